// The scene as the CPU has it: the oracle of the packed one.

@group(0) @binding(4) var<storage, read> shapes: array<array<vec4<f32>, 2>>;
@group(0) @binding(5) var<storage, read> sh: array<f32>;

fn shape_of(i: u32) -> Shape {
    let values = shapes[i];
    return Shape(values[0].xyz, values[0].w, values[1]);
}

fn sh_of(i: u32, k: u32) -> vec3<f32> {
    let first = 3u * (i * (SH_DEGREE + 1u) * (SH_DEGREE + 1u) + k);
    return vec3(sh[first], sh[first + 1u], sh[first + 2u]);
}
