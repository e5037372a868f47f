// Between the stages: how much there is, how much of it there is room for, and how many workgroups that takes. What
// there was no room for shows in the counters, and the frame is made again with more. Whoever records the first frame
// after they were read clears the most that frames needed, so that none of several frames lacks room unseen.

// Both counts are of items, for kernels of workgroups of this size.

@group(0) @binding(0) var<storage, read_write> counters: Counters;
// Workgroups over splats, and over entries.
@group(0) @binding(1) var<storage, read_write> dispatches: array<array<u32, 3>, 2>;
// Sums of the scans before.
@group(0) @binding(2) var<storage, read> splat_total: array<u32>;
@group(0) @binding(3) var<storage, read> entry_total: array<u32>;
// Bound for their length alone.
@group(0) @binding(4) var<storage, read> order: array<u32>;
@group(0) @binding(5) var<storage, read> entry_tiles: array<u32>;

fn dispatch_over(items: u32) -> array<u32, 3> {
    let groups = grid_of((items + GROUP - 1u) / GROUP);
    return array<u32, 3>(groups.x, groups.y, groups.z);
}

@compute @workgroup_size(1)
fn plan_splats() {
    let found = splat_total[0];
    counters.most_splats = max(counters.most_splats, found);
    counters.splats = min(found, arrayLength(&order));
    counters.places = counters.splats + 1u;
    atomicStore(&counters.entry_shares, 0u);
    dispatches[0] = dispatch_over(counters.places);
}

@compute @workgroup_size(1)
fn plan_entries() {
    // From 2^31 on the sum may have wrapped: below, the shares have lost less than 2^30 to rounding, 4,095 a group.
    var found = entry_total[0];
    if atomicLoad(&counters.entry_shares) >= (1u << 31u) / ENTRY_SHARE {
        found = 0xffffffffu;
    }
    atomicStore(&counters.entry_shares, 0u);
    counters.entries = min(found, arrayLength(&entry_tiles));
    counters.most_entries = max(counters.most_entries, found);
    dispatches[1] = dispatch_over(counters.entries);
}
