//! Named buffers that grow together.

use std::collections::BTreeMap;

use crate::buffer::{Buffer, Use};
use crate::error::GpuError;
use crate::gpu::Gpu;

/// A buffer that a stage needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Need {
    /// Its name.
    pub name: &'static str,
    /// Use of the buffer.
    pub usage: Use,
    /// Least size in bytes.
    pub bytes: u64,
}

/// The result of fitting an arena.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use = "kernels bound to the old buffers must be bound again"]
pub enum Fit {
    /// All buffers stayed.
    Kept,
    /// Some buffers are new, of zeros, and kernels must be bound again.
    Grown,
}

/// Named buffers that grow together, and never shrink.
#[derive(Clone, Debug, Default)]
pub struct Arena {
    buffers: BTreeMap<&'static str, (Use, Buffer)>,
}

impl Arena {
    /// Makes sure that the buffers hold `needs`. A buffer that grows gets a quarter more than it needs, within the
    /// device's limits, so that slowly growing needs do not replace it every frame.
    ///
    /// # Errors
    /// [`GpuError`] if the device has too little memory; buffers may have grown.
    pub fn fit(&mut self, gpu: &Gpu, needs: &[Need]) -> Result<Fit, GpuError> {
        let mut fit = Fit::Kept;
        for need in needs {
            let found = self.buffers.get(need.name);
            if found.is_some_and(|(usage, buffer)| *usage == need.usage && buffer.bytes() >= need.bytes) {
                continue;
            }
            let limits = gpu.capabilities().limits;
            let reserve = match found {
                Some(_) => (need.bytes / 4).min(limits.binding_bytes.saturating_sub(need.bytes)),
                None => 0,
            };
            // The old buffer is dropped first, so that both need not fit.
            self.buffers.remove(need.name);
            let buffer = gpu.buffer(need.name, need.usage, need.bytes + reserve)?;
            self.buffers.insert(need.name, (need.usage, buffer));
            fit = Fit::Grown;
        }
        Ok(fit)
    }

    /// The buffer of that name, once [`Arena::fit`] has made it.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<&Buffer> {
        self.buffers.get(name).map(|(_, buffer)| buffer)
    }

    /// Bytes of all buffers.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.buffers.values().map(|(_, buffer)| buffer.bytes()).sum()
    }
}
