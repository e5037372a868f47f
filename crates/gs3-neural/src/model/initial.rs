//! Initial weights for training: random features, and last layers that are zero. Interpolation then equals the
//! pipeline without learning. Super sampling is the mean of the current and the previous frame where both may count,
//! plus an eighth of the drift.

use crate::graph::Graph;
use crate::weights::{Header, Weights};

/// The layers that give what is added to the analytic result.
const LAST: [&str; 6] = ["refine", "gai", "detail", "head.color", "head.alpha", "head.beta"];

/// What the share of the drift starts from: σ(−2) = 0.12. More gains on large frames and loses on small ones.
const DRIFT: (&str, f32) = ("head.beta.bias", -2.0);

/// Weights from which training starts, the same for the same seed: last layers are zero.
#[must_use]
pub fn initial_weights(graph: &Graph, header: Header, seed: u64) -> Weights {
    let mut weights = Weights::random(graph, header, seed);
    for (name, array) in &mut weights.arrays {
        if name.strip_suffix(".weight").is_some_and(|layer| LAST.contains(&layer)) {
            array.values_mut().fill(0.0);
        }
    }
    if let Some(bias) = weights.arrays.get_mut(DRIFT.0) {
        bias.values_mut().fill(DRIFT.1);
    }
    weights
}
