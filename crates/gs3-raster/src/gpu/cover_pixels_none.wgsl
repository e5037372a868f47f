// Without pixels: see cover_pixels.wgsl.

const READS_AHEAD: bool = false;

fn cover_splat(slot: u32, s: Splat, rect: vec4<u32>, workgroup: vec3<u32>, part: u32) {
    cover_rows(slot, s, rect, vec2<f32>(corner_of(workgroup)), BLOCKS / STAGERS * part);
}

fn clear_pixel(lane: u32) {}

fn pixel_word(word: u32, lane: u32) -> u32 {
    return 0u;
}
