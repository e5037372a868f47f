//! What a training has come to.

use gs3_neural::{Adam, Weights};

/// What a training has come to: all that a checkpoint holds.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    /// The weights that steps move: in the form in which they are trained.
    pub weights: Weights,
    /// Their running mean, which is what is used in the end, in the same form.
    pub average: Weights,
    /// The optimiser's means.
    pub adam: Adam,
    /// The average that was best on held-out clips.
    pub best: Option<Best>,
    /// Seconds of training.
    pub seconds: f64,
}

/// Weights and what they gain.
#[derive(Clone, Debug, PartialEq)]
pub struct Best {
    /// The weights, as they are run.
    pub weights: Weights,
    /// Their step.
    pub step: u64,
    /// Their mean gain on held-out clips in dB.
    pub gain: f64,
    /// [`ClipFolder::digest`](crate::ClipFolder::digest) of these clips: on others gains are others.
    pub held: u64,
}

impl State {
    /// Before the first step.
    #[must_use]
    pub fn new(weights: Weights) -> Self {
        let adam = Adam::new(&weights.arrays);
        Self { average: weights.clone(), weights, adam, best: None, seconds: 0.0 }
    }

    /// Steps made.
    #[must_use]
    pub fn steps(&self) -> u64 {
        self.adam.steps()
    }
}
