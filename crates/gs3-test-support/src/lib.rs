//! What tests and examples of several crates share. No crate builds on this one outside its tests.

mod literals;
mod psnr;
mod server;

use gs3_scene::{Gaussians, OpacityMode, Scene, demo};

pub use literals::check_literals;
pub use psnr::{largest_difference_but, psnr, psnr_of_bytes, psnr_shown};
pub use server::serve;

/// `count` Gaussians of opacity 0.9 along the x axis, 1 apart, with standard deviations of `scale` in world units.
///
/// # Panics
/// If `scale` is negative or not finite.
#[must_use]
pub fn row_of_gaussians(count: usize, scale: f32) -> Scene {
    let mut row = Gaussians::zeroed(count, 0);
    for k in 0..count {
        (row.rotations[0][k], row.opacities[k], row.means[0][k]) = (1.0, 0.9, k as f32);
        row.scales.iter_mut().for_each(|axis| axis[k] = scale);
    }
    Scene::new(row, OpacityMode::Default).expect("a scene")
}

/// Every `every`-th Gaussian of the demo scene, widened so that they cover as much: about the same picture, in a fraction of
/// the time where a device in software projects them.
///
/// # Panics
/// If `every` is 0.
#[must_use]
pub fn part_of_demo(every: usize) -> Scene {
    let mut part = demo::scene().expect("the demo").into_gaussians();
    part.retain(|_, i| i % every == 0);
    let wider = (every as f32).sqrt();
    part.scales.iter_mut().flatten().for_each(|scale| *scale *= wider);
    Scene::new(part, OpacityMode::Default).expect("a scene")
}
