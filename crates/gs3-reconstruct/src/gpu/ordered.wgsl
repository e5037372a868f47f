// Samples in the order of their cells, as kernels read them; see order.wgsl.

@group(0) @binding(2) var<storage, read> cell_ends: array<u32>;
@group(0) @binding(3) var<storage, read> ordered_places: array<vec2<f32>>;
@group(0) @binding(4) var<storage, read> ordered_a: array<vec2<u32>>;
@group(0) @binding(5) var<storage, read> ordered_b: array<vec2<u32>>;
@group(0) @binding(6) var<storage, read> ordered_c: array<vec2<u32>>;

// The samples of `columns` cells in a row, from `cell` on: the first, and the one after the last.
fn run_of(cell: vec2<i32>, columns: i32) -> vec2<u32> {
    let first = max(cell.x, 0);
    let end = min(cell.x + columns, i32(cell_columns()));
    if first >= end || cell.y < 0 || cell.y >= i32(cell_rows()) {
        return vec2(0u);
    }
    let row = u32(cell.y) * cell_columns();
    var begin = 0u;
    if row + u32(first) > 0u {
        begin = cell_ends[row + u32(first) - 1u];
    }
    return vec2(begin, cell_ends[row + u32(end) - 1u]);
}
