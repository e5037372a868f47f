//! Single-frame interpolation: the classical kernels and the gradient-aware Hermite surface.

use crate::common::{camera, grid_jitter, wall_and_post};
use gs3_reconstruct::{ReconstructError, ResampleKernel, hermite, resample};
use gs3_scene::{GBuffer, Gradients, Image, Planes, Size};
use gs3_test_support::psnr;
use proptest::prelude::*;

/// A G-buffer of the polynomial Σ c[m][n] xᵐ yⁿ of the LR position in pixels.
fn polynomial(width: usize, height: usize, jitter: [f32; 2], c: &[[f64; 4]; 4], mixed: bool) -> GBuffer {
    let mut planes: [Planes<3>; 4] = std::array::from_fn(|_| Planes::new(width, height));
    let size = width * height;
    for k in 0..size {
        let x = (k % width) as f64 + 0.5 + f64::from(jitter[0]);
        let y = (k / width) as f64 + 0.5 + f64::from(jitter[1]);
        let values = [value(c, x, y, 0, 0), value(c, x, y, 1, 0), value(c, x, y, 0, 1), value(c, x, y, 1, 1)];
        for (planes, value) in planes.iter_mut().zip(values) {
            for channel in 0..3 {
                planes.data_mut()[channel * size + k] = value as f32 * (channel + 1) as f32;
            }
        }
    }
    let [color, color_dx, color_dy, color_dxy] = planes;
    let gradients = Gradients { color_dx, color_dy, color_dxy: mixed.then_some(color_dxy) };
    GBuffer {
        jitter,
        color,
        alpha: Planes::new(width, height),
        gradients: Some(gradients),
        ..GBuffer::default()
    }
}

/// ∂ᵖ⁺ᑫ/∂xᵖ∂yᑫ of the polynomial for p, q ≤ 1.
fn value(c: &[[f64; 4]; 4], x: f64, y: f64, p: i32, q: i32) -> f64 {
    let power =
        |v: f64, n: i32, d: i32| if d == 0 { v.powi(n) } else { f64::from(n) * v.powi((n - 1).max(0)) };
    let mut sum = 0.0;
    for (m, row) in c.iter().enumerate() {
        for (n, c) in row.iter().enumerate() {
            sum += c * power(x, m as i32, p) * power(y, n as i32, q);
        }
    }
    sum
}

/// Largest error against the polynomial at the HR pixels with all four samples.
fn inner_error(out: &Image, scale: u32, jitter: [f32; 2], c: &[[f64; 4]; 4]) -> f64 {
    let (s, mut worst) = (f64::from(scale), 0.0_f64);
    let (w, h) = (out.width() as f64 / s, out.height() as f64 / s);
    for y in 0..out.height() {
        for x in 0..out.width() {
            let (u, v) = ((x as f64 + 0.5) / s, (y as f64 + 0.5) / s);
            let inside = |u: f64, jitter: f32, len: f64| {
                let place = u - 0.5 - f64::from(jitter);
                (0.0..=len - 1.0).contains(&place)
            };
            if inside(u, jitter[0], w) && inside(v, jitter[1], h) {
                for (channel, value_out) in out.row(y)[x][..3].iter().enumerate() {
                    let expected = value(c, u, v, 0, 0) * (channel + 1) as f64;
                    worst = worst.max((f64::from(*value_out) - expected).abs());
                }
            }
        }
    }
    worst
}

const CUBIC: [[f64; 4]; 4] = [
    [0.2, 0.03, -0.01, 0.002],
    [-0.05, 0.012, 0.003, -0.0004],
    [0.01, -0.002, 0.0006, 0.00005],
    [-0.001, 0.0003, -0.00004, 0.000006],
];

#[test]
fn hermite_reproduces_bicubic_polynomials_given_the_mixed_derivative() {
    for scale in [2, 3, 4] {
        for jitter in [[0.0, 0.0], [0.31, -0.27], grid_jitter(scale, 1)] {
            let gbuffer = polynomial(9, 7, jitter, &CUBIC, true);
            let mut out = Image::new(9 * scale as usize, 7 * scale as usize);
            hermite(&gbuffer, scale, &mut out).unwrap();
            let error = inner_error(&out, scale, jitter, &CUBIC);
            assert!(error < 2e-5, "scale {scale}, jitter {jitter:?}: {error}");
        }
    }
}

#[test]
fn the_estimated_mixed_derivative_is_exact_for_quadratics() {
    let mut c = CUBIC;
    for (m, row) in c.iter_mut().enumerate() {
        for (n, c) in row.iter_mut().enumerate() {
            if m + n > 2 {
                *c = 0.0;
            }
        }
    }
    let gbuffer = polynomial(9, 7, [0.2, 0.1], &c, false);
    let mut out = Image::new(36, 28);
    hermite(&gbuffer, 4, &mut out).unwrap();
    assert!(inner_error(&out, 4, [0.2, 0.1], &c) < 1e-5);
}

#[test]
fn catmull_rom_reproduces_lines_at_any_jitter() {
    let mut c = [[0.0; 4]; 4];
    (c[0][0], c[1][0], c[0][1]) = (0.3, 0.05, -0.02);
    for (kernel, tolerance) in
        [(ResampleKernel::Bicubic, 1e-5), (ResampleKernel::Bilinear, 1e-5), (ResampleKernel::Nearest, 0.12)]
    {
        let gbuffer = polynomial(12, 12, [0.25, -0.3], &c, false);
        let mut out = Image::new(36, 36);
        resample(&gbuffer, 3, kernel, &mut out).unwrap();
        let mut worst = 0.0_f64;
        for y in 9..27 {
            for x in 9..27 {
                let expected = value(&c, (x as f64 + 0.5) / 3.0, (y as f64 + 0.5) / 3.0, 0, 0);
                worst = worst.max((f64::from(out.row(y)[x][0]) - expected).abs());
            }
        }
        assert!(worst < tolerance, "{kernel:?}: {worst}");
        assert!(kernel != ResampleKernel::Nearest || worst > 1e-3, "nearest cannot be exact");
    }
}

#[test]
fn gradients_gain_over_colour_alone() {
    let world = wall_and_post(30.0);
    let camera = camera(240, 136, [0.0; 3], 0.0, 0.0);
    let gbuffer = world.gbuffer(&camera.low_resolution(4), [0.0; 2]);
    let native = world.native(&camera);
    let (mut with, mut without) = (Image::new(240, 136), Image::new(240, 136));
    hermite(&gbuffer, 4, &mut with).unwrap();
    resample(&gbuffer, 4, ResampleKernel::Bicubic, &mut without).unwrap();
    let (with, without) = (psnr(&with, &native), psnr(&without, &native));
    assert!(with > without + 1.0, "Hermite {with:.2} dB, bicubic {without:.2} dB");
}

#[test]
fn wrong_inputs_are_typed_errors() {
    let gbuffer = polynomial(4, 3, [0.0; 2], &CUBIC, false);
    let mut out = Image::new(16, 12);
    assert_eq!(hermite(&gbuffer, 0, &mut out), Err(ReconstructError::Scale { actual: 0 }));
    let mut other = Image::new(17, 12);
    let expected =
        ReconstructError::Size { what: "G-buffer", expected: Size::new(5, 3), actual: Size::new(4, 3) };
    assert_eq!(resample(&gbuffer, 4, ResampleKernel::Bicubic, &mut other), Err(expected));
    let bare = GBuffer { gradients: None, ..gbuffer.clone() };
    assert!(matches!(hermite(&bare, 4, &mut out), Err(ReconstructError::Missing { .. })));
    let expected =
        ReconstructError::Size { what: "image", expected: Size::new(16, 12), actual: Size::new(0, 0) };
    assert_eq!(resample(&gbuffer, 4, ResampleKernel::Bicubic, &mut Image::default()), Err(expected.clone()));
    assert_eq!(hermite(&gbuffer, 4, &mut Image::default()), Err(expected));
    let empty = GBuffer::default();
    for result in
        [hermite(&empty, 4, &mut out), resample(&empty, 4, ResampleKernel::Nearest, &mut Image::default())]
    {
        assert!(matches!(result, Err(ReconstructError::Missing { .. })), "{result:?}");
    }
    let shaken = GBuffer { jitter: [f32::NAN, 0.0], ..gbuffer };
    assert!(matches!(hermite(&shaken, 4, &mut out), Err(ReconstructError::Jitter { .. })));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn a_constant_image_stays_constant(
        width in 1_usize..40, height in 1_usize..40, scale in 1_u32..=8,
        jx in -1.0_f32..1.0, jy in -1.0_f32..1.0, level in 0.0_f64..1.0,
    ) {
        let mut c = [[0.0; 4]; 4];
        c[0][0] = level;
        let s = scale as usize;
        let gbuffer = polynomial(width.div_ceil(s), height.div_ceil(s), [jx, jy], &c, false);
        let mut out = Image::new(width, height);
        for kernel in [ResampleKernel::Nearest, ResampleKernel::Bilinear, ResampleKernel::Bicubic] {
            resample(&gbuffer, scale, kernel, &mut out).unwrap();
            prop_assert!(out.pixels().iter().all(|p| (f64::from(p[0]) - level).abs() < 1e-5));
        }
        hermite(&gbuffer, scale, &mut out).unwrap();
        prop_assert!(out.pixels().iter().all(|p| (f64::from(p[0]) - level).abs() < 1e-5 && p[3] == 0.0));
    }
}

#[test]
fn samples_beyond_their_pixels_are_repeated() -> Result<(), ReconstructError> {
    let mut constant = [[0.0; 4]; 4];
    constant[0][0] = 0.25;
    for (width, jitter) in [(1, [0.9, -0.9]), (2, [0.9, 0.9]), (1, [-0.9, -0.9])] {
        let gbuffer = polynomial(1, 3, jitter, &constant, false);
        let mut out = Image::new(width, 6);
        hermite(&gbuffer, 2, &mut out)?;
        for pixel in out.pixels() {
            let error = pixel.iter().zip([0.25, 0.5, 0.75, 0.0]).map(|(a, b): (&f32, f32)| (a - b).abs());
            assert!(error.fold(0.0, f32::max) <= 1e-6, "{width} wide, {jitter:?}: {pixel:?}");
        }
    }
    Ok(())
}
