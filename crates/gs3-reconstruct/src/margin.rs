//! Which of its surroundings a frame is rasterized with.

use glam::DVec2;
use gs3_scene::{BLOCK_SIDE, Camera, Margin, glam};

use crate::depth_lattice::{DepthLattice, SKY};

/// Frames ahead of the one being made whose new parts are rasterized already. A history of S² frames would use more;
/// measured at scale 4, in-between frames gain 2.09 and 2.16 dB with 4 and 8 frames ahead, 2.18 with 15 and margins
/// twice as wide (`docs/performance.md`).
const FRAMES_AHEAD: f64 = 8.0;

/// Points of the lattice so near an edge, in parts of the picture, tell how what lies there moves.
const NEAR_EDGE: f64 = 0.25;

/// LR pixels that the rounding of projections may seem to move what rests: it must not have a margin.
const NO_MOTION: f64 = 0.01;

/// LR pixels beyond the edges that the next frames show if the camera goes on as it moved from `previous`, whose
/// depths are `depths`, to `camera`, `scale` times larger than LR frames: at most `widest` on a side, none
/// where it rests.
#[must_use]
pub fn margin_ahead(
    previous: &Camera,
    camera: &Camera,
    depths: &DepthLattice,
    scale: u32,
    widest: u32,
) -> Margin {
    let size = DVec2::new(f64::from(camera.width()), f64::from(camera.height()));
    // Of what lies near the left, top, right, bottom edge, the fastest that moves inwards, HR pixels per frame.
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
    // What is negative becomes 0.
    let pixels =
        |moved: f64| ((moved * FRAMES_AHEAD / f64::from(scale) - NO_MOTION).ceil() as u32).min(widest);
    let [left, top, right, bottom] = inwards.map(pixels);
    Margin { left, top, right, bottom }
}

/// `margin` with its left and top side widened until it begins at a block of exact pixels, as rasterizers that make these
/// ask for; narrowed where it would be wider than `widest`.
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

    /// At `x`, turned right by `angle`, before a wall at depth 4.
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
