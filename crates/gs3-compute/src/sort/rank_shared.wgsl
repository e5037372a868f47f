// Ranks of keys through shared memory: in each of ITEMS rounds every thread sets its bit in the mask of its digit; bits
// below its own are keys before it. Beside rank_subgroups.wgsl.

const WORDS: u32 = THREADS / 32u;

// Masks of the threads with this digit in their key of this round: WORDS words for each digit.
var<workgroup> masks: array<atomic<u32>, BINS * WORDS>;
// Keys of each digit in the rounds before.
var<workgroup> seen: array<u32, BINS>;

// The place in the tile of a thread's key of round `i`.
fn item(thread: Thread, i: u32) -> u32 {
    return i * THREADS + thread.index;
}

fn clear_ranks(thread: Thread) {
    for (var k = thread.index; k < BINS * WORDS; k += THREADS) {
        atomicStore(&masks[k], 0u);
    }
    for (var d = thread.index; d < BINS; d += THREADS) {
        seen[d] = 0u;
    }
    workgroupBarrier();
}

// The keys before this one that have its digit. All threads call it.
fn rank(thread: Thread, digit: u32) -> u32 {
    let word = thread.index / 32u;
    let bit = 1u << (thread.index % 32u);
    atomicXor(&masks[digit * WORDS + word], bit);
    workgroupBarrier();
    var before = 0u;
    var all = 0u;
    for (var w = 0u; w < WORDS; w++) {
        let mask = atomicLoad(&masks[digit * WORDS + w]);
        all += countOneBits(mask);
        before += countOneBits(select(select(0u, mask & (bit - 1u), w == word), mask, w < word));
    }
    let earlier = seen[digit];
    workgroupBarrier();
    if before == 0u {
        seen[digit] = earlier + all;
    }
    // Only this thread's bit: others may already set theirs for the next round.
    atomicXor(&masks[digit * WORDS + word], bit);
    return earlier + before;
}

// The tile's keys of digit `d`.
fn finish_ranks(d: u32) -> u32 {
    return seen[d];
}

// What to add to a rank.
fn rank_start(thread: Thread, digit: u32) -> u32 {
    return 0u;
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
fn sweep(@builtin(local_invocation_index) index: u32) {
    sweep_tile(Thread(index, 0u, 0u, 0u));
}
