// The depths of the in-between frame without holes; see middle_depth.rs. One invocation per LR pixel.
//
// The CPU fills holes ring by ring from their rims inwards, with the farthest depth beside each hole. So a pixel that
// is k pixels (along the longer axis) from the nearest pixel with a depth gets the farthest depth at distance k. An
// invocation examines ever wider rings around its pixel until one has a depth.

@group(0) @binding(1) var<storage, read> splatted: array<u32>;
@group(0) @binding(2) var<storage, read_write> middle: array<f32>;

// A pixel without any depth within this many LR pixels is infinitely far. The limit bounds the work where almost
// nothing is in view.
const MOST_RINGS: i32 = 64;

// More than any inverse depth.
const NONE: f32 = MAX_FINITE;

// The inverse depth at (x, y), NONE where there is none.
fn splatted_at(x: i32, y: i32) -> f32 {
    if x < 0 || x >= i32(in_between.lr.x) {
        return NONE;
    }
    let bits = splatted[u32(y) * in_between.lr.x + u32(x)];
    return select(NONE, bitcast<f32>(bits - 1u), bits > 0u);
}

@compute @workgroup_size(WORKGROUP_X, WORKGROUP_Y)
fn fill(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id.xy >= in_between.lr) {
        return;
    }
    let at = vec2<i32>(id.xy);
    let size = vec2<i32>(in_between.lr);
    var far = splatted_at(at.x, at.y);
    for (var ring = 1; far == NONE && ring <= MOST_RINGS; ring++) {
        for (var y = max(at.y - ring, 0); y <= min(at.y + ring, size.y - 1); y++) {
            if abs(y - at.y) < ring {
                far = min(far, min(splatted_at(at.x - ring, y), splatted_at(at.x + ring, y)));
                continue;
            }
            for (var x = max(at.x - ring, 0); x <= min(at.x + ring, size.x - 1); x++) {
                far = min(far, splatted_at(x, y));
            }
        }
    }
    middle[id.y * in_between.lr.x + id.x] = select(far, 0.0, far == NONE);
}
