//! Which adapters there are, and which one is taken.

use std::fmt;

use crate::capabilities::{Capabilities, missing};
use crate::error::GpuError;
use crate::waiting::at_once;

/// Which adapter to take.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AdapterChoice {
    /// The best by [`choose`].
    #[default]
    Auto,
    /// The best that is not software.
    Fast,
    /// That place in [`adapters`].
    Number(usize),
    /// The best of one programming interface.
    Api(Api),
}

impl fmt::Display for AdapterChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => write!(f, "any adapter"),
            Self::Fast => write!(f, "an adapter that is not software"),
            Self::Number(number) => write!(f, "adapter {number}"),
            Self::Api(api) => write!(f, "a {api} adapter"),
        }
    }
}

/// The programming interface of a driver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Api {
    /// Khronos Vulkan.
    Vulkan,
    /// Apple Metal.
    Metal,
    /// Microsoft Direct3D 12.
    Dx12,
    /// A browser's own.
    WebGpu,
    /// Something else that wgpu knows.
    Other,
}

impl fmt::Display for Api {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Vulkan => "Vulkan",
            Self::Metal => "Metal",
            Self::Dx12 => "DX12",
            Self::WebGpu => "WebGPU",
            Self::Other => "other",
        })
    }
}

/// What an adapter is, fastest kind first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum AdapterKind {
    /// A graphics card with its own memory.
    Discrete,
    /// A graphics unit that shares the processor's memory.
    Integrated,
    /// A share of a graphics card in a virtual machine.
    Virtual,
    /// The driver does not say.
    Unknown,
    /// The processor: right, and slower than gs3's own CPU path.
    Software,
}

impl fmt::Display for AdapterKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Discrete => "discrete GPU",
            Self::Integrated => "integrated GPU",
            Self::Virtual => "virtual GPU",
            Self::Unknown => "unknown kind",
            Self::Software => "software",
        })
    }
}

/// What is known of an adapter before it is opened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AdapterReport {
    /// Its name.
    pub name: String,
    /// Its programming interface.
    pub api: Api,
    /// What it is.
    pub kind: AdapterKind,
    /// Name and version of the driver.
    pub driver: String,
    /// What it can do.
    pub capabilities: Capabilities,
    /// The first thing that gs3 needs and it lacks.
    pub missing: Option<GpuError>,
}

/// All adapters of this machine, in the driver's order. Empty where there is no driver, and in a browser, which lists
/// none.
#[must_use]
pub fn adapters() -> Vec<AdapterReport> {
    let found = at_once(async { instance().enumerate_adapters(wgpu::Backends::all()).await });
    found.iter().flatten().map(report).collect()
}

/// The adapter that `choice` means.
#[cfg(not(target_arch = "wasm32"))]
pub(crate) async fn take(choice: AdapterChoice) -> Result<(wgpu::Adapter, AdapterReport), GpuError> {
    let mut found = instance().enumerate_adapters(wgpu::Backends::all()).await;
    let reports: Vec<AdapterReport> = found.iter().map(report).collect();
    let (number, _) = choose(&reports, choice)?;
    Ok((found.swap_remove(number), reports[number].clone()))
}

/// The adapter that the browser offers, if `choice` means it.
#[cfg(target_arch = "wasm32")]
pub(crate) async fn take(choice: AdapterChoice) -> Result<(wgpu::Adapter, AdapterReport), GpuError> {
    let wanted = wgpu::RequestAdapterOptions {
        power_preference: wgpu::PowerPreference::HighPerformance,
        ..Default::default()
    };
    let found = instance().request_adapter(&wanted).await.ok();
    let reports: Vec<AdapterReport> = found.iter().map(report).collect();
    choose(&reports, choice)?;
    let none = || GpuError::NoAdapter { expected: choice.to_string(), actual: "none".to_owned() };
    found.zip(reports.into_iter().next()).ok_or_else(none)
}

/// The index in `adapters` of the adapter that `choice` means, and the reason: the fastest kind of the adapters that
/// can run gs3, and the first among equals.
///
/// # Errors
/// [`GpuError::NoAdapter`] if there is no adapter, [`GpuError::Unsupported`] if the requested adapter lacks a
/// feature.
pub fn choose(adapters: &[AdapterReport], choice: AdapterChoice) -> Result<(usize, String), GpuError> {
    let none = || {
        let actual = match adapters.len() {
            0 => "none".to_owned(),
            count => format!("{count} (0 to {})", count - 1),
        };
        GpuError::NoAdapter { expected: choice.to_string(), actual }
    };
    if let AdapterChoice::Number(number) = choice {
        let adapter = adapters.get(number).ok_or_else(none)?;
        return match &adapter.missing {
            Some(missing) => Err(missing.clone()),
            None => Ok((number, "asked for by number".to_owned())),
        };
    }
    let asked = |a: &&(usize, &AdapterReport)| match choice {
        AdapterChoice::Api(api) => a.1.api == api,
        AdapterChoice::Fast => a.1.kind != AdapterKind::Software,
        _ => true,
    };
    let all: Vec<(usize, &AdapterReport)> = adapters.iter().enumerate().collect();
    let mut candidates: Vec<_> = all.iter().filter(asked).collect();
    if let (Some(missing), true) = (
        candidates.iter().find_map(|a| a.1.missing.clone()),
        candidates.iter().all(|a| a.1.missing.is_some()),
    ) {
        return Err(missing);
    }
    candidates.retain(|a| a.1.missing.is_none());
    let (number, best) = candidates.iter().min_by_key(|a| a.1.kind).ok_or_else(none)?;
    let others: Vec<&str> = candidates.iter().filter(|a| a.0 != *number).map(|a| a.1.name.as_str()).collect();
    let reason = match (&others[..], best.kind) {
        ([], AdapterKind::Software) => {
            "the only one that can run gs3; software, slower than the CPU path".to_owned()
        }
        ([], _) => "the only one that can run gs3".to_owned(),
        (_, kind) if candidates.iter().filter(|a| a.1.kind == kind).count() > 1 => {
            format!("the first {kind}; discrete before integrated, virtual and software ones")
        }
        (_, kind) => format!("the only {kind}; discrete before integrated, virtual and software ones"),
    };
    Ok((*number, reason))
}

/// wgpu with the drivers of this machine.
pub(crate) fn instance() -> wgpu::Instance {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::VULKAN
        | wgpu::Backends::METAL
        | wgpu::Backends::DX12
        | wgpu::Backends::BROWSER_WEBGPU;
    // Without it every indirect dispatch costs a second one that checks its counts. Ours come from kernels that bound
    // them (`grid_of`), and none reads `num_workgroups`, which DX12 then lacks.
    descriptor.flags.remove(wgpu::InstanceFlags::VALIDATION_INDIRECT_CALL);
    wgpu::Instance::new(descriptor)
}

/// What is known of `adapter`.
pub(crate) fn report(adapter: &wgpu::Adapter) -> AdapterReport {
    let info = adapter.get_info();
    let api = match info.backend {
        wgpu::Backend::Vulkan => Api::Vulkan,
        wgpu::Backend::Metal => Api::Metal,
        wgpu::Backend::Dx12 => Api::Dx12,
        wgpu::Backend::BrowserWebGpu => Api::WebGpu,
        _ => Api::Other,
    };
    let kind = match info.device_type {
        wgpu::DeviceType::DiscreteGpu => AdapterKind::Discrete,
        wgpu::DeviceType::IntegratedGpu => AdapterKind::Integrated,
        wgpu::DeviceType::VirtualGpu => AdapterKind::Virtual,
        wgpu::DeviceType::Cpu => AdapterKind::Software,
        wgpu::DeviceType::Other => AdapterKind::Unknown,
    };
    let capabilities = Capabilities::of(adapter);
    AdapterReport {
        api,
        kind,
        driver: format!("{} {}", info.driver, info.driver_info).trim().to_owned(),
        missing: missing(adapter, &capabilities.limits),
        capabilities,
        name: info.name,
    }
}
