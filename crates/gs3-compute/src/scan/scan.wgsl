// Exclusive scan in place. Workgroups own equal ranges. The first kernel sums each range; the second scans each range,
// starting from the sum of everything before it. Two dispatches. Their size depends on the buffer, not on the count.

@group(0) @binding(0) var<storage> count: array<u32>;
@group(0) @binding(1) var<storage, read_write> values: array<u32>;
@group(0) @binding(2) var<storage, read_write> sums: array<u32>;
@group(0) @binding(3) var<storage, read_write> total: array<u32>;

// Values that a workgroup takes at once, ITEMS neighbours a thread.
const STEP: u32 = THREADS * ITEMS;

// Workgroups of both dispatches, as `blocks` in mod.rs.
fn blocks() -> u32 {
    return clamp((arrayLength(&values) + STEP - 1u) / STEP, 1u, BLOCKS);
}

// The range of block `block`: start and end, starts being multiples of STEP.
fn range_of(block: u32) -> vec2<u32> {
    let n = min(count[0], arrayLength(&values));
    let steps = (n + STEP - 1u) / STEP;
    let per_block = (steps + blocks() - 1u) / blocks() * STEP;
    return min(vec2<u32>(block, block + 1u) * per_block, vec2<u32>(n));
}

fn value_at(index: u32, end: u32) -> u32 {
    return select(0u, values[min(index, end - 1u)], index < end);
}

fn sum_block(thread: Thread, block: u32) {
    let range = range_of(block);
    var sum = 0u;
    for (var k = range.x + thread.index; k < range.y; k += THREADS) {
        sum += values[k];
    }
    let sums_of_all = prefix(thread, sum);
    if thread.index == 0u {
        sums[block] = sums_of_all.y;
    }
}

fn scan_block(thread: Thread, block: u32) {
    var before = 0u;
    for (var k = thread.index; k < block; k += THREADS) {
        before += sums[k];
    }
    var carry = prefix(thread, before).y;
    let range = range_of(block);
    for (var start = range.x; start < range.y; start += STEP) {
        let first = start + thread.index * ITEMS;
        var own: array<u32, ITEMS>;
        var sum = 0u;
        for (var i = 0u; i < ITEMS; i++) {
            own[i] = sum;
            sum += value_at(first + i, range.y);
        }
        let around = prefix(thread, sum);
        for (var i = 0u; i < ITEMS; i++) {
            if first + i < range.y {
                values[first + i] = carry + around.x + own[i];
            }
        }
        carry += around.y;
    }
    if block == blocks() - 1u && thread.index == 0u {
        total[0] = carry;
    }
}
