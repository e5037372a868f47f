//! Samples an HR image at fractional positions.

use fearless_simd::{Simd, f32x4, f32x16, prelude::*};
use gs3_scene::Image;

use crate::resample::{catmull_rom, clamped};

/// The Catmull–Rom interpolated pixel at `(x, y)`, pixel centres at whole numbers; the border repeats. Positions far
/// outside or not finite give a border pixel.
///
/// Four rows of four pixels are four 512-bit loads.
#[inline(always)]
pub(crate) fn gather<S: Simd>(simd: S, image: &Image, x: f32, y: f32) -> [f32; 4] {
    let (fx, fy) = (x.floor(), y.floor());
    let (wx, wy) = (catmull_rom(x - fx), catmull_rom(y - fy));
    let (column, row) = (fx as isize - 1, fy as isize - 1);
    let (width, height) = (image.width(), image.height());
    if column < 0 || row < 0 || column as usize + 4 > width || row as usize + 4 > height {
        return gather_at_border(image, x, y);
    }
    let mut sum = f32x16::splat(simd, 0.0);
    for (k, weight) in wy.into_iter().enumerate() {
        let start = (row as usize + k) * width + column as usize;
        let taps = f32x16::from_slice(simd, image.pixels()[start..start + 4].as_flattened());
        sum = taps.mul_add(f32x16::splat(simd, weight), sum);
    }
    let pixels = sum.to_array();
    let tap = |k: usize| f32x4::from_slice(simd, &pixels[4 * k..4 * k + 4]);
    let splat = |k: usize| f32x4::splat(simd, wx[k]);
    let (a, b) = (tap(0) * splat(0), tap(1) * splat(1));
    let (a, b) = (tap(2).mul_add(splat(2), a), tap(3).mul_add(splat(3), b));
    (a + b).to_array()
}

#[cold]
fn gather_at_border(image: &Image, x: f32, y: f32) -> [f32; 4] {
    let (width, height) = (image.width(), image.height());
    // NaN falls to the border as well.
    let x = if x >= -1.0 { x.min(width as f32) } else { -1.0 };
    let y = if y >= -1.0 { y.min(height as f32) } else { -1.0 };
    let (fx, fy) = (x.floor(), y.floor());
    let (wx, wy) = (catmull_rom(x - fx), catmull_rom(y - fy));
    let mut sum = [0.0; 4];
    for (k, &wy) in wy.iter().enumerate() {
        let row = image.row(clamped(fy as isize - 1 + k as isize, height));
        for (l, &wx) in wx.iter().enumerate() {
            let pixel = row[clamped(fx as isize - 1 + l as isize, width)];
            for c in 0..4 {
                sum[c] += wx * wy * pixel[c];
            }
        }
    }
    sum
}
