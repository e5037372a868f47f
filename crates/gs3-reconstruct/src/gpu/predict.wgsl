// The current picture's samples with the mixed derivative of the surface through them, and how well the samples
// predict each other. One invocation per sample. See estimate_mixed in hermite.rs, predict in rectification.rs.

@group(0) @binding(1) var<storage, read> color_alpha: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> dx_median: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> dy_expected: array<vec4<f32>>;
// Two vectors of halves for each sample: RGB, ∂x, ∂y, a flag for bare samples, ∂²RGB/∂x∂y per HR pixel² (hermite.wgsl).
@group(0) @binding(4) var<storage, read_write> surface: array<vec4<u32>>;
// Squared errors of predicting a sample from its neighbours.
@group(0) @binding(5) var<storage, read_write> errors: array<f32>;

// The value half-way between two samples two spacings apart, of the cubic through their values and slopes.
fn middle(a: vec3<f32>, b: vec3<f32>, da: vec3<f32>, db: vec3<f32>) -> vec3<f32> {
    return fma(a + b, vec3(0.5), (da - db) * 0.25);
}

@compute @workgroup_size(WORKGROUP_X, WORKGROUP_Y)
fn predict(@builtin(global_invocation_id) at: vec3<u32>) {
    if any(at.xy >= frame.lr) {
        return;
    }
    let width = frame.lr.x;
    let last = frame.lr - 1u;
    let i = at.y * width + at.x;
    let scale = f32(frame.scale);
    let color = color_alpha[i].xyz;

    // The neighbours; at the border, the sample itself.
    let left = at.y * width + max(at.x, 1u) - 1u;
    let right = at.y * width + min(at.x + 1u, last.x);
    let above = (max(at.y, 1u) - 1u) * width + at.x;
    let below = min(at.y + 1u, last.y) * width + at.x;
    // Neighbours are two spacings apart, one at the border. Derivatives are per HR pixel².
    let per_x = select(0.0, 0.5 / (f32(right - left) * scale * scale), right > left);
    let per_y = select(0.0, 0.5 / (f32((below - above) / width) * scale * scale), below > above);
    let cross = per_y * (dx_median[below].xyz - dx_median[above].xyz)
        + per_x * (dy_expected[right].xyz - dy_expected[left].xyz);
    let w = inverse_depth(dx_median[i].w);
    let per = 1.0 / scale;
    let packed = pack_sample(color, dx_median[i].xyz * per, dy_expected[i].xyz * per, w);
    surface[2u * i] = vec4(packed.red_green, packed.b, packed.c.x);
    surface[2u * i + 1u] = vec4(packed.c.y, halves(cross.x, cross.y), halves(cross.z, 0.0), 0u);

    var across = vec3(0.0);
    if at.x > 0u && at.x < last.x {
        let predicted = middle(
            color_alpha[left].xyz, color_alpha[right].xyz, dx_median[left].xyz, dx_median[right].xyz,
        );
        across = predicted - color;
    }
    // The column's three samples around this one; at an end, the nearest three. With fewer rows, the row's error is
    // used alone.
    let top = min(max(at.y, 1u) - 1u, max(frame.lr.y, 3u) - 3u);
    let bottom = min(top + 2u, last.y);
    let a = top * width + at.x;
    let b = bottom * width + at.x;
    let predicted = middle(color_alpha[a].xyz, color_alpha[b].xyz, dy_expected[a].xyz, dy_expected[b].xyz);
    let down = predicted - color_alpha[(top + (bottom - top) / 2u) * width + at.x].xyz;
    errors[i] = max(dot(across, across), dot(down, down));
}
