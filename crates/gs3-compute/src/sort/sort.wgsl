// Stable radix sort, least significant digit first, one read and one write of every pair per digit ("onesweep":
// Adinets & Merrill 2022). THREADS invocations take a tile of THREADS × ITEMS pairs, rank its keys by their digit, find
// how many of each digit the tiles before have, and write the pairs where they belong, tile-sorted first so that
// neighbours go to neighbouring places.
//
// Departures: counts of tiles are halves of a word with their state, so relaxed atomics suffice. No tile waits without
// end for another one: what is not there after POLLS looks, the tile counts itself (after Smith, Levien & Owens
// 2024), so devices that do not run all workgroups fairly finish too.

@group(0) @binding(0) var<storage> count: array<u32>;
@group(0) @binding(1) var<storage> keys_in: array<u32>;
@group(0) @binding(2) var<storage> values_in: array<u32>;
@group(0) @binding(3) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(4) var<storage, read_write> values_out: array<u32>;
// Counts of dispatches: of sweep, then of histogram.
@group(0) @binding(5) var<storage, read_write> dispatches: array<u32>;
// Tiles handed out, for each pass, then counts of digits of all keys, for each pass.
@group(0) @binding(6) var<storage, read_write> control: array<atomic<u32>>;
// What a tile has of each digit: two halves, for even and odd passes, each of BINS words a tile.
@group(0) @binding(7) var<storage, read_write> status: array<atomic<u32>>;

// Which digit.
override PASS: u32 = 0u;
// Looks at another tile's counts before they are counted again.
override POLLS: u32 = 1024u;
// The same for a workgroup that has looked so often in vain: its device does not run workgroups side by side, and the
// next tile is hardly there either.
const LATER_POLLS: u32 = 16u;

const TILE: u32 = THREADS * ITEMS;
// Digits of a thread.
const DIGITS: u32 = (BINS + THREADS - 1u) / THREADS;

// A status word: nothing yet, the count of this tile, or the count of all tiles up to this one. MAX_PAIRS is the mask
// of the count.
const OWN: u32 = MAX_PAIRS + 1u;
const ALL: u32 = 2u * OWN;

var<workgroup> exchange: array<u32, TILE>;
// Where a digit starts in the sorted tile.
var<workgroup> local_start: array<u32, BINS>;
// What to add to a place in the sorted tile to find the place in the result.
var<workgroup> global_start: array<u32, BINS>;
var<workgroup> recount: array<atomic<u32>, BINS>;
var<workgroup> shared_waiting: atomic<u32>;
var<workgroup> shared_uniform: u32;

// Capacity in tiles.
fn tile_room() -> u32 {
    return arrayLength(&status) / (2u * BINS);
}

fn length() -> u32 {
    return min(count[0], min(arrayLength(&keys_in), tile_room() * TILE));
}

fn digit_of(key: u32, pass_index: u32) -> u32 {
    return ((key & KEY_MASK) >> (pass_index * DIGIT_BITS)) & (BINS - 1u);
}

// One workgroup: counts of dispatches, and zeros.
fn prepare_sort(thread: Thread) {
    if thread.index == 0u {
        let tiles = (length() + TILE - 1u) / TILE;
        let sweeps = grid_of(tiles);
        let histograms = grid_of((tiles + HISTOGRAMS - 1u) / HISTOGRAMS);
        dispatches[0] = sweeps.x;
        dispatches[1] = sweeps.y;
        dispatches[2] = sweeps.z;
        dispatches[3] = histograms.x;
        dispatches[4] = histograms.y;
        dispatches[5] = histograms.z;
    }
    for (var k = thread.index; k < PASSES * (1u + BINS); k += THREADS) {
        atomicStore(&control[k], 0u);
    }
}

var<workgroup> histograms: array<atomic<u32>, PASSES * BINS>;

// Counts the digits of HISTOGRAMS tiles, of all passes, and clears what the first pass needs clear.
fn count_digits(thread: Thread, group: u32) {
    for (var k = thread.index; k < PASSES * BINS; k += THREADS) {
        atomicStore(&histograms[k], 0u);
    }
    workgroupBarrier();
    let n = length();
    let tiles = (n + TILE - 1u) / TILE;
    let first = group * HISTOGRAMS;
    let end = min(first + HISTOGRAMS, tiles);
    for (var k = first * TILE + thread.index; k < min(end * TILE, n); k += THREADS) {
        let key = keys_in[k];
        for (var p = 0u; p < PASSES; p++) {
            atomicAdd(&histograms[p * BINS + digit_of(key, p)], 1u);
        }
    }
    for (var k = first * BINS + thread.index; k < end * BINS; k += THREADS) {
        atomicStore(&status[k], 0u);
    }
    workgroupBarrier();
    for (var k = thread.index; k < PASSES * BINS; k += THREADS) {
        let found = atomicLoad(&histograms[k]);
        if found > 0u {
            atomicAdd(&control[PASSES + k], found);
        }
    }
}

// Counts the digits of tile `tile` into recount.
fn count_again(thread: Thread, tile: u32) {
    for (var d = thread.index; d < BINS; d += THREADS) {
        atomicStore(&recount[d], 0u);
    }
    workgroupBarrier();
    for (var k = thread.index; k < TILE; k += THREADS) {
        // Tiles before another one are full.
        atomicAdd(&recount[digit_of(keys_in[tile * TILE + k], PASS)], 1u);
    }
    workgroupBarrier();
}

fn sweep_tile(thread: Thread) {
    if thread.index == 0u {
        shared_uniform = atomicAdd(&control[PASS], 1u);
    }
    let tile = workgroupUniformLoad(&shared_uniform);
    let n = length();
    if tile * TILE >= n {
        return;
    }
    let valid = min(n - tile * TILE, TILE);
    let room = tile_room() * BINS;
    let half = (PASS & 1u) * room;
    let other_half = room - half;
    for (var d = thread.index; d < BINS; d += THREADS) {
        atomicStore(&status[other_half + tile * BINS + d], 0u);
    }

    // Keys, and their ranks among the keys with the same digit.
    var keys: array<u32, ITEMS>;
    var places: array<u32, ITEMS>;
    clear_ranks(thread);
    for (var i = 0u; i < ITEMS; i++) {
        let at = item(thread, i);
        // What is beyond the end sorts behind everything of its tile, and is not written.
        var key = 0xFFFFFFFFu;
        if at < valid {
            key = keys_in[tile * TILE + at];
        }
        keys[i] = key;
        places[i] = rank(thread, digit_of(key, PASS));
    }
    workgroupBarrier();

    // Counts of this tile are there for others as early as possible.
    var found: array<u32, DIGITS>;
    var before: array<u32, DIGITS>;
    var total = 0u;
    var total_of_all = 0u;
    for (var k = 0u; k < DIGITS; k++) {
        let d = thread.index * DIGITS + k;
        if d < BINS {
            found[k] = finish_ranks(d);
            total += found[k];
            total_of_all += atomicLoad(&control[PASSES + PASS * BINS + d]);
            if tile > 0u {
                atomicStore(&status[half + tile * BINS + d], OWN | found[k]);
            } else {
                atomicStore(&status[half + d], ALL | found[k]);
            }
        }
    }
    var start = prefix(thread, total).x;
    var start_of_all = prefix(thread, total_of_all).x;
    for (var k = 0u; k < DIGITS; k++) {
        let d = thread.index * DIGITS + k;
        if d < BINS {
            local_start[d] = start;
            global_start[d] = start_of_all - start;
            start += found[k];
            start_of_all += atomicLoad(&control[PASSES + PASS * BINS + d]);
        }
    }
    workgroupBarrier();
    for (var i = 0u; i < ITEMS; i++) {
        let digit = digit_of(keys[i], PASS);
        places[i] += local_start[digit] + rank_start(thread, digit);
        exchange[places[i]] = keys[i];
    }

    // How many of each digit the tiles before have. `next` is the tile to look at, plus one; 0: all seen.
    var next: array<u32, DIGITS>;
    for (var k = 0u; k < DIGITS; k++) {
        next[k] = select(0u, tile, thread.index * DIGITS + k < BINS);
    }
    var patience = POLLS;
    loop {
        if thread.index == 0u {
            atomicStore(&shared_waiting, 0u);
        }
        workgroupBarrier();
        for (var k = 0u; k < DIGITS; k++) {
            let d = thread.index * DIGITS + k;
            var polls = 0u;
            while next[k] > 0u {
                let word = atomicLoad(&status[half + (next[k] - 1u) * BINS + d]);
                if word == 0u {
                    polls += 1u;
                    if polls > patience {
                        atomicMax(&shared_waiting, next[k]);
                        break;
                    }
                } else {
                    before[k] += word & MAX_PAIRS;
                    next[k] = select(next[k] - 1u, 0u, word >= ALL);
                }
            }
        }
        workgroupBarrier();
        if thread.index == 0u {
            shared_uniform = atomicLoad(&shared_waiting);
        }
        let waiting = workgroupUniformLoad(&shared_uniform);
        if waiting == 0u {
            break;
        }
        count_again(thread, waiting - 1u);
        patience = min(POLLS, LATER_POLLS);
        for (var k = 0u; k < DIGITS; k++) {
            if next[k] == waiting {
                before[k] += atomicLoad(&recount[thread.index * DIGITS + k]);
                next[k] -= 1u;
            }
        }
    }
    for (var k = 0u; k < DIGITS; k++) {
        let d = thread.index * DIGITS + k;
        if d < BINS {
            if tile > 0u {
                atomicStore(&status[half + tile * BINS + d], ALL | (before[k] + found[k]));
            }
            global_start[d] += before[k];
        }
    }
    workgroupBarrier();

    // The tile is sorted: neighbours go to neighbouring places.
    var targets: array<u32, ITEMS>;
    for (var i = 0u; i < ITEMS; i++) {
        let at = i * THREADS + thread.index;
        let key = exchange[at];
        targets[i] = global_start[digit_of(key, PASS)] + at;
        if at < valid {
            keys_out[targets[i]] = key;
        }
    }
    workgroupBarrier();
    for (var i = 0u; i < ITEMS; i++) {
        let at = item(thread, i);
        if at < valid {
            exchange[places[i]] = values_in[tile * TILE + at];
        }
    }
    workgroupBarrier();
    for (var i = 0u; i < ITEMS; i++) {
        let at = i * THREADS + thread.index;
        if at < valid {
            values_out[targets[i]] = exchange[at];
        }
    }
}
