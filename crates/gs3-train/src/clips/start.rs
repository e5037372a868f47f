//! Where cameras start: poses near given camera paths.

use glam::{DAffine3, DQuat, DVec3};
use gs3::scene::{Camera, CameraPath};

use super::draw::Draw;

/// Between the parts of a path for training and for held-out clips, and at a cycle's seam, this share of it is left
/// out.
const GAP: f64 = 0.02;

/// Largest turns about what is seen, in degrees: sideways and up.
const AROUND: [f64; 2] = [30.0, 15.0];

/// Least and largest factor on the distance to what is seen.
const DISTANCE: [f64; 2] = [0.5, 1.4];

/// Largest turns of the camera in its place, in degrees: sideways, up and about its axis.
const LOOK: [f64; 3] = [12.0, 8.0, 8.0];

/// A camera of one of `paths`: of their first part for training, of their last part, the share `held_out`, if
/// `is_held_out`. None if there is no path.
pub(super) fn draw(
    draw: &mut Draw,
    paths: &[CameraPath],
    held_out: f64,
    is_held_out: bool,
) -> Option<Camera> {
    let path = paths.get(draw.below(paths.len()))?;
    let count = path.cameras().len() as f64;
    let length = if path.is_cycle() { count } else { count - 1.0 };
    let (first, last) = match is_held_out {
        true => (1.0 - held_out, 1.0),
        false if held_out > 0.0 => (0.0, 1.0 - held_out - GAP),
        false => (0.0, 1.0),
    };
    let last = if held_out > 0.0 && path.is_cycle() && is_held_out { last - GAP } else { last };
    Some(path.at(length * draw.uniform(first, last.max(first))))
}

/// A pose near `world_from_view`, from where something is seen at `distance`.
pub(super) fn vary(draw: &mut Draw, world_from_view: DAffine3, distance: f64) -> DAffine3 {
    // From hardly at all to as far as it goes.
    let strength = draw.uniform(0.0, 1.0);
    let turn = |axis: DVec3, degrees: f64| DAffine3::from_axis_angle(axis, degrees.to_radians());
    let mut up_to = |largest: f64| strength * draw.uniform(-largest, largest);
    let around = turn(DVec3::Y, up_to(AROUND[0])) * turn(DVec3::X, up_to(AROUND[1]));
    let look =
        turn(DVec3::Y, up_to(LOOK[0])) * turn(DVec3::X, up_to(LOOK[1])) * turn(DVec3::Z, up_to(LOOK[2]));
    let factor = draw.log_uniform(DISTANCE[0], DISTANCE[1]).powf(strength);
    let target = DVec3::Z * distance;
    let varied = world_from_view
        * DAffine3::from_translation(target)
        * around
        * DAffine3::from_translation(-factor * target)
        * look;
    // Products of rotations drift off by rounding only; this keeps it from adding up.
    DAffine3::from_rotation_translation(DQuat::from_mat3(&varied.matrix3).normalize(), varied.translation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs3::scene::Intrinsics;

    #[test]
    fn held_out_starts_are_apart() {
        let camera = |x: f64| {
            let pose = DAffine3::from_translation(DVec3::new(-x, 0.0, 0.0));
            Camera::new(pose, Intrinsics::from_fov_y(64, 64, 1.0)).unwrap()
        };
        for is_cycle in [false, true] {
            let cameras = (0..=100).map(|k| camera(f64::from(k))).collect();
            let path = [CameraPath::new(cameras, 30.0, is_cycle).unwrap()];
            let mut random = Draw::new(1);
            let mut range = |is_held_out: bool| {
                let places = (0..500).map(|_| {
                    let camera = draw(&mut random, &path, 0.1, is_held_out).unwrap();
                    camera.position().x
                });
                places.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], x| [a.min(x), b.max(x)])
            };
            let (training, held_out) = (range(false), range(true));
            assert!(training[0] < 1.0 && training[1] > 85.0, "{training:?}");
            assert!(held_out[0] - training[1] > 1.5 && held_out[1] > 97.0, "{training:?} {held_out:?}");
        }
        assert!(draw(&mut Draw::new(1), &[], 0.1, true).is_none());
    }

    #[test]
    fn varied_poses_see_the_same() {
        let mut draw = Draw::new(5);
        let pose = DAffine3::from_rotation_translation(
            DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 0.7),
            DVec3::new(4.0, -3.0, 2.0),
        );
        let target = pose.transform_point3(DVec3::Z * 5.0);
        for _ in 0..300 {
            let seen = vary(&mut draw, pose, 5.0).inverse().transform_point3(target);
            assert!((2.4..7.1).contains(&seen.length()), "{seen}");
            assert!(seen.z > 0.95 * seen.length(), "{seen}");
        }
    }
}
