//! A training from its beginning, or its last checkpoint, to its end.

use std::path::{Path, PathBuf};
use std::time::Instant;

use gs3_neural::Weights;

use crate::batch::ClipFolder;
use crate::checkpoint;
use crate::error::TrainError;
use crate::log::{Log, Row};
use crate::losses::Terms;
use crate::plot;
use crate::provenance::continued;
use crate::settings::{MAX_SECONDS, Settings};
use crate::state::{Best, State};
use crate::trainer::{TrainStep, Trainer};
use crate::validate::{Validation, validate};

/// Where a training reads and writes, and how often.
#[derive(Clone, Debug, PartialEq)]
pub struct Places {
    /// Clips, `*.clip`; clips with names that begin with `held` are kept for validation.
    pub clips: PathBuf,
    /// Checkpoints, `log.csv` and `log.png`.
    pub checkpoint: PathBuf,
    /// Weights: the best on held-out clips; without such clips the last average. See [`Settings::kept`].
    pub out: PathBuf,
    /// Steps between two rows of the log.
    pub log_every: u64,
    /// Steps between two validations.
    pub validate_every: u64,
    /// Seconds between two checkpoints.
    pub save_every: f64,
}

impl Places {
    /// Whether all numbers are in range.
    ///
    /// # Errors
    /// [`TrainError::Setting`] naming the first that is not.
    pub fn check(&self) -> Result<(), TrainError> {
        if (0.0..=MAX_SECONDS).contains(&self.save_every) {
            return Ok(());
        }
        let (expected, actual) = (format!("0 to {MAX_SECONDS} seconds"), self.save_every.to_string());
        Err(TrainError::Setting { name: "time between checkpoints", expected, actual })
    }
}

/// What happens during a training.
#[derive(Clone, Copy, Debug)]
pub enum TrainEvent<'a> {
    /// It goes on from the checkpoint of a step.
    Resumed {
        /// The step.
        step: u64,
        /// Seconds of training until then.
        seconds: f64,
    },
    /// The record of the best average was of other held-out clips, and was measured again on these; without held-out
    /// clips there is no record any more.
    Remeasured {
        /// The record's step.
        step: u64,
        /// Its gain on the other clips in dB.
        before: f64,
        /// That on these.
        gain: Option<f64>,
    },
    /// A step was made.
    Step {
        /// What it did.
        step: &'a TrainStep,
        /// Seconds of training.
        seconds: f64,
        /// Share of the training that is done, `[0, 1]`.
        progress: f64,
        /// Floating-point operations of its convolutions.
        operations: f64,
    },
    /// The average was looked at on held-out clips.
    Validated {
        /// Steps made.
        step: u64,
        /// Its gains.
        validation: &'a Validation,
        /// Whether no average was better.
        is_best: bool,
    },
}

/// How a training ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// After its length.
    Finished,
    /// Because it was asked to; it can be taken up again.
    Interrupted,
}

/// Trains from the last checkpoint, or from `start` where there is none, until the end or until `go_on` says no; a step
/// is always finished, and all is saved then.
///
/// # Errors
/// [`TrainError`] if settings, clips or weights do not fit, a file cannot be read or written, or the loss diverges.
pub fn train(
    settings: Settings,
    places: &Places,
    start: Weights,
    report: &mut dyn FnMut(TrainEvent<'_>),
    go_on: &dyn Fn() -> bool,
) -> Result<(State, Ending), TrainError> {
    settings.check()?;
    places.check()?;
    let clips = ClipFolder::open(&places.clips, &settings)?;
    let file = |source| TrainError::File { path: places.checkpoint.clone(), source };
    std::fs::create_dir_all(&places.checkpoint).map_err(file)?;
    let state = resume(&places.checkpoint, &start)?;
    let (first, seconds) = (state.steps(), state.seconds);
    if first > 0 {
        report(TrainEvent::Resumed { step: first, seconds });
    }
    let mut session = Session {
        log: Log::open(&places.checkpoint.join("log.csv"), first)?,
        operations: 0.0,
        trainer: Trainer::new(settings, state)?,
        start,
        clips,
        places,
        held: 0,
        since: Means::default(),
        saved: seconds,
    };
    session.held = session.clips.digest()?;
    session.check_record(report)?;
    session.operations = session.trainer.operations()?;
    let ending = session.run(report, go_on)?;
    Ok((session.trainer.state, ending))
}

/// The last checkpoint in `folder`, or the state before the first step with `start`. What weights come from is what
/// `start` says besides what they came from before.
fn resume(folder: &Path, start: &Weights) -> Result<State, TrainError> {
    let Some(mut state) = checkpoint::load(folder)? else { return Ok(State::new(start.clone())) };
    let (found, wanted) = (&state.weights.header, &start.header);
    let fields = [
        ("network", &found.network, &wanted.network),
        ("tier", &found.tier, &wanted.tier),
        ("scale", &found.scale.to_string(), &wanted.scale.to_string()),
    ];
    if let Some((field, actual, expected)) = fields.into_iter().find(|(_, found, wanted)| found != wanted) {
        let (expected, actual) = (expected.clone(), actual.clone());
        return Err(TrainError::Checkpoint { path: folder.to_owned(), field, expected, actual });
    }
    let best = state.best.as_mut().map(|best| &mut best.weights);
    for weights in [&mut state.weights, &mut state.average].into_iter().chain(best) {
        weights.header = continued(start.header.clone(), &weights.header);
    }
    Ok(state)
}

struct Session<'a> {
    trainer: Trainer,
    /// The weights that the training began with.
    start: Weights,
    clips: ClipFolder,
    places: &'a Places,
    log: Log,
    operations: f64,
    /// Digest of the held-out clips.
    held: u64,
    /// What steps did since the last row of the log.
    since: Means,
    /// Seconds of training at the last checkpoint.
    saved: f64,
}

/// Sums over steps.
#[derive(Clone, Copy, Debug, Default)]
struct Means {
    count: u64,
    terms: Terms,
    loss: f64,
    gradient: f64,
}

impl Session<'_> {
    fn run(
        &mut self,
        report: &mut dyn FnMut(TrainEvent<'_>),
        go_on: &dyn Fn() -> bool,
    ) -> Result<Ending, TrainError> {
        if self.trainer.state.steps() == 0 {
            // What it begins with is the first record: nothing worse is written.
            self.validate(report)?;
        }
        // Training alone counts, not time between its parts.
        let (started, before) = (Instant::now(), self.trainer.state.seconds);
        let ending = loop {
            let progress = self.progress();
            if progress >= 1.0 {
                break Ending::Finished;
            }
            if !go_on() {
                break Ending::Interrupted;
            }
            let step = self.trainer.step(&self.clips.train, progress)?;
            let seconds = before + started.elapsed().as_secs_f64();
            self.trainer.state.seconds = seconds;
            self.since.add(&step);
            let (progress, operations) = (self.progress(), self.operations);
            report(TrainEvent::Step { step: &step, seconds, progress, operations });
            let is_due = |every: u64| step.step.is_multiple_of(every.max(1)) || progress >= 1.0;
            let gains = if is_due(self.places.validate_every) { self.validate(report)? } else { None };
            if is_due(self.places.log_every) || gains.is_some() {
                self.write_row(&step, gains)?;
            }
            if seconds - self.saved >= self.places.save_every {
                self.save()?;
            }
        };
        self.save()?;
        Ok(ending)
    }

    /// Measures the record again if it is one of other clips.
    fn check_record(&mut self, report: &mut dyn FnMut(TrainEvent<'_>)) -> Result<(), TrainError> {
        let Some(record) = self.trainer.state.best.take_if(|best| best.held != self.held) else {
            return Ok(());
        };
        let (subject, graph) = (self.trainer.settings().subject, self.trainer.graph());
        let gain = validate(subject, graph, &record.weights, &self.clips.held)?.mean.map(|[gain, _]| gain);
        report(TrainEvent::Remeasured { step: record.step, before: record.gain, gain });
        self.trainer.state.best = gain.map(|gain| Best { gain, held: self.held, ..record });
        Ok(())
    }

    fn progress(&self) -> f64 {
        let State { seconds, .. } = self.trainer.state;
        self.trainer.settings().length.progress(self.trainer.state.steps(), seconds)
    }

    /// Looks at the average on held-out clips, and keeps it if none was better.
    fn validate(&mut self, report: &mut dyn FnMut(TrainEvent<'_>)) -> Result<Option<[f64; 2]>, TrainError> {
        let average = self.trainer.result(&self.start);
        let subject = self.trainer.settings().subject;
        let validation = validate(subject, self.trainer.graph(), &average, &self.clips.held)?;
        let Some([gain, _]) = validation.mean else { return Ok(None) };
        let step = self.trainer.state.steps();
        let best = &mut self.trainer.state.best;
        let is_best = best.as_ref().is_none_or(|best| gain > best.gain);
        if is_best {
            *best = Some(Best { weights: average, step, gain, held: self.held });
        }
        report(TrainEvent::Validated { step, validation: &validation, is_best });
        Ok(validation.mean)
    }

    fn write_row(&mut self, step: &TrainStep, gains: Option<[f64; 2]>) -> Result<(), TrainError> {
        let means = std::mem::take(&mut self.since).means();
        self.log.add(Row {
            step: step.step,
            seconds: self.trainer.state.seconds,
            rate: f64::from(step.rate),
            loss: means.loss,
            terms: means.terms,
            gradient: means.gradient,
            gains,
        })
    }

    fn save(&mut self) -> Result<(), TrainError> {
        let best = self.trainer.state.best.as_ref().map(|best| best.weights.clone());
        checkpoint::save_weights(
            &self.places.out,
            &best.unwrap_or_else(|| self.trainer.result(&self.start)),
        )?;
        checkpoint::save(&self.places.checkpoint, &self.trainer.state)?;
        plot::draw(&self.places.checkpoint.join("log.png"), self.log.rows())?;
        self.saved = self.trainer.state.seconds;
        Ok(())
    }
}

impl Means {
    fn add(&mut self, step: &TrainStep) {
        self.count += 1;
        self.terms += step.terms;
        self.loss += step.loss;
        self.gradient += step.gradient;
    }

    fn means(mut self) -> Self {
        let count = self.count.max(1) as f64;
        self.terms /= count;
        Self { loss: self.loss / count, gradient: self.gradient / count, ..self }
    }
}
