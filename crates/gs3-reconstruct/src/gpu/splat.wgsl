// Splats every remembered sample to its current place; see splat.rs. One invocation per sample, all frames and layers of
// exact blocks at once.
//
// The samples of each cell (cells.wgsl) are counted; order.wgsl then puts the samples into the order of their cells. No
// motion makes memory overflow. The depth pre-pass `splat_depth` runs before; see nearest.rs.

@group(0) @binding(1) var<storage, read> samples_a: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> samples_b: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> cells: array<vec4<u32>>;
// Edge slopes of samples, and after them the corners of exact blocks (block_corners.wgsl).
@group(0) @binding(4) var<storage, read> edge_slopes: array<u32>;
// Number of samples of each cell.
@group(0) @binding(5) var<storage, read_write> cell_counts: array<atomic<u32>>;
// HR positions, pixel centres at whole numbers.
@group(0) @binding(6) var<storage, read_write> places: array<vec2<f32>>;
// Variance of the prediction at the sample's place, pixel⁴, with OF_BLOCK; the sample's cell, or NOWHERE.
@group(0) @binding(7) var<storage, read_write> landed: array<vec2<u32>>;

// Bits of the largest inverse depth of the samples nearest to each pixel, 0 where there is none. Bits of non-negative
// floats are ordered like the floats. One entry per HR pixel, plus RIM pixels on each side.
@group(0) @binding(8) var<storage, read_write> nearest: array<atomic<u32>>;
// The same for `splat_color`, which only reads: atomic loads would bypass the first-level cache.
@group(0) @binding(9) var<storage, read> nearest_found: array<u32>;

struct ReprojectedSample {
    // HR position on the sample's own grid and on the current grid, pixel centres at halves.
    own: vec2<f32>,
    to: vec2<f32>,
    inverse_depth: f32,
    // It exists, and lies in front of the camera.
    is_ahead: bool,
}

// The current place of sample `at`: column, row and entry of `frame.past`.
fn reproject_sample(at: vec3<u32>) -> ReprojectedSample {
    let id = id_of(at);
    var own = (vec2<f32>(at.xy) + (0.5 + frame.past[at.z].offset)) * f32(frame.scale);
    var is_there = true;
    if id >= frame.first_of_blocks {
        let index = id - frame.first_of_blocks;
        let block = block_at(edge_slopes[frame.first_of_corners + index / BLOCK_PIXELS]);
        let pixel = block.xy + pixel_of(index);
        own = vec2<f32>(pixel) + 0.5;
        is_there = block.z != 0u && all(pixel < frame.size);
    }
    let w = bitcast<f32>(samples_a[id].x);
    let seen = reproject(frame.past[at.z].rows, own, w);
    return ReprojectedSample(own, seen.xy, w * seen.w, is_there && seen.z > MIN_DIVISOR);
}

// The place of a pixel in `nearest`.
fn place_of(pixel: vec2<f32>) -> u32 {
    let place = vec2<u32>(vec2<i32>(pixel) + i32(RIM));
    return place.y * (frame.size.x + 2u * RIM) + place.x;
}

@compute @workgroup_size(WORKGROUP_X, WORKGROUP_Y)
fn splat_depth(@builtin(global_invocation_id) id_in_order: vec3<u32>) {
    // LR frames of every EVERY-th age, then all layers.
    let frames = (frame.frames + EVERY - 1u) / EVERY;
    let is_layer = id_in_order.z >= frames;
    let z = select(id_in_order.z * EVERY, frame.frames + id_in_order.z - frames, is_layer);
    let at = vec3(id_in_order.xy, z);
    if !is_sample(at) || frame.past[z].age % EVERY != 0u {
        return;
    }
    let seen = reproject_sample(at);
    let pixel = floor(seen.to);
    let rim = f32(RIM);
    if seen.is_ahead && all(pixel >= vec2(-rim)) && all(pixel < vec2<f32>(frame.size) + rim) {
        atomicMax(&nearest[place_of(pixel)], bitcast<u32>(seen.inverse_depth));
    }
}

// The largest inverse depth around a pixel at most two pixels outside the image.
fn nearest_around(pixel: vec2<f32>) -> f32 {
    let place = place_of(pixel) - (frame.size.x + 2u * RIM) - 1u;
    var most = 0u;
    for (var y = 0u; y < 3u; y++) {
        for (var x = 0u; x < 3u; x++) {
            most = max(most, nearest_found[place + y * (frame.size.x + 2u * RIM) + x]);
        }
    }
    return bitcast<f32>(most);
}

// The variance, pixel⁴, that the current frame gives a past sample with colour `color`, seen now at `at` with inverse
// depth `w`. `staleness` is in pixels, and `change` is a possible change of its colour. Outside the frame the nearest
// cells are used.
fn rectification_variance(at: vec2<f32>, w: f32, color: vec3<f32>, staleness: f32, change: f32) -> f32 {
    let last = vec2<f32>(frame.lr - 1u);
    let place = vec2<u32>(clamp(fma(at, vec2(1.0 / f32(frame.scale)), frame.cell_offset), vec2(0.0), last));
    let i = place.y * frame.lr.x + place.x;
    let rest = cells[2u * i + 1u];
    if w < bitcast<f32>(rest.w) {
        return HIDDEN;
    }
    let middle = bitcast<vec4<f32>>(cells[2u * i]);
    let extent = vec3(unpack2x16float(rest.x), unpack2x16float(rest.y).x);
    let outside = max(abs(color - middle.xyz) - extent, vec3(0.0));
    return fma(fma(change, change, dot(outside, outside)), middle.w, bitcast<f32>(rest.z) * (staleness * staleness));
}

// A place this little before a whole pixel, in pixels, is one: the distance between two f32 from 8 on. Samples that rest on
// pixels reach the same pixels then, wherever rounding puts them. Samples that move are to keep the pixels that they have
// on the CPU: with 16 times as much, one of a test's samples has others, and a kriged pixel that needs it is wrong.
const WHOLE: f32 = 9.5367431640625e-7;

@compute @workgroup_size(WORKGROUP_X, WORKGROUP_Y)
fn splat_color(@builtin(global_invocation_id) at: vec3<u32>) {
    if !is_sample(at) {
        return;
    }
    let id = id_of(at);
    landed[id] = vec2(0u, NOWHERE);
    let seen = reproject_sample(at);
    let to = seen.to - 0.5;
    let first = floor(vec2(to.x, to.y + 0.5) + WHOLE) - 1.0;
    let reaches = first.x > -f32(COLUMNS) && first.y > -f32(ROWS) && all(first < vec2<f32>(frame.size));
    if !(seen.is_ahead && reaches) {
        return;
    }
    let moved = seen.to - seen.own;
    let moved2 = dot(moved, moved);
    let color = vec3(unpack2x16float(samples_a[id].y), unpack2x16float(samples_b[id].x).x);
    // Pixels; see ReprojectedSamples::staleness in splat.rs.
    let parallax = frame.past[at.z].parallax;
    let staleness = fma(bitcast<f32>(samples_a[id].x), parallax, PER_FRAME * f32(frame.past[at.z].age));
    var variance = rectification_variance(to, seen.inverse_depth, color, staleness, bitcast<f32>(edge_slopes[id]) * parallax);
    // A nearer sample may hide this one now. This is more likely, the farther the two have moved apart.
    let near = nearest_around(floor(seen.to));
    if seen.inverse_depth < near * (1.0 - DEPTH_TOLERANCE) {
        let apart = (near - seen.inverse_depth) * parallax;
        variance = fma(apart, apart * OCCLUDED, variance);
    }
    // A sample that does not move keeps its exact value. Only motion (0 at rest, towards 1 for a pixel or more) gives
    // weight to staleness and rectification.
    let motion = moved2 / (moved2 + 1.0);
    let is_of_block = id >= frame.first_of_blocks;
    let aging = select(AGING, AGING_OF_BLOCKS, is_of_block);
    let noise = fma(fma(staleness, aging, variance * select(1.0, ALIKE, is_of_block)), motion, NOISE);
    if !(noise <= MAX_NOISE) {
        return;
    }
    let corner = vec2<u32>(vec2<i32>(first) + vec2<i32>(i32(COLUMNS) - 1, i32(ROWS) - 1));
    let cell = corner.y * cell_columns() + corner.x;
    places[id] = to;
    landed[id] = vec2((bitcast<u32>(noise) & ~OF_BLOCK) | select(0u, OF_BLOCK, is_of_block), cell);
    atomicAdd(&cell_counts[cell], 1u);
}
