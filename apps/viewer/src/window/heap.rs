//! Memory that scenes leave behind.

/// Makes glibc give every block of at least 128 KiB back to the system when the block is freed. Left to itself, glibc keeps freed
/// blocks of up to 32 MiB for later ones, and with scenes opened and closed the process takes twice the memory
/// (docs/performance.md, memory). Frames keep their large blocks, so they do not become slower.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[allow(unsafe_code, reason = "a call of the C library")]
pub fn keep_no_large_blocks() {
    /// glibc's own first value, which a stated one keeps from growing.
    const BYTES: libc::c_int = 128 << 10;

    // SAFETY: the call takes no pointer, and any thread may make it at any time.
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, BYTES);
    }
}

/// Other systems are left to themselves.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
pub const fn keep_no_large_blocks() {}
