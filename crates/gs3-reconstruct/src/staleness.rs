//! The frames and exact blocks that a history with exact blocks keeps. Frames are forgotten once the view has turned away or the
//! picture has moved.

use gs3_scene::Camera;

use crate::reprojection::Reprojection;

/// Number of frames that are always remembered, the current frame included.
const LEAST_REMEMBERED: usize = 4;

/// Distance of a camera from the current one at which its frame is dropped, as a share of the mean depth: 6° around the
/// scene. (Empirical, with 6 % of the pixels exact, frames 10 to 22: 0.05, 0.07, 0.1, 0.14 give 36.61, 36.86, 37.02, 37.02 dB on
/// the demo's orbit at 1280×720, and 32.58, 32.58, 32.65, 32.47 dB on `flowers_orbit`. With 0.1 instead of 0.07, and
/// four frames of blocks, super sampling takes 6 and 17 % longer, frames 1 to 30. Drifts, slow dollies and pans reach none of these distances.)
const MOST_VIEW_CHANGE: f32 = 0.1;

/// The jitter's positions over the LR frames that stay when the picture has moved, the current frame included. A view that has
/// turned away forgets more of them. (Empirical at scale 4, dB more than with sixteen frames, frames 1 to 30 of
/// `flowers_drift`, `fungi_drift`, `fungi_pan`, `lacadiere_drift`, `lacadiere_pan`, `hqgarden_drift`, `hqgarden_pan`: eight
/// frames gain 0.5, 0.4, 1.0, 0.2, 0.4, −0.2, −0.3, and super sampling takes a third less time. Five frames gain 0.8, 0.6, 1.7,
/// −0.1, 0.3, −1.6, −1.2. At 1280×720 eight frames gain 1.0 on `fungi_pan` and −0.8 on `hqgarden_pan`. On pans of 4 to
/// 18 px a frame eight frames gain 0.2 to 1.2 in `fungi` and −0.5 to 0.0 in `hqgarden`.)
const POSITIONS_PER_FRAME_IN_MOTION: usize = 2;

/// Number of frames to remember for `camera`, counted from the newest. Frames are dropped from the oldest on, as long
/// as their view has turned away too far, or the picture has moved too far. `past` are the frames' cameras and mean inverse
/// depths (0 if unknown, as if infinitely far away), newest first. `positions` is the number of the jitter's positions.
pub(crate) fn count_remembered(past: &[(Camera, f32)], camera: &Camera, positions: usize) -> usize {
    let in_motion = (positions / POSITIONS_PER_FRAME_IN_MOTION).saturating_sub(1);
    let is_stale = |age: usize, (then, mean_inverse_depth): &(Camera, f32)| {
        let change = then.position().distance(camera.position()) as f32 * mean_inverse_depth;
        change > MOST_VIEW_CHANGE || age > in_motion && has_moved(then, *mean_inverse_depth, camera)
    };
    let fresh = (1..=past.len()).rev().find(|age| !is_stale(*age, &past[age - 1])).unwrap_or(0);
    fresh.max(past.len().min(LEAST_REMEMBERED - 1))
}

/// Number of past frames with exact blocks that are always remembered. (Empirical, dB more than with four, frames 10 to 22:
/// six gain 0.4 on `hqgarden_pan`, 0.1 on `demo` and `lacadiere_pan`, 0.0 on `flowers_drift` and `hqgarden_drift`, −0.1 on
/// `fungi_drift`. Eight gain 0.1 more on hqgarden alone.)
const LEAST_BLOCK_FRAMES: usize = 6;

/// Distance that a corner of the picture, at the mean depth, has moved when a frame or its blocks are dropped, as a share of
/// the picture's width. A splat's footprint changes as the splat moves in the picture, and sixteen samples of a block err
/// alike, so the few newer samples around them do not outweigh them. (Empirical, with at least four frames of blocks, dB more
/// than with all blocks of sixteen frames, frames 1 to 33 of `fungi_drift`, `hqgarden_drift`, `lacadiere_drift`,
/// `flowers_drift`, where 0.03 is five frames: 0.03 gains 0.5, −0.1, 0.3, 0.6; 0.05 gains 0.3, 0.1, 0.2, 0.2. On pans of 22 to 35 px a frame four frames gain 0.0 to 1.1
/// dB. On a pan of 8 px a frame 0.03 and sixteen frames are alike, and four frames lose 0.4 dB. At rest nothing is dropped.)
const MOST_SHIFT: f32 = 0.03;

/// Whether exact blocks are to be dropped that were made `age` frames ago for the camera `then`, at a mean inverse depth.
pub(crate) fn are_blocks_stale(age: usize, then: &Camera, mean_inverse_depth: f32, now: &Camera) -> bool {
    age > LEAST_BLOCK_FRAMES && has_moved(then, mean_inverse_depth, now)
}

/// Whether a corner of the picture, at a mean inverse depth, has moved by more than [`MOST_SHIFT`].
fn has_moved(then: &Camera, mean_inverse_depth: f32, now: &Camera) -> bool {
    let reprojection = Reprojection::new(then, now);
    let [width, height] = now.size().to_array().map(|side| side as f32);
    let has_moved = |[x, y]: [f32; 2]| {
        let [u, v, q] = reprojection.apply([x, y], mean_inverse_depth);
        q <= 0.0 || (u - x).hypot(v - y) > MOST_SHIFT * width
    };
    [[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]].into_iter().any(has_moved)
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

    fn turned(degrees: f64) -> Camera {
        let pose = DAffine3::from_rotation_y(degrees.to_radians());
        Camera::new(pose, Intrinsics::from_fov_y(64, 36, 1.0)).expect("valid")
    }

    #[test]
    fn blocks_are_forgotten_by_how_far_the_picture_has_moved() {
        let is_stale = |age: usize, then: &Camera| are_blocks_stale(age, then, 0.5, &at(0.0));
        assert!(!is_stale(15, &at(0.0)), "at rest all stay");
        // 3 % of 64 px are 1.92 px. With a focal length of 32.96 px: 0.1165 of the depth 2, and 1.6° at the corners.
        assert!(!is_stale(7, &at(0.110)) && is_stale(7, &at(0.123)));
        assert!(!is_stale(7, &turned(1.5)) && is_stale(7, &turned(1.75)));
        assert!(!is_stale(6, &turned(40.0)), "the least");
        assert!(is_stale(7, &turned(180.0)), "behind the camera");
    }

    #[test]
    fn frames_are_forgotten_by_how_far_the_view_has_turned() {
        let now = at(0.0);
        let remembered = |past: &[(Camera, f32)]| count_remembered(past, &now, 16);
        assert_eq!(remembered(&past(15, 0.0)), 15, "at rest all stay");
        assert_eq!(remembered(&past(15, 0.005)), 15);
        // 0.2 is 0.1 of the depth 2: six steps of 0.03.
        assert_eq!(remembered(&past(15, 0.03)), 6);
        // The picture moves by 3 % of its width at 0.1165. Eleven steps of 0.0105 do not reach it. Seven steps of 0.0172 pass it,
        // and seven frames stay.
        assert_eq!([0.0105, 0.0172].map(|step| remembered(&past(15, step))), [11, 7]);
        // Half of the positions of other scales, if the picture has not moved so far before. At 0.0125 a step the picture has moved
        // after nine steps, and no view turns away.
        assert_eq!([4, 9].map(|positions| count_remembered(&past(15, 0.0172), &now, positions)), [6, 6]);
        assert_eq!(count_remembered(&past(15, 0.0125), &now, 25), 11);
        assert_eq!(remembered(&past(15, 1.0)), 3, "the least");
        assert_eq!(remembered(&past(2, 1.0)), 2);
        assert_eq!(remembered(&[]), 0);
        let turning = |degrees: f64| {
            let past: Vec<_> = (1..=15).map(|age| (turned(degrees * f64::from(age)), 0.5)).collect();
            count_remembered(&past, &turned(0.0), 16)
        };
        // The corners move by 3 % of the width between 1.5° and 1.9°.
        assert_eq!(
            [0.1, 0.19, 0.24, 0.5, 20.0].map(turning),
            [15, 8, 7, 7, 7],
            "turning about its own centre"
        );
        let unknown: Vec<_> = past(15, 1.0).into_iter().map(|(camera, _)| (camera, 0.0)).collect();
        assert_eq!(remembered(&unknown), 15, "frames of unknown depth are not forgotten for walking");
        let unknown: Vec<_> = (1..=15).map(|age| (turned(0.5 * f64::from(age)), 0.0)).collect();
        assert_eq!(count_remembered(&unknown, &turned(0.0), 16), 7, "but for turning");
    }
}
