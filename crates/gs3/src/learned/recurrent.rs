//! A network with a hidden state.

use std::sync::Arc;

use gs3_neural::model::graph_of;
use gs3_neural::{Engine, Graph, Named, Weights};

use super::error::NetworkError;

/// More than any of the networks has: those of a frame are put together without allocation.
const MAX_INPUTS: usize = 16;

/// A network, an engine for the last size asked for, and the hidden state of the last frame.
#[derive(Debug)]
pub(super) struct Recurrent {
    graph: Graph,
    weights: Arc<Weights>,
    /// LR `[height, width]` and the engine planned for it.
    engine: Option<([usize; 2], Engine)>,
    /// The state of the last frame, LR, channels last.
    hidden: Vec<f32>,
    next: Vec<f32>,
    has_state: bool,
}

impl Recurrent {
    pub fn new(weights: Arc<Weights>, network: &'static str, scale: u32) -> Result<Self, NetworkError> {
        let header = &weights.header;
        if header.network != network {
            return Err(NetworkError::Other { expected: network, actual: header.network.clone() });
        }
        if header.scale != scale {
            return Err(NetworkError::Scale { expected: scale, actual: header.scale });
        }
        let graph = graph_of(header)?;
        weights.check(&graph)?;
        Ok(Self { graph, weights, engine: None, hidden: Vec::new(), next: Vec::new(), has_state: false })
    }

    /// Forgets the state.
    pub fn reset(&mut self) {
        self.has_state = false;
    }

    pub fn has_state(&self) -> bool {
        self.has_state
    }

    /// Runs the network for an LR grid of `[height, width]` on `images` and the state, writes its output `color` and keeps
    /// its state.
    pub fn run(
        &mut self,
        lr: [usize; 2],
        images: &[Named<'_>],
        color: &mut [f32],
    ) -> Result<(), NetworkError> {
        let engine = match &mut self.engine {
            Some((size, engine)) if *size == lr => engine,
            other => {
                self.has_state = false;
                &mut other.insert((lr, Engine::new(&self.graph, &self.weights, lr)?)).1
            }
        };
        let len = engine.shape("hidden").map_or(0, |shape| shape.len());
        if !self.has_state {
            self.hidden.clear();
        }
        self.hidden.resize(len, 0.0);
        self.next.resize(len, 0.0);
        let mut all: [Named<'_>; MAX_INPUTS] = [("", &[]); MAX_INPUTS];
        let count = images.len().min(MAX_INPUTS - 1);
        all[..count].copy_from_slice(&images[..count]);
        all[count] = ("hidden", &self.hidden);
        engine.run(&all[..=count], &mut [("color", color), ("hidden", &mut self.next)])?;
        std::mem::swap(&mut self.hidden, &mut self.next);
        self.has_state = true;
        Ok(())
    }
}
