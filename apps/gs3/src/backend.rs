//! Which machine renders.

use gs3::compute::{AdapterChoice, AdapterKind, Gpu, GpuSettings, OptionalFeatures, adapters, choose};
use gs3::neural::MatrixUnit;
use gs3::{FramePipeline, NetworkError, PipelineError};

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
    /// The machine that `device` means, a GPU opened with `features`; its products of matrices are tried if they are
    /// among them.
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

    /// After `error`, lets `pipeline` go on with the CPU if its GPU was not asked for, aloud; without history.
    ///
    /// # Errors
    /// `error`, if there is nobody to take over.
    pub fn take_over(
        &mut self,
        pipeline: &mut FramePipeline,
        error: PipelineError,
    ) -> Result<(), PipelineError> {
        match self {
            Self::Cpu | Self::Gpu(_) => Err(error),
            Self::FoundGpu(_) => {
                *self = Self::fallen_back(&error);
                pipeline.render_on_cpu()?;
                Ok(())
            }
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

    /// The GPU, if it is one.
    pub const fn gpu(&self) -> Option<&Gpu> {
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

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use gs3::scene::demo;
    use gs3::{Mode, PipelineSettings};

    use super::*;

    #[test]
    fn the_cpu_takes_over_from_a_gpu_that_nobody_asked_for_only() {
        let open = || Gpu::new(&GpuSettings::default());
        let Ok(gpu) = open() else {
            note("skipped: no GPU adapter");
            return;
        };
        let scene = Arc::new(demo::scene().unwrap());
        // Large enough that loops of drivers in software have rounds for the splats of a tile.
        let path = demo::path().resized(256, 144).unwrap();
        let settings = PipelineSettings { mode: Mode::Full, ..Default::default() };
        let new = || FramePipeline::new(Arc::clone(&scene), settings).unwrap();
        for (gpu, is_found) in [(gpu, true), (open().unwrap(), false)] {
            let mut pipeline = new();
            pipeline.render_on(&gpu).unwrap();
            pipeline.render(&path.cameras()[0]).unwrap();
            // As a driver that resets.
            gpu.destroy();
            let mut machine = if is_found { Machine::FoundGpu(gpu) } else { Machine::Gpu(gpu) };
            let error = pipeline.render(&path.cameras()[1]).map(|_| ()).unwrap_err();
            assert!(matches!(error, PipelineError::Gpu(_)), "{error}");
            assert_eq!(machine.take_over(&mut pipeline, error).is_ok(), is_found);
            assert_eq!(machine.backend(), if is_found { "cpu" } else { "gpu" });
            if is_found {
                let mut expected = new();
                for camera in &path.cameras()[1..3] {
                    assert!(!pipeline.is_on_device(camera));
                    pipeline.render(camera).unwrap();
                    expected.render(camera).unwrap();
                    assert_eq!(pipeline.last_image().pixels(), expected.last_image().pixels());
                }
            }
        }
    }
}
