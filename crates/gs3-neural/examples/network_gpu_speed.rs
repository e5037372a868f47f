//! Times of both networks on a GPU:
//! `cargo run --release -p gs3-neural --example network_gpu_speed [WIDTH HEIGHT]` (LR pixels).

use std::time::Instant;

use gs3_compute::{Buffer, Gpu, GpuSettings, OptionalFeatures, Slice, Timings, Use};
use gs3_neural::model::{Tier, interpolate, super_sample};
use gs3_neural::{
    GpuEngine, GpuEngineSettings, GpuRunError, GpuTensorImage, Graph, Header, ImageFormat, MatrixUnit,
    Precision, Weights,
};

/// Frames before the measured ones, and those.
const FRAMES: [usize; 2] = [3, 7];

fn main() -> Result<(), GpuRunError> {
    let mut sides = std::env::args().skip(1).filter_map(|side| side.parse().ok());
    let (width, height) = (sides.next().unwrap_or(480), sides.next().unwrap_or(270));
    let gpu = Gpu::new(&GpuSettings { features: OptionalFeatures::Experimental, ..GpuSettings::default() })?;
    println!("{}, LR {width}×{height}", gpu.adapter().name);
    let mut ways = vec![GpuEngineSettings::new(Precision::Single)];
    if Precision::of(&gpu) == Precision::Half {
        let half = GpuEngineSettings::new(Precision::Half);
        ways.push(half);
        if let Some(unit) = MatrixUnit::of(gpu.capabilities()) {
            match unit.check(&gpu) {
                Ok(()) => ways.push(GpuEngineSettings { matrices: Some(unit), ..half }),
                Err(error) => println!("without products of matrices: {error}"),
            }
        }
    }
    for tier in Tier::ALL {
        for graph in [super_sample(4, tier)?, interpolate(4, tier)?] {
            for way in &ways {
                measure(&gpu, &graph, tier, [height, width], way)?;
            }
        }
    }
    Ok(())
}

fn measure(
    gpu: &Gpu,
    graph: &Graph,
    tier: Tier,
    lr: [usize; 2],
    way: &GpuEngineSettings<'_>,
) -> Result<(), GpuRunError> {
    let weights = Weights::random(graph, Header { tier: tier.name().to_owned(), ..Header::of(graph, 4) }, 1);
    let state = ("hidden", ImageFormat::Blocks);
    let outputs = [("color", ImageFormat::Pixels), state];
    let settings = GpuEngineSettings { inputs: &[state], outputs: Some(&outputs), ..*way };
    let start = Instant::now();
    let engine = GpuEngine::new(gpu, graph, &weights, lr, &settings)?;
    let compiled = start.elapsed();
    let buffers = |images: &[GpuTensorImage]| {
        let buffers = images
            .iter()
            .map(|image| Ok((image.name.clone(), gpu.buffer(&image.name, Use::Storage, image.bytes)?)));
        buffers.collect::<Result<Vec<(String, Buffer)>, GpuRunError>>()
    };
    let (from, to) = (buffers(engine.inputs())?, buffers(engine.outputs())?);
    let bound = engine.bind(gpu, &by_name(&from), &by_name(&to))?;
    let mut timings = Timings::new(gpu)?;
    let mut milliseconds = Vec::new();
    for frame in 0..FRAMES.iter().sum() {
        let mut recorder = gpu.recorder(Some(&mut timings));
        recorder.stage("network");
        bound.record(&mut recorder);
        let submission = recorder.submit()?;
        let time: std::time::Duration = timings.read(gpu, &submission)?.iter().map(|t| t.time).sum();
        if frame >= FRAMES[0] {
            milliseconds.push(1e3 * time.as_secs_f64());
        }
    }
    milliseconds.sort_by(f64::total_cmp);
    let median = milliseconds[milliseconds.len() / 2];
    let work = 2.0 * graph.multiply_adds_per_pixel(lr)? * (lr[0] * lr[1]) as f64;
    println!(
        "{} {} {:?}{}: {median:.3} ms, {:.1} GFLOP/s; {} kernels move {} MB, {:.1} GB/s; {} MB of tensors; compiled in \
         {:.1} s",
        graph.name(),
        weights.header.tier,
        way.precision,
        if way.matrices.is_some() { ", products of matrices" } else { "" },
        work / median / 1e6,
        engine.kernels(),
        engine.bytes_moved() / 1_000_000,
        engine.bytes_moved() as f64 / median / 1e6,
        engine.arena_bytes() / 1_000_000,
        compiled.as_secs_f64(),
    );
    Ok(())
}

fn by_name(buffers: &[(String, Buffer)]) -> Vec<(&str, Slice<'_>)> {
    buffers.iter().map(|(name, buffer)| (name.as_str(), buffer.slice())).collect()
}
