//! Seeded randomness and value noise: pure functions, so every splat can be made on any thread.

use glam::{IVec3, Vec3};

/// A small counter-based generator (SplitMix64, Steele et al. 2014).
pub struct Random(u64);

impl Random {
    /// The generator of element `index` of the part `seed`.
    pub fn new(seed: u64, index: usize) -> Self {
        Self(mix(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ mix(index as u64)))
    }

    /// Uniform in `[0, 1)`.
    pub fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        // The upper 24 bits fill the mantissa of an f32.
        (mix(self.0) >> 40) as f32 / (1_u64 << 24) as f32
    }

    /// Uniform in `[low, high)`.
    pub fn range(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
    }

    /// Uniform on the unit sphere.
    pub fn direction(&mut self) -> Vec3 {
        let z = self.range(-1.0, 1.0);
        let angle = self.range(0.0, std::f32::consts::TAU);
        let r = (1.0 - z * z).max(0.0).sqrt();
        Vec3::new(r * angle.cos(), r * angle.sin(), z)
    }
}

const fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

/// Smooth value noise in `[0, 1]` with features of size 1.
pub fn noise(p: Vec3) -> f32 {
    let cell = p.floor();
    let t = p - cell;
    let t = t * t * (Vec3::splat(3.0) - 2.0 * t);
    let corner = cell.as_ivec3();
    let value = |x, y, z| lattice(corner.wrapping_add(IVec3::new(x, y, z)));
    let lerp = |a: f32, b: f32, t: f32| a + (b - a) * t;
    let along_x = |y, z| lerp(value(0, y, z), value(1, y, z), t.x);
    let along_y = |z| lerp(along_x(0, z), along_x(1, z), t.y);
    lerp(along_y(0), along_y(1), t.z)
}

/// Four octaves of [`noise`], in `[0, 1]`.
pub fn fractal_noise(p: Vec3) -> f32 {
    let octaves = [(1.0, 0.5), (2.03, 0.25), (4.01, 0.125), (8.05, 0.125)];
    octaves.iter().map(|(frequency, weight)| weight * noise(p * *frequency)).sum()
}

/// A random value in `[0, 1)` for a whole-numbered place.
pub fn lattice(p: IVec3) -> f32 {
    let bits = (p.x as u32 as u64) ^ ((p.y as u32 as u64) << 21) ^ ((p.z as u32 as u64) << 42);
    (mix(bits.wrapping_mul(0xD6E8_FEB8_6659_FD93)) >> 40) as f32 / (1_u64 << 24) as f32
}
