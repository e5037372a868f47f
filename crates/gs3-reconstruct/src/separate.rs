//! Neighbours at the pose between, unblended, and how well they are seen there.

use fearless_simd::{Simd, prelude::*};

use crate::gather::{QUAD, sum_of_pixels};
use crate::warp::{Clip, LANES, Patch, SIDE, Warp};

/// Rows of pixels of one neighbour.
pub(crate) struct Part<'a> {
    /// Colours, `[rows, width]`.
    pub image: &'a mut [[f32; 4]],
    /// Visibility, `[rows, width]`.
    pub visibility: &'a mut [f32],
}

impl<const N: usize> Warp<'_, N> {
    /// Makes the rows of pixels of `parts`, one for each neighbour, from row `top` on, a band.
    #[inline(always)]
    pub fn separate<S: Simd>(&self, simd: S, top: usize, mut parts: [Part<'_>; N]) {
        let width = self.images.first().map_or(0, |image| image.width());
        let count = parts.first().map_or(0, |part| part.visibility.len());
        for [x, y] in self.runs(count / width.max(1), top) {
            let run = self.look_at_run(simd, x, y);
            let mut patches = [const { None }; LANES];
            // One neighbour after the other, so that the rows gathered from stay in the cache.
            for (n, part) in parts.iter_mut().enumerate() {
                for (k, patch) in patches.iter_mut().enumerate() {
                    let x = x + (k * SIDE) as isize;
                    let clip = Clip::new(x, y, top, width, count);
                    if clip.is_empty() {
                        continue;
                    }
                    let is_rigid = run.rigid >> k & 1 == 1 && clip.is_whole();
                    let is_even = is_rigid && run.even >> k & 1 == 1;
                    let quads = if is_rigid { self.quads(simd, n, &run, k) } else { None };
                    // Not by the array's iterator: it would hand the vectors on through memory.
                    if let Some(quads) = &quads {
                        for r in 0..SIDE {
                            quads[r].store_slice(part.image[clip.row(r)].as_flattened_mut());
                        }
                    }
                    if is_even {
                        (0..SIDE).for_each(|r| part.visibility[clip.row(r)].fill(run.visibility[n][k]));
                    }
                    if is_even && quads.is_some() {
                        continue;
                    }
                    let patch = patch.get_or_insert_with(|| self.look_at_patch(simd, x, y));
                    for r in clip.rows.clone() {
                        let (at, first) = (clip.row(r), r * SIDE + clip.columns.start);
                        if !is_even {
                            let visibility = &patch.visibility[n][first..first + at.len()];
                            part.visibility[at.clone()].copy_from_slice(visibility);
                        }
                        if quads.is_none() {
                            self.gather_row(simd, n, patch, first, &mut part.image[at]);
                        }
                    }
                }
            }
        }
    }

    /// Gathers pixels of a row of a patch, from its pixel `first` on, from neighbour `n` alone.
    #[inline(always)]
    pub fn gather_row<S: Simd>(
        &self,
        simd: S,
        n: usize,
        patch: &Patch<N>,
        first: usize,
        pixels: &mut [[f32; 4]],
    ) {
        if pixels.len() == QUAD
            && let Some(quad) = self.quad(simd, n, patch, first)
        {
            return quad.store_slice(pixels.as_flattened_mut());
        }
        for (k, pixel) in (first..).zip(pixels) {
            *pixel = sum_of_pixels(self.gather.pixel(simd, self.images[n], patch.place(n, k), 1.0));
        }
    }
}
