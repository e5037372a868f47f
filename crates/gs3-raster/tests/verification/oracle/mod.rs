//! A naive f64 evaluation of 3D Gaussian Splatting: every Gaussian at every pixel, no tiles, no vectors, no tricks.
//!
//! Sources: Kerbl et al. 2023 (projection, blending, spherical harmonics), Mip-Splatting (antialiased opacity),
//! UpscaleGS (image gradients), RaDe-GS (ray plane, depth, normal).

mod cutoffs;
mod project;
mod spherical_harmonics;
#[cfg(test)]
mod tests;

pub use cutoffs::{CutOffs, TRANSMITTANCE_BAND};
pub use project::Splat;

use gs3_raster::{ExpectedDepth, Rules};
use gs3_scene::{Camera, Intrinsics, Scene};

/// α below this is not blended.
pub const ALPHA_MIN: f64 = 1.0 / 255.0;
/// α is clamped to this.
pub const ALPHA_MAX: f64 = 0.99;
/// Blending stops before transmittance would fall below this.
pub const TRANSMITTANCE_MIN: f64 = 1e-4;
/// Gaussians at or before this view depth are culled.
pub const NEAR: f64 = 0.2;

/// A scene seen by a camera, ready to be sampled anywhere.
pub struct Oracle {
    /// Front to back.
    pub splats: Vec<Splat>,
    intrinsics: Intrinsics,
    jitter: [f64; 2],
    background: [f64; 3],
    max_alpha: f64,
    has_depths_of_centers: bool,
}

/// Everything a G-buffer holds at one position, and which cut-offs are so near that rounding may cross them.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sample {
    pub color: [f64; 3],
    pub color_dx: [f64; 3],
    pub color_dy: [f64; 3],
    pub color_dxy: [f64; 3],
    pub alpha: f64,
    pub depth_median: f64,
    pub depth_expected: f64,
    pub normal: [f64; 3],
    pub cut_offs: CutOffs,
}

impl Oracle {
    pub fn new(
        scene: &Scene,
        camera: &Camera,
        dilation: f32,
        jitter: [f32; 2],
        background: [f32; 3],
    ) -> Self {
        let mut splats: Vec<Splat> = (0..scene.gaussians().len())
            .filter_map(|i| Splat::project(scene, i, camera, f64::from(dilation)))
            .collect();
        splats.sort_by(|a, b| a.z.total_cmp(&b.z));
        Self {
            splats,
            intrinsics: camera.intrinsics(),
            jitter: jitter.map(f64::from),
            background: background.map(f64::from),
            max_alpha: ALPHA_MAX,
            has_depths_of_centers: false,
        }
    }

    /// The same scene by other rules; the planes' are not read.
    pub fn by(self, rules: Rules) -> Self {
        let has_depths_of_centers = rules.expected_depth == ExpectedDepth::Centers;
        Self { max_alpha: f64::from(rules.max_alpha), has_depths_of_centers, ..self }
    }

    /// The sample that pixel `(i, j)` of the G-buffer stands for.
    pub fn pixel(&self, i: usize, j: usize) -> Sample {
        self.pixel_of(i, j, |_| true)
    }

    /// As [`Self::pixel`], with the splats for which `draws` holds only.
    pub fn pixel_of(&self, i: usize, j: usize, draws: impl Fn(&Splat) -> bool) -> Sample {
        self.sample(i as f64 + 0.5 + self.jitter[0], j as f64 + 0.5 + self.jitter[1], draws)
    }

    /// Blends front to back at image position `(x, y)` the splats for which `draws` holds.
    pub fn sample(&self, x: f64, y: f64, draws: impl Fn(&Splat) -> bool) -> Sample {
        let mut out = Sample::default();
        let (mut t, mut ax, mut ay, mut axy) = (1.0, 0.0, 0.0, 0.0);
        let (mut weight, mut depth_sum, mut depth_median) = (0.0, 0.0, 0.0);
        let mut last_z = f64::NEG_INFINITY;
        for splat in self.splats.iter().filter(|s| draws(s)) {
            let d = [splat.mean[0] - x, splat.mean[1] - y];
            let [a, b, c] = splat.conic;
            let power = -0.5 * (a * d[0] * d[0] + c * d[1] * d[1]) - b * d[0] * d[1];
            if power > 0.0 {
                continue;
            }
            let unclamped = splat.opacity * power.exp();
            let alpha = unclamped.min(self.max_alpha);
            out.cut_offs.note_alpha(unclamped, self.max_alpha);
            if alpha < ALPHA_MIN {
                continue;
            }
            out.cut_offs.note_splat(splat, last_z);
            if splat.z <= NEAR {
                continue;
            }
            last_z = splat.z;
            let after = t * (1.0 - alpha);
            out.cut_offs.note_transmittance(t, after);
            if after < TRANSMITTANCE_MIN {
                break;
            }
            // Derivatives of α with respect to the sample position; a clamped α is constant.
            let moves = f64::from(unclamped < self.max_alpha);
            let (gx, gy) = (a * d[0] + b * d[1], b * d[0] + c * d[1]);
            let (alpha_x, alpha_y) = (moves * alpha * gx, moves * alpha * gy);
            let alpha_xy = moves * alpha * (gx * gy - b);
            // Derivatives of the weight w = α T, where T = 1 − A.
            let w = alpha * t;
            let w_x = alpha_x * t - alpha * ax;
            let w_y = alpha_y * t - alpha * ay;
            let w_xy = alpha_xy * t - alpha_x * ay - alpha_y * ax - alpha * axy;
            for k in 0..3 {
                out.color[k] += splat.color[k] * w;
                out.color_dx[k] += splat.color[k] * w_x;
                out.color_dy[k] += splat.color[k] * w_y;
                out.color_dxy[k] += splat.color[k] * w_xy;
                out.normal[k] += splat.normal[k] * w;
            }
            let distance = splat.distance + splat.plane[0] * d[0] + splat.plane[1] * d[1];
            weight += w;
            depth_sum += w * if self.has_depths_of_centers { splat.z } else { distance };
            if t > 0.5 {
                depth_median = distance;
            }
            // A = 1 − T grows by w, and so do its derivatives.
            (ax, ay, axy) = (ax + w_x, ay + w_y, axy + w_xy);
            t = after;
        }
        for k in 0..3 {
            out.color[k] += t * self.background[k];
            out.color_dx[k] -= ax * self.background[k];
            out.color_dy[k] -= ay * self.background[k];
            out.color_dxy[k] -= axy * self.background[k];
        }
        out.alpha = 1.0 - t;
        if weight > 0.0 {
            let i = self.intrinsics;
            let ray_length = ((x - i.cx) / i.fx).hypot((y - i.cy) / i.fy).hypot(1.0);
            out.depth_expected =
                depth_sum / weight / if self.has_depths_of_centers { 1.0 } else { ray_length };
            out.depth_median = depth_median / ray_length;
        }
        out
    }
}
