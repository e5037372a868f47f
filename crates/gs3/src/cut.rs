//! Whether the camera jumped.

use glam::DVec2;
use gs3_scene::{Camera, GBuffer};

/// Lattice points per axis.
pub(crate) const LATTICE: usize = 5;

/// Median depths of a frame on a lattice of 5×5 of its pixels, row by row; 0 where nothing was hit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Lattice(pub [f32; LATTICE * LATTICE]);

impl Lattice {
    /// That of the frame `gbuffer`; zeros where it has no depth.
    pub fn of(gbuffer: &GBuffer) -> Self {
        let Some(geometry) = &gbuffer.geometry else { return Self::default() };
        let depth = &geometry.depth_median;
        Self(std::array::from_fn(|k| {
            let [fx, fy] = fractions(k);
            let (x, y) = ((fx * depth.width() as f64) as usize, (fy * depth.height() as f64) as usize);
            if y < depth.height() { depth.row(0, y).get(x).copied().unwrap_or(0.0) } else { 0.0 }
        }))
    }
}

/// Where lattice point `k` is, in parts of the picture.
fn fractions(k: usize) -> [f64; 2] {
    [k % LATTICE, k / LATTICE].map(|k| (k as f64 + 0.5) / LATTICE as f64)
}

/// Whether so little of the previous frame still shows that its history is worth nothing: of a 5×5 lattice of its
/// pixels, placed at their depths, fewer than a third lie within the new image and are seen from about the same side.
/// (Empirical; a brisk pan of 3° a frame keeps nine tenths, and no orbit turns by 30° from frame to frame.)
pub(crate) fn is_cut(previous: &Camera, camera: &Camera, lattice: &Lattice) -> bool {
    /// Cosine of 30°: seen from farther around, a surface shows another side, as after a jump across an orbit, where
    /// every point stays in view.
    const SAME_SIDE: f64 = 0.866;
    let size = DVec2::new(f64::from(camera.width()), f64::from(camera.height()));
    let still_shows = |(k, depth): &(usize, &f32)| {
        let fraction = DVec2::from(fractions(*k));
        // Where nothing was hit, only the direction counts: a depth far beyond any motion between frames.
        let z = match f64::from(**depth) {
            z if z > 0.0 => z,
            _ => 1e6 * (1.0 + previous.position().distance(camera.position())),
        };
        let point = previous.unproject(fraction * size, z);
        let (pixel, z) = camera.project(point);
        let [from, to] = [previous, camera].map(|c| (point - c.position()).normalize_or_zero());
        let in_view = z > 0.0 && pixel.cmpge(DVec2::ZERO).all() && pixel.cmplt(size).all();
        in_view && from.dot(to) > SAME_SIDE
    };
    3 * lattice.0.iter().enumerate().filter(still_shows).count() < LATTICE * LATTICE
}
