// Colours as f16, shapes in 128 bits: see `packed_shape` of scene.rs. Means and largest scales are f32.

@group(0) @binding(4) var<storage, read> shapes: array<vec4<u32>>;
@group(0) @binding(5) var<storage, read> sh: array<u32>;

const MAX_OPACITY: f32 = 16777215.0;
const QUATERNION_STEP: f32 = 0.70710678 / 131071.0;

fn shape_of(i: u32) -> Shape {
    let words = shapes[i];
    let ratios = bitcast<vec2<f32>>((words.xy >> vec2(2u)) & vec2(0x3fffffc0u));
    let opacity = (words.x & 0xffu) | ((words.y & 0xffu) << 8u) | ((words.w >> 24u) << 16u);
    let others = vec3(bitcast<i32>(words.z << 14u), bitcast<i32>(((words.z >> 4u) & 0x0fffc000u) | (words.w << 28u)),
        bitcast<i32>(words.w << 10u)) >> vec3(14u);
    let v = vec3<f32>(others) * QUATERNION_STEP;
    let largest = sqrt(max(1.0 - dot3(v, v), 0.0));
    var rotation = vec4(largest, v);
    switch (words.w >> 22u) & 3u {
        case 1u: { rotation = vec4(v.x, largest, v.yz); }
        case 2u: { rotation = vec4(v.xy, largest, v.z); }
        case 3u: { rotation = vec4(v, largest); }
        default: {}
    }
    return Shape(centers[i].w * vec3(1.0, ratios), f32(opacity) / MAX_OPACITY, rotation);
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
