//! The margin that a frame is rasterized with.

use glam::DVec2;
use gs3_scene::{BLOCK_SIDE, Camera, Margin, glam};

use crate::depth_lattice::{DepthLattice, SKY};

/// Number of future frames that the margin is made for. A history of S² frames would use more. Measured at scale 4:
/// in-between frames gain 2.09 and 2.16 dB with 4 and 8 frames ahead, and 2.18 with 15 and margins twice as wide
/// (`docs/performance.md`).
const FRAMES_AHEAD: f64 = 8.0;

/// Lattice points within this distance of an edge, as a fraction of the picture, show the motion near that edge.
const NEAR_EDGE: f64 = 0.25;

/// Motion in LR pixels up to which the picture counts as resting: rounding of projections. A resting picture has no
/// margin.
const NO_MOTION: f64 = 0.01;

/// The margin, in LR pixels, that comes into view in the next frames if the camera keeps moving as it moved from
/// `previous` to `camera`. `depths` are the depths of `previous`. HR frames are `scale` times larger than LR frames.
/// The margin has at most `widest` pixels a side, and none for a resting camera.
#[must_use]
pub fn margin_ahead(
    previous: &Camera,
    camera: &Camera,
    depths: &DepthLattice,
    scale: u32,
    widest: u32,
) -> Margin {
    let size = DVec2::new(f64::from(camera.width()), f64::from(camera.height()));
    // Near the left, top, right and bottom edge: the fastest inward motion, in HR pixels per frame.
    let mut inwards = [0.0_f64; 4];
    for (at, depth) in depths.points() {
        let then = at * size;
        let (now, z) = camera.project(previous.unproject(then, if depth > 0.0 { depth } else { SKY }));
        let moved = now - then;
        if z <= 0.0 || !moved.is_finite() {
            continue;
        }
        let sides = [(at.x, moved.x), (at.y, moved.y), (1.0 - at.x, -moved.x), (1.0 - at.y, -moved.y)];
        for (most, (to_edge, moved)) in inwards.iter_mut().zip(sides) {
            if to_edge < NEAR_EDGE {
                *most = most.max(moved);
            }
        }
    }
    // Negative values become 0.
    let pixels =
        |moved: f64| ((moved * FRAMES_AHEAD / f64::from(scale) - NO_MOTION).ceil() as u32).min(widest);
    let [left, top, right, bottom] = inwards.map(pixels);
    Margin { left, top, right, bottom }
}

/// `margin` with its left and top side widened to start at a block of exact pixels, as rasterizers of such blocks
/// require. A side that would become wider than `widest` is narrowed instead.
pub(crate) fn whole_blocks(margin: Margin, scale: u32, widest: u32) -> Margin {
    let is_whole = |side: &u32| (side * scale).is_multiple_of(BLOCK_SIDE as u32);
    let widened =
        |side: u32| (side..=widest).find(is_whole).or_else(|| (0..=side).rfind(is_whole)).unwrap_or(0);
    Margin { left: widened(margin.left), top: widened(margin.top), ..margin }
}

#[cfg(test)]
mod tests {
    use gs3_scene::Intrinsics;
    use gs3_scene::glam::{DAffine3, DMat3, DVec3};

    use super::*;

    const WIDEST: u32 = 32;

    /// A camera at `x`, turned right by `angle`, before a wall at depth 4.
    fn camera(x: f64, angle: f64) -> Camera {
        let intrinsics = Intrinsics { width: 320, height: 160, fx: 200.0, fy: 200.0, cx: 160.0, cy: 80.0 };
        let world_from_view =
            DAffine3::from_mat3_translation(DMat3::from_rotation_y(angle), DVec3::new(x, 0.0, 0.0));
        Camera::new(world_from_view.inverse(), intrinsics).unwrap()
    }

    #[test]
    fn margins_begin_at_blocks() {
        for scale in 1..=8 {
            for side in 0..=32 {
                let widened = whole_blocks(Margin::all(side), scale, 32);
                assert_eq!((widened.left * scale % 4, widened.top * scale % 4), (0, 0));
                assert!((side..=side + 3).contains(&widened.left) && widened.left <= 32);
                let narrowed = whole_blocks(Margin::all(side), scale, side);
                assert!(narrowed.left <= side && (narrowed.left * scale).is_multiple_of(4));
                assert_eq!((widened.right, widened.bottom), (side, side));
            }
        }
    }

    const WALL: DepthLattice = DepthLattice([4.0; 25]);
    const SKY_ALONE: DepthLattice = DepthLattice([0.0; 25]);

    #[test]
    fn the_margin_lies_where_the_camera_turns_to() {
        let rest = camera(0.0, 0.0);
        assert_eq!(margin_ahead(&rest, &rest, &WALL, 4, WIDEST), Margin::NONE);
        // 200 px · 0.01 at depth 1 is 0.5 px at depth 4: a pixel of four in eight frames.
        let right = margin_ahead(&rest, &camera(0.01, 0.0), &WALL, 4, WIDEST);
        assert_eq!(right, Margin { right: 1, ..Margin::NONE });
        assert_eq!(margin_ahead(&rest, &camera(0.01, 0.0), &SKY_ALONE, 4, WIDEST), Margin::NONE);
        let turned = margin_ahead(&rest, &camera(0.0, 0.01), &SKY_ALONE, 4, WIDEST);
        assert_eq!((turned.left, turned.right), (0, 6), "2 px in the middle, 2.8 near the edge");
        assert_eq!(margin_ahead(&rest, &camera(0.0, -0.01), &SKY_ALONE, 4, WIDEST).left, 6);
        assert_eq!(margin_ahead(&rest, &camera(0.0, -0.5), &SKY_ALONE, 4, WIDEST).left, WIDEST);
    }
}
