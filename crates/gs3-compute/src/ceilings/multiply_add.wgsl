// Arithmetic alone: multiply-adds of numbers that stay in registers. `Number` is f32 or f16, and `Vector` four of them.

struct Load {
    // Unknown to compilers, and such that nothing grows: v·factor + summand approaches summand / (1 − factor).
    factor: f32,
    summand: f32,
    // Rounds of 2 × 8 vectors.
    rounds: u32,
    _pad: u32,
}

@group(0) @binding(0) var<uniform> load: Load;
@group(0) @binding(1) var<storage, read_write> results: array<f32>;

// The sums of neighbouring invocations begin 1/128 apart: 128 invocations begin within 1.
const PER_UNIT: Number = 128.0;

fn eight(v: Vector, factor: Vector, summand: Vector) -> Vector {
    let w = fma(fma(fma(fma(v, factor, summand), factor, summand), factor, summand), factor, summand);
    return fma(fma(fma(fma(w, factor, summand), factor, summand), factor, summand), factor, summand);
}

@compute @workgroup_size(THREADS)
fn multiply_add(@builtin(global_invocation_id) id: vec3<u32>) {
    let factor = Vector(Number(load.factor));
    let summand = Vector(Number(load.summand));
    // Eight sums that do not wait for each other, as many as a processor's two pipes of four cycles need; a GPU has
    // the other invocations besides. All begin elsewhere, so that none is another's.
    var a = Vector(0.0, 1.0, 2.0, 3.0) / 8.0 + Vector(Number(id.x % 64u) / PER_UNIT);
    var b = a + Vector(1.0);
    for (var round = 0u; round < load.rounds; round++) {
        a = eight(a, factor, summand);
        b = eight(b, factor, summand);
    }
    let sum = vec4<f32>(a + b);
    results[id.x] = (sum.x + sum.y) + (sum.z + sum.w);
}
