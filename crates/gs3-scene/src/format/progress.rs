//! How far loading has come.

use std::sync::atomic::{AtomicU64, Ordering};

/// Called with the share that is done, 0 to 1, from whichever thread did it; calls may overlap and arrive out
/// of order by a little.
pub type Progress<'a> = &'a (dyn Fn(f32) + Sync);

/// Counts units of work that many threads do.
pub(super) struct Work<'a> {
    done: AtomicU64,
    total: u64,
    progress: Progress<'a>,
}

impl<'a> Work<'a> {
    pub(super) const fn new(total: u64, progress: Progress<'a>) -> Self {
        Self { done: AtomicU64::new(0), total, progress }
    }

    pub(super) fn add(&self, units: usize) {
        let done = self.done.fetch_add(units as u64, Ordering::Relaxed) + units as u64;
        (self.progress)((done as f64 / self.total.max(1) as f64).min(1.0) as f32);
    }
}
