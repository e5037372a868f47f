//! Networks as ONNX files: what is in them, and that ONNX Runtime computes with them what the graph means.

#[path = "../suite/operations.rs"]
mod operations;
mod runtime;
mod structure;

use gs3_neural::{Graph, Header};

/// The header of weights of `graph`, told from those of other networks by `tier`.
fn header(graph: &Graph, tier: &str) -> Header {
    Header {
        tier: tier.to_owned(),
        training_data: "nothing".to_owned(),
        licence: "MIT OR Apache-2.0".to_owned(),
        ..Header::of(graph, 4)
    }
}
