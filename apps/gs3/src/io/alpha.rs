//! Frames with transparency: what is behind the scene shows through.

use std::sync::Arc;

use gs3::scene::gaussians::SH_C0;
use gs3::scene::{Gaussians, Image, Scene, SceneError};

/// The scene's coverage: the same Gaussians, all of them white. Over black, a frame's colour is then its alpha. The
/// coverage is rendered in the same mode as the scene: alpha is super-sampled and interpolated like any colour.
pub fn coverage(scene: &Scene) -> Result<Arc<Scene>, SceneError> {
    let gaussians = scene.gaussians();
    // A channel is ½ + C₀ · the constant term.
    let white = vec![0.5 / SH_C0; 3 * gaussians.len()];
    let gaussians = Gaussians { sh_degree: 0, sh: white, ..gaussians.clone() };
    Ok(Arc::new(Scene::new(gaussians, scene.opacity_mode())?.with_details(scene.details().clone())))
}

/// Straight RGBA of a frame over black and the frame of its coverage, 8 bits, rows of pixels. Colours are the
/// surfaces' own, not darkened by missing coverage. All four values are 0 where there is no surface.
pub fn straight_rgba8(over_black: &Image, coverage: &Image) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(4 * over_black.pixels().len());
    for (color, coverage) in over_black.pixels().iter().zip(coverage.pixels()) {
        // Channels of reconstructed coverage differ by rounding alone.
        let alpha = coverage[1].clamp(0.0, 1.0);
        // `as` saturates, and maps NaN to 0.
        let eight_bit = |value: f32| (value * 255.0 + 0.5) as u8;
        match eight_bit(alpha) {
            0 => bytes.extend([0; 4]),
            opaque => {
                bytes.extend(color[..3].iter().map(|value| eight_bit(value / alpha)));
                bytes.push(opaque);
            }
        }
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_are_divided_by_what_covers_them() {
        let image = |pixels: &[[f32; 4]]| Image::from_pixels(pixels.len(), 1, pixels.to_vec()).unwrap();
        let color = image(&[
            [0.5, 0.25, 0.0, 0.0],
            [0.2, 0.4, 0.6, 0.0],
            [0.3, 0.3, 0.3, 0.0],
            [1e-4; 4],
            [f32::NAN, -1.0, 2.0, 0.0],
        ]);
        let coverage = image(&[[0.5; 4], [1.0; 4], [1.2; 4], [1e-3; 4], [0.5; 4]]);
        let expected = [[255, 128, 0, 128], [51, 102, 153, 255], [77, 77, 77, 255], [0; 4], [0, 0, 255, 128]];
        assert_eq!(straight_rgba8(&color, &coverage), expected.concat());
    }
}
