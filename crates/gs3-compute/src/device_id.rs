//! Which device something belongs to.

use std::sync::atomic::{AtomicU64, Ordering};

use crate::error::GpuError;

/// Identifies an opened device. wgpu numbers the objects of each of its instances from 0 on. So an object of one
/// instance's device may be taken for another object on a device of another instance, or for none, and then wgpu
/// panics.
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
