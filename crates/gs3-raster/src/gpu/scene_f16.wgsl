// Colours as f16, shapes in 128 bits: see `packed_shape` of scene.rs. Means and largest scales are f32.

@group(0) @binding(4) var<storage, read> shapes: array<vec4<u32>>;
@group(0) @binding(5) var<storage, read> sh: array<u32>;

fn ratio_of(word: u32) -> f32 {
    let code = word >> 10u;
    return select(0.0, bitcast<f32>((code + FIRST_RATIO) << 6u), code > 0u);
}

fn shape_of(i: u32) -> Shape {
    let words = shapes[i];
    let opacity = (words.x & 0x3ffu) | ((words.y & 0x3ffu) << 10u) | ((words.w >> 30u) << 20u);
    let signed = vec3(words.z << 12u, ((words.z >> 8u) & 0xfff000u) | (words.w << 24u), words.w << 4u);
    let v = vec3<f32>(bitcast<vec3<i32>>(signed) >> vec3(12u)) * QUATERNION_STEP;
    let largest = sqrt(max(1.0 - dot3(v, v), 0.0));
    var rotation = vec4(largest, v);
    switch (words.w >> 28u) & 3u {
        case 1u: { rotation = vec4(v.x, largest, v.yz); }
        case 2u: { rotation = vec4(v.xy, largest, v.z); }
        case 3u: { rotation = vec4(v, largest); }
        default: {}
    }
    let scales = centers[i].w * vec3(1.0, ratio_of(words.x), ratio_of(words.y));
    return Shape(scales, f32(opacity) / OPACITY_STEPS, rotation);
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
