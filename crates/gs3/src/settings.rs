//! What a pipeline makes of a scene.

use std::fmt;

use gs3_raster::{Culling, STOCK_DILATION, matched_dilation};
use gs3_reconstruct::{Kriging, Sampling};
use gs3_scene::{Camera, CameraPath};

use crate::refine::{Quality, Refine};

/// How frames come about.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// Every pixel rasterized: the reference of quality and speed.
    Native,
    /// Low-resolution frames enlarged by bicubic (Catmull–Rom) interpolation of their colour: the baseline.
    Bicubic,
    /// Low-resolution G-buffers super-sampled over time.
    SuperSample,
    /// [`Mode::SuperSample`], and interpolated frames before each rendered one: with one of them
    /// ([`PipelineSettings::in_between`]) two frames are shown per frame rasterized.
    #[default]
    Full,
}

impl Mode {
    /// Whether frames depend on the ones before.
    #[must_use]
    pub const fn has_history(self) -> bool {
        matches!(self, Self::SuperSample | Self::Full)
    }

    /// Its name at the command and in reports.
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

/// The dilation ε of projected covariances, in px² of the grid being rasterized.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Dilation {
    /// 0.3 / S²: low-resolution samples are exact samples of the native image.
    #[default]
    Matched,
    /// 0.3 at any resolution, as 3D Gaussian Splatting renders and the paper assumes: a blurrier signal.
    Stock,
    /// Any other value, finite and not negative.
    Value(f32),
}

impl Dilation {
    /// The value for a grid `scale` times coarser than the image shown.
    #[must_use]
    pub fn at_scale(self, scale: u32) -> f32 {
        match self {
            Self::Matched => matched_dilation(scale),
            Self::Stock => STOCK_DILATION,
            Self::Value(value) => value,
        }
    }
}

/// As at the command and in reports.
impl fmt::Display for Dilation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Matched => write!(f, "matched"),
            Self::Stock => write!(f, "stock"),
            Self::Value(value) => write!(f, "{value}"),
        }
    }
}

/// Settings of a [`crate::FramePipeline`], fixed at its construction but for
/// [`refine`](crate::FramePipeline::set_refine).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PipelineSettings {
    /// How frames come about.
    pub mode: Mode,
    /// High-resolution over low-resolution size, 1 to [`gs3_reconstruct::MAX_SCALE`]. Not read by [`Mode::Native`].
    pub scale: u32,
    /// Where low-resolution frames are sampled. Not read by [`Mode::Native`].
    pub sampling: Sampling,
    /// Which pixels that first-order predictions leave uncertain are kriged. Where a network refines frames they are
    /// kriged whatever this says: coarsely below one of tier fast, finely below one of tier high. Read by
    /// [`Mode::SuperSample`] and [`Mode::Full`].
    pub kriging: Kriging,
    /// Whether LR frames are rasterized beyond the edges that the camera turns to, so that what the next frames
    /// reveal has a past. Where a network refines frames they are, whatever this says. Read by [`Mode::SuperSample`]
    /// and [`Mode::Full`].
    pub overscan: bool,
    /// Which pixels are rasterized exactly. Read by [`Mode::SuperSample`] and [`Mode::Full`] on a CPU.
    pub refine: Refine,
    /// What [`Refine::Auto`] may spend.
    pub quality: Quality,
    /// Every so many frames all begins anew, 0 for never: frames whose number on their path
    /// ([`FramePipeline::set_frame_number`](crate::FramePipeline::set_frame_number)) is a multiple are keyframes. What follows a
    /// keyframe depends on no frame before it, so parts of a path can be rendered apart
    /// ([`FramePipeline::first_of_warm_up`](crate::FramePipeline::first_of_warm_up)). Where [`Refine`] starts exact, a keyframe is
    /// rasterized exactly as a whole; elsewhere only the sampling offsets begin anew. Not read by [`Mode::Native`].
    pub keyframes: u32,
    /// Dilation of the projected covariances. Exact pixels are those of a native image with [`Dilation::Matched`].
    pub dilation: Dilation,
    /// Which tiles a splat is assigned to.
    pub culling: Culling,
    /// Frames interpolated before each rendered one in [`Mode::Full`], 1 to [`MAX_IN_BETWEEN`].
    pub in_between: u32,
    /// Background, display-encoded RGB, finite.
    pub background: [f32; 3],
}

impl Default for PipelineSettings {
    fn default() -> Self {
        Self {
            mode: Mode::default(),
            scale: 4,
            sampling: Sampling::default(),
            kriging: Kriging::default(),
            overscan: false,
            refine: Refine::default(),
            quality: Quality::default(),
            keyframes: KEYFRAMES,
            dilation: Dilation::default(),
            culling: Culling::default(),
            in_between: 1,
            background: [0.0; 3],
        }
    }
}

/// Frames from one keyframe to the next where nothing else is said.
pub const KEYFRAMES: u32 = 32;

/// Most frames interpolated between two rendered ones.
pub const MAX_IN_BETWEEN: u32 = 3;

impl PipelineSettings {
    /// Frames shown for each rendered one but the first, which always is a single frame.
    #[must_use]
    pub const fn displayed_per_rendered(&self) -> usize {
        match self.mode {
            Mode::Full => self.in_between as usize + 1,
            Mode::Native | Mode::Bicubic | Mode::SuperSample => 1,
        }
    }

    /// Moments of the frames interpolated before a rendered one, in (0, 1), in order.
    pub fn moments(&self) -> impl Iterator<Item = f64> + use<> {
        let count = self.displayed_per_rendered();
        (1..count).map(move |k| k as f64 / count as f64)
    }

    /// The true cameras of the frames before rendered frame `k` of `path`, where the path knows them. Between frames of
    /// different size nothing lies: no size would be theirs, and a pipeline starts anew there.
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
        let size = |camera: &Camera| (camera.width(), camera.height());
        match size(&cameras[before]) == size(&cameras[k]) {
            true => self.moments().map(|t| path.at(k as f64 - 1.0 + t)).collect(),
            false => Vec::new(),
        }
    }
}
