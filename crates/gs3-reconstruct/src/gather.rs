//! Samples an HR image at fractional positions.

use fearless_simd::{Simd, f32x4, f32x16, i32x16, prelude::*};
use gs3_scene::Image;

use crate::resample::{catmull_rom, clamped};

/// Places to sample an image at: sixteen positions with their Catmull–Rom weights.
#[derive(Clone, Copy)]
pub(crate) struct Places {
    x: [f32; 16],
    y: [f32; 16],
    column: [i32; 16],
    row: [i32; 16],
    /// Weights of the four columns (rows) around each position.
    wx: [[f32; 16]; 4],
    wy: [[f32; 16]; 4],
}

impl Places {
    /// Positions with pixel centres at whole numbers.
    #[inline(always)]
    pub fn new<S: Simd>(x: f32x16<S>, y: f32x16<S>) -> Self {
        let (floor_x, floor_y) = (x.floor(), y.floor());
        let [a, b, c, d] = catmull_rom_16(x - floor_x);
        let [e, f, g, h] = catmull_rom_16(y - floor_y);
        Self {
            x: x.to_array(),
            y: y.to_array(),
            column: floor_x.to_int::<i32x16<S>>().to_array(),
            row: floor_y.to_int::<i32x16<S>>().to_array(),
            wx: [a.to_array(), b.to_array(), c.to_array(), d.to_array()],
            wy: [e.to_array(), f.to_array(), g.to_array(), h.to_array()],
        }
    }

    /// The Catmull–Rom interpolated pixel at position `k`; the border repeats. Positions far outside or not finite give a
    /// border pixel.
    ///
    /// Four rows of four pixels are four 512-bit loads.
    #[inline(always)]
    pub fn gather<S: Simd>(&self, simd: S, image: &Image, k: usize) -> f32x4<S> {
        let (column, row) = (self.column[k] as isize - 1, self.row[k] as isize - 1);
        let (width, height) = (image.width() as isize, image.height() as isize);
        if column < 0 || row < 0 || column + 4 > width || row + 4 > height {
            return f32x4::load_array(simd, gather_at_border(image, self.x[k], self.y[k]));
        }
        let start = (row * width + column) as usize;
        let pixels = image.pixels();
        let taps = |r: usize| {
            f32x16::from_slice(simd, pixels[start + r * width as usize..][..4].as_flattened())
                * f32x16::splat(simd, self.wy[r][k])
        };
        let (low, high) = ((taps(0) + taps(1)) + (taps(2) + taps(3))).split();
        let ((a, b), (c, d)) = (low.split(), high.split());
        let weight = |i: usize| f32x4::splat(simd, self.wx[i][k]);
        (a * weight(0) + b * weight(1)) + (c * weight(2) + d * weight(3))
    }
}

/// [`catmull_rom`] of sixteen positions.
#[inline(always)]
fn catmull_rom_16<S: Simd>(f: f32x16<S>) -> [f32x16<S>; 4] {
    let (f2, f3) = (f * f, f * f * f);
    [f2 - (f3 + f) * 0.5, f3 * 1.5 - f2 * 2.5 + 1.0, f2 * 2.0 - f3 * 1.5 + f * 0.5, (f3 - f2) * 0.5]
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
