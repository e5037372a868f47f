// Corners of exact blocks in the history: a block's first pixel, the column and, in the upper half, the row.

const BLOCK_PIXELS: u32 = BLOCK_SIDE * BLOCK_SIDE;
// Of no block: blocks begin at multiples of BLOCK_SIDE.
const NO_CORNER: u32 = 0xffffffffu;

// The first pixel of the block with `corner`, and 0 for no block.
fn block_at(corner: u32) -> vec3<u32> {
    return vec3(corner & 0xffffu, corner >> 16u, u32(corner != NO_CORNER));
}

// Where in its block the `index`-th pixel of whole blocks lies.
fn pixel_of(index: u32) -> vec2<u32> {
    return vec2(index, index / BLOCK_SIDE) % BLOCK_SIDE;
}
