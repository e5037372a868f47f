//! Times of the GPU rasterizer's stages on the demo scene or a file: `cargo run --release -p gs3-raster --example
//! gpu_speed
//! -- [SCENE [CAMERAS]] [--size WxH] [--color]`.

#![allow(clippy::unwrap_used, reason = "an example that measures")]

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use gs3_compute::{Gpu, GpuSettings, Timings};
use gs3_raster::{
    Culling, GpuGBuffer, GpuRasterizer, Outputs, RasterSettings, ScenePrecision, matched_dilation,
};
use gs3_scene::format::LoadOptions;
use gs3_scene::{capture, demo, format};

fn main() {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let value = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1));
    let files: Vec<&String> = args.iter().take_while(|a| !a.starts_with("--")).collect();
    let size = value("--size").map_or((480, 270), |v| {
        let (w, h) = v.split_once('x').unwrap();
        (w.parse().unwrap(), h.parse().unwrap())
    });
    let is_color = args.iter().any(|a| a == "--color");
    let scene = match files.first() {
        Some(file) => format::load(Path::new(file), &LoadOptions::default(), &|_| ()).unwrap(),
        None => demo::scene().unwrap(),
    };
    let path = match files.get(1) {
        Some(file) => capture::load(Path::new(file)).unwrap(),
        None => demo::path(),
    };
    let camera = path.cameras()[0].resized(size.0, size.1).unwrap();
    let settings = RasterSettings {
        outputs: if is_color { Outputs::Color } else { Outputs::GBuffer },
        dilation: if is_color { 0.3 } else { matched_dilation(4) },
        ..RasterSettings::new(Outputs::Color)
    };
    let gpu = Gpu::new(&GpuSettings::default()).unwrap();
    println!("{} ({}), {}x{}", gpu.adapter().name, gpu.adapter().kind, size.0, size.1);
    let started = Instant::now();
    let mut rasterizer =
        GpuRasterizer::new(&gpu, Arc::new(scene), Culling::AccuTile, ScenePrecision::F16).unwrap();
    println!("scene and kernels: {:.2?}", started.elapsed());
    let started = Instant::now();
    let mut gbuffer = GpuGBuffer::default();
    rasterizer.rasterize(&camera, &settings, &mut gbuffer).unwrap();
    println!("first frame: {:.2?}", started.elapsed());
    let mut timings = Timings::new(&gpu).unwrap();
    for _ in 0..3 {
        let started = Instant::now();
        let mut recorder = gpu.recorder(Some(&mut timings));
        rasterizer.record(&mut recorder, &camera, &settings, &mut gbuffer).unwrap();
        let submission = recorder.submit().unwrap();
        let times = timings.read(&gpu, &submission).unwrap();
        let stages: Vec<String> = times.iter().map(|t| format!("{} {:.2?}", t.stage, t.time)).collect();
        println!("frame: {:.2?}: {}", started.elapsed(), stages.join(", "));
    }
    println!("{:?}", rasterizer.check_capacity().unwrap());
}
