//! Which machine renders, aloud.

use gs3::compute::{Gpu, OptionalFeatures};
use gs3::neural::MatrixUnit;
use gs3::{Backend, FramePipeline, Machine, NetworkError, PipelineError};

use super::error::CliError;
use super::options::Device;
use super::terminal::note;

/// Refuses a GPU's number without a GPU.
pub fn check(device: &Device) -> Result<(), CliError> {
    match (device.backend, device.adapter) {
        (Backend::Cpu, Some(number)) => Err(CliError::Option {
            option: "--adapter",
            expected: "a GPU backend, for it names a GPU".to_owned(),
            actual: format!("--backend cpu --adapter {number}"),
        }),
        _ => Ok(()),
    }
}

/// The machine that `device` means, a GPU opened with `features`; its products of matrices are tried if they are among
/// them.
pub fn open(device: &Device, features: OptionalFeatures) -> Result<Machine, CliError> {
    check(device)?;
    let (machine, failure) = Machine::open(device.backend, device.adapter, features)?;
    if let Some(error) = failure {
        tell_take_over(&error);
    }
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

/// Calls `start` with the GPU, if `machine` is one. Where it fails and was not asked for, the CPU takes over.
pub fn start<E: std::fmt::Display>(
    machine: Machine,
    start: impl FnOnce(&Gpu) -> Result<(), E>,
) -> Result<Machine, E> {
    match &machine {
        Machine::Cpu => Ok(machine),
        Machine::Gpu(gpu) => start(gpu).map(|()| machine),
        Machine::FoundGpu(gpu) => match start(gpu) {
            Ok(()) => Ok(machine),
            Err(error) => {
                tell_take_over(&error);
                Ok(Machine::Cpu)
            }
        },
    }
}

/// After `error`, lets `pipeline` continue on the CPU, without history, if the GPU of `machine` was found and not
/// asked for.
///
/// # Errors
/// `error`, if the machine is no such GPU.
pub fn take_over(
    machine: &mut Machine,
    pipeline: &mut FramePipeline,
    error: PipelineError,
) -> Result<(), PipelineError> {
    match machine {
        Machine::Cpu | Machine::Gpu(_) => Err(error),
        Machine::FoundGpu(_) => {
            tell_take_over(&error);
            *machine = Machine::Cpu;
            pipeline.render_on_cpu()?;
            Ok(())
        }
    }
}

/// Says that the CPU takes over after `error`.
pub fn tell_take_over(error: &impl std::fmt::Display) {
    note(format_args!("the CPU takes over: {error}"));
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use gs3::compute::{GpuSettings, device_for_tests};
    use gs3::scene::demo;
    use gs3::{Mode, PipelineSettings};

    use super::*;

    #[test]
    fn the_cpu_takes_over_from_a_gpu_that_nobody_asked_for_only() {
        let open = || Gpu::new(&GpuSettings::default());
        let Some(gpu) = device_for_tests(&GpuSettings::default()) else { return };
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
            assert_eq!(take_over(&mut machine, &mut pipeline, error).is_ok(), is_found);
            assert_eq!(machine.backend(), if is_found { Backend::Cpu } else { Backend::Gpu });
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
