// Two neighbours along an axis and the weight of the second, for a place with pixel centres at integers, moved into
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
