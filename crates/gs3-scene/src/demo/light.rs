//! Light baked into spherical harmonics: sun, sky, shadows, highlights; and the sky itself.

use std::f32::consts::{PI, TAU};

use glam::Vec3;

use super::noise::fractal_noise;
use super::splats::{Patch, Splat, circle};
use crate::gaussians::{SH_C0, SH_C1, SH_C2};

/// How a surface looks.
#[derive(Clone, Copy)]
pub struct Material {
    /// Diffuse colour.
    pub albedo: Vec3,
    /// Colour of reflections; black for matt surfaces.
    pub reflection: Vec3,
    /// Light that the surface gives off by itself.
    pub glow: Vec3,
}

impl Material {
    pub const fn matt(albedo: Vec3) -> Self {
        Self { albedo, reflection: Vec3::ZERO, glow: Vec3::ZERO }
    }
}

const SUN: Vec3 = Vec3::new(1.05, 0.96, 0.80);
const SKY: Vec3 = Vec3::new(0.36, 0.42, 0.52);
const BOUNCE: Vec3 = Vec3::new(0.20, 0.18, 0.15);

/// Bounding spheres that throw the demo's soft shadows: centre and radius.
const SHADOW_CASTERS: [(Vec3, f32); 7] = [
    (Vec3::new(0.0, 0.0, 1.65), 0.72),
    (Vec3::new(0.0, 0.0, 0.45), 0.6),
    (Vec3::new(1.7, 0.9, 0.42), 0.42),
    (Vec3::new(-1.2, 1.6, 0.55), 0.55),
    (Vec3::new(-1.5, -1.3, 0.36), 0.36),
    (Vec3::new(1.1, -1.75, 0.48), 0.48),
    (Vec3::new(2.3, -0.6, 0.24), 0.24),
];

fn sun_direction() -> Vec3 {
    Vec3::new(0.55, -0.45, 0.70).normalize()
}

/// The five basis functions of degree 2 at a unit direction, in the convention of Kerbl et al. 2023.
fn degree_2(d: Vec3) -> [f32; 5] {
    let Vec3 { x, y, z } = d;
    [
        SH_C2[0] * x * y,
        SH_C2[1] * y * z,
        SH_C2[2] * (2.0 * z * z - x * x - y * y),
        SH_C2[3] * x * z,
        SH_C2[4] * (x * x - y * y),
    ]
}

/// Colour over all viewing directions, `[9, 3]`.
pub fn shade(position: Vec3, normal: Vec3, material: &Material) -> [[f32; 3]; 9] {
    let sun = sun_direction();
    let lit = normal.dot(sun).max(0.0) * sunlight_at(position + 0.02 * normal);
    let sky = SKY.lerp(BOUNCE, 0.5 - 0.5 * normal.z);
    let diffuse = material.albedo * (sky + SUN * lit) + material.glow;

    // A view along d reflects towards d − 2(d·n)n, and the sky brightens with the height of that direction: a linear
    // function of d, so degree 1 holds it exactly.
    let mirrored_up = Vec3::Z - 2.0 * normal.z * normal;
    // The highlight is b₀ + b₁ P₁ + b₂ P₂ of the cosine between d and the direction that mirrors the sun: 1 at the
    // peak, near 0 elsewhere. By the addition theorem b₂ P₂(d·m) = b₂ 4π/5 Σ Y₂(d) Y₂(m).
    let peak = sun - 2.0 * normal.dot(sun) * normal;
    let [b0, b1, b2] = [0.14, 0.40, 0.46].map(|b| b * 1.6 * lit);
    let constant = diffuse + material.reflection * (0.35 + b0);
    let linear = 0.35 * mirrored_up + b1 * peak;
    let quadratic = degree_2(peak).map(|y| b2 * 4.0 * PI / 5.0 * y);

    let mut sh = [[0.0; 3]; 9];
    sh[0] = ((constant - Vec3::splat(0.5)) / SH_C0).to_array();
    sh[1] = (material.reflection * (-linear.y / SH_C1)).to_array();
    sh[2] = (material.reflection * (linear.z / SH_C1)).to_array();
    sh[3] = (material.reflection * (-linear.x / SH_C1)).to_array();
    for (coefficient, value) in sh[4..].iter_mut().zip(quadratic) {
        *coefficient = (material.reflection * value).to_array();
    }
    sh
}

/// Share of the sun that reaches `position`, with soft edges.
fn sunlight_at(position: Vec3) -> f32 {
    let sun = sun_direction();
    let mut light: f32 = 1.0;
    for (center, radius) in SHADOW_CASTERS {
        let to_center = center - position;
        let along = to_center.dot(sun);
        if along > 0.05 {
            let distance = (to_center - along * sun).length();
            let edge = ((distance / radius - 0.75) / 0.5).clamp(0.0, 1.0);
            light = light.min(edge * edge * (3.0 - 2.0 * edge));
        }
    }
    light
}

/// Radius of the sky dome.
pub const DOME_RADIUS: f32 = 60.0;

/// A dome with clouds, brightest around the sun.
pub fn sky_dome() -> Vec<Splat> {
    let sun = sun_direction();
    let patch = Patch { seed: 1, counts: [240, 70], overlap: 0.85 };
    // v runs down from the zenith, so that ∂u × ∂v points inwards.
    let surface = |u: f32, v: f32| {
        let elevation = 0.25 * TAU * (1.02 - 1.08 * v).min(1.0);
        DOME_RADIUS * (circle(u) * elevation.cos() + Vec3::Z * elevation.sin())
    };
    patch.cover(surface, |position, _, _, _| {
        let d = position.normalize();
        let height = d.z.max(0.0);
        let blue = Vec3::new(0.72, 0.82, 0.92).lerp(Vec3::new(0.22, 0.45, 0.80), height.powf(0.55));
        let cloud = fractal_noise(Vec3::new(d.x, d.y, 1.0) / (d.z.max(0.0) + 0.25) * 1.7 + Vec3::splat(9.0));
        let cover = ((cloud - 0.48) / 0.22).clamp(0.0, 1.0);
        let glare = d.dot(sun).max(0.0).powf(24.0);
        let sky = blue.lerp(Vec3::splat(0.96), 0.85 * cover) + Vec3::new(0.30, 0.24, 0.12) * glare;
        Material { albedo: Vec3::ZERO, reflection: Vec3::ZERO, glow: sky }
    })
}
