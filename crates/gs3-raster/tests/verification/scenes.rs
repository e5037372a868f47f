//! Scenes and cameras made for the tests, from a seed.

use glam::{DAffine3, DQuat, DVec2, DVec3};
use gs3_scene::gaussians::sh_coefficient_count;
use gs3_scene::{Camera, Gaussians, Intrinsics, OpacityMode, Scene};

/// SplitMix64 (Steele et al. 2014): small, and the same everywhere.
pub struct Random(pub u64);

impl Random {
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Uniform in `[low, high)`.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * ((self.bits() >> 11) as f64 / (1_u64 << 53) as f64)
    }

    /// Log-uniform in `[low, high)`.
    pub fn log_uniform(&mut self, low: f64, high: f64) -> f64 {
        self.uniform(low.ln(), high.ln()).exp()
    }

    /// Uniform among unit quaternions.
    pub fn rotation(&mut self) -> DQuat {
        loop {
            let q = DQuat::from_array(std::array::from_fn(|_| self.uniform(-1.0, 1.0)));
            if (0.1..1.0).contains(&q.length_squared()) {
                return q.normalize();
            }
        }
    }
}

/// One Gaussian, for tests that place them by hand.
#[derive(Clone, Debug)]
pub struct Spec {
    pub mean: DVec3,
    pub scale: DVec3,
    pub rotation: DQuat,
    pub opacity: f64,
    /// `[(degree + 1)², 3]`.
    pub sh: Vec<f64>,
}

impl Spec {
    /// A ball of constant colour.
    pub fn ball(mean: DVec3, radius: f64, opacity: f64, color: [f64; 3]) -> Self {
        let sh = color.map(|c| (c - 0.5) / 0.28209479177387814).to_vec();
        Self { mean, scale: DVec3::splat(radius), rotation: DQuat::IDENTITY, opacity, sh }
    }
}

/// The Gaussians of `specs`, all of the same degree.
pub fn gaussians(specs: &[Spec], sh_degree: u8) -> Gaussians {
    let mut g = Gaussians::zeroed(specs.len(), sh_degree);
    let stride = sh_coefficient_count(sh_degree) * 3;
    for (i, s) in specs.iter().enumerate() {
        for k in 0..3 {
            g.means[k][i] = s.mean[k] as f32;
            g.scales[k][i] = s.scale[k] as f32;
        }
        let q = s.rotation;
        for (plane, v) in g.rotations.iter_mut().zip([q.w, q.x, q.y, q.z]) {
            plane[i] = v as f32;
        }
        g.opacities[i] = s.opacity as f32;
        assert_eq!(s.sh.len(), stride);
        for (to, from) in g.sh[i * stride..].iter_mut().zip(&s.sh) {
            *to = *from as f32;
        }
    }
    g
}

/// The scene of `specs` in the default opacity mode.
pub fn scene(specs: &[Spec], sh_degree: u8) -> Scene {
    Scene::new(gaussians(specs, sh_degree), OpacityMode::Default).expect("valid by construction")
}

/// A camera at the origin with COLMAP axes, 60° high, its principal point off the centre by `shift` of the size.
pub fn camera_at_origin(width: u32, height: u32, shift: DVec2) -> Camera {
    let mut intrinsics = Intrinsics::from_fov_y(width, height, 60_f64.to_radians());
    // A very wide or high image keeps a sensible field of view along its long side.
    let focal = intrinsics.fx.max(0.6 * f64::from(width));
    (intrinsics.fx, intrinsics.fy) = (focal, focal * 1.05);
    intrinsics.cx += shift.x * f64::from(width);
    intrinsics.cy += shift.y * f64::from(height);
    Camera::new(DAffine3::IDENTITY, intrinsics).expect("valid by construction")
}

/// `camera` moved rigidly.
pub fn posed(camera: &Camera, view_from_world: DAffine3) -> Camera {
    Camera::new(view_from_world, camera.intrinsics()).expect("valid by construction")
}

/// A pose with nothing special about it.
pub fn tilted_pose() -> DAffine3 {
    let rotation = DQuat::from_axis_angle(DVec3::new(0.3, -0.8, 0.5).normalize(), 1.1);
    DAffine3::from_rotation_translation(rotation, DVec3::new(0.4, -0.7, 1.3))
}

/// What to draw at random.
#[derive(Clone, Copy, Debug)]
pub struct RandomScene {
    pub seed: u64,
    pub count: usize,
    pub sh_degree: u8,
    pub opacity_mode: OpacityMode,
    /// Standard deviation of the smallest and largest splats in pixels.
    pub sigma: [f64; 2],
    /// Largest ratio between a Gaussian's axes.
    pub anisotropy: f64,
}

impl RandomScene {
    pub const BASE: Self = Self {
        seed: 1,
        count: 120,
        sh_degree: 0,
        opacity_mode: OpacityMode::Default,
        sigma: [0.4, 12.0],
        anisotropy: 8.0,
    };

    /// Splats all over `camera`'s image and a little beyond it, one in ten before or behind the near plane, one in
    /// five so opaque that α reaches 0.99.
    pub fn build(&self, camera: &Camera) -> Scene {
        Scene::new(gaussians(&self.specs(camera), self.sh_degree), self.opacity_mode).expect("valid")
    }

    pub fn specs(&self, camera: &Camera) -> Vec<Spec> {
        let mut random = Random(self.seed);
        let intrinsics = camera.intrinsics();
        let (w, h) = (f64::from(intrinsics.width), f64::from(intrinsics.height));
        (0..self.count)
            .map(|_| {
                let z = if random.uniform(0.0, 1.0) < 0.1 {
                    random.uniform(-1.0, 0.6)
                } else {
                    random.log_uniform(0.6, 12.0)
                };
                let pixel =
                    DVec2::new(random.uniform(-0.15 * w, 1.15 * w), random.uniform(-0.15 * h, 1.15 * h));
                let radius = random.log_uniform(self.sigma[0], self.sigma[1]) * z.abs() / intrinsics.fx;
                let thinness = self.anisotropy.sqrt();
                let scale = DVec3::from_array(std::array::from_fn(|_| {
                    radius * random.log_uniform(1.0 / thinness, thinness)
                }));
                let opacity = if random.uniform(0.0, 1.0) < 0.2 { 1.0 } else { random.uniform(0.02, 0.98) };
                let mut sh: Vec<f64> = (0..sh_coefficient_count(self.sh_degree) * 3)
                    .map(|_| random.uniform(-0.3, 0.3))
                    .collect();
                for dc in &mut sh[..3] {
                    *dc = random.uniform(-1.6, 1.6);
                }
                Spec { mean: camera.unproject(pixel, z), scale, rotation: random.rotation(), opacity, sh }
            })
            .collect()
    }
}

/// A scene with a smooth image: wide, half-transparent splats that cover the whole image above α = 1/255, few enough
/// that blending never stops.
pub fn smooth_scene(camera: &Camera, seed: u64, sh_degree: u8, opacity_mode: OpacityMode) -> Scene {
    let mut random = Random(seed);
    let intrinsics = camera.intrinsics();
    let (w, h) = (f64::from(intrinsics.width), f64::from(intrinsics.height));
    let specs: Vec<Spec> = (0..7)
        .map(|k| {
            let z = 1.5 + 0.8 * f64::from(k);
            let pixel = DVec2::new(random.uniform(0.2 * w, 0.8 * w), random.uniform(0.2 * h, 0.8 * h));
            // The farthest corner lies within 0.8·√2·side; at σ = 0.5 side that is α ≥ o·e^(−2.6) > 1/255.
            let side = w.max(h) * z / intrinsics.fx;
            let scale = DVec3::from_array(std::array::from_fn(|_| side * random.uniform(0.5, 0.9)));
            let mut sh: Vec<f64> =
                (0..sh_coefficient_count(sh_degree) * 3).map(|_| random.uniform(-0.1, 0.1)).collect();
            for dc in &mut sh[..3] {
                *dc = random.uniform(-1.0, 1.6);
            }
            let mean = camera.unproject(pixel, z);
            Spec { mean, scale, rotation: random.rotation(), opacity: random.uniform(0.3, 0.6), sh }
        })
        .collect();
    Scene::new(gaussians(&specs, sh_degree), opacity_mode).expect("valid by construction")
}
