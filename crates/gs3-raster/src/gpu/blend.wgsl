// Tiles to pixels: front-to-back blending; see blend.rs. A workgroup is a tile, and an invocation a pixel. Sixteen
// consecutive invocations are a 4×4 block, and visit the staged splats that touch their block. Outputs besides colour
// come from one of the outputs_*.wgsl.

@group(0) @binding(1) var<uniform> band: Band;
@group(0) @binding(2) var<storage, read> ranges: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> entry_splats: array<u32>;
@group(0) @binding(4) var<storage, read> splats_a: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> splats_b: array<vec4<u32>>;
@group(0) @binding(6) var<storage, read> splats_c: array<vec4<f32>>;
// RGB and alpha of the band's pixels, row by row; the other planes have the same layout.
@group(0) @binding(7) var<storage, read_write> color_alpha: array<vec4<f32>>;
@group(0) @binding(14) var<storage, read_write> counters: Counters;

var<workgroup> staged_a: array<vec4<f32>, BATCH>;
var<workgroup> staged_b: array<vec4<u32>, BATCH>;
var<workgroup> staged_c: array<vec4<f32>, BATCH>;
// Whether a pixel is open. All invocations that write it at the same time write the same value.
var<workgroup> is_open: u32;

// One splat at one pixel.
struct Contribution {
    // Mean − sample.
    d: vec2<f32>,
    u: f32,
    v: f32,
    // Slope of α; zero where α is capped.
    slope: f32,
    alpha: f32,
    // Transmittance before the splat.
    t: f32,
    // α·t.
    weight: f32,
}

// A pixel as later stages read it.
struct Pixel {
    // Index in the band's planes.
    index: u32,
    // Sample position.
    sample: vec2<f32>,
    // Transmittance behind all splats, and 1 − t.
    t: f32,
    alpha: f32,
}

@compute @workgroup_size(256)
fn blend(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let range = ranges[workgroup.y * band.columns + workgroup.x];
    let corner = vec2(workgroup.x, band.first_row + workgroup.y) * TILE;
    let block = lane / 16u;
    let pixel = corner + vec2(block % BLOCKS, block / BLOCKS) * BLOCK + vec2(lane % BLOCK, lane % 16u / BLOCK);
    let is_inside = all(pixel < view.size);
    let sample = vec2<f32>(pixel);

    // Transmittance while the pixel is open, 0 once it is finished; and the transmittance at which it was finished.
    var t = select(0.0, 1.0, is_inside);
    var last = 0.0;
    var color = vec3(0.0);
    // llvmpipe ends all loops of an invocation after 65,535 rounds, without an error. Unfinished pixels are reported.
    var is_finished = false;
    var is_cut = false;
    var first = range.x;
    for (; first < range.y; first += BATCH) {
        // All invocations have read the batch before.
        workgroupBarrier();
        if lane < BLOCKS * BLOCKS * WORDS {
            atomicStore(&cover[lane], 0u);
        }
        if lane == 0u {
            is_open = 0u;
        }
        let slot = lane / 2u;
        let is_staged = first + slot < range.y;
        if is_staged {
            let splat = entry_splats[first + slot];
            if lane % 2u == 0u {
                staged_a[slot] = splats_a[splat];
                staged_b[slot] = splats_b[splat];
            } else {
                staged_c[slot] = splats_c[splat];
                stage_outputs(slot, splat);
            }
        }
        workgroupBarrier();
        if is_staged {
            let s = splat_of(staged_a[slot], staged_b[slot]);
            cover_rows(slot, s, rect_of(staged_b[slot]), vec2<f32>(corner), lane % 2u * 2u);
        }
        if t > 0.0 {
            is_open = 1u;
        }
        if workgroupUniformLoad(&is_open) == 0u {
            is_finished = true;
            break;
        }
        var word = 0u;
        for (; word < WORDS && t > 0.0; word++) {
            var bits = atomicLoad(&cover[block * WORDS + word]);
            while bits != 0u {
                let slot = word * 32u + firstTrailingBit(bits);
                bits &= bits - 1u;
                let s = splat_of(staged_a[slot], staged_b[slot]);
                let d = s.mean - sample;
                let u = fma(s.l11, d.x, s.l21 * d.y);
                let v = s.l22 * d.y;
                let q = fma(u, u, v * v);
                if q > s.support {
                    continue;
                }
                let c = staged_c[slot];
                let raw = c.w * exp2(-q);
                if raw < MIN_ALPHA {
                    continue;
                }
                let alpha = min(raw, MAX_ALPHA);
                let after = t * (1.0 - alpha);
                if after < MIN_TRANSMITTANCE {
                    last = t;
                    t = 0.0;
                    break;
                }
                // The derivatives of α vanish where α is capped.
                let slope = select(0.0, alpha * UNSCALE, raw < MAX_ALPHA);
                let weight = alpha * t;
                color = fma(c.xyz, vec3(weight), color);
                add_outputs(slot, s, c.xyz, Contribution(d, u, v, slope, alpha, t, weight));
                t = after;
            }
            is_cut = is_cut || (bits != 0u && t > 0.0);
        }
        is_cut = is_cut || (word < WORDS && t > 0.0);
    }
    if is_cut || (first < range.y && !is_finished) {
        atomicStore(&counters.loops_cut, 1u);
    }
    if is_inside {
        let through = select(last, t, t > 0.0);
        let alpha = 1.0 - through;
        let index = (pixel.y - band.first_row * TILE) * view.stride + pixel.x;
        color_alpha[index] = vec4(fma(view.background, vec3(through), color), alpha);
        write_outputs(Pixel(index, sample, through, alpha));
    }
}
