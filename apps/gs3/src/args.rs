//! The command line.

use std::path::{Path, PathBuf};

use clap::{Parser, Subcommand, ValueEnum};
use gs3::compute::OptionalFeatures;
use gs3::neural::Arithmetic;
use gs3::neural::model::Tier;
use gs3::{
    Backend, Culling, KEYFRAMES, Kriging, MAX_GENERATE, Mode, PipelineSettings, Quality, Refine, Sampling,
};

use crate::evaluate::EvaluateArgs;
use crate::export::ExportArgs;
use crate::levels::Levels;
use crate::simplify::SimplifyArgs;
use crate::train::{BaselineArgs, TrainArgs};
use crate::train_clips::ClipsArgs;
use crate::values::{Degrees, DilationArg, FrameRange, Pair, Rgb, Size, scale};

/// What the command reads from its environment.
const ENVIRONMENT: &str = "Environment:
  GS3_SIMD  SIMD level of all CPU kernels: scalar, sse2, sse4.2, avx2, avx512 or neon [default: the best that the processor has]";

/// Shows trained 3D Gaussian Splatting scenes sharp and fluid.
#[derive(Debug, Parser)]
#[command(name = "gs3", version, about, after_help = ENVIRONMENT)]
pub struct Args {
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Render frames or a video along a camera path
    Render(RenderArgs),
    /// Make a video of the frames that renders of parts of a path wrote
    Join(JoinArgs),
    /// Show a scene in a window
    #[cfg(feature = "view")]
    View(crate::view::ViewArgs),
    /// Write one frame's G-buffer as NumPy arrays
    Gbuffer(GbufferArgs),
    /// Say what is in a scene
    Info(InfoArgs),
    /// Convert a scene to another format (.ply, .compressed.ply, .spz, .sog, .glb, .splat)
    Convert(ConvertArgs),
    /// Measure displayed frames per second against native rendering
    Bench(BenchArgs),
    /// Judge quality and speed against native rendering and against other methods
    Evaluate(EvaluateArgs),
    /// Keep the Gaussians that matter most to given cameras
    Simplify(SimplifyArgs),
    /// List GPU adapters, what they can do, and which one is taken
    Devices(DevicesArgs),
    /// Train networks
    #[command(subcommand)]
    Train(Train),
    /// Write a network with its weights as an ONNX file
    Export(ExportArgs),
}

#[derive(Debug, Subcommand)]
pub enum Train {
    /// Render clips from scenes, to train and validate on
    Clips(ClipsArgs),
    /// Train the network from low to high resolution on clips
    SuperSample(TrainArgs),
    /// Train the network for frames between frames on clips
    Interpolate(TrainArgs),
    /// Train a published single-image network on the clips of super sampling, to compare with
    Baseline(BaselineArgs),
}

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
    /// Image size [default: that of the cameras, 1920x1080 without --path]
    #[arg(long, value_name = "WxH", allow_hyphen_values = true)]
    pub size: Option<Size>,
    /// Threads [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

/// What is known of cameras whose file does not say it.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct StatedCameras {
    /// Vertical field of view of the cameras, degrees [default: what their file says]
    #[arg(long, value_name = "DEGREES")]
    pub fov: Option<Degrees>,
    /// nerfstudio's dataparser_transforms.json, into whose frame the cameras are brought [default: the one beside a
    /// transforms.json, if there is one]
    #[arg(long, value_name = "FILE")]
    pub dataparser: Option<PathBuf>,
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
pub struct Look {
    /// How large an error may be left, and how many pixels may be rasterized exactly for it: fast 3 steps of 8 bits and 3 %,
    /// balanced 1 and 6 %, high half a step and 15 %
    #[arg(long, default_value = "balanced", value_name = "fast|balanced|high")]
    pub quality: QualityArg,
    /// Pixels rasterized exactly, where reconstruction is not to be trusted: none, those that --quality says, this share of
    /// all (0 to 1), or as many as fit into a frame of so many milliseconds (33ms). On the CPU
    #[arg(long, default_value = "auto", value_name = "off|auto|SHARE|TIMEms", allow_hyphen_values = true)]
    pub refine: Refine,
    /// High-resolution over low-resolution size
    #[arg(long, default_value_t = 4, value_name = "S", value_parser = scale(1))]
    pub scale: u32,
    /// Networks that improve the frames: none (analytic) or the paper's in three sizes. They take a few times as long
    #[arg(long, value_name = "TIER", default_value = "analytic", conflicts_with = "weights", help_heading = ADVANCED)]
    pub tier: TierArg,
    /// How frames between are made: warped without learning, or refined by the tier's network as well, which takes a
    /// few times as long
    #[arg(long, default_value = "analytic", value_name = "analytic|learned", conflicts_with = "weights", help_heading = ADVANCED)]
    pub interpolation: InterpolationArg,
    /// Weights of super sampling or of interpolation; may be given once for each. Without weights of super sampling
    /// frames are made without learning; without weights of interpolation frames between are warped without learning
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
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_GENERATE)))]
    pub generate: u32,
    /// Sub-pixel offsets of the low-resolution frames
    #[arg(long, default_value = "on", value_name = "on|off", help_heading = ADVANCED)]
    pub jitter: Switch,
    /// Krige pixels that first-order predictions leave uncertain, without networks too; with them it is always done.
    /// Sharper in motion, and takes longer; `coarse` less so, as below tier fast, `fine` more so, as below tier high
    #[arg(long, value_name = "coarse|on|fine", num_args = 0..=1, require_equals = true, default_missing_value = "on", help_heading = ADVANCED)]
    pub kriging: Option<KrigingArg>,
    /// Rasterize beyond the edges that the camera turns to, without networks too; with them it is always done. Sharper
    /// there, and takes a little longer
    #[arg(long, help_heading = ADVANCED)]
    pub overscan: bool,
    /// Frames from one keyframe to the next, where the history begins anew, so that parts of a path can be rendered apart;
    /// 0 for none
    #[arg(long, default_value_t = KEYFRAMES, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=1_000_000), help_heading = ADVANCED)]
    pub keyframes: u32,
    /// Dilation of splats in px² of the rendered grid: matched (0.3/S²), stock (0.3) or a number
    #[arg(long, default_value = "matched", value_name = "matched|stock|VALUE", allow_hyphen_values = true, help_heading = ADVANCED)]
    pub dilation: DilationArg,
    /// Which tiles a splat is assigned to
    #[arg(long, default_value = "accutile", help_heading = ADVANCED)]
    pub culling: CullingArg,
    /// Background colour, each from 0 to 1
    #[arg(long, default_value = "0,0,0", value_name = "R,G,B", allow_hyphen_values = true)]
    pub background: Rgb,
}

/// Heading in the help of what few need.
const ADVANCED: &str = "Advanced";

#[derive(Debug, clap::Args)]
pub struct RenderArgs {
    #[command(flatten)]
    pub view: View,
    #[command(flatten)]
    pub levels: Levels,
    /// Frames of the path, the last one excluded [default: all; the first one for FILE.png]
    #[arg(long, value_name = "A..B", allow_hyphen_values = true)]
    pub frames: Option<FrameRange>,
    /// Most frames before A that are rendered and not shown. Without this option as many as it takes for the bits of one
    /// run over the whole path, up to 48
    #[arg(long, value_name = "N")]
    pub warm_up: Option<usize>,
    /// Render only frames that the folder lacks
    #[arg(long)]
    pub skip_existing: bool,
    /// Render this many frames along the smooth curve through the cameras, at constant speed
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub smooth: Option<u32>,
    /// How frames come about; `full` shows two frames per rendered one
    #[arg(long, default_value = "full")]
    pub mode: ModeArg,
    #[command(flatten)]
    pub look: Look,
    #[command(flatten)]
    pub device: Device,
    /// Folder for PNG frames, FILE.png for a single frame, or FILE.mp4 for a video with its frames in folder FILE.
    /// Frames are numbered as they are shown: frame K of the path is number K, in mode `full` K · (generate + 1), with
    /// those between before it
    #[arg(long, value_name = "DIR|FILE.png|FILE.mp4")]
    pub out: PathBuf,
    /// Write RGBA: transparent where nothing is, straight alpha, instead of a background. Takes about twice as long, as
    /// alpha is reconstructed as colours are
    #[arg(long, conflicts_with = "background")]
    pub alpha: bool,
    /// Also compare with native rendering: write the last frame's middle (native, bicubic, this mode), and say how much
    /// faster than native up to 8 frames were
    #[arg(long, value_name = "FILE.png")]
    pub compare: Option<PathBuf>,
    /// Write figures of the run
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
pub struct JoinArgs {
    /// Folder of frames that gs3 render wrote
    pub frames: PathBuf,
    /// Numbers of the frames, the last one excluded [default: all of the path]
    #[arg(long = "frames", value_name = "A..B", allow_hyphen_values = true)]
    pub numbers: Option<FrameRange>,
    /// Video
    #[arg(long, value_name = "FILE.mp4")]
    pub out: PathBuf,
}

#[derive(Debug, clap::Args)]
pub struct GbufferArgs {
    #[command(flatten)]
    pub view: View,
    #[command(flatten)]
    pub levels: Levels,
    /// Frame of the path
    #[arg(long, default_value_t = 0, value_name = "K")]
    pub frame: usize,
    /// High-resolution over this resolution, for `--dilation matched`
    #[arg(long, default_value_t = 4, value_name = "S", value_parser = scale(1))]
    pub scale: u32,
    /// Offset of the samples from the pixel centres
    #[arg(long, default_value = "0,0", value_name = "X,Y", allow_hyphen_values = true)]
    pub jitter: Pair,
    /// Dilation of splats in px² of the rendered grid: matched (0.3/S²), stock (0.3) or a number
    #[arg(long, default_value = "matched", value_name = "matched|stock|VALUE", allow_hyphen_values = true)]
    pub dilation: DilationArg,
    /// Which tiles a splat is assigned to
    #[arg(long, default_value = "accutile")]
    pub culling: CullingArg,
    /// Background colour, each from 0 to 1
    #[arg(long, default_value = "0,0,0", value_name = "R,G,B", allow_hyphen_values = true)]
    pub background: Rgb,
    #[command(flatten)]
    pub device: Device,
    /// Also write the mixed derivative color_dxy
    #[arg(long)]
    pub mixed: bool,
    /// Output file: f32 arrays [H, W] or [H, W, 3] `color` (display-encoded RGB), `color_dx`, `color_dy` and
    /// `color_dxy` (its derivatives per pixel of this grid), `depth_median` and `depth_expected` (along the view's z,
    /// in the scene's unit, 0 where nothing was hit), `normal` (in view space: x right, y down, z forward; accumulated
    /// with the weights of the colour, so shorter than 1 where splats differ) and `alpha`
    #[arg(long, value_name = "FILE.npz")]
    pub out: PathBuf,
}

#[derive(Debug, clap::Args)]
pub struct InfoArgs {
    /// Scene file or folder, or `demo` for the built-in scene
    pub scene: PathBuf,
    #[command(flatten)]
    pub levels: Levels,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, clap::Args)]
pub struct DevicesArgs {
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, clap::Args)]
pub struct ConvertArgs {
    /// Scene file or folder, or `demo` for the built-in scene
    pub input: PathBuf,
    /// Output file: .ply, .compressed.ply, .spz, .sog, .glb or .splat
    pub output: PathBuf,
    /// Version of .spz files: 3 for programs that do not know 4 yet
    #[arg(long, value_name = "3|4", value_parser = clap::value_parser!(u8).range(3..=4))]
    pub spz_version: Option<u8>,
    #[command(flatten)]
    pub levels: Levels,
}

#[derive(Debug, clap::Args)]
pub struct BenchArgs {
    #[command(flatten)]
    pub view: View,
    #[command(flatten)]
    pub levels: Levels,
    /// Frames of the path, the last one excluded [default: the first 20]
    #[arg(long, value_name = "A..B", allow_hyphen_values = true)]
    pub frames: Option<FrameRange>,
    #[command(flatten)]
    pub look: Look,
    /// What is measured: `cpu` all that a displayed frame takes, `gpu` the stages of frames by the device's clock
    #[arg(long, default_value = "cpu", value_name = "cpu|gpu")]
    pub backend: BenchBackendArg,
    /// A GPU by its number [default: the fastest]
    #[arg(long, value_name = "N")]
    pub adapter: Option<usize>,
    /// Copies of the scene, side by side: what a larger scene would take
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub copies: u32,
    /// Frames before the measured ones with `--backend gpu`
    #[arg(long, default_value_t = 30, value_name = "N")]
    pub warm_up: usize,
    /// Also measure the stages of the CPU rasterizer
    #[arg(long)]
    pub stages: bool,
    /// Write the figures
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

impl Look {
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
            generate: self.generate,
            background: self.background.0,
        }
    }
}

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

/// What makes frames between.
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
pub enum ModeArg {
    /// Every pixel rasterized
    Native,
    /// Low resolution, bicubic interpolation
    Bicubic,
    /// Low resolution, super-sampled over time
    SuperSample,
    /// Super-sampled, with an interpolated frame before each rendered one
    Full,
}

impl From<ModeArg> for Mode {
    fn from(mode: ModeArg) -> Self {
        match mode {
            ModeArg::Native => Self::Native,
            ModeArg::Bicubic => Self::Bicubic,
            ModeArg::SuperSample => Self::SuperSample,
            ModeArg::Full => Self::Full,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum BenchBackendArg {
    Cpu,
    Gpu,
}

impl From<BenchBackendArg> for Backend {
    fn from(backend: BenchBackendArg) -> Self {
        match backend {
            BenchBackendArg::Cpu => Self::Cpu,
            BenchBackendArg::Gpu => Self::Gpu,
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
    #[value(name = "aabb3sigma")]
    Aabb3Sigma,
    Adr,
    #[value(name = "snugbox")]
    SnugBox,
    #[value(name = "accutile")]
    AccuTile,
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
