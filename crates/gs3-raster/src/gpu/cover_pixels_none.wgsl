// Without pixels: see cover_pixels.wgsl.

const READS_AHEAD: bool = false;

fn is_noted_by_pixel(rect: vec4<u32>) -> bool {
    return false;
}

fn cover_pixels(slot: u32, s: Splat, rect: vec4<u32>, origin: vec2<u32>, first_row: u32) {}

fn clear_pixel(lane: u32) {}

fn pixel_word(word: u32, lane: u32) -> u32 {
    return 0u;
}
