//! `gs3 train super-sample`, `gs3 train interpolate` and `gs3 train baseline`.

pub mod clips;

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::time::Duration;

use clap::{ArgGroup, Args, ValueEnum};
use gs3::neural::Weights;
use gs3::neural::model::{PublishedNetwork, Tier};
use gs3_train::losses::Term;
use gs3_train::{
    ClipFolder, Ending, Length, Network, Places, Settings, Symmetries, TrainEvent, TrainedNetwork, Trainer,
    continued, train,
};
use indicatif::{HumanDuration, ProgressBar};

use crate::cli::error::CliError;
use crate::cli::exit::Outcome;
use crate::cli::interrupt;
use crate::cli::terminal::{note, print};
use crate::cli::threads::start_threads;
use crate::io::destination::{self, Destination};
use crate::io::inputs;

/// How long steps are watched for the speed that is shown.
const WATCHED: Duration = Duration::from_secs(10);

/// Arguments of `gs3 train super-sample` and `gs3 train interpolate`.
#[derive(Debug, Args)]
pub struct TrainArgs {
    /// Size of the network
    #[arg(long, default_value = "balanced")]
    pub tier: NetworkTierArg,
    #[command(flatten)]
    pub session: SessionArgs,
}

/// Arguments of `gs3 train baseline`.
#[derive(Debug, Args)]
pub struct BaselineArgs {
    /// The published network: ECBSR-M4C16, RT4KSR or NinaSR-B1
    #[arg(long)]
    pub network: PublishedNetworkArg,
    #[command(flatten)]
    pub session: SessionArgs,
}

/// What all trainings take.
#[derive(Debug, Args)]
#[command(group = ArgGroup::new("length").required(true))]
pub struct SessionArgs {
    /// Folder of clips, as `gs3 train clips` writes them; clips with names that begin with `held` are for validation
    #[arg(long, value_name = "DIR")]
    pub clips: PathBuf,
    /// Folder for checkpoints and the log; if it has a checkpoint, the training goes on from there
    #[arg(long, value_name = "DIR")]
    pub checkpoint: PathBuf,
    /// Weights file to write: the best on held-out clips until then, what the training began with included
    #[arg(long, value_name = "FILE.safetensors")]
    pub out: PathBuf,
    /// High-resolution over low-resolution size
    #[arg(long, default_value_t = 4, value_name = "S")]
    pub scale: u32,
    /// Steps of the whole training
    #[arg(long, group = "length", value_name = "N")]
    pub steps: Option<u64>,
    /// Minutes of the whole training
    #[arg(long, group = "length", value_name = "M")]
    pub minutes: Option<f64>,
    /// Items (crops of clips) of a step, the batch size [default: 8; for baselines 32]
    #[arg(long, value_name = "N")]
    pub batch: Option<usize>,
    /// Consecutive frames of an item [default: 6; for baselines 1]
    #[arg(long, value_name = "T")]
    pub window: Option<usize>,
    /// Side of an item in low-resolution pixels
    #[arg(long, default_value_t = 64, value_name = "PIXELS")]
    pub crop: usize,
    /// How items are mirrored and turned at random
    #[arg(long, default_value = "all")]
    pub symmetries: SymmetriesArg,
    /// Highest learning rate
    #[arg(long, default_value_t = 1e-3, value_name = "RATE")]
    pub rate: f64,
    /// Steps of warm-up: the learning rate rises to --rate
    #[arg(long, default_value_t = 100, value_name = "N")]
    pub warm_up: u64,
    /// Decides the weights at the beginning and what every step is trained on
    #[arg(long, default_value_t = 0, value_name = "N")]
    pub seed: u64,
    /// Weights to begin with, of this tier or a smaller one, which is grown [default: random features that change
    /// nothing yet]
    #[arg(long, value_name = "FILE.safetensors")]
    pub init: Option<PathBuf>,
    /// Epsilon of Charbonnier's loss: smaller errors count by their squares, larger errors by their size
    #[arg(long, default_value_t = 1e-3, value_name = "EPSILON")]
    pub epsilon: f32,
    /// Weights of terms of the loss: charbonnier, laplacian, temporal, perceptual, warp, alpha [default: charbonnier=1;
    /// for super sampling laplacian=0.1 temporal=0.1; for interpolation perceptual=0.2 warp=0.05 alpha=0.001; perceptual counts
    /// with --perceptual only]
    #[arg(long, num_args = 1.., value_name = "TERM=WEIGHT", value_parser = parse_weight)]
    pub loss: Vec<(Term, f64)>,
    /// Weights of SqueezeNet v1.0, conv1 to fire5, for the perceptual term of the loss
    #[arg(long, value_name = "FILE.safetensors")]
    pub perceptual: Option<PathBuf>,
    /// Largest norm of the gradient with respect to all weights; longer gradients are shortened to it (clipping)
    #[arg(long, default_value_t = 1.0, value_name = "LENGTH")]
    pub longest_gradient: f64,
    /// Share of the weights to begin with in those that are validated and written, 0 to less than 1: trained on few
    /// scenes, they err less on others
    #[arg(long, default_value_t = 0.0, value_name = "SHARE")]
    pub keep: f64,
    /// Steps between two looks at held-out clips
    #[arg(long, default_value_t = 250, value_name = "N")]
    pub validate_every: u64,
    /// Steps between two rows of the log
    #[arg(long, default_value_t = 25, value_name = "N")]
    pub log_every: u64,
    /// Minutes between two checkpoints
    #[arg(long, default_value_t = 5.0, value_name = "M")]
    pub save_every: f64,
    /// What the weights are trained on, for their header [default: the scenes of the clips]
    #[arg(long, value_name = "TEXT")]
    pub training_data: Option<String>,
    /// Licence of the weights, for their header: an SPDX expression
    #[arg(long, default_value = "MIT OR Apache-2.0", value_name = "SPDX")]
    pub licence: String,
    /// Threads [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum NetworkTierArg {
    Fast,
    Balanced,
    High,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum PublishedNetworkArg {
    Ecbsr,
    Rt4ksr,
    Ninasr,
}

impl From<PublishedNetworkArg> for PublishedNetwork {
    fn from(peer: PublishedNetworkArg) -> Self {
        match peer {
            PublishedNetworkArg::Ecbsr => Self::Ecbsr,
            PublishedNetworkArg::Rt4ksr => Self::Rt4ksr,
            PublishedNetworkArg::Ninasr => Self::Ninasr,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum SymmetriesArg {
    /// Mirrored and turned at random
    All,
    /// As they were rendered
    None,
}

impl From<SymmetriesArg> for Symmetries {
    fn from(symmetries: SymmetriesArg) -> Self {
        match symmetries {
            SymmetriesArg::All => Self::All,
            SymmetriesArg::None => Self::None,
        }
    }
}

impl From<NetworkTierArg> for Tier {
    fn from(tier: NetworkTierArg) -> Self {
        match tier {
            NetworkTierArg::Fast => Self::Fast,
            NetworkTierArg::Balanced => Self::Balanced,
            NetworkTierArg::High => Self::High,
        }
    }
}

fn parse_weight(text: &str) -> Result<(Term, f64), String> {
    let found = text.split_once('=').and_then(|(name, weight)| {
        let term = Term::ALL.into_iter().find(|term| term.name() == name)?;
        Some((term, weight.parse().ok().filter(|w: &f64| w.is_finite() && *w >= 0.0)?))
    });
    let names = Term::ALL.map(Term::name).join("|");
    found.ok_or_else(|| format!("expected {names}=WEIGHT, at least 0, found {text}"))
}

/// Trains one of our networks.
pub fn run(network: Network, args: &TrainArgs) -> Result<Outcome, CliError> {
    train_network(TrainedNetwork::Own { network, tier: args.tier.into() }, &args.session)
}

/// Trains a published network.
pub fn run_baseline(args: &BaselineArgs) -> Result<Outcome, CliError> {
    train_network(TrainedNetwork::Published(args.network.into()), &args.session)
}

fn train_network(subject: TrainedNetwork, args: &SessionArgs) -> Result<Outcome, CliError> {
    start_threads(args.threads)?;
    interrupt::watch()?;
    let settings = settings(subject, args);
    let places = Places {
        clips: args.clips.clone(),
        checkpoint: args.checkpoint.clone(),
        out: args.out.clone(),
        log_every: args.log_every,
        validate_every: args.validate_every,
        save_every: 60.0 * args.save_every,
    };
    settings.check()?;
    places.check()?;
    check_perceptual(&settings)?;
    destination::check(
        &[
            Destination::folder("--checkpoint", &args.checkpoint),
            Destination::file("--out", &args.out, "safetensors"),
        ],
        args.init.as_deref().into_iter().chain(args.perceptual.as_deref()),
    )?;
    let training_data = match &args.training_data {
        Some(text) => text.clone(),
        None => scenes(&ClipFolder::open(&args.clips, &settings)?),
    };
    let header = Trainer::header(&settings, &training_data, &args.licence)?;
    let start = match &args.init {
        Some(file) => {
            let Weights { header: earlier, arrays } = Trainer::load(&settings, file)?;
            Weights { header: continued(header, &earlier), arrays }
        }
        None => Trainer::initial(&settings, header)?,
    };

    let mut show = Show::new(&settings);
    let (state, ending) =
        train(settings, &places, start, &mut |event| show.event(event), &|| !interrupt::requested())?;
    show.bar.finish_and_clear();
    match &state.best {
        Some(best) => print(format_args!(
            "best {:+.2} dB on held-out clips, of step {} of {}\n",
            best.gain,
            best.step,
            state.steps()
        ))?,
        None => print(format_args!("{} steps; no held-out clips\n", state.steps()))?,
    }
    Ok(match ending {
        Ending::Finished => Outcome::Done,
        Ending::Interrupted => {
            note("interrupted; all files are whole. To go on: the same command");
            Outcome::Interrupted
        }
    })
}

fn settings(subject: TrainedNetwork, args: &SessionArgs) -> Settings {
    let length = match (args.steps, args.minutes) {
        (Some(steps), _) => Length::Steps(steps),
        (None, minutes) => Length::Seconds(60.0 * minutes.unwrap_or_default()),
    };
    let mut settings = Settings::new(subject, args.scale, length);
    settings.batch = args.batch.unwrap_or(settings.batch);
    settings.window = args.window.unwrap_or(settings.window);
    settings.crop = args.crop;
    settings.symmetries = args.symmetries.into();
    settings.rate = args.rate;
    settings.warm_up = args.warm_up;
    settings.seed = args.seed;
    settings.loss.epsilon = args.epsilon;
    settings.perceptual.clone_from(&args.perceptual);
    settings.longest_gradient = args.longest_gradient;
    settings.kept = args.keep;
    for (term, weight) in &args.loss {
        settings.loss.weights.set(*term, *weight);
    }
    settings
}

/// Refuses the weights of a term that does not count.
fn check_perceptual(settings: &Settings) -> Result<(), CliError> {
    if settings.perceptual.is_none() || settings.loss.weights.get(Term::Perceptual) > 0.0 {
        return Ok(());
    }
    Err(CliError::Option {
        option: "--perceptual",
        expected: "--loss perceptual=WEIGHT above 0 with it".to_owned(),
        actual: "perceptual=0".to_owned(),
    })
}

/// The scenes that are trained on.
fn scenes(clips: &ClipFolder) -> String {
    let names: BTreeSet<&str> = clips.train.iter().map(|clip| clip.scene()).collect();
    names.into_iter().collect::<Vec<_>>().join(", ")
}

/// Seconds in words; `?` for those that are no time, such as what is left while the speed is not known.
fn duration(seconds: f64) -> String {
    Duration::try_from_secs_f64(seconds).map_or("?".to_owned(), |time| HumanDuration(time).to_string())
}

/// Shows what happens on the terminal.
struct Show {
    bar: ProgressBar,
    length: Length,
    /// Where the speed is measured from: step and seconds of training.
    since: Option<(u64, f64)>,
    speed: Option<f64>,
    loss: f64,
}

impl Show {
    fn new(settings: &Settings) -> Self {
        let bar = ProgressBar::new(1000).with_style(inputs::style("{wide_bar} {percent}% {msg}"));
        Self { bar, length: settings.length, since: None, speed: None, loss: 0.0 }
    }

    fn event(&mut self, event: TrainEvent<'_>) {
        match event {
            TrainEvent::Resumed { step, seconds } => {
                self.line(&format!("going on from step {step}, after {} of training", duration(seconds)));
            }
            TrainEvent::Remeasured { step, before, gain } => self.line(&match gain {
                Some(gain) => {
                    format!("other held-out clips: the best of step {step} gains {gain:+.2} dB on these, {before:+.2} on those before")
                }
                None => format!("no held-out clips any more: the best of step {step} is forgotten"),
            }),
            TrainEvent::Step { step, seconds, progress, operations } => {
                // A mean over some dozen steps.
                self.loss =
                    if self.loss == 0.0 { step.loss } else { self.loss + (step.loss - self.loss) / 32.0 };
                let (first, from) = *self.since.get_or_insert((step.step, seconds));
                if step.step > first && seconds - from >= 1.0 {
                    self.speed = Some((step.step - first) as f64 / (seconds - from));
                }
                if seconds - from > WATCHED.as_secs_f64() {
                    self.since = None;
                }
                let speed = self.speed.unwrap_or_default();
                let left = match self.length {
                    Length::Steps(steps) => (steps.saturating_sub(step.step)) as f64 / speed,
                    Length::Seconds(length) => length - seconds,
                };
                let left = duration(left.max(0.0));
                self.bar.set_position((progress * 1000.0) as u64);
                self.bar.set_message(format!(
                    "step {} loss {:.5} {speed:.2} steps/s {:.0} GFLOP/s {left} left",
                    step.step,
                    self.loss,
                    speed * operations / 1e9,
                ));
            }
            TrainEvent::Validated { step, validation, is_best } => {
                if let Some([psnr, tpsnr]) = validation.mean {
                    let best = if is_best { ", best so far" } else { "" };
                    let clips: Vec<String> = validation
                        .clips
                        .iter()
                        .map(|clip| format!("{} {:+.2}", clip.name, clip.psnr))
                        .collect();
                    let place = match step {
                        0 => "before the first step".to_owned(),
                        _ => format!("step {step}: loss {:.5}", self.loss),
                    };
                    self.line(&format!(
                        "{place}, held-out PSNR {psnr:+.3} dB, tPSNR {tpsnr:+.3} dB{best} ({})",
                        clips.join(", "),
                    ));
                    // The look itself is no step.
                    self.since = None;
                }
            }
        }
    }

    /// A line that stays.
    fn line(&self, text: &str) {
        self.bar.suspend(|| note(text));
    }
}
