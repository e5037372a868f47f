//! Warping error: does a surface keep its colour from frame to frame? With the exact motion of a static scene.
//!
//! No package can serve as the reference: published code (by Lai et al. and their successors) estimates the motion
//! with a network. The oracle is a plane with frames and motion known in closed form (`tests/warping.rs`).

use glam::{DMat3, DVec2, DVec3};
use gs3_scene::{Camera, Image, Planes};
use rayon::prelude::*;

use super::{BAND_ROWS, MetricError, displayed};

/// A frame with what its motion follows from.
#[derive(Clone, Copy, Debug)]
pub struct WarpFrame<'a> {
    /// The frame.
    pub image: &'a Image,
    /// Its camera; of the image's size.
    pub camera: &'a Camera,
    /// View-space depth z of the surface (the *median* depth of [`gs3_scene::Geometry`]), world units, 0 where there is
    /// none; of the image's size.
    pub depth: &'a Planes<1>,
}

/// Largest relative difference between the depth a point has and the depth seen where it lands, for it to count as the
/// same surface.
const SAME_SURFACE: f64 = 0.02;

/// Warping error `Σ M ‖W(I₁) − I₀‖² / Σ M` over pixels, summed over RGB (Lai et al. 2018), with the exact motion given
/// by depth and cameras instead of estimated flow. Every pixel centre of `frames[0]` is carried to `frames[1]` and
/// sampled there bilinearly; `M` is 1 where it lands inside the image on the same surface (depths within 2 %).
///
/// View-dependent colour, aliasing and sampling give the ground truth an error, too: report its own value beside that
/// of a method. `None` if no pixel is visible in both frames.
///
/// # Errors
/// [`MetricError::Size`] if an image, camera or depth plane differs in size from the first image.
pub fn warping_error(frames: [WarpFrame<'_>; 2]) -> Result<Option<f64>, MetricError> {
    let [from, to] = frames;
    let expected = from.image.size();
    for frame in frames {
        let (image, camera, depth) = (frame.image.size(), frame.camera.size(), frame.depth.size());
        for (what, actual) in [("image", image), ("camera", camera), ("depth", depth)] {
            if actual != expected {
                return Err(MetricError::Size { what, expected, actual });
            }
        }
    }
    let motion = Motion::between(from.camera, to.camera);
    let [width, height] = expected.to_usize();
    let bands: Vec<(f64, usize)> = (0..height.div_ceil(BAND_ROWS))
        .into_par_iter()
        .map(|band| {
            let (mut sum, mut count) = (0.0, 0);
            for y in band * BAND_ROWS..height.min((band + 1) * BAND_ROWS) {
                for x in 0..width {
                    let depth = f64::from(from.depth.row(0, y)[x]);
                    let Some(warped) = sample_same_surface(&motion, &to, x, y, depth) else { continue };
                    let here = from.image.row(y)[x].map(displayed);
                    sum += (0..3).map(|c| f64::from(warped[c] - here[c]).powi(2)).sum::<f64>();
                    count += 1;
                }
            }
            (sum, count)
        })
        .collect();
    let (sum, count) = bands.iter().fold((0.0, 0), |(s, n), (sum, count)| (s + sum, n + count));
    Ok((count > 0).then(|| sum / count as f64))
}

/// The projection from pixels with depth of one camera to pixels with depth of another.
struct Motion {
    /// View-space direction (z = 1) of pixel (0, 0) and its change per pixel, in the first camera.
    origin: DVec2,
    step: DVec2,
    rotation: DMat3,
    translation: DVec3,
    focal: DVec2,
    centre: DVec2,
}

impl Motion {
    fn between(from: &Camera, to: &Camera) -> Self {
        let relative = to.view_from_world() * from.world_from_view();
        let (a, b) = (from.intrinsics(), to.intrinsics());
        Self {
            origin: DVec2::new(-a.cx / a.fx, -a.cy / a.fy),
            step: DVec2::new(1.0 / a.fx, 1.0 / a.fy),
            rotation: relative.matrix3,
            translation: relative.translation,
            focal: DVec2::new(b.fx, b.fy),
            centre: DVec2::new(b.cx, b.cy),
        }
    }

    /// Pixel position and depth in the second camera of the first camera's `pixel` at `depth`.
    fn apply(&self, pixel: DVec2, depth: f64) -> (DVec2, f64) {
        let ray = self.origin + pixel * self.step;
        let view = self.rotation * (ray.extend(1.0) * depth) + self.translation;
        (view.truncate() / view.z * self.focal + self.centre, view.z)
    }
}

/// The colour of `to` where the surface of pixel `(x, y)` appears, if it is visible there.
fn sample_same_surface(
    motion: &Motion,
    to: &WarpFrame<'_>,
    x: usize,
    y: usize,
    depth: f64,
) -> Option<[f32; 3]> {
    if !(depth.is_finite() && depth > 0.0) {
        return None;
    }
    let (position, z) = motion.apply(DVec2::new(x as f64 + 0.5, y as f64 + 0.5), depth);
    let (u, v) = (position.x - 0.5, position.y - 0.5);
    let (width, height) = (to.image.width(), to.image.height());
    let inside = z > 0.0 && u >= 0.0 && v >= 0.0 && u <= (width - 1) as f64 && v <= (height - 1) as f64;
    if !inside {
        return None;
    }
    let (x0, y0) = (u as usize, v as usize);
    let (x1, y1) = ((x0 + 1).min(width - 1), (y0 + 1).min(height - 1));
    // Every pixel of the bilinear footprint must see this surface, or the sample mixes in another one.
    for (px, py) in [(x0, y0), (x1, y0), (x0, y1), (x1, y1)] {
        let seen = f64::from(to.depth.row(0, py)[px]);
        let same_surface = (seen - z).abs() <= SAME_SURFACE * z;
        if !same_surface {
            return None;
        }
    }
    let (fx, fy) = ((u - x0 as f64) as f32, (v - y0 as f64) as f32);
    let [a, b] = [to.image.row(y0)[x0], to.image.row(y0)[x1]].map(|p| p.map(displayed));
    let [c, d] = [to.image.row(y1)[x0], to.image.row(y1)[x1]].map(|p| p.map(displayed));
    Some(std::array::from_fn(|i| {
        let top = a[i] + fx * (b[i] - a[i]);
        let bottom = c[i] + fx * (d[i] - c[i]);
        top + fy * (bottom - top)
    }))
}
