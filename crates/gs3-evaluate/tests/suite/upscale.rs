//! The spatial baselines against reference implementations, and their half-pixel alignment; `oracle/upscale.py` made
//! the values.

use crate::common::{data, gbuffer, image};
use gs3_evaluate::upscale::{Fsr1, Hermite, Lanczos, RidgeError, RidgeMap, UpscaleError, Upscaler};
use gs3_reconstruct::ResampleKernel;
use gs3_scene::{GBuffer, Gradients, Image, Planes, Size};
use serde_json::Value;

/// A smooth function of HR coordinates, its samples on the LR grid with exact gradients, and its HR image.
fn smooth(scale: u32, jitter: [f32; 2], mixed: bool) -> (GBuffer, Image) {
    const SIZE: (usize, usize) = (37, 21);
    let s = f64::from(scale);
    // Colour, its derivatives along x and y, and the mixed one, at HR coordinates.
    let f = |c: usize, x: f64, y: f64| {
        let (a, b) = (0.11 + 0.03 * c as f64, 0.09 - 0.02 * c as f64);
        let ((sx, cx), (sy, cy)) = ((a * x / s * 4.0).sin_cos(), (b * y / s * 4.0).sin_cos());
        let (a, b) = (a / s * 4.0, b / s * 4.0);
        [0.5 + 0.4 * sx * cy, 0.4 * a * cx * cy, -0.4 * b * sx * sy, -0.4 * a * b * cx * sy]
    };
    let (width, height) = SIZE;
    let mut lr = GBuffer { jitter, color: Planes::new(width, height), ..GBuffer::default() };
    let mut gradients = Gradients {
        color_dx: Planes::new(width, height),
        color_dy: Planes::new(width, height),
        color_dxy: mixed.then(|| Planes::new(width, height)),
    };
    for c in 0..3 {
        for y in 0..height {
            for x in 0..width {
                let at = |i: usize, axis: usize| s * (i as f64 + 0.5 + f64::from(jitter[axis]));
                let [v, dx, dy, dxdy] = f(c, at(x, 0), at(y, 1));
                let i = (c * height + y) * width + x;
                lr.color.data_mut()[i] = v as f32;
                gradients.color_dx.data_mut()[i] = (dx * s) as f32;
                gradients.color_dy.data_mut()[i] = (dy * s) as f32;
                if let Some(plane) = &mut gradients.color_dxy {
                    plane.data_mut()[i] = (dxdy * s * s) as f32;
                }
            }
        }
    }
    lr.gradients = Some(gradients);
    let (w, h) = (width * scale as usize, height * scale as usize);
    let pixel = |i: usize| {
        let (x, y) = ((i % w) as f64 + 0.5, (i / w) as f64 + 0.5);
        let [r, g, b] = [0, 1, 2].map(|c| f(c, x, y)[0] as f32);
        [r, g, b, 0.0]
    };
    (lr, Image::from_pixels(w, h, (0..w * h).map(pixel).collect()).unwrap())
}

/// Largest difference of two images, `margin` pixels from the border left out.
fn largest_difference(a: &Image, b: &Image, margin: usize) -> f32 {
    let mut largest = 0.0f32;
    for y in margin..a.height() - margin {
        for (p, q) in a.row(y).iter().zip(b.row(y)).take(a.width() - margin).skip(margin) {
            for c in 0..3 {
                largest = largest.max((p[c] - q[c]).abs());
            }
        }
    }
    largest
}

#[test]
fn baselines_agree_with_reference_implementations() {
    let oracle: Value = serde_json::from_slice(&std::fs::read(data("upscale.json")).unwrap()).unwrap();
    let lr = gbuffer(&image("coffee_lr.png"));
    let mut methods: [(&str, Box<dyn Upscaler>); 5] = [
        ("nearest", Box::new(ResampleKernel::Nearest)),
        ("bilinear", Box::new(ResampleKernel::Bilinear)),
        ("bicubic", Box::new(ResampleKernel::Bicubic)),
        ("lanczos", Box::new(Lanczos::default())),
        ("fsr1", Box::new(Fsr1::default())),
    ];
    for (name, method) in &mut methods {
        let mut out = Image::new(200, 160);
        method.upscale(&lr, 4, &mut out).unwrap();
        for point in oracle[&*name].as_array().unwrap() {
            let [x, y] = ["x", "y"].map(|k| point[k].as_u64().unwrap() as usize);
            for c in 0..3 {
                let expected = point["rgb"][c].as_f64().unwrap() as f32;
                let actual = out.row(y)[x][c];
                // f32 arithmetic on values in [0, 1]; FSR 1 divides by small sums.
                let tolerance = if *name == "fsr1" { 2e-5 } else { 2e-6 };
                assert!(
                    (actual - expected).abs() < tolerance,
                    "{name} ({x}, {y}): {expected}, found {actual}"
                );
            }
        }
    }
}

#[test]
fn every_method_places_samples_where_they_were_taken() {
    // A smooth image is reproduced within the method's own error. Half an LR pixel of shift would cost up to 0.14:
    // nearest and FSR 1, which sharpens, cannot tell, the others can.
    for scale in [2, 3, 4] {
        for jitter in [[0.0, 0.0], [0.375, -0.125], [-0.46, 0.29]] {
            let methods: [(&str, Box<dyn Upscaler>, f32); 7] = [
                ("nearest", Box::new(ResampleKernel::Nearest), 0.15),
                ("bilinear", Box::new(ResampleKernel::Bilinear), 0.025),
                ("bicubic", Box::new(ResampleKernel::Bicubic), 0.01),
                ("lanczos", Box::new(Lanczos::default()), 0.012),
                ("fsr1", Box::new(Fsr1::default()), 0.15),
                ("hermite", Box::new(Hermite::EstimatedMixed), 2e-3),
                ("spline", Box::new(Hermite::ExactMixed), 1e-3),
            ];
            for (name, mut method, tolerance) in methods {
                let (lr, expected) = smooth(scale, jitter, name == "spline");
                let mut out = Image::new(expected.width(), expected.height());
                method.upscale(&lr, scale, &mut out).unwrap();
                let error = largest_difference(&out, &expected, 4 * scale as usize);
                assert!(error < tolerance, "{name} ×{scale} at {jitter:?}: {error}");
            }
        }
    }
}

#[test]
fn the_ridge_map_recovers_smooth_images_better_than_the_spline_and_keeps_constants() {
    let (lr, hr) = smooth(4, [0.0; 2], false);
    let mut map = RidgeMap::fit(&[(&lr, &hr)], 4).unwrap();
    let mut out = Image::new(hr.width(), hr.height());
    map.upscale(&lr, 4, &mut out).unwrap();
    let error = largest_difference(&out, &hr, 4);
    Hermite::EstimatedMixed.upscale(&lr, 4, &mut out).unwrap();
    let spline = largest_difference(&out, &hr, 4);
    assert!(error < 0.5 * spline, "{error} against {spline}");

    let (mut flat, _) = smooth(4, [0.0; 2], false);
    flat.color.data_mut().fill(0.7);
    let gradients = flat.gradients.as_mut().unwrap();
    gradients.color_dx.data_mut().fill(0.0);
    gradients.color_dy.data_mut().fill(0.0);
    map.upscale(&flat, 4, &mut out).unwrap();
    assert!(out.pixels().iter().all(|p| *p == [0.7, 0.7, 0.7, 0.0]));
    assert_eq!(RidgeMap::fit(&[(&flat, &out)], 4).unwrap_err(), RidgeError::Singular);
}

#[test]
fn the_ridge_map_recovers_a_planted_linear_map() {
    // HR pixels that are a linear function of the neighbourhood are reproduced, and only by the right alignment.
    let (lr, mut hr) = smooth(2, [0.0; 2], false);
    let noise = |i: usize| ((i as u32).wrapping_mul(2_654_435_761) >> 8) as f32 / (1u32 << 24) as f32;
    let mut noisy = lr.clone();
    noisy.color.data_mut().iter_mut().enumerate().for_each(|(i, v)| *v = noise(i));
    let gradients = noisy.gradients.as_mut().unwrap();
    gradients.color_dx.data_mut().iter_mut().enumerate().for_each(|(i, v)| *v = noise(i + 7_777));
    gradients.color_dy.data_mut().iter_mut().enumerate().for_each(|(i, v)| *v = noise(i + 99_999));
    let (width, height) = (lr.width(), lr.height());
    let (g, planes) = (noisy.gradients.as_ref().unwrap(), &noisy.color);
    for y in 1..height - 1 {
        for x in 1..width - 1 {
            for c in 0..3 {
                let right = planes.row(c, y)[x + 1];
                let block = [
                    0.75 * planes.row(c, y)[x] + 0.25 * right,
                    planes.row(c, y)[x] + 0.3 * g.color_dx.row(c, y)[x],
                    0.5 * planes.row(c, y)[x] + 0.5 * planes.row(c, y - 1)[x - 1]
                        - 0.2 * g.color_dy.row(c, y + 1)[x],
                    planes.row(c, y + 1)[x],
                ];
                for (i, value) in block.into_iter().enumerate() {
                    let at = (2 * y + i / 2) * 2 * width + 2 * x + i % 2;
                    hr.pixels_mut()[at][c] = value;
                }
            }
        }
    }
    let mut map = RidgeMap::fit(&[(&noisy, &hr)], 2).unwrap();
    let mut out = Image::new(2 * width, 2 * height);
    map.upscale(&noisy, 2, &mut out).unwrap();
    let error = largest_difference(&out, &hr, 2);
    assert!(error < 1e-4, "{error}");
}

#[test]
fn unsuitable_frames_are_refused() {
    let (lr, hr) = smooth(4, [0.0; 2], false);
    let mut small = Image::new(10, 10);
    let size = Err(UpscaleError::Size { expected: Size::new(148, 84), actual: Size::new(10, 10) });
    assert_eq!(Lanczos::default().upscale(&lr, 4, &mut small), size);
    assert_eq!(Fsr1::default().upscale(&lr, 4, &mut small), size);
    let mut map = RidgeMap::fit(&[(&lr, &hr)], 4).unwrap();
    assert_eq!(map.upscale(&lr, 4, &mut small), size);
    let mut out = Image::new(74, 42);
    let scale = Err(UpscaleError::Scale { method: "ridge", expected: 4, actual: 2 });
    assert_eq!(map.upscale(&lr, 2, &mut out), scale);
    let mut out = hr.clone();
    let jittered = GBuffer { jitter: [0.1, 0.0], ..lr.clone() };
    assert!(matches!(map.upscale(&jittered, 4, &mut out), Err(UpscaleError::Jitter { .. })));
    let plain = GBuffer { gradients: None, ..lr };
    assert!(matches!(map.upscale(&plain, 4, &mut out), Err(UpscaleError::NoGradients { .. })));
    assert_eq!(RidgeMap::fit(&[], 4).unwrap_err(), RidgeError::NoFrames);
}
