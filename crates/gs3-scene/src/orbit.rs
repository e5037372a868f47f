//! Generated camera paths for scenes that come without one.

mod matter;
mod place;

use std::f64::consts::{PI, TAU};

use glam::{DAffine3, DMat3, DVec2, DVec3};

use crate::camera::{Camera, CameraError, Intrinsics, NEAR};
use crate::camera_path::CameraPath;
use crate::scene::Scene;
use matter::Matter;
use place::{Frame, Ring};

/// Vertical field of view of generated paths: 50°, about as a normal lens held upright.
const FOV_Y: f64 = 50.0 * PI / 180.0;

/// Height of the camera over the horizon of an object's centre: 15°, from where both tops and sides of it show.
const ELEVATION: f64 = 15.0 * PI / 180.0;

/// Room around an object, as a factor on the distance from which it just fills the image.
const MARGIN: f64 = 1.05;

/// A scene surrounds its middle if what lies beyond twice the radius of its bulk hides at least this share of all
/// directions from there. (Measured: captured objects and cut-out grounds at most 0.001, rooms and gardens at least 1.)
const SURROUNDED: f64 = 0.3;

/// A scene that is lower than this share of its width is a place (a room, a street, a lawn), too.
const PLACE_HEIGHT: f64 = 0.4;

/// Strays are farther from the middle than this many times the median distance. (A captured guitar on its stand has
/// 4.4.)
const STRAY: f64 = 5.0;

/// A place is looked at from within if its radius is at least this many times as far as the near plane; most of a
/// smaller one would be before the plane.
const PLACE_RADIUS: f64 = 4.0;

/// The near plane [`NEAR`] is for scenes with at least this median distance of centres from their middle, in world
/// units. In smaller scenes the near plane is nearer in proportion. (Captures in the unit of their camera tracks are
/// larger.)
const USUAL_SIZE: f64 = 0.5;

/// Percentiles are taken over at most this many Gaussians, evenly spread over the scene.
const SAMPLE: usize = 1 << 17;

/// z is up where the scene is lowest along z, and lower than this share of its length along y. (Empirical: places on an
/// xy ground have up to 0.26, objects that stand along y 0.33 and more.)
const LOW_ALONG_Z: f64 = 0.3;

/// Where the bulk of a scene is, however far its strays fly, and which way is up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bulk {
    /// Median of the centres, per axis.
    pub center: DVec3,
    /// Radius around `center` that holds the bulk of the scene: the 95th percentile of the distances, but at most
    /// five times their median. The limit matters in captures with a background many times farther away than the
    /// subject.
    pub radius: f64,
    /// Lengths along x, y and z between the 10th and the 90th percentile of the centres.
    pub extent: DVec3,
    /// Whether the scene is one to walk around, as a statue; else it is a place to be in.
    pub is_object: bool,
    /// The upward direction: what the scene's file states; else the likely one, +z for what lies on an xy ground and −y,
    /// as COLMAP leaves captures, elsewhere.
    pub up: DVec3,
}

impl Bulk {
    /// The bulk of `scene`.
    #[must_use]
    pub fn of(scene: &Scene) -> Self {
        Survey::of(scene).bulk
    }
}

/// The bulk and what it was found from.
struct Survey {
    bulk: Bulk,
    /// Centres of a sample of the Gaussians that are no strays.
    subject: Vec<DVec3>,
    /// The scene's near plane.
    near: f64,
}

impl Survey {
    fn of(scene: &Scene) -> Self {
        let sample = sample(scene);
        let center = along(&sample, 0.5);
        let extent = along(&sample, 0.9) - along(&sample, 0.1);
        let distances: Vec<f64> = sample.iter().map(|p| p.distance(center)).collect();
        let most = percentile(distances.clone(), 0.95);
        // A scene of a single point still needs a distance to look from.
        let limit = (STRAY * percentile(distances, 0.5)).max(1e-3);
        let radius = most.clamp(1e-3, limit);
        let subject: Vec<DVec3> = sample.into_iter().filter(|p| p.distance(center) <= limit).collect();
        let is_z_up = extent.z < extent.x && extent.z < LOW_ALONG_Z * extent.y;
        let up = scene.details().up.unwrap_or(if is_z_up { DVec3::Z } else { DVec3::NEG_Y });
        let size = along(&subject, 0.99) - along(&subject, 0.01);
        let is_low = size.dot(up).abs() < PLACE_HEIGHT * level_extent(size, up);
        let is_object = !is_low && surroundings(scene, center, 2.0 * radius) < SURROUNDED;
        let near = f64::from(scene.details().near);
        Self { bulk: Bulk { center, radius, extent, is_object, up }, subject, near }
    }

    /// Centre of the box around an object, and the distance at which the whole object is in the image from every
    /// side, with no part before the near plane.
    fn around_object(&self, frame: &Frame) -> (DVec3, f64) {
        let [low, high] = [0.005, 0.995].map(|share| along(&self.subject, share));
        let center = 0.5 * (low + high);
        let height = 0.5 * (high - low).dot(frame.up).abs();
        let level = |p: &DVec3| (*p - center).reject_from_normalized(frame.up).length();
        let width = percentile(self.subject.iter().map(level).collect(), 0.99);
        // A cylinder, seen under an elevation ε: points at `a` towards the camera, `l` aside and `y` up have the depth
        // D − a cos ε − y sin ε, and are l and y cos ε − a sin ε from the image's middle.
        let (sin, cos) = ELEVATION.sin_cos();
        let [half_width, half_height] = frame.half_size;
        let rims = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)].map(|(a, y)| {
            let (a, y) = (a * width, y * height);
            a * cos + y * sin + (y * cos - a * sin).abs() / half_height
        });
        let sides = height * sin + width * DVec2::new(cos, 1.0 / half_width).length();
        let fitting = MARGIN * rims.into_iter().fold(sides, f64::max);
        (center, fitting.max(self.near + DVec2::new(width, height).length()).max(1e-3))
    }

    /// A ring within a place.
    fn within_place(&self, scene: &Scene, frame: &Frame) -> Option<Ring> {
        /// Centres that are tried, along each level axis and up.
        const CENTERS: [usize; 2] = [9, 10];
        let [low, high] = [0.05, 0.95].map(|share| along(&self.subject, share));
        let extent = level_extent(high - low, frame.up);
        let matter = Matter::of(scene, low - 0.5 * (high - low), high + 0.5 * (high - low));
        // Level: where most is. Up: evenly, since heads are where little is.
        let level = |axis: DVec3, k: usize| {
            let share = 0.1 + 0.8 * k as f64 / (CENTERS[0] - 1) as f64;
            axis * percentile(self.subject.iter().map(|p| p.dot(axis)).collect(), share)
        };
        let up = |k: usize| {
            let share = (k + 1) as f64 / (CENTERS[1] + 1) as f64;
            low.lerp(high, share).project_onto_normalized(frame.up)
        };
        let axes = frame.level.map(|axis| (0..CENTERS[0]).map(|k| level(axis, k)).collect::<Vec<_>>());
        let mut centers = Vec::new();
        for (x, y) in axes[0].iter().flat_map(|x| axes[1].iter().map(move |y| (x, y))) {
            centers.extend((0..CENTERS[1]).map(|k| *x + *y + up(k)));
        }
        Ring::best(&matter, frame, &centers, extent)
    }
}

/// The share of all directions from `center` that the scene beyond `distance` would hide, were it not for overlaps.
fn surroundings(scene: &Scene, center: DVec3, distance: f64) -> f64 {
    let gaussians = scene.gaussians();
    let solid_angle = |i: usize| {
        let squared = DVec3::from(gaussians.mean(i).map(f64::from)).distance_squared(center);
        let is_far = squared > distance * distance;
        let area = matter::area(gaussians.scale(i)) * f64::from(gaussians.opacities[i]);
        if is_far { (area / squared).min(TAU) } else { 0.0 }
    };
    (0..gaussians.len()).map(solid_angle).sum::<f64>() / (2.0 * TAU)
}

/// Centres of evenly spread Gaussians.
fn sample(scene: &Scene) -> Vec<DVec3> {
    let count = scene.gaussians().len();
    let mean = |i: usize| DVec3::from(scene.gaussians().mean(i).map(f64::from));
    (0..count).step_by(count.div_ceil(SAMPLE).max(1)).map(mean).collect()
}

/// The near plane for `scene`, view-space z in world units: [`NEAR`], or nearer in proportion for scenes so small that
/// a camera that fills its image with one would have part of it before that plane.
#[must_use]
pub fn near_plane(scene: &Scene) -> f32 {
    let sample = sample(scene);
    let center = along(&sample, 0.5);
    let usual = percentile(sample.iter().map(|p| p.distance(center)).collect(), 0.5);
    // A scene of a single point has no size to go by.
    let share = if usual > 0.0 { (usual / USUAL_SIZE).min(1.0) } else { 1.0 };
    (f64::from(NEAR) * share).max(f64::from(f32::MIN_POSITIVE)) as f32
}

/// The smaller of the two level extents, where up is nearest to an axis.
fn level_extent(extent: DVec3, up: DVec3) -> f64 {
    let DVec3 { x, y, z } = up.abs();
    match () {
        () if z >= x.max(y) => extent.x.min(extent.y),
        () if y >= x => extent.x.min(extent.z),
        () => extent.y.min(extent.z),
    }
}

/// A closed orbit of `frames` cameras (at least 1) at 30 frames per second that keeps `scene` in view: around an
/// object, all of it in the image; in a place, across a free part of it.
///
/// # Errors
/// [`CameraError`] if the size is zero or too large.
pub fn around(scene: &Scene, frames: usize, width: u32, height: u32) -> Result<CameraPath, CameraError> {
    let intrinsics = Intrinsics::from_fov_y(width, height, FOV_Y);
    let survey = Survey::of(scene);
    let up = survey.bulk.up;
    let side = up.any_orthonormal_vector();
    let half_size = [0.5 * f64::from(width) / intrinsics.fx, 0.5 * f64::from(height) / intrinsics.fy];
    let frame = Frame { up, level: [side, up.cross(side)], half_size };
    // A place that is full everywhere is looked at from without, too.
    let is_seen_from_within = !survey.bulk.is_object && survey.bulk.radius >= PLACE_RADIUS * survey.near;
    let ring = if is_seen_from_within { survey.within_place(scene, &frame) } else { None };
    let (center, distance) = survey.around_object(&frame);
    let view = |share: f64| match &ring {
        Some(ring) => ring.view(&frame, share),
        None => {
            let outward = frame.direction(share) * ELEVATION.cos() + up * ELEVATION.sin();
            (center + distance * outward, center)
        }
    };
    let camera = |k: usize| {
        let (eye, target) = view(k as f64 / frames.max(1) as f64);
        look_at(eye, target, up, intrinsics)
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

/// The point below which `share` of `points` lie along each axis; 0 for none.
fn along(points: &[DVec3], share: f64) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|axis| percentile(points.iter().map(|p| p[axis]).collect(), share)))
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
            let bulk = Bulk::of(&scene);
            assert!(bulk.is_object && bulk.center.distance(center) < 0.05, "{bulk:?}");
            assert!((0.8..1.3).contains(&bulk.radius), "{bulk:?}");
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
    fn the_bulk_of_small_scenes_is_beyond_the_near_plane() {
        for (size, flatness) in [(0.01_f32, 1.0_f32), (0.1, 1.0), (0.1, 0.05)] {
            let mut g = ball(DVec3::ZERO, false).into_gaussians();
            for (axis, flat) in [1.0, 1.0, flatness].into_iter().enumerate() {
                g.means[axis].iter_mut().for_each(|v| *v *= size * flat);
                g.scales[axis].iter_mut().for_each(|v| *v *= size);
            }
            let scene = Scene::new(g, OpacityMode::Default).unwrap();
            for camera in around(&scene, 6, 160, 90).unwrap().cameras() {
                let depth = |i| camera.project(DVec3::from(scene.gaussians().mean(i).map(f64::from))).1;
                let seen = (0..scene.gaussians().len()).filter(|i| depth(*i) > f64::from(NEAR)).count();
                assert!(seen * 100 >= scene.gaussians().len() * 99, "{size}, {flatness}: {seen}");
            }
        }
    }

    /// A room of 10 × 12 × 3 with walls of Gaussians, cupboards along two of them, a pillar in its middle, and a far
    /// sky.
    fn room() -> Scene {
        let mut points: Vec<(DVec3, f32)> = Vec::new();
        let steps = |from: f64, to: f64| {
            let count = ((to - from) / 0.2).round() as usize;
            (0..=count).map(move |k| from + 0.2 * k as f64)
        };
        let is_wall = |v: f64, low: f64, high: f64| (v - low).abs() < 0.1 || (v - high).abs() < 0.1;
        for (x, y) in steps(-5.0, 5.0).flat_map(|x| steps(-6.0, 6.0).map(move |y| (x, y))) {
            for z in steps(0.0, 3.0) {
                let wall = is_wall(x, -5.0, 5.0) || is_wall(y, -6.0, 6.0) || is_wall(z, 0.0, 3.0);
                let cupboard = (x < -3.5 || y > 5.0) && z < 2.0;
                let pillar = x.abs() < 0.8 && y.abs() < 0.8;
                if wall || cupboard || pillar {
                    points.push((DVec3::new(x, y, z), 0.12));
                }
            }
        }
        for k in 0..2_000 {
            let height = 2.0 * (f64::from(k) + 0.5) / 2_000.0 - 1.0;
            let (sin, cos) = (f64::from(k) * 2.399_963).sin_cos();
            let ring = (1.0 - height * height).sqrt();
            points.push((200.0 * DVec3::new(ring * cos, ring * sin, height), 10.0));
        }
        let mut g = Gaussians::zeroed(points.len(), 0);
        for (i, (p, scale)) in points.into_iter().enumerate() {
            for axis in 0..3 {
                g.means[axis][i] = p[axis] as f32;
                g.scales[axis][i] = scale;
            }
            g.rotations[0][i] = 1.0;
            g.opacities[i] = 0.9;
        }
        Scene::new(g, OpacityMode::Default).unwrap()
    }

    #[test]
    fn a_place_is_seen_from_free_points_within_it() {
        let scene = room();
        let bulk = Bulk::of(&scene);
        assert!(!bulk.is_object && bulk.up == DVec3::Z, "{bulk:?}");
        for camera in around(&scene, 40, 160, 90).unwrap().cameras() {
            let eye = camera.position();
            let is_inside = eye.abs().cmplt(DVec3::new(5.0, 6.0, 3.0)).all() && eye.z > 0.0;
            let nearest = (0..scene.gaussians().len())
                .map(|i| eye.distance(DVec3::from(scene.gaussians().mean(i).map(f64::from))))
                .fold(f64::INFINITY, f64::min);
            assert!(is_inside && nearest > 0.2, "{eye} with matter at {nearest}");
        }
    }

    #[test]
    fn up_is_up_in_the_image() {
        let scene = crate::demo::scene().unwrap();
        let bulk = Bulk::of(&scene);
        assert!(bulk.up == DVec3::Z && !bulk.is_object, "{bulk:?}");
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

    #[test]
    fn the_near_plane_follows_small_scenes() {
        let row = |step: f32| {
            let mut g = Gaussians::zeroed(101, 0);
            for i in 0..g.len() {
                (g.means[0][i], g.rotations[0][i]) = (i as f32 * step, 1.0);
            }
            near_plane(&Scene::new(g, OpacityMode::Default).unwrap())
        };
        // Half of a row of 101 lies within 25 steps of its middle.
        let least = 25.0 * 1e-3 / USUAL_SIZE as f32 * NEAR;
        assert!((row(1e-3) - least).abs() < 0.05 * least, "{}, expected {least}", row(1e-3));
        // Usual scenes, and those without a size.
        assert_eq!([row(1.0), row(0.0)], [NEAR; 2]);
    }

    #[test]
    fn opengl_looks_along_minus_z_with_y_up() {
        let pose = DAffine3::from_translation(DVec3::new(0.0, 0.0, -5.0));
        let intrinsics = Intrinsics::from_fov_y(64, 48, 1.0);
        let camera = Camera::from_opengl(pose, intrinsics).unwrap();
        let above = camera.project(DVec3::new(1.0, 1.0, 0.0));
        assert!(above.1 == 5.0 && above.0.x > 32.0 && above.0.y < 24.0, "{above:?}");
        let looked = look_at(DVec3::new(0.0, 0.0, 5.0), DVec3::ZERO, DVec3::Y, intrinsics).unwrap();
        assert!(camera.view_from_world().abs_diff_eq(looked.view_from_world(), 1e-12));
    }
}
