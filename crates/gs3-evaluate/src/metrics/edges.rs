//! PSNR near silhouettes, where reconstruction has least to go by and a mean over the whole image hides what it does.

use gs3_scene::{Image, Planes, Size};
use rayon::prelude::*;

use super::mean_square::{Quantisation, shown};
use super::{BAND_ROWS, MetricError, psnr_from_mse, same_size};

/// Two neighbouring pixels show different surfaces if one is farther than the other by more than this share.
pub const DEPTH_STEP: f32 = 0.1;

/// Pixels this far from a discontinuity still count as its neighbourhood, in columns and in rows.
pub const EDGE_REACH: usize = 2;

/// The pixels of an image that lie near a depth discontinuity.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DepthEdges {
    width: usize,
    height: usize,
    /// `[height, width]`.
    is_near: Vec<bool>,
}

impl DepthEdges {
    /// The pixels at most [`EDGE_REACH`] columns and rows from a discontinuity of `depth` (view-space z, one unit
    /// throughout; 0, negative and non-finite values: nothing there). Both of two pixels beside or above one another
    /// lie on a discontinuity if the farther depth exceeds the nearer by more than [`DEPTH_STEP`] of the nearer, or if
    /// just one of them shows anything.
    #[must_use]
    pub fn of(depth: &Planes<1>) -> Self {
        let (width, height) = (depth.width(), depth.height());
        let mut on_edge = vec![false; width * height];
        on_edge.par_chunks_exact_mut(width.max(1)).enumerate().for_each(|(y, out)| {
            let row = depth.row(0, y);
            for (x, pair) in row.windows(2).enumerate() {
                if is_step(pair[0], pair[1]) {
                    out[x..x + 2].fill(true);
                }
            }
            let others = [y.checked_sub(1), Some(y + 1).filter(|below| *below < height)];
            for other in others.into_iter().flatten().map(|y| depth.row(0, y)) {
                for ((out, a), b) in out.iter_mut().zip(row).zip(other) {
                    *out |= is_step(*a, *b);
                }
            }
        });
        let mut wide = vec![false; width * height];
        wide.par_chunks_exact_mut(width.max(1)).zip(on_edge.par_chunks_exact(width.max(1))).for_each(
            |(out, row)| {
                for (x, out) in out.iter_mut().enumerate() {
                    *out = row[x.saturating_sub(EDGE_REACH)..width.min(x + EDGE_REACH + 1)].contains(&true);
                }
            },
        );
        let mut is_near = on_edge;
        is_near.par_chunks_exact_mut(width.max(1)).enumerate().for_each(|(y, out)| {
            out.fill(false);
            for row in y.saturating_sub(EDGE_REACH)..height.min(y + EDGE_REACH + 1) {
                for (out, near) in out.iter_mut().zip(&wide[row * width..][..width]) {
                    *out |= *near;
                }
            }
        });
        Self { width, height, is_near }
    }

    /// Whether each pixel lies near a discontinuity, `[height, width]`.
    #[must_use]
    pub fn pixels(&self) -> &[bool] {
        &self.is_near
    }

    /// The share of pixels near a discontinuity, in `[0, 1]`; 0 of an empty image.
    #[must_use]
    pub fn share(&self) -> f64 {
        let count = self.is_near.iter().filter(|near| **near).count();
        count as f64 / self.is_near.len().max(1) as f64
    }
}

/// Whether neighbouring depths are of different surfaces.
fn is_step(a: f32, b: f32) -> bool {
    let is_there = |depth: f32| depth.is_finite() && depth > 0.0;
    match (is_there(a), is_there(b)) {
        (true, true) => a.max(b) > a.min(b) * (1.0 + DEPTH_STEP),
        (false, false) => false,
        _ => true,
    }
}

/// PSNR in dB of the pixels of `edges` alone: one mean squared error over their RGB values in `[0, 1]`, peak 1. Infinite
/// where they are equal, none where there are no such pixels.
///
/// # Errors
/// [`MetricError::Size`] if the images or `edges` differ in size.
pub fn edge_psnr(
    reference: &Image,
    test: &Image,
    edges: &DepthEdges,
    quantisation: Quantisation,
) -> Result<Option<f64>, MetricError> {
    same_size(reference, "test image", test)?;
    let (expected, actual) = (reference.size(), Size::of(edges.width, edges.height));
    if actual != expected {
        return Err(MetricError::Size { what: "depth edges", expected, actual });
    }
    let band = BAND_ROWS * reference.width().max(1);
    let pixels = reference.pixels().par_chunks(band).zip(test.pixels().par_chunks(band));
    let sums: Vec<(f64, usize)> = pixels
        .zip(edges.is_near.par_chunks(band))
        .map(|((reference, test), near)| {
            let (mut sum, mut count) = (0.0, 0);
            for ((a, b), _) in reference.iter().zip(test).zip(near).filter(|(_, near)| **near) {
                for c in 0..3 {
                    sum += f64::from(shown(b[c], quantisation) - shown(a[c], quantisation)).powi(2);
                }
                count += 1;
            }
            (sum, count)
        })
        .collect();
    let (sum, count) = sums.iter().fold((0.0, 0), |(s, n), (sum, count)| (s + sum, n + count));
    Ok((count > 0).then(|| psnr_from_mse(sum / (3 * count) as f64)))
}
