//! Peak signal-to-noise ratios, dB.

use gs3_scene::Image;

/// A mean squared error below which images count as equal: 120 dB.
const LEAST: f64 = 1e-12;

/// PSNR of the colours of `image` against `truth`, peak 1, at most 120 dB.
///
/// # Panics
/// If the images have different sizes.
#[must_use]
pub fn psnr(image: &Image, truth: &Image) -> f64 {
    of(image, truth, f64::from)
}

/// As [`psnr`], of the colours as they are shown: clamped to `[0, 1]`.
///
/// # Panics
/// If the images have different sizes.
#[must_use]
pub fn psnr_shown(image: &Image, truth: &Image) -> f64 {
    of(image, truth, |v| f64::from(v.clamp(0.0, 1.0)))
}

/// PSNR of bytes against `truth`, peak 255, at most 120 dB.
///
/// # Panics
/// If there are different numbers of bytes.
#[must_use]
pub fn psnr_of_bytes(bytes: &[u8], truth: &[u8]) -> f64 {
    assert_eq!(bytes.len(), truth.len(), "bytes of two images");
    let squares =
        bytes.iter().zip(truth).map(|(a, b)| (f64::from(*a) / 255.0 - f64::from(*b) / 255.0).powi(2));
    decibels(squares.sum::<f64>() / truth.len() as f64)
}

/// The largest difference of a colour between `image` and `truth` once the `share` of the pixels with the largest
/// differences is left out: what a mean does not show.
///
/// # Panics
/// If the images have different sizes, or `share` leaves no pixel.
#[must_use]
pub fn largest_difference_but(image: &Image, truth: &Image, share: f64) -> f32 {
    assert_eq!(image.size(), truth.size(), "sizes of two images");
    let pairs = image.pixels().iter().zip(truth.pixels());
    let mut differences: Vec<f32> =
        pairs.map(|(a, b)| (0..3).map(|c| (a[c] - b[c]).abs()).fold(0.0, worse)).collect();
    let last = differences.len() - 1 - (share * differences.len() as f64) as usize;
    *differences.select_nth_unstable_by(last, f32::total_cmp).1
}

/// The larger of two differences. A difference that is not a number counts as larger than any number.
fn worse(a: f32, b: f32) -> f32 {
    if b <= a { a } else { b }
}

fn of(image: &Image, truth: &Image, seen: impl Fn(f32) -> f64) -> f64 {
    assert_eq!(image.size(), truth.size(), "sizes of two images");
    let pairs = image.pixels().iter().zip(truth.pixels());
    let squares = pairs.map(|(a, b)| (0..3).map(|c| (seen(a[c]) - seen(b[c])).powi(2)).sum::<f64>());
    decibels(squares.sum::<f64>() / (3 * truth.pixels().len()) as f64)
}

/// # Panics
/// If a number was not finite: comparisons would pass it.
fn decibels(mse: f64) -> f64 {
    assert!(mse.is_finite(), "expected finite colours, found a mean squared error of {mse}");
    -10.0 * mse.max(LEAST).log10()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tenth_of_the_peak_is_20_db() {
        let image = |value: f32| Image::from_pixels(2, 1, vec![[value; 4]; 2]).expect("two pixels");
        assert!((psnr(&image(0.5), &image(0.6)) - 20.0).abs() < 1e-5);
        assert!((psnr_shown(&image(0.9), &image(7.0)) - 20.0).abs() < 1e-5);
        assert!((psnr_of_bytes(&[0, 51], &[51, 0]) - 13.979_4).abs() < 1e-4);
        assert!((psnr(&image(0.5), &image(0.5)) - 120.0).abs() < 1e-9);
    }

    #[test]
    #[should_panic(expected = "expected finite colours")]
    fn what_is_no_number_is_not_equal() {
        let image = |value: f32| Image::from_pixels(1, 1, vec![[value; 4]]).expect("a pixel");
        assert!(largest_difference_but(&image(f32::NAN), &image(0.0), 0.0).is_nan());
        let _ = psnr(&image(f32::NAN), &image(0.0));
    }

    #[test]
    fn a_share_of_the_pixels_is_left_out() {
        let truth = Image::from_pixels(4, 1, vec![[0.0; 4]; 4]).expect("four pixels");
        let values = [0.5, 0.0, 0.25, 0.125].map(|v| [0.0, v, 0.0, 9.0]);
        let image = Image::from_pixels(4, 1, values.to_vec()).expect("four pixels");
        assert_eq!(
            [0.0, 0.25, 0.5].map(|share| largest_difference_but(&image, &truth, share)),
            [0.5, 0.25, 0.125]
        );
    }
}
