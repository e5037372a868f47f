//! Where training starts: random features and last layers that are zero, which is the pipeline without learning.

use crate::graph::Graph;
use crate::weights::{Header, Weights};

/// The layers that give what is added to the analytic result.
const LAST: [&str; 4] = ["refine", "gai", "head.color", "head.alpha"];

/// Weights from which training starts, the same for the same seed: the networks give the analytic result.
#[must_use]
pub fn initial_weights(graph: &Graph, header: Header, seed: u64) -> Weights {
    let mut weights = Weights::random(graph, header, seed);
    for (name, array) in &mut weights.arrays {
        if name.strip_suffix(".weight").is_some_and(|layer| LAST.contains(&layer)) {
            array.values_mut().fill(0.0);
        }
    }
    weights
}
