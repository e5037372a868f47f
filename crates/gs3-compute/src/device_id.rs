//! Which device something belongs to.

use std::sync::atomic::{AtomicU64, Ordering};

use crate::error::GpuError;

/// A device that was opened. wgpu numbers what there is on each of its instances from 0 on: what belongs to a device of
/// another one may be taken for something else there, or for nothing, at which it panics.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct DeviceId(u64);

impl DeviceId {
    /// One that nothing belongs to yet.
    pub fn new() -> Self {
        static OPENED: AtomicU64 = AtomicU64::new(0);
        Self(OPENED.fetch_add(1, Ordering::Relaxed))
    }

    /// Whether what belongs to `other` may be used here.
    pub fn check(self, other: Self, what: &'static str) -> Result<(), GpuError> {
        if self == other { Ok(()) } else { Err(GpuError::OtherDevice { what }) }
    }
}
