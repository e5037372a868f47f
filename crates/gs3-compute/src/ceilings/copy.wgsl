// Memory alone: every vector is read once and written once.

// An invocation has ITEMS vectors, a workgroup apart: several loads are under way at a time. The loop over them is written out.

@group(0) @binding(0) var<storage, read> source: array<vec4<f32>>;
@group(0) @binding(1) var<storage, read_write> copied: array<vec4<f32>>;

@compute @workgroup_size(THREADS)
fn copy(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let first = workgroup.x * THREADS * ITEMS + lane;
    if first + (ITEMS - 1u) * THREADS >= arrayLength(&copied) {
        return;
    }
    let a = source[first];
    let b = source[first + THREADS];
    let c = source[first + 2u * THREADS];
    let d = source[first + 3u * THREADS];
    copied[first] = a;
    copied[first + THREADS] = b;
    copied[first + 2u * THREADS] = c;
    copied[first + 3u * THREADS] = d;
}
