//! What has been made on a device, counted: so that who renders frames can see that frames make nothing.

use std::sync::atomic::{AtomicU64, Ordering};

/// What has been made on a device since it was opened, whether it is still there or not.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Allocations {
    /// Buffers, and pieces of memory that frames write and read through.
    pub buffers: u64,
    /// Kernels compiled.
    pub kernels: u64,
    /// Kernels bound to buffers.
    pub bindings: u64,
    /// Submissions.
    pub submissions: u64,
}

/// [`Allocations`], as it grows.
#[derive(Debug, Default)]
pub struct Counts {
    pub buffers: AtomicU64,
    pub kernels: AtomicU64,
    pub bindings: AtomicU64,
    pub submissions: AtomicU64,
}

/// One more.
pub fn count(of: &AtomicU64) {
    of.fetch_add(1, Ordering::Relaxed);
}

impl Counts {
    pub fn allocations(&self) -> Allocations {
        let of = |count: &AtomicU64| count.load(Ordering::Relaxed);
        Allocations {
            buffers: of(&self.buffers),
            kernels: of(&self.kernels),
            bindings: of(&self.bindings),
            submissions: of(&self.submissions),
        }
    }
}
