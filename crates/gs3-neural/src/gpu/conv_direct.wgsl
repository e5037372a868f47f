// A convolution that reads its input where it is: windows of one pixel, and those too wide for workgroup memory. An
// invocation keeps four pixels × THREAD_BLOCKS blocks of output channels in registers. Lines in capitals are written
// out by conv.rs.

@compute @workgroup_size(THREADS)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) index: u32) {
    let first_pixel = group_index(group) * 4u * THREADS + index;
    PLACES
    SUMS
    for (var block = 0u; block < IN_BLOCKS; block++) {
        PARTIAL_SUMS
        for (var tap = 0u; tap < TAPS; tap++) {
            let step = vec2<i32>(vec2<u32>(tap % KERNEL, tap / KERNEL) * DILATION) - i32(REACH);
            let matrix_at = ((group.z * IN_BLOCKS + block) * TAPS + tap) * GROUP_BLOCKS;
            PRODUCTS
        }
        ADD_PARTIAL_SUMS
    }
    STORE
}
