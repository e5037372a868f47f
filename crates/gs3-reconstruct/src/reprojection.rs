//! Where a point seen by one camera appears in another camera: rows of a homography plus parallax.

use fearless_simd::{Simd, f32x16, prelude::*};
use glam::{DMat3, DVec3};
use gs3_scene::Camera;

/// Two points belong to one surface, at any slope, if their inverse depths differ by at most this relative amount.
pub(crate) const SAME_SURFACE: f32 = 0.02;

/// Smallest divisor `q` of a point in front of the target camera.
pub(crate) const MIN_DIVISOR: f32 = 1e-6;

/// Maps pixel and inverse depth of a source camera to pixel and inverse depth of a target camera.
///
/// Let `p = (x, y, 1)` be a place in source pixels and `w = 1/z` the inverse view-space depth (0 at infinity). The
/// target sees the point at `(h₀·p + e₀ w, h₁·p + e₁ w) / q` with inverse depth `w / q`, where `q = h₂·p + e₂ w`. The
/// point is in front of the target if `q > 0`. `H = K_t R K_s⁻¹` and `e = K_t t` for the rigid motion `(R, t)` from
/// source to target view space. The map is exact for pinhole cameras. It is evaluated once in f64 and applied in f32.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Reprojection {
    /// Rows of `H`.
    pub rows: [[f32; 3]; 3],
    /// `e`.
    pub epipole: [f32; 3],
    /// Rows of `K_t R`, with `R` from world to target view space. If a point has moved by `d` in the world, `w K_t R
    /// d` is added to its image before the division.
    pub world: [[f32; 3]; 3],
}

impl Reprojection {
    pub fn new(source: &Camera, target: &Camera) -> Self {
        let target_from_source = target.view_from_world() * source.world_from_view();
        let target_matrix = intrinsic_matrix(target);
        let h = target_matrix * target_from_source.matrix3 * intrinsic_matrix(source).inverse();
        let e = target_matrix * target_from_source.translation;
        let rows = |m: DMat3| [0, 1, 2].map(|i| m.row(i).to_array().map(|v| v as f32));
        let world = rows(target_matrix * target.view_from_world().matrix3);
        Self { rows: rows(h), epipole: e.to_array().map(|v| v as f32), world }
    }

    /// Target pixel x, y and the divisor `q` of one source pixel `(x, y)` at inverse depth `w`.
    pub fn apply(&self, [x, y]: [f32; 2], w: f32) -> [f32; 3] {
        let sum = |i: usize| {
            let [h0, h1, h2] = self.rows[i];
            x.mul_add(h0, y.mul_add(h1, w.mul_add(self.epipole[i], h2)))
        };
        let q = sum(2);
        [sum(0) / q, sum(1) / q, q]
    }

    /// Target pixel x, y and the divisor `q` of sixteen source pixels `(x, y)` at inverse depths `w`.
    #[inline(always)]
    pub fn apply_16<S: Simd>(&self, simd: S, x: f32x16<S>, y: f32x16<S>, w: f32x16<S>) -> [f32x16<S>; 3] {
        // Not a closure: a closure would be compiled for the narrowest vectors, and called instead of inlined.
        let mut sums = [f32x16::splat(simd, 0.0); 3];
        for (i, [h0, h1, h2]) in self.rows.into_iter().enumerate() {
            let of_pixel = y.mul_add(h1, w.mul_add(self.epipole[i], f32x16::splat(simd, h2)));
            sums[i] = x.mul_add(h0, of_pixel);
        }
        let [a, b, c] = sums;
        let per = 1.0 / c;
        [a * per, b * per, c]
    }

    /// The inverse depths in the source camera of what source pixels `(x, y)` show and the target camera has at inverse
    /// depths `w`; −1 behind the source camera. With `w_t = w_s / (h₂·p + e₂ w_s)`, `w_s = w_t h₂·p / (1 − e₂ w_t)`.
    #[inline(always)]
    pub fn source_depth_16<S: Simd>(&self, simd: S, x: f32x16<S>, y: f32x16<S>, w: f32x16<S>) -> f32x16<S> {
        let [h0, h1, h2] = self.rows[2];
        let of_pixel = x.mul_add(h0, y.mul_add(h1, f32x16::splat(simd, h2)));
        let divisor = 1.0 - w * self.epipole[2];
        divisor.simd_gt(MIN_DIVISOR).select(w * of_pixel / divisor, f32x16::splat(simd, -1.0))
    }

    /// As [`Self::apply_16`], for surfaces that have moved by `offset` in the world since the source camera saw them.
    #[inline(always)]
    pub fn apply_moved_16<S: Simd>(
        &self,
        simd: S,
        x: f32x16<S>,
        y: f32x16<S>,
        w: f32x16<S>,
        offset: [f32x16<S>; 3],
    ) -> [f32x16<S>; 3] {
        let mut sums = [f32x16::splat(simd, 0.0); 3];
        for i in 0..3 {
            let ([h0, h1, h2], [m0, m1, m2]) = (self.rows[i], self.world[i]);
            let of_pixel = y.mul_add(h1, w.mul_add(self.epipole[i], f32x16::splat(simd, h2)));
            let moved = offset[0].mul_add(m0, offset[1].mul_add(m1, offset[2] * m2));
            // Without motion the result has the same bits as without this term.
            sums[i] = x.mul_add(h0, of_pixel) + moved * w;
        }
        let [a, b, c] = sums;
        let per = 1.0 / c;
        [a * per, b * per, c]
    }
}

/// Parallax of a point at depth 1 between the cameras, in pixels of `target`, for a baseline perpendicular to the
/// view: baseline times focal length. A point at depth z has 1/z of it.
pub(crate) fn parallax(source: &Camera, target: &Camera) -> f32 {
    (source.position().distance(target.position()) * target.intrinsics().fx) as f32
}

fn intrinsic_matrix(camera: &Camera) -> DMat3 {
    let i = camera.intrinsics();
    DMat3::from_cols(DVec3::new(i.fx, 0.0, 0.0), DVec3::new(0.0, i.fy, 0.0), DVec3::new(i.cx, i.cy, 1.0))
}

/// Depths up to a micro-unit count as no surface, so that no inverse overflows.
pub const NEAREST_DEPTH: f32 = 1e-6;

/// Inverse view-space depth; 0 (infinity) for depth 0, which means no surface.
#[inline(always)]
#[must_use]
pub fn inverse_depth(z: f32) -> f32 {
    if z > NEAREST_DEPTH { 1.0 / z } else { 0.0 }
}

/// [`inverse_depth`] of sixteen depths.
#[inline(always)]
pub(crate) fn inverse_depth_16<S: Simd>(simd: S, z: f32x16<S>) -> f32x16<S> {
    z.simd_gt(NEAREST_DEPTH).select(1.0 / z, f32x16::splat(simd, 0.0))
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DQuat, DVec2};
    use gs3_scene::Intrinsics;

    use super::*;

    /// Target pixel x, y and divisor of one pixel.
    fn apply(reprojection: &Reprojection, x: f32, y: f32, w: f32) -> [f32; 3] {
        apply_moved(reprojection, [x, y, w], None)
    }

    /// As `apply`, for a surface that may have moved.
    fn apply_moved(reprojection: &Reprojection, [x, y, w]: [f32; 3], moved: Option<DVec3>) -> [f32; 3] {
        let level = gs3_simd::level();
        fearless_simd::dispatch!(level, simd => {
            let splat = |v: f32| f32x16::splat(simd, v);
            match moved {
                None => reprojection.apply_16(simd, splat(x), splat(y), splat(w)).map(|v| v[0]),
                Some(by) => {
                    let by = by.to_array().map(|v| splat(v as f32));
                    reprojection.apply_moved_16(simd, splat(x), splat(y), splat(w), by).map(|v| v[0])
                }
            }
        })
    }

    #[test]
    fn agrees_with_unproject_and_project() {
        let intrinsics = Intrinsics::from_fov_y(640, 360, 1.0);
        let pose = |yaw: f64, t: [f64; 3]| {
            let rotation = DQuat::from_euler(glam::EulerRot::YXZ, yaw, 0.1, -0.2);
            Camera::new(DAffine3::from_rotation_translation(rotation, t.into()), intrinsics).unwrap()
        };
        let (source, target) = (pose(0.0, [0.0; 3]), pose(0.1, [0.3, -0.2, 0.4]));
        let reprojection = Reprojection::new(&source, &target);
        for (x, y, z) in [(10.5, 20.5, 1.0), (320.0, 180.0, 5.0), (600.25, 300.75, 100.0)] {
            let (expected, depth) = target.project(source.unproject(DVec2::new(x, y), z));
            let [u, v, q] = apply(&reprojection, x as f32, y as f32, inverse_depth(z as f32));
            assert!((f64::from(u) - expected.x).abs() < 1e-3, "{u} {expected}");
            assert!((f64::from(v) - expected.y).abs() < 1e-3, "{v} {expected}");
            assert!((z * f64::from(q) - depth).abs() < 1e-4 * depth);
            let one = reprojection.apply([x as f32, y as f32], inverse_depth(z as f32));
            assert!(one.iter().zip([u, v, q]).all(|(a, b)| (a - b).abs() < 1e-3), "{one:?}");

            let still = apply_moved(&reprojection, [x as f32, y as f32, 1.0 / z as f32], Some(DVec3::ZERO));
            assert_eq!(still, apply(&reprojection, x as f32, y as f32, 1.0 / z as f32));
            let by = DVec3::new(0.05, -0.3, 0.2);
            let (expected, depth) = target.project(source.unproject(DVec2::new(x, y), z) + by);
            let [u, v, q] = apply_moved(&reprojection, [x as f32, y as f32, 1.0 / z as f32], Some(by));
            assert!((f64::from(u) - expected.x).abs() < 1e-3, "{u} {expected}");
            assert!((f64::from(v) - expected.y).abs() < 1e-3, "{v} {expected}");
            assert!((z * f64::from(q) - depth).abs() < 1e-4 * depth);
        }
    }

    #[test]
    fn the_same_camera_is_the_identity() {
        let pose = DAffine3::from_rotation_translation(
            DQuat::from_euler(glam::EulerRot::YXZ, 0.7, 0.3, 0.1),
            DVec3::new(1.0, 2.0, 3.0),
        );
        let camera = Camera::new(pose, Intrinsics::from_fov_y(1920, 1080, 1.0)).unwrap();
        let [x, y, q] = apply(&Reprojection::new(&camera, &camera), 1900.5, 1000.5, 0.25);
        assert!(
            (x - 1900.5).abs() < 1e-3 && (y - 1000.5).abs() < 1e-3 && (q - 1.0).abs() < 1e-6,
            "{x} {y} {q}"
        );
    }
}
