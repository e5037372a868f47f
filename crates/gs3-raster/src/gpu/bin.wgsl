// Splats to tiles; see bin.rs. Splats come front to back. `count` counts the tiles of the band that each splat
// covers. A scan turns the counts into places. `emit` writes one entry (tile, splat) per tile, and a stable sort by
// tile gives every tile its splats front to back.

override CULLING: u32 = 3u;

// Splats that cover more tiles of the band are written by the whole workgroup: otherwise one lane would delay the
// others.
const ALONE: u32 = 64u;

// Splats, as many in each array as `order` has room for; see splat.wgsl.
@group(0) @binding(1) var<storage, read> splats: array<vec4<u32>>;
// Splats front to back.
@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read_write> counters: Counters;
@group(0) @binding(4) var<uniform> band: Band;
// Tile counts of the splats in order. A scan makes them first places; the entry after the last splat becomes the sum.
@group(0) @binding(5) var<storage, read_write> tile_counts: array<u32>;
@group(0) @binding(6) var<storage, read_write> entry_tiles: array<u32>;
@group(0) @binding(7) var<storage, read_write> entry_splats: array<u32>;

// A splat's tiles, its last ones inclusive, rows cut to the band's.
struct Tiles {
    first: vec2<u32>,
    last: vec2<u32>,
    // Whether rows have spans of their own.
    is_cut: bool,
}

fn tiles_of(b: vec4<u32>) -> Tiles {
    let rect = rect_of(b);
    if any(rect.zw <= rect.xy) {
        return Tiles(vec2(0u, 1u), vec2(0u), false);
    }
    let first = rect.xy / TILE;
    let last = (rect.zw - 1u) / TILE;
    // The box is tight: a support in a single row or column of tiles reaches every tile of the box.
    let is_cut = (CULLING == ACCU_TILE || CULLING == EXACT) && all(first < last);
    let rows = vec2(max(first.y, band.first_row), min(last.y, band.first_row + band.rows - 1u));
    if rows.y < rows.x {
        return Tiles(vec2(0u, 1u), vec2(0u), false);
    }
    return Tiles(vec2(first.x, rows.x), vec2(last.x, rows.y), is_cut);
}

// The first tile of a row that the splat is assigned to, and the tile after the last.
fn row_span(tiles: Tiles, splat: u32, b: vec4<u32>, row: u32) -> vec2<u32> {
    var span = vec2(tiles.first.x, tiles.last.x + 1u);
    if !tiles.is_cut {
        return span;
    }
    let s = splat_of(bitcast<vec4<f32>>(splats[splat]), b);
    let top = f32(row * TILE) - view.cell_before.y;
    let bottom = f32(row * TILE + TILE - 1u) + view.cell_after.y;
    let limit = f32(TILE * (tiles.last.x + 1u));
    let reached = x_span(s, top, bottom) + vec2(-view.cell_after.x, view.cell_before.x);
    let x = clamp(reached, vec2(0.0), vec2(limit));
    span.x = max(span.x, u32(x.x) / TILE);
    span.y = min(span.y, u32(x.y) / TILE + 1u);
    if CULLING == EXACT {
        // The support's part of a row is connected: only the tiles at the ends may be missed.
        while span.x < span.y && !reaches_tile(s, span.x, top, bottom) {
            span.x++;
        }
        while span.x < span.y && !reaches_tile(s, span.y - 1u, top, bottom) {
            span.y--;
        }
    }
    return vec2(span.x, max(span.x, span.y));
}

fn reaches_tile(s: Splat, column: u32, top: f32, bottom: f32) -> bool {
    let left = f32(column * TILE) - view.cell_before.x;
    let right = f32(column * TILE + TILE - 1u) + view.cell_after.x;
    return reaches(s, vec2(left, top), vec2(right, bottom));
}

var<workgroup> group_count: atomic<u32>;

@compute @workgroup_size(GROUP)
fn count(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    if lane == 0u {
        atomicStore(&group_count, 0u);
    }
    workgroupBarrier();
    let i = group_index(workgroup) * GROUP + lane;
    if i < counters.splats {
        let splat = order[i];
        let b = splats[arrayLength(&order) + splat];
        let tiles = tiles_of(b);
        var count = 0u;
        for (var row = tiles.first.y; row <= tiles.last.y; row++) {
            let span = row_span(tiles, splat, b, row);
            count += span.y - span.x;
        }
        tile_counts[i] = count;
        atomicAdd(&group_count, count);
    } else if i == counters.splats {
        tile_counts[i] = 0u;
    }
    workgroupBarrier();
    // A group's sum is below 2^27: 256 splats on at most 516×516 tiles. The sum of everything may overflow 2^32, which the
    // scan would not notice; shares of 4,096 do not overflow.
    if lane == 0u {
        atomicAdd(&counters.entry_shares, atomicLoad(&group_count) / ENTRY_SHARE);
    }
}

var<workgroup> large_count: atomic<u32>;
var<workgroup> large_lanes: array<u32, GROUP>;
var<workgroup> large: u32;
// Inclusive sums of the tiles of rows, for alternating steps of the scan.
var<workgroup> sums: array<array<u32, GROUP>, 2>;

fn write_entry(place: u32, tile: u32, splat: u32) {
    if place < arrayLength(&entry_tiles) {
        entry_tiles[place] = tile;
        entry_splats[place] = splat;
    }
}

fn write_span(span: vec2<u32>, row: u32, splat: u32, place: u32, end: u32) {
    let line = (row - band.first_row) * band.columns;
    for (var k = 0u; k < span.y - span.x && place + k < end; k++) {
        write_entry(place + k, line + span.x + k, splat);
    }
}

@compute @workgroup_size(GROUP)
fn emit(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    if lane == 0u {
        atomicStore(&large_count, 0u);
    }
    workgroupBarrier();
    let first_splat = group_index(workgroup) * GROUP;
    let i = first_splat + lane;
    if i < counters.splats {
        let place = tile_counts[i];
        let end = tile_counts[i + 1u];
        if end - place > ALONE {
            large_lanes[atomicAdd(&large_count, 1u)] = lane;
        } else {
            emit_alone(order[i], place, end);
        }
    }
    workgroupBarrier();
    if lane == 0u {
        large = atomicLoad(&large_count);
    }
    let count = workgroupUniformLoad(&large);
    for (var k = 0u; k < count; k++) {
        // The order of the lanes' splats does not matter: places are fixed.
        let which = workgroupUniformLoad(&large_lanes[k]);
        emit_together(first_splat + which, lane);
    }
}

// `count` and `emit` call the same code, which compilers may round differently. Entries beyond the counted ones are
// tiles that only the slack reaches, and are dropped. Unused places go to a tile that is not drawn.
fn emit_alone(splat: u32, first: u32, end: u32) {
    let b = splats[arrayLength(&order) + splat];
    let tiles = tiles_of(b);
    var place = first;
    for (var row = tiles.first.y; row <= tiles.last.y; row++) {
        let span = row_span(tiles, splat, b, row);
        write_span(span, row, splat, place, end);
        place += span.y - span.x;
    }
    fill(place, end, splat);
}

fn fill(first: u32, end: u32, splat: u32) {
    for (var place = first; place < end; place++) {
        write_entry(place, band.columns * band.rows, splat);
    }
}

// One lane per row; a scan of the rows' counts gives the places.
fn emit_together(i: u32, lane: u32) {
    let splat = order[i];
    let b = splats[arrayLength(&order) + splat];
    let tiles = tiles_of(b);
    var place = tile_counts[i];
    let end = tile_counts[i + 1u];
    for (var first_row = tiles.first.y; first_row <= tiles.last.y; first_row += GROUP) {
        let row = first_row + lane;
        var span = vec2(0u);
        if row <= tiles.last.y {
            span = row_span(tiles, splat, b, row);
        }
        let count = span.y - span.x;
        sums[0][lane] = count;
        workgroupBarrier();
        var turn = 0u;
        for (var step = 1u; step < GROUP; step *= 2u) {
            var sum = sums[turn][lane];
            if lane >= step {
                sum += sums[turn][lane - step];
            }
            turn = 1u - turn;
            sums[turn][lane] = sum;
            workgroupBarrier();
        }
        write_span(span, row, splat, place + sums[turn][lane] - count, end);
        place += sums[turn][GROUP - 1u];
        workgroupBarrier();
    }
    if lane == 0u {
        fill(place, end, splat);
    }
}
