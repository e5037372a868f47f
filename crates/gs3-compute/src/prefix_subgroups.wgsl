// Sums over a workgroup of THREADS invocations, subgroups of at least MIN_SUBGROUP. Beside prefix_shared.wgsl.

// Who an invocation is. `index` counts by subgroup, then by lane: the order of subgroup sums.
struct Thread {
    index: u32,
    subgroup: u32,
    lane: u32,
    size: u32,
}

var<workgroup> prefix_sums: array<u32, THREADS / MIN_SUBGROUP>;

// x: the sum of `value` over the threads before this one; y: over all. All threads call it.
fn prefix(thread: Thread, value: u32) -> vec2<u32> {
    let inclusive = subgroupInclusiveAdd(value);
    workgroupBarrier();
    if thread.lane == thread.size - 1u {
        prefix_sums[thread.subgroup] = inclusive;
    }
    workgroupBarrier();
    var before = 0u;
    var total = 0u;
    for (var k = 0u; k < THREADS / thread.size; k++) {
        before += select(0u, prefix_sums[k], k < thread.subgroup);
        total += prefix_sums[k];
    }
    return vec2<u32>(before + inclusive - value, total);
}
