//! How a training goes.

use std::path::PathBuf;

use crate::clip::Network;
use crate::error::TrainError;
use crate::losses::{Loss, Term, Terms};
use crate::trained_network::TrainedNetwork;

/// LR pixels at each side of a crop that losses do not see: there the network saw copies of the border.
pub const MARGIN: usize = 2;

/// The rate that the schedule ends with, a share of the highest: 1e-5 of the paper's 1e-3.
const LAST_RATE: f64 = 1e-2;

/// The longest time, in seconds: thirty years, more than any training takes, and few enough for what counts time.
pub(crate) const MAX_SECONDS: f64 = 1e9;

/// The most steps of a warm-up, thirty years of one a second.
const MAX_WARM_UP: u64 = 1_000_000_000;

/// ε of Charbonnier's loss. Below, ε² is no normal f32, and a derivative without error becomes 0 / 0. Above, the loss
/// of an error of 1 / 255, e² / 2ε, is less than ε · 2⁻²⁴, and so lost in √(e² + ε²) − ε.
const EPSILONS: std::ops::RangeInclusive<f32> = 1e-18..=10.0;

/// What is trained, on what, and how fast.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// The network.
    pub subject: TrainedNetwork,
    /// HR pixels per LR pixel along a side.
    pub scale: u32,
    /// Items of a step; their derivatives are averaged.
    pub batch: usize,
    /// Consecutive frames of an item, through which the hidden state is differentiated.
    pub window: usize,
    /// Side of an item in LR pixels.
    pub crop: usize,
    /// Decides what every step is trained on.
    pub seed: u64,
    /// Ways in which items are laid down.
    pub symmetries: Symmetries,
    /// What is lowered.
    pub loss: Loss,
    /// Weights of SqueezeNet v1.0 for the perceptual term, which is nothing without.
    pub perceptual: Option<PathBuf>,
    /// Highest learning rate.
    pub rate: f64,
    /// Steps over which the rate rises from 0.
    pub warm_up: u64,
    /// Longest derivative by all weights; longer ones are shortened to it.
    pub longest_gradient: f64,
    /// Share of the weights that training began with in those that are validated and written, `[0, 1)`: what was
    /// trained on few scenes then errs less on others (Wortsman et al. 2022, "Robust fine-tuning of zero-shot models").
    pub kept: f64,
    /// How long the training is.
    pub length: Length,
}

/// How items are laid down: networks see no difference between left and right, and eight times as many items.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Symmetries {
    /// As they were rendered.
    None,
    /// In any of the eight ways to lay a square down, at random.
    All,
}

/// The end of a training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Length {
    /// After so many steps.
    Steps(u64),
    /// After so many seconds of training, over all its parts.
    Seconds(f64),
}

impl Length {
    /// The share of the training that is done after `steps` in `seconds`, `[0, 1]`.
    #[must_use]
    pub fn progress(&self, steps: u64, seconds: f64) -> f64 {
        let share = match self {
            Self::Steps(length) => steps as f64 / *length as f64,
            Self::Seconds(length) => seconds / length,
        };
        share.clamp(0.0, 1.0)
    }
}

impl Settings {
    /// What a network is trained with unless something else is wanted.
    #[must_use]
    pub fn new(subject: TrainedNetwork, scale: u32, length: Length) -> Self {
        let mut weights = Terms::default();
        weights.set(Term::Charbonnier, 1.0);
        match subject {
            TrainedNetwork::Own { network: Network::SuperSample, .. } => {
                weights.set(Term::Laplacian, 0.1);
                weights.set(Term::Temporal, 0.1);
            }
            TrainedNetwork::Own { network: Network::Interpolate, .. } => {
                weights.set(Term::Perceptual, 0.2);
                weights.set(Term::Warp, 0.05);
                // The paper's 0.2 is of another norm. Of the mean square a departure of 0.1 would cost 2e-3, more than
                // a third of all the loss that warped frames begin with, and networks learned nothing.
                weights.set(Term::Alpha, 0.001);
            }
            // As they were published: the error's size alone.
            TrainedNetwork::Published(_) => {}
        }
        // Networks without memory see no more in frames that follow each other than in any others.
        let (batch, window) = match subject {
            TrainedNetwork::Own { .. } => (8, 6),
            TrainedNetwork::Published(_) => (32, 1),
        };
        Self {
            subject,
            scale,
            batch,
            window,
            crop: 64,
            seed: 0,
            symmetries: Symmetries::All,
            loss: Loss { weights, epsilon: 1e-3 },
            perceptual: None,
            rate: 1e-3,
            warm_up: 100,
            longest_gradient: 1.0,
            kept: 0.0,
            length,
        }
    }

    /// The learning rate of the step after `steps`, at the training's `progress`: a linear rise, then half a cosine
    /// down to a hundredth.
    #[must_use]
    pub fn rate_at(&self, steps: u64, progress: f64) -> f32 {
        let rise = ((steps as f64 + 1.0) / (self.warm_up as f64 + 1.0)).min(1.0);
        let fall = 0.5 * (1.0 + (std::f64::consts::PI * progress).cos());
        (self.rate * rise * (LAST_RATE + (1.0 - LAST_RATE) * fall)) as f32
    }

    /// Whether all numbers are in range.
    ///
    /// # Errors
    /// [`TrainError::Setting`] naming the first that is not.
    pub fn check(&self) -> Result<(), TrainError> {
        let fail = |name, expected: &str, actual: String| {
            Err(TrainError::Setting { name, expected: expected.to_owned(), actual })
        };
        let least_crop = 2 * MARGIN + 1;
        let length = match self.length {
            Length::Steps(steps) => steps as f64,
            Length::Seconds(seconds) => seconds,
        };
        let positive = |v: f64| v.is_finite() && v > 0.0;
        let weights = Term::ALL.map(|term| (term.name(), self.loss.weights.get(term)));
        if !(1..=4096).contains(&self.batch) {
            return fail("batch", "1 to 4096", self.batch.to_string());
        }
        if !(1..=4096).contains(&self.window) {
            return fail("window", "1 to 4096", self.window.to_string());
        }
        if !(least_crop..=4096).contains(&self.crop) {
            return fail("crop", &format!("{least_crop} to 4096"), self.crop.to_string());
        }
        if !positive(length) {
            return fail("length", "a finite number above 0", length.to_string());
        }
        if let Length::Seconds(seconds) = self.length
            && seconds > MAX_SECONDS
        {
            return fail("length", &format!("at most {MAX_SECONDS} seconds"), seconds.to_string());
        }
        if self.warm_up > MAX_WARM_UP {
            return fail("warm-up", &format!("at most {MAX_WARM_UP} steps"), self.warm_up.to_string());
        }
        if !positive(self.rate) {
            return fail("rate", "a finite number above 0", self.rate.to_string());
        }
        if !positive(self.longest_gradient) {
            return fail("longest gradient", "more than 0", self.longest_gradient.to_string());
        }
        if !(0.0..1.0).contains(&self.kept) {
            return fail("kept", "0 to less than 1", self.kept.to_string());
        }
        if !EPSILONS.contains(&self.loss.epsilon) {
            let expected = format!("{:e} to {}", EPSILONS.start(), EPSILONS.end());
            return fail("epsilon", &expected, format!("{:e}", self.loss.epsilon));
        }
        match weights.into_iter().find(|(_, weight)| !(weight.is_finite() && *weight >= 0.0)) {
            Some((name, weight)) => fail(name, "a weight of at least 0", weight.to_string()),
            None => Ok(()),
        }
    }
}
