// HR images at fractional positions, from 6×6 pixels; see gather.rs. Positions are fixed-point numbers of 1/UNITS
// pixel, pixel centres at whole numbers; the border repeats.

@group(0) @binding(1) var<storage, read> before: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> after: array<vec2<u32>>;

// Pixel (x, y) of neighbour `n`.
fn pixel_of(n: u32, x: i32, y: i32) -> vec4<f32> {
    let last = vec2<i32>(in_between.size) - 1;
    let i = u32(clamp(y, 0, last.y)) * in_between.size.x + u32(clamp(x, 0, last.x));
    var packed: vec2<u32>;
    if n == 0u {
        packed = before[i];
    } else {
        packed = after[i];
    }
    return vec4(unpack2x16float(packed.x), unpack2x16float(packed.y));
}

// Weights of the taps −2, −1 and 0 at `f`, without the linear part; at 1 − `f` they are the weights of 3, 2 and 1.
fn half_weights(f: f32) -> vec3<f32> {
    return f * (1.0 - f) * fma(vec3(f), FIT_SECOND, FIT_FIRST);
}

fn weights(position: i32) -> array<f32, TAPS> {
    let f = f32(position & (UNITS - 1)) / f32(UNITS);
    let before = half_weights(f);
    let after = half_weights(1.0 - f);
    return array(before.x, before.y, 1.0 - f + before.z, f + after.z, after.y, after.x);
}

// Gathers `count` pixels in a row of neighbour `n` from `position` on, whole pixels apart.
fn gather_row(n: u32, position: vec2<i32>, count: u32) -> array<vec4<f32>, 4> {
    var wx = weights(position.x);
    let wy = weights(position.y);
    // The pixel of the first weight.
    let first = vec2(position.x >> PHASE_BITS, position.y >> PHASE_BITS) - BEFORE;
    var row: array<vec4<f32>, 4>;
    for (var c = 0u; c < count + TAPS - 1u; c++) {
        let x = first.x + i32(c);
        var column = pixel_of(n, x, first.y) * wy[0];
        column = fma(pixel_of(n, x, first.y + 1), vec4(wy[1]), column);
        column = fma(pixel_of(n, x, first.y + 2), vec4(wy[2]), column);
        column = fma(pixel_of(n, x, first.y + 3), vec4(wy[3]), column);
        column = fma(pixel_of(n, x, first.y + 4), vec4(wy[4]), column);
        column = fma(pixel_of(n, x, first.y + 5), vec4(wy[5]), column);
        for (var k = 0u; k < count; k++) {
            // Index of the pixel's column; other columns wrap to large numbers.
            let tap = c - k;
            if tap < TAPS {
                row[k] = fma(column, vec4(wx[tap]), row[k]);
            }
        }
    }
    return row;
}
