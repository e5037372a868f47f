//! What the command can fail with: one readable line each.

use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use gs3::compute::GpuError;
use gs3::raster::{GpuRasterError, RasterError};
use gs3::reconstruct::ReconstructError;
use gs3::scene::capture::CaptureError;
use gs3::scene::format::{LoadError, SaveError};
use gs3::scene::{CameraError, SceneError};
use gs3::simd::SimdError;
use gs3::{NetworkError, PipelineError};
use gs3_evaluate::methods::SpecError;
use gs3_evaluate::metrics::MetricError;
use gs3_evaluate::photos::PhotoError;
use gs3_evaluate::protocol::EvaluateError;
use gs3_evaluate::simplify::SimplifyError;
use gs3_train::clips::MakeError;
use gs3_train::{ClipError, TrainError};

/// Why a command stopped.
#[derive(Debug, thiserror::Error)]
pub enum CliError {
    #[error(transparent)]
    Load(#[from] LoadError),
    #[error(transparent)]
    Save(#[from] SaveError),
    #[error(transparent)]
    Capture(#[from] CaptureError),
    #[error("demo: {0}")]
    Demo(#[from] SceneError),
    #[error("{0}")]
    Camera(#[from] CameraError),
    #[error("{0}")]
    Network(#[from] NetworkError),
    #[error("{}: {source}", path.display())]
    Weights { path: PathBuf, source: NetworkError },
    #[error("{0}")]
    Pipeline(#[from] PipelineError),
    #[error("{0}")]
    Raster(#[from] RasterError),
    #[error("{0}")]
    Gpu(#[from] GpuError),
    #[error("{0}")]
    GpuRaster(#[from] GpuRasterError),
    #[error("{0}")]
    Reconstruct(#[from] ReconstructError),
    #[error("{0}")]
    Metric(#[from] MetricError),
    #[error("{0}")]
    Evaluate(#[from] EvaluateError),
    #[error("{0}")]
    Simplify(#[from] SimplifyError),
    #[error("--methods: {0}")]
    Spec(#[from] SpecError),
    #[error("{}; the others are in {}", failures.join("; "), report.display())]
    Methods { failures: Vec<String>, report: PathBuf },
    #[error("{0}")]
    Photos(#[from] PhotoError),
    #[error("{0}")]
    Clip(#[from] ClipError),
    #[error("{0}")]
    Clips(#[from] MakeError),
    #[error("{0}")]
    Train(#[from] TrainError),
    #[error("{}: cannot be written: {source}", path.display())]
    Write { path: PathBuf, source: io::Error },
    #[error("{}: cannot be read: {source}", path.display())]
    Read { path: PathBuf, source: io::Error },
    #[error("{}: {message}", path.display())]
    Manifest { path: PathBuf, message: String },
    #[error("standard output: cannot be written: {0}")]
    Print(io::Error),
    #[error("{option}: expected {expected}, found {actual}")]
    Option { option: &'static str, expected: String, actual: String },
    #[error("--threads: the thread pool did not start: {message}")]
    Threads { message: String },
    #[error(transparent)]
    Simd(#[from] SimdError),
    #[cfg(feature = "view")]
    #[error("{0}")]
    Window(#[from] gs3_viewer::window::WindowError),
    #[error("Ctrl-C cannot be handled: {0}")]
    Interrupt(#[from] ctrlc::Error),
    #[error("{}: {message}; the frames are in {}, and {by_hand} makes a video of them", path.display(), frames.display())]
    Video { path: PathBuf, message: String, frames: PathBuf, by_hand: String },
}

impl CliError {
    pub fn write(path: &Path) -> impl Fn(io::Error) -> Self + '_ {
        move |source| Self::Write { path: path.to_path_buf(), source }
    }

    /// Whether the same command may succeed later or elsewhere: the machine, not what it was asked for, was at fault.
    pub fn may_pass(&self) -> bool {
        let is_passing = |error: &io::Error| {
            // What is missing or forbidden stays so; a full disk or a server that does not answer may not.
            !matches!(
                error.kind(),
                ErrorKind::NotFound
                    | ErrorKind::PermissionDenied
                    | ErrorKind::AlreadyExists
                    | ErrorKind::NotADirectory
                    | ErrorKind::IsADirectory
                    | ErrorKind::InvalidInput
                    | ErrorKind::InvalidData
                    | ErrorKind::InvalidFilename
                    | ErrorKind::ReadOnlyFilesystem
                    | ErrorKind::FileTooLarge
                    | ErrorKind::UnexpectedEof
            )
        };
        match self {
            Self::Write { source, .. } | Self::Read { source, .. } => is_passing(source),
            Self::Load(LoadError::Io { source, .. }) => is_passing(source),
            Self::Load(LoadError::Memory { .. }) => true,
            // A GPU that is not there or lacks a feature stays so.
            Self::Gpu(error) | Self::Pipeline(PipelineError::Gpu(error)) => {
                !matches!(error, GpuError::NoAdapter { .. } | GpuError::Unsupported { .. })
            }
            Self::Threads { .. } => true,
            _ => false,
        }
    }

    /// The message on a single line, also with line breaks in file names or messages of libraries.
    pub fn one_line(&self) -> String {
        single_line(&self.to_string())
    }
}

/// `text` without its line breaks.
pub fn single_line(text: &str) -> String {
    text.split(['\n', '\r']).map(str::trim).collect::<Vec<_>>().join(" ")
}
