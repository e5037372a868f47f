//! The error of the worst blocks: faults that cover little of an image hardly change its mean error, and are what
//! people see first.

use gs3_scene::Image;
use rayon::prelude::*;

use super::mean_square::{Quantisation, shown};
use super::{MetricError, same_size};

/// Side of a block in pixels.
pub const BLOCK: usize = 8;

/// The root mean squared error of every [`BLOCK`]² block over RGB, in 1/255 of the range, so in `[0, 255]`; row by row
/// from the top left. Blocks at the right and lower border hold the pixels that are left.
///
/// # Errors
/// [`MetricError`] if sizes differ or the images are empty.
pub fn block_rmse(
    reference: &Image,
    test: &Image,
    quantisation: Quantisation,
) -> Result<Vec<f64>, MetricError> {
    same_size(reference, "test image", test)?;
    let (width, height) = (reference.width(), reference.height());
    if width == 0 || height == 0 {
        return Err(MetricError::TooSmall { metric: "block RMSE", min: 1, actual: reference.size() });
    }
    let columns = width.div_ceil(BLOCK);
    let rows: Vec<Vec<f64>> = (0..height.div_ceil(BLOCK))
        .into_par_iter()
        .map(|row| {
            let lines = row * BLOCK..height.min((row + 1) * BLOCK);
            let mut sums = vec![0.0; columns];
            for y in lines.clone() {
                let blocks = reference.row(y).chunks(BLOCK).zip(test.row(y).chunks(BLOCK));
                for (sum, (reference, test)) in sums.iter_mut().zip(blocks) {
                    for (a, b) in reference.iter().zip(test) {
                        for c in 0..3 {
                            *sum += f64::from(shown(b[c], quantisation) - shown(a[c], quantisation)).powi(2);
                        }
                    }
                }
            }
            for (column, sum) in sums.iter_mut().enumerate() {
                let count = 3 * lines.len() * (width - column * BLOCK).min(BLOCK);
                *sum = (*sum / count as f64).sqrt() * 255.0;
            }
            sums
        })
        .collect();
    Ok(rows.concat())
}

/// The 99th percentile of [`block_rmse`], in `[0, 255]`: one block in a hundred is worse. Between two blocks it is
/// interpolated linearly, as NumPy's `percentile` does.
///
/// # Errors
/// [`MetricError`] if sizes differ or the images are empty.
pub fn block_rmse_p99(
    reference: &Image,
    test: &Image,
    quantisation: Quantisation,
) -> Result<f64, MetricError> {
    let mut blocks = block_rmse(reference, test, quantisation)?;
    blocks.sort_by(f64::total_cmp);
    let rank = 0.99 * (blocks.len() - 1) as f64;
    let below = blocks[rank as usize];
    let above = blocks[(rank as usize + 1).min(blocks.len() - 1)];
    Ok(below + rank.fract() * (above - below))
}
