//! From parametric surfaces to Gaussians.

use std::f32::consts::TAU;

use glam::{Mat3, Quat, Vec3};
use rayon::prelude::*;

use super::light::{Material, shade};
use super::noise::Random;

/// One Gaussian of the demo.
#[derive(Clone)]
pub struct Splat {
    pub center: Vec3,
    pub rotation: Quat,
    /// Standard deviations along the rotated axes.
    pub scale: Vec3,
    pub opacity: f32,
    /// Coefficients up to degree 2, `[9, 3]`.
    pub sh: [[f32; 3]; 9],
}

/// A grid of Gaussians on a surface.
pub struct Patch {
    pub seed: u64,
    /// Number of Gaussians along u and v; u and v run over `[0, 1)`.
    pub counts: [usize; 2],
    /// Standard deviation of a Gaussian in steps of the grid: about 0.6 covers the surface without blurring it.
    pub overlap: f32,
}

impl Patch {
    /// Covers `surface(u, v)` with flat Gaussians; `material(position, normal, u, v)` gives each its look. The normal
    /// is ∂u × ∂v.
    pub fn cover(
        &self,
        surface: impl Fn(f32, f32) -> Vec3 + Sync,
        material: impl Fn(Vec3, Vec3, f32, f32) -> Material + Sync,
    ) -> Vec<Splat> {
        let [nu, nv] = self.counts;
        let (step_u, step_v) = (1.0 / nu as f32, 1.0 / nv as f32);
        let splat = |i: usize| {
            let mut random = Random::new(self.seed, i);
            // A jittered grid has neither the gaps of random places nor the moiré of a regular one.
            let u = ((i % nu) as f32 + random.range(0.1, 0.9)) * step_u;
            let v = ((i / nu) as f32 + random.range(0.1, 0.9)) * step_v;
            let center = surface(u, v);
            let along_u = (surface(u + 0.5 * step_u, v) - surface(u - 0.5 * step_u, v)) * self.overlap;
            let along_v = (surface(u, v + 0.5 * step_v) - surface(u, v - 0.5 * step_v)) * self.overlap;
            let normal = along_u.cross(along_v).normalize_or(Vec3::Z);
            let tangent = along_u.normalize_or(normal.any_orthonormal_vector());
            let rotation = Quat::from_mat3(&Mat3::from_cols(tangent, normal.cross(tangent), normal));
            let (size_u, size_v) = (along_u.length().max(1e-4), along_v.length().max(1e-4));
            let material = material(center, normal, u, v);
            Splat {
                center,
                rotation,
                scale: Vec3::new(size_u, size_v, 0.12 * size_u.min(size_v)),
                opacity: random.range(0.9, 0.98),
                sh: shade(center, normal, &material),
            }
        };
        (0..nu * nv).into_par_iter().map(splat).collect()
    }
}

/// A thin Gaussian from `root` along `direction`: a leaf or a blade of grass.
pub fn blade(root: Vec3, direction: Vec3, normal: Vec3, size: Vec3, material: &Material) -> Splat {
    let along = direction.normalize_or(Vec3::Z);
    let across = normal.cross(along).normalize_or(along.any_orthonormal_vector());
    let facing = along.cross(across);
    let center = root + along * (1.5 * size.x);
    Splat {
        center,
        rotation: Quat::from_mat3(&Mat3::from_cols(along, across, facing)),
        scale: size,
        opacity: 0.92,
        sh: shade(center, normal, material),
    }
}

/// The unit circle at `turns`.
pub fn circle(turns: f32) -> Vec3 {
    let (sin, cos) = (TAU * turns).sin_cos();
    Vec3::new(cos, sin, 0.0)
}
