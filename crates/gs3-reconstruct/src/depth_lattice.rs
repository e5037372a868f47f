//! A few depths of a frame. The CPU has them even if a GPU makes the frames.

use glam::DVec2;
use gs3_scene::{GBuffer, Size};

/// Distance assumed for pixels without a surface, in world units: turning the camera moves them, walking does not.
pub(crate) const SKY: f64 = 1e9;

/// Median depths of a frame on a lattice of 5×5 of its pixels, row by row; 0 where there is no surface.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DepthLattice(pub(crate) [f32; DepthLattice::LEN]);

impl DepthLattice {
    /// Points per axis.
    pub const SIDE: usize = 5;

    /// Number of depths.
    pub const LEN: usize = Self::SIDE * Self::SIDE;

    /// A lattice of the given median depths at [`Self::pixels`], in this order, 0 where there is no surface. This is
    /// for renderers with their G-buffer elsewhere.
    #[must_use]
    pub const fn new(depths: [f32; DepthLattice::LEN]) -> Self {
        Self(depths)
    }

    /// The lattice's pixels `[x, y]` in a frame of `size`.
    pub fn pixels(size: Size) -> impl Iterator<Item = [usize; 2]> {
        (0..DepthLattice::LEN).map(move |k| {
            let at = fraction(k) * DVec2::from(size.to_array().map(f64::from));
            [at.x as usize, at.y as usize]
        })
    }

    /// The lattice of the frame `gbuffer`; zeros if the frame has no depth.
    #[must_use]
    pub fn of(gbuffer: &GBuffer) -> Self {
        let Some(geometry) = &gbuffer.geometry else { return Self::default() };
        let depth = &geometry.depth_median;
        let mut depths = [0.0; DepthLattice::LEN];
        for (to, [x, y]) in depths.iter_mut().zip(Self::pixels(depth.size())) {
            // An empty frame has no pixels.
            if y < depth.height() {
                *to = depth.row(0, y).get(x).copied().unwrap_or(0.0);
            }
        }
        Self(depths)
    }

    /// Mean inverse depth of the points on a surface; 0 if there is none.
    #[must_use]
    pub fn mean_inverse_depth(&self) -> f32 {
        let hits = self.0.iter().filter(|depth| **depth > crate::NEAREST_DEPTH && depth.is_finite());
        let (sum, count) = hits.fold((0.0, 0), |(sum, count), depth| (sum + 1.0 / depth, count + 1));
        if count > 0 { sum / count as f32 } else { 0.0 }
    }

    /// The depths, row by row.
    #[must_use]
    pub const fn depths(&self) -> &[f32; Self::LEN] {
        &self.0
    }

    /// The places of the lattice points, as fractions of the picture, and their depths.
    pub(crate) fn points(&self) -> impl Iterator<Item = (DVec2, f64)> + use<'_> {
        self.0.iter().enumerate().map(|(k, depth)| (fraction(k), f64::from(*depth)))
    }
}

/// The place of lattice point `k`, as a fraction of the picture.
fn fraction(k: usize) -> DVec2 {
    DVec2::from(
        [k % DepthLattice::SIDE, k / DepthLattice::SIDE]
            .map(|k| (k as f64 + 0.5) / DepthLattice::SIDE as f64),
    )
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
        let mut depths = [0.0; DepthLattice::LEN];
        for (to, [x, y]) in depths.iter_mut().zip(DepthLattice::pixels(depth_median.size())) {
            *to = depth_median.row(0, y)[x];
        }
        let geometry = Some(Geometry { depth_median, ..Geometry::default() });
        let gbuffer = GBuffer { geometry, ..GBuffer::default() };
        assert_eq!(DepthLattice::of(&gbuffer), DepthLattice::new(depths));
        assert_eq!(depths[DepthLattice::LEN / 2], (9 * width + 16) as f32, "the middle of the picture");
        assert_eq!(depths[0], (width + 3) as f32, "a tenth of the sides from the corner");
        assert_eq!(DepthLattice::of(&GBuffer::default()), DepthLattice::default());
    }
}
