//! A small world that can be evaluated anywhere, exactly: a textured disc before a textured wall. The disc flies and turns;
//! the camera is wherever a test puts it.

use std::f64::consts::TAU;

use glam::{DAffine3, DQuat, DVec2, DVec3};
use gs3_reconstruct::{GBufferView, PlanesView};
use gs3_scene::{Camera, Image, Intrinsics, Size};
use rayon::prelude::*;

pub const SCALE: u32 = 4;
pub const SIZE: Size = Size::new(256, 160);

/// The z of the wall.
const WALL: f64 = 6.0;
const RADIUS: f64 = 0.7;

/// How the disc moves in a frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct World {
    /// World units a frame; its start is left of the middle, two units before the wall.
    pub velocity: DVec3,
    /// Radians a frame, about its middle, in its plane.
    pub spin: f64,
}

/// What a ray meets.
#[derive(Clone, Copy)]
struct Hit {
    is_disc: bool,
    point: DVec3,
}

fn texture(p: DVec2, seed: f64) -> [f64; 3] {
    let wave = |fx: f64, fy: f64, phase: f64| (TAU * (fx * p.x + fy * p.y) + phase + seed).sin();
    [
        0.5 + 0.16 * wave(1.7, 0.6, 0.1) + 0.12 * wave(-3.1, 4.3, 1.0) + 0.08 * wave(8.0, 5.1, 2.0),
        0.5 + 0.16 * wave(0.8, -1.9, 2.1) + 0.12 * wave(4.7, 2.2, 0.4) + 0.08 * wave(-6.4, 7.3, 1.1),
        0.5 + 0.16 * wave(-1.2, 1.1, 4.0) + 0.12 * wave(2.6, -5.2, 3.3) + 0.08 * wave(5.9, 8.2, 0.7),
    ]
}

impl World {
    fn center(self, time: f64) -> DVec3 {
        DVec3::new(-0.6, 0.05, 4.0) + self.velocity * time
    }

    /// Where on the plane of the disc or the wall the ray through a pixel position meets it.
    fn meet(self, camera: &Camera, pixel: DVec2, z: f64) -> DVec3 {
        let origin = camera.position();
        let direction = camera.unproject(pixel, 1.0) - origin;
        origin + direction * ((z - origin.z) / direction.z)
    }

    fn hit(self, camera: &Camera, pixel: DVec2, time: f64) -> Hit {
        let center = self.center(time);
        let on_disc = self.meet(camera, pixel, center.z);
        if on_disc.distance(center) < RADIUS {
            Hit { is_disc: true, point: on_disc }
        } else {
            Hit { is_disc: false, point: self.meet(camera, pixel, WALL) }
        }
    }

    /// The colour of the disc or the wall where a ray meets it.
    fn color(self, is_disc: bool, point: DVec3, time: f64) -> [f64; 3] {
        if is_disc {
            let turned = DVec2::from_angle(-self.spin * time).rotate((point - self.center(time)).truncate());
            texture(turned, 5.0)
        } else {
            texture(point.truncate(), 0.0)
        }
    }

    /// Where the surface that is at `hit` was a frame before.
    fn before(self, hit: Hit, time: f64) -> DVec3 {
        if !hit.is_disc {
            return hit.point;
        }
        let away = hit.point - self.center(time);
        let turned = DVec2::from_angle(-self.spin).rotate(away.truncate());
        self.center(time - 1.0) + turned.extend(away.z)
    }

    /// The image with which super sampling is compared.
    pub fn native(self, camera: &Camera, time: f64) -> Image {
        let mut image = Image::new(camera.width() as usize, camera.height() as usize);
        let width = image.width();
        image.pixels_mut().par_iter_mut().enumerate().for_each(|(k, pixel)| {
            let hit = self.hit(camera, center(k, width), time);
            let c = self.color(hit.is_disc, hit.point, time);
            *pixel = [c[0] as f32, c[1] as f32, c[2] as f32, 1.0];
        });
        image
    }

    /// For each pixel how far it lies outside of the disc's rim, world units at its depth; negative on the disc.
    pub fn outside(self, camera: &Camera, time: f64) -> Vec<f64> {
        let width = camera.width() as usize;
        let disc = self.center(time);
        let away =
            |k: usize| self.meet(camera, center(k, width), disc.z).truncate().distance(disc.truncate());
        (0..width * camera.height() as usize).map(|k| away(k) - RADIUS).collect()
    }

    /// What a renderer hands over: RGBA, derivatives per LR pixel, distances, motion since the frame of `before`.
    pub fn render(self, camera: &Camera, before: &Camera, jitter: [f32; 2], time: f64) -> Buffers {
        let (lr, lr_before) = (camera.low_resolution(SCALE), before.low_resolution(SCALE));
        let (size, width) = (lr.size(), lr.width() as usize);
        let mut buffers = Buffers { size, jitter, ..Buffers::default() };
        let offset = DVec2::from(jitter.map(f64::from));
        for k in 0..size.pixels() as usize {
            let at = center(k, width) + offset;
            let hit = self.hit(&lr, at, time);
            let color = self.color(hit.is_disc, hit.point, time);
            buffers.rgba.extend(color.map(|v| v as f32).into_iter().chain([1.0]));
            let (_, z) = lr.project(hit.point);
            buffers.depth.push(z as f32);
            // Derivatives of the visible surface, by differences much finer than its texture.
            let slope = |step: DVec2| {
                let texel = |side: f64| {
                    let point = self.meet(&lr, at + step * side, hit.point.z);
                    self.color(hit.is_disc, point, time)
                };
                let (a, b) = (texel(-1.0), texel(1.0));
                [0, 1, 2].map(|c| ((b[c] - a[c]) / (2.0 * step.length())) as f32)
            };
            buffers.dx.extend(slope(DVec2::new(1e-3, 0.0)));
            buffers.dy.extend(slope(DVec2::new(0.0, 1e-3)));
            let (was, _) = lr_before.project(self.before(hit, time));
            buffers.motion.extend((was - at).to_array().map(|v| v as f32));
        }
        buffers
    }
}

/// The centre of pixel `k` of rows of `width`.
fn center(k: usize, width: usize) -> DVec2 {
    DVec2::new((k % width) as f64 + 0.5, (k / width) as f64 + 0.5)
}

/// The buffers of a renderer.
#[derive(Clone, Default)]
pub struct Buffers {
    pub size: Size,
    pub jitter: [f32; 2],
    pub rgba: Vec<f32>,
    pub dx: Vec<f32>,
    pub dy: Vec<f32>,
    pub depth: Vec<f32>,
    pub motion: Vec<f32>,
}

impl Buffers {
    /// Without motion.
    pub fn view(&self) -> GBufferView<'_> {
        let color = PlanesView::interleaved(&self.rgba, self.size, 4).unwrap();
        let depth = PlanesView::planar(&self.depth, self.size).unwrap();
        let slopes = [&self.dx, &self.dy].map(|data| PlanesView::interleaved(data, self.size, 3).unwrap());
        GBufferView { gradients: Some(slopes), ..GBufferView::new(color, depth, self.jitter) }
    }

    pub fn moving_view(&self) -> GBufferView<'_> {
        let motion = PlanesView::interleaved(&self.motion, self.size, 2).unwrap();
        GBufferView { motion: Some(motion), ..self.view() }
    }
}

/// At x, looking along z.
pub fn camera(x: f64) -> Camera {
    turned_camera(x, 0.0)
}

/// At x, turned by `yaw` radians from z towards x.
pub fn turned_camera(x: f64, yaw: f64) -> Camera {
    let intrinsics = Intrinsics::from_fov_y(SIZE.width, SIZE.height, 0.6);
    let rotation = DAffine3::from_quat(DQuat::from_rotation_y(-yaw));
    Camera::new(rotation * DAffine3::from_translation(DVec3::new(-x, 0.0, 0.0)), intrinsics).unwrap()
}

/// PSNR over RGB of the pixels that `is_wanted` says, by their number, dB.
pub fn psnr_where(a: &Image, b: &Image, is_wanted: impl Fn(usize) -> bool) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for (k, (a, b)) in a.pixels().iter().zip(b.pixels()).enumerate() {
        if is_wanted(k) {
            sum += (0..3).map(|c| f64::from(a[c] - b[c]).powi(2)).sum::<f64>();
            count += 3.0;
        }
    }
    -10.0 * (sum / count).max(1e-12).log10()
}
