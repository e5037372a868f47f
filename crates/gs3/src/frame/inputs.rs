//! The values that a machine takes to make a frame, and the values that it returns.

use gs3_reconstruct::{BlockGradients, DepthLattice, Neighbor, ResetReason};
use gs3_scene::{Camera, GBuffer, Image, Margin, Size};

use crate::stages::StageTimes;

/// Everything that is decided about a frame before its first stage runs. Both machines read these values, and read
/// nothing else about the frame.
#[derive(Clone, Debug)]
pub struct FrameInputs {
    /// The camera of the high-resolution frame.
    pub camera: Camera,
    /// The scale of the frame, HR over LR size on each axis: 1 in [`crate::Mode::Native`].
    pub scale: u32,
    /// Why this frame has no history; none if the frame has one. Stages are given this value and keep no flag of
    /// their own.
    pub reset: Option<ResetReason>,
    /// Where the LR frame is sampled within its pixels: the offset from the pixel centre, in LR pixels.
    pub jitter: [f32; 2],
    /// The margin that is rasterized beyond the edges, in LR pixels.
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

/// What a frame made by a GPU copies back to the CPU.
#[cfg_attr(not(feature = "gpu"), expect(dead_code, reason = "the processor has all that it makes"))]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReadBack {
    /// The rasterizer's counters and some depths, a few hundred bytes, while the frame after it is made. Images stay on
    /// the device.
    Late,
    /// The counters and the depths. Images stay on the device.
    Counters,
    /// The counters, the depths, and all images.
    Images,
}

/// What a machine reports about a frame that it made.
#[derive(Clone, Copy, Debug)]
pub struct Made {
    /// Depths that show whether the next camera is a cut, and where the next frame is to be sampled.
    pub lattice: DepthLattice,
    /// Number of frames interpolated before this one.
    pub in_between: usize,
    /// Share of the frame's pixels that are exact blocks, `[0, 1]`.
    pub refined: f32,
    /// How long the frame's stages took.
    pub times: StageTimes,
}

/// A high-resolution frame and the G-buffer that it was made from.
#[derive(Debug, Default)]
pub struct Frame {
    /// The camera of the frame; none while the frame is being made, and before the first frame.
    pub camera: Option<Camera>,
    pub gbuffer: GBuffer,
    pub image: Image,
    /// Derivatives of the image in its exact blocks; empty without exact blocks, and of a frame that is exact as a whole.
    pub gradients: BlockGradients,
}

impl Frame {
    /// The frame's size, once the frame is made.
    pub fn size(&self) -> Option<Size> {
        self.camera.map(|camera| camera.size())
    }

    /// The frame as later stages and frames read it, once it is made.
    pub fn neighbor(&self) -> Option<Neighbor<'_>> {
        let Self { camera, gbuffer, image, gradients } = self;
        camera.as_ref().map(|camera| Neighbor { camera, image, gbuffer, gradients: gradients.some() })
    }
}

/// The frames in the processor's memory. A machine writes `current` and `in_between`.
#[derive(Debug, Default)]
pub struct Frames {
    pub previous: Frame,
    pub current: Frame,
    /// The in-between frames of both. [`Made::in_between`] says how many of them belong to the current frame.
    pub in_between: Vec<Image>,
}

impl Frames {
    /// Makes the current frame the previous one.
    pub fn advance(&mut self) {
        std::mem::swap(&mut self.previous, &mut self.current);
        self.current.camera = None;
    }

    /// Undoes [`Self::advance`]. Whatever was made since is discarded, and the next frame has no previous frame.
    pub fn retreat(&mut self) {
        std::mem::swap(&mut self.previous, &mut self.current);
        self.current.camera = None;
    }
}
