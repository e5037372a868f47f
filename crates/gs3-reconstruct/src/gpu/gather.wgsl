// HR images at fractional positions, Catmull–Rom; see gather.rs. Positions are fixed-point numbers of 1/UNITS pixel, pixel
// centres at whole numbers; the border repeats.

@group(0) @binding(1) var<storage, read> before: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> after: array<vec2<u32>>;

// Pixel (x, y) of neighbour `n`.
fn pixel_of(n: u32, x: i32, y: i32) -> vec4<f32> {
    let last = vec2<i32>(between.size) - 1;
    let i = u32(clamp(y, 0, last.y)) * between.size.x + u32(clamp(x, 0, last.x));
    var packed: vec2<u32>;
    if n == 0u {
        packed = before[i];
    } else {
        packed = after[i];
    }
    return vec4(unpack2x16float(packed.x), unpack2x16float(packed.y));
}

fn catmull_rom(position: i32) -> vec4<f32> {
    let f = f32(position & (UNITS - 1)) / f32(UNITS);
    let f2 = f * f;
    let f3 = f2 * f;
    return vec4(
        -0.5 * f3 + f2 - 0.5 * f, 1.5 * f3 - 2.5 * f2 + 1.0, -1.5 * f3 + 2.0 * f2 + 0.5 * f, 0.5 * f3 - 0.5 * f2,
    );
}

// Of `count` pixels in a row of neighbour `n` from `position` on, whole pixels apart.
fn gather_row(n: u32, position: vec2<i32>, count: u32) -> array<vec4<f32>, 4> {
    let wx = catmull_rom(position.x);
    let wy = catmull_rom(position.y);
    // The pixel of the first weight.
    let first = vec2(position.x >> PHASE_BITS, position.y >> PHASE_BITS) - 1;
    var row: array<vec4<f32>, 4>;
    for (var c = 0u; c < count + 3u; c++) {
        let x = first.x + i32(c);
        let column = pixel_of(n, x, first.y) * wy.x + pixel_of(n, x, first.y + 1) * wy.y
            + pixel_of(n, x, first.y + 2) * wy.z + pixel_of(n, x, first.y + 3) * wy.w;
        for (var k = 0u; k < count; k++) {
            // Which of the pixel's four columns it is; others wrap to large numbers.
            let tap = c - k;
            if tap < 4u {
                row[k] = fma(column, vec4(wx[tap]), row[k]);
            }
        }
    }
    return row;
}
