//! An analytic world, point-sampled: textured, softly cut sheets facing the z axis, seen by any pinhole camera. Its
//! G-buffers are exact, so they are the oracle of the tests.

use glam::{DAffine3, DQuat, DVec2, DVec3, EulerRot};
use gs3_scene::{Camera, GBuffer, Geometry, Gradients, Image, Intrinsics, Margin, Planes};
use rayon::prelude::*;

/// A sheet in the plane `z`: opaque within `half_width` of x = `center`, with an edge `softness` wide; texture of
/// waves.
pub struct Sheet {
    pub z: f64,
    pub center: f64,
    pub half_width: f64,
    pub softness: f64,
    /// Wave vectors (radians per world unit) and amplitudes.
    pub waves: Vec<(DVec2, f64)>,
    pub base: [f64; 3],
}

/// What has less than this weight is left out: less than the rounding of f32.
const UNSEEN: f64 = 1e-12;

/// Sheets, nearest first.
pub struct World {
    pub sheets: Vec<Sheet>,
}

impl Sheet {
    /// A sheet without edge, with waves of up to `frequency` radians per world unit.
    pub fn endless(z: f64, seed: u64, frequency: f64) -> Self {
        let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
        let mut random = move || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        let count = 24;
        let waves = (0..count)
            .map(|k| {
                // Octaves down from the highest frequency, amplitudes as of natural images, 1/f.
                let f = frequency * 2.0_f64.powf(-5.0 * f64::from(k) / f64::from(count));
                let angle = std::f64::consts::TAU * random();
                (DVec2::new(angle.cos(), angle.sin()) * f, 0.03 * (frequency / f).sqrt())
            })
            .collect();
        Self { z, center: 0.0, half_width: f64::INFINITY, softness: 1.0, waves, base: [0.5, 0.45, 0.4] }
    }

    /// How much of what is behind the sheet its point at `p` hides, and how this changes while `p` moves by `moved`.
    fn alpha(&self, p: DVec2, moved: [DVec2; 2]) -> (f64, [f64; 2]) {
        let inside = self.half_width - (p.x - self.center).abs();
        let alpha = if inside == f64::INFINITY { 1.0 } else { 1.0 / (1.0 + (-inside / self.softness).exp()) };
        let slope = -(p.x - self.center).signum() * alpha * (1.0 - alpha) / self.softness;
        (alpha, moved.map(|moved| slope * moved.x))
    }

    /// The colour at `p`, and how it changes while `p` moves by `moved`.
    fn color(&self, p: DVec2, moved: [DVec2; 2]) -> ([f64; 3], [[f64; 3]; 2]) {
        let (mut color, mut slopes) = (self.base, [[0.0; 3]; 2]);
        for (k, (wave, amplitude)) in self.waves.iter().enumerate() {
            let (sin, cos) = (wave.dot(p) + k as f64).sin_cos();
            color[k % 3] += amplitude * sin;
            color[(k + 1) % 3] += 0.7 * amplitude * cos;
            for (slopes, moved) in slopes.iter_mut().zip(moved) {
                let rate = wave.dot(moved);
                slopes[k % 3] += amplitude * cos * rate;
                slopes[(k + 1) % 3] -= 0.7 * amplitude * sin * rate;
            }
        }
        (color, slopes)
    }
}

/// What a pixel position shows.
#[derive(Default)]
pub struct Sample {
    pub color: [f64; 3],
    /// ∂colour/∂x and ∂colour/∂y, per pixel.
    pub slopes: [[f64; 3]; 2],
    /// The median depth, 0 for none.
    pub depth: f64,
    pub alpha: f64,
}

impl World {
    /// What `camera` sees at a pixel position.
    pub fn sample(&self, camera: &Camera, pixel: DVec2) -> Sample {
        let origin = camera.position();
        let towards = |pixel: DVec2| camera.unproject(pixel, 1.0) - origin;
        let direction = towards(pixel);
        let along = [DVec2::X, DVec2::Y].map(|step| towards(pixel + step) - direction);
        let mut sample = Sample::default();
        // Of what is behind, and its slopes.
        let (mut transmittance, mut falls) = (1.0, [0.0; 2]);
        for sheet in &self.sheets {
            let z = (sheet.z - origin.z) / direction.z;
            if z <= 0.0 {
                continue;
            }
            let hit = (origin + direction * z).truncate();
            // The hit stays in the sheet's plane.
            let moved = along.map(|along| ((along - direction * (along.z / direction.z)) * z).truncate());
            let (alpha, alpha_slopes) = sheet.alpha(hit, moved);
            if transmittance * alpha < UNSEEN {
                continue;
            }
            let (color, slopes) = sheet.color(hit, moved);
            for c in 0..3 {
                sample.color[c] += transmittance * alpha * color[c];
                for axis in 0..2 {
                    let weight_slope = falls[axis] * alpha + transmittance * alpha_slopes[axis];
                    sample.slopes[axis][c] +=
                        weight_slope * color[c] + transmittance * alpha * slopes[axis][c];
                }
            }
            // As the rasterizer: what is too faint is not there.
            if transmittance > 0.5 && alpha >= 1.0 / 255.0 {
                sample.depth = z;
            }
            falls = [0, 1].map(|axis| falls[axis] * (1.0 - alpha) - transmittance * alpha_slopes[axis]);
            transmittance *= 1.0 - alpha;
        }
        sample.alpha = 1.0 - transmittance;
        sample
    }

    /// The image at all pixel centres.
    pub fn native(&self, camera: &Camera) -> Image {
        let mut image = Image::new(camera.width() as usize, camera.height() as usize);
        let width = image.width();
        image.pixels_mut().par_iter_mut().enumerate().for_each(|(k, pixel)| {
            let p = DVec2::new((k % width) as f64 + 0.5, (k / width) as f64 + 0.5);
            let Sample { color, alpha, .. } = self.sample(camera, p);
            *pixel = [color[0] as f32, color[1] as f32, color[2] as f32, alpha as f32];
        });
        image
    }

    /// The G-buffer of `camera` (the LR camera itself) and what lies around its picture.
    pub fn gbuffer_around(&self, camera: &Camera, jitter: [f32; 2], margin: Margin) -> GBuffer {
        let mut intrinsics = camera.intrinsics();
        [intrinsics.width, intrinsics.height] = margin.padded(intrinsics.size()).to_array();
        intrinsics.cx += f64::from(margin.left);
        intrinsics.cy += f64::from(margin.top);
        let wider = Camera::new(camera.view_from_world(), intrinsics).unwrap();
        GBuffer { margin, ..self.gbuffer(&wider, jitter) }
    }

    /// The G-buffer of `camera` (the LR camera itself).
    pub fn gbuffer(&self, camera: &Camera, jitter: [f32; 2]) -> GBuffer {
        let (width, height) = (camera.width() as usize, camera.height() as usize);
        let mut out = GBuffer {
            jitter,
            margin: Margin::NONE,
            color: Planes::new(width, height),
            alpha: Planes::new(width, height),
            gradients: Some(Gradients {
                color_dx: Planes::new(width, height),
                color_dy: Planes::new(width, height),
                color_dxy: None,
            }),
            geometry: Some(Geometry {
                depth_median: Planes::new(width, height),
                depth_expected: Planes::new(width, height),
                normal: Planes::new(width, height),
            }),
        };
        let size = width * height;
        let samples: Vec<_> = (0..size)
            .into_par_iter()
            .map(|k| {
                let p = DVec2::new((k % width) as f64, (k / width) as f64) + 0.5;
                self.sample(camera, p + DVec2::from(jitter.map(f64::from)))
            })
            .collect();
        let gradients = out.gradients.as_mut().unwrap();
        let geometry = out.geometry.as_mut().unwrap();
        for (k, Sample { color, slopes: [dx, dy], depth, alpha }) in samples.into_iter().enumerate() {
            for c in 0..3 {
                out.color.data_mut()[c * size + k] = color[c] as f32;
                gradients.color_dx.data_mut()[c * size + k] = dx[c] as f32;
                gradients.color_dy.data_mut()[c * size + k] = dy[c] as f32;
            }
            geometry.depth_median.data_mut()[k] = depth as f32;
            geometry.depth_expected.data_mut()[k] = depth as f32;
            out.alpha.data_mut()[k] = alpha as f32;
        }
        out
    }
}

#[test]
fn slopes_are_those_of_the_colour() {
    // A sheet that more light comes through lies between post and wall.
    let mut world = wall_and_post(60.0);
    world.sheets.insert(1, Sheet { half_width: 0.3, softness: 0.1, ..Sheet::endless(4.0, 5, 40.0) });
    let camera = camera(64, 40, [0.1, 0.2, 0.3], 0.3, -0.2);
    let step = 1e-4;
    for k in 0..64 * 40 {
        let pixel = DVec2::new((k % 64) as f64 + 0.3, (k / 64) as f64 + 0.8);
        let slopes = world.sample(&camera, pixel).slopes;
        for (slopes, axis) in slopes.into_iter().zip([DVec2::X, DVec2::Y]) {
            let [after, before] = [step, -step].map(|step| world.sample(&camera, pixel + axis * step).color);
            for c in 0..3 {
                let difference = (after[c] - before[c]) / (2.0 * step);
                // The difference errs by step²/6 of the third derivative: 7e-7 at the post's edge.
                assert!((slopes[c] - difference).abs() < 1e-6, "{pixel}: {} {difference}", slopes[c]);
            }
        }
    }
}

/// A camera at `position` looking along z, turned by `yaw` and `pitch` radians.
pub fn camera(width: u32, height: u32, position: [f64; 3], yaw: f64, pitch: f64) -> Camera {
    let rotation = DQuat::from_euler(EulerRot::YXZ, yaw, pitch, 0.0);
    let pose = DAffine3::from_rotation_translation(rotation, DVec3::from(position)).inverse();
    Camera::new(pose, Intrinsics::from_fov_y(width, height, 1.0)).unwrap()
}

/// The jitter of frame `k` on the exact `scale`×`scale` grid, in an order that spreads early samples.
pub fn grid_jitter(scale: u32, k: usize) -> [f32; 2] {
    let s = scale as usize;
    let n = s * s;
    // A stride coprime to S² visits every cell and keeps successive ones apart.
    let stride = match s {
        2 => 3,
        3 => 4,
        4 => 5,
        _ => 1,
    };
    let cell = (k * stride) % n;
    let (a, b) = (cell % s, (cell / s + k * usize::from(s == 2)) % s);
    let offset = |a: usize| (a as f32 - (scale as f32 - 1.0) / 2.0) / scale as f32;
    [offset(a), offset(b)]
}

/// A wall with a post in front.
pub fn wall_and_post(frequency: f64) -> World {
    let mut post = Sheet::endless(3.0, 7, frequency * 2.0);
    (post.half_width, post.softness, post.base) = (0.25, 0.004, [0.7, 0.3, 0.2]);
    World { sheets: vec![post, Sheet::endless(6.0, 3, frequency)] }
}

/// A post with a soft rim and a wall that ends: holes inside and at the border, and nothing beyond.
pub fn wall_that_ends(frequency: f64) -> World {
    let mut world = wall_and_post(frequency);
    world.sheets[1].half_width = 3.0;
    world.sheets.push(Sheet { half_width: 9.0, softness: 0.1, ..Sheet::endless(14.0, 5, frequency / 3.0) });
    world
}
