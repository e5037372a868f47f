// Ranks of keys by subgroup. Each subgroup takes a strip of the tile and counts digits for itself. Lanes find the
// lanes with the same digit by one ballot for each of its bits. See also rank_shared.wgsl.

const ROWS: u32 = THREADS / MIN_SUBGROUP;

// Keys of each digit, by subgroup.
var<workgroup> counts: array<atomic<u32>, ROWS * BINS>;

// The place in the tile of a thread's key of round `i`.
fn item(thread: Thread, i: u32) -> u32 {
    return (thread.subgroup * ITEMS + i) * thread.size + thread.lane;
}

fn clear_ranks(thread: Thread) {
    for (var k = thread.index; k < ROWS * BINS; k += THREADS) {
        atomicStore(&counts[k], 0u);
    }
    workgroupBarrier();
}

// Bits of all lanes below `lane`.
fn lanes_below(lane: u32) -> vec4<u32> {
    let first = vec4<u32>(0u, 32u, 64u, 96u);
    let below = clamp(vec4<i32>(i32(lane)) - vec4<i32>(first), vec4<i32>(0), vec4<i32>(32));
    // A shift by 32 is none.
    return select((vec4<u32>(1u) << (vec4<u32>(below) & vec4<u32>(31u))) - 1u, vec4<u32>(0xFFFFFFFFu), below == vec4<i32>(32));
}

fn ones(mask: vec4<u32>) -> u32 {
    let ones = countOneBits(mask);
    return ones.x + ones.y + ones.z + ones.w;
}

// The first lane of `mask`, which is not empty.
fn first_lane(mask: vec4<u32>) -> u32 {
    var first = 96u + firstTrailingBit(mask.w);
    first = select(first, 64u + firstTrailingBit(mask.z), mask.z != 0u);
    first = select(first, 32u + firstTrailingBit(mask.y), mask.y != 0u);
    return select(first, firstTrailingBit(mask.x), mask.x != 0u);
}

// The keys of this subgroup before this one that have its digit. All threads call it.
fn rank(thread: Thread, digit: u32) -> u32 {
    var same = subgroupBallot(true);
    for (var b = 0u; b < DIGIT_BITS; b++) {
        let is_one = ((digit >> b) & 1u) == 1u;
        let with_bit = subgroupBallot(is_one);
        same &= select(~with_bit, with_bit, is_one);
    }
    let leader = first_lane(same);
    var earlier = 0u;
    if thread.lane == leader {
        earlier = atomicAdd(&counts[thread.subgroup * BINS + digit], ones(same));
    }
    earlier = subgroupShuffle(earlier, leader);
    return earlier + ones(same & lanes_below(thread.lane));
}

// The tile's keys of digit `d`; counts become what subgroups before have.
fn finish_ranks(d: u32) -> u32 {
    var sum = 0u;
    for (var row = 0u; row < ROWS; row++) {
        let found = atomicLoad(&counts[row * BINS + d]);
        atomicStore(&counts[row * BINS + d], sum);
        sum += found;
    }
    return sum;
}

// What to add to a rank.
fn rank_start(thread: Thread, digit: u32) -> u32 {
    return atomicLoad(&counts[thread.subgroup * BINS + digit]);
}

@compute @workgroup_size(THREADS)
fn prepare(@builtin(local_invocation_index) index: u32) {
    prepare_sort(Thread(index, 0u, 0u, 0u));
}

@compute @workgroup_size(THREADS)
fn histogram(@builtin(local_invocation_index) index: u32, @builtin(workgroup_id) group: vec3<u32>) {
    count_digits(Thread(index, 0u, 0u, 0u), group_index(group));
}

@compute @workgroup_size(THREADS)
fn sweep(
    @builtin(subgroup_id) subgroup: u32,
    @builtin(subgroup_invocation_id) lane: u32,
    @builtin(subgroup_size) size: u32,
) {
    sweep_tile(Thread(subgroup * size + lane, subgroup, lane, size));
}
