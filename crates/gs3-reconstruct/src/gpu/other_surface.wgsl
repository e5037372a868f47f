// Another surface for patches beside a silhouette; see other_surface.rs. One invocation per four pixels in a row, a row of a
// patch; the rows of a patch decide together.

// Squared differences between the neighbours' colours in the doubtful pixels of a row: at their own depths, at the farthest
// and at the nearest surface around the patch.
var<workgroup> row_apart: array<f32, PATCHES * LINES>;
var<workgroup> row_apart_at_surfaces: array<vec2<f32>, PATCHES * LINES>;

// Four pixels in both neighbours.
struct Both {
    colors: array<array<vec4<f32>, 4>, 2>,
    visibility: array<vec2<f32>, 4>,
}

// 1 for doubtful pixels, else 0: pixels inside both neighbours that a neighbour may not show. Where one neighbour shows a
// pixel and the other one hides the pixel, colours differ without a doubt.
fn doubtful(visibility: vec2<f32>) -> f32 {
    let least = min(visibility.x, visibility.y);
    let is_occluded = least <= UNSEEN && max(visibility.x, visibility.y) >= 1.0;
    return select(0.0, 1.0, least >= UNSEEN && least < 1.0 && !is_occluded);
}

fn squared_difference(a: vec4<f32>, b: vec4<f32>) -> f32 {
    let difference = b.xyz - a.xyz;
    return dot(difference, difference);
}

// Four pixels of a patch from `corner` on, the first at `first`, as if the patch had inverse depth `depth` and faced the
// camera. They have visibility 0 if the patch is not all inside both neighbours.
fn facing(corner: vec2<i32>, first: vec2<i32>, depth: f32) -> Both {
    var both: Both;
    var seen: vec2<f32>;
    let size = vec2<i32>(in_between.size);
    for (var n = 0u; n < 2u; n++) {
        let there = seen_in(n, vec2<f32>(corner) + PATCH_MIDDLE, depth);
        let position = units(vec4(there.moved, there.moved), first).xy;
        let pixel = vec2(position.x >> PHASE_BITS, position.y >> PHASE_BITS) - (first - corner) - BEFORE;
        if there.visibility < UNSEEN || any(pixel < vec2(0)) || any(pixel + 3 + i32(TAPS) > size) {
            return Both();
        }
        both.colors[n] = gather_row(n, position, 4u);
        seen[n] = there.visibility;
    }
    both.visibility = array(seen, seen, seen, seen);
    return both;
}

// The four pixels of this invocation at the surface at which the neighbours agree best in the patch, if they agree much better
// there. All invocations of a workgroup call this function.
fn settled(both: Both, quad: Quad, corner: vec2<i32>, line: u32, lane: u32) -> Both {
    var own = both;
    let first = corner + vec2(0, i32(line));
    var pixels: array<f32, 4>;
    var apart = 0.0;
    for (var k = 0; k < 4; k++) {
        pixels[k] = select(0.0, doubtful(own.visibility[k]), quad.may_settle);
        apart = fma(squared_difference(own.colors[0][k], own.colors[1][k]), pixels[k], apart);
    }
    let top = lane - line * PATCHES;
    row_apart[lane] = apart;
    workgroupBarrier();
    apart = row_apart[top] + row_apart[top + PATCHES] + row_apart[top + 2u * PATCHES] + row_apart[top + 3u * PATCHES];
    let surfaces = quad.surfaces;
    let limit = LESS * apart - DISAGREE;
    let is_doubtful = quad.may_settle && limit > 0.0 && surfaces.y - surfaces.x > 2.0 * SAME_SURFACE * surfaces.y;
    var far: Both;
    var near: Both;
    row_apart_at_surfaces[lane] = vec2(0.0);
    if is_doubtful {
        far = facing(corner, first, surfaces.x);
        near = facing(corner, first, surfaces.y);
        for (var k = 0; k < 4; k++) {
            let of_far = squared_difference(far.colors[0][k], far.colors[1][k]);
            let of_near = squared_difference(near.colors[0][k], near.colors[1][k]);
            row_apart_at_surfaces[lane] += vec2(of_far, of_near) * pixels[k];
        }
    }
    workgroupBarrier();
    if !is_doubtful {
        return own;
    }
    var at_surfaces = row_apart_at_surfaces[top];
    for (var k = 1u; k < 4u; k++) {
        at_surfaces += row_apart_at_surfaces[top + k * PATCHES];
    }
    let is_there = vec2(far.visibility[0].x, near.visibility[0].x) > vec2(0.0);
    at_surfaces = select(vec2(MAX_FINITE), at_surfaces, is_there);
    // Where both are nearly as good, rounding does not choose.
    let margin = select(0.0, 0.5 * DISAGREE, at_surfaces.x < limit);
    let is_near = at_surfaces.y + margin < min(at_surfaces.x, limit);
    // Gradually, so that machines that round to different sides of the limit make nearly the same frames.
    let gain = clamp((limit - select(at_surfaces.x, at_surfaces.y, is_near)) / DISAGREE, 0.0, 1.0);
    for (var k = 0; k < 4; k++) {
        let by = pixels[k] * gain;
        for (var n = 0; n < 2; n++) {
            let there = select(far.colors[n][k], near.colors[n][k], is_near);
            own.colors[n][k] = fma(there - own.colors[n][k], vec4(by), own.colors[n][k]);
        }
        let there = select(far.visibility[k], near.visibility[k], is_near);
        own.visibility[k] = fma(there - own.visibility[k], vec2(by), own.visibility[k]);
    }
    return own;
}

// The four pixels of invocation `at` in both neighbours, `lane` its number in the workgroup. Neighbours that no pixel needs are
// gathered only where `needs_all`. All invocations of a workgroup call this function.
fn both_at(at: vec3<u32>, lane: u32, needs_all: bool) -> Both {
    let line = at.y % 4u;
    let quad = quad_at(patch_corner(at), line, lane);
    var both: Both;
    both.visibility = quad.visibility;
    if !is_outside(first_pixel(at)) {
        var least = 1.0;
        var most = 0.0;
        var needs_both = needs_all;
        for (var k = 0; k < 4; k++) {
            let share = share_of(both.visibility[k]);
            least = min(least, share);
            most = max(most, share);
            needs_both = needs_both || (quad.may_settle && doubtful(both.visibility[k]) > 0.0);
        }
        if needs_both || least < 1.0 {
            both.colors[0] = gather_quad(0u, quad.positions, quad.alike.x);
        }
        if needs_both || most > 0.0 {
            both.colors[1] = gather_quad(1u, quad.positions, quad.alike.y);
        }
    }
    return settled(both, quad, patch_corner(at), line, lane);
}
