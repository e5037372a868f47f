//! The settings of a pipeline.

use std::fmt;

use gs3_raster::{Culling, KERBL_DILATION, LIST_MEMORY, matched_dilation};
use gs3_reconstruct::{Kriging, Sampling};
use gs3_scene::{Camera, CameraPath};

use crate::refine::{Quality, Refine};
use crate::scale::Scale;

/// How frames are made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// Every pixel rasterized: the reference of quality and speed.
    Native,
    /// Low-resolution frames enlarged by bicubic (Catmull–Rom) interpolation of their colour: the baseline.
    Bicubic,
    /// LR G-buffers super-sampled over time.
    SuperSample,
    /// [`Mode::SuperSample`] plus interpolated frames before each rendered frame. With two in-between frames
    /// ([`PipelineSettings::in_between`]), three frames are shown per frame rasterized.
    #[default]
    Full,
}

impl Mode {
    /// Whether a frame depends on the frames before it.
    #[must_use]
    pub const fn has_history(self) -> bool {
        matches!(self, Self::SuperSample | Self::Full)
    }

    /// The mode's name in the command and in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Native => "native",
            Self::Bicubic => "bicubic",
            Self::SuperSample => "super-sample",
            Self::Full => "full",
        }
    }
}

/// The dilation ε of projected covariances, in px² of the rasterized grid.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Dilation {
    /// 0.3 / S²: samples of the LR grid are exact samples of the native image.
    #[default]
    Matched,
    /// 0.3 at any resolution, as in the original 3D Gaussian Splatting and as the paper assumes. The signal is
    /// blurrier.
    Kerbl,
    /// Any other value, finite and not negative.
    Value(f32),
}

impl Dilation {
    /// The dilation for a grid `scale` times coarser than the image shown.
    #[must_use]
    pub fn at_scale(self, scale: u32) -> f32 {
        match self {
            Self::Matched => matched_dilation(scale),
            Self::Kerbl => KERBL_DILATION,
            Self::Value(value) => value,
        }
    }
}

/// The name in the command and in reports.
impl fmt::Display for Dilation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Matched => write!(f, "matched"),
            Self::Kerbl => write!(f, "kerbl"),
            Self::Value(value) => write!(f, "{value}"),
        }
    }
}

/// Settings of a [`crate::FramePipeline`]. They are fixed at its construction, except
/// [`refine`](crate::FramePipeline::set_refine). Fewer in-between frames than here are a choice for each frame
/// ([`FramePipeline::set_in_between`](crate::FramePipeline::set_in_between)).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PipelineSettings {
    /// How frames are made.
    pub mode: Mode,
    /// High-resolution over low-resolution size. Not read by [`Mode::Native`].
    pub scale: Scale,
    /// Where LR frames are sampled. Not read by [`Mode::Native`].
    pub sampling: Sampling,
    /// Which pixels are kriged, among the pixels that first-order predictions leave uncertain. Frames that a network
    /// refines are always kriged: at least coarsely with a network of tier fast, and finely with one of tier high.
    /// Read by [`Mode::SuperSample`] and [`Mode::Full`].
    pub kriging: Kriging,
    /// Whether LR frames are rasterized beyond the edges that the camera turns to (overscan). The next frames then
    /// have past samples for the parts that come into view. Frames that a network refines always have overscan. Read
    /// by [`Mode::SuperSample`] and [`Mode::Full`].
    pub overscan: bool,
    /// Which pixels are rasterized exactly. Read by [`Mode::SuperSample`] and [`Mode::Full`].
    pub refine: Refine,
    /// The budget of [`Refine::Auto`].
    pub quality: Quality,
    /// Frames from one keyframe to the next, 0 for no keyframes. A frame is a keyframe if its number on its path
    /// ([`FramePipeline::set_frame_number`](crate::FramePipeline::set_frame_number)) is a multiple of this value.
    /// Frames after a keyframe depend on no frame before the keyframe. So parts of a path can be rendered separately
    /// ([`FramePipeline::first_of_warm_up`](crate::FramePipeline::first_of_warm_up)). If [`Refine`] starts exact and
    /// frames have exact pixels, a keyframe is rasterized exactly as a whole. Otherwise only the sampling offsets start
    /// anew. Not read by [`Mode::Native`].
    pub keyframes: u32,
    /// Dilation of the projected covariances. Exact pixels equal the native image's with [`Dilation::Matched`].
    pub dilation: Dilation,
    /// Which tiles a splat is assigned to.
    pub culling: Culling,
    /// Frames interpolated before each rendered frame in [`Mode::Full`], 1 to [`MAX_IN_BETWEEN`].
    pub in_between: u32,
    /// Background colour: display-encoded RGB, finite.
    pub background: [f32; 3],
    /// Most bytes that a CPU's lists of the splats of tiles take at once
    /// ([`with_list_memory`](gs3_raster::Rasterizer::with_list_memory)). Frames have the same bits with any number.
    pub list_memory: u64,
}

impl Default for PipelineSettings {
    fn default() -> Self {
        Self {
            mode: Mode::default(),
            scale: Scale::default(),
            sampling: Sampling::default(),
            kriging: Kriging::default(),
            overscan: false,
            refine: Refine::default(),
            quality: Quality::default(),
            keyframes: KEYFRAMES,
            dilation: Dilation::default(),
            culling: Culling::default(),
            in_between: IN_BETWEEN,
            background: [0.0; 3],
            list_memory: LIST_MEMORY,
        }
    }
}

/// Default number of frames from one keyframe to the next.
pub const KEYFRAMES: u32 = 32;

/// Default number of frames interpolated between two rendered frames. The paper has one. With two, a rendered frame may take
/// half as long again for the same displayed frames per second, so more of its pixels are exact. In-between frames become
/// better with their neighbours.
pub const IN_BETWEEN: u32 = 2;

/// Largest number of frames interpolated between two rendered frames.
pub const MAX_IN_BETWEEN: u32 = 3;

impl PipelineSettings {
    /// Frames shown for each rendered frame. The first rendered frame is always shown alone.
    #[must_use]
    pub const fn displayed_per_rendered(&self) -> usize {
        match self.mode {
            Mode::Full => self.in_between as usize + 1,
            Mode::Native | Mode::Bicubic | Mode::SuperSample => 1,
        }
    }

    /// Moments of the frames interpolated before a rendered frame, in (0, 1), in order.
    pub fn moments(&self) -> impl Iterator<Item = f64> + use<> {
        let count = self.displayed_per_rendered();
        (1..count).map(move |k| k as f64 / count as f64)
    }

    /// The true cameras of the in-between frames before rendered frame `k` of `path`, if the path knows them. There
    /// are no in-between frames of two frames of different size: a pipeline starts anew there.
    ///
    /// # Panics
    /// If the path has no camera `k`.
    #[must_use]
    pub fn poses_between(&self, path: &CameraPath, k: usize) -> Vec<Camera> {
        let cameras = path.cameras();
        let before = match k.checked_sub(1) {
            None if path.is_cycle() => cameras.len() - 1,
            None => return Vec::new(),
            Some(before) => before,
        };
        match cameras[before].size() == cameras[k].size() {
            true => self.moments().map(|t| path.at(k as f64 - 1.0 + t)).collect(),
            false => Vec::new(),
        }
    }
}
