//! The frames that a history with exact blocks keeps: frames with a similar view to the current one.

use gs3_scene::Camera;

/// Number of frames that are always remembered, the current frame included.
const LEAST_REMEMBERED: usize = 4;

/// Distance of a camera from the current one at which its frame is dropped, as a share of the mean depth: 2.9° around
/// the scene. (Empirical, with a twentieth of the pixels exact: on an orbit of 1.2° a frame, 0.1 gains 0.3 dB over
/// 0.05 and takes half as long again; 0.2 loses 0.6 dB and takes twice as long. Slow dollies and pans reach none of
/// these distances.)
const MOST_VIEW_CHANGE: f32 = 0.05;

/// Number of frames to remember for `camera`, counted from the newest. Frames are dropped from the oldest on, as long
/// as their view has turned away too far. `past` are the frames' cameras and mean inverse depths (0 if unknown: such
/// a frame is never dropped), newest first.
pub(crate) fn count_remembered(past: &[(Camera, f32)], camera: &Camera) -> usize {
    let is_stale = |(then, mean_inverse_depth): &(Camera, f32)| {
        then.position().distance(camera.position()) as f32 * mean_inverse_depth > MOST_VIEW_CHANGE
    };
    let fresh = past.iter().rposition(|past| !is_stale(past)).map_or(0, |last| last + 1);
    fresh.max(past.len().min(LEAST_REMEMBERED - 1))
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DVec3};
    use gs3_scene::Intrinsics;

    use super::*;

    fn at(x: f64) -> Camera {
        let pose = DAffine3::from_translation(DVec3::new(-x, 0.0, 0.0));
        Camera::new(pose, Intrinsics::from_fov_y(64, 36, 1.0)).expect("valid")
    }

    /// Frames `step` apart before a wall at depth 2, newest first.
    fn past(count: usize, step: f64) -> Vec<(Camera, f32)> {
        (1..=count).map(|age| (at(-step * age as f64), 0.5)).collect()
    }

    #[test]
    fn frames_are_forgotten_by_how_far_the_view_has_turned() {
        let now = at(0.0);
        assert_eq!(count_remembered(&past(15, 0.0), &now), 15, "at rest all stay");
        assert_eq!(count_remembered(&past(15, 0.005), &now), 15);
        // 0.1 of the depth 2 is 0.05: ten steps of 0.0099.
        assert_eq!(count_remembered(&past(15, 0.0099), &now), 10);
        assert_eq!(count_remembered(&past(15, 1.0), &now), 3, "the least");
        assert_eq!(count_remembered(&past(2, 1.0), &now), 2);
        assert_eq!(count_remembered(&[], &now), 0);
        let unknown: Vec<_> = past(15, 1.0).into_iter().map(|(camera, _)| (camera, 0.0)).collect();
        assert_eq!(count_remembered(&unknown, &now), 15, "depths that are not known forget nothing");
    }
}
