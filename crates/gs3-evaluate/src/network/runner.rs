//! Networks on images of any size, by gs3's engine.

use gs3::neural::{Arithmetic, Engine, Graph, RunError, Weights};
use gs3_scene::{GBuffer, Image};

use crate::upscale::UpscaleError;

/// A graph with its weights.
#[derive(Clone, Debug)]
pub(super) struct Runner {
    /// What messages call the network.
    name: &'static str,
    graph: Graph,
    weights: Weights,
    /// For LR images of `[height, width]`.
    engine: Option<([usize; 2], Engine)>,
}

impl Runner {
    /// `graph` with `weights`.
    ///
    /// # Errors
    /// [`RunError`] if they are not its own.
    pub fn new(name: &'static str, graph: Graph, weights: Weights) -> Result<Self, RunError> {
        weights.check(&graph)?;
        Ok(Self { name, graph, weights, engine: None })
    }

    /// Runs it on images of LR `size`, `[height, width]`; as [`Engine::run`].
    pub fn run(
        &mut self,
        size: [usize; 2],
        images: &[(&str, &[f32])],
        outputs: &mut [(&str, &mut [f32])],
    ) -> Result<(), UpscaleError> {
        let failed = |e: RunError| UpscaleError::Network { method: self.name, message: e.to_string() };
        let engine = match self.engine.take().filter(|(of, _)| *of == size) {
            Some(engine) => engine,
            None => {
                // In f32, also when gs3's own networks compute in bf16: those add to an image and lose nothing by
                // bf16, but RT4KSR makes the image itself and loses 0.07 dB.
                let engine = Engine::with_arithmetic(&self.graph, &self.weights, size, Arithmetic::F32);
                (size, engine.map_err(failed)?)
            }
        };
        let (_, engine) = self.engine.insert(engine);
        engine.run(images, outputs).map_err(failed)
    }
}

/// The colour of `lr`, clamped to `[0, 1]`, and its `[height, width]`; the last column and row are repeated until
/// `multiple` divides the sides.
pub(super) fn color_of(lr: &GBuffer, multiple: usize) -> (Vec<f32>, [usize; 2]) {
    let size = [lr.height(), lr.width()].map(|side| side.next_multiple_of(multiple));
    let mut color = Vec::with_capacity(3 * size[0] * size[1]);
    for y in 0..size[0] {
        let rows: [&[f32]; 3] = std::array::from_fn(|c| lr.color.row(c, y.min(lr.height() - 1)));
        let pixel = |x: usize| rows.map(|row| row[x.min(lr.width() - 1)].clamp(0.0, 1.0));
        color.extend((0..size[1]).flat_map(pixel));
    }
    (color, size)
}

/// Writes RGB, `width` pixels a row, to an image of this size or smaller, fourth channel 0.
pub(super) fn write(color: &[f32], width: usize, out: &mut Image) {
    let columns = out.width();
    for (row, pixels) in color.chunks_exact(3 * width).zip(out.pixels_mut().chunks_exact_mut(columns)) {
        for (pixel, [r, g, b]) in pixels.iter_mut().zip(row.as_chunks().0) {
            *pixel = [*r, *g, *b, 0.0];
        }
    }
}
