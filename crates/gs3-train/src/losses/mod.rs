//! The losses of training. All terms except the one of α are functions of errors, output − truth, so they vanish at
//! the truth. Each term adds its derivative to the others'.
//!
//! Error images are HR, `[height, width, 4]`; the fourth number of a pixel is 0, as is what it adds to any loss.

mod alpha;
mod charbonnier;
mod interior;
mod laplacian;
mod perceptual;
mod warp;

pub use alpha::square;
pub use charbonnier::{change, charbonnier};
pub use interior::Interior;
pub use laplacian::Laplacian;
pub use perceptual::{Perceptual, PerceptualMemory};
pub use warp::{Moved, warp};

use std::ops::{AddAssign, DivAssign};

/// Numbers of a pixel of error images.
pub(crate) const CHANNELS: usize = 4;

/// The terms of the loss.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Term {
    /// √(e² + ε²) − ε: [`charbonnier()`].
    Charbonnier,
    /// |∇²e|: [`Laplacian`].
    Laplacian,
    /// Charbonnier of eₜ − eₜ₋₁: [`change`].
    Temporal,
    /// Differences of features, of one frame of an item: [`Perceptual`].
    Perceptual,
    /// Charbonnier of eₜ − eₜ₋₁ moved along: [`warp()`].
    Warp,
    /// The square of what a learned blend departs from the blend by visibility: [`square`].
    Alpha,
}

impl Term {
    /// All of them.
    pub const ALL: [Self; 6] =
        [Self::Charbonnier, Self::Laplacian, Self::Temporal, Self::Perceptual, Self::Warp, Self::Alpha];

    /// As in logs.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Charbonnier => "charbonnier",
            Self::Laplacian => "laplacian",
            Self::Temporal => "temporal",
            Self::Perceptual => "perceptual",
            Self::Warp => "warp",
            Self::Alpha => "alpha",
        }
    }
}

/// A number for each term: its weight or its value.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Terms([f64; Term::ALL.len()]);

impl Terms {
    /// The number of `term`.
    #[must_use]
    pub const fn get(&self, term: Term) -> f64 {
        self.0[term as usize]
    }

    /// Sets the number of `term`.
    pub fn set(&mut self, term: Term, value: f64) {
        self.0[term as usize] = value;
    }

    /// The sum of the terms, each times its weight.
    #[must_use]
    pub fn weighted(&self, weights: &Self) -> f64 {
        self.0.iter().zip(&weights.0).map(|(value, weight)| value * weight).sum()
    }
}

impl AddAssign for Terms {
    fn add_assign(&mut self, other: Self) {
        self.0.iter_mut().zip(other.0).for_each(|(sum, value)| *sum += value);
    }
}

impl DivAssign<f64> for Terms {
    fn div_assign(&mut self, by: f64) {
        self.0.iter_mut().for_each(|value| *value /= by);
    }
}

/// What is lowered: terms by weight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Loss {
    /// Weights of the terms; a term of weight 0 is not computed.
    pub weights: Terms,
    /// ε of Charbonnier terms: errors far below it count by their squares, those far above by their size.
    pub epsilon: f32,
}
