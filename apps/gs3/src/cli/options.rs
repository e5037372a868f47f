//! Options that several commands have.

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use gs3::compute::OptionalFeatures;
use gs3::neural::Arithmetic;
use gs3::neural::model::Tier;
use gs3::scene::{Axes, Size};
use gs3::{
    Backend, Culling, IN_BETWEEN, KEYFRAMES, Kriging, MAX_IN_BETWEEN, Mode, PipelineSettings, Quality,
    Refine, Sampling, Scale,
};

use super::memory;
use super::values::{Bytes, Degrees, DilationArg, Distance, Rgb, camera_size};

/// What to look at.
#[derive(Debug, clap::Args)]
pub struct View {
    /// Scene file or folder, or `demo` for the built-in scene
    pub scene: PathBuf,
    /// Cameras: COLMAP model, transforms.json, cameras.json, camera_path.json, settings of SuperSplat or RealityScan's CSV
    /// [default: an orbit]
    #[arg(long, value_name = "CAMERAS")]
    pub path: Option<PathBuf>,
    #[command(flatten)]
    pub stated: StatedCameras,
    /// Image size [default: the size of the cameras, 1920x1080 without --path]
    #[arg(long, value_name = "WxH", allow_hyphen_values = true, value_parser = camera_size)]
    pub size: Option<Size>,
    /// Threads [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

impl View {
    /// What is read.
    pub fn inputs(&self) -> impl Iterator<Item = &Path> {
        [self.scene.as_path()]
            .into_iter()
            .chain(self.path.as_deref())
            .chain(self.stated.dataparser.as_deref())
    }
}

/// What is known of cameras and missing in their file.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct StatedCameras {
    /// Vertical field of view of the cameras, degrees [default: what their file says]
    #[arg(long, value_name = "DEGREES")]
    pub fov: Option<Degrees>,
    /// nerfstudio's dataparser_transforms.json; the cameras are brought into its frame [default: the one beside a
    /// transforms.json, if there is one]
    #[arg(long, value_name = "FILE")]
    pub dataparser: Option<PathBuf>,
}

/// What renders.
#[derive(Debug, clap::Args)]
pub struct Device {
    /// What renders: auto is a GPU where there is one, the CPU where there is none or it is emulated
    #[arg(long, default_value_t = Backend::Auto, value_name = "auto|cpu|gpu")]
    pub backend: Backend,
    /// A GPU by its number [default: the fastest]
    #[arg(long, value_name = "N")]
    pub adapter: Option<usize>,
}

/// How the frames are made.
#[derive(Debug, clap::Args)]
pub struct FrameOptions {
    /// How large an error may be left, and how many pixels may be rasterized exactly for it: fast 12 steps of 8 bits and 8 %,
    /// balanced 5.75 and 17.5 %, high 3 and 30 %; above 1920x1080 no more
    /// pixels than there
    #[arg(long, default_value = "balanced", value_name = "fast|balanced|high")]
    pub quality: QualityArg,
    /// Pixels rasterized exactly, where reconstruction is not to be trusted: none, those that --quality says, this share of
    /// all (0 to 1), or as many as fit into a frame of so many milliseconds (33ms). A GPU has no exact pixels with a
    /// super-sampling network, and none with --culling aabb3sigma or adr
    #[arg(long, default_value = "auto", value_name = "off|auto|SHARE|TIMEms", allow_hyphen_values = true)]
    pub refine: Refine,
    /// High-resolution over low-resolution size, 1 to 8: auto is the scale of the networks, else 4 up to 2560x1440 pixels and 6
    /// above
    #[arg(long, default_value_t = Scale::Auto, value_name = "auto|S", allow_hyphen_values = true)]
    pub scale: Scale,
    /// Networks that improve the frames: none (analytic), or networks of three sizes. Frames take a few times as long. Networks
    /// are for --scale 4. The super-sampling network of tier balanced is also for --scale 2
    #[arg(long, value_name = "TIER", default_value = "analytic", conflicts_with = "weights", help_heading = ADVANCED)]
    pub tier: TierArg,
    /// How in-between frames are made: warped (analytic), or warped and refined by the network of --tier (learned), which takes a
    /// few times as long and needs --tier fast, balanced or high
    #[arg(long, default_value = "analytic", value_name = "analytic|learned", conflicts_with = "weights", help_heading = ADVANCED)]
    pub interpolation: InterpolationArg,
    /// Weights of super sampling or of interpolation; may be given once for each. Without weights of super sampling
    /// frames are made without learning; without weights of interpolation in-between frames are warped without learning
    #[arg(long, value_name = "FILE.safetensors", help_heading = ADVANCED)]
    pub weights: Vec<PathBuf>,
    /// What networks on the CPU compute with; `bf16` needs AMX (Linux) or AVX-512 BF16 and is the same as `f32`
    /// elsewhere [default: the faster on this machine]
    #[arg(long, value_name = "bf16|f32", help_heading = ADVANCED)]
    pub arithmetic: Option<ArithmeticArg>,
    /// Networks on a GPU multiply matrices in its hardware for them. Experimental: tried on a small convolution first
    #[arg(long, help_heading = ADVANCED)]
    pub matrix_products: bool,
    /// Frames interpolated before each rendered one in mode `full`
    #[arg(long, alias = "generate", default_value_t = IN_BETWEEN, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_IN_BETWEEN)))]
    pub in_between: u32,
    /// Sub-pixel offsets of the low-resolution frames
    #[arg(long, default_value = "on", value_name = "on|off", help_heading = ADVANCED)]
    pub jitter: Switch,
    /// Predict uncertain pixels from values and gradients of up to eight samples (kriging): sharper in motion, and slower.
    /// `coarse` kriges fewer pixels, `fine` more. Networks always krige: tier fast coarsely, balanced as `on`, high finely
    #[arg(long, value_name = "coarse|on|fine", num_args = 0..=1, require_equals = true, default_missing_value = "on", help_heading = ADVANCED)]
    pub kriging: Option<KrigingArg>,
    /// Rasterize beyond the edges that the camera turns to: sharper there, and a little slower. Frames with networks always do so
    #[arg(long, help_heading = ADVANCED)]
    pub overscan: bool,
    /// Frames from one keyframe to the next, 0 for none, so that parts of a path can be rendered apart. The history begins anew
    /// at a keyframe if frames have exact pixels, else only the sub-pixel offsets do. --refine TIMEms has no keyframes
    #[arg(long, default_value_t = KEYFRAMES, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=1_000_000), help_heading = ADVANCED)]
    pub keyframes: u32,
    /// Dilation of splats in px² of the rendered grid: matched (0.3/S²), kerbl (0.3, as in Kerbl et al.) or a number
    #[arg(long, default_value = "matched", value_name = "matched|kerbl|VALUE", allow_hyphen_values = true, help_heading = ADVANCED)]
    pub dilation: DilationArg,
    /// Which tiles a splat is assigned to. snugbox, accutile and exact make the same picture; the others cut the rims of splats
    #[arg(long, default_value = "accutile", help_heading = ADVANCED)]
    pub culling: CullingArg,
    /// Background colour, each from 0 to 1
    #[arg(long, default_value = "0,0,0", value_name = "R,G,B", allow_hyphen_values = true)]
    pub background: Rgb,
    /// Most memory for the CPU's lists of the splats of tiles, like 64M or 2G. A frame with longer lists is made in parts
    /// [default: a quarter of what is free, at most 256M]
    #[arg(long, value_name = "SIZE", help_heading = ADVANCED)]
    pub memory: Option<Bytes>,
}

impl FrameOptions {
    /// What a GPU is opened with.
    pub const fn features(&self) -> OptionalFeatures {
        match self.matrix_products {
            true => OptionalFeatures::Experimental,
            false => OptionalFeatures::All,
        }
    }

    pub fn settings(&self, mode: Mode) -> PipelineSettings {
        PipelineSettings {
            mode,
            scale: self.scale,
            sampling: self.jitter.into(),
            kriging: self.kriging.map_or(Kriging::Off, Into::into),
            overscan: self.overscan,
            refine: self.refine,
            quality: self.quality.into(),
            keyframes: self.keyframes,
            dilation: self.dilation.0,
            culling: self.culling.into(),
            in_between: self.in_between,
            background: self.background.0,
            list_memory: memory::for_lists(self.memory),
        }
    }
}

/// Heading in the help of what few need.
const ADVANCED: &str = "Advanced";

/// How hard the pipeline works.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum QualityArg {
    Fast,
    Balanced,
    High,
}

impl From<QualityArg> for Quality {
    fn from(quality: QualityArg) -> Self {
        match quality {
            QualityArg::Fast => Self::Fast,
            QualityArg::Balanced => Self::Balanced,
            QualityArg::High => Self::High,
        }
    }
}

/// Quality tiers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum TierArg {
    /// No network
    Analytic,
    /// 16 channels
    Fast,
    /// 32 channels
    Balanced,
    /// 48 channels
    High,
}

impl TierArg {
    /// The network's tier, if there is a network.
    pub const fn network(self) -> Option<Tier> {
        match self {
            Self::Analytic => None,
            Self::Fast => Some(Tier::Fast),
            Self::Balanced => Some(Tier::Balanced),
            Self::High => Some(Tier::High),
        }
    }
}

/// What makes in-between frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum InterpolationArg {
    Analytic,
    Learned,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ArithmeticArg {
    F32,
    Bf16,
}

impl From<ArithmeticArg> for Arithmetic {
    fn from(arithmetic: ArithmeticArg) -> Self {
        match arithmetic {
            ArithmeticArg::F32 => Self::F32,
            ArithmeticArg::Bf16 => Self::Bf16,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Switch {
    On,
    Off,
}

impl From<Switch> for Sampling {
    fn from(switch: Switch) -> Self {
        match switch {
            Switch::On => Self::Jittered,
            Switch::Off => Self::Centered,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum KrigingArg {
    Coarse,
    On,
    Fine,
}

impl From<KrigingArg> for Kriging {
    fn from(kriging: KrigingArg) -> Self {
        match kriging {
            KrigingArg::Coarse => Self::Coarse,
            KrigingArg::On => Self::On,
            KrigingArg::Fine => Self::Fine,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum CullingArg {
    /// Square of three standard deviations (Kerbl et al. 2023)
    #[value(name = "aabb3sigma")]
    Aabb3Sigma,
    /// Box by opacity, for each axis (AdR-Gaussian)
    Adr,
    /// Tight box (Speedy-Splat)
    #[value(name = "snugbox")]
    SnugBox,
    /// Exact extent in each row of tiles (Speedy-Splat)
    #[value(name = "accutile")]
    AccuTile,
    /// Exact test of each tile (StopThePop)
    Exact,
}

impl From<CullingArg> for Culling {
    fn from(culling: CullingArg) -> Self {
        match culling {
            CullingArg::Aabb3Sigma => Self::Aabb3Sigma,
            CullingArg::Adr => Self::Adr,
            CullingArg::SnugBox => Self::SnugBox,
            CullingArg::AccuTile => Self::AccuTile,
            CullingArg::Exact => Self::Exact,
        }
    }
}

/// How a scene file is read: what to take of a streamed scene, which holds several representations of itself, and what
/// a file does not say.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
pub struct SceneOptions {
    /// Level of detail of a streamed scene (lod-meta.json), 0 the finest [default: the finest that each part of it has]
    #[arg(long, value_name = "N")]
    pub lod: Option<u32>,
    /// Gaussians to show of a streamed scene, at most: each part at the level that leaves the least error in the images of
    /// --path. The environment comes on top
    #[arg(long, value_name = "N", conflicts_with = "lod")]
    pub budget: Option<u64>,
    /// Whether the environment of a streamed scene (sky, far background) is part of it [default: on]
    #[arg(long, value_name = "on|off")]
    pub environment: Option<Switch>,
    /// Where x, y and z point in the scene file, as rdf (right, down, front), rub (right, up, back) or luf [default: as
    /// the file states, else as its format says: rub in SPZ, luf in glTF, rdf elsewhere]
    #[arg(long, value_name = "XYZ")]
    pub axes: Option<Axes>,
    /// Gaussians nearer to the camera than this are not shown, in world units along the view [default: 0.2, less in
    /// scenes smaller than one unit]
    #[arg(long, value_name = "DISTANCE")]
    pub near: Option<Distance>,
}

impl SceneOptions {
    /// The same options for another file, which is not streamed.
    pub const fn of_whole(self) -> Self {
        Self { lod: None, budget: None, environment: None, ..self }
    }
}

/// A quantity of every pixel besides its colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Aov {
    /// Distance along the view, in the scene's unit
    Depth,
    /// Direction of the surface, in world space
    Normal,
    /// Where the surface was in the frame before, in pixels
    Motion,
}

impl Aov {
    /// All of them, in the order of files.
    pub const ALL: [Self; 3] = [Self::Depth, Self::Normal, Self::Motion];

    pub const fn name(self) -> &'static str {
        match self {
            Self::Depth => "depth",
            Self::Normal => "normal",
            Self::Motion => "motion",
        }
    }
}

/// The format of files with quantities of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum AovFormat {
    /// OpenEXR
    Exr,
    /// NumPy arrays
    Npz,
}

impl AovFormat {
    /// The format's name, and the extension of its files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Exr => "exr",
            Self::Npz => "npz",
        }
    }
}
