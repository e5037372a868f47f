// Exact blocks: a workgroup makes up to GROUP_BLOCKS of the chosen blocks of 4×4 pixels whose samples lie in a tile, and an
// invocation a pixel. The z-th workgroup of a tile makes the z-th so many of its blocks. The pixels lie between the samples
// of the low-resolution frame, so positions are fractions of samples.

// The picture: RGB and 0 as four halves a pixel, row by row.
@group(0) @binding(6) var<storage, read_write> image: array<vec2<u32>>;
// For each block of the picture, row by row: its number among the chosen blocks, from 1 on, or 0 if it is not chosen.
@group(0) @binding(7) var<storage, read> chosen: array<u32>;

// Bits of the blocks of a tile, at the largest scale.
const WORDS_OF_TILE: u32 = (TILE * MAX_SCALE / BLOCK) * (TILE * MAX_SCALE / BLOCK) / 32u;
const NO_BLOCK: u32 = 0xffffffffu;

var<workgroup> chosen_bits: array<atomic<u32>, WORDS_OF_TILE>;
var<workgroup> chosen_count: u32;
// The numbers in the tile of the workgroup's blocks, NO_BLOCK after the last; and the positions of their first pixels.
var<workgroup> numbers: array<u32, GROUP_BLOCKS>;
var<workgroup> corners: array<vec2<f32>, GROUP_BLOCKS>;

// For outputs_blocks.wgsl: the place of the invocation's pixel among the samples, and its colour.
var<private> sample_place: u32;
var<private> color_made: vec3<f32>;

// Blocks along a side of a tile.
fn blocks_along() -> u32 {
    return TILE * view.scale / BLOCK;
}

// Column and row of the tile's first block; negative in a margin, which has whole blocks.
fn first_block(workgroup: vec3<u32>) -> vec2<i32> {
    return vec2<i32>(corner_of(workgroup) * view.scale / BLOCK) - vec2<i32>(view.margin * view.scale / BLOCK);
}

fn block_of(number: u32, workgroup: vec3<u32>) -> vec2<i32> {
    return first_block(workgroup) + vec2<i32>(vec2(number % blocks_along(), number / blocks_along()));
}

// The position in samples of pixel `at` of the picture.
fn sample_of(at: vec2<i32>) -> vec2<f32> {
    return (vec2<f32>(at) - view.first_sample) / f32(view.scale) + vec2<f32>(view.margin);
}

// Finds the workgroup's blocks. Returns the tile's splats; none if there are no blocks.
fn range_of(workgroup: vec3<u32>, lane: u32) -> vec2<u32> {
    if lane < WORDS_OF_TILE {
        atomicStore(&chosen_bits[lane], 0u);
    }
    workgroupBarrier();
    let side = blocks_along();
    let grid = vec2<i32>((view.picture + BLOCK - 1u) / BLOCK);
    for (var number = lane; number < side * side; number += PIXELS) {
        let at = block_of(number, workgroup);
        if all(at >= vec2(0)) && all(at < grid) && chosen[at.y * grid.x + at.x] != 0u {
            atomicOr(&chosen_bits[number / 32u], 1u << (number % 32u));
        }
    }
    workgroupBarrier();
    if lane < GROUP_BLOCKS {
        var before = workgroup.z * GROUP_BLOCKS + lane;
        var number = NO_BLOCK;
        for (var word = 0u; word < WORDS_OF_TILE && number == NO_BLOCK; word++) {
            var bits = atomicLoad(&chosen_bits[word]);
            let count = countOneBits(bits);
            if before < count {
                for (; before > 0u; before--) {
                    bits &= bits - 1u;
                }
                number = word * 32u + firstTrailingBit(bits);
            } else {
                before -= count;
            }
        }
        numbers[lane] = number;
        if number != NO_BLOCK {
            corners[lane] = sample_of(block_of(number, workgroup) * i32(BLOCK));
        }
        if lane == 0u {
            chosen_count = u32(number != NO_BLOCK);
        }
    }
    let is_any = workgroupUniformLoad(&chosen_count) != 0u;
    return select(vec2(0u), ranges[workgroup.y * band.columns + workgroup.x], is_any);
}

fn place_of(workgroup: vec3<u32>, lane: u32) -> Place {
    let number = numbers[lane / 16u];
    if number == NO_BLOCK {
        return Place(0u, vec2(0.0), false);
    }
    let block = block_of(number, workgroup);
    let row = (view.picture.x + BLOCK - 1u) / BLOCK;
    sample_place = (chosen[u32(block.y) * row + u32(block.x)] - 1u) * BLOCK * BLOCK + lane % 16u;
    let pixel = block * i32(BLOCK) + vec2<i32>(vec2(lane % BLOCK, lane % 16u / BLOCK));
    let is_inside = all(pixel < vec2<i32>(view.picture));
    return Place(u32(pixel.y) * view.picture.x + u32(pixel.x), sample_of(pixel), is_inside);
}

fn write_color(index: u32, color: vec3<f32>, alpha: f32) {
    let limited = clamp(color, vec3(-LARGEST_HALF), vec3(LARGEST_HALF));
    color_made = color;
    image[index] = vec2(pack2x16float(limited.xy), pack2x16float(vec2(limited.z, 0.0)));
}
