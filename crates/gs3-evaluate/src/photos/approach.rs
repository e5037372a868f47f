//! The way to a photo: what a viewer has shown before the camera gets there.

use glam::{DMat3, DVec2, DVec3};
use gs3_raster::{Outputs, RasterError, RasterSettings, Rasterizer};
use gs3_scene::{Camera, CameraPath, GBuffer};

/// Farthest that the middle of what is seen moves from frame to frame, in pixels of the photo: a quick walk, as along
/// the camera paths of `docs/results.md`.
pub(super) const FASTEST: f64 = 8.0;

/// Depths of a photo are looked at on a lattice of this many rows and as many columns as its shape asks for.
const ROWS: u32 = 48;

/// The cameras of `count` frames that lead to `target`, which follows them, in order: along the smooth curve from the
/// nearest camera of `others` through `target` and on to the nearest on its other side, and no faster than
/// [`FASTEST`] by `depth`. Without `others` the camera rests at `target`.
pub(super) fn approach(target: &Camera, others: &[Camera], count: usize, depth: &Depth) -> Vec<Camera> {
    let [from, beyond] = neighbours(target, others, depth.typical);
    // Neighbours see with the target's lens: a photo of another size is another picture.
    let seen = |camera: &Camera| Camera::new(camera.view_from_world(), target.intrinsics()).ok();
    let keys: Vec<Camera> =
        [from.and_then(seen), Some(*target), beyond.and_then(seen)].into_iter().flatten().collect();
    let at_target = f64::from(u8::from(from.is_some()));
    let Ok(path) = CameraPath::new(keys, 1.0, false) else { return Vec::new() };
    let camera = |frames_before: f64, step: f64| path.at(at_target - frames_before * step);
    let mut step = at_target / count.max(1) as f64;
    // Motion is nearly linear in the step where steps are as short as this: two corrections are enough.
    for _ in 0..2 {
        let motion = depth.motion(target, &camera(1.0, step));
        if motion > FASTEST {
            step *= FASTEST / motion;
        }
    }
    (0..count).map(|k| camera((count - k) as f64, step)).collect()
}

/// The nearest camera to `target`, and the nearest of those on its other side.
fn neighbours<'a>(target: &Camera, others: &'a [Camera], typical: f64) -> [Option<&'a Camera>; 2] {
    let pose = |camera: &Camera| camera.world_from_view();
    let towards = |camera: &Camera| pose(camera).translation - pose(target).translation;
    // What is seen moves about as far by an angle as by a step of as many times its distance.
    let distance = |camera: &Camera| {
        towards(camera).length() + typical * angle_between(pose(camera).matrix3, pose(target).matrix3)
    };
    let nearest = |cameras: &mut dyn Iterator<Item = &'a Camera>| {
        cameras.min_by(|a, b| distance(a).total_cmp(&distance(b)))
    };
    // The target's own camera is among them, within rounding.
    let from = nearest(&mut others.iter().filter(|camera| distance(camera) > 1e-6 * typical));
    let way = from.map_or(DVec3::ZERO, &towards);
    [from, nearest(&mut others.iter().filter(|camera| towards(camera).dot(way) < 0.0))]
}

/// The angle of the rotation from one pose to another, radians.
fn angle_between(a: DMat3, b: DMat3) -> f64 {
    let trace = |m: DMat3| m.x_axis.x + m.y_axis.y + m.z_axis.z;
    ((trace(a.transpose() * b) - 1.0) / 2.0).clamp(-1.0, 1.0).acos()
}

/// How far what a photo shows is from its camera.
pub(super) struct Depth {
    /// Points of what is seen, world units.
    points: Vec<DVec3>,
    /// Their median depth; 1 where nothing is seen.
    typical: f64,
}

impl Depth {
    /// Looks at the scene of `rasterizer` from `camera`, on a lattice.
    ///
    /// # Errors
    /// [`RasterError`] if the frame cannot be rasterized.
    pub fn seen(rasterizer: &mut Rasterizer, camera: &Camera) -> Result<Self, RasterError> {
        let columns = (ROWS * camera.width()).div_ceil(camera.height());
        let small = camera.resized(columns, ROWS).unwrap_or(*camera);
        let mut gbuffer = GBuffer::default();
        rasterizer.rasterize(&small, &RasterSettings::new(Outputs::GBuffer), &mut gbuffer)?;
        let depths = gbuffer.geometry.as_ref().map_or(&[][..], |geometry| geometry.depth_median.data());
        let (mut points, mut distances) = (Vec::new(), Vec::new());
        for (i, depth) in depths.iter().map(|depth| f64::from(*depth)).enumerate() {
            if depth.is_finite() && depth > 0.0 {
                let (x, y) = (i % gbuffer.width(), i / gbuffer.width());
                points.push(small.unproject(DVec2::new(x as f64 + 0.5, y as f64 + 0.5), depth));
                distances.push(depth);
            }
        }
        Ok(Self { points, typical: median(distances).unwrap_or(1.0) })
    }

    /// Median distance in pixels that what is seen moves between the pictures of two cameras; 0 where nothing is seen.
    fn motion(&self, a: &Camera, b: &Camera) -> f64 {
        let moved = |point: &DVec3| {
            let [(a, in_front), (b, is_before)] = [a, b].map(|camera| {
                let (position, depth) = camera.project(*point);
                (position, depth > 0.0)
            });
            (in_front && is_before).then(|| a.distance(b))
        };
        median(self.points.iter().filter_map(moved).collect()).unwrap_or(0.0)
    }
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use glam::DAffine3;
    use gs3_scene::Intrinsics;

    use super::*;

    /// A camera at `x` that looks along z.
    fn camera(x: f64, width: u32) -> Camera {
        let pose = DAffine3::from_translation(DVec3::new(-x, 0.0, 0.0));
        let half = f64::from(width) / 2.0;
        Camera::new(pose, Intrinsics { width, height: width, fx: 100.0, fy: 100.0, cx: half, cy: half })
            .unwrap()
    }

    /// A wall at z = 5.
    fn wall() -> Depth {
        let points = (-10..=10).flat_map(|x| (-10..=10).map(move |y| DVec3::new(x.into(), y.into(), 5.0)));
        Depth { points: points.collect(), typical: 5.0 }
    }

    #[test]
    fn frames_lead_from_the_nearest_camera_on_one_line_to_the_photo() {
        let others = [camera(3.0, 64), camera(-0.4, 32), camera(1.0, 64), camera(0.0, 64), camera(-9.0, 64)];
        let way = approach(&camera(0.0, 64), &others, 16, &wall());
        assert_eq!(way.len(), 16);
        let x = |camera: &Camera| camera.position().x;
        assert!((x(&way[0]) + 0.4).abs() < 1e-9, "from the nearest camera that is another");
        for (k, frame) in way.iter().enumerate() {
            assert_eq!((frame.width(), frame.intrinsics().cx), (64, 32.0), "with the photo's own lens");
            let before = k.checked_sub(1).map_or(x(frame), |before| x(&way[before]));
            assert!(before <= x(frame) + 1e-9 && x(frame) < 0.0);
        }
    }

    #[test]
    fn a_far_neighbour_is_not_reached_by_leaps() {
        let target = camera(0.0, 64);
        let way = approach(&target, &[camera(-20.0, 64), camera(20.0, 64)], 16, &wall());
        // At a distance of 5 and 100 pixels of focal length a unit is 20 pixels.
        let steps: Vec<f64> = way.iter().chain([&target]).map(|camera| 20.0 * camera.position().x).collect();
        for pair in steps.windows(2) {
            let step = pair[1] - pair[0];
            assert!((0.8 * FASTEST..=1.01 * FASTEST).contains(&step), "{steps:?}");
        }
    }

    #[test]
    fn without_others_and_without_depth_it_still_gives_cameras() {
        let target = camera(0.0, 64);
        for others in [&[][..], &[target]] {
            let way = approach(&target, others, 4, &wall());
            assert!(way.len() == 4 && way.iter().all(|camera| *camera == target), "{others:?}");
        }
        let nothing = Depth { points: Vec::new(), typical: 1.0 };
        assert_eq!(approach(&target, &[camera(1.0, 64)], 4, &nothing).len(), 4);
    }
}
