//! `gs3 bench --backend gpu`: the stages of native frames, low-resolution G-buffers and whole frames by the device's
//! clock, frames per second where each follows the other and no image is read back, the sort alone, and what the device
//! can do at most.

use std::fmt::Write;
use std::sync::Arc;
use std::time::{Duration, Instant};

use gs3::compute::{AdapterKind, Ceilings, Gpu, Pairs, Sort, StageTime, Timings, Use};
use gs3::raster::{
    CapacityCheck, GpuGBuffer, GpuRasterizer, KERBL_DILATION, Outputs, RasterSettings, ScenePrecision,
};
use gs3::scene::{Camera, Scene};
use gs3::{FramePipeline, Mode, Networks, PipelineSettings, ResetReason};
use serde_json::{Value, json};

use super::args::BenchArgs;
use crate::cli::error::CliError;
use crate::io::inputs;
use crate::io::report::{self, median_ms};

/// Pairs sorted at a time: enough to fill any GPU. An emulated one shows only that it works.
const SORTED: u32 = 1 << 24;
const SORTED_IN_SOFTWARE: u32 = 1 << 16;

/// Runs of the sort after as many to warm up.
const SORT_RUNS: usize = 20;

/// Its figures.
pub fn run(args: &BenchArgs, gpu: &Gpu, scene: Arc<Scene>, cameras: &[Camera]) -> Result<Value, CliError> {
    let (networks, _) = inputs::networks(&args.frame_options)?;
    let look = args.frame_options.settings(Mode::Full);
    let gaussians = scene.gaussians().len();
    let with = |outputs, dilation| RasterSettings {
        dilation,
        background: look.background,
        ..RasterSettings::new(outputs)
    };
    // All frames have the scale of the first one: `lr_settings` have one dilation.
    let scale = look.scale.with(&networks).at(cameras[0].size());
    let low: Vec<Camera> = cameras.iter().map(|camera| camera.low_resolution(scale)).collect();
    let (native, lr_gbuffer) = {
        let mut bench = RasterBench {
            timings: Timings::new(gpu)?,
            rasterizer: GpuRasterizer::new(gpu, Arc::clone(&scene), look.culling, ScenePrecision::default())?,
            gbuffer: GpuGBuffer::default(),
            warm_up: args.warm_up,
        };
        let native = bench.measure(cameras, &with(Outputs::Color, KERBL_DILATION))?;
        let lr_settings = with(Outputs::GBuffer, look.dilation.at_scale(scale));
        (native, bench.measure(&low, &lr_settings)?)
        // Here its scene leaves the device: each pipeline brings its own.
    };
    let frames = |mode| {
        let settings = args.frame_options.settings(mode);
        measure_frames(gpu, &scene, &settings, &networks, cameras, args.warm_up)
    };
    let [super_sample, full] = [frames(Mode::SuperSample)?, frames(Mode::Full)?];
    Ok(json!({
        "driver": gpu.adapter().driver,
        "matrix_products": args.frame_options.matrix_products,
        "scene": args.view.scene.display().to_string(),
        "gaussians": gaussians,
        "copies": args.copies,
        "size": cameras[0].size().to_array(),
        "scale": scale,
        "warm_up_frames": args.warm_up,
        "native": native,
        "lr_gbuffer": lr_gbuffer,
        "displayed_fps": {
            "native": native["fps"], "super_sample": super_sample["fps"], "full": full["fps"],
        },
        "super_sample_network": networks.super_sample.as_ref().map(|weights| weights.header.tier.clone()),
        "interpolation_network": networks.interpolate.as_ref().map(|weights| weights.header.tier.clone()),
        "super_sample": super_sample,
        "full": full,
        "sort": sort(gpu)?,
        "ceilings": ceilings(gpu)?,
    }))
}

struct RasterBench {
    timings: Timings,
    rasterizer: GpuRasterizer,
    gbuffer: GpuGBuffer,
    warm_up: usize,
}

impl RasterBench {
    /// Times of the frames seen by `cameras`, each on its own, and frames per second where each follows the other.
    fn measure(&mut self, cameras: &[Camera], settings: &RasterSettings) -> Result<Value, CliError> {
        for camera in cameras.iter().cycle().take(self.warm_up) {
            self.rasterizer.rasterize(camera, settings, &mut self.gbuffer)?;
        }
        let gpu = self.rasterizer.gpu().clone();
        let mut frames = Vec::with_capacity(cameras.len());
        let (mut most_splats, mut most_entries) = (0, 0);
        for camera in cameras {
            loop {
                let mut recorder = gpu.recorder(Some(&mut self.timings));
                self.rasterizer.record(&mut recorder, camera, settings, &mut self.gbuffer)?;
                let submission = recorder.submit()?;
                let times = self.timings.read(&gpu, &submission)?;
                // A frame that lacked room is no measurement.
                if let CapacityCheck::Sufficient { splats, entries } = self.rasterizer.check_capacity()? {
                    (most_splats, most_entries) = (most_splats.max(splats), most_entries.max(entries));
                    frames.push(times);
                    break;
                }
            }
        }
        // Nothing is read back of these, so whether all of them had room shows at their end; the room that one lacked
        // is there for all when they are made again.
        let fps = loop {
            let started = Instant::now();
            let mut last = None;
            for camera in cameras {
                let mut recorder = gpu.recorder(None);
                self.rasterizer.record(&mut recorder, camera, settings, &mut self.gbuffer)?;
                last = Some(recorder.submit()?);
            }
            if let Some(last) = last {
                gpu.wait(&last)?;
            }
            let elapsed = started.elapsed();
            if let CapacityCheck::Sufficient { .. } = self.rasterizer.check_capacity()? {
                break cameras.len() as f64 / elapsed.as_secs_f64();
            }
        };
        Ok(json!({
            "fps": fps, "most_splats": most_splats, "most_entries": most_entries, "stages": stages(&frames),
        }))
    }
}

/// Times of whole frames along `cameras`, as [`FramePipeline`] makes them: of each stage where a frame is waited for, and
/// displayed frames per second, those between included, where one follows the other. The frames before the measured ones
/// lead up to the first, so that no camera is a cut; those that follow each other are the same frames once more, from
/// the first that leads up to them on.
fn measure_frames(
    gpu: &Gpu,
    scene: &Arc<Scene>,
    settings: &PipelineSettings,
    networks: &Networks,
    cameras: &[Camera],
    warm_up: usize,
) -> Result<Value, CliError> {
    let mut pipeline = FramePipeline::with_networks(Arc::clone(scene), *settings, networks)?;
    pipeline.render_on(gpu)?;
    if let Some(odd) = cameras.iter().find(|camera| !pipeline.is_on_device(camera)) {
        return Err(CliError::Option {
            option: "--size",
            expected: "a multiple of the scale, as networks on a GPU need, or --tier analytic".into(),
            actual: odd.size().to_string(),
        });
    }
    let walk = || {
        let ahead = (1..=warm_up).rev().map(|k| &cameras[reflected(k, cameras.len())]);
        ahead.chain(cameras).enumerate()
    };
    let mut measured = Vec::with_capacity(cameras.len());
    for (k, camera) in walk() {
        pipeline.render_to_device(camera, &[])?;
        if k >= warm_up {
            measured.push(pipeline.device_times().to_vec());
        }
    }
    // The CPU waits for none of these frames but the one before the last, so an overflow only shows later.
    let fps = loop {
        pipeline.reset(ResetReason::CameraCut);
        let (mut started, mut displayed, mut is_complete) = (Instant::now(), 0, true);
        for (k, camera) in walk() {
            if k == warm_up {
                is_complete = pipeline.wait_for_device()?;
                (started, displayed) = (Instant::now(), 0);
            }
            displayed += pipeline.submit_to_device(camera, &[])?.in_between.len() + 1;
        }
        is_complete &= pipeline.wait_for_device()?;
        if is_complete {
            break displayed as f64 / started.elapsed().as_secs_f64();
        }
    };
    Ok(json!({ "fps": fps, "stages": stages(&measured) }))
}

/// Place `k` of a walk to and fro over `count` places.
fn reflected(k: usize, count: usize) -> usize {
    let turn = count.saturating_sub(1);
    match k % (2 * turn).max(1) {
        k if k <= turn => k,
        k => 2 * turn - k,
    }
}

/// Of each stage, in the order in which they run, and of all together: from the start of a frame's first kernel to the
/// end of its last.
fn stages(frames: &[Vec<StageTime>]) -> Value {
    let names = frames.first().into_iter().flatten().map(|time| time.stage);
    let of = |stage: &str, times| report::join(json!({ "stage": stage }), distribution(times));
    let each = names.map(|name| {
        let times = frames.iter().flatten().filter(|time| time.stage == name);
        of(name, times.map(|time| time.time).collect())
    });
    let all = frames.iter().map(|frame| frame.iter().map(|time| time.time).sum()).collect();
    each.chain([of("all", all)]).collect()
}

/// Median and 99th percentile (nearest rank) in milliseconds.
fn distribution(mut times: Vec<Duration>) -> Value {
    times.sort_unstable();
    let rank = (times.len() * 99).div_ceil(100).max(1) - 1;
    let p99 = times.get(rank).map(|time| time.as_secs_f64() * 1e3);
    json!({ "median_ms": median_ms(times), "p99_ms": p99 })
}

/// Pairs of a 32-bit key and a 32-bit value.
fn sort(gpu: &Gpu) -> Result<Value, CliError> {
    let count = match gpu.adapter().kind {
        AdapterKind::Software => SORTED_IN_SOFTWARE,
        _ => SORTED,
    };
    let keys: Vec<u32> = (0..count).map(|k| k.wrapping_mul(2_654_435_769).rotate_left(7)).collect();
    let length = gpu.buffer_with("count", Use::Storage, &[count])?;
    let unsorted = gpu.buffer_with("unsorted", Use::Storage, &keys)?;
    let empty = |_| gpu.buffer("pairs", Use::Storage, u64::from(count) * 4);
    let halves = [0; 4].map(empty).into_iter().collect::<Result<Vec<_>, _>>()?;
    let half = |k: usize| Pairs { keys: halves[k].slice(), values: halves[k + 1].slice() };
    let pairs = [half(0), half(2)];
    let bound = Sort::new(gpu, count, u32::BITS)?.bind(gpu, length.slice(), pairs)?;
    let mut timings = Timings::new(gpu)?;
    let mut times = Vec::with_capacity(SORT_RUNS);
    for run in 0..2 * SORT_RUNS {
        let mut recorder = gpu.recorder(Some(&mut timings));
        // What is sorted already would be sorted sooner.
        recorder.copy(&unsorted.slice(), &halves[0].slice());
        recorder.stage("sort");
        bound.record(&mut recorder);
        let submission = recorder.submit()?;
        let time = timings.read(gpu, &submission)?.iter().map(|time| time.time).sum::<Duration>();
        if run >= SORT_RUNS {
            times.push(time);
        }
    }
    let keys_per_s = median_ms(times.clone()).map(|ms| f64::from(count) / ms * 1e3);
    let figures = json!({ "pairs": count, "key_bits": u32::BITS, "keys_per_s": keys_per_s });
    Ok(report::join(figures, distribution(times)))
}

/// What the device can do at most, beside which the stages' bytes and operations are their floors.
fn ceilings(gpu: &Gpu) -> Result<Value, CliError> {
    let Ceilings { copy_bytes_per_s, f32_flop_per_s, f16_flop_per_s } = Ceilings::measure(gpu)?;
    Ok(json!({
        "copy_gb_per_s": copy_bytes_per_s / 1e9,
        "f32_tflop_per_s": f32_flop_per_s / 1e12,
        "f16_tflop_per_s": f16_flop_per_s.map(|rate| rate / 1e12),
    }))
}

/// What [`run`] gave, for people.
pub fn text(figures: &Value) -> String {
    let mut text = String::new();
    let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
    for side in ["native", "lr_gbuffer", "super_sample", "full"] {
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "{side:<12} {:8.2} fps, median and 99th percentile:",
            number(&figures[side]["fps"])
        );
        for times in figures[side]["stages"].as_array().into_iter().flatten() {
            let stage = times["stage"].as_str().unwrap_or_default();
            let [median, p99] = ["median_ms", "p99_ms"].map(|field| number(&times[field]));
            let _ = writeln!(text, "  {stage:<20} {median:9.3} {p99:9.3} ms");
        }
    }
    let sort = &figures["sort"];
    let rate = number(&sort["keys_per_s"]) / 1e6;
    let _ = writeln!(text, "sort of {} 32-bit keys with values: {rate:.1} million keys/s", sort["pairs"]);
    let ceilings = &figures["ceilings"];
    let [copy, single] = ["copy_gb_per_s", "f32_tflop_per_s"].map(|field| number(&ceilings[field]));
    let half = ceilings["f16_tflop_per_s"].as_f64().map_or("none".to_owned(), |half| format!("{half:.3}"));
    let _ = writeln!(
        text,
        "ceilings: copies {copy:.1} GB/s read and written, multiply-adds {single:.3} TFLOP/s in f32, {half} in f16"
    );
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_walk_to_and_fro_never_jumps() {
        for count in [1, 2, 5] {
            let walk: Vec<usize> = (0..20).map(|k| reflected(k, count)).collect();
            assert!(walk[0] == 0 && walk.iter().all(|k| *k < count), "{walk:?}");
            assert!(walk.windows(2).all(|w| w[0].abs_diff(w[1]) == usize::from(count > 1)), "{walk:?}");
        }
    }

    #[test]
    fn stages_are_told_in_their_order_and_summed_frame_by_frame() {
        let frame = |project: u64, blend: u64| {
            let stage = |stage, ms| StageTime { stage, time: Duration::from_millis(ms) };
            vec![stage("project", project), stage("blend", blend)]
        };
        let stage =
            |name: &str, median: f64, p99: f64| json!({ "stage": name, "median_ms": median, "p99_ms": p99 });
        assert_eq!(
            stages(&[frame(1, 9), frame(2, 3), frame(3, 6)]),
            json!([stage("project", 2.0, 3.0), stage("blend", 6.0, 9.0), stage("all", 9.0, 10.0)])
        );
        // Of 200 frames two may be slower.
        let with_slow =
            |slow: usize| -> Vec<_> { (0..200).map(|k| frame(if k < slow { 50 } else { 1 }, 1)).collect() };
        assert_eq!(stages(&with_slow(2))[0], stage("project", 1.0, 1.0));
        assert_eq!(stages(&with_slow(3))[0], stage("project", 1.0, 50.0));
    }
}
