//! Another surface for patches beside a silhouette.
//!
//! Depths of the middle frame are those of LR samples: a silhouette is known to half an LR pixel. Pixels beside a
//! silhouette may have the depth of the wrong surface. The neighbours then show two places that have nothing to do with
//! each other, and the in-between frame shows both: a ghost of the silhouette. Where the neighbours' colours disagree in
//! a patch, they are compared at the farthest and at the nearest surface around the patch, too. The patch takes the
//! surface at which they agree much better.

use fearless_simd::{Simd, f32x16, prelude::*};

use crate::cpu::gather::UNITS;
use crate::cpu::lanes::spread;
use crate::cpu::neighbor_depth::HIDDEN;
use crate::cpu::warp::{LANES, Patch, SIDE, Warp};
use crate::reprojection::{MIN_DIVISOR, SAME_SURFACE};

/// Another surface must leave less than this share of a patch's disagreement, the sum of squared differences between its
/// neighbours' colours: textures, too, may agree better by chance at a wrong depth. (Empirical, in-between frames of `demo`
/// and `flowers_orbit`: with 1 0.06 dB more and 0.01 dB less, with 1/4 0.4 and 0.07 dB less. With 1, columns of a wall
/// beside a post that hides them from one neighbour are wrong.)
pub(crate) const LESS: f32 = 0.5;

/// Disagreement that counts as none. A patch approaches another surface from this value below the limit on, and is there
/// at twice this value. (Empirical: with a half or three times as much, in-between frames of `demo`, `fungi_drift` and
/// `flowers_orbit` are alike within 0.1 dB.)
pub(crate) const DISAGREE: f32 = 0.03;

/// The middle of a patch, in pixels from its first one.
pub(crate) const MIDDLE: f32 = 0.5 * (SIDE - 1) as f32;

/// The colours among the channels of four pixels.
const COLORS: [f32; LANES] = [1., 1., 1., 0., 1., 1., 1., 0., 1., 1., 1., 0., 1., 1., 1., 0.];

/// A patch in the neighbours, as if it were at one depth and faced the camera.
struct Facing<S: Simd, const N: usize> {
    rows: [[f32x16<S>; SIDE]; N],
    visibility: [f32; N],
}

impl<const N: usize> Patch<N> {
    /// 1 for pixels that are inside all neighbours and that one of them may not show, else 0. Pixels that one neighbour
    /// shows and that another one hides are occluded there: their colours say nothing.
    #[inline(always)]
    fn unsure<S: Simd>(&self, simd: S) -> f32x16<S> {
        let (mut least, mut most) = (f32x16::splat(simd, 1.0), f32x16::splat(simd, 0.0));
        for visibility in &self.visibility {
            let visibility = f32x16::load_array_ref(simd, visibility);
            (least, most) = (least.min(visibility), most.max(visibility));
        }
        let is_unsure =
            least.simd_ge(HIDDEN) & least.simd_lt(1.0) & (least.simd_gt(HIDDEN) | most.simd_lt(1.0));
        is_unsure.select(f32x16::splat(simd, 1.0), f32x16::splat(simd, 0.0))
    }

    /// Whether any pixel is unsure.
    #[inline(always)]
    pub fn is_unsure<S: Simd>(&self, simd: S) -> bool {
        self.unsure(simd).simd_gt(0.0).any_true()
    }
}

impl<const N: usize> Warp<'_, N> {
    /// Moves the unsure pixels of the patch from `at` on, with colours `rows` in the neighbours, to the surface at which
    /// the neighbours agree best, if they agree much better there. Returns whether anything changed. A single neighbour
    /// agrees with itself.
    #[inline(always)]
    pub fn settle<S: Simd>(
        &self,
        simd: S,
        at: [isize; 2],
        patch: &mut Patch<N>,
        rows: &mut [[f32x16<S>; SIDE]; N],
    ) -> bool {
        let unsure = patch.unsure(simd);
        let pixels = unsure.to_array();
        let apart = disagreement(simd, rows, &pixels);
        // Where something moves, the displacement of the other surface is not known.
        let moves = [at[1], at[1] + SIDE as isize - 1].iter().any(|y| self.middle.moves_in_row(*y));
        if LESS * apart <= DISAGREE || moves {
            return false;
        }
        let Some(surfaces) = self.surfaces_around(at, &patch.depth) else { return false };
        let (mut least, mut best) = (LESS * apart - DISAGREE, None);
        for depth in surfaces {
            if let Some(facing) = self.facing(simd, at, depth) {
                let apart = disagreement(simd, &facing.rows, &pixels);
                if apart < least {
                    (least, best) = (apart, Some(facing));
                }
            }
        }
        let Some(best) = best else { return false };
        // Gradually, so that machines whose rounding differs about the limit differ little.
        let gain = ((LESS * apart - DISAGREE - least) * (1.0 / DISAGREE)).min(1.0);
        for n in 0..N {
            for r in 0..SIDE {
                let by = spread(simd, &pixels[r * SIDE..(r + 1) * SIDE]) * gain;
                let moved = (best.rows[n][r] - rows[n][r]).mul_add(by, rows[n][r]);
                rows[n][r] = by.simd_gt(0.0).select(moved, rows[n][r]);
            }
            let visibility = f32x16::load_array_ref(simd, &patch.visibility[n]);
            let there = f32x16::splat(simd, best.visibility[n]);
            patch.visibility[n] = (there - visibility).mul_add(unsure * gain, visibility).to_array();
        }
        true
    }

    /// The patch from `at` on, as if it had inverse depth `depth` and faced the camera; `None` if it is not all inside
    /// the neighbours.
    #[inline(always)]
    fn facing<S: Simd>(&self, simd: S, at: [isize; 2], depth: f32) -> Option<Facing<S, N>> {
        let middle = at.map(|first| first as f32 + MIDDLE);
        let mut facing = Facing { rows: [[f32x16::splat(simd, 0.0); SIDE]; N], visibility: [0.0; N] };
        for n in 0..N {
            let [u, v, q] = self.place_in(n, middle, depth)?;
            facing.visibility[n] = self.depths[n].visibility_at([u, v, depth / q], self.scale as f32);
            let place = [(u - middle[0], at[0]), (v - middle[1], at[1])]
                .map(|(moved, first)| (moved * UNITS + 0.5).floor() as i32 + first as i32 * UNITS as i32);
            facing.rows[n] = self.gather.patch(simd, self.images[n], place)?;
        }
        Some(facing)
    }

    /// Inverse depths of the farthest and of the nearest surface around the patch from `(x, y)` on, whose pixels have
    /// inverse depths `depth`: around its corners in the middle frame and in the neighbours. `None` if there is one
    /// surface.
    #[inline(always)]
    fn surfaces_around(&self, [x, y]: [isize; 2], depth: &[f32; LANES]) -> Option<[f32; 2]> {
        let (mut far, mut near) = (f32::INFINITY, 0.0_f32);
        for k in [0, SIDE - 1, LANES - SIDE, LANES - 1] {
            let (x, y) = (x + (k % SIDE) as isize, y + (k / SIDE) as isize);
            let [least, most] = self.middle.range_at(x, y);
            (far, near) = (far.min(least), near.max(most));
            for n in 0..N {
                if let Some([u, v, q]) = self.place_in(n, [x as f32, y as f32], depth[k]) {
                    let [least, most] = self.depths[n].range_at([u, v], self.scale as f32);
                    // Ranges of neighbours are wider than their samples.
                    far = far.min(least * (q / (1.0 - SAME_SURFACE)));
                    near = near.max(most * (q / (1.0 + SAME_SURFACE)));
                }
            }
        }
        (near - far > 2.0 * SAME_SURFACE * near).then_some([far, near])
    }

    /// The place in neighbour `n` of pixel `(x, y)` with inverse depth `depth`, and the divisor of the depth; `None` if
    /// outside.
    #[inline(always)]
    fn place_in(&self, n: usize, [x, y]: [f32; 2], depth: f32) -> Option<[f32; 3]> {
        let [u, v, q] = self.reprojections[n].apply([x + 0.5, y + 0.5], depth);
        let (u, v) = (u - 0.5, v - 0.5);
        let (width, height) = (self.images[n].width() as f32, self.images[n].height() as f32);
        let is_inside = q > MIN_DIVISOR && u >= -0.5 && v >= -0.5 && u <= width - 0.5 && v <= height - 0.5;
        is_inside.then_some([u, v, q])
    }
}

/// The sum of squared differences between the colours of the first and of the last neighbour, over those of a patch's
/// pixels that have a 1 in `pixels`.
#[inline(always)]
fn disagreement<S: Simd, const N: usize>(
    simd: S,
    neighbors: &[[f32x16<S>; SIDE]; N],
    pixels: &[f32; LANES],
) -> f32 {
    let mut squares = f32x16::splat(simd, 0.0);
    for r in 0..SIDE {
        let by = f32x16::load_array_ref(simd, &COLORS) * spread(simd, &pixels[r * SIDE..(r + 1) * SIDE]);
        let difference = (neighbors[N - 1][r] - neighbors[0][r]) * by;
        squares = difference.mul_add(difference, squares);
    }
    let (a, b) = squares.split();
    let (a, b) = (a + b).split();
    (a + b).to_array().into_iter().sum()
}
