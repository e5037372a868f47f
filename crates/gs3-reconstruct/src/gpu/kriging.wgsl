// Pixels that first-order predictions leave uncertain, by gradient-enhanced kriging; see cpu/kriging/mod.rs.
//
// tile.wgsl marks them by the sign of their uncertainty. A workgroup lists those of its pixels, so that none of its
// invocations waits for nothing. An invocation looks around one pixel for its samples; then SAMPLES of them solve a
// pixel's system, each the rows of one sample: whole, they are more than an invocation's registers hold. Per sample
// one hands its rows to the others through workgroup memory, which take them off their own. Lines in capitals are
// written out by kriging.rs.

@group(0) @binding(1) var<storage, read> samples_a: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> samples_b: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> samples_c: array<vec2<u32>>;
@group(0) @binding(5) var<storage, read> heads: array<u32>;
@group(0) @binding(6) var<storage, read> places: array<vec2<f32>>;
@group(0) @binding(7) var<storage, read> links: array<vec2<u32>>;
// RGB and uncertainty, halves, row by row.
@group(0) @binding(8) var<storage, read_write> image: array<vec2<u32>>;

// Those that are solved at a time.
const SYSTEMS: u32 = THREADS / SAMPLES;

var<workgroup> count: atomic<u32>;
var<workgroup> marked: u32;
var<workgroup> list: array<u32, KRIGED_WIDTH * KRIGED_HEIGHT>;
// Of each pixel its samples, best first, by numbers from 1, 0 where there is none; from which variance on samples are
// left out.
var<workgroup> ids: array<u32, THREADS * SAMPLES>;
var<workgroup> left_out: array<f32, THREADS>;
// Of each system its samples: positions relative to the pixel in lengths of the covariance, noises, 1 if there is one.
var<workgroup> around: array<vec4<f32>, THREADS>;
// Of each system the rows of one sample, and of the next one.
var<workgroup> pivots: array<vec4<f32>, 2u * SYSTEMS * 3u * WIDTH>;

// The best samples around `pixel` into place `slot`.
fn find_samples(pixel: vec2<i32>, slot: u32) {
    let size = vec2<i32>(frame.size) + vec2(i32(COLUMNS) - 1, i32(ROWS) - 1);
    var best: array<f32, SAMPLES + 1u>;
    var numbers: array<u32, SAMPLES + 1u>;
    for (var k = 0u; k <= SAMPLES; k++) {
        best[k] = FARTHEST;
        numbers[k] = 0u;
    }
    // Samples less than two pixels away. A sample's cell is the first pixel that it reaches, COLUMNS − 1 and ROWS − 1
    // further on.
    let first = pixel + vec2(i32(COLUMNS) - 4, i32(ROWS) - 4);
    for (var y = max(first.y, 0); y <= min(first.y + 4, size.y - 1); y++) {
        for (var x = first.x; x <= min(first.x + 3, size.x - 1); x++) {
            var id = heads[u32(y * size.x + x)];
            while id != 0u {
                let link = links[id - 1u];
                let d = places[id - 1u] - vec2<f32>(pixel);
                let d2 = dot(d, d);
                var variance = fma(d2, d2, bitcast<f32>(link.x));
                // By their numbers among equals. The worst falls out at the end.
                var number = id;
                for (var k = 0u; k <= SAMPLES; k++) {
                    if variance < best[k] || (variance == best[k] && number < numbers[k]) {
                        let worse = vec2(bitcast<u32>(best[k]), numbers[k]);
                        best[k] = variance;
                        numbers[k] = number;
                        variance = bitcast<f32>(worse.x);
                        number = worse.y;
                    }
                }
                id = link.y;
            }
        }
    }
    for (var k = 0u; k < SAMPLES; k++) {
        ids[slot * SAMPLES + k] = numbers[k];
    }
    left_out[slot] = best[SAMPLES];
}

fn covariance(u: vec2<f32>) -> f32 {
    return 1.0 / fma(0.5, dot(u, u), 1.0);
}

// What the value, ∂x and ∂y of one sample have in common with those of another.
struct Shared {
    value: vec3<f32>,
    dx: vec3<f32>,
    dy: vec3<f32>,
}

// Of samples `a` and `b` of `around`; `own` is added to what they have with themselves.
fn shared_by(a: vec4<f32>, b: vec4<f32>, own: f32) -> Shared {
    let u = a.xy - b.xy;
    let q = covariance(u);
    // The image's covariance, and that of what both samples err by alike.
    let grown = fma(PER_NOISE, min(a.z, b.z), 1.0);
    let both = a.w * b.w;
    let q2 = both * q * q * grown;
    let slope = q2 * u;
    let bend = -2.0 * q * slope;
    return Shared(
        vec3(fma(both * q, grown, own), slope),
        vec3(-slope.x, fma(bend.x, u.x, q2) + own, bend.x * u.y),
        vec3(-slope.y, bend.x * u.y, fma(bend.y, u.y, q2) + own),
    );
}

// The 3×3 matrix of a sample as LDLᵀ.
struct Factors {
    inverses: vec3<f32>,
    l10: f32,
    l20: f32,
    l21: f32,
}

// Of its upper triangle.
fn factors_of(a: vec3<f32>, b: vec2<f32>, c: f32) -> Factors {
    // Only rounding brings a pivot below the nugget.
    let first = 1.0 / max(a.x, 0.5 * NUGGET);
    let l10 = a.y * first;
    let l20 = a.z * first;
    let second = 1.0 / max(fma(-l10, a.y, b.x), 0.5 * NUGGET);
    let below = fma(-l10, a.z, b.y);
    let l21 = below * second;
    let third = 1.0 / max(fma(-l21, below, fma(-l20, a.z, c)), 0.5 * NUGGET);
    return Factors(vec3(first, second, third), l10, l20, l21);
}

// The inverse of the matrix times `b`.
fn solved(f: Factors, b: vec3<f32>) -> vec3<f32> {
    let y = fma(-f.l10, b.x, b.y);
    let z = fma(-f.l21, y, fma(-f.l20, b.x, b.z)) * f.inverses.z;
    let second = fma(-f.l21, z, y * f.inverses.y);
    return vec3(fma(-f.l20, z, fma(-f.l10, second, b.x * f.inverses.x)), second, z);
}

// The part of the pixel in `slot` that sample `sample` of its system `system` has in its solution.
fn krige(corner: vec2<u32>, slot: u32, list_place: u32, system: u32, sample: u32) {
    let is_pixel = list_place < marked;
    var pixel = corner;
    var id = 0u;
    if is_pixel {
        pixel += vec2(list[list_place] % KRIGED_WIDTH, list[list_place] / KRIGED_WIDTH);
        id = ids[slot * SAMPLES + sample];
    }
    let place = pixel.y * frame.size.x + pixel.x;
    let packed = image[place];
    let rest = unpack2x16float(packed.y);
    let mean = vec3(unpack2x16float(packed.x), rest.x);
    // Of a sample that there is not, a system of its own that says nothing.
    var own = 1.0;
    var here = vec4(0.0);
    // Covariance with the pixel, and what the sample differs from the mean by.
    var value6 = vec4(0.0);
    var dx6 = vec4(0.0);
    var dy6 = vec4(0.0);
    if id != 0u {
        let d = places[id - 1u] - vec2<f32>(pixel);
        let noise = bitcast<f32>(links[id - 1u].x);
        let d2 = dot(d, d);
        let share = fma(d2, d2, noise) / left_out[slot];
        own = NUGGET + FADE * share * share / (1.0 + 1e-4 - share);
        here = vec4(d / LENGTH, noise, 1.0);
        let q = covariance(here.xy);
        let s = unpack_sample(samples_a[id - 1u].y, samples_b[id - 1u], samples_c[id - 1u]);
        value6 = vec4(q, s.color - mean);
        dx6 = vec4(-q * q * here.x, LENGTH * s.dx);
        dy6 = vec4(-q * q * here.y, LENGTH * s.dy);
    }
    let first = system * SAMPLES;
    around[first + sample] = here;
    workgroupBarrier();
    FILL
    // How much of the pixel's variance the samples explain, and what they say that the mean does not: forward
    // elimination alone gives both.
    var all = vec4(0.0);
    ELIMINATE
    if is_pixel && sample == 0u {
        let trust = saturate((all.x - UNTRUSTED) / (TRUSTED - UNTRUSTED));
        let color = clamp(fma(all.yzw, vec3(trust), mean), vec3(-65504.0), vec3(65504.0));
        image[place] = vec2(pack2x16float(color.xy), pack2x16float(vec2(color.z, -rest.y)));
    }
}

@compute @workgroup_size(THREADS)
fn krige_marked(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let corner = group.xy * vec2(KRIGED_WIDTH, KRIGED_HEIGHT);
    // Workgroup memory begins with anything.
    if lane == 0u {
        atomicStore(&count, 0u);
    }
    workgroupBarrier();
    for (var k = lane; k < KRIGED_WIDTH * KRIGED_HEIGHT; k += THREADS) {
        let pixel = corner + vec2(k % KRIGED_WIDTH, k / KRIGED_WIDTH);
        if all(pixel < frame.size) && (image[pixel.y * frame.size.x + pixel.x].y >> 31u) != 0u {
            list[atomicAdd(&count, 1u)] = k;
        }
    }
    workgroupBarrier();
    if lane == 0u {
        marked = atomicLoad(&count);
    }
    let end = workgroupUniformLoad(&marked);
    for (var first = 0u; first < end; first += THREADS) {
        if first + lane < end {
            let at = list[first + lane];
            find_samples(vec2<i32>(corner + vec2(at % KRIGED_WIDTH, at / KRIGED_WIDTH)), lane);
        }
        workgroupBarrier();
        for (var k = 0u; k < min(THREADS, end - first); k += SYSTEMS) {
            let system = lane / SAMPLES;
            krige(corner, k + system, first + k + system, system, lane % SAMPLES);
        }
        workgroupBarrier();
    }
}
