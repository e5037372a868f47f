// The Hermite surface through the current samples; see hermite.rs.

@group(0) @binding(1) var<storage, read> samples_a: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> samples_b: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> samples_c: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read> mixed: array<vec2<u32>>;

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

fn sample_at(at: vec2<u32>) -> Sample {
    let id = id_in_picture(at);
    return unpack_sample(samples_a[id].y, samples_b[id], samples_c[id]);
}

fn mixed_at(i: u32) -> vec3<f32> {
    let packed = mixed[i];
    return vec3(unpack2x16float(packed.x), unpack2x16float(packed.y).x);
}

// Beyond the border the nearest column is repeated, with slope 0.
fn column_at(index: i32, rows: Rows, bare: vec3<f32>) -> Column {
    let inside = clamp(index, 0, i32(frame.lr.x) - 1);
    let i = rows.inside * frame.lr.x + u32(inside);
    let a = sample_at(vec2(u32(inside), rows.inside.x));
    let b = sample_at(vec2(u32(inside), rows.inside.y));
    let w = rows.weights;
    let value = a.color * w.x + a.dy * w.y + b.color * w.z + b.dy * w.w;
    var slope = vec3(0.0);
    if index == inside {
        slope = a.dx * w.x + mixed_at(i.x) * w.y + b.dx * w.z + mixed_at(i.y) * w.w;
    }
    let is_bare = a.is_bare && b.is_bare && all(a.color == bare) && all(b.color == bare);
    return Column(value, slope, is_bare);
}
