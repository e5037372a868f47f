// Projected Gaussians as arrays of vectors, one array after the other in one buffer: a kernel of a browser has eight
// storage bindings. Quantities as in splat.rs.
//
//     a: mean x, mean y, l11, l21    b: l22, support, x0 | x1 << 16, y0 | y1 << 16    c: color, opacity
//     of a G-buffer: d: ray distance, ray plane x and y, normal x    e: normal y and z, 0, 0

struct Splat {
    mean: vec2<f32>,
    l11: f32,
    l21: f32,
    l22: f32,
    support: f32,
}

fn splat_of(a: vec4<f32>, b: vec4<u32>) -> Splat {
    return Splat(a.xy, a.z, a.w, bitcast<f32>(b.x), bitcast<f32>(b.y));
}

// x0, y0, x1, y1: the ends are exclusive.
fn rect_of(b: vec4<u32>) -> vec4<u32> {
    return vec4(b.z & 0xffffu, b.w & 0xffffu, b.z >> 16u, b.w >> 16u);
}

// First and last x of the support over sample rows y0 to y1, with a slack for rounding. Meaningful where the support
// reaches those rows (Speedy-Splat's AccuTile, Hanson et al. 2025).
fn x_span(s: Splat, y0: f32, y1: f32) -> vec2<f32> {
    let low = s.mean.y - y1;
    let high = s.mean.y - y0;
    // The support's largest dx is reached at this dy, its smallest at the negative: where ∂(u² + v²)/∂dy = 0.
    let steepness = sqrt(fma(s.l21, s.l21, s.l22 * s.l22));
    let dy_at_max_dx = -s.l21 * (sqrt(s.support) / s.l22) / steepness;
    let right = edge(s, max(min(dy_at_max_dx, high), low), 1.0);
    let left = edge(s, max(min(-dy_at_max_dx, high), low), -1.0);
    let slack = fma(right - left, SPAN_SLACK_PER_PIXEL, SPAN_SLACK);
    return vec2(s.mean.x - right - slack, s.mean.x - left + slack);
}

fn edge(s: Splat, dy: f32, side: f32) -> f32 {
    let v = s.l22 * dy;
    return (side * sqrt(max(s.support - v * v, 0.0)) - s.l21 * dy) / s.l11;
}

// Whether the support reaches the rectangle of sample positions `low` to `high` (StopThePop, Radl et al. 2024): the
// quadratic form is convex, so outside the centre its minimum lies on an edge.
fn reaches(s: Splat, low: vec2<f32>, high: vec2<f32>) -> bool {
    if all(low <= s.mean) && all(s.mean <= high) {
        return true;
    }
    let nearest = min(min(column(s, low.x, low.y, high.y), column(s, high.x, low.y, high.y)),
        min(row(s, low.y, low.x, high.x), row(s, high.y, low.x, high.x)));
    // The slack covers rounding; a tile too many costs time only.
    return nearest <= s.support * REACH_FACTOR + REACH_SLACK;
}

fn form(s: Splat, dx: f32, dy: f32) -> f32 {
    let u = fma(s.l11, dx, s.l21 * dy);
    let v = s.l22 * dy;
    return fma(u, u, v * v);
}

fn column(s: Splat, x: f32, y0: f32, y1: f32) -> f32 {
    let dx = s.mean.x - x;
    let dy = -s.l11 * s.l21 * dx / fma(s.l21, s.l21, s.l22 * s.l22);
    return form(s, dx, max(min(dy, s.mean.y - y0), s.mean.y - y1));
}

fn row(s: Splat, y: f32, x0: f32, x1: f32) -> f32 {
    let dy = s.mean.y - y;
    let dx = -s.l21 * dy / s.l11;
    return form(s, max(min(dx, s.mean.x - x0), s.mean.x - x1), dy);
}
