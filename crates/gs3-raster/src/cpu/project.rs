//! Gaussians to splats: culling, EWA projection (Kerbl et al. 2023), rejection of splats that touch no sample, colour.
//!
//! Sixteen Gaussians are projected at a time. A splat with no sample position in its support is rejected before its
//! colour is evaluated or anything is sorted. At low resolution with matched dilation, most splats are rejected.

use fearless_simd::{Simd, f32x16, mask32x16, prelude::*};
use gs3_scene::{Gaussians, OpacityMode};

use super::block_table::BlockTable;
use super::geometry;
use super::math::log2;
use super::sh;
use super::splat::{PixelRect, Splat};
use crate::settings::{Culling, MIN_ALPHA_INVERSE};
use crate::view::View;

/// Slack on `support`, for the rounding of log₂ here and of 2ˣ in blending. With exponents up to 8 they are off by 1e-6 and
/// 4.3e-7 on a CPU ([`super::math`]), and by 1.4e-6 (3 ULP) and 3.3e-6 (3 + 2·8 ULP) on a GPU: 5e-6 at most. This is 200
/// times as much. [`super::splat::SPAN_SLACK`] and [`super::splat::REACH_FACTOR`] count on the rest.
pub const SUPPORT_MARGIN: f32 = 1e-3;

/// Slack in pixels on the support's extents, for the rounding of positions: by 2⁻¹² px up to 8192 px, 2⁻⁹ px up to 65,536 px.
/// (The extents themselves are off by at most 16·2⁻²⁴ of their lengths. [`SUPPORT_MARGIN`] adds 6e-5 of them.)
pub const EXTENT_MARGIN: f32 = 2e-3;

/// Centres farther off the axis than this multiple of their depth are culled. At a focal length of a thousand pixels
/// their position, 10⁹ px, is only known to 64 px, and its square must not overflow.
pub const MAX_SLOPE: f32 = 1e6;

/// Upper bound of 2·ln 255, the largest squared Mahalanobis radius of a support.
pub const MAX_SQUARED_RADIUS: f32 = 11.1;

/// 2·ln 2, which turns log₂(255 o) into the squared Mahalanobis radius 2·ln(255 o).
pub const TWO_LN_2: f32 = 2.0 * std::f32::consts::LN_2;

/// The largest standard deviation that is projected, in pixels, including the stretch by slopes: the product of two
/// such numbers stays finite. (From 4·10⁹ on, the determinant of a round splat overflows, and it is not drawn
/// either.)
pub const MAX_DEVIATION: f32 = 1e16;

/// √(½·log₂ e): the Cholesky factor is scaled by it so that blending uses powers of 2.
pub const HALF_LOG2_E_SQRT: f32 = 0.849_321_8;

/// The largest steepness of a splat, in square roots of binary orders per pixel. A splat thinner than a nanopixel
/// meets a sample only by accident, and its derivatives would overflow. Only a dilation of 0 gets here.
pub const MAX_STEEPNESS: f32 = 1e9;

/// Standard deviations that the published boxes reach to (Kerbl et al. 2023; [`Culling::Aabb3Sigma`], [`Culling::Adr`]).
pub const PUBLISHED_SIGMAS: f32 = 3.0;

/// Side in pixels of the tiles that the published rules cut splats to, on any machine.
pub const PUBLISHED_TILE: f32 = 16.0;

/// Visible splats of one job, and scratch that keeps its memory between frames.
#[derive(Default)]
pub struct Projected {
    pub splats: Vec<Splat>,
    /// View-space unit normals, facing the camera (RaDe-GS, Zhang et al. 2024); empty unless asked for.
    pub normals: Vec<[f32; 3]>,
    /// The splats' places in the scene; empty unless asked for.
    pub indices: Vec<u32>,
    /// The splats' rectangles again: most of binning reads only these.
    pub rects: Vec<PixelRect>,
}

impl Projected {
    pub fn clear(&mut self) {
        self.splats.clear();
        self.normals.clear();
        self.indices.clear();
        self.rects.clear();
    }
}

/// Inputs of a frame's projection that are the same for all Gaussians.
pub struct ProjectInput<'a> {
    pub gaussians: &'a Gaussians,
    pub opacity_mode: OpacityMode,
    pub view: &'a View,
    pub culling: Culling,
    pub outputs: ProjectOutputs,
    /// If there are any, splats that meet none of these blocks are left out before their colours are evaluated.
    pub wanted: Option<&'a BlockTable>,
}

/// What is projected of each splat besides what blending its colour needs.
#[derive(Clone, Copy, Debug, Default)]
pub struct ProjectOutputs {
    /// [`Splat::ray_distance`] and [`Splat::ray_plane`].
    pub depths: bool,
    pub normals: bool,
    /// Places in the scene.
    pub indices: bool,
}

/// Per-lane results of one vector of Gaussians, spilled for the scalar tail of the survivors.
#[derive(Default)]
struct Lanes {
    direction: [[f32; 16]; 3],
    mean: [[f32; 16]; 2],
    factor: [[f32; 16]; 3],
    opacity: [f32; 16],
    support: [f32; 16],
    depth: [f32; 16],
    rect: [[f32; 16]; 4],
    geometry: [[f32; 16]; geometry::PLANES],
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

#[inline(always)]
fn load3<S: Simd>(s: S, planes: &[Vec<f32>; 3], start: usize, count: usize) -> [f32x16<S>; 3] {
    [load(s, &planes[0], start, count), load(s, &planes[1], start, count), load(s, &planes[2], start, count)]
}

#[inline(always)]
fn load4<S: Simd>(s: S, planes: &[Vec<f32>; 4], start: usize, count: usize) -> [f32x16<S>; 4] {
    [
        load(s, &planes[0], start, count),
        load(s, &planes[1], start, count),
        load(s, &planes[2], start, count),
        load(s, &planes[3], start, count),
    ]
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
    let zero = lanes(s, 0.0);

    let mut direction = [zero; 3];
    for k in 0..3 {
        let mean = load(s, &g.means[k], start, count);
        direction[k] = mean - lanes(s, view.origin[k]) - lanes(s, view.origin_rest[k]);
    }
    let view_space = rotate(s, view, direction);
    let z = view_space[2];
    let valid_lanes = mask32x16::from_bitmask(s, (1_u64 << count) - 1);
    let mut visible = valid_lanes & z.simd_gt(lanes(s, view.near)) & z.simd_lt(lanes(s, view.far));
    // Chunks at the border of two slabs are visited for both.
    if !visible.any_true() {
        return 0;
    }
    let inv_z = lanes(s, 1.0) / z;
    let scales = load3(s, &g.scales, start, count);
    let largest = scales[0].max(scales[1]).max(scales[2]);

    // Per image axis: μ/z, μ/z limited for the Jacobian, and the projected mean.
    let (mut slope, mut limited, mut mean) = ([zero; 2], [zero; 2], [zero; 2]);
    for a in 0..2 {
        slope[a] = view_space[a] * inv_z;
        visible &= slope[a].abs().simd_lt(lanes(s, MAX_SLOPE));
        mean[a] = slope[a].mul_add(lanes(s, view.focal[a]), lanes(s, view.center[a]));
        let [least, most] = view.jacobian_limits[a].map(|limit| lanes(s, limit));
        limited[a] = slope[a].min(most).max(least);
        // A bound of the extent by the largest scale alone, before rotation and opacity are read.
        let per_unit = lanes(s, view.focal[a]) * inv_z * largest;
        let deviation = per_unit * (lanes(s, 1.0) + limited[a].abs());
        visible &= deviation.simd_lt(lanes(s, MAX_DEVIATION));
        let variance = (per_unit * per_unit)
            .mul_add(limited[a].mul_add(limited[a], lanes(s, 1.0)), lanes(s, view.dilation));
        let extent = (variance * lanes(s, MAX_SQUARED_RADIUS)).sqrt() + lanes(s, 1.0);
        visible &= (mean[a] + extent).simd_ge(lanes(s, -view.before[a]));
        visible &=
            (mean[a] - extent).simd_le(lanes(s, view.size.to_array()[a] as f32 - 1.0 - view.before[a]));
    }
    if !visible.any_true() {
        return 0;
    }

    // Columns of M = J·W·R·S, [axis][row]: the principal axes on the image. Row a of J·W is
    // (W_a − clamp(μ_a/z)·W_2)·focal/z.
    let axes = rotation_columns(s, load4(s, &g.rotations, start, count));
    let mut m = [[zero; 2]; 3];
    for a in 0..2 {
        let factor = lanes(s, view.focal[a]) * inv_z;
        let mut row = [zero; 3];
        for k in 0..3 {
            let w = lanes(s, view.rotation[a][k]) - limited[a] * lanes(s, view.rotation[2][k]);
            row[k] = w * factor;
        }
        for k in 0..3 {
            m[k][a] = dot(row, axes[k]) * scales[k];
        }
    }
    let dilation = lanes(s, view.dilation);
    let raw_xx = dot([m[0][0], m[1][0], m[2][0]], [m[0][0], m[1][0], m[2][0]]);
    let raw_yy = dot([m[0][1], m[1][1], m[2][1]], [m[0][1], m[1][1], m[2][1]]);
    let xy = dot([m[0][0], m[1][0], m[2][0]], [m[0][1], m[1][1], m[2][1]]);
    let (xx, yy) = (raw_xx + dilation, raw_yy + dilation);
    // det(M·Mᵀ) as the sum of its squared 2×2 minors (Cauchy–Binet): no cancellation for thin splats, unlike
    // xx·yy − xy².
    let minors = [
        m[0][0] * m[1][1] - m[1][0] * m[0][1],
        m[0][0] * m[2][1] - m[2][0] * m[0][1],
        m[1][0] * m[2][1] - m[2][0] * m[1][1],
    ];
    let raw_det = dot(minors, minors);
    let det = dilation.mul_add(raw_xx + raw_yy + dilation, raw_det);
    visible &= det.simd_gt(zero) & det.simd_lt(lanes(s, f32::MAX));

    let mut opacity = load(s, &g.opacities, start, count);
    if input.opacity_mode == OpacityMode::Antialiased {
        let floor = lanes(s, view.min_compensation * view.min_compensation);
        opacity *= (raw_det / det).max(floor).sqrt();
    }
    let reach = opacity * lanes(s, MIN_ALPHA_INVERSE);
    visible &= reach.simd_ge(lanes(s, 1.0));
    let support = log2(s, reach.max(lanes(s, 1.0))) + lanes(s, SUPPORT_MARGIN);

    // Extents of the support, and the rows and columns of samples inside.
    let squared_radius = support * lanes(s, TWO_LN_2);
    let extent_x = (squared_radius * xx).sqrt() + lanes(s, EXTENT_MARGIN);
    let extent_y = (squared_radius * yy).sqrt() + lanes(s, EXTENT_MARGIN);
    let before = view.before.map(|pixels| lanes(s, pixels));
    let last = [0, 1].map(|a| lanes(s, view.size.to_array()[a] as f32 - 1.0 - view.before[a]));
    let x0 = (mean[0] - extent_x).ceil().max(zero - before[0]);
    let x1 = (mean[0] + extent_x).floor().min(last[0]);
    let y0 = (mean[1] - extent_y).ceil().max(zero - before[1]);
    let y1 = (mean[1] + extent_y).floor().min(last[1]);
    visible &= x0.simd_le(x1) & y0.simd_le(y1);

    // Cholesky factor of the scaled inverse covariance.
    let scale = lanes(s, HALF_LOG2_E_SQRT);
    let l22 = scale / yy.sqrt();
    visible &= (yy * det).simd_ge(lanes(s, f32::MIN_POSITIVE));
    let root = scale / (yy * det).sqrt();
    let (l11, l21) = (yy * root, zero - xy * root);
    let steepest = l11.max(l22).max(l21.abs());
    visible &= steepest.simd_lt(lanes(s, MAX_STEEPNESS));

    // If at most two by two samples are in the box, all of them may miss the ellipse.
    let small = (x1 - x0).simd_le(lanes(s, 1.0)) & (y1 - y0).simd_le(lanes(s, 1.0));
    let mut hit = mask32x16::splat(s, false);
    for (x, y) in [(x0, y0), (x1, y0), (x0, y1), (x1, y1)] {
        let (dx, dy) = (mean[0] - x, mean[1] - y);
        let (u, v) = (l11.mul_add(dx, l21 * dy), l22 * dy);
        hit |= u.mul_add(u, v * v).simd_le(support);
    }
    visible &= hit | !small;

    let (mut x0, mut x1, mut y0, mut y1) = (x0, x1, y0, y1);
    let clip = match input.culling {
        Culling::Aabb3Sigma => {
            let half = (raw_xx + raw_yy) * lanes(s, 0.5) + dilation;
            let spread = (raw_xx - raw_yy) * lanes(s, 0.5);
            let radius =
                ((half + spread.mul_add(spread, xy * xy).sqrt()).sqrt() * lanes(s, PUBLISHED_SIGMAS)).ceil();
            Some([radius, radius])
        }
        Culling::Adr => {
            let reach = (support - lanes(s, SUPPORT_MARGIN)) * lanes(s, TWO_LN_2);
            Some([adr_radius(s, reach, xx), adr_radius(s, reach, yy)])
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
        for (vector, lanes) in direction.iter().zip(&mut out.direction) {
            vector.store_slice(lanes);
        }
        if input.outputs.depths || input.outputs.normals {
            let geometry = geometry::project(s, view, view_space, axes, scales);
            for (vector, lanes) in geometry.iter().zip(&mut out.geometry) {
                vector.store_slice(lanes);
            }
        }
        for (vector, lanes) in mean.iter().zip(&mut out.mean) {
            vector.store_slice(lanes);
        }
        for (vector, lanes) in [l11, l21, l22].iter().zip(&mut out.factor) {
            vector.store_slice(lanes);
        }
        let rect = [x0 + before[0], y0 + before[1], x1 + before[0], y1 + before[1]];
        for (vector, lanes) in rect.iter().zip(&mut out.rect) {
            vector.store_slice(lanes);
        }
        opacity.store_slice(&mut out.opacity);
        support.store_slice(&mut out.support);
        z.store_slice(&mut out.depth);
    }
    visible
}

/// Half the width of a support along an axis by AdR-Gaussian's rule, pixels. `reach` is the support's squared radius in units of
/// the variance. Not a closure: a closure may be compiled without the kernel's vector instructions.
#[inline(always)]
fn adr_radius<S: Simd>(s: S, reach: f32x16<S>, variance: f32x16<S>) -> f32x16<S> {
    (variance.sqrt() * lanes(s, PUBLISHED_SIGMAS)).min((reach * variance).sqrt().ceil())
}

/// First and last pixel of the 16-px tiles that `mean ± radius` touches by the published rule: from tile ⌊(mean −
/// radius)/16⌋ to tile ⌊(mean + radius + 15)/16⌋, exclusive.
#[inline(always)]
fn published_tiles<S: Simd>(s: S, mean: f32x16<S>, radius: f32x16<S>) -> [f32x16<S>; 2] {
    let (side, per_tile) = (lanes(s, PUBLISHED_TILE), lanes(s, 1.0 / PUBLISHED_TILE));
    let first = ((mean - radius) * per_tile).floor() * side;
    let end = ((mean + radius + lanes(s, PUBLISHED_TILE - 1.0)) * per_tile).floor() * side;
    [first, end - lanes(s, 1.0)]
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
    let direction = [lanes.direction[0][lane], lanes.direction[1][lane], lanes.direction[2][lane]];
    let [x0, y0, x1, y1] = [0, 1, 2, 3].map(|k| lanes.rect[k][lane] as u16);
    let rect = PixelRect { x0, y0, x1: x1 + 1, y1: y1 + 1 };
    if let Some(wanted) = input.wanted
        && !wanted.meets(rect)
    {
        return;
    }
    let geometry = |k: usize| lanes.geometry[k][lane];
    // With neither depths nor normals, the lanes of geometry stay 0.
    out.splats.push(Splat {
        mean: [lanes.mean[0][lane], lanes.mean[1][lane]],
        l11: lanes.factor[0][lane],
        l21: lanes.factor[1][lane],
        l22: lanes.factor[2][lane],
        opacity: lanes.opacity[lane],
        color: sh::color(input.gaussians.sh_of(index), direction),
        support: lanes.support[lane],
        rect,
        depth_bits: lanes.depth[lane].to_bits(),
        ray_distance: geometry(0),
        ray_plane: [geometry(1), geometry(2)],
    });
    out.rects.push(rect);
    if input.outputs.indices {
        out.indices.push(index as u32);
    }
    if input.outputs.normals {
        out.normals.push([geometry(3), geometry(4), geometry(5)]);
    }
}

#[inline(always)]
pub fn lanes<S: Simd>(s: S, v: f32) -> f32x16<S> {
    f32x16::splat(s, v)
}

#[inline(always)]
pub fn dot<S: Simd>(a: [f32x16<S>; 3], b: [f32x16<S>; 3]) -> f32x16<S> {
    a[0].mul_add(b[0], a[1].mul_add(b[1], a[2] * b[2]))
}

/// World-space vectors in view space.
#[inline(always)]
pub fn rotate<S: Simd>(s: S, view: &View, v: [f32x16<S>; 3]) -> [f32x16<S>; 3] {
    let row = |r: [f32; 3]| [lanes(s, r[0]), lanes(s, r[1]), lanes(s, r[2])];
    [dot(row(view.rotation[0]), v), dot(row(view.rotation[1]), v), dot(row(view.rotation[2]), v)]
}
