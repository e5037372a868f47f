//! Generated camera paths for scenes that come without one.

use std::f64::consts::TAU;

use glam::{DAffine3, DMat3, DVec3};

use crate::camera::{Camera, CameraError, Intrinsics};
use crate::camera_path::CameraPath;
use crate::scene::Scene;

/// Vertical field of view of generated paths: 50°, about that of a normal lens held upright.
const FOV_Y: f64 = 50.0 * std::f64::consts::PI / 180.0;

/// Height of the camera over the horizon of the centre: 15°, from where both tops and sides of objects show.
const ELEVATION: f64 = 15.0 * std::f64::consts::PI / 180.0;

/// A scene that is lower than this share of its width surrounds the camera (a room, a street, a lawn); others are
/// objects. (Empirical: captured places are at most 0.3, standing objects 0.4 and more.)
const PLACE_HEIGHT: f64 = 0.4;

/// The camera's distance from the centre of a place as a share of its width: well within its walls.
const PLACE_DISTANCE: f64 = 0.35;

/// z is up where the scene is lowest along z, and lower than this share of its length along y. (Empirical: places on an
/// xy ground have up to 0.26, objects that stand along y 0.33 and more.)
const LOW_ALONG_Z: f64 = 0.3;

/// Where the bulk of a scene is, however far its strays fly, and which way is up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Median of the centres, per axis.
    pub center: DVec3,
    /// Radius around `center` that holds the bulk of the scene: the 95th percentile of the distances, but at most
    /// four times their median. The second rules in captures whose background reaches many times farther than their
    /// subject; a captured guitar on its stand has 3.9.
    pub radius: f64,
    /// Lengths along x, y and z between the 10th and the 90th percentile of the centres.
    pub extent: DVec3,
    /// Whether the scene is one to walk around, as a statue; else it is a place to be in.
    pub is_object: bool,
    /// The likely upward direction: +z for what lies on an xy ground, else −y, as COLMAP leaves captures.
    pub up: DVec3,
}

impl Bounds {
    /// The bounds of `scene`.
    #[must_use]
    pub fn of(scene: &Scene) -> Self {
        let means = &scene.gaussians().means;
        let along = |share: f64| {
            DVec3::from_array(std::array::from_fn(|axis| {
                percentile(means[axis].iter().copied().map(f64::from).collect(), share)
            }))
        };
        let (center, extent) = (along(0.5), along(0.9) - along(0.1));
        let distances: Vec<f64> = (0..scene.gaussians().len())
            .map(|i| DVec3::from(scene.gaussians().mean(i).map(f64::from)).distance(center))
            .collect();
        let most = percentile(distances.clone(), 0.95);
        // A scene of a single point still needs a distance to look from.
        let radius = most.min(4.0 * percentile(distances, 0.5)).max(1e-3);
        let is_z_up = extent.z < extent.x && extent.z < LOW_ALONG_Z * extent.y;
        let (up, height) = if is_z_up { (DVec3::Z, extent.z) } else { (DVec3::NEG_Y, extent.y) };
        let is_object = height >= PLACE_HEIGHT * level_width(extent, up);
        Self { center, radius, extent, is_object, up }
    }
}

/// The smaller of the two level extents.
fn level_width(extent: DVec3, up: DVec3) -> f64 {
    if up.z != 0.0 { extent.x.min(extent.y) } else { extent.x.min(extent.z) }
}

/// A closed orbit of `frames` cameras (at least 1) at 30 frames per second that keeps `scene` in view: around an
/// object, all of it in the image; in a place, from within and across its middle.
///
/// # Errors
/// [`CameraError`] if the size is zero or too large.
pub fn around(scene: &Scene, frames: usize, width: u32, height: u32) -> Result<CameraPath, CameraError> {
    let Bounds { center, radius, extent, is_object, up } = Bounds::of(scene);
    let intrinsics = Intrinsics::from_fov_y(width, height, FOV_Y);
    let half_fov_x = (0.5 * f64::from(width) / intrinsics.fx).atan();
    let distance = if is_object {
        radius / half_fov_x.min(0.5 * FOV_Y).sin()
    } else {
        PLACE_DISTANCE * level_width(extent, up)
    };
    let side = up.any_orthonormal_vector();
    let forward = up.cross(side);
    let camera = |frame: usize| {
        let angle = TAU * frame as f64 / frames.max(1) as f64;
        let level = side * angle.cos() + forward * angle.sin();
        let eye = center + distance * (level * ELEVATION.cos() + up * ELEVATION.sin());
        look_at(eye, center, up, intrinsics)
    };
    Ok(CameraPath::cycle((0..frames.max(1)).map(camera).collect::<Result<_, _>>()?))
}

/// The camera at `eye` that looks at `target`, `up` pointing up in its image as far as possible.
///
/// # Errors
/// [`CameraError`] if `target` is `eye` or straight above or below it, or the intrinsics are not usable.
pub fn look_at(eye: DVec3, target: DVec3, up: DVec3, intrinsics: Intrinsics) -> Result<Camera, CameraError> {
    let forward = (target - eye).normalize();
    let right = forward.cross(up).normalize();
    let down = forward.cross(right);
    let view_from_world = DMat3::from_cols(right, down, forward).transpose();
    Camera::new(DAffine3 { matrix3: view_from_world, translation: -(view_from_world * eye) }, intrinsics)
}

/// The value below which `share` of `values` lie; 0 for none.
fn percentile(mut values: Vec<f64>, share: f64) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let index = (share * (values.len() - 1) as f64).round() as usize;
    *values.select_nth_unstable_by(index, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussians::Gaussians;
    use crate::scene::OpacityMode;

    /// A ball of Gaussians around `center`, and a share of strays a hundred times farther out.
    fn ball(center: DVec3, strays: bool) -> Scene {
        let count = 2_000;
        let mut g = Gaussians::zeroed(count, 0);
        for i in 0..count {
            let height = 2.0 * (i as f64 + 0.5) / count as f64 - 1.0;
            let (sin, cos) = (i as f64 * 2.399_963).sin_cos();
            let ring = (1.0 - height * height).sqrt();
            let far = if strays && i % 50 == 0 { 100.0 } else { ((i % 7) as f64 + 1.0) / 7.0 };
            let p = center + far * DVec3::new(ring * cos, ring * sin, height);
            for axis in 0..3 {
                g.means[axis][i] = p[axis] as f32;
                g.scales[axis][i] = 0.01;
            }
            g.rotations[0][i] = 1.0;
            g.opacities[i] = 0.5;
        }
        Scene::new(g, OpacityMode::Default).unwrap()
    }

    #[test]
    fn objects_stay_in_view_and_strays_do_not_matter() {
        let center = DVec3::new(3.0, -2.0, 5.0);
        for strays in [false, true] {
            let scene = ball(center, strays);
            let bounds = Bounds::of(&scene);
            assert!(bounds.is_object && bounds.center.distance(center) < 0.05, "{bounds:?}");
            assert!((0.8..1.3).contains(&bounds.radius), "{bounds:?}");
            for (width, height) in [(160, 90), (90, 160)] {
                let path = around(&scene, 12, width, height).unwrap();
                assert_eq!(path.cameras().len(), 12);
                for camera in path.cameras() {
                    let seen = (0..scene.gaussians().len()).filter(|i| {
                        let (pixel, z) =
                            camera.project(DVec3::from(scene.gaussians().mean(*i).map(f64::from)));
                        let [x, y] = [pixel.x / f64::from(width), pixel.y / f64::from(height)];
                        z > 0.2 && (0.0..1.0).contains(&x) && (0.0..1.0).contains(&y)
                    });
                    assert!(seen.count() as f64 > 0.95 * scene.gaussians().len() as f64);
                }
            }
        }
    }

    #[test]
    fn up_is_up_in_the_image() {
        let scene = crate::demo::scene().unwrap();
        let bounds = Bounds::of(&scene);
        assert!(bounds.up == DVec3::Z && !bounds.is_object, "{bounds:?}");
        for camera in around(&scene, 5, 160, 90).unwrap().cameras() {
            let low = camera.project(DVec3::ZERO).0;
            let high = camera.project(DVec3::new(0.0, 0.0, 1.0)).0;
            assert!(high.y < low.y && (high.x - low.x).abs() < 5.0);
        }
    }

    #[test]
    fn a_single_gaussian_can_be_orbited() {
        let mut g = Gaussians::zeroed(1, 0);
        g.rotations[0][0] = 1.0;
        g.opacities[0] = 1.0;
        let scene = Scene::new(g, OpacityMode::Default).unwrap();
        assert_eq!(around(&scene, 3, 64, 64).unwrap().cameras().len(), 3);
        assert!(around(&scene, 3, 0, 64).is_err());
    }
}
