//! Which machine renders, aloud.

use std::sync::Arc;

use gs3::compute::OptionalFeatures;
use gs3::neural::MatrixUnit;
use gs3::scene::Scene;
use gs3::{Backend, Machine, NetworkError, Networks, PipelineSettings, Session, SessionSettings};

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

/// A session of `scene` on the machine that `device` means, a GPU opened with `features`.
pub fn session(
    scene: Arc<Scene>,
    pipeline: PipelineSettings,
    networks: &Networks,
    device: &Device,
    features: OptionalFeatures,
) -> Result<Session, CliError> {
    check(device)?;
    if features == OptionalFeatures::Experimental {
        // Tried before a session, which may go on where the GPU fails.
        open(device, features)?;
    }
    let Device { backend, adapter } = *device;
    let settings = SessionSettings { pipeline, networks: networks.clone(), backend, adapter, features };
    let mut session = Session::new(scene, settings)?;
    tell_notices(std::slice::from_mut(&mut session));
    Ok(session)
}

/// The machine that `device` means, for what makes no whole frames; a GPU is opened with `features`.
pub fn open(device: &Device, features: OptionalFeatures) -> Result<Machine, CliError> {
    check(device)?;
    let (machine, failure) = Machine::open(device.backend, device.adapter, features)?;
    if let Some(error) = failure {
        tell_take_over(&error);
    }
    check_matrix_products(&machine, features)?;
    Ok(machine)
}

/// Tries the products of matrices of `machine` if they are among `features`.
fn check_matrix_products(machine: &Machine, features: OptionalFeatures) -> Result<(), CliError> {
    if features != OptionalFeatures::Experimental {
        return Ok(());
    }
    let unit = machine.gpu().and_then(|gpu| Some((gpu, MatrixUnit::of(gpu.capabilities())?)));
    let Some((gpu, unit)) = unit else {
        return Err(CliError::Option {
            option: "--matrix-products",
            expected: "a GPU that has them, with subgroups of one size (gs3 devices)".to_owned(),
            actual: machine.adapter().unwrap_or_else(|| "the CPU".to_owned()),
        });
    };
    Ok(unit.check(gpu).map_err(NetworkError::from)?)
}

/// Says what `sessions` have to say, the same once: that the CPU took over, and why.
pub fn tell_notices(sessions: &mut [Session]) {
    let mut told: Vec<String> = Vec::new();
    for notice in sessions.iter_mut().flat_map(Session::take_notices) {
        if !told.contains(&notice) {
            note(&notice);
            told.push(notice);
        }
    }
}

/// Says that the CPU takes over after `error`.
pub fn tell_take_over(error: &impl std::fmt::Display) {
    note(format_args!("the CPU takes over: {error}"));
}
