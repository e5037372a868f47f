//! Which machine renders.

use gs3::NetworkError;
use gs3::compute::{AdapterChoice, AdapterKind, Gpu, GpuSettings, OptionalFeatures, adapters, choose};
use gs3::neural::MatrixUnit;

use crate::args::{BackendArg, Device};
use crate::error::CliError;
use crate::terminal::note;

/// The machine that renders.
pub enum Machine {
    Cpu,
    /// Asked for: where it fails, the command does.
    Gpu(Gpu),
    /// Found and not asked for: where it fails, the CPU takes over.
    FoundGpu(Gpu),
}

impl Machine {
    /// The machine that `device` means, a GPU opened with `features`; its products of matrices are tried if they are among them.
    pub fn new(device: &Device, features: OptionalFeatures) -> Result<Self, CliError> {
        let machine = Self::open(device, features)?;
        if features == OptionalFeatures::Experimental {
            let gpu = machine.gpu();
            let unit = gpu.and_then(|gpu| Some((gpu, MatrixUnit::of(gpu.capabilities())?)));
            let Some((gpu, unit)) = unit else {
                return Err(CliError::Option {
                    option: "--matrix-products",
                    expected: "a GPU that has them, with subgroups of one size (gs3 devices)".to_owned(),
                    actual: machine.adapter().unwrap_or_else(|| "the CPU".to_owned()),
                });
            };
            unit.check(gpu).map_err(NetworkError::from)?;
        }
        Ok(machine)
    }

    fn open(device: &Device, features: OptionalFeatures) -> Result<Self, CliError> {
        let open = |adapter| Gpu::new(&GpuSettings { adapter, features });
        match (device.backend, device.adapter) {
            (BackendArg::Cpu, None) => Ok(Self::Cpu),
            (BackendArg::Cpu, Some(number)) => Err(CliError::Option {
                option: "--adapter",
                expected: "a GPU backend, of which it names the adapter".to_owned(),
                actual: format!("--backend cpu --adapter {number}"),
            }),
            (BackendArg::Auto | BackendArg::Gpu, Some(number)) => {
                Ok(Self::Gpu(open(AdapterChoice::Number(number))?))
            }
            (BackendArg::Gpu, None) => Ok(Self::Gpu(open(AdapterChoice::Auto)?)),
            (BackendArg::Auto, None) => {
                let found = adapters();
                let best = choose(&found, AdapterChoice::Auto).ok().map(|(number, _)| number);
                // Software adapters are slower than the CPU's own path.
                match best.filter(|number| found[*number].kind != AdapterKind::Software) {
                    None => Ok(Self::Cpu),
                    Some(number) => match open(AdapterChoice::Number(number)) {
                        Ok(gpu) => Ok(Self::FoundGpu(gpu)),
                        Err(error) => Ok(Self::fallen_back(&error)),
                    },
                }
            }
        }
    }

    /// Calls `start` with the GPU, if it is one. Where it fails and was not asked for, the CPU takes over, aloud.
    pub fn start<E: std::fmt::Display>(self, start: impl FnOnce(&Gpu) -> Result<(), E>) -> Result<Self, E> {
        match &self {
            Self::Cpu => Ok(self),
            Self::Gpu(gpu) => start(gpu).map(|()| self),
            Self::FoundGpu(gpu) => match start(gpu) {
                Ok(()) => Ok(self),
                Err(error) => Ok(Self::fallen_back(&error)),
            },
        }
    }

    /// `cpu` or `gpu`, as `--backend` has it.
    pub const fn backend(&self) -> &'static str {
        match self {
            Self::Cpu => "cpu",
            Self::Gpu(_) | Self::FoundGpu(_) => "gpu",
        }
    }

    /// The GPU's name and interface, if it is one.
    pub fn adapter(&self) -> Option<String> {
        self.gpu().map(|gpu| format!("{} ({})", gpu.adapter().name, gpu.adapter().api))
    }

    const fn gpu(&self) -> Option<&Gpu> {
        match self {
            Self::Cpu => None,
            Self::Gpu(gpu) | Self::FoundGpu(gpu) => Some(gpu),
        }
    }

    fn fallen_back(error: &impl std::fmt::Display) -> Self {
        note(format_args!("the CPU takes over: {error}"));
        Self::Cpu
    }
}
