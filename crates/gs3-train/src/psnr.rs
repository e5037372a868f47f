//! Errors of images, and their PSNR.

use crate::clip::from_unorm;

/// A mean squared error below which frames count as equal: 100 dB. The noise of targets in 16 bits is at 107 dB.
const LEAST_ERROR: f64 = 1e-10;

/// Errors of an image against a target, `[height, width, channels]`, shown in `[0, 1]`; the first three channels are
/// RGB. The result is RGB, at least `margin` pixels from the border.
pub fn subtract(image: &[f32], [width, channels, margin]: [usize; 3], target: &[u16], errors: &mut Vec<f32>) {
    errors.clear();
    let (rows, targets) = (image.chunks_exact(width * channels), target.chunks_exact(width * 3));
    let inside = rows.len().saturating_sub(2 * margin);
    for (row, target) in rows.zip(targets).skip(margin).take(inside) {
        let pixels = row.chunks_exact(channels).zip(target.as_chunks::<3>().0);
        let pixels = pixels.skip(margin).take(width.saturating_sub(2 * margin));
        errors.extend(
            pixels.flat_map(|(image, target)| {
                [0, 1, 2].map(|c| image[c].clamp(0.0, 1.0) - from_unorm(target[c]))
            }),
        );
    }
}

/// PSNR in dB of errors, peak 1; without errors, the PSNR of equal frames.
pub fn psnr(errors: impl ExactSizeIterator<Item = f32>) -> f64 {
    let count = errors.len() as f64;
    let sum: f64 = errors.map(|e| f64::from(e) * f64::from(e)).sum();
    -10.0 * (sum / count).max(LEAST_ERROR).log10()
}
