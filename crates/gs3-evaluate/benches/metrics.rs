//! Milliseconds per 1920×1080 frame of each metric: `cargo bench -p gs3-evaluate --bench metrics`. Must: PSNR + SSIM ≤
//! 60 ms on 2 cores.

use std::time::Instant;

use gs3_evaluate::metrics::flip::DEFAULT_PIXELS_PER_DEGREE;
use gs3_evaluate::metrics::{Quantisation, SsimBorder, flip, psnr, ssim};
use gs3_scene::Image;

const WIDTH: usize = 1920;
const HEIGHT: usize = 1080;

/// A smooth image with seeded noise of the given amplitude.
fn frame(noise: f32) -> Image {
    let mut state = 1u32;
    let pixels = (0..WIDTH * HEIGHT).map(|i| {
        let (x, y) = ((i % WIDTH) as f32, (i / WIDTH) as f32);
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let n = ((state >> 8) as f32 / (1 << 24) as f32 - 0.5) * noise;
        [0.5 + 0.4 * (x / 37.0).sin() + n, 0.5 + 0.4 * (y / 23.0).cos() - n, 0.5 + n, 1.0]
    });
    Image::from_pixels(WIDTH, HEIGHT, pixels.collect()).unwrap_or_default()
}

/// Median milliseconds of 15 runs after one to warm up.
fn median_ms(mut run: impl FnMut()) -> f64 {
    run();
    let mut times: Vec<f64> = (0..15)
        .map(|_| {
            let start = Instant::now();
            run();
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

fn main() {
    let (reference, test) = (frame(0.0), frame(0.1));
    println!("{WIDTH}x{HEIGHT}, {} threads, median of 15", rayon::current_num_threads());
    let psnr_ms = median_ms(|| _ = psnr(&reference, &test, Quantisation::None));
    let ssim_ms = median_ms(|| _ = ssim(&reference, &test, SsimBorder::Crop));
    println!("PSNR         {psnr_ms:7.1} ms");
    println!("PSNR, 8-bit  {:7.1} ms", median_ms(|| _ = psnr(&reference, &test, Quantisation::EightBit)));
    println!("SSIM         {ssim_ms:7.1} ms");
    println!("PSNR + SSIM  {:7.1} ms (must: 60, ratio {:.2})", psnr_ms + ssim_ms, (psnr_ms + ssim_ms) / 60.0);
    println!("FLIP         {:7.1} ms", median_ms(|| _ = flip(&reference, &test, DEFAULT_PIXELS_PER_DEGREE)));
}
