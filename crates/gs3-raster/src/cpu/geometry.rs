//! Depth and normal of a Gaussian as seen by a camera (RaDe-GS, Zhang et al. 2024).

use gs3_scene::Gaussians;

use super::splat::SplatGeometry;
use super::view::View;

/// Ray distance, its slope over the image and the normal of Gaussian `index`; `direction` is its centre relative to the
/// camera centre, world space.
///
/// With U = μ/z (view space), the plane that the rays' maxima of the Gaussian form has the normal m = Σ⁻¹U. Σ⁻¹ is
/// scaled by the square of the smallest axis, so flat Gaussians stay finite.
pub fn of_gaussian(g: &Gaussians, index: usize, view: &View, direction: [f32; 3]) -> SplatGeometry {
    let mean = view.rotate(direction);
    let ray = [mean[0] / mean[2], mean[1] / mean[2], 1.0];
    let scale = g.scale(index);
    let smallest = scale[0].min(scale[1]).min(scale[2]);
    let [w, x, y, z] = g.rotation(index);
    let axes = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)],
        [2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)],
        [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)],
    ];
    let mut m = [0.0; 3];
    for (axis, s) in axes.into_iter().zip(scale) {
        let axis = view.rotate(axis);
        // 0/0 of a degenerate axis counts as the smallest itself.
        let ratio = if s > smallest { smallest / s } else { 1.0 };
        let weight = ratio * ratio * dot(axis, ray);
        for k in 0..3 {
            m[k] += weight * axis[k];
        }
    }
    let along = dot(m, ray);
    let ray_length2 = dot(ray, ray);
    // An edge-on flat Gaussian has no plane of maxima; its centre's depth is used.
    let q = if along > f32::MIN_POSITIVE { m.map(|v| v / along) } else { ray.map(|v| v / ray_length2) };
    let distance = dot(mean, mean).sqrt();
    let slope = |a: usize| distance / view.focal[a] * (q[a] - ray[a] / ray_length2);
    let length = dot(m, m).sqrt();
    let normal = if length > f32::MIN_POSITIVE {
        m.map(|v| -v / length)
    } else {
        ray.map(|v| -v / ray_length2.sqrt())
    };
    SplatGeometry { ray_distance: distance, ray_plane: [slope(0), slope(1)], normal }
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
