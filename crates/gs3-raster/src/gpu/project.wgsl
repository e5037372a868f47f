// Gaussians to splats: culling, EWA projection (Kerbl et al. 2023), rejection of splats that touch no sample (with exact
// blocks, no pixel's cell), colour; see project.rs. `mark` notes what is visible, one workgroup a chunk; once their places are
// known, `project_color` and `project_gbuffer` write the splats of a chunk, in scene order, with as many lanes as there are
// visible ones. Whatever the second evaluation rounds otherwise, a marked Gaussian has a place and fills it.

override CULLING: u32 = 3u;
override OPACITY_MODE: u32 = 0u;

const WORDS: u32 = CHUNK / 32u;

// Bit i of word k: whether Gaussian 32·k + i is visible.
@group(0) @binding(6) var<storage, read_write> marks: array<u32>;
// Visible Gaussians of each chunk; between the entry points a scan makes them first places.
@group(0) @binding(7) var<storage, read_write> places: array<u32>;
// Splats, as many in each array as `order` has room for; see splat.wgsl.
@group(0) @binding(8) var<storage, read_write> splats: array<vec4<u32>>;
// Depth as bits that sort as unsigned integers, and the splat's place.
@group(0) @binding(9) var<storage, read_write> depth_keys: array<u32>;
@group(0) @binding(10) var<storage, read_write> order: array<u32>;

struct Projection {
    is_visible: bool,
    direction: vec3<f32>,
    view_space: vec3<f32>,
    scales: vec3<f32>,
    axes: mat3x3<f32>,
    mean: vec2<f32>,
    // l11, l21, l22.
    factor: vec3<f32>,
    opacity: f32,
    support: f32,
    // First and last sample, x then y.
    low: vec2<f32>,
    high: vec2<f32>,
}

fn project(i: u32) -> Projection {
    var p: Projection;
    p.is_visible = false;
    let center = centers[i];
    p.direction = center.xyz - view.origin;
    // In view space: compilers that sum as they like would lose what is left in the origin.
    p.view_space = rotate(p.direction) - view.origin_rest;
    let z = p.view_space.z;
    if !(z > view.near) {
        return p;
    }
    let inv_z = 1.0 / z;
    let slope = p.view_space.xy * inv_z;
    if !all(abs(slope) < vec2(MAX_SLOPE)) {
        return p;
    }
    p.mean = fma(slope, view.focal, view.center);
    let limited = max(min(slope, view.jacobian_high), view.jacobian_low);
    // A bound of the extent from the largest scale alone, before the rest is read.
    let per_unit = view.focal * inv_z * center.w;
    // From here on nothing is NaN: compilers that take that for granted turn comparisons round.
    if any(per_unit * (vec2(1.0) + abs(limited)) >= vec2(MAX_DEVIATION)) {
        return p;
    }
    let bound = fma(per_unit * per_unit, fma(limited, limited, vec2(1.0)), vec2(view.dilation));
    let bound_extent = sqrt(bound * MAX_SQUARED_RADIUS) + 1.0;
    let last = vec2<f32>(view.size) - 1.0;
    if !(all(p.mean + bound_extent + view.cell_before >= vec2(0.0)) && all(p.mean - bound_extent - view.cell_after <= last)) {
        return p;
    }

    let shape = shape_of(i);
    p.scales = shape.scales;
    p.axes = rotation_columns(shape.rotation);
    // Rows of J·W, and the columns of M = J·W·R·S as rows over the axes.
    let factor = view.focal * inv_z;
    let row_x = (view.rotation[0].xyz - limited.x * view.rotation[2].xyz) * factor.x;
    let row_y = (view.rotation[1].xyz - limited.y * view.rotation[2].xyz) * factor.y;
    let mx = vec3(dot3(row_x, p.axes[0]), dot3(row_x, p.axes[1]), dot3(row_x, p.axes[2])) * shape.scales;
    let my = vec3(dot3(row_y, p.axes[0]), dot3(row_y, p.axes[1]), dot3(row_y, p.axes[2])) * shape.scales;
    let raw_xx = dot3(mx, mx);
    let raw_yy = dot3(my, my);
    let xy = dot3(mx, my);
    let xx = raw_xx + view.dilation;
    let yy = raw_yy + view.dilation;
    // det(M·Mᵀ) as the sum of its squared 2×2 minors (Cauchy–Binet): no cancellation for thin splats.
    let minors = vec3(mx.x * my.y - mx.y * my.x, mx.x * my.z - mx.z * my.x, mx.y * my.z - mx.z * my.y);
    let raw_det = dot3(minors, minors);
    let det = fma(view.dilation, raw_xx + raw_yy + view.dilation, raw_det);
    if !(det > 0.0 && det < MAX_FINITE) {
        return p;
    }

    p.opacity = shape.opacity;
    if OPACITY_MODE == ANTIALIASED {
        p.opacity *= sqrt(max(raw_det / det, MIN_COMPENSATION * MIN_COMPENSATION));
    }
    let reach = p.opacity * MIN_ALPHA_INVERSE;
    if !(reach >= 1.0) {
        return p;
    }
    p.support = log2(reach) + SUPPORT_MARGIN;

    // Rows and columns of samples, or of cells with a pixel, in the support's box.
    let squared_radius = p.support * TWO_LN_2;
    let variance = vec2(xx, yy);
    let extent = sqrt(squared_radius * variance) + EXTENT_MARGIN;
    p.low = max(ceil(p.mean - extent - view.cell_after), vec2(0.0));
    p.high = min(floor(p.mean + extent + view.cell_before), last);
    if !all(p.low <= p.high) {
        return p;
    }

    // Cholesky factor of the scaled inverse covariance.
    if yy * det < TINY {
        return p;
    }
    let root = HALF_LOG2_E_SQRT / sqrt(yy * det);
    p.factor = vec3(yy * root, -xy * root, HALF_LOG2_E_SQRT / sqrt(yy));
    if !(max(max(p.factor.x, p.factor.z), abs(p.factor.y)) < MAX_STEEPNESS) {
        return p;
    }

    // Where at most two by two samples are in the box, all of them may miss the ellipse. Cells of several pixels hardly do.
    if view.has_blocks == 0u && all(p.high - p.low <= vec2(1.0)) {
        let hit = reaches_sample(p, p.low) || reaches_sample(p, p.high)
            || reaches_sample(p, vec2(p.high.x, p.low.y)) || reaches_sample(p, vec2(p.low.x, p.high.y));
        if !hit {
            return p;
        }
    }

    if CULLING <= ADR {
        var radius: vec2<f32>;
        if CULLING == AABB_3_SIGMA {
            let half = (raw_xx + raw_yy) * 0.5 + view.dilation;
            let spread = (raw_xx - raw_yy) * 0.5;
            radius = vec2(ceil(sqrt(half + sqrt(fma(spread, spread, xy * xy))) * PUBLISHED_SIGMAS));
        } else {
            let squared = (p.support - SUPPORT_MARGIN) * TWO_LN_2;
            radius = min(sqrt(variance) * PUBLISHED_SIGMAS, ceil(sqrt(squared * variance)));
        }
        // First and last pixel of the tiles that mean ± radius touches by the published rule.
        p.low = max(p.low, floor((p.mean - radius) / PUBLISHED_TILE) * PUBLISHED_TILE);
        p.high = min(p.high, floor((p.mean + radius + (PUBLISHED_TILE - 1.0)) / PUBLISHED_TILE) * PUBLISHED_TILE - 1.0);
        if !all(p.low <= p.high) {
            return p;
        }
    }
    p.is_visible = true;
    return p;
}

fn reaches_sample(p: Projection, sample: vec2<f32>) -> bool {
    let d = p.mean - sample;
    let u = fma(p.factor.x, d.x, p.factor.y * d.y);
    let v = p.factor.z * d.y;
    return fma(u, u, v * v) <= p.support;
}

// Columns of the rotation matrix of the unit quaternion (w, x, y, z): the principal axes in world space.
fn rotation_columns(q: vec4<f32>) -> mat3x3<f32> {
    let w = q.x;
    let v = q.yzw;
    let v2 = v + v;
    let squares = v * v2;
    let xy = v.x * v2.y;
    let xz = v.x * v2.z;
    let yz = v.y * v2.z;
    let turns = w * v2;
    return mat3x3(
        vec3(1.0 - squares.y - squares.z, xy + turns.z, xz - turns.y),
        vec3(xy - turns.z, 1.0 - squares.x - squares.z, yz + turns.x),
        vec3(xz + turns.y, yz - turns.x, 1.0 - squares.x - squares.y),
    );
}

var<workgroup> words: array<atomic<u32>, WORDS>;

@compute @workgroup_size(CHUNK)
fn mark(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let chunk = group_index(workgroup);
    if chunk >= page.chunks {
        return;
    }
    if lane < WORDS {
        atomicStore(&words[lane], 0u);
    }
    workgroupBarrier();
    let i = chunk * CHUNK + lane;
    if i < page.gaussians && may_see(chunks[chunk]) {
        if project(i).is_visible {
            atomicOr(&words[lane / 32u], 1u << (lane % 32u));
        }
    }
    workgroupBarrier();
    let place = page.first_chunk + chunk;
    if lane < WORDS {
        marks[place * WORDS + lane] = atomicLoad(&words[lane]);
    }
    if lane == 0u {
        var count = 0u;
        for (var k = 0u; k < WORDS; k++) {
            count += countOneBits(atomicLoad(&words[k]));
        }
        places[place] = count;
    }
}

var<workgroup> visible: array<u32, CHUNK>;

const NONE: u32 = 0xffffffffu;

struct Place {
    // Of the splat, or NONE.
    splat: u32,
    // In the page.
    gaussian: u32,
}

// The visible Gaussian of this lane: the first lanes take the visible ones in scene order.
fn place_of(workgroup: vec3<u32>, lane: u32) -> Place {
    let chunk = group_index(workgroup);
    if chunk >= page.chunks {
        return Place(NONE, 0u);
    }
    let place = page.first_chunk + chunk;
    var count = 0u;
    for (var k = 0u; k < WORDS; k++) {
        count += countOneBits(marks[place * WORDS + k]);
    }
    let bits = marks[place * WORDS + lane / 32u];
    if ((bits >> (lane % 32u)) & 1u) == 1u {
        var rank = countOneBits(bits & ((1u << (lane % 32u)) - 1u));
        for (var k = 0u; k < lane / 32u; k++) {
            rank += countOneBits(marks[place * WORDS + k]);
        }
        visible[rank] = lane;
    }
    workgroupBarrier();
    // Without room for it the splat is left out, and the caller told; see frame.wgsl.
    let first = places[place];
    if lane >= count || first + lane >= arrayLength(&order) {
        return Place(NONE, 0u);
    }
    return Place(first + lane, chunk * CHUNK + visible[lane]);
}

fn write_splat(place: Place, p: Projection) {
    // The low end of a rectangle is below its high end, but for Gaussians that only `mark` saw: those cover nothing.
    var x = 0u;
    var y = 0u;
    if p.is_visible {
        x = u32(p.low.x) | (u32(p.high.x + 1.0) << 16u);
        y = u32(p.low.y) | (u32(p.high.y + 1.0) << 16u);
    }
    let color = color_of(place.gaussian, p.direction);
    let room = arrayLength(&order);
    splats[place.splat] = bitcast<vec4<u32>>(vec4(p.mean, p.factor.xy));
    splats[room + place.splat] = vec4(bitcast<u32>(p.factor.z), bitcast<u32>(p.support), x, y);
    splats[2u * room + place.splat] = bitcast<vec4<u32>>(vec4(color, p.opacity));
    depth_keys[place.splat] = bitcast<u32>(p.view_space.z);
    order[place.splat] = place.splat;
}

@compute @workgroup_size(CHUNK)
fn project_color(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let place = place_of(workgroup, lane);
    if place.splat != NONE {
        write_splat(place, project(place.gaussian));
    }
}

@compute @workgroup_size(CHUNK)
fn project_gbuffer(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let place = place_of(workgroup, lane);
    if place.splat == NONE {
        return;
    }
    let p = project(place.gaussian);
    write_splat(place, p);
    let g = geometry_of(p.view_space, p.axes, p.scales);
    let room = arrayLength(&order);
    splats[3u * room + place.splat] = bitcast<vec4<u32>>(vec4(g.ray_distance, g.ray_plane, g.normal.x));
    splats[4u * room + place.splat] = bitcast<vec4<u32>>(vec4(g.normal.yz, 0.0, 0.0));
}
