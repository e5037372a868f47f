//! Times the learning-free reconstruction on a trained scene and a camera path, ×4: median milliseconds of super
//! sampling with a full history, without and with kriging, and of interpolation, over frames that were rasterized
//! before.
//!
//! `cargo run --release -p gs3-reconstruct --example speed -- SCENE PATH [WIDTHxHEIGHT] [FRAMES]`

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use gs3_raster::{Culling, Outputs, RasterSettings, Rasterizer, matched_dilation};
use gs3_reconstruct::{DepthView, Interpolator, Kriging, Motion, Neighbor, SuperSampler, Warped};
use gs3_scene::{Camera, GBuffer, Image, capture, format, jitter::Jitter};

const SCALE: u32 = 4;

/// Milliseconds that `work` takes.
fn time<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let start = Instant::now();
    let result = work();
    (result, 1e3 * start.elapsed().as_secs_f64())
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [scene, path, rest @ ..] = arguments.as_slice() else {
        return Err("usage: speed SCENE PATH [WIDTHxHEIGHT] [FRAMES]".into());
    };
    let size = rest.first().map_or("1920x1080", String::as_str);
    let (width, height) = size.split_once('x').ok_or("expected a size such as 1920x1080")?;
    let path = capture::load(Path::new(path))?.resized(width.parse()?, height.parse()?)?;
    let frames: usize = rest.get(1).map_or(Ok(20), |frames| frames.parse())?;
    let scene = format::load(Path::new(scene), &format::LoadOptions::default(), &|_| {})?;
    let mut rasterizer = Rasterizer::new(Arc::new(scene), Culling::default());

    let jitter = Jitter::grid(SCALE);
    let history = jitter.period();
    let mut rendered: Vec<(Camera, GBuffer)> = Vec::new();
    for k in 0..history + frames {
        let camera = path.at(k as f64);
        let (dilation, jitter) = (matched_dilation(SCALE), jitter.offset(k as u64));
        let settings = RasterSettings { dilation, jitter, ..RasterSettings::new(Outputs::GBuffer) };
        let mut gbuffer = GBuffer::default();
        rasterizer.rasterize(&camera.low_resolution(SCALE), &settings, &mut gbuffer)?;
        rendered.push((camera, gbuffer));
    }

    let (mut sampler, mut kriging) =
        (SuperSampler::new(SCALE, Kriging::Off)?, SuperSampler::new(SCALE, Kriging::On)?);
    let mut interpolator = Interpolator::new(SCALE)?;
    let (mut motion, mut warped) = (Motion::default(), Warped::default());
    let [mut previous, mut current, mut kriged, mut between] = [(); 4].map(|()| Image::default());
    let mut times = [(); 5].map(|()| Vec::new());
    for k in 0..rendered.len() {
        let (camera, gbuffer) = &rendered[k];
        std::mem::swap(&mut previous, &mut current);
        let (result, super_sampling) = time(|| sampler.super_sample(camera, gbuffer, &mut current));
        result?;
        let (result, with_kriging) = time(|| kriging.super_sample(camera, gbuffer, &mut kriged));
        result?;
        if k < history {
            continue;
        }
        let (camera_before, gbuffer_before) = &rendered[k - 1];
        let from =
            Neighbor { camera: camera_before, image: &previous, gbuffer: gbuffer_before, gradients: None };
        let to = Neighbor { camera, image: &current, gbuffer, gradients: None };
        let middle = path.at(k as f64 - 0.5);
        let (result, interpolation) = time(|| interpolator.interpolate(from, to, 0.5, &middle, &mut between));
        result?;
        let (result, warping) = time(|| interpolator.warp(from, to, 0.5, &middle, &mut warped));
        result?;
        let now = DepthView::of_gbuffer(gbuffer, camera, SCALE)?;
        let before = DepthView::of_gbuffer(gbuffer_before, camera_before, SCALE)?;
        let (result, moving) = time(|| motion.set(&now, &before));
        result?;
        let all = [super_sampling, with_kriging, interpolation, warping, moving];
        for (times, time) in times.iter_mut().zip(all) {
            times.push(time);
        }
    }
    let best = times.each_ref().map(|times| times.iter().copied().fold(f64::INFINITY, f64::min));
    println!("best {best:.2?}");
    let medians = times.map(|mut times| {
        times.sort_by(f64::total_cmp);
        times.get(times.len() / 2).copied().unwrap_or(f64::NAN)
    });
    let [super_sampling, with_kriging, interpolation, warping, moving] = medians;
    println!(
        "super sampling {super_sampling:.1} ms, with kriging {with_kriging:.1} ms, interpolation {interpolation:.1} ms, warp {warping:.1} ms, motion {moving:.2} ms"
    );
    Ok(())
}
