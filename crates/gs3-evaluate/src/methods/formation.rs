//! LR frames by reduction of the native image.

use gs3_scene::{GBuffer, Image, Planes};
use rayon::prelude::*;

/// Reduces `image` by `scale` to the colour of `lr` with an antialiasing bicubic filter: the Catmull–Rom kernel (a =
/// −½) stretched by `scale`, weights normalised inside the image, as MATLAB's `imresize` and Pillow's `BICUBIC` do. The
/// other planes of `lr` are dropped. The sides of `image` are multiples of `scale`.
pub(super) fn reduce(image: &Image, scale: u32, lr: &mut GBuffer) {
    let (width, height) = (image.width() / scale as usize, image.height() / scale as usize);
    *lr = GBuffer {
        color: std::mem::take(&mut lr.color),
        alpha: Planes::new(width, height),
        ..GBuffer::default()
    };
    lr.color.resize(width, height);
    let across: Vec<Taps> = (0..width).map(|x| Taps::new(x, scale, image.width())).collect();
    let down: Vec<Taps> = (0..height).map(|y| Taps::new(y, scale, image.height())).collect();
    // Rows first: [image height, width].
    let mut rows = vec![[0.0f32; 3]; image.height() * width];
    rows.par_chunks_exact_mut(width).enumerate().for_each(|(y, row)| {
        for (value, taps) in row.iter_mut().zip(&across) {
            for (pixel, weight) in image.row(y)[taps.first..].iter().zip(&taps.weights) {
                (0..3).for_each(|c| value[c] += weight * pixel[c]);
            }
        }
    });
    lr.color.data_mut().par_chunks_exact_mut(width).enumerate().for_each(|(i, row)| {
        let (c, taps) = (i / height, &down[i % height]);
        for (x, value) in row.iter_mut().enumerate() {
            let column = rows[taps.first * width + x..].iter().step_by(width);
            *value = column.zip(&taps.weights).map(|(v, weight)| weight * v[c]).sum();
        }
    });
}

/// The source pixels of one reduced pixel.
struct Taps {
    first: usize,
    weights: Vec<f32>,
}

impl Taps {
    fn new(index: usize, scale: u32, length: usize) -> Self {
        let s = f64::from(scale);
        let centre = (index as f64 + 0.5) * s;
        let first = (centre - 2.0 * s).round().max(0.0) as usize;
        let last = ((centre + 2.0 * s).round() as usize).min(length);
        let raw: Vec<f64> = (first..last).map(|i| catmull_rom((i as f64 + 0.5 - centre) / s)).collect();
        let sum: f64 = raw.iter().sum();
        Self { first, weights: raw.iter().map(|w| (w / sum) as f32).collect() }
    }
}

fn catmull_rom(x: f64) -> f64 {
    let x = x.abs();
    match x {
        x if x < 1.0 => (1.5 * x - 2.5) * x * x + 1.0,
        x if x < 2.0 => ((-0.5 * x + 2.5) * x - 4.0) * x + 2.0,
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_pillow() {
        // numpy.arange(12) ** 2 / 121 as a 12×1 image in mode F, resized to 3×1 with BICUBIC (Pillow 13.0).
        let pixels = (0..12).flat_map(|x| [[(x * x) as f32 / 121.0; 4]; 4]);
        let mut columns: Vec<[f32; 4]> = pixels.collect();
        // [12, 4] to [4, 12]: four equal rows.
        columns =
            (0..4).flat_map(|y| (0..12).map(move |x| (x, y))).map(|(x, y)| columns[x * 4 + y]).collect();
        let image = Image::from_pixels(12, 4, columns).unwrap_or_default();
        let mut lr = GBuffer::default();
        reduce(&image, 4, &mut lr);
        assert_eq!((lr.width(), lr.height()), (3, 1));
        for (actual, expected) in lr.color.row(1, 0).iter().zip(PILLOW) {
            assert!((actual - expected).abs() < 1e-6, "{actual} against {expected}");
        }
    }

    const PILLOW: [f32; 3] = [0.025062311440706253, 0.25903186202049255, 0.7357405424118042];
}
