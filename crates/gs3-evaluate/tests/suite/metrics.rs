//! The metrics against their reference implementations; `oracle/metrics.py` made the values.

use crate::common::{crop, data, image};
use gs3_evaluate::metrics::flip::DEFAULT_PIXELS_PER_DEGREE;
use gs3_evaluate::metrics::{
    MetricError, Quantisation, SsimBorder, Viewing, color_video_vdp, flicker, flip, flip_map, psnr, ssim,
    tpsnr,
};
use gs3_scene::{Image, Size};
use serde_json::Value;

fn oracle() -> Value {
    serde_json::from_slice(&std::fs::read(data("metrics.json")).unwrap()).unwrap()
}

/// Checks a value against the oracle's, at a tolerance given with its reason by the caller.
fn close(what: &str, actual: f64, expected: &Value, tolerance: f64) {
    let expected = expected.as_f64().unwrap();
    assert!(
        (actual - expected).abs() <= tolerance,
        "{what}: expected {expected} ± {tolerance}, found {actual}"
    );
}

fn pairs() -> Vec<(&'static str, Image, Image)> {
    ["chelsea", "coffee"].map(|n| (n, image(&format!("{n}.png")), image(&format!("{n}_test.png")))).to_vec()
}

fn viewing() -> Viewing {
    Viewing { display: "standard_4k".into(), frames_per_second: 30.0, memory_limit_bytes: 1 << 30 }
}

#[test]
fn psnr_agrees_with_scikit_image() {
    for (name, reference, test) in pairs() {
        let expected = &oracle()["images"][name];
        // Both sides sum in f64; differences come from f32 pixels.
        close(name, psnr(&reference, &test, Quantisation::None).unwrap(), &expected["psnr"], 1e-5);
        let mut between = test.clone();
        for (b, r) in between.pixels_mut().iter_mut().zip(reference.pixels()) {
            *b = std::array::from_fn(|c| 0.9 * b[c] + 0.1 * r[c]);
        }
        close(name, psnr(&reference, &between, Quantisation::None).unwrap(), &expected["psnr_between"], 1e-5);
        let eight_bit = psnr(&reference, &between, Quantisation::EightBit).unwrap();
        // A value at a rounding boundary may fall to either side: one level on one value is 1e-4 dB here.
        close(name, eight_bit, &expected["psnr_between_8bit"], 1e-3);
    }
}

#[test]
fn ssim_agrees_with_scikit_image_and_with_the_zero_padded_convention() {
    for (name, reference, test) in pairs() {
        let expected = &oracle()["images"][name];
        // f32 filtering: 1e-7 on variances against C2 = 9e-4.
        close(name, ssim(&reference, &test, SsimBorder::Crop).unwrap(), &expected["ssim_crop"], 2e-6);
        close(name, ssim(&reference, &test, SsimBorder::ZeroPad).unwrap(), &expected["ssim_zero_pad"], 2e-6);
    }
}

#[test]
fn flip_agrees_with_its_authors_tool() {
    for (name, reference, test) in pairs() {
        let expected = &oracle()["images"][name];
        // Both sides compute in f32 with powers of small differences.
        close(name, flip(&reference, &test, DEFAULT_PIXELS_PER_DEGREE).unwrap(), &expected["flip"], 1e-5);
        let map = flip_map(&reference, &test, DEFAULT_PIXELS_PER_DEGREE).unwrap();
        for point in expected["flip_at"].as_array().unwrap() {
            let [x, y] = ["x", "y"].map(|k| point[k].as_u64().unwrap() as usize);
            close(&format!("{name} at ({x}, {y})"), f64::from(map.row(0, y)[x]), &point["flip"], 2e-4);
        }
    }
}

#[test]
fn temporal_metrics_agree_with_their_definitions() {
    let (reference, test) = (image("chelsea.png"), image("chelsea_test.png"));
    let sequence = |image: &Image| (0..4).map(|t| crop(image, 5 * t, 3 * t, 120, 96)).collect::<Vec<_>>();
    let (r, t) = (sequence(&reference), sequence(&test));
    let expected = &oracle()["temporal"];
    for i in 0..3 {
        let value = tpsnr([&r[i], &r[i + 1]], [&t[i], &t[i + 1]], Quantisation::None).unwrap();
        close("tPSNR", value, &expected["tpsnr"][i], 1e-5);
    }
    for i in 0..2 {
        let frames = |s: &[Image], i: usize| [s[i].clone(), s[i + 1].clone(), s[i + 2].clone()];
        let (r, t) = (frames(&r, i), frames(&t, i));
        let value = flicker(r.each_ref(), t.each_ref(), Quantisation::None).unwrap();
        close("flicker", value, &expected["flicker"][i], 1e-8);
    }
    let value = color_video_vdp(&r, &t, &viewing()).unwrap();
    close("ColorVideoVDP of a video", value, &expected["cvvdp_jod_30fps"], 1e-4);
}

#[test]
fn color_video_vdp_agrees_with_its_authors_code_on_images() {
    for (name, reference, test) in pairs() {
        let value = color_video_vdp(&[reference], &[test], &viewing()).unwrap();
        close(name, value, &oracle()["images"][name]["cvvdp_jod"], 1e-4);
    }
}

#[test]
fn equal_images_are_perfect_and_stronger_errors_score_worse() {
    let (_, reference, test) = pairs().remove(1);
    let blend = |share: f32| {
        let mut image = reference.clone();
        for (b, t) in image.pixels_mut().iter_mut().zip(test.pixels()) {
            *b = std::array::from_fn(|c| b[c] + share * (t[c] - b[c]));
        }
        image
    };
    let scores = [0.0, 0.3, 0.6, 1.0].map(|share| {
        let image = blend(share);
        let vdp = color_video_vdp(std::slice::from_ref(&reference), std::slice::from_ref(&image), &viewing());
        [
            psnr(&reference, &image, Quantisation::None).unwrap(),
            ssim(&reference, &image, SsimBorder::Crop).unwrap(),
            -flip(&reference, &image, DEFAULT_PIXELS_PER_DEGREE).unwrap(),
            vdp.unwrap(),
        ]
    });
    assert_eq!(scores[0][0], f64::INFINITY);
    assert!((scores[0][1] - 1.0).abs() < 1e-6 && scores[0][2] == 0.0 && scores[0][3] == 10.0, "{scores:?}");
    for pair in scores.windows(2) {
        for (metric, (better, worse)) in pair[0].iter().zip(&pair[1]).enumerate() {
            assert!(better > worse, "metric {metric}: {better} should exceed {worse}");
        }
    }
}

#[test]
fn metrics_judge_what_a_display_shows() {
    let (_, reference, test) = pairs().remove(0);
    let mut wild = test.clone();
    let mut tame = test;
    let hostile = [f32::NAN, -3.0, 7.5, f32::INFINITY, f32::NEG_INFINITY];
    for (i, value) in hostile.into_iter().enumerate() {
        wild.pixels_mut()[1000 * i + 7] = [value; 4];
        let shown = if value > 0.0 { 1.0 } else { 0.0 };
        tame.pixels_mut()[1000 * i + 7] = [shown; 4];
    }
    for quantisation in [Quantisation::None, Quantisation::EightBit] {
        assert_eq!(psnr(&reference, &wild, quantisation), psnr(&reference, &tame, quantisation));
    }
    assert_eq!(ssim(&reference, &wild, SsimBorder::Crop), ssim(&reference, &tame, SsimBorder::Crop));
    let flip = |image| flip(&reference, image, DEFAULT_PIXELS_PER_DEGREE);
    assert_eq!(flip(&wild), flip(&tame));
    let vdp = |image: &Image| {
        color_video_vdp(std::slice::from_ref(&reference), std::slice::from_ref(image), &viewing())
    };
    assert_eq!(vdp(&wild), vdp(&tame));
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let (_, reference, test) = pairs().remove(0);
    let all = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            [
                psnr(&reference, &test, Quantisation::None).unwrap(),
                ssim(&reference, &test, SsimBorder::ZeroPad).unwrap(),
                flip(&reference, &test, DEFAULT_PIXELS_PER_DEGREE).unwrap(),
            ]
            .map(f64::to_bits)
        })
    };
    assert_eq!(all(1), all(3));
}

#[test]
fn odd_sizes_work_and_unusable_ones_are_refused() {
    let reference = image("chelsea.png");
    let tiny = crop(&reference, 0, 0, 11, 11);
    assert!((ssim(&tiny, &tiny, SsimBorder::Crop).unwrap() - 1.0).abs() < 1e-6);
    let narrow = crop(&reference, 3, 5, 10, 30);
    assert_eq!(
        ssim(&narrow, &narrow, SsimBorder::Crop),
        Err(MetricError::TooSmall { metric: "SSIM", min: 11, actual: Size::new(10, 30) })
    );
    let pixel = crop(&reference, 3, 5, 1, 1);
    assert_eq!(psnr(&pixel, &pixel, Quantisation::None), Ok(f64::INFINITY));
    assert_eq!(flip(&pixel, &pixel, DEFAULT_PIXELS_PER_DEGREE), Ok(0.0));
    let size =
        MetricError::Size { what: "test image", expected: Size::new(11, 11), actual: Size::new(10, 30) };
    assert_eq!(psnr(&tiny, &narrow, Quantisation::None), Err(size.clone()));
    assert_eq!(ssim(&tiny, &narrow, SsimBorder::Crop), Err(size.clone()));
    assert_eq!(flip(&tiny, &narrow, DEFAULT_PIXELS_PER_DEGREE), Err(size));
    let empty = Image::new(0, 0);
    assert!(matches!(psnr(&empty, &empty, Quantisation::None), Err(MetricError::TooSmall { .. })));
    assert!(matches!(flip(&empty, &empty, DEFAULT_PIXELS_PER_DEGREE), Err(MetricError::TooSmall { .. })));
    assert!(matches!(
        color_video_vdp(std::slice::from_ref(&tiny), &[], &viewing()),
        Err(MetricError::FrameCount { expected: 1, actual: 0, .. })
    ));
}
