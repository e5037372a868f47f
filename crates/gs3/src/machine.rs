//! Which machine renders.

use std::fmt;
use std::str::FromStr;

#[cfg(feature = "gpu")]
use gs3_compute::{AdapterChoice, Gpu, GpuError, GpuSettings, OptionalFeatures, now};

#[cfg(not(feature = "gpu"))]
use crate::error::PipelineError;

/// The choice of a machine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Backend {
    /// A GPU if there is one. The CPU if there is none, if the GPU is emulated, or after the GPU fails.
    #[default]
    Auto,
    /// The CPU.
    Cpu,
    /// A GPU, which may be an emulated one. If no GPU can be opened, or the GPU fails, there is no frame.
    Gpu,
}

impl Backend {
    /// All choices.
    pub const ALL: [Self; 3] = [Self::Auto, Self::Cpu, Self::Gpu];

    /// The choice's name in the command and in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Cpu => "cpu",
            Self::Gpu => "gpu",
        }
    }
}

impl fmt::Display for Backend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// The text that is no [`Backend`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected auto, cpu or gpu, found {actual:?}")]
pub struct BackendError {
    /// The text found.
    pub actual: String,
}

/// Reads the text that [`Backend`] prints.
impl FromStr for Backend {
    type Err = BackendError;

    fn from_str(text: &str) -> Result<Self, BackendError> {
        let named = |backend: &Self| backend.name() == text;
        Self::ALL.into_iter().find(named).ok_or_else(|| BackendError { actual: text.to_owned() })
    }
}

/// The machine that renders. Clones share a GPU.
#[derive(Clone, Debug)]
pub enum Machine {
    /// The CPU.
    Cpu,
    /// A GPU that was asked for: if it fails, there is no frame.
    #[cfg(feature = "gpu")]
    Gpu(Gpu),
    /// A GPU that was found and not asked for: if it fails, the CPU takes over.
    #[cfg(feature = "gpu")]
    FoundGpu(Gpu),
}

impl Machine {
    /// Opens the machine that `backend` means, as [`Self::open_async`] does.
    ///
    /// # Errors
    /// As [`Self::open_async`]; [`GpuError::WouldBlock`] in a browser, but for [`Backend::Cpu`].
    #[cfg(feature = "gpu")]
    pub fn open(
        backend: Backend,
        adapter: Option<usize>,
        features: OptionalFeatures,
    ) -> Result<(Self, Option<GpuError>), GpuError> {
        now(Self::open_async(backend, adapter, features))
    }

    /// Opens the machine that `backend` means. A GPU is opened with `features`. It is number `adapter` of
    /// [`gs3_compute::adapters`], if a number is given ([`Backend::Cpu`] does not read it). Without a number, [`Backend::Auto`]
    /// takes no emulated GPU. [`Backend::Auto`] takes the CPU if the GPU cannot be opened; the second value then says
    /// why.
    ///
    /// # Errors
    /// [`GpuError`] if a GPU that was asked for cannot be opened.
    #[cfg(feature = "gpu")]
    pub async fn open_async(
        backend: Backend,
        adapter: Option<usize>,
        features: OptionalFeatures,
    ) -> Result<(Self, Option<GpuError>), GpuError> {
        let open = async |adapter| Gpu::open(&GpuSettings { adapter, features }).await;
        Ok(match (backend, adapter) {
            (Backend::Cpu, _) => (Self::Cpu, None),
            (Backend::Auto | Backend::Gpu, Some(number)) => {
                (Self::Gpu(open(AdapterChoice::Number(number)).await?), None)
            }
            (Backend::Gpu, None) => (Self::Gpu(open(AdapterChoice::Auto).await?), None),
            (Backend::Auto, None) => match open(AdapterChoice::Fast).await {
                Ok(gpu) => (Self::FoundGpu(gpu), None),
                Err(GpuError::NoAdapter { .. } | GpuError::Unsupported { .. }) => (Self::Cpu, None),
                Err(error) => (Self::Cpu, Some(error)),
            },
        })
    }

    /// The machine that `backend` means.
    ///
    /// # Errors
    /// [`PipelineError::NoGpuFeature`] if a GPU is asked for.
    #[cfg(not(feature = "gpu"))]
    pub fn open(backend: Backend) -> Result<Self, PipelineError> {
        match backend {
            Backend::Auto | Backend::Cpu => Ok(Self::Cpu),
            Backend::Gpu => Err(PipelineError::NoGpuFeature),
        }
    }

    /// [`Backend::Cpu`] or [`Backend::Gpu`].
    #[must_use]
    pub const fn backend(&self) -> Backend {
        match self {
            Self::Cpu => Backend::Cpu,
            #[cfg(feature = "gpu")]
            Self::Gpu(_) | Self::FoundGpu(_) => Backend::Gpu,
        }
    }

    /// The GPU, if the machine is one.
    #[cfg(feature = "gpu")]
    #[must_use]
    pub const fn gpu(&self) -> Option<&Gpu> {
        match self {
            Self::Cpu => None,
            Self::Gpu(gpu) | Self::FoundGpu(gpu) => Some(gpu),
        }
    }

    /// The name and the interface of the GPU, if the machine is one.
    #[must_use]
    pub fn adapter(&self) -> Option<String> {
        match self {
            Self::Cpu => None,
            #[cfg(feature = "gpu")]
            Self::Gpu(gpu) | Self::FoundGpu(gpu) => {
                Some(format!("{} ({})", gpu.adapter().name, gpu.adapter().api))
            }
        }
    }

    /// Bytes that the GPU has allocated, if the machine is a GPU and its driver reports them.
    #[must_use]
    pub fn device_bytes(&self) -> Option<u64> {
        match self {
            Self::Cpu => None,
            #[cfg(feature = "gpu")]
            Self::Gpu(gpu) | Self::FoundGpu(gpu) => gpu.allocated_bytes(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn backends_read_what_they_print() {
        for backend in Backend::ALL {
            assert_eq!(backend.to_string().parse(), Ok(backend));
        }
        let error = "cuda".parse::<Backend>().unwrap_err();
        assert_eq!(error.to_string(), "expected auto, cpu or gpu, found \"cuda\"");
    }
}
