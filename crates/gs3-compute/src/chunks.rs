//! Data larger than one binding.

use std::ops::Range;

use crate::capabilities::Limits;
use crate::error::GpuError;

/// How many items of a fixed size are divided among bindings: all chunks but the last have `per_chunk` items.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChunkPlan {
    /// Items in all.
    pub count: u64,
    /// Items of every chunk but the last.
    pub per_chunk: u64,
}

impl ChunkPlan {
    /// Divides `count` items of `bytes` each. Chunks hold a multiple of `multiple` items.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] if `multiple` items do not fit one binding.
    pub fn new(limits: &Limits, count: u64, bytes: u64, multiple: u64) -> Result<Self, GpuError> {
        let (bytes, multiple) = (bytes.max(1), multiple.max(1));
        let max = limits.binding_bytes.min(limits.buffer_bytes);
        let per_chunk = max / bytes / multiple * multiple;
        if per_chunk == 0 {
            let actual = bytes.saturating_mul(multiple);
            return Err(GpuError::TooLarge { what: "bytes of a chunk".to_owned(), max, actual });
        }
        Ok(Self { count, per_chunk })
    }

    /// The items of each chunk. No items are one empty chunk.
    pub fn ranges(&self) -> impl Iterator<Item = Range<u64>> + use<> {
        let Self { count, per_chunk } = *self;
        (0..count.div_ceil(per_chunk).max(1)).map(move |k| k * per_chunk..((k + 1) * per_chunk).min(count))
    }
}
