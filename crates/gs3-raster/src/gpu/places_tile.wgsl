// The pixels of a frame: a workgroup makes a tile, and an invocation a pixel.

// RGB and alpha of the band's pixels, row by row; the other planes have the same layout.
@group(0) @binding(6) var<storage, read_write> color_alpha: array<vec4<f32>>;

fn range_of(workgroup: vec3<u32>, lane: u32) -> vec2<u32> {
    return ranges[workgroup.y * band.columns + workgroup.x];
}

fn place_of(workgroup: vec3<u32>, lane: u32) -> Place {
    let block = lane / 16u;
    let pixel = corner_of(workgroup) + vec2(block % BLOCKS, block / BLOCKS) * BLOCK + vec2(lane % BLOCK, lane % 16u / BLOCK);
    let index = (pixel.y - band.first_row * TILE) * view.stride + pixel.x;
    return Place(index, vec2<f32>(pixel), all(pixel < view.size));
}

fn write_color(index: u32, color: vec3<f32>, alpha: f32) {
    color_alpha[index] = vec4(color, alpha);
}
