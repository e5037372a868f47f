//! Decisions about a frame before it is rendered, from the frames before it.

use gs3_scene::{Camera, Margin};

use crate::cut::is_cut;
use crate::depth_lattice::DepthLattice;
use crate::jitter::{AdaptiveJitter, Sampling};
use crate::margin::{margin_ahead, whole_blocks};

/// Why the history is not valid. The owner of the history reports the reason; a [`crate::SuperSampler`] does not
/// detect cuts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ResetReason {
    /// There is no earlier frame.
    FirstFrame,
    /// The camera jumped: its view has little in common with the previous view.
    CameraCut,
    /// The output size or the quality tier changed.
    SizeOrTierChange,
    /// The scene, or the shown part of the scene, changed.
    SceneChange,
    /// Another machine renders, and the history is on the old one.
    BackendChange,
    /// The previous frame could not be made, or one shortly before is incomplete.
    Failure,
    /// The frame is a keyframe: at fixed frame numbers of a path everything starts anew, so that parts of the path
    /// can be rendered separately. A keyframe has in-between frames before it.
    Keyframe,
}

/// How a frame is to be rendered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameStart {
    /// Why the frame has no history; none if it has one.
    pub reset: Option<ResetReason>,
    /// The best sampling offset within the frame's LR pixels, in LR pixels from the pixel centre.
    pub jitter: [f32; 2],
    /// The margin worth rendering beyond the frame's edges, in LR pixels. The next frames then have past samples for
    /// the parts that come into view.
    pub margin: Margin,
    /// The camera of the previous frame; none if there is no history.
    pub previous: Option<Camera>,
}

/// A sequence of frames: detects camera cuts, and chooses jitter and margins. It needs only cameras and a few depths,
/// so it works with any renderer and any place of the frames in memory.
///
/// [`Self::begin`] decides and changes nothing. [`Self::commit`] records the frame once it has been made.
#[derive(Clone, Debug)]
pub struct FrameSequence {
    scale: u32,
    sampling: Sampling,
    widest_margin: u32,
    jitter: AdaptiveJitter,
    /// The last frame.
    last: Option<(Camera, DepthLattice)>,
    /// Why the next frame starts without history, if the reason is already known.
    next_reset: Option<ResetReason>,
}

impl FrameSequence {
    /// A sequence before its first frame. LR frames are `scale` times coarser than the frames shown. Their margins
    /// have at most `widest_margin` LR pixels, 0 for none.
    #[must_use]
    pub fn new(scale: u32, sampling: Sampling, widest_margin: u32) -> Self {
        let jitter = AdaptiveJitter::new(scale, sampling);
        Self { scale, sampling, widest_margin, jitter, last: None, next_reset: Some(ResetReason::FirstFrame) }
    }

    /// Changes the scale, HR over LR size. The next frame has no history if the scale is another one.
    pub fn set_scale(&mut self, scale: u32) {
        if scale != self.scale {
            (self.scale, self.jitter) = (scale, AdaptiveJitter::new(scale, self.sampling));
            self.reset(ResetReason::SizeOrTierChange);
        }
    }

    /// How to render the frame of `camera`.
    #[must_use]
    pub fn begin(&self, camera: &Camera) -> FrameStart {
        let reset = self.next_reset.or_else(|| match &self.last {
            None => Some(ResetReason::FirstFrame),
            Some((last, _)) if last.size() != camera.size() => Some(ResetReason::SizeOrTierChange),
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
            // After a cut the motion of the camera is unknown.
            _ => FrameStart { reset, jitter: self.jitter.first(), margin: Margin::NONE, previous: None },
        }
    }

    /// Records the frame of `camera` as the last frame. `reset` is the reason for its missing history, if any;
    /// `jitter` is its sampling offset; `depths` are its depths, all 0 if they are unknown.
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

    /// Takes `depths`, of the last frame or of one shortly before it, for the depths of the last frame. A frame whose depths
    /// are known late is recorded with unknown ones.
    pub const fn learn_depths(&mut self, depths: DepthLattice) {
        if let Some((_, last)) = &mut self.last {
            *last = depths;
        }
    }

    /// Records that the frame which began with `reset` could not be made: the next frame has no history.
    pub fn fail(&mut self, reset: Option<ResetReason>) {
        self.next_reset = Some(reset.unwrap_or(ResetReason::Failure));
    }

    /// Drops the history: the next frame starts anew, for this reason unless an earlier reason is pending.
    pub fn reset(&mut self, reason: ResetReason) {
        self.next_reset.get_or_insert(reason);
    }

    /// Forgets where earlier frames were sampled. The next frame is sampled like a first frame, and later frames
    /// depend on the frames from there on.
    pub fn restart_sampling(&mut self) {
        self.jitter.reset();
    }

    /// Number of frames after which a resting camera repeats its sampling offsets, S² or 1.
    #[must_use]
    pub fn period(&self) -> usize {
        self.jitter.period()
    }
}
