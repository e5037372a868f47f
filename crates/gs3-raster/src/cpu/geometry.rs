//! Depth and normal of Gaussians as seen by a camera (RaDe-GS, Zhang et al. 2024), sixteen at a time.

use fearless_simd::{Simd, f32x16, prelude::*};

use super::project::{dot, lanes, rotate};
use crate::view::View;

/// Values per Gaussian that [`project`] returns: ray distance, its slopes along x and y, the normal.
pub const PLANES: usize = 6;

/// Steeper planes of maxima (world units per pixel) count as edge-on. At a focal length of 10⁴ px a splat's samples are
/// at most 10¹⁰ px from its mean ([`super::project::MAX_SLOPE`]). A distance along the ray is then at most 10³⁰, 10⁸ times
/// less than the largest f32, so sums of weights up to 1 stay finite.
pub const STEEPEST_PLANE: f32 = 1e20;

/// Computes the ray distance at the centre (world units), its change per pixel of mean − sample along x and y, and
/// the view-space normal. The inputs are the view-space means, the principal axes (world space) and the scales.
///
/// With U = μ/z, the maxima of the Gaussian along rays form a plane with the normal m = Σ⁻¹U. Σ⁻¹ is scaled by the
/// square of the smallest axis, so flat Gaussians stay finite.
#[inline(always)]
pub fn project<S: Simd>(
    s: S,
    view: &View,
    mean: [f32x16<S>; 3],
    axes: [[f32x16<S>; 3]; 3],
    scales: [f32x16<S>; 3],
) -> [f32x16<S>; PLANES] {
    let (zero, one) = (lanes(s, 0.0), lanes(s, 1.0));
    let tiny = lanes(s, f32::MIN_POSITIVE);
    let inv_z = one / mean[2];
    let ray = [mean[0] * inv_z, mean[1] * inv_z, one];
    let smallest = scales[0].min(scales[1]).min(scales[2]);
    let mut m = [zero; 3];
    for k in 0..3 {
        let axis = rotate(s, view, axes[k]);
        // 0/0 of a degenerate axis counts as the smallest axis itself.
        let ratio = scales[k].simd_gt(smallest).select(smallest / scales[k], one);
        let weight = ratio * ratio * dot(axis, ray);
        for i in 0..3 {
            m[i] = weight.mul_add(axis[i], m[i]);
        }
    }
    let ray_length2 = dot(ray, ray);
    let inv_ray_length2 = one / ray_length2;
    // An edge-on flat Gaussian has no such plane; the depth of its centre is used.
    let along = dot(m, ray);
    let has_plane = along.simd_gt(tiny);
    let distance = mean[2] * ray_length2.sqrt();
    let mut slopes = [zero; 2];
    for a in 0..2 {
        let slope = distance * (m[a] / along - ray[a] * inv_ray_length2) * lanes(s, 1.0 / view.focal[a]);
        // A slope this steep counts as edge-on as well: times a pixel distance it would overflow.
        let is_usable = has_plane & slope.abs().simd_lt(lanes(s, STEEPEST_PLANE));
        slopes[a] = is_usable.select(slope, zero);
    }
    let length2 = dot(m, m);
    let has_normal = length2.simd_gt(tiny);
    let inv_length = one / length2.sqrt();
    let inv_ray_length = inv_ray_length2.sqrt();
    let mut normal = [zero; 3];
    for k in 0..3 {
        let facing = zero - ray[k] * inv_ray_length;
        normal[k] = has_normal.select(zero - m[k] * inv_length, facing);
    }
    [distance, slopes[0], slopes[1], normal[0], normal[1], normal[2]]
}
