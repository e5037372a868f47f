//! A few depths of a frame, which the processor knows also where frames are made on a GPU.

use glam::DVec2;
use gs3_scene::GBuffer;

/// Lattice points per axis.
pub(crate) const LATTICE: usize = 5;

/// Median depths of a frame on a lattice of 5×5 of its pixels, row by row; 0 where nothing was hit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DepthLattice(pub(crate) [f32; LATTICE * LATTICE]);

impl DepthLattice {
    /// That of the frame `gbuffer`; zeros where it has no depth.
    #[must_use]
    pub fn of(gbuffer: &GBuffer) -> Self {
        let Some(geometry) = &gbuffer.geometry else { return Self::default() };
        let depth = &geometry.depth_median;
        Self(std::array::from_fn(|k| {
            let at = fraction(k);
            let (x, y) = ((at.x * depth.width() as f64) as usize, (at.y * depth.height() as f64) as usize);
            if y < depth.height() { depth.row(0, y).get(x).copied().unwrap_or(0.0) } else { 0.0 }
        }))
    }

    /// Where its points are, in parts of the picture, and their depths.
    pub(crate) fn points(&self) -> impl Iterator<Item = (DVec2, f64)> + use<'_> {
        self.0.iter().enumerate().map(|(k, depth)| (fraction(k), f64::from(*depth)))
    }
}

/// Where lattice point `k` is, in parts of the picture.
fn fraction(k: usize) -> DVec2 {
    DVec2::from([k % LATTICE, k / LATTICE].map(|k| (k as f64 + 0.5) / LATTICE as f64))
}
