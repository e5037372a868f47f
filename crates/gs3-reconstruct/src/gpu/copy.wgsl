// Blue and the gradients of the samples in the order of their cells; see order.wgsl.

@group(0) @binding(1) var<storage, read> order: array<u32>;
@group(0) @binding(2) var<storage, read> cell_ends: array<u32>;
@group(0) @binding(3) var<storage, read> samples_b: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read> samples_c: array<vec2<u32>>;
@group(0) @binding(5) var<storage, read_write> ordered_b: array<vec2<u32>>;
@group(0) @binding(6) var<storage, read_write> ordered_c: array<vec2<u32>>;

@compute @workgroup_size(WORKGROUP_X, WORKGROUP_Y)
fn copy(@builtin(global_invocation_id) at: vec3<u32>) {
    let place = place_in_order(at);
    if place >= cell_ends[cell_count() - 1u] {
        return;
    }
    let id = order[place];
    ordered_b[place] = samples_b[id];
    ordered_c[place] = samples_c[id];
}
