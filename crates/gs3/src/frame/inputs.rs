//! What a frame is made from and what it leaves: the values that a machine gets and gives.

use gs3_reconstruct::{DepthLattice, Neighbor, ResetReason};
use gs3_scene::{Camera, GBuffer, Image, Margin};

use crate::stages::StageTimes;

/// All that is decided about a frame before its first stage runs. Both machines read it, and nothing else about the
/// frame.
#[derive(Clone, Debug)]
pub struct FrameInputs {
    /// The camera of the high-resolution frame.
    pub camera: Camera,
    /// Why this frame has no history, if it has none. Stages are given this; they keep no flag of their own.
    pub reset: Option<ResetReason>,
    /// Where within its pixels the LR frame is sampled, in LR pixels from the pixel centre.
    pub jitter: [f32; 2],
    /// What is rasterized beyond the edges, LR pixels.
    pub margin: Margin,
    /// The frames to interpolate between the previous frame and this one, in order; none without a previous frame.
    pub moments: Vec<Moment>,
}

/// A moment between two rendered frames.
#[derive(Clone, Copy, Debug)]
pub struct Moment {
    /// Time in (0, 1): 0 is the previous frame, 1 the current one.
    pub t: f32,
    /// The camera at that time.
    pub camera: Camera,
}

/// What comes back to the processor of a frame that a GPU makes.
#[cfg_attr(not(feature = "gpu"), expect(dead_code, reason = "the processor has all that it makes"))]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReadBack {
    /// Nothing, and nobody waits for the frame.
    Nothing,
    /// The rasterizer's counters and some depths, a few hundred bytes. Images stay on the device.
    Counters,
    /// The same and all images.
    Images,
}

/// What a machine tells of a frame that it made.
#[derive(Clone, Copy, Debug)]
pub struct Made {
    /// Depths that tell whether the next camera is a cut, and where its frame is to be sampled.
    pub lattice: DepthLattice,
    /// Number of frames interpolated before this one.
    pub in_between: usize,
    /// Share of its pixels that are exact blocks.
    pub refined: f32,
    /// How long its stages took.
    pub times: StageTimes,
}

/// A high-resolution frame and what it was made from.
#[derive(Debug, Default)]
pub struct Frame {
    /// What saw it; none while it is being made, and before the first frame.
    pub camera: Option<Camera>,
    pub gbuffer: GBuffer,
    pub image: Image,
}

impl Frame {
    /// Width and height, once it is made.
    pub fn size(&self) -> Option<[u32; 2]> {
        self.camera.map(|camera| [camera.width(), camera.height()])
    }

    /// The frame as what comes after it reads it, once it is made.
    pub fn neighbor(&self) -> Option<Neighbor<'_>> {
        let Self { camera, gbuffer, image, .. } = self;
        camera.as_ref().map(|camera| Neighbor { camera, image, gbuffer })
    }
}

/// The frames in the processor's memory. A machine writes `current` and `in_between`.
#[derive(Debug, Default)]
pub struct Frames {
    pub previous: Frame,
    pub current: Frame,
    /// Those between both. How many of them belong to the current frame, [`Made::in_between`] says.
    pub in_between: Vec<Image>,
}

impl Frames {
    /// Makes the current frame the previous one.
    pub fn advance(&mut self) {
        std::mem::swap(&mut self.previous, &mut self.current);
        self.current.camera = None;
    }

    /// Takes [`Self::advance`] back. What was made since is no frame, and nothing goes on from the one before it.
    pub fn retreat(&mut self) {
        std::mem::swap(&mut self.previous, &mut self.current);
        self.current.camera = None;
    }
}
