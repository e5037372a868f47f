// The expected errors of blocks of 4×4 pixels: sums of squared corrections for curvature; see tile.rs. Whole numbers of
// ERROR_UNITS, so that sums do not depend on the order in which workgroups add their parts.

@group(0) @binding(8) var<storage, read_write> block_errors: array<atomic<u32>>;

const BLOCKS_OF_TILE: u32 = BLOCKS_ALONG * BLOCKS_ALONG;

var<workgroup> tile_errors: array<atomic<u32>, BLOCKS_OF_TILE>;

fn begin_errors(lane: u32) {
    if lane < BLOCKS_OF_TILE {
        atomicStore(&tile_errors[lane], 0u);
    }
}

// The block of the tile's first wanted pixel.
fn first_block(corner: vec2<i32>) -> vec2<u32> {
    return vec2<u32>(corner + 1) / BLOCK_SIDE;
}

fn add_error(at: vec2<u32>, corner: vec2<i32>, correction: vec3<f32>) {
    let units = min(dot(correction, correction), LARGEST_ERROR) * ERROR_UNITS;
    let block = at / BLOCK_SIDE - first_block(corner);
    atomicAdd(&tile_errors[block.y * BLOCKS_ALONG + block.x], u32(units + 0.5));
}

fn write_errors(corner: vec2<i32>, lane: u32) {
    workgroupBarrier();
    if lane < BLOCKS_OF_TILE {
        let sum = atomicLoad(&tile_errors[lane]);
        let block = first_block(corner) + vec2(lane % BLOCKS_ALONG, lane / BLOCKS_ALONG);
        if sum > 0u {
            let columns = (frame.size.x + BLOCK_SIDE - 1u) / BLOCK_SIDE;
            atomicAdd(&block_errors[block.y * columns + block.x], sum);
        }
    }
}

fn add_past(k: u32, is_past: bool, weighed: vec4<f32>) {}

fn write_innovation(k: u32, at: vec2<u32>, tile_varies: bool) {}
