// Cells: one per HR pixel, and a rim. A sample reaches COLUMNS columns and ROWS rows of pixels at most, and the first of
// these pixels is its cell. A sample of an exact block reaches fewer; see CORNERS in splat.rs.

// The cell of a sample that reaches no pixel.
const NOWHERE: u32 = 0xffffffffu;

// In a variance's sign: the sample belongs to the current frame.
const CURRENT: u32 = 0x80000000u;

// In a variance's lowest bit, which is too small to matter: the sample belongs to an exact block.
const OF_BLOCK: u32 = 1u;

fn cell_columns() -> u32 {
    return frame.size.x + COLUMNS - 1u;
}

fn cell_rows() -> u32 {
    return frame.size.y + ROWS - 1u;
}

fn cell_count() -> u32 {
    return cell_columns() * cell_rows();
}

// The place in order that invocation `at` makes; NOWHERE beyond the history's memory.
fn place_in_order(at: vec3<u32>) -> u32 {
    return select((at.z * frame.padded.y + at.y) * frame.padded.x + at.x, NOWHERE, any(at.xy >= frame.padded));
}

// Whether there is a sample `at`: column, row and entry of `frame.past`.
fn is_sample(at: vec3<u32>) -> bool {
    let within = at.y * frame.padded.x + at.x;
    return all(at.xy < frame.past[at.z].extent) && within < frame.past[at.z].count;
}

// The number of sample `at`.
fn id_of(at: vec3<u32>) -> u32 {
    return frame.past[at.z].first + at.y * frame.padded.x + at.x;
}
