//! The optimiser Adam (Kingma and Ba 2015), with a state that can be saved and taken up again bit for bit.

#[cfg(feature = "fs")]
use std::path::Path;

#[cfg(feature = "fs")]
use crate::arrays::{self, Texts};
use crate::arrays::{Array, Arrays};
use crate::error::WeightError;

/// Shares of the means that each step keeps, and what is added to the root: the paper's.
const KEPT: [f64; 2] = [0.9, 0.999];
const EPSILON: f32 = 1e-8;

/// Running means of the derivatives.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Adam {
    /// Steps made.
    step: u64,
    /// Means of derivatives, under the names of the weights.
    first: Arrays,
    /// Means of their squares.
    second: Arrays,
}

impl Adam {
    /// The state before the first step.
    #[must_use]
    pub fn new(weights: &Arrays) -> Self {
        let zeros = |(name, array): (&String, &Array)| (name.clone(), Array::zeros(array.shape()));
        let [first, second] = [0, 1].map(|_| weights.iter().map(zeros).collect());
        Self { step: 0, first, second }
    }

    /// Steps made.
    #[must_use]
    pub fn steps(&self) -> u64 {
        self.step
    }

    /// Moves `weights` against `derivatives`, about `rate` each.
    ///
    /// # Errors
    /// [`WeightError`] if names or shapes of `weights`, `derivatives` and the state differ; nothing is moved then.
    pub fn step(&mut self, weights: &mut Arrays, derivatives: &Arrays, rate: f32) -> Result<(), WeightError> {
        for arrays in [derivatives, &self.first, &self.second] {
            check_same(weights, arrays)?;
        }
        self.step += 1;
        let exponent = i32::try_from(self.step).unwrap_or(i32::MAX);
        // What the means lack because they began at zero.
        let [first_share, second_share] = KEPT.map(|kept| (1.0 - kept.powi(exponent)) as f32);
        let [keep_first, keep_second] = KEPT.map(|kept| kept as f32);
        // Not 1 − 0.999 in single precision, which is 5e-5 of itself too large.
        let [add_first, add_second] = KEPT.map(|kept| (1.0 - kept) as f32);
        let states = self.first.values_mut().zip(self.second.values_mut());
        for ((weight, derivative), (first, second)) in
            weights.values_mut().zip(derivatives.values()).zip(states)
        {
            let states = first.values_mut().iter_mut().zip(second.values_mut());
            for ((w, v), (m, s)) in weight.values_mut().iter_mut().zip(derivative.values()).zip(states) {
                *m = keep_first * *m + add_first * v;
                *s = keep_second * *s + add_second * v * v;
                *w -= rate * (*m / first_share) / ((*s / second_share).sqrt() + EPSILON);
            }
        }
        Ok(())
    }

    /// Writes the state to a safetensors file, whole or not at all.
    ///
    /// # Errors
    /// [`WeightError`] if it cannot be written.
    #[cfg(feature = "fs")]
    pub fn save(&self, path: &Path) -> Result<(), WeightError> {
        let mut all = Arrays::new();
        for (kind, arrays) in [("first", &self.first), ("second", &self.second)] {
            all.extend(arrays.iter().map(|(name, array)| (format!("{kind}/{name}"), array.clone())));
        }
        arrays::save(path, &Texts::from([("step".to_owned(), self.step.to_string())]), &all)
    }

    /// Reads a state.
    ///
    /// # Errors
    /// [`WeightError`] if the file cannot be read or is something else. [`Adam::step`] checks whether the state fits
    /// the weights.
    #[cfg(feature = "fs")]
    pub fn load(path: &Path) -> Result<Self, WeightError> {
        let (texts, arrays) = arrays::load(path)?;
        let step =
            texts.get("step").and_then(|step| step.parse().ok()).ok_or_else(|| WeightError::Header {
                field: "step",
                expected: "a number".to_owned(),
                actual: texts.get("step").cloned().unwrap_or_else(|| "none".to_owned()),
            })?;
        let mut state = Self { step, ..Self::default() };
        for (name, array) in arrays {
            match name.split_once('/') {
                Some(("first", weight)) => state.first.insert(weight.to_owned(), array),
                Some(("second", weight)) => state.second.insert(weight.to_owned(), array),
                _ => return Err(WeightError::Unknown { name }),
            };
        }
        Ok(state)
    }
}

/// Whether `actual` has the names and shapes of `expected`.
fn check_same(expected: &Arrays, actual: &Arrays) -> Result<(), WeightError> {
    for (name, array) in expected {
        let (name, expected) = (name.clone(), array.shape().to_vec());
        match actual.get(&name) {
            None => return Err(WeightError::Missing { name, expected }),
            Some(found) if found.shape() != expected => {
                let actual = format!("{:?}", found.shape());
                return Err(WeightError::Shape { name, expected, actual });
            }
            Some(_) => {}
        }
    }
    match actual.keys().find(|name| !expected.contains_key(*name)) {
        Some(name) => Err(WeightError::Unknown { name: name.clone() }),
        None => Ok(()),
    }
}
