//! The in-between frame, gathered from both neighbours and blended by visibility, time and uncertainty.
//!
//! The error of a frame is about in proportion to its uncertainty, so neighbours are weighted by inverse uncertainty.
//! The neighbour with the longer history, or with a sample of its own beside a pixel, then counts more.

use fearless_simd::{Simd, f32x16, prelude::*, u8x64};

use crate::cpu::lanes::{load_all, spread};
use crate::cpu::warp::{Clip, LANES, Run, SIDE, Warp};

/// Weights below this value are not visible on the finest display.
pub(crate) const NEGLIGIBLE: f32 = 1e-4;

/// Added to uncertainties, in pixel²: warping makes an exact pixel uncertain by about this much. (Empirical, on clips
/// of eight scenes: 0.01 is alike; 0.2 gains a fifth less on captures and a little more on generated scenes. Weights
/// by inverse squares gain as much on captures, and lose on generated scenes.)
pub(crate) const UNSURE: f32 = 0.05;

/// Inputs of the rows.
pub(crate) struct Blend<'a> {
    pub warp: Warp<'a, 2>,
    /// Time, `[0, 1]` from the first neighbour to the second.
    pub t: f32,
    /// Whether errors to expect are wanted.
    pub has_errors: bool,
}

impl Blend<'_> {
    /// Blends the rows of a band: `rows`, starting at row `top`. `errors` gets [`squared_error`] of each of
    /// the band's patches, summed over pixels and RGB; 0 of patches that are not whole, and if
    /// errors are not wanted.
    #[inline(always)]
    pub fn blend<S: Simd>(&self, simd: S, top: usize, rows: &mut [[f32; 4]], errors: &mut [f32]) {
        let warp = &self.warp;
        let width = warp.images[0].width();
        let (count, mut first) = (rows.len(), [[[0.0; 4 * SIDE]; SIDE]; LANES]);
        let patches = warp.patches(top);
        errors.fill(0.0);
        for [x, y] in warp.runs(count / width, top) {
            let run = warp.correspondence_of_run(simd, x, y);
            let clip = |k: usize| Clip::new(x + (k * SIDE) as isize, y, top, width, count);
            let even_share = share(simd, &run.visibility, self.t).to_array();
            // One neighbour after the other, so that the source rows stay in the cache.
            let mut gathered = 0;
            for k in 0..LANES {
                if run.rigid >> k & 1 == 1 && clip(k).is_whole() {
                    let is_wanted = run.even >> k & 1 == 0 || even_share[k] < 1.0;
                    gathered |= u64::from(self.gather_first(simd, &run, k, is_wanted, &mut first[k])) << k;
                }
            }
            for k in 0..LANES {
                let (clip, x) = (clip(k), x + (k * SIDE) as isize);
                if clip.is_empty() {
                    continue;
                }
                let moves_alike = run.rigid >> k & 1 == 1 && clip.is_whole();
                let mut error = errors.get_mut(patches.index([x, y])).filter(|_| self.has_errors);
                let is_gathered = gathered >> k & 1 == 1;
                let is_even = moves_alike && run.even >> k & 1 == 1;
                if is_gathered
                    && is_even
                    && self.gather_second(simd, &run, k, even_share[k], &first[k], &clip, rows, &mut error)
                {
                    continue;
                }
                let mut patch = warp.correspondence_of_patch(simd, &run, k, x, y);
                if is_even {
                    patch.take_visibility(&run, k);
                }
                let is_doubtful = !is_even && clip.is_whole() && patch.is_doubtful(simd);
                let mut share_of_second = share(simd, &patch.visibility, self.t);
                // Neighbours that no pixel needs are not gathered.
                let mut both = [[f32x16::splat(simd, 0.0); SIDE]; 2];
                if is_doubtful || share_of_second.simd_lt(1.0).any_true() {
                    both[0] = match is_gathered {
                        true => load_all(simd, &first[k]),
                        false => warp.gather_patch(simd, 0, &run, k, moves_alike, &patch, &clip),
                    };
                }
                if is_doubtful || share_of_second.simd_gt(0.0).any_true() {
                    both[1] = warp.gather_patch(simd, 1, &run, k, moves_alike, &patch, &clip);
                }
                if is_doubtful && warp.settle(simd, [x, y], &mut patch, &mut both) {
                    share_of_second = share(simd, &patch.visibility, self.t);
                }
                let share = share_of_second.to_array();
                let mut sum = f32x16::splat(simd, 0.0);
                for r in clip.rows.clone() {
                    let share = spread(simd, &share[r * SIDE..(r + 1) * SIDE]);
                    let (mixed, squared) = mix(simd, both[0][r], both[1][r], share);
                    sum += squared;
                    clip.store(mixed, r, rows);
                }
                if clip.is_whole()
                    && let Some(error) = error
                {
                    *error = of_colors(sum);
                }
            }
        }
    }

    /// Gathers the first neighbour's pixels of a rigid patch, if it is wanted. Returns `false` if the patch is not
    /// all inside.
    #[inline(always)]
    fn gather_first<S: Simd>(
        &self,
        simd: S,
        run: &Run<2>,
        k: usize,
        is_wanted: bool,
        out: &mut [[f32; 4 * SIDE]; SIDE],
    ) -> bool {
        if !is_wanted {
            return true;
        }
        let Some(quads) = self.warp.quads(simd, 0, run, k) else { return false };
        for (quad, out) in quads.into_iter().zip(out) {
            quad.store_array(out);
        }
        true
    }

    /// Blends the first neighbour's pixels of an even patch with the second neighbour's, and writes the result.
    /// Returns `false` and writes nothing if the second neighbour's patch is not all inside.
    #[inline(always)]
    fn gather_second<S: Simd>(
        &self,
        simd: S,
        run: &Run<2>,
        k: usize,
        share: f32,
        first: &[[f32; 4 * SIDE]; SIDE],
        clip: &Clip,
        rows: &mut [[f32; 4]],
        error: &mut Option<&mut f32>,
    ) -> bool {
        if share == 0.0 {
            for (r, first) in first.iter().enumerate() {
                clip.store(f32x16::load_array_ref(simd, first), r, rows);
            }
            return true;
        }
        let Some(second) = self.warp.quads(simd, 1, run, k) else { return false };
        // The first neighbour was not gathered.
        if share == 1.0 {
            for r in 0..SIDE {
                clip.store(second[r], r, rows);
            }
            return true;
        }
        let both = [load_all(simd, first), second];
        // One division for all sixteen pixels.
        let [of_first, of_second] = [pack_uncertainty(simd, &both[0]), pack_uncertainty(simd, &both[1])];
        let by = surer(f32x16::splat(simd, share), of_first, of_second);
        let mut sum = f32x16::splat(simd, 0.0);
        for r in 0..SIDE {
            let by = by.swizzle_dyn_within_blocks(u8x64::load_array_ref(simd, &LANE_BYTES[r]));
            let between = both[1][r] - both[0][r];
            sum += squared_error(between, by);
            clip.store(between.mul_add(by, both[0][r]), r, rows);
        }
        if let Some(error) = error {
            **error = of_colors(sum);
        }
        true
    }
}

/// For every four lanes, the bytes of lane `r`, repeated four times.
const LANE_BYTES: [[u8; 64]; SIDE] = {
    let mut bytes = [[0; 64]; SIDE];
    let mut k = 0;
    while k < SIDE * 64 {
        bytes[k / 64][k % 64] = (k / 64 * 4 + k % 4) as u8;
        k += 1;
    }
    bytes
};

/// 1 in lane `r` of every four lanes.
const LANE_ONLY: [[f32; LANES]; SIDE] = {
    let mut lanes = [[0.0; LANES]; SIDE];
    let mut k = 0;
    while k < SIDE * LANES {
        lanes[k / LANES][k % LANES] = (k % LANES % SIDE == k / LANES) as u8 as f32;
        k += 1;
    }
    lanes
};

/// The uncertainties of a patch's pixels: lane `4 c + r` has the pixel in column `c` of row `r`.
#[inline(always)]
fn pack_uncertainty<S: Simd>(simd: S, rows: &[f32x16<S>; SIDE]) -> f32x16<S> {
    let bytes = u8x64::load_array_ref(simd, &LANE_BYTES[SIDE - 1]);
    let mut packed = rows[SIDE - 1];
    for r in 0..SIDE - 1 {
        let is_here = f32x16::load_array_ref(simd, &LANE_ONLY[r]).simd_gt(0.5);
        packed = is_here.select(rows[r].swizzle_dyn_within_blocks(bytes), packed);
    }
    packed
}

/// True over expected squared error of in-between frames, because the neighbours also err alike: both lack the same detail.
/// (Empirical: 2.1 to 5.1 at 1920×1080, on frames 14 to 19 of eight paths, with one and with two frames between. The program is
/// not part of the repository.)
pub(crate) const SHARED: f32 = 3.6;

/// The squared error of a blend that comes from what differs in its neighbours. `between` is their difference and `share` the
/// second's share. If the neighbours' own errors have a variance of σ² each, the mean of their difference's square is 2 σ². The
/// blend then has a variance of σ² (s² + (1 − s)²), at s = ½ as much as s (1 − s) times that square.
#[inline(always)]
fn squared_error<S: Simd>(between: f32x16<S>, share: f32x16<S>) -> f32x16<S> {
    between * between * (share * (1.0 - share))
}

/// The sum of the lanes of colours of four pixels.
#[inline(always)]
fn of_colors<S: Simd>(lanes: f32x16<S>) -> f32 {
    let lanes = lanes.to_array();
    let mut sum = 0.0;
    for [r, g, b, _] in lanes.as_chunks::<4>().0 {
        sum += r + g + b;
    }
    sum
}

/// Blends four pixels of the first neighbour with four of the second, and gives the [`squared_error`] of their numbers. The lanes of
/// `share` have the pixels' shares by time and visibility.
#[inline(always)]
fn mix<S: Simd>(simd: S, first: f32x16<S>, second: f32x16<S>, share: f32x16<S>) -> (f32x16<S>, f32x16<S>) {
    let uncertainty = u8x64::load_array_ref(simd, &LANE_BYTES[SIDE - 1]);
    let of_first = first.swizzle_dyn_within_blocks(uncertainty);
    let of_second = second.swizzle_dyn_within_blocks(uncertainty);
    let (between, by) = (second - first, surer(share, of_first, of_second));
    let (mixed, squared) = (between.mul_add(by, first), squared_error(between, by));
    // A neighbour with no weight is not read, so that its numbers that are not finite do not spread.
    let (is_first, is_second) = (share.simd_eq(0.0), share.simd_eq(1.0));
    let mixed = is_second.select(second, is_first.select(first, mixed));
    (mixed, (is_first | is_second).select(f32x16::splat(simd, 0.0), squared))
}

/// The share of the second neighbour with these uncertainties, where `share` is its share by time and visibility.
/// Interpolation can make uncertainties negative.
#[inline(always)]
fn surer<S: Simd>(share: f32x16<S>, first: f32x16<S>, second: f32x16<S>) -> f32x16<S> {
    let weight = share * (first.max(0.0) + UNSURE);
    weight / (weight + (1.0 - share) * (second.max(0.0) + UNSURE))
}

/// The second neighbour's share by time `t` and visibility.
#[inline(always)]
fn share<S: Simd>(simd: S, visibility: &[[f32; LANES]; 2], t: f32) -> f32x16<S> {
    let [before, after] = visibility;
    let before = f32x16::load_array_ref(simd, before) * (1.0 - t);
    let after = f32x16::load_array_ref(simd, after) * t;
    let share = after / (before + after);
    let share = share.simd_lt(NEGLIGIBLE).select(f32x16::splat(simd, 0.0), share);
    share.simd_gt(1.0 - NEGLIGIBLE).select(f32x16::splat(simd, 1.0), share)
}

/// The shares of the second neighbour at time `t`, for pixels of `images` with these visibilities in each.
#[inline(always)]
pub(crate) fn shares<S: Simd>(
    simd: S,
    visibility: [&[f32]; 2],
    images: [&[[f32; 4]]; 2],
    t: f32,
    out: &mut [f32],
) {
    for (k, out) in out.chunks_mut(LANES).enumerate() {
        let pixels = k * LANES..k * LANES + out.len();
        let mut both = [[1.0; LANES]; 2];
        for (both, visibility) in both.iter_mut().zip(visibility) {
            both[..out.len()].copy_from_slice(&visibility[pixels.clone()]);
        }
        let share = share(simd, &both, t);
        let counts = share.simd_gt(0.0) & share.simd_lt(1.0);
        let first = uncertainties(simd, &images[0][pixels.clone()]);
        let second = uncertainties(simd, &images[1][pixels]);
        // Pixels without weight may have any value.
        let share = counts.select(surer(share, first, second), share);
        out.copy_from_slice(&share.to_array()[..out.len()]);
    }
}

/// The uncertainties of up to sixteen pixels; 0 for the others.
#[inline(always)]
fn uncertainties<S: Simd>(simd: S, pixels: &[[f32; 4]]) -> f32x16<S> {
    let mut all = [0.0; LANES];
    for (uncertainty, pixel) in all.iter_mut().zip(pixels) {
        *uncertainty = pixel[3];
    }
    f32x16::load_array(simd, all)
}
