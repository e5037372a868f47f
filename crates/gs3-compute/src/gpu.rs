//! An open device.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError};

use crate::adapter::{self, AdapterChoice, AdapterReport};
use crate::allocations::{Allocations, Counts, count};
use crate::capabilities::{Capabilities, OptionalFeatures, experimental, missing};
use crate::device_id::DeviceId;
use crate::error::GpuError;
use crate::pools::{ReadPool, UploadPool};
use crate::scopes;
use crate::waiting::now;

/// How to open a device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GpuSettings {
    /// Which adapter.
    pub adapter: AdapterChoice,
    /// Which optional features to use.
    pub features: OptionalFeatures,
}

/// The first error that has not been reported yet, and whether the device is lost.
#[derive(Debug, Default)]
struct Trouble {
    lost: Option<String>,
    error: Option<GpuError>,
}

/// An open device. Clones are the same device.
#[derive(Clone, Debug)]
pub struct Gpu {
    pub(crate) device_id: DeviceId,
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    adapter: Arc<AdapterReport>,
    capabilities: Arc<Capabilities>,
    trouble: Arc<Mutex<Trouble>>,
    pub(crate) uploads: Arc<UploadPool>,
    pub(crate) reads: Arc<ReadPool>,
    pub(crate) counts: Arc<Counts>,
}

impl Gpu {
    /// Opens a device.
    ///
    /// # Errors
    /// [`GpuError`] if there is no such adapter, it lacks something, or does not open; in a browser, which has no
    /// call that waits: [`Self::open`] is for it.
    pub fn new(settings: &GpuSettings) -> Result<Self, GpuError> {
        now(Self::open(settings))
    }

    /// Opens a device, as [`Self::new`] does. In a browser the future does not block; natively the future waits within
    /// its first poll. A browser offers one adapter, of [`Api::WebGpu`](crate::Api::WebGpu).
    ///
    /// # Errors
    /// [`GpuError`] if there is no such adapter, it lacks something, or does not open.
    pub async fn open(settings: &GpuSettings) -> Result<Self, GpuError> {
        let (adapter, report) = adapter::take(settings.adapter).await?;
        let descriptor = Self::wanted(&adapter, settings.features);
        let (device, queue) = adapter.request_device(&descriptor).await.map_err(|e| GpuError::Refused {
            what: format!("opening {}", report.name),
            message: e.to_string(),
        })?;
        let gpu = Self::with(report, device, queue);
        let state = gpu.trouble.clone();
        gpu.device.on_uncaptured_error(Arc::new(move |error| {
            let mut state = state.lock().unwrap_or_else(PoisonError::into_inner);
            state.error.get_or_insert_with(|| typed("a call outside any check", 0, error));
        }));
        Ok(gpu)
    }

    /// The descriptor to open a device of `adapter` with, for [`Gpu::of`]: all limits of the adapter, and its
    /// features that gs3 uses. The caller may ask for more. Without a feature, its fallback runs.
    #[must_use]
    pub fn wanted(adapter: &wgpu::Adapter, features: OptionalFeatures) -> wgpu::DeviceDescriptor<'static> {
        let capabilities = Capabilities::of(adapter).with(features);
        wgpu::DeviceDescriptor {
            label: Some("gs3"),
            required_features: capabilities.required_features(),
            experimental_features: experimental(&capabilities),
            required_limits: adapter.limits(),
            ..Default::default()
        }
    }

    /// Uses the caller's own device of `adapter`, with its queue, so that the caller can show the results of gs3
    /// directly. gs3 uses the features that the device was opened with. gs3 also takes the device's callback for
    /// device loss; [`Gpu::check`] reports the loss from then on. [`Buffer::raw`](crate::Buffer::raw) and
    /// [`Buffer::of`](crate::Buffer::of) convert between the buffers of both.
    ///
    /// Frames take less time without [`wgpu::InstanceFlags::VALIDATION_INDIRECT_CALL`], which gs3 does not need.
    ///
    /// # Errors
    /// [`GpuError::Unsupported`] if the device was opened with lower limits than gs3 needs.
    pub fn of(adapter: &wgpu::Adapter, device: wgpu::Device, queue: wgpu::Queue) -> Result<Self, GpuError> {
        let mut report = adapter::report(adapter);
        report.capabilities = report.capabilities.within(&device);
        report.missing = missing(adapter, &report.capabilities.limits);
        match report.missing {
            Some(missing) => Err(missing),
            None => Ok(Self::with(report, device, queue)),
        }
    }

    /// `device`, opened with the capabilities in `report`.
    fn with(mut report: AdapterReport, device: wgpu::Device, queue: wgpu::Queue) -> Self {
        let capabilities = report.capabilities.clone().within(&device);
        report.missing = None;
        let trouble: Arc<Mutex<Trouble>> = Arc::default();
        let state = trouble.clone();
        device.set_device_lost_callback(move |reason, message| {
            let mut state = state.lock().unwrap_or_else(PoisonError::into_inner);
            state.lost.get_or_insert_with(|| format!("{reason:?}: {message}"));
        });
        Self {
            device_id: DeviceId::new(),
            device,
            queue,
            adapter: Arc::new(report),
            capabilities: Arc::new(capabilities),
            trouble,
            uploads: Arc::default(),
            reads: Arc::default(),
            counts: Arc::default(),
        }
    }

    /// wgpu's own handle of the device.
    #[must_use]
    pub const fn device(&self) -> &wgpu::Device {
        &self.device
    }

    /// wgpu's own handle of the device's queue. Submissions to it are ordered with gs3's submissions.
    #[must_use]
    pub const fn queue(&self) -> &wgpu::Queue {
        &self.queue
    }

    /// The adapter it runs on.
    #[must_use]
    pub fn adapter(&self) -> &AdapterReport {
        &self.adapter
    }

    /// The capabilities of the device that gs3 may use.
    #[must_use]
    pub fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    /// What has been made on it so far.
    #[must_use]
    pub fn allocations(&self) -> Allocations {
        self.counts.allocations()
    }

    /// Bytes that the device has allocated for its objects, if wgpu divides the driver's memory (Vulkan, DX12).
    #[must_use]
    pub fn allocated_bytes(&self) -> Option<u64> {
        self.device.generate_allocator_report().map(|report| report.total_reserved_bytes)
    }

    /// A buffer of the device.
    pub(crate) fn create_buffer(&self, descriptor: &wgpu::BufferDescriptor<'_>) -> wgpu::Buffer {
        count(&self.counts.buffers);
        self.device.create_buffer(descriptor)
    }

    /// Submits `commands`.
    pub(crate) fn submit(
        &self,
        commands: impl IntoIterator<Item = wgpu::CommandBuffer>,
    ) -> wgpu::SubmissionIndex {
        count(&self.counts.submissions);
        self.queue.submit(commands)
    }

    /// Checks that there was no error since the last check.
    ///
    /// # Errors
    /// [`GpuError::DeviceLost`] from then on, any other error once.
    pub fn check(&self) -> Result<(), GpuError> {
        let mut trouble = self.trouble.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(message) = &trouble.lost {
            return Err(GpuError::DeviceLost { message: message.clone() });
        }
        trouble.error.take().map_or(Ok(()), Err)
    }

    /// Destroys the device: every later use returns [`GpuError::DeviceLost`].
    pub fn destroy(&self) {
        self.device.destroy();
        let mut trouble = self.trouble.lock().unwrap_or_else(PoisonError::into_inner);
        trouble.lost.get_or_insert_with(|| "given back".to_owned());
    }

    pub(crate) fn poll(&self, poll: wgpu::PollType) -> Result<(), GpuError> {
        let polled = self.survived(|| self.device.poll(poll));
        self.check()?;
        let Err(error) = polled? else { return Ok(()) };
        // For a device that its program destroyed, this may be the first notice: wgpu reports it with delay.
        let _ = self.survived(|| self.device.poll(wgpu::PollType::Poll));
        self.check()?;
        Err(GpuError::Refused { what: "waiting".to_owned(), message: error.to_string() })
    }

    /// The result of `call`. wgpu panics if a device is lost while something waits for it (30.0: `Device::poll`);
    /// this counts as an ordinary device loss.
    fn survived<T>(&self, call: impl FnOnce() -> T) -> Result<T, GpuError> {
        catch_unwind(AssertUnwindSafe(call)).map_err(|panic| {
            let said = panic.downcast_ref::<String>().map(String::as_str);
            let message =
                said.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("while waiting").to_owned();
            let mut trouble = self.trouble.lock().unwrap_or_else(PoisonError::into_inner);
            GpuError::DeviceLost { message: trouble.lost.get_or_insert(message).clone() }
        })
    }

    /// Makes a call that may only fail because the device is lost, which is reported elsewhere. On a caller's own
    /// device wgpu would panic.
    pub(crate) fn quietly(&self, call: impl FnOnce()) {
        // Nothing can be done about an error here.
        let _ = scopes::caught(&self.device, [wgpu::ErrorFilter::Validation], call);
    }

    /// The result of `call`, or its first error. `bytes` is the memory that it asks for. A browser reports errors
    /// later: there the next check has them.
    pub(crate) fn checked<T>(&self, what: &str, bytes: u64, call: impl FnOnce() -> T) -> Result<T, GpuError> {
        self.check()?;
        let filters =
            [wgpu::ErrorFilter::Internal, wgpu::ErrorFilter::OutOfMemory, wgpu::ErrorFilter::Validation];
        let (result, first) = scopes::caught(&self.device, filters, call);
        self.check()?;
        match first {
            Some(error) => Err(typed(what, bytes, error)),
            None => Ok(result),
        }
    }
}

/// An error of wgpu that arose during `what`, which asked for `bytes`.
fn typed(what: &str, bytes: u64, error: wgpu::Error) -> GpuError {
    let what = what.to_owned();
    match error {
        wgpu::Error::OutOfMemory { .. } => GpuError::OutOfMemory { what, bytes },
        wgpu::Error::Validation { description, .. } | wgpu::Error::Internal { description, .. } => {
            GpuError::Refused { what, message: description }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_panics_while_it_waits_is_a_lost_device() {
        let Some(gpu) = crate::device_for_tests(&GpuSettings::default()) else { return };
        assert_eq!(gpu.survived(|| 7), Ok(7));
        let lost = GpuError::DeviceLost { message: "Parent device is lost".to_owned() };
        assert_eq!(gpu.survived(|| panic!("Parent device is lost")), Err::<(), _>(lost.clone()));
        assert_eq!(gpu.check(), Err(lost));
    }
}
