// Pixels that first-order predictions leave uncertain, by gradient-enhanced kriging; see kriging.rs.
//
// tile.wgsl marks them by the sign of their uncertainty. A workgroup lists those of its pixels and shares them out,
// so that no invocation waits for nothing while others solve.

@group(0) @binding(1) var<storage, read> samples_a: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> samples_b: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> samples_c: array<vec2<u32>>;
@group(0) @binding(5) var<storage, read> heads: array<u32>;
@group(0) @binding(6) var<storage, read> places: array<vec2<f32>>;
@group(0) @binding(7) var<storage, read> links: array<vec2<u32>>;
// RGB and uncertainty, halves, row by row.
@group(0) @binding(8) var<storage, read_write> image: array<vec2<u32>>;

const DATA: u32 = 3u * SAMPLES;
const THREADS: u32 = 64u;

var<workgroup> count: atomic<u32>;
var<workgroup> list: array<u32, KRIGED_WIDTH * KRIGED_HEIGHT>;

// The samples of the pixel and one more, best first: numbers, variances of their first-order predictions, positions
// relative to the pixel in lengths of the covariance.
var<private> ids: array<u32, SAMPLES + 1u>;
var<private> variances: array<f32, SAMPLES + 1u>;
var<private> at: array<vec2<f32>, SAMPLES + 1u>;
// Variances of the samples' first-order predictions where they are.
var<private> noises: array<f32, SAMPLES>;
// Variance from which on samples are left out.
var<private> left_out: f32;
// The lower triangle, row by row; the last row has the covariances with the pixel.
var<private> system: array<f32, (DATA + 1u) * (DATA + 2u) / 2u>;
var<private> inverses: array<f32, DATA>;
var<private> weights: array<f32, DATA>;

// Puts the best samples around `pixel` into `ids`, by their numbers among equals; how many.
fn look_around(pixel: vec2<i32>) -> u32 {
    let size = vec2<i32>(frame.size) + vec2(i32(COLUMNS) - 1, i32(ROWS) - 1);
    var found = 0u;
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
                let variance = fma(d2, d2, bitcast<f32>(link.x));
                var k = min(found, SAMPLES);
                if variance < FARTHEST && (found <= SAMPLES || is_better(variance, id, k)) {
                    found = min(found + 1u, SAMPLES + 1u);
                    while k > 0u && is_better(variance, id, k - 1u) {
                        variances[k] = variances[k - 1u];
                        ids[k] = ids[k - 1u];
                        at[k] = at[k - 1u];
                        k--;
                    }
                    variances[k] = variance;
                    ids[k] = id;
                    at[k] = d / LENGTH;
                }
                id = link.y;
            }
        }
    }
    left_out = FARTHEST;
    if found > SAMPLES {
        found = SAMPLES;
        left_out = variances[SAMPLES];
    }
    return found;
}

fn is_better(variance: f32, id: u32, k: u32) -> bool {
    return variance < variances[k] || (variance == variances[k] && id < ids[k]);
}

fn row(r: u32) -> u32 {
    return r * (r + 1u) / 2u;
}

fn covariance(u: vec2<f32>) -> f32 {
    return 1.0 / fma(0.5, dot(u, u), 1.0);
}

// The covariances of the data of `n` samples with each other and with the pixel.
fn fill_system(n: u32) {
    for (var i = 0u; i < n; i++) {
        let share = variances[i] / left_out;
        let fade = FADE * share * share / (1.0 + 1e-4 - share);
        noises[i] = bitcast<f32>(links[ids[i] - 1u].x);
        for (var j = 0u; j <= i; j++) {
            let u = at[i] - at[j];
            let q = covariance(u);
            // The image's covariance, and that of what both samples err by alike.
            let grown = fma(PER_NOISE, min(noises[i], noises[j]), 1.0);
            let q2 = q * q * grown;
            let slope = q2 * u;
            let bend = -2.0 * q * slope;
            let own = select(0.0, NUGGET + fade, i == j);
            let to = vec3(row(3u * i), row(3u * i + 1u), row(3u * i + 2u)) + 3u * j;
            system[to.x] = fma(q, grown, own);
            system[to.y] = -slope.x;
            system[to.y + 1u] = fma(bend.x, u.x, q2) + own;
            system[to.z] = -slope.y;
            system[to.z + 1u] = bend.x * u.y;
            system[to.z + 2u] = fma(bend.y, u.y, q2) + own;
            if i != j {
                system[to.x + 1u] = slope.x;
                system[to.x + 2u] = slope.y;
                system[to.y + 2u] = bend.x * u.y;
            }
        }
        let q = covariance(at[i]);
        let to = row(3u * n) + 3u * i;
        system[to] = q;
        system[to + 1u] = -q * q * at[i].x;
        system[to + 2u] = -q * q * at[i].y;
    }
}

// The weights of `data` data, LDLᵀ, of which LD takes the place of the system; how far to trust them.
fn solve(data: u32) -> f32 {
    var explained = 0.0;
    for (var column = 0u; column < data; column++) {
        // Only rounding brings a pivot below the nugget.
        let inverse = 1.0 / max(system[row(column) + column], 0.5 * NUGGET);
        inverses[column] = inverse;
        // L⁻¹k: nothing more is to be subtracted.
        let known = system[row(data) + column];
        explained = fma(known * known, inverse, explained);
        for (var other = column + 1u; other < data; other++) {
            let by = -system[row(other) + column] * inverse;
            for (var r = other; r <= data; r++) {
                system[row(r) + other] = fma(system[row(r) + column], by, system[row(r) + other]);
            }
        }
    }
    for (var k = data; k > 0u; k--) {
        let column = k - 1u;
        var sum = system[row(data) + column];
        for (var r = k; r < data; r++) {
            sum = fma(-system[row(r) + column], weights[r], sum);
        }
        weights[column] = sum * inverses[column];
    }
    return saturate((explained - DOUBTFUL) / (CERTAIN - DOUBTFUL));
}

fn krige(pixel: vec2<u32>) {
    let place = pixel.y * frame.size.x + pixel.x;
    let packed = image[place];
    let rest = unpack2x16float(packed.y);
    let mean = vec3(unpack2x16float(packed.x), rest.x);
    let n = look_around(vec2<i32>(pixel));
    fill_system(n);
    let trust = solve(3u * n);
    var change = vec3(0.0);
    for (var i = 0u; i < n; i++) {
        let id = ids[i] - 1u;
        let s = unpack_sample(samples_a[id].y, samples_b[id], samples_c[id]);
        change += weights[3u * i] * (s.color - mean)
            + LENGTH * fma(vec3(weights[3u * i + 1u]), s.dx, weights[3u * i + 2u] * s.dy);
    }
    let color = clamp(fma(change, vec3(trust), mean), vec3(-65504.0), vec3(65504.0));
    image[place] = vec2(pack2x16float(color.xy), pack2x16float(vec2(color.z, -rest.y)));
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
    let marked = atomicLoad(&count);
    for (var slot = lane; slot < marked; slot += THREADS) {
        krige(corner + vec2(list[slot] % KRIGED_WIDTH, list[slot] / KRIGED_WIDTH));
    }
}
