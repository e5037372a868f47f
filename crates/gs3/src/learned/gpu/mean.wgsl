// The mean inverse depth of what was hit, in two steps: sums and counts of workgroups, then their sum.

// Workgroups that sum.
const PARTS: u32 = 64u;

var<workgroup> partial: array<vec2<f32>, 256>;

// Always the same numbers in the same order: the sum does not depend on who comes first.
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

// 1 where nothing was hit.
fn mean_of(sum: vec2<f32>) -> f32 {
    return select(1.0, sum.x / sum.y, sum.y > 0.0);
}

