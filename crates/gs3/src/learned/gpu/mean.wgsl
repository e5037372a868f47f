// The mean inverse depth of pixels that show a surface, in two steps: sums and counts per workgroup, then their sum.

// PARTS workgroups of THREADS invocations sum.

var<workgroup> partial: array<vec2<f32>, THREADS>;

// Sums the same numbers in the same order every time, so the result does not depend on the order of execution.
fn summed(lane: u32, own: vec2<f32>) -> vec2<f32> {
    partial[lane] = own;
    workgroupBarrier();
    for (var half_count = THREADS / 2u; half_count > 0u; half_count /= 2u) {
        if lane < half_count {
            partial[lane] += partial[lane + half_count];
        }
        workgroupBarrier();
    }
    return partial[0];
}

// 1 if no pixel shows a surface.
fn mean_of(sum: vec2<f32>) -> f32 {
    return select(1.0, sum.x / sum.y, sum.y > 0.0);
}

