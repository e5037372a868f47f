//! A procedural scene that needs no download: a stone court with a gilded knot, marble, columns, trees, grass and sky.
//!
//! It is as hard for a renderer as a capture: 530,000 Gaussians of all sizes, thin foliage, fine texture, glossy
//! view-dependent colour, and a sky dome around it. World units are metres, z points up. Every machine with the same
//! floating-point functions generates the same Gaussians, with any number of threads.

mod court;
mod light;
mod noise;
mod plants;
mod splats;

use std::f64::consts::TAU;

use glam::DVec3;
use rayon::prelude::*;

use crate::camera::Intrinsics;
use crate::camera_path::CameraPath;
use crate::gaussians::Gaussians;
use crate::orbit::look_at;
use crate::scene::{OpacityMode, Scene, SceneError};
use splats::Splat;

/// Spherical-harmonics degree of the demo: two carry the reflection of the sky and a broad highlight.
const SH_DEGREE: u8 = 2;

/// Frames of the demo's camera path, 8 s at 30 rendered frames per second.
const PATH_FRAMES: usize = 240;

/// Generates the scene.
///
/// # Errors
/// None in practice: the generated Gaussians are valid. The error type comes from [`Scene::new`].
pub fn scene() -> Result<Scene, SceneError> {
    let parts: [fn() -> Vec<Splat>; 3] = [court::splats, plants::splats, light::sky_dome];
    let parts: Vec<Vec<Splat>> = parts.par_iter().map(|part| part()).collect();
    Scene::new(to_gaussians(&parts.concat()), OpacityMode::Default)
}

/// The demo's camera path: a closed sweep around the knot, 4096×2160, vertical field of view 55°.
#[must_use]
pub fn path() -> CameraPath {
    let camera = |frame: usize| {
        let turn = TAU * frame as f64 / PATH_FRAMES as f64;
        let angle = 35_f64.to_radians() * turn.sin() - 1.1;
        let radius = 5.2 + 0.7 * turn.cos();
        let eye = DVec3::new(radius * angle.cos(), radius * angle.sin(), 1.7 + 0.35 * (2.0 * turn).sin());
        let intrinsics = Intrinsics::from_fov_y(4096, 2160, 55_f64.to_radians());
        look_at(eye, DVec3::new(0.0, 0.0, 1.25), DVec3::Z, intrinsics)
    };
    // The cameras are valid, as a test shows; none is dropped.
    CameraPath::cycle((0..PATH_FRAMES).flat_map(camera).collect())
}

fn to_gaussians(splats: &[Splat]) -> Gaussians {
    let mut g = Gaussians::zeroed(splats.len(), SH_DEGREE);
    for (i, splat) in splats.iter().enumerate() {
        for axis in 0..3 {
            g.means[axis][i] = splat.center[axis];
            g.scales[axis][i] = splat.scale[axis];
        }
        let q = splat.rotation;
        for (plane, value) in g.rotations.iter_mut().zip([q.w, q.x, q.y, q.z]) {
            plane[i] = value;
        }
        g.opacities[i] = splat.opacity;
    }
    let stride = g.sh_stride();
    for (row, splat) in g.sh.chunks_exact_mut(stride).zip(splats) {
        row.copy_from_slice(splat.sh.as_flattened());
    }
    g
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scene_is_rich_valid_and_the_same_every_time() {
        let scene = scene().unwrap();
        assert!(scene.gaussians().len() >= 300_000, "{}", scene.gaussians().len());
        assert_eq!((scene.dropped().total(), scene.gaussians().sh_degree), (0, SH_DEGREE));
        let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        assert!(alone.install(super::scene).unwrap() == scene);
        let view_dependent =
            scene.gaussians().sh.chunks_exact(27).filter(|row| row[3..] != [0.0; 24]).count();
        assert!(view_dependent > 50_000, "{view_dependent}");
    }

    #[test]
    fn path_is_a_smooth_loop_around_the_knot() {
        let path = path();
        assert_eq!((path.cameras().len(), path.is_cycle()), (PATH_FRAMES, true));
        for k in 0..PATH_FRAMES {
            let (a, b) = (path.at(k as f64), path.at(k as f64 + 1.0));
            assert!(a.position().distance(b.position()) < 0.12, "{k}");
            let (pixel, z) = a.project(DVec3::new(0.0, 0.0, 1.25));
            assert!(z > 0.0 && (pixel.x - 2048.0).abs() < 1.0 && (pixel.y - 1080.0).abs() < 1.0);
        }
    }
}
