//! The oracle against values computed by hand and against its own differences.

use glam::{DAffine3, DMat3, DQuat, DVec2, DVec3};
use gs3_scene::{Camera, Intrinsics, OpacityMode, Scene};

use super::Oracle;
use super::spherical_harmonics::basis;
use crate::scenes::{
    RandomScene, Spec, camera_at_origin, gaussians, posed, scene, smooth_scene, tilted_pose,
};

fn camera(width: u32, height: u32, focal: f64) -> Camera {
    let (cx, cy) = (f64::from(width) / 2.0, f64::from(height) / 2.0);
    Camera::new(DAffine3::IDENTITY, Intrinsics { width, height, fx: focal, fy: focal, cx, cy })
        .expect("valid")
}

fn close(actual: f64, expected: f64, tolerance: f64) {
    assert!((actual - expected).abs() <= tolerance, "expected {expected}, found {actual}");
}

/// A ball of radius 0.1 at depth 2, seen with a focal length of 100 px: σ² = 5² + 0.3 px², centred at (8, 8).
#[test]
fn one_ball_by_hand() {
    let ball = Spec::ball(DVec3::new(0.0, 0.0, 2.0), 0.1, 0.8, [1.0, 0.5, 0.0]);
    let oracle = Oracle::new(&scene(&[ball], 0), &camera(16, 16, 100.0), 0.3, [0.0; 2], [0.0, 0.0, 1.0]);
    let s = &oracle.splats[0];
    close(s.mean[0], 8.0, 1e-12);
    close(s.covariance[0], 25.3, 1e-5);
    close(s.covariance[1], 0.0, 1e-12);
    close(s.conic[2], 1.0 / 25.3, 1e-8);
    // Pixel (10, 8): centre (10.5, 8.5), d = (−2.5, −0.5).
    let alpha = 0.8 * (-0.5 * (2.5_f64.powi(2) + 0.5_f64.powi(2)) / 25.3).exp();
    let p = oracle.pixel(10, 8);
    close(p.alpha, alpha, 1e-7);
    close(p.color[0], alpha, 1e-7);
    close(p.color[1], 0.5 * alpha, 1e-7);
    close(p.color[2], 1.0 - alpha, 1e-7);
    let alpha_x = -alpha * 2.5 / 25.3;
    close(p.color_dx[0], alpha_x, 1e-7);
    close(p.color_dx[2], -alpha_x, 1e-7);
    close(p.color_dxy[0], alpha * (2.5 * 0.5) / 25.3_f64.powi(2), 1e-7);
    // The ball's ray plane lies across the view ray at its centre, so its depth is 2 along the axis.
    let axis = oracle.sample(8.0, 8.0, |_| true);
    close(axis.depth_median, 2.0, 1e-6);
    close(axis.depth_expected, 2.0, 1e-6);
    close(axis.normal[2], -axis.alpha, 1e-7);
}

/// Two splats in front of each other at the centre: α = 0.6 each, T = 0.4 before the second, so the median is the
/// first.
#[test]
fn two_balls_blend_front_to_back() {
    let far = Spec::ball(DVec3::new(0.0, 0.0, 4.0), 0.5, 0.6, [0.0, 1.0, 0.0]);
    let near = Spec::ball(DVec3::new(0.0, 0.0, 2.0), 0.5, 0.6, [1.0, 0.0, 0.0]);
    let oracle = Oracle::new(&scene(&[far, near], 0), &camera(16, 16, 100.0), 0.3, [0.0; 2], [0.0; 3]);
    let s = oracle.sample(8.0, 8.0, |_| true);
    close(s.color[0], 0.6, 1e-6);
    close(s.color[1], 0.4 * 0.6, 1e-6);
    close(s.alpha, 1.0 - 0.16, 1e-6);
    close(s.depth_median, 2.0, 1e-6);
    close(s.depth_expected, (0.6 * 2.0 + 0.24 * 4.0) / 0.84, 1e-5);
}

/// Opaque splats: α is held at 0.99, gradients vanish there, and the third splat would push T below 1e-4.
#[test]
fn opaque_splats_clamp_and_stop() {
    let balls: Vec<Spec> =
        (0..4).map(|k| Spec::ball(DVec3::new(0.0, 0.0, 2.0 + f64::from(k)), 1.0, 1.0, [1.0; 3])).collect();
    let oracle = Oracle::new(&scene(&balls[..1], 0), &camera(16, 16, 100.0), 0.3, [0.0; 2], [0.0; 3]);
    let s = oracle.sample(8.5, 8.0, |_| true);
    close(s.alpha, 0.99, 1e-12);
    assert_eq!(s.color_dx, [0.0; 3]);
    let oracle = Oracle::new(&scene(&balls, 0), &camera(16, 16, 100.0), 0.3, [0.0; 2], [0.0; 3]);
    // T = 0.01 after one; a second would leave 1e-4, which is within rounding of the step, and is marked.
    assert!(oracle.sample(8.0, 8.0, |_| true).cut_offs.stop);
}

#[test]
fn faint_contributions_are_skipped_and_marked() {
    let ball = Spec::ball(DVec3::new(0.0, 0.0, 2.0), 0.02, 1.0, [1.0; 3]);
    let oracle = Oracle::new(&scene(&[ball], 0), &camera(32, 32, 100.0), 0.0, [0.0; 2], [0.0; 3]);
    // σ = 1 px: α = 1/255 at √(2 ln 255) = 3.3290 px.
    let at = |distance: f64| oracle.sample(16.0 + distance, 16.0, |_| true);
    assert!(at(3.32).alpha > 0.0);
    assert_eq!(at(3.34).alpha, 0.0);
    assert!(at(3.3290).cut_offs.alpha_min);
    assert!(!at(3.32).cut_offs.any());
}

/// Antialiased opacity keeps the integral of a splat much thinner than the dilation: det₀/det₁ = (σ²/(σ² + ε))².
#[test]
fn antialiased_opacity_by_hand() {
    let ball = Spec::ball(DVec3::new(0.0, 0.0, 2.0), 0.01, 1.0, [1.0; 3]);
    let scene = Scene::new(gaussians(&[ball], 0), OpacityMode::Antialiased).expect("valid");
    let oracle = Oracle::new(&scene, &camera(32, 32, 100.0), 0.3, [0.0; 2], [0.0; 3]);
    close(oracle.splats[0].opacity, 0.25 / 0.55, 1e-6);
}

#[test]
fn spherical_harmonics_are_orthonormal() {
    // Gauss–Legendre would be shorter in points; the midpoint rule is shorter in words.
    let (rings, spokes) = (400, 64);
    let mut gram = [[0.0; 25]; 25];
    for i in 0..rings {
        let z = -1.0 + 2.0 * (f64::from(i) + 0.5) / f64::from(rings);
        let r = (1.0 - z * z).sqrt();
        for j in 0..spokes {
            let phi = std::f64::consts::TAU * f64::from(j) / f64::from(spokes);
            let b = basis(DVec3::new(r * phi.cos(), r * phi.sin(), z));
            let area = 2.0 * std::f64::consts::TAU / f64::from(rings * spokes);
            for (row, p) in gram.iter_mut().zip(b) {
                for (cell, q) in row.iter_mut().zip(b) {
                    *cell += area * p * q;
                }
            }
        }
    }
    for (i, row) in gram.iter().enumerate() {
        for (j, cell) in row.iter().enumerate() {
            close(*cell, f64::from(i == j), 1e-3);
        }
    }
}

/// The published closed form of the ray plane against its definition: the maximum along the ray of the Gaussian taken
/// to ray space (x/z, y/z, distance) by the full 3×3 Jacobian.
#[test]
fn ray_plane_is_the_maximum_along_the_ray() {
    let camera = posed(&camera_at_origin(64, 48, DVec2::new(0.1, -0.05)), tilted_pose());
    let scene = RandomScene { sigma: [2.0, 12.0], ..RandomScene::BASE }.build(&camera);
    let oracle = Oracle::new(&scene, &camera, 0.3, [0.0; 2], [0.0; 3]);
    let intrinsics = camera.intrinsics();
    assert!(oracle.splats.len() > 50);
    for splat in &oracle.splats {
        let g = scene.gaussians();
        let view =
            camera.view_from_world().transform_point3(DVec3::from_array(g.mean(splat.index).map(f64::from)));
        let [w, x, y, z] = g.rotation(splat.index).map(f64::from);
        let s = DVec3::from_array(g.scale(splat.index).map(f64::from));
        let axes =
            camera.view_from_world().matrix3 * DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        let covariance = axes * DMat3::from_diagonal(s * s) * axes.transpose();
        let l = view.length();
        // Rows: ∂(x/z), ∂(y/z), ∂|x|.
        let jacobian = DMat3::from_cols(
            DVec3::new(1.0 / view.z, 0.0, view.x / l),
            DVec3::new(0.0, 1.0 / view.z, view.y / l),
            DVec3::new(-view.x / view.z.powi(2), -view.y / view.z.powi(2), view.z / l),
        );
        let precision = (jacobian * covariance * jacobian.transpose()).inverse();
        // At offset (du, dv) from the centre: dt = −(P_tu du + P_tv dv)/P_tt; a sample at d = centre − sample has
        // du = −d.x/fx.
        let expected = [
            precision.col(0).z / precision.col(2).z / intrinsics.fx,
            precision.col(1).z / precision.col(2).z / intrinsics.fy,
        ];
        for (actual, expected) in splat.plane.iter().zip(expected) {
            close(*actual, expected, 1e-6 * (l / intrinsics.fx + expected.abs()));
        }
    }
}

#[test]
fn derivatives_are_the_limits_of_differences() {
    let camera = posed(&camera_at_origin(40, 30, DVec2::new(0.1, -0.05)), tilted_pose());
    for (seed, mode) in [(1, OpacityMode::Default), (2, OpacityMode::Antialiased)] {
        let scene = smooth_scene(&camera, seed, 3, mode);
        let oracle = Oracle::new(&scene, &camera, 0.3, [0.0; 2], [0.9, 0.2, 0.4]);
        let h = 1e-3;
        for (x, y) in [(0.5, 0.5), (39.5, 29.5), (20.0, 15.0), (7.3, 22.1)] {
            let at = |dx: f64, dy: f64| oracle.sample(x + dx, y + dy, |_| true);
            let s = at(0.0, 0.0);
            assert!(!s.cut_offs.any());
            for k in 0..3 {
                close(s.color_dx[k], (at(h, 0.0).color[k] - at(-h, 0.0).color[k]) / (2.0 * h), 1e-9);
                close(s.color_dy[k], (at(0.0, h).color[k] - at(0.0, -h).color[k]) / (2.0 * h), 1e-9);
                let mixed = at(h, h).color[k] - at(h, -h).color[k] - at(-h, h).color[k] + at(-h, -h).color[k];
                close(s.color_dxy[k], mixed / (4.0 * h * h), 1e-8);
                assert!(s.color_dx[k].abs() > 1e-5);
            }
        }
    }
}
