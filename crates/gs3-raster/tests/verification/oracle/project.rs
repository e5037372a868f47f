//! One Gaussian, seen by a camera.

use glam::{DMat3, DQuat, DVec3};
use gs3_scene::{Camera, OpacityMode, Scene};

use super::NEAR;
use super::cutoffs::is_near_plane;
use super::spherical_harmonics::color;

/// A projected Gaussian.
#[derive(Clone, Debug)]
pub struct Splat {
    /// Index in the scene.
    pub index: usize,
    /// View depth.
    pub z: f64,
    /// Image position in pixels.
    pub mean: [f64; 2],
    /// Dilated image covariance `xx`, `xy`, `yy` in px².
    pub covariance: [f64; 3],
    /// Its inverse `A`, `B`, `C`.
    pub conic: [f64; 3],
    /// Opacity at the centre.
    pub opacity: f64,
    /// Colour seen from this camera.
    pub color: [f64; 3],
    /// Distance of the centre from the camera.
    pub distance: f64,
    /// Change of distance per pixel from the sample to the centre.
    pub plane: [f64; 2],
    /// View-space normal, towards the camera.
    pub normal: [f64; 3],
}

impl Splat {
    /// `None` if the Gaussian is culled (rounding at the near plane aside) or degenerate.
    pub(super) fn project(scene: &Scene, index: usize, camera: &Camera, dilation: f64) -> Option<Self> {
        let g = scene.gaussians();
        let intrinsics = camera.intrinsics();
        let (fx, fy) = (intrinsics.fx, intrinsics.fy);
        let world = DVec3::from_array(g.mean(index).map(f64::from));
        let view = camera.view_from_world().transform_point3(world);
        // Culled splats this close to the near plane are kept, to mark the samples that they could have changed.
        if view.z <= NEAR && !is_near_plane(view.z) {
            return None;
        }

        let [w, x, y, z] = g.rotation(index).map(f64::from);
        let scale = DVec3::from_array(g.scale(index).map(f64::from));
        let axes =
            camera.view_from_world().matrix3 * DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        let covariance_view = axes * DMat3::from_diagonal(scale * scale) * axes.transpose();

        // The Jacobian's rows; only here the direction is clamped, to 15 % of the image's sides outside of it.
        let clamp = |slope: f64, side: u32, center: f64, focal: f64| {
            let side = f64::from(side);
            slope.clamp((-center - 0.15 * side) / focal, (1.15 * side - center) / focal)
        };
        let (u, v) = (view.x / view.z, view.y / view.z);
        let jx = DVec3::new(fx / view.z, 0.0, -fx * clamp(u, intrinsics.width, intrinsics.cx, fx) / view.z);
        let jy = DVec3::new(0.0, fy / view.z, -fy * clamp(v, intrinsics.height, intrinsics.cy, fy) / view.z);
        let (xx, xy, yy) =
            (jx.dot(covariance_view * jx), jx.dot(covariance_view * jy), jy.dot(covariance_view * jy));
        let (dxx, dyy) = (xx + dilation, yy + dilation);
        let det = dxx * dyy - xy * xy;
        if det <= 0.0 {
            return None;
        }
        let opacity = f64::from(g.opacities[index])
            * match scene.opacity_mode() {
                OpacityMode::Default => 1.0,
                OpacityMode::Antialiased => ((xx * yy - xy * xy) / det).max(0.005 * 0.005).sqrt(),
            };

        // Ray plane and normal; m ∝ Σ⁻¹ U, scaled by the smallest variance.
        let ray = DVec3::new(u, v, 1.0);
        let smallest = scale.min_element();
        let m: DVec3 =
            (0..3).map(|k| (smallest / scale[k]).powi(2) * axes.col(k).dot(ray) * axes.col(k)).sum();
        let q = m / m.dot(ray);
        let ray_squared = ray.length_squared();
        let distance = view.length();
        let plane = [distance / fx * (q.x - u / ray_squared), distance / fy * (q.y - v / ray_squared)];

        Some(Self {
            index,
            z: view.z,
            mean: [fx * u + intrinsics.cx, fy * v + intrinsics.cy],
            covariance: [dxx, xy, dyy],
            conic: [dyy / det, -xy / det, dxx / det],
            opacity,
            color: color(g.sh_degree, g.sh_of(index), world - camera.position()),
            distance,
            plane,
            normal: (-m.normalize()).to_array(),
        })
    }
}
