// The mean inverse depth of pixels that show a surface, in two steps: sums and counts per workgroup, then their sum.

// Number of workgroups that sum.
const PARTS: u32 = 64u;

var<workgroup> partial: array<vec2<f32>, 256>;

// Sums the same numbers in the same order every time, so the result does not depend on the order of execution.
fn summed(lane: u32, own: vec2<f32>) -> vec2<f32> {
    partial[lane] = own;
    workgroupBarrier();
    for (var half_count = 128u; half_count > 0u; half_count /= 2u) {
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

