// Sums over a workgroup of THREADS invocations through shared memory. Beside prefix_subgroups.wgsl.

// Who an invocation is: `index` in the workgroup; the other two matter with subgroups only.
struct Thread {
    index: u32,
    subgroup: u32,
    lane: u32,
    size: u32,
}

var<workgroup> prefix_sums: array<u32, THREADS>;
var<workgroup> prefix_total: u32;

// x: the sum of `value` over the threads before this one; y: over all. All threads call it.
fn prefix(thread: Thread, value: u32) -> vec2<u32> {
    workgroupBarrier();
    prefix_sums[thread.index] = value;
    var sum = value;
    for (var step = 1u; step < THREADS; step *= 2u) {
        workgroupBarrier();
        var other = 0u;
        if thread.index >= step {
            other = prefix_sums[thread.index - step];
        }
        workgroupBarrier();
        sum += other;
        prefix_sums[thread.index] = sum;
    }
    if thread.index == THREADS - 1u {
        prefix_total = sum;
    }
    return vec2<u32>(sum - value, workgroupUniformLoad(&prefix_total));
}
