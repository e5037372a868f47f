// The choice of the blocks with the largest expected errors; see select.rs. `rank` makes keys that sort to the front the
// larger an error is; a stable sort leaves equal errors in row order. `choose` marks the first of the sorted blocks.

struct Selection {
    // Blocks of the picture.
    blocks: u32,
    // Blocks that may be chosen.
    most: u32,
    // Errors up to this one, in ERROR_UNITS, are left out, unless all blocks are wanted.
    least: u32,
    wants_all: u32,
}

@group(0) @binding(0) var<uniform> selection: Selection;
@group(0) @binding(1) var<storage, read> block_errors: array<u32>;
@group(0) @binding(2) var<storage, read_write> keys: array<u32>;
@group(0) @binding(3) var<storage, read_write> numbers: array<u32>;
// For each block its number among the chosen ones, from 1 on: the largest error first; 0 for the others.
@group(0) @binding(4) var<storage, read_write> chosen: array<u32>;
@group(0) @binding(5) var<storage, read_write> chosen_count: atomic<u32>;

// A block's largest error, in ERROR_UNITS, and the key of a block that is left out.
const LARGEST_SUM: u32 = u32(LARGEST_ERROR * ERROR_UNITS) * BLOCK_SIDE * BLOCK_SIDE;
const LEFT_OUT: u32 = LARGEST_SUM + 1u;

@compute @workgroup_size(GROUP)
fn rank(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let block = group_index(workgroup) * GROUP + lane;
    if block >= selection.blocks {
        return;
    }
    let error = min(block_errors[block], LARGEST_SUM);
    let is_wanted = selection.wants_all != 0u || error > selection.least;
    keys[block] = select(LEFT_OUT, LARGEST_SUM - error, is_wanted);
    numbers[block] = block;
}

var<workgroup> group_count: atomic<u32>;

@compute @workgroup_size(GROUP)
fn choose(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    if lane == 0u {
        atomicStore(&group_count, 0u);
    }
    workgroupBarrier();
    let place = group_index(workgroup) * GROUP + lane;
    if place < min(selection.most, selection.blocks) && keys[place] != LEFT_OUT {
        chosen[numbers[place]] = place + 1u;
        atomicAdd(&group_count, 1u);
    }
    workgroupBarrier();
    if lane == 0u {
        atomicAdd(&chosen_count, atomicLoad(&group_count));
    }
}
