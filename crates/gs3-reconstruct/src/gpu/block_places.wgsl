// Exact blocks in the history. The place of a block is its first pixel: the column, and the row in the upper half.

const BLOCK_PIXELS: u32 = BLOCK_SIDE * BLOCK_SIDE;
// Of no block: blocks begin at multiples of BLOCK_SIDE.
const NO_PLACE: u32 = 0xffffffffu;

// The first pixel of the block at `place`, and 0 for no block.
fn block_at(place: u32) -> vec3<u32> {
    return vec3(place & 0xffffu, place >> 16u, u32(place != NO_PLACE));
}

// Where in its block the `index`-th pixel of whole blocks lies.
fn pixel_of(index: u32) -> vec2<u32> {
    return vec2(index, index / BLOCK_SIDE) % BLOCK_SIDE;
}
