//! Measures the learning-free reconstruction on a trained scene and a camera path: PSNR against the native render of
//! bicubic and Hermite interpolation (no jitter), super sampling with history (grid jitter) and interpolated frames,
//! the same for a resting camera, and times. ×4 to 1920×1080.
//!
//! `cargo run --release -p gs3-reconstruct --example quality -- SCENE PATH [FRAMES]`

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use gs3_raster::{Culling, Outputs, RasterSettings, Rasterizer, matched_dilation};
use gs3_reconstruct::{Interpolator, Kriging, Neighbor, ResampleKernel, SuperSampler, hermite, resample};
use gs3_scene::{Camera, CameraPath, GBuffer, Image, capture, format, jitter::Jitter};
use gs3_test_support::psnr_shown;

const SCALE: u32 = 4;

struct Measurement {
    rasterizer: Rasterizer,
    path: CameraPath,
}

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

impl Measurement {
    fn native(&mut self, camera: &Camera) -> Outcome<Image> {
        let mut image = Image::default();
        self.rasterizer.rasterize_image(camera, &RasterSettings::new(Outputs::Color), &mut image)?;
        Ok(image)
    }

    fn gbuffer(&mut self, camera: &Camera, jitter: [f32; 2]) -> Outcome<GBuffer> {
        let dilation = matched_dilation(SCALE);
        let settings = RasterSettings { dilation, jitter, ..RasterSettings::new(Outputs::GBuffer) };
        let mut gbuffer = GBuffer::default();
        self.rasterizer.rasterize(&camera.low_resolution(SCALE), &settings, &mut gbuffer)?;
        Ok(gbuffer)
    }

    /// Prints mean PSNR and best times of the first `frames` frames.
    fn in_motion(&mut self, frames: u64) -> Outcome<()> {
        let jitter = Jitter::grid(SCALE);
        let mut sampler = SuperSampler::new(SCALE, Kriging::Off)?;
        let mut interpolator = Interpolator::new(SCALE)?;
        let size = (self.path.at(0.0).width() as usize, self.path.at(0.0).height() as usize);
        let [mut single, mut current, mut middle] = [(); 3].map(|()| Image::new(size.0, size.1));
        let mut before: Option<(Camera, Image, GBuffer)> = None;
        let (mut sums, mut best) = ([0.0; 4], [f64::INFINITY; 2]);
        for k in 0..frames {
            let camera = self.path.at(k as f64);
            let native = self.native(&camera)?;
            let centred = self.gbuffer(&camera, [0.0; 2])?;
            resample(&centred, SCALE, ResampleKernel::Bicubic, &mut single)?;
            sums[0] += psnr_shown(&single, &native);
            hermite(&centred, SCALE, &mut single)?;
            sums[1] += psnr_shown(&single, &native);
            let gbuffer = self.gbuffer(&camera, jitter.offset(k))?;
            let start = Instant::now();
            sampler.super_sample(&camera, &gbuffer, &mut current)?;
            if k >= jitter.period() as u64 {
                best[0] = start.elapsed().as_secs_f64().min(best[0]);
            }
            sums[2] += psnr_shown(&current, &native);
            if let Some((camera_before, image, gbuffer_before)) = &before {
                let camera_between = self.path.at(k as f64 - 0.5);
                let from = Neighbor { camera: camera_before, image, gbuffer: gbuffer_before };
                let to = Neighbor { camera: &camera, image: &current, gbuffer: &gbuffer };
                let start = Instant::now();
                interpolator.interpolate(from, to, 0.5, &camera_between, &mut middle)?;
                best[1] = start.elapsed().as_secs_f64().min(best[1]);
                let native = self.native(&camera_between)?;
                sums[3] += psnr_shown(&middle, &native);
            }
            before = Some((camera, current.clone(), gbuffer));
        }
        let [bicubic, hermite, history] = [0, 1, 2].map(|i| sums[i] / frames as f64);
        let interpolated = sums[3] / (frames.max(2) - 1) as f64;
        let [super_sample, interpolate] = best.map(|seconds| 1e3 * seconds);
        println!(
            "bicubic {bicubic:.2} dB, Hermite {hermite:.2} dB, history {history:.2} dB, interpolated {interpolated:.2} dB"
        );
        println!("super sampling {super_sample:.1} ms, interpolation {interpolate:.1} ms");
        Ok(())
    }

    /// Prints the PSNR of a resting camera after one period of jitter.
    fn at_rest(&mut self) -> Outcome<()> {
        let jitter = Jitter::grid(SCALE);
        let camera = self.path.at(0.0);
        let mut sampler = SuperSampler::new(SCALE, Kriging::Off)?;
        let mut image = Image::default();
        for k in 0..jitter.period() as u64 {
            sampler.super_sample(&camera, &self.gbuffer(&camera, jitter.offset(k))?, &mut image)?;
        }
        println!(
            "at rest after {} frames: {:.1} dB",
            jitter.period(),
            psnr_shown(&image, &self.native(&camera)?)
        );
        Ok(())
    }
}

fn main() -> Outcome<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [scene, path, rest @ ..] = arguments.as_slice() else {
        return Err("usage: quality SCENE PATH [FRAMES]".into());
    };
    let frames = rest.first().map_or(Ok(30), |frames| frames.parse())?;
    let scene = format::load(Path::new(scene), &format::LoadOptions::default(), &|_| {})?;
    let path = capture::load(Path::new(path))?.resized(1920, 1080)?;
    let rasterizer = Rasterizer::new(Arc::new(scene), Culling::default());
    let mut measurement = Measurement { rasterizer, path };
    measurement.at_rest()?;
    measurement.in_motion(frames)
}
