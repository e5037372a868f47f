// A convolution as products of matrices in hardware: SIDE pixels of a row × SIDE input channels, times weights of SIDE
// input × SIDE output channels. For each SIDE input channels the workgroup stages its tile with its margin; a
// subgroup keeps RUNS such rows of pixels × COLUMNS matrices of output channels in registers. Lines in capitals are
// written out by conv_matrix.rs.
//
// wgpu 30 declares Vulkan's memory model for modules with matrices, but not which accesses other invocations see
// (gfx-rs/wgpu #8805): by the letter its barriers do not order workgroup memory here. Drivers have ordered it all
// along; MatrixUnit::check looks.

const EDGE: u32 = TILE + 2u * REACH;
const QUADS: u32 = SIDE / 4u;
const MATRIX: u32 = SIDE * SIDE;

// `[pixel][channel]`.
var<workgroup> pixels: array<f16, EDGE * EDGE * SIDE>;
// Of each subgroup one matrix, `[pixel][channel]`, on its way out.
var<workgroup> sums: array<f32, SUBGROUPS * MATRIX>;

// Where in the tile a run of pixels begins.
fn run_at(run: u32) -> vec2<u32> {
    return vec2<u32>(run % (TILE / SIDE) * SIDE, run / (TILE / SIDE));
}

@compute @workgroup_size(THREADS)
fn main(
    @builtin(workgroup_id) tile: vec3<u32>,
    @builtin(local_invocation_index) index: u32,
    @builtin(subgroup_id) subgroup: u32,
    @builtin(subgroup_invocation_id) lane: u32,
) {
    let corner = vec2<i32>(tile.xy * TILE) - i32(REACH);
    let first_run = subgroup * RUNS;
    SUMS
    for (var block = 0u; block < IN_BLOCKS; block += QUADS) {
        workgroupBarrier();
        for (var k = index; k < EDGE * EDGE * QUADS; k += THREADS) {
            let quad = k / (EDGE * EDGE);
            let pixel = k % (EDGE * EDGE);
            var value = Block(0.0);
            if block + quad < IN_BLOCKS {
                value = seen(block + quad, corner + vec2<i32>(vec2<u32>(pixel % EDGE, pixel / EDGE)));
            }
            let at = pixel * SIDE + quad * 4u;
            pixels[at] = value.x;
            pixels[at + 1u] = value.y;
            pixels[at + 2u] = value.z;
            pixels[at + 3u] = value.w;
        }
        workgroupBarrier();
        let first_matrix = (tile.z * IN_MATRICES + block / QUADS) * TAPS * COLUMNS;
        for (var tap = 0u; tap < TAPS; tap++) {
            let step = vec2<u32>(tap % KERNEL, tap / KERNEL) * DILATION;
            let matrix_at = (first_matrix + tap * COLUMNS) * MATRIX;
            PRODUCTS
        }
    }
    STORE
}

// Writes the matrix of a subgroup: `run` of the tile, output channels from `first_block` on.
fn store(subgroup: u32, lane: u32, tile: vec2<u32>, run: u32, first_block: u32) {
    let corner = tile * TILE + run_at(run);
    for (var k = lane; k < SIDE * QUADS; k += SUBGROUP) {
        let x = corner.x + k % SIDE;
        let block = first_block + k / SIDE;
        if x < WIDTH && corner.y < HEIGHT && block < BLOCKS {
            let at = subgroup * MATRIX + k % SIDE * SIDE + k / SIDE * 4u;
            let sum = vec4<f32>(sums[at], sums[at + 1u], sums[at + 2u], sums[at + 3u]);
            let bias_at = FIRST_BIAS + block * 4u;
            let bias = vec4<f16>(weights[bias_at], weights[bias_at + 1u], weights[bias_at + 2u], weights[bias_at + 3u]);
            result[block * PIXELS + corner.y * WIDTH + x] = Block(finish(block, x, corner.y, sum + vec4<f32>(bias)));
        }
    }
}
