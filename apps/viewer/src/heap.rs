//! Memory that scenes leave behind.

/// Lets all threads take memory from one place. Other systems than Linux with glibc are left to themselves.
///
/// glibc gives each thread an arena of its own. Blocks that stay in use then hold pages of every arena, and the number of these pages
/// grows with each scene that is opened and closed (docs/performance.md, memory). Frames allocate little, so threads seldom wait for
/// each other.
///
/// # Safety
/// The caller's thread is the only one: glibc's `mallopt` is not for programs whose other threads allocate meanwhile, and a thread that
/// has begun may have an arena already.
#[cfg(feature = "window")]
#[allow(unsafe_code, reason = "a call of the C library")]
pub unsafe fn use_one_arena() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: the call takes two numbers, and there is no other thread.
    unsafe {
        libc::mallopt(libc::M_ARENA_MAX, 1);
    }
}

/// Gives the system the memory that the C library keeps of what was freed. glibc keeps blocks of up to 32 MiB for later ones. With
/// scenes opened and closed the process takes 1.7 times the memory without this call (docs/performance.md, memory).
#[cfg(all(feature = "window", target_os = "linux", target_env = "gnu"))]
#[allow(unsafe_code, reason = "a call of the C library")]
pub fn give_back() {
    // SAFETY: the call takes no pointer, and any thread may make it at any time.
    unsafe {
        libc::malloc_trim(0);
    }
}

/// Other systems are left to themselves.
#[cfg(not(all(feature = "window", target_os = "linux", target_env = "gnu")))]
pub const fn give_back() {}
