// Which staged splats touch which 4×4 block of a tile: the exact extent per row of blocks; see cover.rs.

// Blocks along a side of a tile, and blocks of a workgroup.
const BLOCKS: u32 = TILE / BLOCK;
const GROUP_BLOCKS: u32 = PIXELS / (BLOCK * BLOCK);

// BATCH splats are staged at a time: with depth and normal, and what touches what, 5 KiB for 64 invocations and 13 KiB for 256,
// so that every device has room and several workgroups share a multiprocessor.
const WORDS: u32 = BATCH / 32u;

// Invocations that stage a splat: one or two.
const STAGERS: u32 = PIXELS / BATCH;

// Bit i of word k of a block: whether staged splat 32·k + i touches it.
var<workgroup> cover: array<atomic<u32>, GROUP_BLOCKS * WORDS>;

// Notes the blocks of a stager's rows, from `first_row` on, that staged splat `slot` touches; `origin` is the tile's first pixel.
fn cover_rows(slot: u32, s: Splat, rect: vec4<u32>, origin: vec2<f32>, first_row: u32) {
    let mean = s.mean - origin;
    let low = vec2<f32>(rect.xy) - origin;
    let high = vec2<f32>(rect.zw) - 1.0 - origin;
    let steepness = sqrt(fma(s.l21, s.l21, s.l22 * s.l22));
    let dy_at_max_dx = -s.l21 * (sqrt(s.support) / s.l22) / steepness;
    for (var row = first_row; row < first_row + BLOCKS / STAGERS; row++) {
        let top = f32(row * BLOCK);
        let bottom = f32(row * BLOCK + BLOCK - 1u);
        if low.y > bottom || high.y < top {
            continue;
        }
        let nearest = mean.y - bottom;
        let farthest = mean.y - top;
        let right = edge(s, max(min(dy_at_max_dx, farthest), nearest), 1.0);
        let left = edge(s, max(min(-dy_at_max_dx, farthest), nearest), -1.0);
        // The slack covers rounding; a block too many costs time only.
        let slack = fma(right - left, SPAN_SLACK_PER_PIXEL, SPAN_SLACK);
        let begin = max(mean.x - right - slack, low.x);
        let end = min(mean.x - left + slack, high.x);
        for (var column = 0u; column < BLOCKS; column++) {
            if begin <= f32(column * BLOCK + BLOCK - 1u) && end >= f32(column * BLOCK) {
                atomicOr(&cover[(row * BLOCKS + column) * WORDS + slot / 32u], 1u << (slot % 32u));
            }
        }
    }
}
