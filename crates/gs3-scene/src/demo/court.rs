//! The stone court: paving, pedestal, knot, marble spheres, columns.

use std::f32::consts::{PI, TAU};

use glam::{IVec3, Quat, Vec3};

use super::light::Material;
use super::noise::{fractal_noise, lattice, noise};
use super::splats::{Patch, Splat, circle};

/// Radius of the paved court.
pub const COURT_RADIUS: f32 = 3.4;

const COLUMNS: usize = 7;
const COLUMN_HEIGHT: f32 = 2.9;

pub fn splats() -> Vec<Splat> {
    let mut splats = paving();
    splats.extend(pedestal());
    splats.extend(knot());
    let spheres = [
        (Vec3::new(1.7, 0.9, 0.42), 0.42, Vec3::new(0.70, 0.69, 0.67), 10),
        (Vec3::new(-1.2, 1.6, 0.55), 0.55, Vec3::new(0.16, 0.34, 0.30), 11),
        (Vec3::new(-1.5, -1.3, 0.36), 0.36, Vec3::new(0.62, 0.22, 0.16), 12),
        (Vec3::new(1.1, -1.75, 0.48), 0.48, Vec3::new(0.18, 0.22, 0.42), 13),
        (Vec3::new(2.3, -0.6, 0.24), 0.24, Vec3::new(0.72, 0.56, 0.30), 14),
    ];
    for (center, radius, color, seed) in spheres {
        splats.extend(marble_sphere(center, radius, color, seed));
    }
    for k in 0..COLUMNS {
        // No column where the camera enters.
        let place = circle(0.08 + 0.75 * k as f32 / COLUMNS as f32) * (COURT_RADIUS - 0.4);
        splats.extend(column(place, 20 + k as u64));
    }
    splats
}

fn paving() -> Vec<Splat> {
    let patch = Patch { seed: 2, counts: [560, 150], overlap: 0.62 };
    let surface = |u: f32, v: f32| {
        let p = circle(-u) * (COURT_RADIUS * v.max(0.0).powf(0.62));
        p + Vec3::Z * (0.02 * noise(p * 9.0))
    };
    patch.cover(surface, |p, _, _, _| {
        // Rings of stones, every ring turned against its neighbours.
        let ring = (p.truncate().length() / 0.34).floor();
        let stones = 1.0 + ring * 5.0;
        let turn = p.y.atan2(p.x) / TAU + 0.5 + 0.37 * ring;
        let stone = (turn * stones).floor();
        let to_ring_edge = 0.5 - ((p.truncate().length() / 0.34).fract() - 0.5).abs();
        let to_stone_edge = (0.5 - ((turn * stones).fract() - 0.5).abs()) * TAU * (ring + 0.5) / stones;
        let shade = 0.55 + 0.30 * lattice(IVec3::new(ring as i32, stone as i32, 7));
        let grain = 0.75 + 0.5 * fractal_noise(p * 14.0);
        let warm = Vec3::new(0.95, 0.88, 0.78)
            .lerp(Vec3::new(0.72, 0.74, 0.76), lattice(IVec3::new(stone as i32, ring as i32, 3)));
        let is_joint = to_ring_edge.min(to_stone_edge) < 0.05;
        let albedo = if is_joint { Vec3::new(0.22, 0.21, 0.17) } else { warm * shade * grain };
        let wet = ((noise(p * 1.1 + Vec3::splat(4.0)) - 0.5) * 4.0).clamp(0.0, 1.0);
        let reflection = if is_joint { Vec3::ZERO } else { Vec3::splat(0.30 * wet) };
        Material { albedo: albedo * (1.0 - 0.35 * wet), reflection, glow: Vec3::ZERO }
    })
}

fn pedestal() -> Vec<Splat> {
    let patch = Patch { seed: 3, counts: [220, 80], overlap: 0.62 };
    // The profile is turned around z: base, waist, cornice, lid; from the top down, so that normals point outwards.
    let profile: [(f32, f32); 7] =
        [(0.0, 0.92), (0.52, 0.92), (0.52, 0.82), (0.42, 0.74), (0.40, 0.22), (0.56, 0.12), (0.56, 0.0)];
    let lengths: Vec<f32> = profile.windows(2).map(|w| (w[1].0 - w[0].0).hypot(w[1].1 - w[0].1)).collect();
    let total: f32 = lengths.iter().sum();
    let at = move |v: f32| {
        let mut rest = v.clamp(0.0, 1.0) * total;
        for (segment, length) in profile.windows(2).zip(&lengths) {
            if rest <= *length {
                let t = rest / length;
                let mix = |a: f32, b: f32| a + (b - a) * t;
                return (mix(segment[0].0, segment[1].0), mix(segment[0].1, segment[1].1));
            }
            rest -= length;
        }
        (0.56, 0.0)
    };
    let surface = move |u: f32, v: f32| {
        let (radius, height) = at(v);
        circle(-u) * radius.max(1e-3) + Vec3::Z * height
    };
    patch.cover(surface, |p, _, u, _| {
        let flutes = if p.z > 0.22 && p.z < 0.74 { 0.82 + 0.18 * (u * 24.0 * TAU).cos() } else { 1.0 };
        let stain = 0.7 + 0.5 * fractal_noise(Vec3::new(p.x * 6.0, p.y * 6.0, p.z * 2.0));
        let band =
            if (p.z - 0.48).abs() < 0.06 { Vec3::new(0.30, 0.42, 0.52) } else { Vec3::new(0.78, 0.74, 0.68) };
        Material { albedo: band * flutes * stain, reflection: Vec3::splat(0.06), glow: Vec3::ZERO }
    })
}

/// A gilded (2, 3) torus knot with an engraved band.
fn knot() -> Vec<Splat> {
    let patch = Patch { seed: 4, counts: [900, 48], overlap: 0.62 };
    let curve = |u: f32| {
        let (a, b) = (2.0 * TAU * u, 3.0 * TAU * u);
        let r = 0.42 + 0.17 * b.cos();
        // Upright: the knot's axis lies in the ground plane.
        Vec3::new(r * a.cos(), 0.30 * b.sin(), r * a.sin()) + Vec3::new(0.0, 0.0, 1.60)
    };
    let surface = |u: f32, v: f32| {
        let tangent = (curve(u + 1e-3) - curve(u - 1e-3)).normalize();
        let outwards = (curve(u) - Vec3::new(0.0, 0.0, 1.60)).normalize();
        let side = tangent.cross(outwards).normalize();
        let up = side.cross(tangent);
        let (sin, cos) = (TAU * v).sin_cos();
        let radius = 0.105 + 0.008 * (TAU * 36.0 * u).sin() * (TAU * 3.0 * v).sin();
        curve(u) + radius * (up * cos + side * sin)
    };
    patch.cover(surface, |p, _, u, v| {
        let is_engraved = ((v * 4.0 + u * 72.0).fract() - 0.5).abs() < 0.07;
        let tarnish = fractal_noise(p * 7.0);
        let gold = Vec3::new(0.95, 0.66, 0.26)
            .lerp(Vec3::new(0.72, 0.36, 0.20), (2.2 * tarnish - 0.7).clamp(0.0, 1.0));
        let albedo = if is_engraved { gold * 0.12 } else { gold * 0.30 };
        let reflection = if is_engraved { gold * 0.15 } else { gold * 0.95 };
        Material { albedo, reflection, glow: Vec3::ZERO }
    })
}

fn marble_sphere(center: Vec3, radius: f32, color: Vec3, seed: u64) -> Vec<Splat> {
    let side = (radius * 210.0) as usize;
    let patch = Patch { seed, counts: [2 * side, side], overlap: 0.62 };
    let surface = |u: f32, v: f32| {
        let (sin, cos) = (PI * v.clamp(0.0, 1.0)).sin_cos();
        center + radius * (circle(-u) * sin.max(1e-3) + Vec3::Z * cos)
    };
    patch.cover(surface, |p, _, _, _| {
        let q = (p - center) / radius * 2.2 + Vec3::splat(seed as f32);
        let vein = (q.x * 2.0 + 5.0 * fractal_noise(q)).sin().abs().powf(0.35);
        let fleck = if noise(q * 14.0) > 0.82 { 0.75 } else { 1.0 };
        let albedo = color.lerp(Vec3::splat(0.85), 0.75 * (1.0 - vein)) * fleck;
        Material { albedo, reflection: Vec3::splat(0.22), glow: Vec3::ZERO }
    })
}

fn column(place: Vec3, seed: u64) -> Vec<Splat> {
    let patch = Patch { seed, counts: [110, 90], overlap: 0.62 };
    let broken = COLUMN_HEIGHT * (0.62 + 0.38 * lattice(IVec3::new(seed as i32, 1, 1)));
    let turn = Quat::from_rotation_z(seed as f32);
    let surface = |u: f32, v: f32| {
        // The last tenth of v closes the top.
        let (height, inwards) =
            if v < 0.9 { (v / 0.9 * broken, 1.0) } else { (broken, ((1.0 - v) / 0.1).max(0.02)) };
        let foot = 0.22 - 0.012 * height + 0.09 * (-(height / 0.16).powi(4)).exp();
        let flute = 1.0 - 0.05 * (TAU * 16.0 * u).cos().abs();
        let chipped =
            0.05 * noise(Vec3::new(u * 12.0, seed as f32, height * 3.0)) * (height / broken).powi(4);
        place + turn * (circle(u) * ((foot * flute - chipped) * inwards) + Vec3::Z * height)
    };
    patch.cover(surface, |p, _, u, _| {
        let groove = 0.70 + 0.30 * (1.0 - (TAU * 16.0 * u).cos().abs());
        let weather = fractal_noise(Vec3::new(p.x * 5.0, p.y * 5.0, p.z * 1.6));
        let moss =
            ((fractal_noise(p * 3.0 + Vec3::splat(31.0)) - 0.5) * 5.0 - p.z * 0.8 + 0.6).clamp(0.0, 1.0);
        let stone = Vec3::new(0.86, 0.80, 0.70) * groove * (0.65 + 0.5 * weather);
        Material::matt(stone.lerp(Vec3::new(0.26, 0.34, 0.14), moss))
    })
}
