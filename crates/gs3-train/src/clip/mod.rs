//! Clips: consecutive frames of one camera path, what a network is fed and what it should give.

mod error;
mod file;
mod symmetry;

use std::ops::Range;

use gs3_neural::Graph;
pub use gs3_neural::model::Network;
use gs3_neural::model::Tier;
use half::f16;

pub use error::ClipError;
pub use file::ClipFile;
pub use symmetry::Symmetry;

/// The state that a network hands on to itself, which no clip holds.
pub const HIDDEN: &str = "hidden";

/// Consecutive frames of one camera path, or of a part of the image.
#[derive(Clone, Debug, PartialEq)]
pub struct Clip {
    /// The network it is for.
    pub network: Network,
    /// Where it comes from, for reports.
    pub scene: String,
    /// HR pixels per LR pixel along a side.
    pub scale: u32,
    /// Size of the LR grid, `[height, width]`.
    pub lr: [usize; 2],
    /// In order of time; all have the same inputs in the same order.
    pub frames: Vec<ClipFrame>,
}

/// One frame of a clip.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ClipFrame {
    /// The network's inputs but `hidden`. Where there is no past, `motion` and `validity` are 0.
    pub inputs: Vec<ClipPlane>,
    /// The native frame, HR, `[height, width, 3]`: RGB by [`to_unorm`].
    pub target: Vec<u16>,
}

/// An input of a network.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ClipPlane {
    /// The input's name in the graph.
    pub name: String,
    /// Its channels.
    pub channels: usize,
    /// `[height, width, channels]` on the LR or the HR grid, whichever the graph says. f16 holds numbers of `[½, 1]` to
    /// 2.4e-4 at worst: noise of −77 dB, far below any error that is trained on.
    pub values: Vec<f16>,
}

/// A number of `[0, 1]`, clamped, in 16 bits: exact to 7.7e-6.
#[must_use]
pub fn to_unorm(value: f32) -> u16 {
    // A cast saturates, and takes NaN to 0.
    (value.clamp(0.0, 1.0) * f32::from(u16::MAX) + 0.5) as u16
}

/// The number of `[0, 1]` that [`to_unorm`] holds.
#[must_use]
pub fn from_unorm(value: u16) -> f32 {
    f32::from(value) * (1.0 / f32::from(u16::MAX))
}

/// A part of a clip.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ClipWindow {
    /// Frames.
    pub frames: Range<usize>,
    /// Rows of the LR grid.
    pub rows: Range<usize>,
    /// Columns of the LR grid.
    pub columns: Range<usize>,
}

impl ClipWindow {
    /// Size on the LR grid, `[height, width]`.
    #[must_use]
    pub fn lr(&self) -> [usize; 2] {
        [self.rows.len(), self.columns.len()]
    }

    /// Whether it lies within a clip of `frames` frames on an LR grid of `lr`, and is not empty.
    fn check(&self, frames: usize, lr: [usize; 2]) -> Result<(), ClipError> {
        let ranges = [(&self.frames, frames), (&self.rows, lr[0]), (&self.columns, lr[1])];
        match ranges.iter().all(|(range, end)| !range.is_empty() && range.end <= *end) {
            true => Ok(()),
            false => Err(ClipError::Window { frames, lr, actual: self.clone() }),
        }
    }
}

impl Clip {
    /// Whether every frame holds the inputs of the network and a target, of the right sizes.
    ///
    /// # Errors
    /// [`ClipError`] naming the first that does not fit.
    pub fn check(&self) -> Result<(), ClipError> {
        if self.frames.is_empty() {
            return Err(ClipError::Empty);
        }
        // Inputs that clips hold are the same for all tiers.
        let graph = self.network.graph(self.scale, Tier::Fast)?;
        let shapes = graph.shapes(self.lr)?;
        for (k, frame) in self.frames.iter().enumerate() {
            for (tensor, layer) in graph.inputs().filter(|(_, layer)| layer.name != HIDDEN) {
                let shape = shapes[tensor.index()];
                let plane = frame.inputs.iter().find(|plane| plane.name == layer.name);
                let actual = plane.map_or([0, 0], |plane| [plane.channels, plane.values.len()]);
                if actual != [shape.channels, shape.len()] {
                    return Err(ClipError::Plane {
                        frame: k,
                        name: layer.name.clone(),
                        expected: shape,
                        actual,
                    });
                }
            }
            let wrong = |plane: &&ClipPlane| plane.name == HIDDEN || !is_input(&graph, &plane.name);
            if let Some(plane) = frame.inputs.iter().find(wrong) {
                return Err(ClipError::Unknown { name: plane.name.clone() });
            }
            let names = |frame: &ClipFrame| frame.inputs.iter().map(|p| p.name.clone()).collect::<Vec<_>>();
            if names(frame) != names(&self.frames[0]) {
                return Err(ClipError::Order {
                    frame: k,
                    expected: names(&self.frames[0]),
                    actual: names(frame),
                });
            }
            let hr = self.lr.map(|side| side * self.scale as usize);
            let expected = hr[0] * hr[1] * 3;
            if frame.target.len() != expected {
                return Err(ClipError::Target { frame: k, expected, actual: frame.target.len() });
            }
        }
        Ok(())
    }

    /// The part of the clip within `window`. What was outside it has not been seen: `validity` is 0 where `motion`
    /// points there.
    ///
    /// # Errors
    /// [`ClipError`] if the window is empty or not within the clip, or the clip not whole.
    pub fn crop(&self, window: &ClipWindow) -> Result<Self, ClipError> {
        self.check()?;
        window.check(self.frames.len(), self.lr)?;
        let scale = self.scale as usize;
        let cut = |frame: &ClipFrame| {
            let plane = |plane: &ClipPlane| {
                // All pixels of the LR grid or, `scale²` times as many, of the HR grid: the clip was checked.
                let factor =
                    if plane.values.len() == plane.channels * self.lr[0] * self.lr[1] { 1 } else { scale };
                let values = cut_out(&plane.values, self.lr[1], plane.channels, factor, window);
                ClipPlane { name: plane.name.clone(), channels: plane.channels, values }
            };
            ClipFrame {
                inputs: frame.inputs.iter().map(plane).collect(),
                target: cut_out(&frame.target, self.lr[1], 3, scale, window),
            }
        };
        let frames = self.frames[window.frames.clone()].iter().map(cut).collect();
        let mut clip = Self { lr: window.lr(), frames, scene: self.scene.clone(), ..*self };
        clip.forget_outside();
        Ok(clip)
    }

    /// Makes invalid what comes from outside the image.
    fn forget_outside(&mut self) {
        let [height, width] = self.lr;
        for frame in &mut self.frames {
            let place = |name: &str| frame.inputs.iter().position(|plane| plane.name == name);
            let (Some(motion), Some(validity)) = (place("motion"), place("validity")) else { continue };
            let Ok([motion, validity]) = frame.inputs.get_disjoint_mut([motion, validity]) else { continue };
            let motion = motion.values.as_chunks::<2>().0;
            for (k, (valid, [dx, dy])) in validity.values.iter_mut().zip(motion).enumerate() {
                // The image reaches half a pixel beyond the centres of its outermost pixels.
                let inside = |at: usize, by: f16, side: usize| {
                    (-0.5..=side as f32 - 0.5).contains(&(at as f32 + by.to_f32()))
                };
                if !(inside(k % width, *dx, width) && inside(k / width, *dy, height)) {
                    *valid = f16::ZERO;
                }
            }
        }
    }
}

fn is_input(graph: &Graph, name: &str) -> bool {
    graph.inputs().any(|(_, layer)| layer.name == name)
}

/// The pixels within `window` of an image `factor` times as fine as an LR grid of `width` columns.
fn cut_out<T: Copy>(
    values: &[T],
    width: usize,
    channels: usize,
    factor: usize,
    window: &ClipWindow,
) -> Vec<T> {
    let pixel = channels * factor;
    let mut out = Vec::with_capacity(window.rows.len() * factor * window.columns.len() * pixel);
    for row in
        values.chunks_exact(width * pixel).take(window.rows.end * factor).skip(window.rows.start * factor)
    {
        out.extend_from_slice(&row[window.columns.start * pixel..window.columns.end * pixel]);
    }
    out
}
