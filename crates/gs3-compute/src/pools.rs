//! Memory of a device that frames write and read through, kept for the next frame.

use std::sync::{Mutex, PoisonError};

/// Memory that frames have written through, for reuse. [`wgpu::Queue::write_buffer`] would make a buffer for each
/// struct of each frame.
#[derive(Debug, Default)]
pub struct UploadPool(Mutex<Vec<wgpu::util::StagingBelt>>);

impl UploadPool {
    pub fn take(&self) -> Option<wgpu::util::StagingBelt> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).pop()
    }

    pub fn give_back(&self, belt: wgpu::util::StagingBelt) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(belt);
    }
}

/// Most bytes of memory that are kept for the next read.
const KEPT: u64 = 64 << 20;

/// Memory that was read and can be used again: the memory of the last finished read.
#[derive(Debug, Default)]
pub struct ReadPool(Mutex<Option<wgpu::Buffer>>);

impl ReadPool {
    pub fn take(&self) -> Option<wgpu::Buffer> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    pub fn give_back(&self, staging: wgpu::Buffer) {
        if staging.size() <= KEPT {
            *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(staging);
        }
    }
}
