// The Hermite surface through the current samples; see hermite.rs.

// See predict.wgsl, which writes it.
@group(0) @binding(1) var<storage, read> surface: array<vec4<u32>>;

// Value and slope of the cubic along x at an LR column, at the height of a row of pixels.
struct Column {
    value: vec3<f32>,
    slope: vec3<f32>,
    // All samples that it is made from are bare, and of the colour asked for.
    is_bare: bool,
}

// Weights of value, slope, value, slope at `f` of the way between two samples.
fn hermite_weights(f: f32) -> vec4<f32> {
    let f2 = f * f;
    let f3 = f2 * f;
    let spacing = f32(SCALE);
    return vec4(
        2.0 * f3 - 3.0 * f2 + 1.0, spacing * (f3 - 2.0 * f2 + f), 3.0 * f2 - 2.0 * f3, spacing * (f3 - f2),
    );
}

struct Rows {
    inside: vec2<u32>,
    weights: vec4<f32>,
    // Fraction of the way between the rows.
    fraction: f32,
}

// The rows of samples above and below row `y` of pixels. Beyond the border the nearest row is repeated, with slope 0.
fn rows_around(y: u32) -> Rows {
    let place = frame.y_places[y % SCALE];
    let index = i32(place.x) + i32(y / SCALE);
    let last = i32(frame.lr.y) - 1;
    let inside = clamp(vec2(index, index + 1), vec2(0), vec2(last));
    var weights = hermite_weights(place.y);
    weights.y = select(0.0, weights.y, inside.x == index);
    weights.w = select(0.0, weights.w, inside.y == index + 1);
    return Rows(vec2<u32>(inside), weights, place.y);
}

// A sample of the picture, and the mixed derivative there.
struct SurfaceSample {
    sample: Sample,
    mixed: vec3<f32>,
}

fn surface_at(at: vec2<u32>) -> SurfaceSample {
    let i = at.y * frame.lr.x + at.x;
    let first = surface[2u * i];
    let second = surface[2u * i + 1u];
    let mixed = vec3(unpack2x16float(second.y), unpack2x16float(second.z).x);
    return SurfaceSample(unpack_sample(first.x, first.yz, vec2(first.w, second.x)), mixed);
}

// Beyond the border the nearest column is repeated, with slope 0.
fn column_at(index: i32, rows: Rows, bare: vec3<f32>) -> Column {
    let inside = clamp(index, 0, i32(frame.lr.x) - 1);
    let above = surface_at(vec2(u32(inside), rows.inside.x));
    let below = surface_at(vec2(u32(inside), rows.inside.y));
    let a = above.sample;
    let b = below.sample;
    let w = rows.weights;
    let value = a.color * w.x + a.dy * w.y + b.color * w.z + b.dy * w.w;
    var slope = vec3(0.0);
    if index == inside {
        slope = a.dx * w.x + above.mixed * w.y + b.dx * w.z + below.mixed * w.w;
    }
    let is_bare = a.is_bare && b.is_bare && all(a.color == bare) && all(b.color == bare);
    return Column(value, slope, is_bare);
}
