// Cells: one per HR pixel, and a rim. A sample reaches COLUMNS columns and ROWS rows of pixels, and the first of these
// pixels is its cell.

// The cell of a sample that reaches no pixel.
const NOWHERE: u32 = 0xffffffffu;

// In a variance's sign: the sample belongs to the current frame.
const CURRENT: u32 = 0x80000000u;

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

// The number of sample `at`: column, row and age.
fn id_of(at: vec3<u32>) -> u32 {
    return (frame.past[at.z].slot * frame.padded.y + at.y) * frame.padded.x + at.x;
}
