//! The protocol: which frames are judged, against what, how they are timed.
//!
//! Ground truth is the scene rasterized at full size by the same rasterizer with exact tile culling, at the poses of
//! rendered frames and at the true poses of the frames that methods show between them. Every method runs over the same
//! cameras, after warming up; scores are taken outside the timed stages. Native rendering runs beside it, frame by frame,
//! so that speed-ups compare what was measured at the same time. Finished methods are kept in the output folder, so a run
//! that was interrupted resumes.

mod cache;
mod ground_truth;
mod judge;
mod machine;
mod moment;
mod paper;
mod results;
mod timeline;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use gs3::Culling;
use gs3_scene::camera_path::CameraPath;
use gs3_scene::{CameraError, Scene, Size};

use crate::digest;
use crate::methods::{MethodError, MethodSettings, MethodSpec, build, check_weights};
use crate::metrics::MetricError;
pub(crate) use cache::{Cache, part_of};
use ground_truth::GroundTruth;
pub(crate) use judge::crop;
pub use judge::{Crop, FrameScore, MethodScore, PSNR_CAP};
use judge::{Judged, judge};
pub use machine::MachineReport;
pub use moment::Moment;
use moment::PER_RENDERED;
pub use paper::{Absent, Paper, PaperResults, PaperRow, Table};
pub use results::{Failure, ProtocolFacts, ResultRow, Results, StageStatistics, Subset, TruthFacts};
pub use timeline::Case;
use timeline::Timeline;

/// What to evaluate.
#[derive(Clone, Debug)]
pub struct Protocol {
    /// The scene.
    pub scene: Arc<Scene>,
    /// Its name in reports.
    pub scene_name: String,
    /// The scene that ground truth shows: the same one, or the full one where `scene` is a simplification of it.
    pub reference: Arc<Scene>,
    /// The cameras.
    pub path: CameraPath,
    /// Their name in reports.
    pub path_name: String,
    /// Rendered frames of the path, first and one past the last.
    pub frames: std::ops::Range<usize>,
    /// How the camera moves over them.
    pub case: Case,
    /// The size of displayed frames.
    pub size: Size,
    /// HR over LR size.
    pub scale: u32,
    /// Methods to compare; native rendering is always among them.
    pub methods: Vec<MethodSpec>,
    /// Which tiles a splat is assigned to.
    pub culling: Culling,
    /// The same of native rendering of [`Self::reference`], which runs beside every method.
    pub beside: Culling,
    /// Background, display-encoded RGB, finite.
    pub background: [f32; 3],
    /// Rendered frames that every method runs, untimed and unjudged, before it starts.
    pub warm_up_frames: usize,
    /// Folder with weights, as [`MethodSettings::weights`].
    pub weights: Option<PathBuf>,
    /// Whether ColorVideoVDP judges, too. It looks at all frames of a method at once, in memory.
    pub jod: bool,
    /// The command that was given, for the report.
    pub command: String,
}

/// Why nothing was evaluated.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EvaluateError {
    /// The frame range is not part of the path.
    #[error("frames: expected a range within 0..{available} with at least 3 frames, found {}..{}", .actual.start, .actual.end)]
    Frames {
        /// Number of frames of the path.
        available: usize,
        /// The range found.
        actual: std::ops::Range<usize>,
    },
    /// The size cannot be divided by the scale.
    #[error("size: expected sides divisible by the scale {scale}, found {actual}")]
    Size {
        /// The scale.
        scale: u32,
        /// The size found.
        actual: Size,
    },
    /// The scale is not supported.
    #[error("scale: expected 2 to {}, found {actual}", gs3_reconstruct::MAX_SCALE)]
    Scale {
        /// The scale found.
        actual: u32,
    },
    /// The cameras cannot take the size.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The ground truth cannot be rendered.
    #[error("ground truth: {0}")]
    GroundTruth(#[from] gs3_raster::RasterError),
    /// A file of the output folder cannot be read or written.
    #[error("{}: {source}", .path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What went wrong.
        source: std::io::Error,
    },
    /// Images do not compare; a method gave one of another size.
    #[error(transparent)]
    Metric(#[from] MetricError),
    /// A method failed.
    #[error(transparent)]
    Method(#[from] MethodError),
}

/// Something that happened, for those who watch.
#[derive(Clone, Copy, Debug)]
pub enum Event<'a> {
    /// Ground-truth frame `done` of `total` is there.
    GroundTruth {
        /// Frames so far.
        done: usize,
        /// All frames.
        total: usize,
    },
    /// Photos of a capture have no file; the others are judged.
    PhotosMissing {
        /// Their names, at least one.
        names: &'a [String],
    },
    /// Rendered frame `done` of `total` of a method is judged.
    Method {
        /// The method.
        method: MethodSpec,
        /// Frames so far.
        done: usize,
        /// All frames.
        total: usize,
    },
    /// A method is finished already, from a run before.
    Resumed {
        /// The method.
        method: MethodSpec,
    },
    /// A method failed; the others go on.
    Failed {
        /// The method, and why.
        failure: &'a Failure,
    },
}

/// Poses that methods may fit to: enough for a map of a few hundred weights, few enough to render quickly.
const TRAINING_FRAMES: usize = 4;

impl Protocol {
    /// Runs the evaluation; `folder` keeps what is finished.
    ///
    /// # Errors
    /// [`EvaluateError`] if the protocol makes no sense, weights are missing, the ground truth cannot be made, or a
    /// file cannot be written. A method that fails is listed in the results.
    pub fn run(&self, folder: &Path, watch: &mut dyn FnMut(Event<'_>)) -> Result<Results, EvaluateError> {
        self.check()?;
        let timeline = Timeline::new(&self.path, self.frames.clone(), self.case, self.size)?;
        let cache = Cache::new(folder, &self.key())?;
        let mut truth = GroundTruth::new(self, &timeline, cache.folder());
        let methods = MethodSpec::with_native(&self.methods);
        let mut scores = Vec::new();
        for spec in &methods {
            let part = part_of(*spec, self.scale, self.weights.as_deref())?;
            let score = cache.load::<MethodScore>(&part)?;
            scores.push((*spec, part, score));
        }
        let unfinished = scores.iter().filter(|(.., score)| score.is_none());
        let moments: BTreeSet<Moment> =
            unfinished.flat_map(|(spec, ..)| timeline.moments(spec.in_between())).collect();
        for (k, moment) in moments.iter().enumerate() {
            truth.ensure(*moment)?;
            watch(Event::GroundTruth { done: k + 1, total: moments.len() });
        }
        let mut facts = Vec::new();
        for count in methods.iter().map(|spec| spec.in_between()).collect::<BTreeSet<_>>() {
            let part = format!("ground_truth-{count}");
            facts.push(match cache.load(&part)? {
                Some(facts) => facts,
                None => cache.store(&part, truth.facts(count)?)?,
            });
        }
        let settings = MethodSettings {
            scene: Arc::clone(&self.scene),
            scale: self.scale,
            culling: self.culling,
            background: self.background,
            weights: self.weights.clone(),
            training: timeline.outside(&self.path, self.frames.clone(), self.size, TRAINING_FRAMES)?,
        };
        let (scene, culling) = (Arc::clone(&self.reference), self.beside);
        let mut beside = build(MethodSpec::NATIVE, &MethodSettings { scene, culling, ..settings.clone() })?;
        let (mut finished, mut failures) = (Vec::new(), Vec::new());
        for (spec, part, score) in scores {
            if let Some(score) = score {
                watch(Event::Resumed { method: spec });
                finished.push((spec, score));
                continue;
            }
            let mut progress = |done| watch(Event::Method { method: spec, done, total: timeline.rendered() });
            let judged = build(spec, &settings).map_err(EvaluateError::from).and_then(|mut method| {
                let rate =
                    self.jod.then(|| self.path.frames_per_second() * spec.displayed_per_rendered() as f64);
                let (in_between, beside) = (spec.in_between(), beside.as_mut());
                let methods = Judged { method: method.as_mut(), in_between, beside };
                judge(methods, &timeline, &mut truth, self.warm_up_frames, rate, &mut progress)
            });
            match judged {
                Ok(score) => finished.push((spec, cache.store(&part, score)?)),
                Err(error) => {
                    let failure = Failure::of(spec, &error);
                    watch(Event::Failed { failure: &failure });
                    failures.push(failure);
                }
            }
        }
        truth.remove_frames()?;
        Ok(Results::new(self, &timeline, facts, finished, failures))
    }

    fn check(&self) -> Result<(), EvaluateError> {
        let (available, actual) = (self.path.cameras().len(), self.frames.clone());
        // Flicker looks at three frames in a row.
        if actual.end > available || actual.len() < 3 {
            return Err(EvaluateError::Frames { available, actual });
        }
        if !(2..=gs3_reconstruct::MAX_SCALE).contains(&self.scale) {
            return Err(EvaluateError::Scale { actual: self.scale });
        }
        if !self.size.to_array().iter().all(|side| side.is_multiple_of(self.scale)) {
            return Err(EvaluateError::Size { scale: self.scale, actual: self.size });
        }
        Ok(check_weights(&self.methods, self.scale, self.weights.as_deref())?)
    }

    /// Everything that results depend on but the methods and what they read, which [`part_of`] tells apart: results of
    /// another key are not resumed.
    fn key(&self) -> String {
        let Self {
            scene_name,
            path_name,
            frames,
            case,
            size,
            scale,
            culling,
            beside,
            background,
            warm_up_frames,
            jod,
            ..
        } = self;
        let [scene, reference] = [&self.scene, &self.reference].map(|scene| digest::of_scene(scene));
        // All cameras: those between the frames and before them count, too, and others are what methods fit to.
        let path = digest::of(&format!("{:?}", self.path));
        let Size { width, height } = size;
        format!(
            "gs3-evaluate {} {scene_name} {scene:016x} {reference:016x} {path_name} {path:016x} {frames:?} {case:?} \
             ({width}, {height}) x{scale} {culling:?} {beside:?} {background:?} {warm_up_frames} jod {jod} \
             moments 1/{PER_RENDERED} {} threads",
            env!("CARGO_PKG_VERSION"),
            rayon::current_num_threads()
        )
    }
}
