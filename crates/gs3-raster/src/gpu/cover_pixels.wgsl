// Which small staged splats touch which pixel of a tile, for G-buffers: at low resolution most splats are as small as
// pixels, and a block has several times as many splats as one of its pixels.

// The splats of the next batch are read before they are needed. With colour alone they are not: blending takes a tenth
// longer then on an H100.
const READS_AHEAD: bool = true;

// Splats at most this wide and high, in pixels, are noted pixel by pixel. (On an H100, 4 and 6 are alike, 9 is slower.)
const SMALL: u32 = 6u;

// Bit i of word k of a pixel: whether small splat 32·k + i touches it. Word k of all pixels lies before word k + 1.
var<workgroup> pixel_cover: array<atomic<u32>, PIXELS * WORDS>;

// Notes the pixels in a stager's rows of blocks, from `first_row` on, that staged splat `slot` touches; `origin` is the
// tile's first pixel.
fn cover_pixels(slot: u32, s: Splat, rect: vec4<u32>, origin: vec2<u32>, first_row: u32) {
    let top = max(rect.y, origin.y + first_row * BLOCK);
    let bottom = min(rect.w, origin.y + (first_row + BLOCKS / STAGERS) * BLOCK);
    let low = f32(max(rect.x, origin.x));
    let high = f32(min(rect.z, origin.x + TILE)) - 1.0;
    for (var y = top; y < bottom; y++) {
        let dy = s.mean.y - f32(y);
        let right = edge(s, dy, 1.0);
        let left = edge(s, dy, -1.0);
        // The slack covers rounding; a pixel too many costs time only.
        let slack = fma(right - left, SPAN_SLACK_PER_PIXEL, SPAN_SLACK);
        let begin = max(ceil(s.mean.x - right - slack), low);
        let end = min(floor(s.mean.x - left + slack), high);
        for (var x = begin; x <= end; x += 1.0) {
            let at = vec2(u32(x), y) - origin;
            let block = at / BLOCK;
            let inside = at % BLOCK;
            let pixel = (block.y * BLOCKS + block.x) * BLOCK * BLOCK + inside.y * BLOCK + inside.x;
            atomicOr(&pixel_cover[slot / 32u * PIXELS + pixel], 1u << (slot % 32u));
        }
    }
}

// Notes what staged splat `slot` touches in a stager's part of the tile.
fn cover_splat(slot: u32, s: Splat, rect: vec4<u32>, workgroup: vec3<u32>, part: u32) {
    let corner = corner_of(workgroup);
    if all(rect.zw - rect.xy <= vec2(SMALL)) {
        cover_pixels(slot, s, rect, corner, BLOCKS / STAGERS * part);
    } else {
        cover_rows(slot, s, rect, vec2<f32>(corner), BLOCKS / STAGERS * part);
    }
}

fn clear_pixel(lane: u32) {
    for (var word = 0u; word < WORDS; word++) {
        atomicStore(&pixel_cover[word * PIXELS + lane], 0u);
    }
}

fn pixel_word(word: u32, lane: u32) -> u32 {
    return atomicLoad(&pixel_cover[word * PIXELS + lane]);
}
