//! What a run found: `results.json`.

use gs3::Stage;
use serde::{Deserialize, Serialize};

use super::judge::{MethodScore, PSNR_CAP};
use super::machine::MachineReport;
use super::moment::Moment;
use super::timeline::Timeline;
use super::{EvaluateError, Protocol};
use crate::methods::{Formation, MethodSpec, Spatial};
use crate::metrics::blocks::BLOCK;
use crate::metrics::edges::{DEPTH_STEP, EDGE_REACH};
use crate::metrics::flip::DEFAULT_PIXELS_PER_DEGREE;

/// Which of the displayed frames a figure is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Subset {
    /// Frames that were rendered.
    SuperSampled,
    /// Frames between them.
    Interpolated,
    /// All frames that the method displays.
    All,
}

impl Subset {
    /// All subsets, in order.
    pub const EACH: [Self; 3] = [Self::SuperSampled, Self::Interpolated, Self::All];

    /// The subset of the frame displayed at `moment`, beside [`Self::All`].
    #[must_use]
    pub const fn of(moment: Moment) -> Self {
        if moment.is_rendered() { Self::SuperSampled } else { Self::Interpolated }
    }

    /// The subset's name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::SuperSampled => "super_sampled",
            Self::Interpolated => "interpolated",
            Self::All => "all",
        }
    }

    const fn holds(self, moment: Moment) -> bool {
        matches!(self, Self::All) || self as usize == Self::of(moment) as usize
    }
}

/// Facts of the ground truth of all frames that some methods display.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TruthFacts {
    /// Frames that these methods show between two rendered ones.
    pub in_between: u32,
    /// Mean warping error of the ground truth itself from frame to frame.
    pub warping_error: Option<f64>,
    /// Median motion from frame to frame, in pixels; mean over the frames.
    pub motion_px: Option<f64>,
    /// Share of the pixels that edge PSNR looks at, in `[0, 1]`; mean over the frames.
    pub edge_share: Option<f64>,
}

/// Median and 99th percentile of a duration, in milliseconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StageStatistics {
    /// Median.
    pub median_ms: f64,
    /// 99th percentile.
    pub p99_ms: f64,
}

impl StageStatistics {
    /// None of no values.
    fn of(mut values: Vec<f64>) -> Option<Self> {
        values.sort_by(f64::total_cmp);
        let at = |share: f64| values.get((share * (values.len() as f64 - 1.0)).round() as usize).copied();
        Some(Self { median_ms: at(0.5)?, p99_ms: at(0.99)? })
    }
}

/// One method on one subset of its frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ResultRow {
    /// The method.
    pub method: String,
    /// Which of its frames.
    pub subset: Subset,
    /// Frames that the method shows between two rendered ones.
    pub in_between: u32,
    /// Mean PSNR in dB.
    pub psnr: f64,
    /// Mean SSIM.
    pub ssim: f64,
    /// Mean ꟻLIP.
    pub flip: f64,
    /// Mean PSNR in dB near depth discontinuities, of frames that have some.
    pub edge_psnr: Option<f64>,
    /// Mean over the frames of the 99th percentile of the RMSE of 8×8 blocks, in `[0, 255]`.
    pub block_rmse_p99: f64,
    /// Mean PSNR of frame differences in dB.
    pub tpsnr: Option<f64>,
    /// Mean warping error; the ground truth's own, with as many frames between, stands in the protocol's facts.
    pub warping_error: Option<f64>,
    /// Mean flicker.
    pub flicker: Option<f64>,
    /// ColorVideoVDP in JOD, of all frames together, where it was asked for.
    pub jod: Option<f64>,
    /// Frames displayed per second, by the time of the median rendered frame. None for methods with LR frames that
    /// need the native image.
    pub displayed_fps: Option<f64>,
    /// [`Self::displayed_fps`] over native rendering's, each against native rendering measured beside it.
    pub speedup_over_native: Option<f64>,
    /// How the LR frames came about; none for native rendering.
    pub lr_formation: Option<String>,
    /// Whether the LR frames were jittered.
    pub lr_jitter: bool,
    /// Mean share of the pixels of a rendered frame that were rasterized exactly beside the LR frame, in `[0, 1]`; none
    /// for methods that rasterize none so.
    pub refined_share: Option<f64>,
    /// Number of frames.
    pub frames: usize,
    /// Rasterizing a frame.
    pub rasterize: Option<StageStatistics>,
    /// Super-sampling it.
    pub super_sample: Option<StageStatistics>,
    /// Exact pixels.
    pub refine: Option<StageStatistics>,
    /// Making the frames between it and the one before.
    pub interpolate: Option<StageStatistics>,
    /// All of it, per rendered frame.
    pub total: Option<StageStatistics>,
}

/// A method that failed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Failure {
    /// The method.
    pub method: String,
    /// Why, without the method's name.
    pub error: String,
}

impl Failure {
    /// That `method` failed with `error`.
    pub(crate) fn of(method: MethodSpec, error: &EvaluateError) -> Self {
        let (method, error) = (method.to_string(), error.to_string());
        // Errors of weights name their method, because they are also reported where no method runs yet.
        let error = error.strip_prefix(&format!("{method}: ")).map(str::to_owned).unwrap_or(error);
        Self { method, error }
    }
}

impl std::fmt::Display for Failure {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {}", self.method, self.error)
    }
}

/// The protocol's own facts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ProtocolFacts {
    /// Name of the scene.
    pub scene: String,
    /// Number of its Gaussians.
    pub gaussians: usize,
    /// Degree of its spherical harmonics.
    pub sh_degree: u8,
    /// Name of the path.
    pub path: String,
    /// How the camera moves: `path`, `rest` or `cut`.
    pub case: String,
    /// First rendered frame of the path, and one past the last.
    pub frames: [usize; 2],
    /// Rendered frames.
    pub rendered_frames: usize,
    /// Width and height of displayed frames.
    pub size: [u32; 2],
    /// HR over LR size.
    pub scale: u32,
    /// Tile culling.
    pub culling: String,
    /// Background colour.
    pub background: [f32; 3],
    /// Rendered frames run before the timed ones.
    pub warm_up_frames: usize,
    /// What the ground truth is.
    pub ground_truth: String,
    /// Its facts, by the number of frames that methods show between two rendered ones, rendered frames alone first.
    pub truth: Vec<TruthFacts>,
    /// How figures are defined.
    pub conventions: Vec<String>,
    /// The machine.
    pub machine: MachineReport,
    /// Version of gs3.
    pub version: String,
    /// The command.
    pub command: String,
}

/// What a run found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Results {
    /// The protocol's facts.
    pub protocol: ProtocolFacts,
    /// One row per method and subset.
    pub results: Vec<ResultRow>,
    /// Methods that failed.
    pub failures: Vec<Failure>,
    /// Frames that each method displays while native rendering beside it shows one.
    #[serde(skip)]
    pub(super) speeds: Vec<(String, Option<f64>)>,
    /// All scores by method, for plots.
    #[serde(skip)]
    pub scores: Vec<(String, MethodScore)>,
}

impl Results {
    pub(super) fn new(
        protocol: &Protocol,
        timeline: &Timeline,
        truth: Vec<TruthFacts>,
        scores: Vec<(MethodSpec, MethodScore)>,
        failures: Vec<Failure>,
    ) -> Self {
        let speeds = scores.iter().map(|(spec, score)| (spec.to_string(), speed(*spec, score))).collect();
        let native = (scores.iter().find(|(spec, _)| *spec == MethodSpec::NATIVE))
            .and_then(|(spec, score)| speed(*spec, score));
        let results = scores.iter().flat_map(|(spec, score)| rows(*spec, score, native)).collect();
        Self {
            protocol: facts(protocol, timeline, truth),
            results,
            failures,
            speeds,
            scores: scores.into_iter().map(|(spec, score)| (spec.to_string(), score)).collect(),
        }
    }

    /// The row of `method` and `subset`.
    #[must_use]
    pub fn row(&self, method: &str, subset: Subset) -> Option<&ResultRow> {
        self.results.iter().find(|row| row.method == method && row.subset == subset)
    }
}

/// The time of each rendered frame, where all of its stages have one.
fn totals(spec: MethodSpec, score: &MethodScore) -> Option<StageStatistics> {
    let all = score.stage_ms.iter().map(|stages| stages.iter().flatten().sum());
    (spec.formation != Formation::Antialiased).then(|| StageStatistics::of(all.collect()))?
}

fn displayed_fps(spec: MethodSpec, score: &MethodScore) -> Option<f64> {
    Some(spec.displayed_per_rendered() as f64 * 1e3 / totals(spec, score)?.median_ms)
}

/// Frames that the method displays while native rendering beside it shows one.
fn speed(spec: MethodSpec, score: &MethodScore) -> Option<f64> {
    let beside = StageStatistics::of(score.native_ms.clone())?;
    Some(displayed_fps(spec, score)? * beside.median_ms / 1e3)
}

fn rows(spec: MethodSpec, score: &MethodScore, native: Option<f64>) -> Vec<ResultRow> {
    let mean =
        |values: &[f64]| (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64);
    let stage = |s: Stage| {
        StageStatistics::of(score.stage_ms.iter().filter_map(|stages| stages[s as usize]).collect())
    };
    let (fps, speed) = (displayed_fps(spec, score), speed(spec, score));
    let row = |subset: Subset| {
        let frames: Vec<_> = score.frames.iter().filter(|f| subset.holds(f.moment)).collect();
        let mean_of = |value: &dyn Fn(usize) -> f64| mean(&(0..frames.len()).map(value).collect::<Vec<_>>());
        let index = subset as usize;
        Some(ResultRow {
            method: spec.to_string(),
            subset,
            in_between: spec.in_between(),
            psnr: mean_of(&|i| frames[i].psnr)?,
            ssim: mean_of(&|i| frames[i].ssim)?,
            flip: mean_of(&|i| frames[i].flip)?,
            edge_psnr: mean(&frames.iter().filter_map(|f| f.edge_psnr).collect::<Vec<_>>()),
            block_rmse_p99: mean_of(&|i| frames[i].block_rmse_p99)?,
            tpsnr: mean(&score.tpsnr[index]),
            warping_error: mean(&score.warping_error[index]),
            flicker: mean(&score.flicker[index]),
            jod: score.jod.filter(|_| subset == Subset::All),
            displayed_fps: fps,
            speedup_over_native: speed.zip(native).map(|(speed, native)| speed / native),
            lr_formation: (spec.spatial != Spatial::Native).then(|| spec.formation.name().to_owned()),
            lr_jitter: spec.spatial.is_jittered(),
            refined_share: mean(&score.refined_share),
            frames: frames.len(),
            rasterize: stage(Stage::Rasterize),
            super_sample: stage(Stage::SuperSample),
            refine: stage(Stage::Refine),
            interpolate: stage(Stage::Interpolate),
            total: totals(spec, score),
        })
    };
    Subset::EACH.into_iter().filter_map(row).collect()
}

fn facts(protocol: &Protocol, timeline: &Timeline, truth: Vec<TruthFacts>) -> ProtocolFacts {
    let gaussians = protocol.scene.gaussians();
    ProtocolFacts {
        scene: protocol.scene_name.clone(),
        gaussians: gaussians.len(),
        sh_degree: gaussians.sh_degree,
        path: protocol.path_name.clone(),
        case: protocol.case.name().into(),
        frames: [protocol.frames.start, protocol.frames.end],
        rendered_frames: timeline.rendered(),
        size: protocol.size.to_array(),
        scale: protocol.scale,
        culling: format!("{:?}", protocol.culling),
        background: protocol.background,
        warm_up_frames: protocol.warm_up_frames,
        ground_truth: "the scene rasterized at full size by the same rasterizer, dilation 0.3 px², tile culling without loss (AccuTile), at the poses of \
                       rendered frames and at the true poses of the frames between"
            .into(),
        truth,
        conventions: vec![
            "All metrics judge values clamped to [0, 1], not rounded to 8 bits; the ground truth is kept at 16 bits.".into(),
            format!("PSNR: one mean squared error over all RGB of a frame, mean over frames, capped at {PSNR_CAP} dB."),
            "SSIM: 11×11 Gaussian, σ = 1.5, biased, borders cropped (scikit-image).".into(),
            format!("FLIP: LDR, {DEFAULT_PIXELS_PER_DEGREE:.2} pixels per degree, mean error."),
            format!(
                "Edge PSNR: PSNR of the pixels within {EDGE_REACH} columns and rows of two neighbours whose native median depths \
                 differ by more than {:.0} % of the nearer, or just one of which shows anything; mean over frames.",
                100.0 * DEPTH_STEP
            ),
            format!(
                "Block p99: the 99th percentile of the RMSE over RGB of the {BLOCK}×{BLOCK} blocks of a frame, of 255; mean over \
                 frames."
            ),
            "In-between frames are equally spaced in time. Where a method makes none, as at a cut, the frame before stays on.".into(),
            "tPSNR: PSNR of the differences of consecutive frames of the subset.".into(),
            "Warping error: mean squared RGB distance along exact motion, where visible in both frames.".into(),
            "Flicker: rms of the error's part that alternates from frame to frame.".into(),
            "In-between frames without rendered ones have no tPSNR, warping error and flicker if there is more than one before \
             each rendered frame: they are not equally spaced."
                .into(),
            "JOD: ColorVideoVDP of the middle 1280×720 pixels of all displayed frames, watched on a 30-inch 4K display from \
             0.75 m at the method's own displayed rate; 10 is no visible difference.".into(),
            "Methods with history start without one at the first frame: the first frames count as they are.".into(),
            "LR formation `matched`: rasterized at LR with dilation 0.3/S² (exact point samples of the native image); `kerbl`: \
             dilation 0.3; `antialiased`: the native image reduced by an antialiasing bicubic filter."
                .into(),
            "Displayed FPS: frames shown per rendered frame over its median time, all stages in sequence, the first frame \
             excluded; loading, metrics and encoding excluded."
                .into(),
            "Speed-ups: native rendering runs beside every method, frame by frame; its median time, and the method's, give the \
             ratio, so that what else the machine does slows both."
                .into(),
        ],
        machine: MachineReport::this(),
        version: env!("CARGO_PKG_VERSION").into(),
        command: protocol.command.clone(),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use super::*;
    use crate::protocol::FrameScore;

    #[test]
    fn speed_ups_compare_what_ran_at_the_same_time() {
        let score = |ms: f64, native_ms: f64| MethodScore {
            frames: vec![FrameScore {
                moment: Moment::rendered(0),
                psnr: 30.0,
                ssim: 0.9,
                flip: 0.1,
                edge_psnr: Some(25.0),
                block_rmse_p99: 20.0,
            }],
            stage_ms: vec![[Some(ms), None, None, None]; 3],
            native_ms: vec![native_ms; 3],
            ..MethodScore::default()
        };
        let native = speed(MethodSpec::NATIVE, &score(100.0, 100.0));
        // Twice as slow a machine while the method ran: it takes a quarter of native rendering's time, not half.
        let method: MethodSpec = "history+repeat".parse().unwrap();
        let row = |score| rows(method, score, native).pop().unwrap();
        let slow = row(&score(50.0, 200.0));
        assert_eq!(slow.speedup_over_native, Some(8.0), "two frames shown for a rendered one");
        assert_eq!(slow.displayed_fps, Some(40.0));
    }
}
