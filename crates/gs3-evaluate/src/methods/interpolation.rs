//! Frames between rendered ones, for baselines.

use gs3_reconstruct::{Interpolator, Neighbor};
use gs3_scene::{Camera, GBuffer, Image};
use rayon::prelude::*;

use super::{Interpolation, MethodError};

/// A rendered frame, to be interpolated between.
#[derive(Debug, Default)]
pub(super) struct Frame {
    pub camera: Option<Camera>,
    pub gbuffer: GBuffer,
    pub image: Image,
}

/// Makes the frame between `before` and `after` in `out`, at time `t` ∈ (0, 1) and its camera `pose`; false if the method
/// makes none, and `before` stays on.
pub(super) fn interpolate(
    interpolation: Interpolation,
    interpolator: &mut Interpolator,
    before: &Frame,
    after: &Frame,
    (t, pose): (f32, &Camera),
    out: &mut Image,
) -> Result<bool, MethodError> {
    match interpolation {
        Interpolation::None | Interpolation::Repeat => Ok(false),
        Interpolation::Blend => {
            out.resize(after.image.width(), after.image.height());
            let neighbors = before.image.pixels().par_iter().zip(after.image.pixels());
            out.pixels_mut().par_iter_mut().zip(neighbors).for_each(|(to, (a, b))| {
                *to = std::array::from_fn(|c| 0.5 * (a[c] + b[c]));
            });
            Ok(true)
        }
        // Learned interpolation is part of the pipeline, and `build` takes no other.
        Interpolation::Warp(_) | Interpolation::Learned(_) => {
            let (Some(from), Some(to)) = (&before.camera, &after.camera) else { return Ok(false) };
            let before =
                Neighbor { camera: from, image: &before.image, gbuffer: &before.gbuffer, gradients: None };
            let after =
                Neighbor { camera: to, image: &after.image, gbuffer: &after.gbuffer, gradients: None };
            interpolator.interpolate(before, after, t, pose, out)?;
            Ok(true)
        }
    }
}
