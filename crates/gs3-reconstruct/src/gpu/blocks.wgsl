// Writes the current frame's exact blocks into the history, as samples.wgsl does its LR frame; see fill_block in
// samples/fill.rs. One invocation per pixel of a block.

// Where the blocks go.
struct Remembered {
    // The block of the history that takes the first one; the next ones follow, after the last block the first.
    first: u32,
    // Blocks of the history that belong to this frame, used or not.
    count: u32,
    // Blocks of the history.
    room: u32,
    // Blocks in a row of the picture.
    columns: u32,
}

@group(0) @binding(1) var<uniform> remembered: Remembered;
// Colour and median depth, ∂x, ∂y of the blocks' pixels per HR pixel, array after array.
@group(0) @binding(2) var<storage, read> exact_samples: array<vec4<f32>>;
// Numbers of the picture's blocks, the chosen ones first.
@group(0) @binding(3) var<storage, read> numbers: array<u32>;
@group(0) @binding(4) var<storage, read> chosen_count: u32;
@group(0) @binding(5) var<storage, read_write> samples_a: array<vec2<u32>>;
@group(0) @binding(6) var<storage, read_write> samples_b: array<vec2<u32>>;
@group(0) @binding(7) var<storage, read_write> samples_c: array<vec2<u32>>;
@group(0) @binding(8) var<storage, read_write> edge_slopes: array<u32>;

// The largest inverse depth of the pixels around pixel `at`, in the block of `corner` with its first sample at `first`.
fn nearest_in_block(first: u32, corner: vec2<u32>, at: vec2<u32>) -> f32 {
    let last = min(min(at + 1u, vec2(BLOCK_SIDE - 1u)), frame.size - 1u - corner);
    var near = 0.0;
    for (var y = max(at.y, 1u) - 1u; y <= last.y; y++) {
        for (var x = max(at.x, 1u) - 1u; x <= last.x; x++) {
            near = max(near, inverse_depth(exact_samples[first + y * BLOCK_SIDE + x].w));
        }
    }
    return near;
}

// The largest inverse depth of nine samples of the current LR frame: the sample nearest to the middle of the block of `corner`,
// and the samples around that one. From scale 4 on they surround the block.
fn nearest_around_block(corner: vec2<u32>) -> f32 {
    let last = frame.past[0].extent - 1u;
    let middle = vec2<f32>(corner + BLOCK_SIDE / 2u) * (1.0 / f32(frame.scale));
    let nearest = min(vec2<u32>(max(middle - frame.past[0].offset + HALF_WAY, vec2(0.0))), last);
    let first = max(nearest, vec2(1u)) - 1u;
    var near = 0.0;
    for (var y = first.y; y <= min(nearest.y + 1u, last.y); y++) {
        for (var x = first.x; x <= min(nearest.x + 1u, last.x); x++) {
            near = max(near, bitcast<f32>(samples_a[newest() + y * frame.padded.x + x].x));
        }
    }
    return near;
}

@compute @workgroup_size(GROUP)
fn remember_blocks(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = group_index(workgroup) * GROUP + lane;
    let number = index / BLOCK_PIXELS;
    if number >= remembered.count {
        return;
    }
    let to = (remembered.first + number) % remembered.room;
    let samples = arrayLength(&exact_samples) / 3u;
    let is_block = number < chosen_count && number < samples / BLOCK_PIXELS;
    let block = numbers[select(0u, number, is_block)];
    let corner = vec2(block % remembered.columns, block / remembered.columns) * BLOCK_SIDE;
    if index % BLOCK_PIXELS == 0u {
        edge_slopes[frame.first_of_corners + to] = select(NO_CORNER, corner.x | (corner.y << 16u), is_block);
    }
    let at = pixel_of(index);
    if !is_block || any(corner + at >= frame.size) {
        return;
    }
    let color = exact_samples[index];
    let dx = exact_samples[samples + index].xyz;
    let dy = exact_samples[2u * samples + index].xyz;
    let near = max(nearest_in_block(index - index % BLOCK_PIXELS, corner, at), nearest_around_block(corner));
    let id = frame.first_of_blocks + to * BLOCK_PIXELS + index % BLOCK_PIXELS;
    write_sample(id, color.xyz, dx, dy, inverse_depth(color.w), near, CROSSING_OF_BLOCKS);
}
