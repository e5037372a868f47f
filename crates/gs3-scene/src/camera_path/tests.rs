use super::*;
use std::f64::consts::{FRAC_PI_2, TAU};

fn camera(center: DVec3, angle: f64) -> Camera {
    let world_from_view = DMat3::from_rotation_y(angle);
    camera_at(world_from_view, center, Intrinsics::from_fov_y(64, 36, 1.0)).unwrap()
}

fn circle(count: usize) -> CameraPath {
    let at = |k: usize| {
        let angle = TAU * k as f64 / count as f64;
        camera(DVec3::new(angle.cos(), 0.0, angle.sin()), angle)
    };
    CameraPath::new((0..count).map(at).collect(), 30.0, true).unwrap()
}

#[test]
fn keyframes_come_back_unchanged() {
    let path = circle(9);
    for k in 0..9 {
        assert_eq!(path.at(k as f64), path.cameras()[k]);
    }
    assert_eq!(path.at(9.0), path.cameras()[0]);
    assert_eq!(path.at(-1.0), path.cameras()[8]);
    assert_eq!(path.at(f64::NAN), path.cameras()[0]);
}

#[test]
fn spline_follows_the_circle_where_the_chord_leaves_it() {
    let path = circle(12);
    for k in 0..12 {
        let on_spline = path.at(k as f64 + 0.5).position().length();
        let on_chord =
            pose_between(&path.cameras()[k], &path.cameras()[(k + 1) % 12], 0.5).position().length();
        assert!((on_spline - 1.0).abs() < 2e-3, "{on_spline}");
        assert!((on_chord - 1.0).abs() > 3e-2, "{on_chord}");
    }
}

#[test]
fn spline_is_smooth_at_uneven_keyframes() {
    let centers = [0.0, 1.0, 1.1, 5.0, 5.05].map(|x: f64| DVec3::new(x, (3.0 * x).sin(), 0.5 * x * x));
    let path = CameraPath::new(centers.map(|c| camera(c, 0.0)).to_vec(), 30.0, false).unwrap();
    let h = 1e-6;
    for k in 1..4 {
        let k = k as f64;
        let before = (path.at(k).position() - path.at(k - h).position()).normalize();
        let after = (path.at(k + h).position() - path.at(k).position()).normalize();
        // The direction of travel is continuous; the speed in keyframe time is not, by design.
        assert!(before.dot(after) > 1.0 - 1e-4, "{before} {after}");
    }
}

#[test]
fn resting_cameras_stay_finite_and_at_rest() {
    let path = CameraPath::new(vec![camera(DVec3::ONE, 0.3); 4], 30.0, false).unwrap();
    assert!((path.at(1.5).position() - DVec3::ONE).length() < 1e-12);
    let smooth = path.smoothed(7, Pace::Speed);
    assert!(smooth.cameras().iter().all(|c| (c.position() - DVec3::ONE).length() < 1e-12));
    let rest_then_go = [0.0, 0.0, 1.0, 1.0].map(|x| camera(DVec3::new(x, 0.0, 0.0), 0.0)).to_vec();
    let path = CameraPath::new(rest_then_go, 30.0, false).unwrap();
    assert!((path.at(1.5).position().x - 0.5).abs() < 1e-9);
}

#[test]
fn middle_pose_halves_rotation_and_translation() {
    let (a, b) = (camera(DVec3::ZERO, 0.0), camera(DVec3::new(2.0, 4.0, 6.0), FRAC_PI_2));
    let middle = pose_between(&a, &b, 0.5);
    assert!((middle.position() - DVec3::new(1.0, 2.0, 3.0)).length() < 1e-12);
    let expected = DMat3::from_rotation_y(FRAC_PI_2 / 2.0);
    let difference = middle.world_from_view().matrix3 - expected;
    assert!(difference.to_cols_array().iter().all(|v| v.abs() < 1e-12));
}

#[test]
fn constant_speed_evens_out_distances() {
    let xs = [0.0, 0.1, 0.2, 3.0, 3.1];
    let path =
        CameraPath::new(xs.map(|x| camera(DVec3::new(x, 0.0, 0.0), 0.0)).to_vec(), 30.0, false).unwrap();
    let steps = |path: &CameraPath| -> Vec<f64> {
        path.cameras().windows(2).map(|w| w[0].position().distance(w[1].position())).collect()
    };
    let even = path.smoothed(21, Pace::Speed);
    let step = 3.1 / 20.0;
    assert!(steps(&even).iter().all(|s| (s - step).abs() < 0.01 * step), "{:?}", steps(&even));
    assert_eq!(even.cameras()[0], path.cameras()[0]);
    assert_eq!(even.cameras()[20], path.cameras()[4]);
    let keyed = path.smoothed(9, Pace::Keyframes);
    assert_eq!(keyed.cameras()[4], path.cameras()[2]);
}

/// What frames of `path` travel and turn, one after the other.
fn steps(path: &CameraPath) -> Vec<(f64, f64)> {
    let step = |pair: &[Camera]| {
        let [a, b] = [pair[0], pair[1]].map(|camera| camera.world_from_view().matrix3);
        (pair[0].position().distance(pair[1].position()), angle_between(a, b))
    };
    path.cameras().windows(2).map(step).collect()
}

/// A path along x of the keyframes (x, degrees about y), not at the origin, where positions round.
fn keyed(keyframes: &[(f64, f64)]) -> CameraPath {
    let at = |(x, yaw): &(f64, f64)| camera(DVec3::new(1.0 + x, 2.0, 3.0), yaw.to_radians());
    CameraPath::new(keyframes.iter().map(at).collect(), 30.0, false).unwrap()
}

#[test]
fn turns_in_place_are_spread_over_frames() {
    let path = keyed(&[(0.0, -40.0), (0.0, 20.0), (0.5, 20.0), (0.5, -20.0), (1.0, -20.0)]);
    let smooth = path.smoothed(101, Pace::Speed);
    // A length of 1 and a turning of 60° and 40°.
    let turning = 100_f64.to_radians();
    let radius = 1.0 / (turning + 1.0);
    let length = 1.0 + radius * turning;
    for (moved, turned) in steps(&smooth) {
        // Frames across a keyframe do a part of either.
        let share = (moved + radius * turned) / length;
        assert!((share - 0.01).abs() < 2e-4, "{moved} {turned}");
    }
    assert_eq!((smooth.cameras()[0], smooth.cameras()[100]), (path.cameras()[0], path.cameras()[4]));
}

#[test]
fn turns_change_nothing_where_the_path_travels_farther() {
    for path in [circle(12), keyed(&[(0.0, 0.0), (0.1, 1.0), (0.2, 1.0), (3.0, 25.0), (3.1, 25.0)])] {
        let straight = path.cameras().iter().map(|k| camera(k.position(), 0.0)).collect();
        let straight = CameraPath::new(straight, 30.0, path.is_cycle()).unwrap().smoothed(200, Pace::Speed);
        for (a, b) in path.smoothed(200, Pace::Speed).cameras().iter().zip(straight.cameras()) {
            assert!(a.position().distance(b.position()) < 1e-9, "{} {}", a.position(), b.position());
        }
    }
}

#[test]
fn a_path_that_only_turns_does_so_evenly() {
    let path = keyed(&[(0.0, 0.0), (0.0, 10.0), (0.0, 10.0), (0.0, 90.0)]);
    for (_, turned) in steps(&path.smoothed(10, Pace::Speed)) {
        assert!((turned.to_degrees() - 10.0).abs() < 1e-6, "{turned}");
    }
}

#[test]
fn refuses_paths_that_cannot_be_shown() {
    assert_eq!(CameraPath::new(vec![], 30.0, false), Err(CameraPathError::Empty));
    for fps in [0.0, -1.0, f64::INFINITY] {
        let path = CameraPath::new(vec![camera(DVec3::ZERO, 0.0)], fps, false);
        assert_eq!(path, Err(CameraPathError::FramesPerSecond { actual: fps }));
    }
}
