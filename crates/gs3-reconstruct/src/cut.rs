//! Whether the camera jumped.

use glam::DVec2;
use gs3_scene::Camera;

use crate::depth_lattice::{DepthLattice, SKY};

/// Whether so little of the previous frame still shows that its history is worthless. A 5×5 lattice of the previous
/// frame's pixels is placed at their depths. It is a cut if fewer than a third of these points lie within the new
/// image and are seen from about the same side. The owner of the history resets it then, as [`crate::FrameSequence`]
/// does. (Empirical; a brisk pan of 3° a frame keeps nine tenths of the points, and no orbit turns by 30° from frame
/// to frame.)
#[must_use]
pub fn is_cut(previous: &Camera, camera: &Camera, lattice: &DepthLattice) -> bool {
    /// Cosine of 30°. Seen from farther around, a surface shows another side. This happens after a jump across an
    /// orbit, where every point stays in view.
    const SAME_SIDE: f64 = 0.866;
    let size = DVec2::new(f64::from(camera.width()), f64::from(camera.height()));
    let still_shows = |(fraction, depth): &(DVec2, f64)| {
        let point = previous.unproject(*fraction * size, if *depth > 0.0 { *depth } else { SKY });
        let (pixel, z) = camera.project(point);
        let [from, to] = [previous, camera].map(|c| (point - c.position()).normalize_or_zero());
        let in_view = z > 0.0 && pixel.cmpge(DVec2::ZERO).all() && pixel.cmplt(size).all();
        in_view && from.dot(to) > SAME_SIDE
    };
    3 * lattice.points().filter(still_shows).count() < lattice.points().count()
}
