//! Everything that grows: meadow, grass, trees, hedges, hills.

use std::f32::consts::TAU;

use glam::Vec3;
use rayon::prelude::*;

use super::court::COURT_RADIUS;
use super::light::{DOME_RADIUS, Material};
use super::noise::{Random, fractal_noise, noise};
use super::splats::{Patch, Splat, blade, circle};

const MEADOW_RADIUS: f32 = 14.0;
const GRASS_BLADES: usize = 70_000;
const LEAVES_PER_TREE: usize = 9_000;
const TREES: usize = 9;

pub fn splats() -> Vec<Splat> {
    let mut splats = meadow();
    splats.extend(hills());
    splats.extend(grass());
    for k in 0..TREES {
        splats.extend(tree(k));
    }
    splats
}

fn ground_height(p: Vec3) -> f32 {
    let outside = ((p.truncate().length() - COURT_RADIUS) / 3.0).clamp(0.0, 1.0);
    0.35 * outside * (noise(p * 0.45 + Vec3::splat(5.0)) - 0.3)
}

fn meadow() -> Vec<Splat> {
    let patch = Patch { seed: 40, counts: [500, 70], overlap: 0.66 };
    let surface = |u: f32, v: f32| {
        let p = circle(-u) * (COURT_RADIUS + (MEADOW_RADIUS - COURT_RADIUS) * v.max(0.0).powf(1.4));
        p + Vec3::Z * (ground_height(p) - 0.01)
    };
    patch.cover(surface, |p, _, _, _| {
        let dry = fractal_noise(p * 1.3);
        let green =
            Vec3::new(0.20, 0.30, 0.10).lerp(Vec3::new(0.46, 0.40, 0.20), (2.5 * dry - 0.8).clamp(0.0, 1.0));
        Material::matt(green * (0.6 + 0.8 * fractal_noise(p * 6.0)))
    })
}

fn hills() -> Vec<Splat> {
    let patch = Patch { seed: 41, counts: [420, 44], overlap: 0.68 };
    let surface = |u: f32, v: f32| {
        let t = v.clamp(0.0, 1.0);
        let p = circle(-u) * (MEADOW_RADIUS - 0.5 + (DOME_RADIUS - 2.0 - MEADOW_RADIUS) * t);
        p + Vec3::Z * (ground_height(p) + 11.0 * t * t * (fractal_noise(p * 0.06) - 0.22))
    };
    patch.cover(surface, |p, _, _, _| {
        let far = ((p.truncate().length() - MEADOW_RADIUS) / DOME_RADIUS).clamp(0.0, 1.0);
        let field = Vec3::new(0.22, 0.33, 0.12).lerp(Vec3::new(0.48, 0.46, 0.22), fractal_noise(p * 0.3));
        let copse = if fractal_noise(p * 0.21 + Vec3::splat(50.0)) > 0.55 { 0.5 } else { 1.0 };
        Material::matt((field * copse).lerp(Vec3::new(0.55, 0.66, 0.78), 0.75 * far))
    })
}

fn grass() -> Vec<Splat> {
    let blade_of_grass = |i: usize| {
        let mut random = Random::new(42, i);
        // Dense where the camera comes near.
        let radius = COURT_RADIUS - 0.05 + 6.0 * random.unit().powf(1.5);
        let p = circle(random.unit()) * radius;
        let clump = noise(p * 2.3 + Vec3::splat(70.0));
        let root = p + Vec3::Z * ground_height(p);
        let height = random.range(0.02, 0.05) * (0.6 + 1.2 * clump);
        let lean = circle(random.unit() * 0.5 + 0.3 * clump) * random.range(0.1, 0.7);
        let is_flower = random.unit() < 0.03;
        let green = Vec3::new(0.24, 0.42, 0.10).lerp(Vec3::new(0.62, 0.62, 0.24), random.unit() * clump);
        if is_flower {
            let petals =
                [Vec3::new(0.95, 0.85, 0.25), Vec3::new(0.92, 0.92, 0.96), Vec3::new(0.72, 0.32, 0.62)];
            let color = petals[(random.unit() * 3.0) as usize % 3];
            let head = root + Vec3::Z * (3.0 * height);
            return blade(head, lean, Vec3::Z, Vec3::new(0.014, 0.012, 0.004), &Material::matt(color));
        }
        // Blades catch light from all sides: shaded as if they faced up.
        let size = Vec3::new(height, 0.0035, 0.0012);
        blade(root, Vec3::Z + lean, Vec3::Z, size, &Material::matt(green * random.range(0.6, 1.15)))
    };
    (0..GRASS_BLADES).into_par_iter().map(blade_of_grass).collect()
}

/// Tree `k`: a trunk, and leaves around the ends of its twigs.
fn tree(k: usize) -> Vec<Splat> {
    let mut random = Random::new(43, k);
    let place =
        circle(0.02 + 0.96 * (k as f32 + random.range(-0.2, 0.2)) / TREES as f32) * random.range(6.4, 10.5);
    let root = place + Vec3::Z * ground_height(place);
    let height = random.range(2.2, 3.4);
    let crown = random.range(1.2, 1.9);
    let hue = random.unit();
    let trunk = Patch { seed: 44 + k as u64, counts: [36, 60], overlap: 0.65 };
    let bend = circle(random.unit()) * 0.3;
    let axis = |v: f32| root + Vec3::Z * (height * v) + bend * (v * v);
    let surface = |u: f32, v: f32| {
        let radius = 0.16 * (1.0 - 0.6 * v) + 0.10 * (-9.0 * v).exp() + 0.012 * (u * 9.0 * TAU).sin();
        axis(v) + circle(u) * radius
    };
    let mut splats = trunk.cover(surface, |p, _, u, _| {
        let bark = noise(Vec3::new(u * 40.0, p.z * 7.0, k as f32));
        Material::matt(Vec3::new(0.36, 0.27, 0.19) * (0.5 + 0.9 * bark))
    });
    let center = axis(1.0) + Vec3::Z * (0.35 * crown);
    let base = Vec3::new(0.20, 0.40, 0.10).lerp(Vec3::new(0.66, 0.42, 0.10), 0.8 * hue * hue);
    let leaf = |i: usize| {
        let mut random = Random::new(100 + k as u64, i);
        // Sixty twigs share the leaves, so that the crown has clumps and holes.
        let mut twig = Random::new(200 + k as u64, i % 60);
        let reach = twig.direction() * Vec3::new(1.0, 1.0, 0.75);
        let twig_end = center + reach * (crown * twig.range(0.45, 1.0));
        let p = twig_end + random.direction() * (0.42 * random.unit().sqrt());
        let facing =
            (random.direction() + Vec3::Z + (p - center).normalize_or(Vec3::Z)).normalize_or(Vec3::Z);
        let along = random.direction();
        // Deep leaves see less sky.
        let depth = ((p - center).length() / crown).clamp(0.25, 1.1);
        let tint = base * random.range(0.7, 1.25) * depth;
        let material = Material { albedo: tint, reflection: Vec3::splat(0.05), glow: tint * 0.10 };
        blade(p, along, facing, Vec3::new(0.036, 0.017, 0.0025), &material)
    };
    splats.par_extend((0..LEAVES_PER_TREE).into_par_iter().map(leaf));
    splats
}
