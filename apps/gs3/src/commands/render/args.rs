//! Arguments of `gs3 render`.

use std::path::PathBuf;

use clap::ValueEnum;
use gs3::Mode;

use crate::cli::options::{Aov, AovFormat, Device, FrameOptions, SceneOptions, View};
use crate::cli::values::FrameRange;

#[derive(Debug, clap::Args)]
pub struct RenderArgs {
    #[command(flatten)]
    pub view: View,
    #[command(flatten)]
    pub scene_options: SceneOptions,
    /// Frames of the path, the last one excluded [default: all; the first one for FILE.png and FILE.exr]
    #[arg(long, value_name = "A..B", allow_hyphen_values = true)]
    pub frames: Option<FrameRange>,
    /// Most frames before A that are rendered and not shown [default: as many as it takes for the bits of one run over the whole
    /// path, at most 48 at scale 4 and 68 at scale auto with the default --keyframes]
    #[arg(long, value_name = "N")]
    pub warm_up: Option<usize>,
    /// Render only frames that the folder lacks
    #[arg(long)]
    pub skip_existing: bool,
    /// Render this many frames along the smooth curve through the cameras, at constant speed
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub smooth: Option<u32>,
    /// How frames are made
    #[arg(long, default_value = "full")]
    pub mode: ModeArg,
    #[command(flatten)]
    pub frame_options: FrameOptions,
    #[command(flatten)]
    pub device: Device,
    /// Folder for PNG frames, FILE.png or FILE.exr (linear light) for a single frame, or FILE.mp4 for a video with its
    /// frames in folder FILE.
    /// Frames are numbered as they are shown: frame K of the path is number K, in mode `full` K · (in_between + 1), with
    /// those between before it
    #[arg(long, value_name = "DIR|FILE.png|FILE.exr|FILE.mp4")]
    pub out: PathBuf,
    /// Write RGBA: transparent where nothing is, straight alpha, instead of a background. Takes about twice as long, as
    /// alpha is reconstructed as colours are
    #[arg(long, conflicts_with = "background")]
    pub alpha: bool,
    /// Also write each frame in numbers, beside its PNG file: linear colour and depth, normal or motion, separated by
    /// commas. They are rasterized natively, which takes longer than a frame in mode `native`
    #[arg(long, value_name = "depth,normal,motion", value_delimiter = ',')]
    pub aov: Vec<Aov>,
    /// Format of these files
    #[arg(long, value_name = "exr|npz", default_value = "exr", requires = "aov")]
    pub aov_format: AovFormat,
    /// Also compare with native rendering: write the last frame's middle (native, bicubic, this mode), and say how much
    /// faster than native up to 8 frames were
    #[arg(long, value_name = "FILE.png")]
    pub compare: Option<PathBuf>,
    /// Write figures of the run
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum ModeArg {
    /// Every pixel rasterized
    Native,
    /// Low resolution, bicubic interpolation
    Bicubic,
    /// Low resolution, super-sampled over time
    SuperSample,
    /// Super-sampled, with interpolated frames before each rendered one (--in-between)
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
