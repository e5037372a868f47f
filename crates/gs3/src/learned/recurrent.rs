//! A network with a hidden state.

use std::sync::Arc;

use gs3_neural::model::{Network, graph_of};
use gs3_neural::{Arithmetic, Engine, Graph, Named, Op, Weights};

use crate::error::NetworkError;

/// More inputs than any of the networks has: the inputs of a frame are collected without allocation.
const MAX_INPUTS: usize = 16;

/// A network, an engine for the last size requested, and the hidden state of the last frame.
#[derive(Debug)]
pub(super) struct Recurrent {
    graph: Graph,
    weights: Arc<Weights>,
    arithmetic: Arithmetic,
    /// LR `[height, width]` and the engine planned for this size.
    engine: Option<([usize; 2], Engine)>,
    /// The state of the last frame, LR, channels last.
    hidden: Vec<f32>,
    next: Vec<f32>,
    has_state: bool,
    /// HR inputs and the output, padded for images that are not a whole number of blocks.
    padded: [Vec<f32>; MAX_INPUTS],
}

impl Recurrent {
    pub fn new(
        weights: Arc<Weights>,
        network: Network,
        scale: u32,
        arithmetic: Arithmetic,
    ) -> Result<Self, NetworkError> {
        let header = &weights.header;
        if header.network != network.name() {
            return Err(NetworkError::Other { expected: network.name(), actual: header.network.clone() });
        }
        if header.scale != scale {
            return Err(NetworkError::Scale { expected: scale, actual: header.scale });
        }
        let graph = graph_of(header)?;
        weights.check(&graph)?;
        Ok(Self {
            graph,
            weights,
            arithmetic,
            engine: None,
            hidden: Vec::new(),
            next: Vec::new(),
            has_state: false,
            padded: Default::default(),
        })
    }

    /// Drops the hidden state.
    pub fn reset(&mut self) {
        self.has_state = false;
    }

    pub fn has_state(&self) -> bool {
        self.has_state
    }

    /// Runs the network on `images` and the hidden state, writes its output to `color` and keeps its new state. The
    /// LR grid is `[height, width]`; HR images have S times this size, or up to one block less.
    pub fn run(
        &mut self,
        lr: [usize; 2],
        hr: [usize; 2],
        images: &[Named<'_>],
        color: &mut [f32],
    ) -> Result<(), NetworkError> {
        let engine = match &mut self.engine {
            Some((size, engine)) if *size == lr => engine,
            other => {
                self.has_state = false;
                let engine = Engine::with_arithmetic(&self.graph, &self.weights, lr, self.arithmetic)?;
                &mut other.insert((lr, engine)).1
            }
        };
        let len = engine.shape("hidden").map_or(0, |shape| shape.len());
        if !self.has_state {
            self.hidden.clear();
        }
        self.hidden.resize(len, 0.0);
        self.next.resize(len, 0.0);
        let scale = self.weights.header.scale as usize;
        let full = lr.map(|side| side * scale);
        let [padded @ .., padded_color] = &mut self.padded;
        let mut all: [Named<'_>; MAX_INPUTS] = [("", &[]); MAX_INPUTS];
        let count = images.len().min(MAX_INPUTS - 1);
        for ((place, (name, image)), padded) in all.iter_mut().zip(&images[..count]).zip(padded) {
            let is_hr = |op: &Op| matches!(op, Op::Input { scale, .. } if *scale > 1);
            let is_hr = self.graph.inputs().any(|(_, layer)| layer.name == *name && is_hr(&layer.op));
            *place = match is_hr && hr != full {
                true => {
                    pad(image, hr, full, padded);
                    (*name, &padded[..])
                }
                false => (*name, *image),
            };
        }
        all[count] = ("hidden", &self.hidden);
        if hr == full {
            engine.run(&all[..=count], &mut [("color", color), ("hidden", &mut self.next)])?;
        } else {
            let channels = color.len() / (hr[0] * hr[1]);
            padded_color.resize(full[0] * full[1] * channels, 0.0);
            engine.run(&all[..=count], &mut [("color", padded_color), ("hidden", &mut self.next)])?;
            let rows = padded_color.chunks_exact(full[1] * channels);
            for (to, from) in color.chunks_exact_mut(hr[1] * channels).zip(rows) {
                to.copy_from_slice(&from[..to.len()]);
            }
        }
        std::mem::swap(&mut self.hidden, &mut self.next);
        self.has_state = true;
        Ok(())
    }
}

/// Repeats the last row and column of an image of `[height, width]` up to the size `full`.
fn pad(image: &[f32], [height, width]: [usize; 2], full: [usize; 2], out: &mut Vec<f32>) {
    let channels = image.len() / (height * width).max(1);
    out.clear();
    for y in 0..full[0] {
        let row = &image[y.min(height - 1) * width * channels..][..width * channels];
        out.extend_from_slice(row);
        for _ in width..full[1] {
            out.extend_from_slice(&row[row.len() - channels..]);
        }
    }
}
