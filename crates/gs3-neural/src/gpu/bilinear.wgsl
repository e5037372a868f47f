// Two neighbours along an axis and the weight of the second: of a place whose integers are pixels' centres, moved into
// the image.
struct Neighbours {
    first: u32,
    second: u32,
    fraction: f32,
}

fn neighbours(place: f32, side: u32) -> Neighbours {
    let inside = clamp(place, 0.0, f32(side - 1u));
    let first = min(u32(inside), max(side, 2u) - 2u);
    return Neighbours(first, min(first + 1u, side - 1u), inside - f32(first));
}

// part0 at (x, y).
fn part0_between(block: u32, x: f32, y: f32) -> vec4<f32> {
    let across = neighbours(x, PART0_WIDTH);
    let down = neighbours(y, PART0_HEIGHT);
    let above = mix(
        part0_block(block, across.first, down.first),
        part0_block(block, across.second, down.first),
        across.fraction,
    );
    let below = mix(
        part0_block(block, across.first, down.second),
        part0_block(block, across.second, down.second),
        across.fraction,
    );
    return mix(above, below, down.fraction);
}
