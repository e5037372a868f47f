// Rectification of past samples by the current frame; see rectification.rs. One invocation per cell: cell (i, j) lies
// between samples i, i + 1 and j, j + 1.

@group(0) @binding(1) var<storage, read> color_alpha: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> dx_median: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> dy_expected: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> errors: array<f32>;
// Two vectors per cell. First: the middles of the ranges of plausible RGB, and the weight of a mismatch. Second: half
// the ranges' extents as three halves, the weight of drift, and the smallest inverse depth that is not hidden.
@group(0) @binding(5) var<storage, read_write> cells: array<vec4<u32>>;

@compute @workgroup_size(WORKGROUP_X, WORKGROUP_Y)
fn find_ranges(@builtin(global_invocation_id) at: vec3<u32>) {
    if any(at.xy >= frame.lr) {
        return;
    }
    let next = min(at.xy + 1u, frame.lr - 1u);
    var low = vec3(MAX_FINITE);
    var high = vec3(-MAX_FINITE);
    var far = MAX_FINITE;
    var error = 0.0;
    for (var k = 0u; k < 4u; k++) {
        let i = select(at.y, next.y, k >= 2u) * frame.lr.x + select(at.x, next.x, k % 2u == 1u);
        let color = color_alpha[i].xyz;
        let dx = dx_median[i];
        let spread = (abs(dx.xyz) + abs(dy_expected[i].xyz)) * EXTRAPOLATION;
        low = min(low, color - spread);
        high = max(high, color + spread);
        far = min(far, inverse_depth(dx.w));
        error = max(error, errors[i]);
    }
    let extent = high - low;
    let gain = MISMATCH / (dot(extent, extent) + EXTENT_FLOOR);
    let restless = DRIFT * DRIFT / (error + ERROR_FLOOR);
    let i = at.y * frame.lr.x + at.x;
    let extents = min(extent * 0.5, vec3(LARGEST_HALF));
    let packed = vec2(pack2x16float(extents.xy), pack2x16float(vec2(extents.z, 0.0)));
    cells[2u * i] = bitcast<vec4<u32>>(vec4((low + high) * 0.5, gain));
    cells[2u * i + 1u] = vec4(packed, bitcast<vec2<u32>>(vec2(restless, far * (1.0 - DEPTH_TOLERANCE))));
}
