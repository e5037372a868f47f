//! Published networks with weights of gs3's own trainer, run by gs3's engine: what their design does on the very frames
//! that gs3's networks were trained on.

use gs3::neural::model::{Peer, graph_of};
use gs3::neural::{self, Arithmetic, Engine, Graph, RunError};
use gs3_scene::{GBuffer, Image};

use crate::upscale::{UpscaleError, Upscaler, check_size};

/// LR sides are made multiples of this: RT4KSR works on blocks of 2×2 pixels.
const MULTIPLE: usize = 2;

/// A trained published network.
#[derive(Clone, Debug)]
pub struct Trained {
    peer: Peer,
    scale: u32,
    graph: Graph,
    weights: neural::Weights,
    /// For LR images of `[height, width]`.
    engine: Option<([usize; 2], Engine)>,
    color: Vec<f32>,
    image: Vec<f32>,
}

impl Trained {
    /// `peer` with `weights`, as `gs3 train baseline` writes them.
    ///
    /// # Errors
    /// [`RunError`] if they are not those of the network.
    pub fn new(peer: Peer, weights: neural::Weights) -> Result<Self, RunError> {
        let actual = weights.header.network.clone();
        if actual != peer.name() {
            let (field, expected) = ("network", peer.name().to_owned());
            return Err(neural::WeightError::Header { field, expected, actual }.into());
        }
        let graph = graph_of(&weights.header)?;
        weights.check(&graph)?;
        let (scale, [color, image]) = (weights.header.scale, [Vec::new(), Vec::new()]);
        Ok(Self { peer, scale, graph, weights, engine: None, color, image })
    }

    /// The weights that come with the crate.
    #[must_use]
    pub fn shipped(peer: Peer, scale: u32) -> Option<&'static [u8]> {
        SHIPPED.iter().find(|file| file.0 == peer && file.1 == scale).map(|file| file.2)
    }
}

/// Networks, their scales and their weights. Model cards lie beside them.
const SHIPPED: &[(Peer, u32, &[u8])] = &[
    (Peer::Ecbsr, 4, include_bytes!("../../weights/ecbsr_x4.safetensors")),
    (Peer::Rt4ksr, 4, include_bytes!("../../weights/rt4ksr_x4.safetensors")),
    (Peer::Ninasr, 4, include_bytes!("../../weights/ninasr_x4.safetensors")),
];

impl Upscaler for Trained {
    fn jitter(&self) -> [f32; 2] {
        self.peer.jitter(self.scale as usize)
    }

    fn upscale(&mut self, lr: &GBuffer, scale: u32, out: &mut Image) -> Result<(), UpscaleError> {
        if scale != self.scale {
            let (expected, actual) = (self.scale, scale);
            return Err(UpscaleError::Scale { method: self.peer.name(), expected, actual });
        }
        check_size(lr, scale, out)?;
        let size = [lr.height(), lr.width()].map(|side| side.next_multiple_of(MULTIPLE));
        let failed = |e: RunError| UpscaleError::Network { method: self.peer.name(), message: e.to_string() };
        let engine = match self.engine.take().filter(|(of, _)| *of == size) {
            Some(engine) => engine,
            None => {
                // In f32 whatever gs3's own networks compute with: those add to an image and lose nothing by bf16, but
                // RT4KSR makes the image itself, and loses 0.07 dB.
                let engine = Engine::with_arithmetic(&self.graph, &self.weights, size, Arithmetic::F32);
                (size, engine.map_err(failed)?)
            }
        };
        let (_, engine) = self.engine.insert(engine);
        // The last row and column are repeated where sides are odd.
        self.color.clear();
        for y in 0..size[0] {
            let rows: [&[f32]; 3] = std::array::from_fn(|c| lr.color.row(c, y.min(lr.height() - 1)));
            let pixel = |x: usize| rows.map(|row| row[x.min(lr.width() - 1)].clamp(0.0, 1.0));
            self.color.extend((0..size[1]).flat_map(pixel));
        }
        let width = size[1] * scale as usize;
        self.image.resize(size[0] * scale as usize * width * 3, 0.0);
        let failed = |e: RunError| UpscaleError::Network { method: self.peer.name(), message: e.to_string() };
        engine.run(&[("color", &self.color)], &mut [("color", &mut self.image)]).map_err(failed)?;
        let columns = out.width();
        for (row, pixels) in
            self.image.chunks_exact(width * 3).zip(out.pixels_mut().chunks_exact_mut(columns))
        {
            for (pixel, [r, g, b]) in pixels.iter_mut().zip(row.as_chunks().0) {
                *pixel = [*r, *g, *b, 0.0];
            }
        }
        Ok(())
    }
}
