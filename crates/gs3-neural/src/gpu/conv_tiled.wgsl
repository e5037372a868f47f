// A convolution, TILE × TILE pixels a workgroup. For each four input channels the workgroup stages the tile with its
// margin, and the weights; an invocation keeps four pixels of a column × THREAD_BLOCKS blocks of output channels in
// registers. Lines in capitals are written out by conv.rs.

const SIDE: u32 = TILE + 2u * REACH;

var<workgroup> pixels: array<Block, SIDE * SIDE>;
var<workgroup> matrices: array<Matrix, TAPS * GROUP_BLOCKS>;

@compute @workgroup_size(THREADS)
fn main(@builtin(workgroup_id) tile: vec3<u32>, @builtin(local_invocation_index) index: u32) {
    let corner = vec2<i32>(tile.xy * TILE) - i32(REACH);
    let column = index % TILE;
    let row = index / TILE % (TILE / 4u) * 4u;
    let first_block = index / (TILE * TILE / 4u) * THREAD_BLOCKS;
    SUMS
    for (var block = 0u; block < IN_BLOCKS; block++) {
        workgroupBarrier();
        for (var k = index; k < SIDE * SIDE; k += THREADS) {
            pixels[k] = seen(block, corner + vec2<i32>(vec2<u32>(k % SIDE, k / SIDE)));
        }
        let first_matrix = (tile.z * IN_BLOCKS + block) * TAPS * GROUP_BLOCKS;
        for (var k = index; k < TAPS * GROUP_BLOCKS; k += THREADS) {
            matrices[k] = weights[first_matrix + k];
        }
        workgroupBarrier();
        PARTIAL_SUMS
        for (var dx = 0u; dx < KERNEL; dx++) {
            let at = row * SIDE + column + dx * DILATION;
            let matrix_at = dx * GROUP_BLOCKS + first_block;
            PRODUCTS
        }
        ADD_PARTIAL_SUMS
    }
    let x = tile.x * TILE + column;
    let first_y = tile.y * TILE + row;
    if x < WIDTH {
        STORE
    }
}
