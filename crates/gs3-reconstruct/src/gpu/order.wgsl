// Samples in the order of their cells: what a pixel needs then lies in three runs of memory, one a row of cells. Within
// a cell samples are ordered by their numbers, so that sums do not depend on the order of arrival.
//
// splat.wgsl counts the samples of each cell. A scan turns the counts into first places. `list` gives each sample a place
// in its cell, in any order, and turns the first places into ends. `rank` finds the places in order. copy.wgsl copies
// the gradients.

@group(0) @binding(1) var<storage, read> landed: array<vec2<u32>>;
// The first place of each cell, while `list` turns them into ends.
@group(0) @binding(2) var<storage, read_write> cell_counts: array<atomic<u32>>;
@group(0) @binding(3) var<storage, read> cell_ends: array<u32>;
// The samples of each cell in any order.
@group(0) @binding(4) var<storage, read_write> listed: array<u32>;
@group(0) @binding(5) var<storage, read> places: array<vec2<f32>>;
@group(0) @binding(6) var<storage, read> samples_a: array<vec2<u32>>;
// In order: places; variance, with CURRENT and OF_BLOCK, and red and green; numbers.
@group(0) @binding(7) var<storage, read_write> ordered_places: array<vec2<f32>>;
@group(0) @binding(8) var<storage, read_write> ordered_a: array<vec2<u32>>;
@group(0) @binding(9) var<storage, read_write> order: array<u32>;

// Reverses the order of arrival: for tests that this order has no effect.
override BACKWARD: bool = false;

@compute @workgroup_size(WORKGROUP_X, WORKGROUP_Y)
fn list(@builtin(global_invocation_id) id_in_order: vec3<u32>) {
    if any(id_in_order.xy >= frame.padded) {
        return;
    }
    let last = vec3(frame.padded, frame.frames + frame.layers) - 1u;
    let at = select(id_in_order, last - id_in_order, BACKWARD);
    if !is_sample(at) {
        return;
    }
    let id = id_of(at);
    let cell = landed[id].y;
    if cell != NOWHERE {
        listed[atomicAdd(&cell_counts[cell], 1u)] = id;
    }
}

@compute @workgroup_size(WORKGROUP_X, WORKGROUP_Y)
fn rank(@builtin(global_invocation_id) at: vec3<u32>) {
    let place = place_in_order(at);
    if place >= cell_ends[cell_count() - 1u] {
        return;
    }
    let id = listed[place];
    let here = landed[id];
    var first = 0u;
    if here.y > 0u {
        first = cell_ends[here.y - 1u];
    }
    var to = first;
    for (var k = first; k < cell_ends[here.y]; k++) {
        to += u32(listed[k] < id);
    }
    let is_current = id - newest() < frame.padded.x * frame.padded.y;
    ordered_places[to] = places[id];
    ordered_a[to] = vec2(here.x | select(0u, CURRENT, is_current), samples_a[id].y);
    order[to] = id;
}
