//! The reconstructor: any renderer's frames, whatever lies where in memory.
#![allow(clippy::unwrap_used, reason = "a failed helper is a failed test")]

use std::f64::consts::TAU;

use glam::{DAffine3, DVec2, DVec3};
use gs3_reconstruct::{
    DepthEncoding, GBufferView, PlanesView, ReconstructError, Reconstructor, ReconstructorSettings, Strides,
};
use gs3_scene::{Camera, GBuffer, Image, Intrinsics};
use rayon::prelude::*;

const SCALE: u32 = 4;
const SIZE: [u32; 2] = [256, 160];

/// A textured disc before a textured wall, both facing the camera. The disc shifts along x by `speed` world units a frame.
#[derive(Clone, Copy)]
struct World {
    speed: f64,
}

const WALL: f64 = 6.0;
const DISC: f64 = 4.0;
const RADIUS: f64 = 0.7;

fn texture(p: DVec2, seed: f64) -> [f64; 3] {
    let wave = |fx: f64, fy: f64, phase: f64| (TAU * (fx * p.x + fy * p.y) + phase + seed).sin();
    [
        0.5 + 0.16 * wave(1.7, 0.6, 0.1) + 0.12 * wave(-3.1, 4.3, 1.0) + 0.08 * wave(8.0, 5.1, 2.0),
        0.5 + 0.16 * wave(0.8, -1.9, 2.1) + 0.12 * wave(4.7, 2.2, 0.4) + 0.08 * wave(-6.4, 7.3, 1.1),
        0.5 + 0.16 * wave(-1.2, 1.1, 4.0) + 0.12 * wave(2.6, -5.2, 3.3) + 0.08 * wave(5.9, 8.2, 0.7),
    ]
}

impl World {
    fn center(self, time: f64) -> DVec2 {
        DVec2::new(-0.6 + self.speed * time, 0.05)
    }

    /// Colour and depth at a pixel position of `camera` at `time`, and how the surface moved in one frame.
    fn sample(self, camera: &Camera, pixel: DVec2, time: f64) -> ([f64; 3], f64, DVec3) {
        let origin = camera.position();
        let direction = camera.unproject(pixel, 1.0) - origin;
        let hit = |z: f64| origin + direction * ((z - origin.z) / direction.z);
        let on_disc = hit(DISC).truncate() - self.center(time);
        if on_disc.length() < RADIUS {
            (texture(on_disc, 5.0), DISC - origin.z, DVec3::new(self.speed, 0.0, 0.0))
        } else {
            (texture(hit(WALL).truncate(), 0.0), WALL - origin.z, DVec3::ZERO)
        }
    }

    fn native(self, camera: &Camera, time: f64) -> Image {
        let mut image = Image::new(camera.width() as usize, camera.height() as usize);
        let width = image.width();
        image.pixels_mut().par_iter_mut().enumerate().for_each(|(k, pixel)| {
            let at = DVec2::new((k % width) as f64 + 0.5, (k / width) as f64 + 0.5);
            let (c, ..) = self.sample(camera, at, time);
            *pixel = [c[0] as f32, c[1] as f32, c[2] as f32, 1.0];
        });
        image
    }

    /// What a renderer hands over: RGBA, derivatives per LR pixel, distances, motion from `before` to `camera`.
    fn render(self, camera: &Camera, before: &Camera, jitter: [f32; 2], time: f64) -> Buffers {
        let (lr, lr_before) = (camera.low_resolution(SCALE), before.low_resolution(SCALE));
        let size = [lr.width() as usize, lr.height() as usize];
        let mut buffers = Buffers { size, jitter, ..Buffers::default() };
        let offset = DVec2::from(jitter.map(f64::from)) + 0.5;
        for k in 0..size[0] * size[1] {
            let at = DVec2::new((k % size[0]) as f64, (k / size[0]) as f64) + offset;
            let (c, z, moved) = self.sample(&lr, at, time);
            buffers.rgba.extend(c.map(|v| v as f32).into_iter().chain([1.0]));
            buffers.depth.push(z as f32);
            // Derivatives of the visible surface, by differences much finer than its texture.
            let slope = |step: DVec2| {
                let texel = |side: f64| {
                    let origin = lr.position();
                    let direction = lr.unproject(at + step * side, 1.0) - origin;
                    let plane = if moved == DVec3::ZERO && z > DISC + 1.0 - origin.z { WALL } else { DISC };
                    let hit = (origin + direction * ((plane - origin.z) / direction.z)).truncate();
                    if plane == WALL { texture(hit, 0.0) } else { texture(hit - self.center(time), 5.0) }
                };
                let (a, b) = (texel(-1.0), texel(1.0));
                [0, 1, 2].map(|c| ((b[c] - a[c]) / (2.0 * step.length())) as f32)
            };
            buffers.dx.extend(slope(DVec2::new(1e-3, 0.0)));
            buffers.dy.extend(slope(DVec2::new(0.0, 1e-3)));
            let (was, _) = lr_before.project(lr.unproject(at, z) - moved);
            buffers.motion.extend((was - at).to_array().map(|v| v as f32));
        }
        buffers
    }
}

#[derive(Clone, Default)]
struct Buffers {
    size: [usize; 2],
    jitter: [f32; 2],
    rgba: Vec<f32>,
    dx: Vec<f32>,
    dy: Vec<f32>,
    depth: Vec<f32>,
    motion: Vec<f32>,
}

impl Buffers {
    fn view(&self) -> GBufferView<'_> {
        let color = PlanesView::interleaved(&self.rgba, self.size, 4).unwrap();
        let depth = PlanesView::planar(&self.depth, self.size).unwrap();
        let slopes = [&self.dx, &self.dy].map(|data| PlanesView::interleaved(data, self.size, 3).unwrap());
        GBufferView { gradients: Some(slopes), ..GBufferView::new(color, depth, self.jitter) }
    }
}

/// At x, looking along z.
fn camera(x: f64) -> Camera {
    let intrinsics = Intrinsics::from_fov_y(SIZE[0], SIZE[1], 0.6);
    Camera::new(DAffine3::from_translation(DVec3::new(-x, 0.0, 0.0)), intrinsics).unwrap()
}

fn psnr(a: &Image, b: &Image) -> f64 {
    let pairs = a.pixels().iter().zip(b.pixels());
    let squares = pairs.flat_map(|(a, b)| (0..3).map(|c| f64::from(a[c] - b[c]).powi(2)));
    let mse = squares.sum::<f64>() / (3 * a.pixels().len()) as f64;
    -10.0 * mse.max(1e-12).log10()
}

#[test]
fn a_resting_camera_becomes_native_with_exact_derivatives_and_without() {
    let (world, now) = (World { speed: 0.0 }, camera(0.0));
    let native = world.native(&now, 0.0);
    for has_derivatives in [true, false] {
        let mut reconstructor = Reconstructor::new(ReconstructorSettings::default()).unwrap();
        let mut quality = Vec::new();
        for _ in 0..16 {
            let buffers = world.render(&now, &now, reconstructor.next_jitter(&now), 0.0);
            let view = buffers.view();
            let gradients = view.gradients.filter(|_| has_derivatives);
            let shown = reconstructor.reconstruct(&now, &GBufferView { gradients, ..view }).unwrap();
            quality.push(psnr(shown.current, &native));
        }
        // The kriging-free mean leaves a millionth of a neighbour's error at each pixel.
        assert!(quality[15] > 80.0 && quality[0] < 45.0, "derivatives {has_derivatives}: {quality:.1?}");
    }
}

#[test]
fn buffers_are_read_however_they_lie_and_whatever_their_depths_mean() {
    let world = World { speed: 0.0 };
    let [mut plain, mut other] =
        [0, 1].map(|_| Reconstructor::new(ReconstructorSettings::default()).unwrap());
    for k in 0..4 {
        let now = camera(0.01 * f64::from(k));
        let buffers = world.render(&now, &now, plain.next_jitter(&now), 0.0);
        let [width, height] = buffers.size;
        // Planes, bottom padding of rows, reversed depth.
        let row = width + 3;
        let mut planar = vec![f32::NAN; 3 * row * height];
        for (k, pixel) in buffers.rgba.chunks_exact(4).enumerate() {
            for c in 0..3 {
                planar[(c * height + k / width) * row + k % width] = pixel[c];
            }
        }
        let strides = Strides { row, pixel: 1, channel: row * height };
        let near = 0.125;
        let reversed: Vec<f32> = buffers.depth.iter().map(|z| near / z).collect();
        let view = GBufferView {
            color: PlanesView::new(&planar, buffers.size, strides).unwrap(),
            depth: PlanesView::planar(&reversed, buffers.size).unwrap(),
            encoding: DepthEncoding::Reversed { near, far: f32::INFINITY },
            ..buffers.view()
        };
        let a = plain.reconstruct(&now, &buffers.view()).unwrap().current.clone();
        let b = other.reconstruct(&now, &view).unwrap();
        // Depths round otherwise.
        assert!(psnr(&a, b.current) > 90.0, "frame {k}: {} dB", psnr(&a, b.current));
    }
}

#[test]
fn a_frame_that_is_refused_leaves_the_history_as_it_was() {
    let world = World { speed: 0.0 };
    let run = |refuses: bool| {
        let mut reconstructor = Reconstructor::new(ReconstructorSettings::default()).unwrap();
        let mut shown = Image::default();
        for k in 0..4 {
            let now = camera(0.01 * f64::from(k));
            let buffers = world.render(&now, &now, reconstructor.next_jitter(&now), 0.0);
            if refuses {
                let mut bad = buffers.clone();
                bad.rgba[40] = f32::NAN;
                let error = reconstructor.reconstruct(&now, &bad.view()).unwrap_err();
                assert_eq!(error, ReconstructError::NotFinite { what: "G-buffer colour" });
                let small = camera(0.0).resized(64, 64).unwrap();
                let error = reconstructor.reconstruct(&small, &buffers.view()).unwrap_err();
                assert!(matches!(error, ReconstructError::Size { .. }), "{error}");
                let error =
                    reconstructor.reconstruct_with_poses(&now, &buffers.view(), &[now; 2]).unwrap_err();
                assert_eq!(error, ReconstructError::Poses { expected: 1, actual: 2 });
            }
            shown = reconstructor.reconstruct(&now, &buffers.view()).unwrap().current.clone();
        }
        shown
    };
    assert!(run(true) == run(false));
}

#[test]
fn gbuffers_of_our_own_are_views_too() {
    let now = camera(0.0);
    let gbuffer = GBuffer::zeroed(64, 40);
    let mut reconstructor = Reconstructor::new(ReconstructorSettings::default()).unwrap();
    let shown = reconstructor.reconstruct(&now, &GBufferView::of(&gbuffer).unwrap()).unwrap();
    assert!(shown.between.is_empty() && shown.current.pixels().iter().all(|pixel| pixel[..3] == [0.0; 3]));
    let error = GBufferView::of(&GBuffer { geometry: None, ..gbuffer }).map(|_| ()).unwrap_err();
    assert_eq!(error, ReconstructError::Missing { what: "depth" });
}
