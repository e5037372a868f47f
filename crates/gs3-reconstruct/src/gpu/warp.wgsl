// The in-between frame, gathered from both neighbours; see warp.rs. One invocation per four pixels in a row, a row of
// a 4×4 patch. Each invocation examines one corner of the patch for all four. If the corners move alike, the patch is
// gathered with one displacement; if they have the same visibility, with one weight.

@group(0) @binding(3) var<storage, read> middle: array<f32>;
@group(0) @binding(4) var<storage, read> ranges: array<vec2<f32>>;
@group(0) @binding(5) var<storage, read_write> result: array<vec2<u32>>;

// A workgroup makes PATCHES patches in a row, and LINES rows of pixels.

// The places of a patch's pixels in both neighbours, and their visibility there.
struct Correspondence {
    // Displacements in the first neighbour, then in the second.
    moved: vec4<f32>,
    visibility: vec2<f32>,
}

var<workgroup> corner_moved: array<vec4<f32>, PATCHES * LINES>;
var<workgroup> corner_visibility: array<vec2<f32>, PATCHES * LINES>;

// The place of HR column (or row) `x` among `len` samples: the samples around it, and the fraction of the way.
struct Place {
    samples: vec2<u32>,
    fraction: f32,
}

fn place_of(x: i32, len: u32) -> Place {
    let scale = in_between.scale;
    let inside = u32(clamp(x, 0, i32(len * scale) - 1)) + scale - scale / 2u;
    // Cell c lies between samples c − 1 and c.
    let cell = inside / scale;
    let fraction = (f32(inside % scale) + 0.5 + f32(scale / 2u)) / f32(scale) - 0.5;
    return Place(min(vec2(max(cell, 1u) - 1u, cell), vec2(len - 1u)), fraction);
}

// The inverse depth at an HR pixel: linear within a surface, the nearest sample's at an edge.
fn middle_at(at: vec2<i32>) -> f32 {
    let column = place_of(at.x, in_between.lr.x);
    let row = place_of(at.y, in_between.lr.y);
    let rows = row.samples * in_between.lr.x;
    let a = middle[rows.x + column.samples.x];
    let b = middle[rows.x + column.samples.y];
    let c = middle[rows.y + column.samples.x];
    let d = middle[rows.y + column.samples.y];
    let far = min(min(a, b), min(c, d));
    let near = max(max(a, b), max(c, d));
    if near - far <= near * SAME_SURFACE {
        let left = fma(c - a, row.fraction, a);
        let right = fma(d - b, row.fraction, b);
        return fma(right - left, column.fraction, left);
    }
    let left = select(c, a, row.fraction < 0.5);
    let right = select(d, b, row.fraction < 0.5);
    return select(right, left, column.fraction < 0.5);
}

// Displacement of pixel `at` with inverse depth `depth` in neighbour `n`, and its visibility there: next to nothing
// outside.
fn correspondence_in(n: u32, at: vec2<f32>, depth: f32) -> vec3<f32> {
    let neighbor = in_between.neighbors[n];
    // Pixel centres of cameras are at halves.
    let seen = reproject(neighbor.from_middle, at + 0.5, depth);
    let to = seen.xy - 0.5;
    let size = vec2<f32>(in_between.size);
    let w = depth * seen.w;
    if !(seen.z > MIN_DIVISOR && all(to >= vec2(-0.5)) && all(to <= size - 0.5) && w >= 0.0) {
        return vec3(to - at, UNSEEN * UNSEEN);
    }
    let scale = f32(in_between.scale);
    let place = fma(to, vec2(1.0 / scale), vec2(0.5 / scale - 0.5) - neighbor.jitter);
    let cell = vec2<u32>(clamp(place, vec2(0.0), vec2<f32>(in_between.lr - 1u)));
    let range = ranges[n * in_between.lr.x * in_between.lr.y + cell.y * in_between.lr.x + cell.x];
    let one_surface = range.y - range.x <= range.y * ONE_SURFACE;
    let is_seen = w >= range.x && w <= range.y;
    return vec3(to - at, select(UNSEEN, select(SILHOUETTE, 1.0, one_surface), is_seen));
}

fn correspondence(at: vec2<i32>) -> Correspondence {
    let depth = middle_at(at);
    let first = correspondence_in(0u, vec2<f32>(at), depth);
    let second = correspondence_in(1u, vec2<f32>(at), depth);
    return Correspondence(vec4(first.xy, second.xy), vec2(first.z, second.z));
}

// The second neighbour's share by time and visibility.
fn share_of(visibility: vec2<f32>) -> f32 {
    let before = visibility.x * (1.0 - in_between.t);
    let after = visibility.y * in_between.t;
    let share = after / (before + after);
    return select(select(share, 0.0, share < NEGLIGIBLE), 1.0, share > 1.0 - NEGLIGIBLE);
}

// Fixed-point positions of pixel `at` moved by `moved`. Whole pixels are added as integers, so that pixels with the
// same motion stay whole pixels apart.
fn units(moved: vec4<f32>, at: vec2<i32>) -> vec4<i32> {
    return vec4<i32>(floor(fma(moved, vec4(f32(UNITS)), vec4(0.5)))) + at.xyxy * UNITS;
}

// The four pixels' visibility and positions in each neighbour.
struct Quad {
    share: array<f32, 4>,
    visibility: array<vec2<f32>, 4>,
    positions: array<vec4<i32>, 4>,
    // Whether the four pixels move alike in the first and in the second neighbour.
    alike: vec2<bool>,
}

fn quad_at(patch_corner: vec2<i32>, line: u32, lane: u32) -> Quad {
    // The corner that this invocation examines for its patch.
    let own_corner = vec2(i32(line % 2u), i32(line / 2u)) * 3;
    let corner = correspondence(patch_corner + own_corner);
    corner_moved[lane] = corner.moved;
    corner_visibility[lane] = corner.visibility;
    workgroupBarrier();
    let top = lane - line * PATCHES;
    var least = corner_moved[top];
    var most = least;
    let visibility = corner_visibility[top];
    var is_even = true;
    for (var k = 1u; k < 4u; k++) {
        least = min(least, corner_moved[top + k * PATCHES]);
        most = max(most, corner_moved[top + k * PATCHES]);
        is_even = is_even && all(corner_visibility[top + k * PATCHES] == visibility);
    }
    let is_whole = all(patch_corner >= vec2(0)) && all(patch_corner + 4 <= vec2<i32>(in_between.size));
    // At scale 1, pixels between the corners have samples of their own.
    let is_rigid = is_whole && in_between.scale > 1u && all(most - least <= vec4(RIGID));

    var quad: Quad;
    let first = patch_corner + vec2(0, i32(line));
    if is_rigid && is_even {
        quad.alike = vec2(true);
        let share = share_of(visibility);
        for (var k = 0; k < 4; k++) {
            quad.positions[k] = units((least + most) * 0.5, first + vec2(k, 0));
            quad.share[k] = share;
            quad.visibility[k] = visibility;
        }
        return quad;
    }
    var moved: array<vec4<f32>, 4>;
    var row_least = vec4(MAX_FINITE);
    var row_most = vec4(-MAX_FINITE);
    for (var k = 0; k < 4; k++) {
        let seen = correspondence(first + vec2(k, 0));
        moved[k] = seen.moved;
        quad.share[k] = share_of(seen.visibility);
        quad.visibility[k] = seen.visibility;
        row_least = min(row_least, seen.moved);
        row_most = max(row_most, seen.moved);
    }
    let is_near = row_most - row_least <= vec4(RIGID);
    quad.alike = vec2(is_rigid) | vec2(all(is_near.xy), all(is_near.zw));
    let shared_move = select((row_least + row_most) * 0.5, (least + most) * 0.5, is_rigid);
    for (var k = 0; k < 4; k++) {
        quad.positions[k] = units(select(moved[k], shared_move, quad.alike.xxyy), first + vec2(k, 0));
    }
    return quad;
}

// The four pixels of neighbour `n`.
fn gather_quad(n: u32, positions: array<vec4<i32>, 4>, alike: bool) -> array<vec4<f32>, 4> {
    var at = positions;
    if alike {
        return gather_row(n, select(at[0].xy, at[0].zw, n == 1u), 4u);
    }
    var row: array<vec4<f32>, 4>;
    for (var k = 0u; k < 4u; k++) {
        row[k] = gather_row(n, select(at[k].xy, at[k].zw, n == 1u), 1u)[0];
    }
    return row;
}

// The second neighbour's share with these uncertainties: the less uncertain neighbour counts more.
fn surer(share: f32, first: f32, second: f32) -> f32 {
    let weight = share * (max(first, 0.0) + UNSURE);
    return weight / (weight + (1.0 - share) * (max(second, 0.0) + UNSURE));
}

fn pack(color: vec4<f32>) -> vec2<u32> {
    let c = clamp(color, vec4(-LARGEST_HALF), vec4(LARGEST_HALF));
    return vec2(pack2x16float(c.xy), pack2x16float(c.zw));
}

// The first pixel of the patch with the row of invocation `at`.
fn patch_corner(at: vec3<u32>) -> vec2<i32> {
    let start = select(0, i32(in_between.offset) - 4, in_between.offset > 0u);
    return vec2<i32>(vec2(at.x * 4u, at.y - at.y % 4u)) + start;
}

// Whether four pixels in a row from `first` on are all beyond the image.
fn is_outside(first: vec2<i32>) -> bool {
    return any(first >= vec2<i32>(in_between.size)) || first.y < 0;
}

@compute @workgroup_size(PATCHES, LINES)
fn blend(
    @builtin(global_invocation_id) at: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let corner = patch_corner(at);
    let quad = quad_at(corner, at.y % 4u, lane);
    let first = corner + vec2(0, i32(at.y % 4u));
    if is_outside(first) {
        return;
    }
    var share = quad.share;
    let most = max(max(share[0], share[1]), max(share[2], share[3]));
    let least = min(min(share[0], share[1]), min(share[2], share[3]));
    var colors: array<vec4<f32>, 4>;
    if least < 1.0 {
        colors = gather_quad(0u, quad.positions, quad.alike.x);
    }
    if most > 0.0 {
        let row = gather_quad(1u, quad.positions, quad.alike.y);
        for (var k = 0u; k < 4u; k++) {
            let by = surer(share[k], colors[k].w, row[k].w);
            colors[k] = fma(row[k] - colors[k], vec4(by), colors[k]);
        }
    }
    for (var k = 0; k < 4; k++) {
        let x = first.x + k;
        if x >= 0 && x < i32(in_between.size.x) {
            result[u32(first.y) * in_between.size.x + u32(x)] = pack(colors[k]);
        }
    }
}
