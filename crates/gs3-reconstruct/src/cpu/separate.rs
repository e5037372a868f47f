//! Both neighbours at the pose of the in-between frame, not blended, and their visibility there.

use fearless_simd::Simd;

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
            let mut patches = [const { None }; LANES];
            // One neighbour after the other, so that the source rows stay in the cache.
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
                    // Not by the array's iterator: it would pass the vectors through memory.
                    if let Some(quads) = &quads {
                        for r in 0..SIDE {
                            clip.store(quads[r], r, part.image);
                        }
                    }
                    if is_even {
                        (0..SIDE).for_each(|r| part.visibility[clip.row(r)].fill(run.visibility[n][k]));
                    }
                    if is_even && quads.is_some() {
                        continue;
                    }
                    // Not by a closure: the closure would be compiled without the kernel's vector instructions.
                    let patch = match patch {
                        Some(patch) => patch,
                        None => patch.insert(self.correspondence_of_patch(simd, x, y)),
                    };
                    for r in clip.rows.clone() {
                        if !is_even {
                            let (at, first) = (clip.row(r), r * SIDE + clip.columns.start);
                            let visibility = &patch.visibility[n][first..first + at.len()];
                            part.visibility[at].copy_from_slice(visibility);
                        }
                        if quads.is_none() {
                            let row = self.gather_row(simd, n, patch, r, clip.columns.clone());
                            clip.store(row, r, part.image);
                        }
                    }
                }
            }
        }
    }
}
