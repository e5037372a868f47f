//! What is decided about a frame before it is rendered, by the frames before it.

use gs3_scene::{Camera, Margin};

use crate::cut::is_cut;
use crate::depth_lattice::DepthLattice;
use crate::jitter::{AdaptiveJitter, Sampling};
use crate::margin::{margin_ahead, whole_blocks};

/// Why history is not valid. Whoever keeps it tells; a [`crate::SuperSampler`] does not look for cuts itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ResetReason {
    /// There has been no frame yet.
    FirstFrame,
    /// The camera jumped: what it sees has little to do with what it saw.
    CameraCut,
    /// The output size or the quality tier changed.
    SizeOrTierChange,
    /// The scene, or what is shown of it, changed.
    SceneChange,
    /// Other hardware renders: the history stayed behind.
    BackendChange,
    /// The frame before could not be made.
    Failure,
    /// The frame is one of those at fixed numbers of a path where all begins anew, so that parts of the path can be
    /// rendered apart. In-between frames lead to it.
    Keyframe,
}

/// How a frame is to be rendered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameStart {
    /// Why the frame has no history, if it has none.
    pub reset: Option<ResetReason>,
    /// Where within its LR pixels it is best sampled, in LR pixels from the pixel centre.
    pub jitter: [f32; 2],
    /// What is worth rendering beyond its edges, LR pixels: what the next frames reveal then has a past.
    pub margin: Margin,
    /// The camera of the frame before; none if there is no history.
    pub previous: Option<Camera>,
}

/// Frames one after the other: tells camera cuts, and chooses sampling offsets and margins. It knows cameras and a few
/// depths, so it serves any renderer, wherever its frames lie.
///
/// [`Self::begin`] decides, and changes nothing; the frame counts once it is there, with [`Self::commit`].
#[derive(Clone, Debug)]
pub struct FrameSequence {
    scale: u32,
    widest_margin: u32,
    jitter: AdaptiveJitter,
    /// The last frame.
    last: Option<(Camera, DepthLattice)>,
    /// Why the next frame starts without history, if that is known already.
    next_reset: Option<ResetReason>,
}

impl FrameSequence {
    /// Before the first frame. LR frames are `scale` times coarser than what is shown; their margins have at most
    /// `widest_margin` LR pixels, 0 for none.
    #[must_use]
    pub fn new(scale: u32, sampling: Sampling, widest_margin: u32) -> Self {
        let jitter = AdaptiveJitter::new(scale, sampling);
        Self { scale, widest_margin, jitter, last: None, next_reset: Some(ResetReason::FirstFrame) }
    }

    /// How the frame of `camera` is to be rendered.
    #[must_use]
    pub fn begin(&self, camera: &Camera) -> FrameStart {
        let size = |camera: &Camera| (camera.width(), camera.height());
        let reset = self.next_reset.or_else(|| match &self.last {
            None => Some(ResetReason::FirstFrame),
            Some((last, _)) if size(last) != size(camera) => Some(ResetReason::SizeOrTierChange),
            Some((last, depths)) if is_cut(last, camera, depths) => Some(ResetReason::CameraCut),
            Some(_) => None,
        });
        match (&self.last, reset) {
            (Some((last, depths)), None) => {
                let jitter = self.jitter.choose(camera, depths);
                let margin = match self.widest_margin {
                    0 => Margin::NONE,
                    widest => whole_blocks(
                        margin_ahead(last, camera, depths, self.scale, widest),
                        self.scale,
                        widest,
                    ),
                };
                FrameStart { reset, jitter, margin, previous: Some(*last) }
            }
            // After a cut nothing tells where the camera goes.
            _ => FrameStart { reset, jitter: self.jitter.first(), margin: Margin::NONE, previous: None },
        }
    }

    /// Makes the frame of `camera` the last one. It had no history for the reason `reset`, if any, and was sampled at
    /// `jitter`; `depths` are its own, all 0 where they are not known.
    pub fn commit(
        &mut self,
        camera: &Camera,
        reset: Option<ResetReason>,
        jitter: [f32; 2],
        depths: DepthLattice,
    ) {
        if reset.is_some() {
            self.jitter.reset();
        }
        self.jitter.remember(camera, jitter);
        self.last = Some((*camera, depths));
        self.next_reset = None;
    }

    /// Tells that the frame which began with `reset` could not be made: the next one has no history.
    pub fn fail(&mut self, reset: Option<ResetReason>) {
        self.next_reset = Some(reset.unwrap_or(ResetReason::Failure));
    }

    /// Forgets the frames before: the next one starts anew, for this reason unless another came first.
    pub fn reset(&mut self, reason: ResetReason) {
        self.next_reset.get_or_insert(reason);
    }

    /// Forgets where the frames before were sampled: the next one is sampled as a first frame is, and those after by the
    /// frames from there on.
    pub fn restart_sampling(&mut self) {
        self.jitter.reset();
    }

    /// Number of frames after which a resting camera repeats its sampling offsets, S² or 1.
    #[must_use]
    pub fn period(&self) -> usize {
        self.jitter.period()
    }
}
