// The places of the in-between frame's pixels in both neighbours; see warp.rs. One invocation per four pixels in a row, a
// row of a 4×4 patch. Each invocation examines one corner of the patch for all four. If the corners move alike, the patch is
// gathered with one displacement; if they are also all shown or all hidden, with one weight.

@group(0) @binding(3) var<storage, read> middle: array<f32>;
@group(0) @binding(4) var<storage, read> ranges: array<vec2<f32>>;
@group(0) @binding(5) var<storage, read_write> result: array<vec2<u32>>;

// A workgroup makes PATCHES patches in a row, and LINES rows of pixels.

// The places of a pixel in both neighbours, and its visibility there.
struct Correspondence {
    // Displacements in the first neighbour, then in the second.
    moved: vec4<f32>,
    visibility: vec2<f32>,
    // Inverse depths of the farthest and of the nearest surface around the pixel and where it is in the neighbours.
    surfaces: vec2<f32>,
}

// The place of a pixel in one neighbour.
struct Seen {
    moved: vec2<f32>,
    visibility: f32,
    // Inverse depths, in the middle frame, of the farthest and of the nearest surface there.
    surfaces: vec2<f32>,
}

// A surface of the middle frame, and those around it.
struct Middle {
    depth: f32,
    surfaces: vec2<f32>,
}

var<workgroup> corner_moved: array<vec4<f32>, PATCHES * LINES>;
var<workgroup> corner_visibility: array<vec2<f32>, PATCHES * LINES>;
var<workgroup> corner_surfaces: array<vec2<f32>, PATCHES * LINES>;

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
fn middle_at(at: vec2<i32>) -> Middle {
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
        return Middle(fma(right - left, column.fraction, left), vec2(far, near));
    }
    let left = select(c, a, row.fraction < 0.5);
    let right = select(d, b, row.fraction < 0.5);
    return Middle(select(right, left, column.fraction < 0.5), vec2(far, near));
}

// The farthest and the nearest of two pairs of surfaces.
fn around(a: vec2<f32>, b: vec2<f32>) -> vec2<f32> {
    return vec2(min(a.x, b.x), max(a.y, b.y));
}

// The inverse depths, in the middle frame, of what pixel `at` shows and a neighbour has at inverse depths `w`; `row` is the
// last row to the neighbour. With w_n = w / (h + e w), w = w_n h / (1 − e w_n). What is behind the middle camera is no
// surface.
fn source_depths(row: vec4<f32>, at: vec2<f32>, w: vec2<f32>) -> vec2<f32> {
    let divisor = 1.0 - w * row.w;
    let found = w * fma(at.x, row.x, fma(at.y, row.y, row.z)) / divisor;
    return select(vec2(MAX_FINITE, 0.0), found, (divisor > vec2(MIN_DIVISOR)) & (found >= vec2(0.0)));
}

// Pixel `at` with inverse depth `depth` in neighbour `n`. Outside, its visibility is next to nothing, and there are no
// surfaces.
fn seen_in(n: u32, at: vec2<f32>, depth: f32) -> Seen {
    let neighbor = in_between.neighbors[n];
    // Pixel centres of cameras are at halves.
    let seen = reproject(neighbor.from_middle, at + 0.5, depth);
    let to = seen.xy - 0.5;
    let size = vec2<f32>(in_between.size);
    let w = depth * seen.w;
    if !(seen.z > MIN_DIVISOR && all(to >= vec2(-0.5)) && all(to <= size - 0.5) && w >= 0.0) {
        return Seen(to - at, UNSEEN * UNSEEN, vec2(MAX_FINITE, 0.0));
    }
    let scale = f32(in_between.scale);
    let place = fma(to, vec2(1.0 / scale), vec2(0.5 / scale - 0.5) - neighbor.jitter);
    let cell = vec2<u32>(clamp(place, vec2(0.0), vec2<f32>(in_between.lr - 1u)));
    let range = ranges[n * in_between.lr.x * in_between.lr.y + cell.y * in_between.lr.x + cell.x];
    let one_surface = range.y - range.x <= range.y * ONE_SURFACE;
    let is_seen = w >= range.x && w <= range.y;
    let visibility = select(UNSEEN, select(SILHOUETTE, 1.0, one_surface), is_seen);
    // Ranges are wider than their samples.
    let found = range / vec2(1.0 - SAME_SURFACE, 1.0 + SAME_SURFACE);
    return Seen(to - at, visibility, source_depths(neighbor.from_middle[2], at + 0.5, found));
}

fn correspondence(at: vec2<i32>) -> Correspondence {
    let middle = middle_at(at);
    let first = seen_in(0u, vec2<f32>(at), middle.depth);
    let second = seen_in(1u, vec2<f32>(at), middle.depth);
    let surfaces = around(middle.surfaces, around(first.surfaces, second.surfaces));
    return Correspondence(vec4(first.moved, second.moved), vec2(first.visibility, second.visibility), surfaces);
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

// The share of own displacements in those of pixels in each neighbour, by the range of the displacements: 0 up to RIGID, 1
// from LOOSE on.
fn looseness(range: vec4<f32>) -> vec2<f32> {
    let widest = max(range.xz, range.yw);
    let ramp = max((widest - RIGID) / (LOOSE - RIGID), vec2(0.0));
    // Ranges that are no numbers are not below the limit.
    return select(vec2(1.0), ramp, (range.xz < vec2(LOOSE)) & (range.yw < vec2(LOOSE)));
}

// The displacements of a pixel with these shares of its own ones.
fn toward(shared_ones: vec4<f32>, own: vec4<f32>, looseness: vec2<f32>) -> vec4<f32> {
    return select(fma(own - shared_ones, looseness.xxyy, shared_ones), own, looseness.xxyy == vec4(1.0));
}

// The four pixels' visibility and positions in each neighbour.
struct Quad {
    visibility: array<vec2<f32>, 4>,
    positions: array<vec4<i32>, 4>,
    // Whether the four pixels move alike in the first and in the second neighbour.
    alike: vec2<bool>,
    // Whether the patch may be of another surface: the patch is inside the image, and not both rigid and even.
    may_settle: bool,
    // Inverse depths of the farthest and of the nearest surface around the patch.
    surfaces: vec2<f32>,
}

fn quad_at(patch_corner: vec2<i32>, line: u32, lane: u32) -> Quad {
    // The corner that this invocation examines for its patch.
    let own_corner = vec2(i32(line % 2u), i32(line / 2u)) * 3;
    let corner = correspondence(patch_corner + own_corner);
    corner_moved[lane] = corner.moved;
    corner_visibility[lane] = corner.visibility;
    corner_surfaces[lane] = corner.surfaces;
    workgroupBarrier();
    let top = lane - line * PATCHES;
    var least = corner_moved[top];
    var most = least;
    let visibility = corner_visibility[top];
    var surfaces = corner_surfaces[top];
    // What both neighbours hide may be of another surface.
    var is_even = all((visibility == vec2(1.0)) | (visibility <= vec2(UNSEEN))) && max(visibility.x, visibility.y) != UNSEEN;
    for (var k = 1u; k < 4u; k++) {
        least = min(least, corner_moved[top + k * PATCHES]);
        most = max(most, corner_moved[top + k * PATCHES]);
        is_even = is_even && all(corner_visibility[top + k * PATCHES] == visibility);
        surfaces = around(surfaces, corner_surfaces[top + k * PATCHES]);
    }
    let is_whole = all(patch_corner >= vec2(0)) && all(patch_corner + 4 <= vec2<i32>(in_between.size));
    // At scale 1, pixels between the corners have samples of their own.
    let of_patch = select(vec2(1.0), looseness(most - least), in_between.scale > 1u);
    let is_rigid = is_whole && all(of_patch == vec2(0.0));

    var quad: Quad;
    quad.may_settle = is_whole && !(is_rigid && is_even);
    quad.surfaces = surfaces;
    let first = patch_corner + vec2(0, i32(line));
    if is_rigid && is_even {
        quad.alike = vec2(true);
        for (var k = 0; k < 4; k++) {
            quad.positions[k] = units((least + most) * 0.5, first + vec2(k, 0));
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
        quad.visibility[k] = seen.visibility;
        row_least = min(row_least, seen.moved);
        row_most = max(row_most, seen.moved);
    }
    let of_row = looseness(row_most - row_least);
    quad.alike = (of_row == vec2(0.0)) | (of_patch == vec2(0.0));
    for (var k = 0; k < 4; k++) {
        let of_pixel = toward((row_least + row_most) * 0.5, moved[k], of_row);
        quad.positions[k] = units(toward((least + most) * 0.5, of_pixel, of_patch), first + vec2(k, 0));
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

// The first pixel of invocation `at`.
fn first_pixel(at: vec3<u32>) -> vec2<i32> {
    return patch_corner(at) + vec2(0, i32(at.y % 4u));
}

// Whether four pixels in a row from `first` on are all beyond the image.
fn is_outside(first: vec2<i32>) -> bool {
    return any(first >= vec2<i32>(in_between.size)) || first.y < 0;
}
