//! Another surface for patches beside a silhouette.
//!
//! Depths of the middle frame are those of LR samples: a silhouette is known to half an LR pixel. Pixels beside a
//! silhouette may have the depth of the wrong surface. The neighbours then show two places that have nothing to do with
//! each other, and the in-between frame shows both: a ghost of the silhouette. Where the neighbours' colours disagree in
//! a patch, they are compared at the farthest and at the nearest surface around the patch, too. The patch takes the
//! surface at which they agree much better.

use fearless_simd::{Simd, f32x16, prelude::*};

use crate::cpu::lanes::spread;
use crate::cpu::neighbor_depth::HIDDEN;
use crate::cpu::warp::{LANES, Patch, SIDE, Warp, units};
use crate::reprojection::SAME_SURFACE;

/// Let the disagreement of a patch be the sum, over its doubtful pixels, of squared differences between the neighbours'
/// colours. Another surface gains `LESS` times the disagreement, less the disagreement there, less [`DISAGREE`]: textures
/// may agree better by chance at a wrong depth. (Empirical, in-between frames of `demo` and of `flowers_orbit`: 34.62 and
/// 34.61 dB with 1, 34.56 and 34.62 dB with 1/2, 34.15 and 34.55 dB with 1/4. With 1, columns of a wall beside a post that
/// hides them from one neighbour are wrong.)
pub(crate) const LESS: f32 = 0.5;

/// Disagreement that counts as none. A patch approaches another surface that gains, and is there if it gains as much as
/// this value. (Empirical, in-between frames of `demo`, `fungi_drift` and `flowers_orbit`: 34.56, 49.48 and 34.62 dB; with
/// 0.08 34.35, 49.47 and 34.60 dB.)
pub(crate) const DISAGREE: f32 = 0.03;

/// The middle of a patch, in pixels from its first one.
pub(crate) const PATCH_MIDDLE: f32 = 0.5 * (SIDE - 1) as f32;

/// 1 at the corners of a patch.
const CORNERS: [f32; LANES] = [1., 0., 0., 1., 0., 0., 0., 0., 0., 0., 0., 0., 1., 0., 0., 1.];

/// 1 at the colours among the channels of four pixels.
const COLORS: [f32; LANES] = [1., 1., 1., 0., 1., 1., 1., 0., 1., 1., 1., 0., 1., 1., 1., 0.];

/// A patch in the neighbours, as if it were at one depth and faced the camera.
struct Facing<S: Simd, const N: usize> {
    rows: [[f32x16<S>; SIDE]; N],
    visibility: [f32; N],
}

impl<const N: usize> Patch<N> {
    /// 1 for doubtful pixels, else 0. Doubtful pixels are inside all neighbours, and a neighbour may not show them. Where a
    /// neighbour shows a pixel and another neighbour hides the pixel, colours differ without a doubt.
    #[inline(always)]
    fn doubtful<S: Simd>(&self, simd: S) -> f32x16<S> {
        let (mut least, mut most) = (f32x16::splat(simd, 1.0), f32x16::splat(simd, 0.0));
        for visibility in &self.visibility {
            let visibility = f32x16::load_array_ref(simd, visibility);
            (least, most) = (least.min(visibility), most.max(visibility));
        }
        let is_doubtful =
            least.simd_ge(HIDDEN) & least.simd_lt(1.0) & (least.simd_gt(HIDDEN) | most.simd_lt(1.0));
        is_doubtful.select(f32x16::splat(simd, 1.0), f32x16::splat(simd, 0.0))
    }

    /// Whether any pixel is doubtful.
    #[inline(always)]
    pub fn is_doubtful<S: Simd>(&self, simd: S) -> bool {
        self.doubtful(simd).simd_gt(0.0).any_true()
    }
}

impl<const N: usize> Warp<'_, N> {
    /// Moves the doubtful pixels of the patch from `(x, y)` on, with colours `rows` in the neighbours, to the surface at
    /// which the neighbours agree best, if they agree much better there. Returns whether anything changed.
    #[inline(always)]
    pub fn settle<S: Simd>(
        &self,
        simd: S,
        [x, y]: [isize; 2],
        patch: &mut Patch<N>,
        rows: &mut [[f32x16<S>; SIDE]; N],
    ) -> bool {
        if N < 2 {
            return false;
        }
        let doubtful = patch.doubtful(simd);
        let pixels = doubtful.to_array();
        let limit = LESS * disagreement(simd, rows, &pixels) - DISAGREE;
        // The displacement of another surface is not known.
        if limit <= 0.0 || self.middle.moves_in_patch(x, y) {
            return false;
        }
        let Some(surfaces) = self.surfaces_around(simd, [x, y], patch) else { return false };
        let (mut least, mut best) = (limit, None);
        for depth in surfaces {
            if let Some(facing) = self.facing(simd, [x, y], depth) {
                let apart = disagreement(simd, &facing.rows, &pixels);
                // Where both are nearly as good, rounding does not choose.
                let margin = if best.is_some() { 0.5 * DISAGREE } else { 0.0 };
                if apart + margin < least {
                    (least, best) = (apart, Some(facing));
                }
            }
        }
        let Some(best) = best else { return false };
        // Gradually, so that machines that round to different sides of the limit make nearly the same frames.
        let gain = ((limit - least) * (1.0 / DISAGREE)).min(1.0);
        for n in 0..N {
            for r in 0..SIDE {
                let by = spread(simd, &pixels[r * SIDE..(r + 1) * SIDE]) * gain;
                let moved = (best.rows[n][r] - rows[n][r]).mul_add(by, rows[n][r]);
                rows[n][r] = by.simd_gt(0.0).select(moved, rows[n][r]);
            }
            let visibility = f32x16::load_array_ref(simd, &patch.visibility[n]);
            let there = f32x16::splat(simd, best.visibility[n]);
            patch.visibility[n] = (there - visibility).mul_add(doubtful * gain, visibility).to_array();
        }
        true
    }

    /// The patch from `(x, y)` on, as if it had inverse depth `depth` and faced the camera; `None` if it is not all inside
    /// the neighbours.
    #[inline(always)]
    fn facing<S: Simd>(&self, simd: S, [x, y]: [isize; 2], depth: f32) -> Option<Facing<S, N>> {
        let [x, y] = [f32x16::splat(simd, x as f32), f32x16::splat(simd, y as f32)];
        let middle = [x + PATCH_MIDDLE, y + PATCH_MIDDLE, f32x16::splat(simd, depth)];
        let mut facing = Facing { rows: [[f32x16::splat(simd, 0.0); SIDE]; N], visibility: [0.0; N] };
        for n in 0..N {
            let [u, v, w] = self.reproject(simd, n, middle, None);
            let seen = self.depths[n].visibility_within(simd, [u, v, w], self.scale as f32);
            facing.visibility[n] = self.inside(simd, n, [u, v, w], seen)[0];
            if facing.visibility[n] < HIDDEN {
                return None;
            }
            let place = [units(u - middle[0], x).to_array()[0], units(v - middle[1], y).to_array()[0]];
            facing.rows[n] = self.gather.patch(simd, self.images[n], place)?;
        }
        Some(facing)
    }

    /// Inverse depths of the farthest and of the nearest surface around the corners of the patch from `(x, y)` on, in the
    /// middle frame and where the corners are in the neighbours. `None` if there is one surface.
    #[inline(always)]
    fn surfaces_around<S: Simd>(&self, simd: S, [x, y]: [isize; 2], patch: &Patch<N>) -> Option<[f32; 2]> {
        let [mut far, mut near] = self.middle.ranges_in_patch(simd, x, y);
        let [x, y] = Patch::<N>::pixels(simd, [x, y]);
        let depth = f32x16::load_array_ref(simd, &patch.depth);
        for n in 0..N {
            let [u, v, w] = self.reproject(simd, n, [x, y, depth], None);
            let is_inside = self.inside(simd, n, [u, v, w], f32x16::splat(simd, 1.0)).simd_ge(1.0);
            let [least, most] = self.depths[n].ranges_within(simd, [u, v], self.scale as f32);
            // Ranges of neighbours are wider than their samples.
            let (least, most) = (least * (1.0 / (1.0 - SAME_SURFACE)), most * (1.0 / (1.0 + SAME_SURFACE)));
            for found in [least, most] {
                let found = self.reprojections[n].source_depth_16(simd, x + 0.5, y + 0.5, found);
                let is_there = is_inside & found.simd_ge(0.0);
                far = is_there.select(far.min(found), far);
                near = is_there.select(near.max(found), near);
            }
        }
        let is_corner = f32x16::load_array_ref(simd, &CORNERS).simd_gt(0.0);
        let far = is_corner.select(far, f32x16::splat(simd, f32::INFINITY)).reduce_min();
        let near = is_corner.select(near, f32x16::splat(simd, 0.0)).reduce_max();
        (near - far > 2.0 * SAME_SURFACE * near).then_some([far, near])
    }
}

/// Sum over the pixels of a patch with a 1 in `pixels`: squared differences between the colours of the first and of the
/// last neighbour.
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
