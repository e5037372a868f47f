//! Gaussians to splats: culling, EWA projection (Kerbl et al. 2023), rejection of splats that touch no sample, colour.
//!
//! Sixteen Gaussians at a time. A splat is rejected before its colour is evaluated or anything is sorted when no
//! sample position lies in its support: at low resolution with matched dilation that is most of them.

use fearless_simd::{Simd, f32x16, mask32x16, prelude::*};
use gs3_scene::{Gaussians, OpacityMode};

use super::geometry;
use super::math::log2;
use super::sh;
use super::splat::{PixelRect, Splat, SplatGeometry};
use super::view::{NEAR, View};
use crate::settings::Culling;

/// Slack on `support` for the rounding of the contribution's exponent between here and blending.
const SUPPORT_MARGIN: f32 = 1e-3;

/// Slack in pixels on the support's extents, for the rounding of positions up to 8192 px (2⁻¹¹ px).
const EXTENT_MARGIN: f32 = 2e-3;

/// Smallest factor on opacity in antialiased scenes (gsplat).
const MIN_COMPENSATION: f32 = 0.005;

/// 2·ln 2, which turns log₂(255 o) into the squared Mahalanobis radius 2·ln(255 o).
const TWO_LN_2: f32 = 2.0 * std::f32::consts::LN_2;

/// √(½·log₂ e): the Cholesky factor is scaled by it so that blending uses powers of 2.
pub const HALF_LOG2_E_SQRT: f32 = 0.849_321_8;

/// Visible splats of one job, and scratch that keeps its memory between frames.
#[derive(Default)]
pub struct Projected {
    pub splats: Vec<Splat>,
    /// Empty unless depth and normals are asked for.
    pub geometry: Vec<SplatGeometry>,
    /// View-space z, as bits that sort as unsigned integers (z is positive).
    pub depth_bits: Vec<u32>,
    pub rects: Vec<PixelRect>,
}

impl Projected {
    pub fn clear(&mut self) {
        self.splats.clear();
        self.geometry.clear();
        self.depth_bits.clear();
        self.rects.clear();
    }
}

/// Constant inputs of a frame's projection.
pub struct ProjectInput<'a> {
    pub gaussians: &'a Gaussians,
    pub opacity_mode: OpacityMode,
    pub view: &'a View,
    pub culling: Culling,
    pub with_geometry: bool,
}

/// Per-lane results of one vector of Gaussians, spilled for the scalar tail of the survivors.
#[derive(Default)]
struct Lanes {
    direction: [[f32; 16]; 3],
    mean: [[f32; 16]; 2],
    factor: [[f32; 16]; 3],
    opacity: [f32; 16],
    support: [f32; 16],
    dy_at_max_dx: [f32; 16],
    depth: [f32; 16],
    rect: [[f32; 16]; 4],
}

/// Projects Gaussians `start..end` and appends the visible ones to `out` in order.
#[inline(always)]
pub fn project<S: Simd>(s: S, input: &ProjectInput<'_>, start: usize, end: usize, out: &mut Projected) {
    let mut lanes = Lanes::default();
    let mut i = start;
    while i < end {
        let count = (end - i).min(16);
        let mut visible = project_lanes(s, input, i, count, &mut lanes);
        while visible != 0 {
            let lane = visible.trailing_zeros() as usize;
            visible &= visible - 1;
            emit(input, &lanes, lane, i + lane, out);
        }
        i += count;
    }
}

#[inline(always)]
fn load<S: Simd>(s: S, plane: &[f32], start: usize, count: usize) -> f32x16<S> {
    if count == 16 {
        f32x16::from_slice(s, &plane[start..start + 16])
    } else {
        let mut padded = [0.0; 16];
        padded[..count].copy_from_slice(&plane[start..start + count]);
        f32x16::from_slice(s, &padded)
    }
}

/// Projects up to sixteen Gaussians; returns the bit mask of the visible ones.
#[inline(always)]
fn project_lanes<S: Simd>(
    s: S,
    input: &ProjectInput<'_>,
    start: usize,
    count: usize,
    out: &mut Lanes,
) -> u64 {
    let ProjectInput { gaussians: g, view, .. } = *input;
    let c = |v: f32| f32x16::splat(s, v);
    let zero = c(0.0);

    let direction: [f32x16<S>; 3] = std::array::from_fn(|k| {
        load(s, &g.means[k], start, count) - c(view.origin[k]) - c(view.origin_rest[k])
    });
    let view_space: [f32x16<S>; 3] = std::array::from_fn(|k| {
        let row = view.rotation[k];
        direction[0].mul_add(c(row[0]), direction[1].mul_add(c(row[1]), direction[2] * c(row[2])))
    });
    let z = view_space[2];
    let inv_z = c(1.0) / z;
    let slope = [view_space[0] * inv_z, view_space[1] * inv_z];
    let mean: [f32x16<S>; 2] = std::array::from_fn(|a| slope[a].mul_add(c(view.focal[a]), c(view.center[a])));
    // T = J·W, rows scaled by z / focal: row a = W_a − clamp(slope_a) · W_2.
    let clamped: [f32x16<S>; 2] = std::array::from_fn(|a| {
        let limit = c(view.jacobian_limit[a]);
        slope[a].min(limit).max(zero - limit)
    });
    let scales: [f32x16<S>; 3] = std::array::from_fn(|k| load(s, &g.scales[k], start, count));

    // A bound of the extents from the largest scale alone, before rotation and opacity are read. 11.1 > 2·ln 255.
    let largest = scales[0].max(scales[1]).max(scales[2]);
    let valid_lanes = mask32x16::from_bitmask(s, (1_u64 << count) - 1);
    let mut visible = valid_lanes & z.simd_gt(c(NEAR));
    for a in 0..2 {
        let per_unit = c(view.focal[a]) * inv_z * largest;
        let variance = per_unit * per_unit * clamped[a].mul_add(clamped[a], c(1.0)) + c(view.dilation);
        let extent = (variance * c(11.1)).sqrt() + c(1.0);
        visible &= (mean[a] + extent).simd_ge(zero);
        visible &= (mean[a] - extent).simd_le(c(view.size[a] as f32 - 1.0));
    }
    if !visible.any_true() {
        return 0;
    }

    let transform: [[f32x16<S>; 3]; 2] = std::array::from_fn(|a| {
        let factor = c(view.focal[a]) * inv_z;
        std::array::from_fn(|k| (c(view.rotation[a][k]) - clamped[a] * c(view.rotation[2][k])) * factor)
    });
    let rotation: [f32x16<S>; 4] = std::array::from_fn(|k| load(s, &g.rotations[k], start, count));
    // Columns of M = T·R·S, [axis][row]: the principal axes on the image.
    let axes = rotation_columns(s, rotation);
    let m: [[f32x16<S>; 2]; 3] = std::array::from_fn(|k| {
        std::array::from_fn(|a| {
            let t = transform[a];
            let p = t[0].mul_add(axes[k][0], t[1].mul_add(axes[k][1], t[2] * axes[k][2]));
            p * scales[k]
        })
    });
    let dot = |a: usize, b: usize| m[0][a].mul_add(m[0][b], m[1][a].mul_add(m[1][b], m[2][a] * m[2][b]));
    let dilation = c(view.dilation);
    let (raw_xx, raw_yy, xy) = (dot(0, 0), dot(1, 1), dot(0, 1));
    let (xx, yy) = (raw_xx + dilation, raw_yy + dilation);
    // det(M·Mᵀ) as the sum of its squared 2×2 minors (Cauchy–Binet): no cancellation for thin splats, unlike xx·yy − xy².
    let minor = |j: usize, k: usize| m[j][0] * m[k][1] - m[k][0] * m[j][1];
    let (m01, m02, m12) = (minor(0, 1), minor(0, 2), minor(1, 2));
    let raw_det = m01.mul_add(m01, m02.mul_add(m02, m12 * m12));
    let det = dilation.mul_add(raw_xx + raw_yy + dilation, raw_det);
    visible &= det.simd_gt(zero) & det.simd_lt(c(f32::MAX));

    let mut opacity = load(s, &g.opacities, start, count);
    if input.opacity_mode == OpacityMode::Antialiased {
        let floor = c(MIN_COMPENSATION * MIN_COMPENSATION);
        opacity *= (raw_det / det).max(floor).sqrt();
    }
    let reach = opacity * c(255.0);
    visible &= reach.simd_ge(c(1.0));
    let support = log2(s, reach.max(c(1.0))) + c(SUPPORT_MARGIN);

    // Extents of the support, and the rows and columns of samples inside.
    let squared_radius = support * c(TWO_LN_2);
    let extent_x = (squared_radius * xx).sqrt() + c(EXTENT_MARGIN);
    let extent_y = (squared_radius * yy).sqrt() + c(EXTENT_MARGIN);
    let last = [c(view.size[0] as f32 - 1.0), c(view.size[1] as f32 - 1.0)];
    let x0 = (mean[0] - extent_x).ceil().max(zero);
    let x1 = (mean[0] + extent_x).floor().min(last[0]);
    let y0 = (mean[1] - extent_y).ceil().max(zero);
    let y1 = (mean[1] + extent_y).floor().min(last[1]);
    visible &= x0.simd_le(x1) & y0.simd_le(y1);

    // Cholesky factor of the scaled inverse covariance.
    let scale = c(HALF_LOG2_E_SQRT);
    let l22 = scale / yy.sqrt();
    let root = scale / (yy * det).sqrt();
    let (l11, l21) = (yy * root, zero - xy * root);

    // Where at most two by two samples are in the box, all of them may miss the ellipse.
    let small = (x1 - x0).simd_le(c(1.0)) & (y1 - y0).simd_le(c(1.0));
    let inside = |x: f32x16<S>, y: f32x16<S>| {
        let (dx, dy) = (mean[0] - x, mean[1] - y);
        let (u, v) = (l11.mul_add(dx, l21 * dy), l22 * dy);
        u.mul_add(u, v * v).simd_le(support)
    };
    let hit = inside(x0, y0) | inside(x1, y0) | inside(x0, y1) | inside(x1, y1);
    visible &= hit | !small;

    let (mut x0, mut x1, mut y0, mut y1) = (x0, x1, y0, y1);
    let clip = match input.culling {
        Culling::Aabb3Sigma => {
            let half = (raw_xx + raw_yy) * c(0.5) + dilation;
            let spread = (raw_xx - raw_yy) * c(0.5);
            let radius = ((half + spread.mul_add(spread, xy * xy).sqrt()).sqrt() * c(3.0)).ceil();
            Some([radius, radius])
        }
        Culling::Adr => {
            let reach = (support - c(SUPPORT_MARGIN)) * c(TWO_LN_2);
            let radius =
                |variance: f32x16<S>| (variance.sqrt() * c(3.0)).min((reach * variance).sqrt().ceil());
            Some([radius(xx), radius(yy)])
        }
        Culling::SnugBox | Culling::AccuTile | Culling::Exact => None,
    };
    if let Some(radius) = clip {
        let [left, right] = published_tiles(s, mean[0], radius[0]);
        let [top, bottom] = published_tiles(s, mean[1], radius[1]);
        (x0, x1) = (x0.max(left), x1.min(right));
        (y0, y1) = (y0.max(top), y1.min(bottom));
        visible &= x0.simd_le(x1) & y0.simd_le(y1);
    }

    let visible = visible.to_bitmask();
    if visible != 0 {
        for k in 0..3 {
            direction[k].store_slice(&mut out.direction[k]);
        }
        for (vector, lanes) in mean.iter().zip(&mut out.mean) {
            vector.store_slice(lanes);
        }
        for (vector, lanes) in [l11, l21, l22].iter().zip(&mut out.factor) {
            vector.store_slice(lanes);
        }
        for (vector, lanes) in [x0, y0, x1, y1].iter().zip(&mut out.rect) {
            vector.store_slice(lanes);
        }
        opacity.store_slice(&mut out.opacity);
        support.store_slice(&mut out.support);
        // The support's rightmost point is (xx, xy)·√(r²/xx).
        (xy * (squared_radius / xx).sqrt()).store_slice(&mut out.dy_at_max_dx);
        z.store_slice(&mut out.depth);
    }
    visible
}

/// First and last pixel of the 16-px tiles that `mean ± radius` touches by the published rule: tiles
/// ⌊(mean − radius)/16⌋ to ⌊(mean + radius + 15)/16⌋, exclusive.
#[inline(always)]
fn published_tiles<S: Simd>(s: S, mean: f32x16<S>, radius: f32x16<S>) -> [f32x16<S>; 2] {
    let c = |v: f32| f32x16::splat(s, v);
    let first = ((mean - radius) * c(1.0 / 16.0)).floor() * c(16.0);
    let end = ((mean + radius + c(15.0)) * c(1.0 / 16.0)).floor() * c(16.0);
    [first, end - c(1.0)]
}

/// Columns of the rotation matrix of the unit quaternion (w, x, y, z): the principal axes in world space.
#[inline(always)]
fn rotation_columns<S: Simd>(s: S, [w, x, y, z]: [f32x16<S>; 4]) -> [[f32x16<S>; 3]; 3] {
    let one = f32x16::splat(s, 1.0);
    let (x2, y2, z2) = (x + x, y + y, z + z);
    let (xx, yy, zz) = (x * x2, y * y2, z * z2);
    let (xy, xz, yz) = (x * y2, x * z2, y * z2);
    let (wx, wy, wz) = (w * x2, w * y2, w * z2);
    [[one - yy - zz, xy + wz, xz - wy], [xy - wz, one - xx - zz, yz + wx], [xz + wy, yz - wx, one - xx - yy]]
}

/// Appends the splat of Gaussian `index` from its lane.
#[inline(always)]
fn emit(input: &ProjectInput<'_>, lanes: &Lanes, lane: usize, index: usize, out: &mut Projected) {
    let direction = lanes.direction.map(|plane| plane[lane]);
    let inv_length = 1.0 / direction.iter().map(|v| v * v).sum::<f32>().sqrt();
    let color = sh::color(input.gaussians.sh_of(index), direction.map(|v| v * inv_length));
    let [l11, l21, l22] = lanes.factor.map(|plane| plane[lane]);
    out.splats.push(Splat {
        mean: lanes.mean.map(|plane| plane[lane]),
        l11,
        l21,
        l22,
        opacity: lanes.opacity[lane],
        color,
        support: lanes.support[lane],
        dy_at_max_dx: lanes.dy_at_max_dx[lane],
        inv_l11: 1.0 / l11,
    });
    out.depth_bits.push(lanes.depth[lane].to_bits());
    let [x0, y0, x1, y1] = lanes.rect.map(|plane| plane[lane] as u16);
    out.rects.push(PixelRect { x0, y0, x1: x1 + 1, y1: y1 + 1 });
    if input.with_geometry {
        out.geometry.push(geometry::of_gaussian(input.gaussians, index, input.view, direction));
    }
}
