//! Samples HR images at fractional positions.

use fearless_simd::{Simd, f32x4, f32x8, f32x16, prelude::*};
use gs3_scene::Image;

use crate::cpu::resample::clamped;

/// Fractional bits of positions. The largest error is 1/128 px, far below the accuracy of reprojected depths. The
/// weights of all phases fit into the first-level cache.
pub(crate) const PHASE_BITS: u32 = 6;
const PHASES: usize = 1 << PHASE_BITS;
/// Fixed-point positions per pixel.
pub(crate) const UNITS: f32 = PHASES as f32;

/// Pixels in a run that is gathered at once: four RGBA pixels are one vector.
pub(crate) const QUAD: usize = 4;

/// Number of pixels along each axis that a value is interpolated from.
pub(crate) const TAPS: usize = 6;

/// Number of taps before the tap at the position.
pub(crate) const BEFORE: usize = TAPS / 2 - 1;

/// Weights of the taps, each repeated for four channels. Two zeros fill up the vectors.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
struct Taps([[f32; 16]; 2]);

impl Taps {
    #[inline(always)]
    fn weight(&self, tap: usize) -> f32 {
        self.0[tap / 4][tap % 4 * 4]
    }
}

/// Interpolation of RGBA images from 6×6 pixels ([`weights`]). Pixel centres are at whole numbers; the border
/// repeats.
///
/// Positions are fixed-point numbers of 1/[`UNITS`] px, any value of `i32`.
#[derive(Debug)]
pub(crate) struct Gather {
    phases: Box<[Taps; PHASES]>,
}

/// Factors of `f` (1 − `f`) and of `f`² (1 − `f`) in the weights of the taps −2, −1 and 0. The factors of 3, 2 and 1
/// mirror them.
///
/// They are fitted, within 0.004, to the weights of least mean squared error for images like splats: a spectrum that
/// falls with the square of the frequency (natural images; Field 1987), low-passed by the native dilation of 0.3 px²,
/// sampled at pixels. With any factors, the weights at `f` = 0 are the pixel itself, and the weights sum to 1.
pub(crate) const FIT: [[f32; 2]; BEFORE + 1] = [[0.204, -0.102], [-0.879, 0.515], [1.0045, -1.072]];

/// Weights of the samples −2 to 3 at `f` ∈ `[0, 1)` between samples 0 and 1.
///
/// On four captured paths, in-between frames of true frames are 0.9 to 2.5 dB nearer to the truth than with
/// Catmull–Rom, and in-between frames of kriged frames 0.3 to 0.65 dB (`docs/performance.md`). Eight taps would gain
/// 0.01 to 0.04 dB more.
fn weights(f: f32) -> [f32; TAPS] {
    let half = |f: f32| FIT.map(|[first, second]| f * (1.0 - f) * (first + second * f));
    let ([a, b, c], [z, y, x]) = (half(f), half(1.0 - f));
    [a, b, 1.0 - f + c, f + x, y, z]
}

impl Gather {
    pub fn new() -> Self {
        let taps = |phase: usize| {
            let weights = weights(phase as f32 / PHASES as f32);
            let weight = |k: usize| weights.get(k).copied().unwrap_or(0.0);
            Taps(std::array::from_fn(|v| std::array::from_fn(|k| weight(4 * v + k / 4))))
        };
        Self { phases: Box::new(std::array::from_fn(taps)) }
    }

    /// The weights at a position, and the pixel of the first tap.
    #[inline(always)]
    fn place(&self, position: i32) -> (&Taps, isize) {
        let phase = position as usize % PHASES;
        (&self.phases[phase], (position >> PHASE_BITS) as isize - BEFORE as isize)
    }

    /// `rows` rows of `columns` pixels from `(column, row)` on, the image's width apart; `None` if some are outside.
    #[inline(always)]
    fn inside(image: &Image, [column, row]: [isize; 2], columns: usize, rows: usize) -> Option<&[f32]> {
        let (width, height) = (image.width(), image.height());
        let inside =
            column >= 0 && row >= 0 && column as usize + columns <= width && row as usize + rows <= height;
        if !inside {
            return None;
        }
        let start = row as usize * width + column as usize;
        // One check for all loads.
        Some(image.pixels()[start..start + (rows - 1) * width + columns].as_flattened())
    }

    /// Four pixels from the twelve pixels that they are interpolated from.
    #[inline(always)]
    fn across<S: Simd>([a, b, c]: [f32x16<S>; 3], weights: &Taps) -> f32x16<S> {
        let odd = a.slide::<4>(b).mul_add(weights.weight(1), a * weights.weight(0));
        let even = a.slide::<12>(b).mul_add(weights.weight(3), a.slide::<8>(b) * weights.weight(2));
        b.mul_add(weights.weight(4), odd) + b.slide::<4>(c).mul_add(weights.weight(5), even)
    }

    /// The pixel at `(x, y)`.
    #[inline(always)]
    pub fn pixel<S: Simd>(&self, simd: S, image: &Image, [x, y]: [i32; 2]) -> f32x4<S> {
        let ((across, column), (down, row)) = (self.place(x), self.place(y));
        let Some(pixels) = Self::inside(image, [column, row], TAPS, TAPS) else {
            return f32x4::load_array(simd, self.pixel_at_border(image, [x, y]));
        };
        // Two taps a vector.
        let mut sums = [f32x8::splat(simd, 0.0); TAPS / 2];
        for k in 0..TAPS {
            let pixels = &pixels[4 * k * image.width()..][..4 * TAPS];
            let weight = f32x8::splat(simd, down.weight(k));
            for (sum, pixels) in sums.iter_mut().zip(pixels.as_chunks::<8>().0) {
                *sum = f32x8::load_array_ref(simd, pixels).mul_add(weight, *sum);
            }
        }
        let mut both = f32x8::splat(simd, 0.0);
        for (sum, weights) in sums.iter().zip(across.0.as_flattened().as_chunks::<8>().0) {
            both = sum.mul_add(f32x8::load_array_ref(simd, weights), both);
        }
        let (even, odd) = both.split();
        even + odd
    }

    /// Four pixels in a row, the first at `(x, y)`; `None` near the border.
    #[inline(always)]
    pub fn quad<S: Simd>(&self, simd: S, image: &Image, [x, y]: [i32; 2]) -> Option<f32x16<S>> {
        let ((across, column), (down, row)) = (self.place(x), self.place(y));
        let pixels = Self::inside(image, [column, row], 3 * QUAD, TAPS)?;
        let mut sums = [f32x16::splat(simd, 0.0); 3];
        for k in 0..TAPS {
            let pixels = &pixels[4 * k * image.width()..][..12 * QUAD];
            let weight = f32x16::splat(simd, down.weight(k));
            for (sum, pixels) in sums.iter_mut().zip(pixels.as_chunks::<16>().0) {
                *sum = f32x16::load_array_ref(simd, pixels).mul_add(weight, *sum);
            }
        }
        Some(Self::across(sums, across))
    }

    /// Four rows of four pixels, the first at `(x, y)`; `None` near the border.
    #[inline(always)]
    pub fn patch<S: Simd>(&self, simd: S, image: &Image, [x, y]: [i32; 2]) -> Option<[f32x16<S>; QUAD]> {
        const SIDE: usize = QUAD + TAPS - 1;
        let ((across, column), (down, row)) = (self.place(x), self.place(y));
        let pixels = Self::inside(image, [column, row], SIDE, SIDE)?;
        let (mut of_columns, mut of_rows) =
            ([f32x16::splat(simd, 0.0); TAPS], [f32x16::splat(simd, 0.0); TAPS]);
        for k in 0..TAPS {
            of_columns[k] = f32x16::splat(simd, across.weight(k));
            of_rows[k] = f32x16::splat(simd, down.weight(k));
        }
        let mut sums = [f32x16::splat(simd, 0.0); QUAD];
        // Rows first: a tap's pixels are then an unaligned load instead of a shift of vectors. Four sums and a row
        // fit the sixteen registers of AVX2.
        for k in 0..SIDE {
            let pixels = &pixels[4 * k * image.width()..][..4 * SIDE];
            let mut row = f32x16::from_slice(simd, &pixels[..4 * QUAD]) * of_columns[0];
            for tap in 1..TAPS {
                let pixels = &pixels[4 * tap..4 * (tap + QUAD)];
                row = f32x16::from_slice(simd, pixels).mul_add(of_columns[tap], row);
            }
            for r in 0..QUAD {
                if k >= r && k < r + TAPS {
                    sums[r] = row.mul_add(of_rows[k - r], sums[r]);
                }
            }
        }
        Some(sums)
    }

    #[cold]
    #[inline(never)]
    fn pixel_at_border(&self, image: &Image, [x, y]: [i32; 2]) -> [f32; 4] {
        let ((x_weights, column), (y_weights, row)) = (self.place(x), self.place(y));
        let mut sum = [0.0; 4];
        for l in 0..TAPS {
            let pixels = image.row(clamped(row + l as isize, image.height()));
            for k in 0..TAPS {
                let pixel = pixels[clamped(column + k as isize, image.width())];
                for c in 0..4 {
                    sum[c] += x_weights.weight(k) * y_weights.weight(l) * pixel[c];
                }
            }
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::resample::catmull_rom;

    /// Waves along both axes of at most `most` cycles per pixel, at (x, y).
    fn waves(x: f32, y: f32, most: f32) -> f32 {
        let wave =
            |k: u8| (most * f32::from(k) / 5.0 * (x + 0.7 * y) * std::f32::consts::TAU + f32::from(k)).sin();
        (1..=5).map(wave).sum()
    }

    #[test]
    fn weights_are_those_of_the_pixel_itself_where_one_is_and_sum_to_one() {
        assert_eq!(weights(0.0), [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
        for phase in 0..PHASES {
            let weights = weights(phase as f32 / PHASES as f32);
            assert!((weights.iter().sum::<f32>() - 1.0).abs() < 1e-6, "{weights:?}");
        }
    }

    #[test]
    fn weights_are_the_same_from_either_side() {
        for phase in 1..PHASES {
            let mut mirrored = weights(1.0 - phase as f32 / PHASES as f32);
            mirrored.reverse();
            for (a, b) in weights(phase as f32 / PHASES as f32).into_iter().zip(mirrored) {
                assert!((a - b).abs() < 1e-6, "{a} and {b}");
            }
        }
    }

    /// Along one axis, at all phases.
    #[test]
    fn detail_is_nearer_to_the_truth_than_by_four_pixels() {
        for most in [0.2, 0.3, 0.4] {
            let (mut six, mut four) = (0.0, 0.0);
            for phase in 0..20 * PHASES {
                let (x, f) = ((phase / PHASES) as f32, (phase % PHASES) as f32 / PHASES as f32);
                let truth = waves(x + f, 0.0, most);
                let sum = |weights: &[f32], first: f32| {
                    let taps = weights.iter().enumerate();
                    taps.map(|(k, weight)| weight * waves(x + first + k as f32, 0.0, most)).sum::<f32>()
                };
                six += (sum(&weights(f), -2.0) - truth).powi(2);
                four += (sum(&catmull_rom(f), -1.0) - truth).powi(2);
            }
            assert!(six < 0.6 * four, "{most} cycles per pixel: {six} and {four}");
        }
    }

    #[test]
    fn pixels_quads_and_patches_are_sums_of_36_pixels() {
        let (width, height) = (24, 20);
        let mut image = Image::new(width, height);
        for (k, pixel) in image.pixels_mut().iter_mut().enumerate() {
            let (x, y) = ((k % width) as f32, (k / width) as f32);
            *pixel = [waves(x, y, 0.4), waves(y, x, 0.3), x, y * y];
        }
        let (gather, level) = (Gather::new(), gs3_simd::level());
        let near = |a: &[f32], b: &[f32], what: &str| {
            for (a, b) in a.iter().zip(b) {
                assert!((a - b).abs() < 1e-3, "{what}: {a} and {b}");
            }
        };
        for place in [[7.3, 8.8], [10.0, 9.5], [2.0, 2.0]] {
            let [x, y] = place.map(|v: f32| (v * UNITS).round() as i32);
            let pixel = |k: usize, l: usize| {
                gather.pixel_at_border(&image, [x + (k * PHASES) as i32, y + (l * PHASES) as i32])
            };
            fearless_simd::dispatch!(level, simd => {
                near(&gather.pixel(simd, &image, [x, y]).to_array(), &pixel(0, 0), "pixel");
                let quad = gather.quad(simd, &image, [x, y]).unwrap().to_array();
                let patch = gather.patch(simd, &image, [x, y]).unwrap().map(|row| row.to_array());
                for k in 0..QUAD {
                    near(&quad[4 * k..4 * k + 4], &pixel(k, 0), "quad");
                    for (l, row) in patch.iter().enumerate() {
                        near(&row[4 * k..4 * k + 4], &pixel(k, l), "patch");
                    }
                }
            });
        }
        // A gather that needs pixels beyond the border is left to code that repeats the border.
        let beyond = [(1.9, 5.0), (5.0, 1.9), (18.1, 5.0), (5.0, 14.1)];
        for (x, y) in beyond.map(|(x, y): (f32, f32)| ((x * UNITS) as i32, (y * UNITS) as i32)) {
            fearless_simd::dispatch!(level, simd => {
                assert!(gather.patch(simd, &image, [x, y]).is_none());
            });
        }
        let corner = gather.pixel_at_border(&image, [-1000 * PHASES as i32, -3 * PHASES as i32]);
        near(&corner, &image.pixels()[0], "corner");
    }
}
