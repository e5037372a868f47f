//! A few depths of a frame, which the processor knows also where frames are made on a GPU.

use glam::DVec2;
use gs3_scene::GBuffer;

/// Lattice points per axis.
pub(crate) const LATTICE: usize = 5;

/// How far away what no Gaussian hits is taken to be, world units: turning moves it, going does not.
pub(crate) const SKY: f64 = 1e9;

/// Median depths of a frame on a lattice of 5×5 of its pixels, row by row; 0 where nothing was hit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DepthLattice(pub(crate) [f32; DepthLattice::LEN]);

impl DepthLattice {
    /// Number of its depths.
    pub const LEN: usize = LATTICE * LATTICE;

    /// Of the median depths of a frame at [`Self::pixels`], in that order, 0 where nothing was hit: for renderers
    /// whose G-buffer is elsewhere.
    #[must_use]
    pub const fn new(depths: [f32; LATTICE * LATTICE]) -> Self {
        Self(depths)
    }

    /// The pixels `[x, y]` of a frame of `size`, width and height, whose depths it has.
    pub fn pixels(size: [usize; 2]) -> impl Iterator<Item = [usize; 2]> {
        (0..LATTICE * LATTICE).map(move |k| {
            let at = fraction(k) * DVec2::from(size.map(|side| side as f64));
            [at.x as usize, at.y as usize]
        })
    }

    /// That of the frame `gbuffer`; zeros where it has no depth.
    #[must_use]
    pub fn of(gbuffer: &GBuffer) -> Self {
        let Some(geometry) = &gbuffer.geometry else { return Self::default() };
        let depth = &geometry.depth_median;
        let mut depths = [0.0; LATTICE * LATTICE];
        for (to, [x, y]) in depths.iter_mut().zip(Self::pixels([depth.width(), depth.height()])) {
            // An empty frame has none.
            if y < depth.height() {
                *to = depth.row(0, y).get(x).copied().unwrap_or(0.0);
            }
        }
        Self(depths)
    }

    /// Mean inverse depth of the points that hit something; 0 if none did.
    #[must_use]
    pub fn mean_inverse_depth(&self) -> f32 {
        let hits = self.0.iter().filter(|depth| **depth > crate::NEAREST_DEPTH && depth.is_finite());
        let (sum, count) = hits.fold((0.0, 0), |(sum, count), depth| (sum + 1.0 / depth, count + 1));
        if count > 0 { sum / count as f32 } else { 0.0 }
    }

    /// Its depths, row by row.
    #[must_use]
    pub const fn depths(&self) -> &[f32; Self::LEN] {
        &self.0
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

#[cfg(test)]
mod tests {
    use gs3_scene::{Geometry, Planes};

    use super::*;

    #[test]
    fn depths_from_elsewhere_make_the_lattice_of_their_frame() {
        let [width, height] = [33, 18];
        let depths = (0..width * height).map(|i| i as f32).collect();
        let depth_median = Planes::<1>::from_data(width, height, depths).expect("of this size");
        let mut depths = [0.0; LATTICE * LATTICE];
        for (to, [x, y]) in depths.iter_mut().zip(DepthLattice::pixels([width, height])) {
            *to = depth_median.row(0, y)[x];
        }
        let geometry = Some(Geometry { depth_median, ..Geometry::default() });
        let gbuffer = GBuffer { geometry, ..GBuffer::default() };
        assert_eq!(DepthLattice::of(&gbuffer), DepthLattice::new(depths));
        assert_eq!(depths[LATTICE * LATTICE / 2], (9 * width + 16) as f32, "the middle of the picture");
        assert_eq!(depths[0], (width + 3) as f32, "a tenth of the sides from the corner");
        assert_eq!(DepthLattice::of(&GBuffer::default()), DepthLattice::default());
    }
}
