//! Bounds of runs of 256 consecutive Gaussians, for culling. Most formats of trained scenes have spatial order. In
//! other scenes the bounds are large, and culling stays correct.

use gs3_scene::Gaussians;
use rayon::prelude::*;

use crate::view::View;

/// Gaussians in a chunk.
pub const CHUNK: usize = 256;

/// Largest Mahalanobis radius of a support, √(2 ln 255) = 3.33, rounded up.
const MAX_RADIUS: f32 = 3.34;

/// Slack of a chunk's sphere, as a share of its distance from the camera (of the sum of its coordinates, which is not
/// less) and of its radius. It covers rounding. A chunk too many only costs time.
///
/// With ε = 2⁻²⁴, rounding moves the sphere against a plane by less than 20 ε of the distance: the offset from the camera
/// by 1, the entries of the rotation by √3, sums of three products by 3√3, the plane's coefficients by 5, and the sum along
/// the plane by 5. The slack is 1,680 ε, 84 times as much.
///
/// The rest is for GPUs and chunks far from the world's origin. A GPU knows the camera's origin rounded, as the chunk's centre is, by
/// ε of the distance from the world's origin. The slack covers this up to 830 times the distance between the two. The pixel
/// that [`Frustum`] adds is as much again at a focal length of 10,000 pixels, and more at shorter ones.
pub const SLACK: f32 = 1e-4;

/// Factor of a chunk's radius. It covers rounding: the sides of the box, their squares, the sum and the root are off by 5 ε
/// in all, and this is 1,680 ε. (The sides are measured from the rounded centre.)
const RADIUS_FACTOR: f32 = 1.0001;

/// A sphere around the centres of a chunk, and its largest scale, world units.
#[derive(Clone, Copy, Debug)]
pub struct Chunk {
    pub center: [f32; 3],
    pub radius: f32,
    pub largest_scale: f32,
}

/// The chunks of a scene, in order.
pub fn of_gaussians(g: &Gaussians) -> Vec<Chunk> {
    (0..g.len().div_ceil(CHUNK))
        .into_par_iter()
        .map(|c| {
            let range = c * CHUNK..((c + 1) * CHUNK).min(g.len());
            let mut center = [0.0; 3];
            let mut half = [0.0; 3];
            for k in 0..3 {
                let plane = &g.means[k][range.clone()];
                let low = plane.iter().fold(f32::INFINITY, |a, b| a.min(*b));
                let high = plane.iter().fold(f32::NEG_INFINITY, |a, b| a.max(*b));
                center[k] = low + 0.5 * (high - low);
                // The centre is rounded, and the sphere must hold both ends.
                half[k] = (high - center[k]).max(center[k] - low);
            }
            let radius = half.iter().map(|v: &f32| v * v).sum::<f32>().sqrt() * RADIUS_FACTOR;
            let scales = g.scales.iter().flat_map(|plane| &plane[range.clone()]);
            Chunk { center, radius, largest_scale: scales.fold(0.0, |a, b| a.max(*b)) }
        })
        .collect()
}

/// Half spaces of view space. A chunk outside of one has no visible Gaussian.
///
/// A splat reaches pixel x = W when fx·x/z + cx − W − 3.34·√(Σxx + ε) < 0, and Σxx is bounded by (fx/z)²(1 +
/// limit²)·s². Multiplied by z, the condition is linear in (x, z), except for a constant times the largest scale s.
/// The other sides are treated in the same way.
pub struct Frustum<'a> {
    view: &'a View,
    /// The coefficients of the view-space coordinate and of z, the length of this pair, and the factor of the largest
    /// scale.
    pub planes: [(usize, [f32; 3], f32); 4],
}

impl<'a> Frustum<'a> {
    pub fn new(view: &'a View) -> Self {
        let margin = MAX_RADIUS * view.dilation.sqrt() + 1.0;
        let plane = |axis: usize, sign: f32| {
            let focal = view.focal[axis];
            let edge = if sign > 0.0 { view.size.to_array()[axis] as f32 } else { 0.0 } - view.before[axis];
            // sign·(focal·x/z + center − edge) > margin + … means outside.
            let a = sign * focal;
            let b = sign * (view.center[axis] - edge) - margin;
            let [least, most] = view.jacobian_limits[axis];
            let limit = least.abs().max(most.abs());
            let spread = MAX_RADIUS * focal * (1.0 + limit * limit).sqrt();
            (axis, [a, b, a.hypot(b)], spread)
        };
        Self { view, planes: [plane(0, 1.0), plane(0, -1.0), plane(1, 1.0), plane(1, -1.0)] }
    }

    /// Whether any Gaussian of the chunk may touch the image. Errs towards yes.
    pub fn may_see(&self, chunk: &Chunk) -> bool {
        let View { origin, origin_rest, .. } = self.view;
        let offset: [f32; 3] = std::array::from_fn(|k| chunk.center[k] - origin[k] - origin_rest[k]);
        let center = self.view.rotate(offset);
        let slack = SLACK * (center.iter().map(|v| v.abs()).sum::<f32>() + chunk.radius);
        let radius = chunk.radius + slack;
        if center[2] + radius <= self.view.near || center[2] - radius >= self.view.far {
            return false;
        }
        // The comparison is written so that a chunk with non-finite bounds counts as visible.
        let outside = self.planes.iter().any(|(axis, [a, b, length], spread)| {
            a * center[*axis] + b * center[2] - length * radius > spread * chunk.largest_scale
        });
        !outside
    }
}
