//! The rasterizer's gradients against central differences of its own images, on scenes without cut-offs.

use glam::DVec2;
use gs3_raster::{Culling, RasterSettings};
use gs3_scene::{GBuffer, OpacityMode, Planes};

use crate::compare::{EVERYTHING, assert_matches, oracle, oracle_samples, render};
use crate::scenes::{camera_at_origin, posed, smooth_scene, tilted_pose};

/// Of the plane's largest value.
const TOLERANCE: f64 = 1e-3;
/// Step in pixels. The splats are some 20 px wide, so the third derivative is 1/400 of the first: h²/6/400 = 1e-4; f32
/// rounding of the colours, 1e-7 over 2h times the first derivative's 20 px, is 4e-6.
const STEP: f32 = 0.25;

#[test]
fn gradients_are_the_limits_of_differences() {
    for (seed, mode) in
        [(11, OpacityMode::Default), (12, OpacityMode::Antialiased), (13, OpacityMode::Default)]
    {
        let camera = posed(&camera_at_origin(40, 36, DVec2::new(0.08, -0.05)), tilted_pose());
        let scene = smooth_scene(&camera, seed, 3, mode);
        let at = |x: f32, y: f32| -> GBuffer {
            let settings = RasterSettings { jitter: [x, y], background: [0.8, 0.1, 0.5], ..EVERYTHING };
            let samples = oracle_samples(&oracle(&scene, &camera, &settings), &camera);
            assert!(samples.iter().all(|s| !s.cut_offs.any()), "the scene is not smooth");
            let gbuffer = render(&scene, Culling::AccuTile, &camera, &settings);
            assert_matches(&gbuffer, &samples, 1e-4, "smooth");
            gbuffer
        };
        let center = at(0.0, 0.0);
        let (left, right) = (at(-STEP, 0.0), at(STEP, 0.0));
        let (above, below) = (at(0.0, -STEP), at(0.0, STEP));
        let gradients = |g: &GBuffer| g.gradients.clone().expect("asked for");
        let g = gradients(&center);
        let mixed = g.color_dxy.as_ref().expect("asked for");
        assert_difference("color_dx", &g.color_dx, &left.color, &right.color);
        assert_difference("color_dy", &g.color_dy, &above.color, &below.color);
        assert_difference("color_dxy", mixed, &gradients(&above).color_dx, &gradients(&below).color_dx);
        assert_difference("color_dxy", mixed, &gradients(&left).color_dy, &gradients(&right).color_dy);
    }
}

fn assert_difference(name: &str, derivative: &Planes<3>, before: &Planes<3>, after: &Planes<3>) {
    let largest = derivative.data().iter().fold(0.0_f64, |m, v| m.max(f64::from(v.abs())));
    assert!(largest > 1e-5, "{name}: nothing to compare");
    for (i, v) in derivative.data().iter().enumerate() {
        let difference = f64::from(after.data()[i]) - f64::from(before.data()[i]);
        let error = (f64::from(*v) - difference / f64::from(2.0 * STEP)).abs();
        assert!(
            error <= TOLERANCE * largest,
            "{name} {i}: expected {difference}, found {v}: {:.1e}",
            error / largest
        );
    }
}
