//! Samples HR images at fractional positions.

use fearless_simd::{Simd, f32x16, prelude::*};
use gs3_scene::Image;

use crate::resample::{catmull_rom, clamped};

/// Binary digits of positions after the point: 1/128 px is the largest error, far below what reprojected depths are
/// good for, and the weights of all phases fit into the first-level cache.
pub(crate) const PHASE_BITS: u32 = 6;
const PHASES: usize = 1 << PHASE_BITS;
/// Fixed-point positions per pixel.
pub(crate) const UNITS: f32 = PHASES as f32;

/// Pixels in a run that is gathered at once: four RGBA pixels are one vector.
pub(crate) const QUAD: usize = 4;

/// Catmull–Rom weights of four taps, each repeated for four channels.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
struct Taps([f32; 16]);

/// Catmull–Rom interpolation of RGBA images; pixel centres at whole numbers, the border repeats.
///
/// Positions are fixed-point numbers of 1/[`UNITS`] px, any value of `i32`.
#[derive(Debug)]
pub(crate) struct Gather {
    phases: Box<[Taps; PHASES]>,
}

impl Gather {
    pub fn new() -> Self {
        let taps = |phase: usize| {
            let weights = catmull_rom(phase as f32 / PHASES as f32);
            Taps(std::array::from_fn(|k| weights[k / 4]))
        };
        Self { phases: Box::new(std::array::from_fn(taps)) }
    }

    /// The weights at a position, and the pixel of the first of them.
    #[inline(always)]
    fn place(&self, position: i32) -> (&[f32; 16], isize) {
        let phase = position as usize % PHASES;
        (&self.phases[phase].0, (position >> PHASE_BITS) as isize - 1)
    }

    /// Sum over four rows of `N` vectors of four pixels from `(column, row)` on; `None` if they are not all inside.
    #[inline(always)]
    fn rows<S: Simd, const N: usize>(
        simd: S,
        image: &Image,
        (column, row): (isize, isize),
        weights: &[f32; 16],
    ) -> Option<[f32x16<S>; N]> {
        let (width, height) = (image.width(), image.height());
        let inside =
            column >= 0 && row >= 0 && column as usize + 4 * N <= width && row as usize + 4 <= height;
        if !inside {
            return None;
        }
        let mut sums = [f32x16::splat(simd, 0.0); N];
        let start = row as usize * width + column as usize;
        // One check for all loads.
        let pixels = image.pixels()[start..start + 3 * width + 4 * N].as_flattened();
        for k in 0..4 {
            let weight = f32x16::splat(simd, weights[4 * k]);
            for (n, sum) in sums.iter_mut().enumerate() {
                let at = 4 * (k * width + 4 * n);
                *sum = f32x16::from_slice(simd, &pixels[at..at + 16]).mul_add(weight, *sum);
            }
        }
        Some(sums)
    }

    /// The pixel at `(x, y)`, times `weight`: four taps whose sum it is.
    #[inline(always)]
    pub fn pixel<S: Simd>(&self, simd: S, image: &Image, [x, y]: [i32; 2], weight: f32) -> f32x16<S> {
        let ((x_weights, column), (y_weights, row)) = (self.place(x), self.place(y));
        match Self::rows::<S, 1>(simd, image, (column, row), y_weights) {
            Some([sum]) => sum * (f32x16::load_array_ref(simd, x_weights) * f32x16::splat(simd, weight)),
            None => {
                let pixel = self.pixel_at_border(image, [x, y]);
                let taps = std::array::from_fn(|k| if k < 4 { weight * pixel[k] } else { 0.0 });
                f32x16::load_array(simd, taps)
            }
        }
    }

    /// Four pixels in a row, the first at `(x, y)`; `None` near the border.
    #[inline(always)]
    pub fn quad<S: Simd>(&self, simd: S, image: &Image, [x, y]: [i32; 2]) -> Option<f32x16<S>> {
        let ((x_weights, column), (y_weights, row)) = (self.place(x), self.place(y));
        let [a, b] = Self::rows::<S, 2>(simd, image, (column, row), y_weights)?;
        let weight = |k: usize| f32x16::splat(simd, x_weights[4 * k]);
        let (even, odd) = (a * weight(0), a.slide::<4>(b) * weight(1));
        let even = a.slide::<8>(b).mul_add(weight(2), even);
        let odd = a.slide::<12>(b).mul_add(weight(3), odd);
        Some(even + odd)
    }

    /// Four rows of four pixels, the first at `(x, y)`; `None` near the border.
    #[inline(always)]
    pub fn patch<S: Simd>(&self, simd: S, image: &Image, [x, y]: [i32; 2]) -> Option<[f32x16<S>; QUAD]> {
        let ((x_weights, column), (y_weights, row)) = (self.place(x), self.place(y));
        let (width, height) = (image.width(), image.height());
        let inside = column >= 0
            && row >= 0
            && column as usize + 2 * QUAD <= width
            && row as usize + 2 * QUAD <= height + 1;
        if !inside {
            return None;
        }
        let start = row as usize * width + column as usize;
        // One check for all loads.
        let pixels = image.pixels()[start..start + (2 * QUAD - 2) * width + 2 * QUAD].as_flattened();
        let (mut left, mut right) = ([f32x16::splat(simd, 0.0); QUAD], [f32x16::splat(simd, 0.0); QUAD]);
        for k in 0..2 * QUAD - 1 {
            let at = 4 * k * width;
            let a = f32x16::from_slice(simd, &pixels[at..at + 16]);
            let b = f32x16::from_slice(simd, &pixels[at + 16..at + 32]);
            for r in 0..QUAD {
                if k >= r && k < r + QUAD {
                    let weight = y_weights[4 * (k - r)];
                    left[r] = a.mul_add(weight, left[r]);
                    right[r] = b.mul_add(weight, right[r]);
                }
            }
        }
        let mut quads = left;
        for r in 0..QUAD {
            let (a, b) = (left[r], right[r]);
            let odd = (a.slide::<4>(b)).mul_add(x_weights[4], a * x_weights[0]);
            let even = (a.slide::<12>(b)).mul_add(x_weights[12], a.slide::<8>(b) * x_weights[8]);
            quads[r] = odd + even;
        }
        Some(quads)
    }

    #[cold]
    #[inline(never)]
    fn pixel_at_border(&self, image: &Image, [x, y]: [i32; 2]) -> [f32; 4] {
        let ((x_weights, column), (y_weights, row)) = (self.place(x), self.place(y));
        let mut sum = [0.0; 4];
        for l in 0..4 {
            let pixels = image.row(clamped(row + l as isize, image.height()));
            for k in 0..4 {
                let pixel = pixels[clamped(column + k as isize, image.width())];
                for c in 0..4 {
                    sum[c] += x_weights[4 * k] * y_weights[4 * l] * pixel[c];
                }
            }
        }
        sum
    }
}

/// The sum of four pixels.
#[inline(always)]
pub(crate) fn sum_of_pixels<S: Simd>(pixels: f32x16<S>) -> [f32; 4] {
    let (a, b) = pixels.split();
    let (a, b) = (a + b).split();
    (a + b).to_array()
}
