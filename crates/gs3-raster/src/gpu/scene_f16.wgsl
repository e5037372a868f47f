// Scales and colours as f16, opacity as 16-bit fixed point of [0, 1], quaternions of [-1, 1]. Means stay f32.

@group(0) @binding(4) var<storage, read> shapes: array<vec4<u32>>;
@group(0) @binding(5) var<storage, read> sh: array<u32>;

fn shape_of(i: u32) -> Shape {
    let words = shapes[i];
    let xy = unpack2x16float(words.x);
    let z = unpack2x16float(words.y).x;
    let opacity = unpack2x16unorm(words.y).y;
    let rotation = vec4(unpack2x16snorm(words.z), unpack2x16snorm(words.w));
    return Shape(vec3(xy, z) * page.scale_unit, opacity, rotation);
}

// Coefficient k of Gaussian i, RGB: three halves, at an odd half where k is odd.
fn sh_of(i: u32, k: u32) -> vec3<f32> {
    let halves = 3u * (SH_DEGREE + 1u) * (SH_DEGREE + 1u);
    let word = i * ((halves + 1u) / 2u) + 3u * k / 2u;
    let first = unpack2x16float(sh[word]);
    let second = unpack2x16float(sh[word + 1u]);
    if (k & 1u) == 0u {
        return vec3(first, second.x);
    }
    return vec3(first.y, second);
}
