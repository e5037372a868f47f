//! Prefetches memory.

/// Bytes of a cache line.
const LINE: usize = 64;

/// Asks the CPU to load `values` into the caches, in lines of 64 bytes from their first byte on. This helps where a few cache
/// lines each are read from many places: too few for the hardware to detect a stream. Does nothing but on x86-64: safe Rust
/// has no such instruction for other architectures.
#[inline(always)]
#[allow(unsafe_code, reason = "the intrinsic takes a raw pointer")]
pub fn prefetch<T>(values: &[T]) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        let start = values.as_ptr().cast::<i8>();
        for at in (0..size_of_val(values)).step_by(LINE) {
            // SAFETY: a prefetch is a hint that neither reads nor faults, at any address; the instruction (SSE) is
            // part of x86-64.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(start.wrapping_add(at)) };
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (values, LINE);
}
