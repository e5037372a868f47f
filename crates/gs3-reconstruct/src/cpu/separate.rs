//! Both neighbours at the pose of the in-between frame, not blended, and their visibility there.

use fearless_simd::{Simd, f32x16, prelude::*};

use crate::cpu::warp::{Clip, LANES, SIDE, Warp};

/// Rows of pixels of one neighbour.
pub(crate) struct Part<'a> {
    /// Colours, `[rows, width]`.
    pub image: &'a mut [[f32; 4]],
    /// Visibility, `[rows, width]`.
    pub visibility: &'a mut [f32],
}

impl<const N: usize> Warp<'_, N> {
    /// Makes the rows of a band, one part per neighbour, from row `top` on.
    #[inline(always)]
    pub fn separate<S: Simd>(&self, simd: S, top: usize, mut parts: [Part<'_>; N]) {
        let width = self.images.first().map_or(0, |image| image.width());
        let count = parts.first().map_or(0, |part| part.visibility.len());
        for [x, y] in self.runs(count / width.max(1), top) {
            let run = self.correspondence_of_run(simd, x, y);
            let clip = |k: usize| Clip::new(x + (k * SIDE) as isize, y, top, width, count);
            // One neighbour after the other, so that the source rows stay in the cache.
            let mut left = 0_u64;
            for (n, part) in parts.iter_mut().enumerate() {
                for k in 0..LANES {
                    let clip = clip(k);
                    let is_even = (run.rigid & run.even) >> k & 1 == 1 && clip.is_whole();
                    let quads = if is_even { self.quads(simd, n, &run, k) } else { None };
                    let Some(quads) = quads else {
                        left |= u64::from(!clip.is_empty()) << k;
                        continue;
                    };
                    for r in 0..SIDE {
                        clip.store(quads[r], r, part.image);
                        part.visibility[clip.row(r)].fill(run.visibility[n][k]);
                    }
                }
            }
            for k in 0..LANES {
                if left >> k & 1 == 0 {
                    continue;
                }
                let (clip, x) = (clip(k), x + (k * SIDE) as isize);
                let moves_alike = run.rigid >> k & 1 == 1 && clip.is_whole();
                let mut patch = self.correspondence_of_patch(simd, &run, k, x, y);
                let mut all = [[f32x16::splat(simd, 0.0); SIDE]; N];
                for n in 0..N {
                    all[n] = self.gather_patch(simd, n, &run, k, moves_alike, &patch, &clip);
                }
                if moves_alike && run.even >> k & 1 == 1 {
                    patch.take_visibility(&run, k);
                } else if clip.is_whole() {
                    self.settle(simd, [x, y], &mut patch, &mut all);
                }
                for (n, part) in parts.iter_mut().enumerate() {
                    for r in clip.rows.clone() {
                        clip.store(all[n][r], r, part.image);
                        let (at, first) = (clip.row(r), r * SIDE + clip.columns.start);
                        let visibility = &patch.visibility[n][first..first + at.len()];
                        part.visibility[at].copy_from_slice(visibility);
                    }
                }
            }
        }
    }
}
