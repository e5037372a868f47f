// Which staged splats touch which exact block of the workgroup.

// A workgroup has few pixels for the length of its list, and waits for the splats.
const READS_AHEAD: bool = true;

// Notes the blocks of a stager's share that staged splat `slot` touches: its exact extent on the block's rows; see cover.rs.
fn cover_splat(slot: u32, s: Splat, rect: vec4<u32>, workgroup: vec3<u32>, part: u32) {
    let root = sqrt(s.support);
    let reach = vec2(root * sqrt(fma(s.l21, s.l21, s.l22 * s.l22)) / (s.l11 * s.l22), root / s.l22);
    // The slack covers rounding; a block too many costs time only.
    let slack = fma(reach, vec2(2.0 * SPAN_SLACK_PER_PIXEL), vec2(SPAN_SLACK));
    let low = s.mean - reach - slack;
    let high = s.mean + reach + slack;
    let side = f32(BLOCK - 1u) / f32(view.scale);
    let first_block = part * (GROUP_BLOCKS / STAGERS);
    for (var block = first_block; block < first_block + GROUP_BLOCKS / STAGERS; block++) {
        if numbers[block] == NO_BLOCK {
            return;
        }
        let first = corners[block];
        let last = first + side;
        if any(high < first) || any(low > last) {
            continue;
        }
        let span = x_span(s, first.y, last.y);
        if span.x <= last.x && span.y >= first.x {
            atomicOr(&cover[block * WORDS + slot / 32u], 1u << (slot % 32u));
        }
    }
}

fn clear_pixel(lane: u32) {}

fn pixel_word(word: u32, lane: u32) -> u32 {
    return 0u;
}
