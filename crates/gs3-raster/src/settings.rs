//! The settings of a rasterized frame.

use gs3_scene::{BLOCK_SIDE, Margin, Size};

/// The inverse of [`MIN_ALPHA`], which is rounded: its own inverse would be 254.99998.
pub(crate) const MIN_ALPHA_INVERSE: f32 = 255.0;

/// A contribution below this is not blended (Kerbl et al. 2023).
pub(crate) const MIN_ALPHA: f32 = 1.0 / MIN_ALPHA_INVERSE;

/// Dilation of the projected covariance in px² that 3D Gaussian Splatting trains with (Kerbl et al. 2023).
pub const KERBL_DILATION: f32 = 0.3;

/// The matched dilation in px² of a grid `scale` times coarser. Low-resolution samples are then exact point samples
/// of the high-resolution image rendered with [`KERBL_DILATION`]: lengths shrink by `scale`, areas by its square.
#[must_use]
pub fn matched_dilation(scale: u32) -> f32 {
    KERBL_DILATION / (scale as f32 * scale as f32)
}

/// Widest margin beyond an edge of the picture, in pixels. A turn by 32 of 480 pixels in a few frames is fast, and
/// margins of 48 and 64 pixels gain only 0.01 to 0.02 dB more (`docs/performance.md`). Memory for margins is
/// allocated for this width.
pub const MAX_MARGIN: u32 = 32;

/// Largest scale of a low-resolution frame with exact blocks.
pub(crate) const MAX_BLOCK_SCALE: u32 = 8;

/// Which tiles a splat is assigned to.
///
/// The last three cover the whole support of a splat (contribution ≥ 1/255) and give identical images. The first two
/// cut the support as published, so that opaque splats lose the rim outside of the tiles that their box touches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Culling {
    /// 3DGS (Kerbl et al. 2023): a square of radius ⌈3√λmax⌉, in whole 16×16 tiles.
    Aabb3Sigma,
    /// AdR-Gaussian (Wang et al. 2024): per axis min(3σ, ⌈√(2 ln(255 o) Σii)⌉), in whole 16×16 tiles.
    Adr,
    /// Speedy-Splat's SnugBox (Hanson et al. 2025): the tight box of the support.
    SnugBox,
    /// Speedy-Splat's AccuTile: the support's exact extent per row of tiles.
    #[default]
    AccuTile,
    /// The exact test of StopThePop (Radl et al. 2024): largest contribution within the tile.
    Exact,
}

impl Culling {
    /// The name in the command and in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Aabb3Sigma => "aabb3sigma",
            Self::Adr => "adr",
            Self::SnugBox => "snugbox",
            Self::AccuTile => "accutile",
            Self::Exact => "exact",
        }
    }
}

/// A part of an image, in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// Columns of the image left of the window.
    pub left: u32,
    /// Rows of the image above the window.
    pub top: u32,
    /// Columns of the window, at least 1.
    pub width: u32,
    /// Rows of the window, at least 1.
    pub height: u32,
}

impl Window {
    pub(crate) const fn size(self) -> Size {
        Size::new(self.width, self.height)
    }

    /// Checks that the window lies in an image of `size` and is not empty.
    pub(crate) fn check(self, size: Size) -> Result<(), RasterError> {
        let fits = |first: u32, count: u32, side| {
            count > 0 && first.checked_add(count).is_some_and(|end| end <= side)
        };
        match fits(self.left, self.width, size.width) && fits(self.top, self.height, size.height) {
            true => Ok(()),
            false => Err(RasterError::Window { size, actual: self }),
        }
    }
}

/// Which planes to produce.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Outputs {
    /// Colour and alpha.
    Color,
    /// Colour, alpha, ∂/∂x and ∂/∂y of colour, and median depth: what reconstruction without networks reads. GPUs make the planes of
    /// [`Outputs::GBuffer`].
    Samples,
    /// [`Outputs::Samples`], expected depth and normal.
    GBuffer,
    /// [`Outputs::GBuffer`] and the mixed derivative ∂²/∂x∂y of colour.
    GBufferMixed,
}

/// The differences between implementations of 3D Gaussian Splatting. A scene is rendered by the rules that it was
/// trained with.
///
/// GPUs support [`Rules::KERBL`] only.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rules {
    /// Gaussians nearer than this view-space z are culled, in world units, finite and positive. If there is no value,
    /// the scene's own near plane is used ([`gs3_scene::Details::near`]).
    pub near: Option<f32>,
    /// Gaussians at or beyond this view-space z are culled, in world units, positive; infinite to show all.
    pub far: f32,
    /// Cap of a contribution α, above 1/255 and below 1.
    pub max_alpha: f32,
    /// Smallest factor on opacity in antialiased scenes, `[0, 1]`.
    pub min_compensation: f32,
    /// The depths that [`Geometry::depth_expected`](gs3_scene::Geometry::depth_expected) averages.
    pub expected_depth: ExpectedDepth,
}

impl Rules {
    /// 3D Gaussian Splatting as published (Kerbl et al. 2023; Mip-Splatting, Yu et al. 2024, where scenes are
    /// antialiased), with depths of surfaces.
    pub const KERBL: Self = Self {
        near: None,
        far: f32::INFINITY,
        max_alpha: 0.99,
        min_compensation: 0.005,
        expected_depth: ExpectedDepth::Surface,
    };

    /// The rules of gsplat: its default planes, cap and depths.
    pub const GSPLAT: Self = Self {
        near: Some(0.01),
        far: 1e10,
        max_alpha: 0.999,
        min_compensation: 0.0,
        expected_depth: ExpectedDepth::Centers,
    };

    fn check(&self) -> Result<(), RasterError> {
        if let Some(actual) = self.near.filter(|near| !(near.is_finite() && *near > 0.0)) {
            return Err(RasterError::Near { actual });
        }
        if self.far.is_nan() || self.far <= 0.0 {
            return Err(RasterError::Far { actual: self.far });
        }
        if !(self.max_alpha > MIN_ALPHA && self.max_alpha < 1.0) {
            return Err(RasterError::MaxAlpha { actual: self.max_alpha });
        }
        if !(0.0..=1.0).contains(&self.min_compensation) {
            return Err(RasterError::MinCompensation { actual: self.min_compensation });
        }
        Ok(())
    }
}

/// The depths that a mean depth averages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ExpectedDepth {
    /// Depths where the pixel's ray meets each Gaussian (RaDe-GS, Zhang et al. 2024).
    #[default]
    Surface,
    /// Depths of the Gaussians' centres (gsplat).
    Centers,
}

/// Settings of one rasterized frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RasterSettings {
    /// Planes to produce.
    pub outputs: Outputs,
    /// ε added to the projected covariance's diagonal, in px² of the grid being rendered, finite and not negative.
    pub dilation: f32,
    /// Offset of the sample positions from the pixel centres, in pixels of the grid being rendered, within ±1.
    pub jitter: [f32; 2],
    /// The margin rasterized around the picture, each side within [`MAX_MARGIN`]. The picture is the same with any
    /// margin, except for the rounding of positions. Images have no margin.
    pub margin: Margin,
    /// Background colour, display-encoded RGB, finite.
    pub background: [f32; 3],
    /// The differences between implementations of 3D Gaussian Splatting.
    pub rules: Rules,
}

impl RasterSettings {
    /// Kerbl's dilation, no jitter, black background, [`Rules::KERBL`].
    #[must_use]
    pub const fn new(outputs: Outputs) -> Self {
        Self {
            outputs,
            dilation: KERBL_DILATION,
            jitter: [0.0; 2],
            margin: Margin::NONE,
            background: [0.0; 3],
            rules: Rules::KERBL,
        }
    }

    /// Checks the documented range of each field.
    ///
    /// # Errors
    /// [`RasterError`] with the field, the expected and the actual value.
    pub fn check(&self) -> Result<(), RasterError> {
        if !(self.dilation.is_finite() && self.dilation >= 0.0) {
            return Err(RasterError::Dilation { actual: self.dilation });
        }
        if !self.jitter.iter().all(|v| v.abs() <= 1.0) {
            return Err(RasterError::Jitter { actual: self.jitter });
        }
        if self.margin.widest() > MAX_MARGIN {
            return Err(RasterError::Margin { actual: self.margin.widest() });
        }
        if !self.background.iter().all(|v| v.is_finite()) {
            return Err(RasterError::Background { actual: self.background });
        }
        self.rules.check()
    }

    /// Checks that a frame `scale` times coarser than its camera's image can have exact blocks.
    ///
    /// # Errors
    /// [`RasterError::Scale`] if `scale` is not 1 to 8; [`RasterError::MarginBlocks`] if the margin does not start at a block.
    pub(crate) fn check_blocks(&self, scale: u32) -> Result<(), RasterError> {
        if !(1..=MAX_BLOCK_SCALE).contains(&scale) {
            return Err(RasterError::Scale { actual: scale });
        }
        let starts = [self.margin.left, self.margin.top];
        match starts.into_iter().find(|side| !(side * scale).is_multiple_of(BLOCK_SIDE as u32)) {
            Some(actual) => Err(RasterError::MarginBlocks { scale, actual }),
            None => Ok(()),
        }
    }
}

/// Why settings are refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RasterError {
    /// The dilation is negative or not finite.
    #[error("dilation: expected a finite number of at least 0 (px²), found {actual}")]
    Dilation {
        /// The value found.
        actual: f32,
    },
    /// The jitter is not within one pixel.
    #[error("jitter: expected two numbers within -1 and 1 (pixels), found {}, {}", actual[0], actual[1])]
    Jitter {
        /// The value found.
        actual: [f32; 2],
    },
    /// The margin is too wide.
    #[error("margin: expected at most {MAX_MARGIN} pixels beyond each edge, found {actual}")]
    Margin {
        /// The widest side.
        actual: u32,
    },
    /// The scale of a low-resolution frame is outside of the supported range.
    #[error("scale: expected 1 to 8, found {actual}")]
    Scale {
        /// The value found.
        actual: u32,
    },
    /// The margin does not start at a block of 4×4 pixels of the native image.
    #[error(
        "margin: expected its left and top side times the scale {scale} to be a multiple of 4, found {actual}"
    )]
    MarginBlocks {
        /// High-resolution over low-resolution size.
        scale: u32,
        /// The side found, in LR pixels.
        actual: u32,
    },
    /// Exact blocks share the splats of a low-resolution frame, and no such frame was made.
    #[error("exact blocks: expected a low-resolution frame with gradients and depth before, found none")]
    NoFrame,
    /// The window is empty or reaches beyond the image.
    #[error(
        "window: expected one within 0,0 and {},{}, found {}x{} from {},{}",
        size.width, size.height, actual.width, actual.height, actual.left, actual.top
    )]
    Window {
        /// The image's size.
        size: Size,
        /// The window found.
        actual: Window,
    },
    /// The background is not finite.
    #[error("background: expected three finite numbers, found {}, {}, {}", actual[0], actual[1], actual[2])]
    Background {
        /// The value found.
        actual: [f32; 3],
    },
    /// The near plane is not positive and finite.
    #[error("near plane: expected a positive finite number (world units), found {actual}")]
    Near {
        /// The value found.
        actual: f32,
    },
    /// The far plane is not positive.
    #[error("far plane: expected a positive number (world units), found {actual}")]
    Far {
        /// The value found.
        actual: f32,
    },
    /// The cap of contributions is outside of its range.
    #[error("max_alpha: expected a number above 1/255 and below 1, found {actual}")]
    MaxAlpha {
        /// The value found.
        actual: f32,
    },
    /// The smallest factor on opacity is outside of its range.
    #[error("min_compensation: expected a number from 0 to 1, found {actual}")]
    MinCompensation {
        /// The value found.
        actual: f32,
    },
    /// GPUs do not support these rules.
    #[error("rules: expected those of Kerbl et al. (Rules::KERBL), which a GPU has alone, found {actual:?}")]
    Rules {
        /// The rules found.
        actual: Rules,
    },
    /// The statistics belong to another scene.
    #[error("importance: expected values for the scene's {expected} Gaussians, found {actual}")]
    ImportanceLength {
        /// Number of Gaussians in the scene.
        expected: usize,
        /// The number found.
        actual: usize,
    },
}
