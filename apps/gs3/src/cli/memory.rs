//! Memory: how much of it lists may take, and what happens where there is none.

use std::alloc::{GlobalAlloc, Layout, System};
use std::io::{Write, stderr};

use gs3::raster::LIST_MEMORY;
use sysinfo::System as Machine;

use super::exit::MAY_PASS;
use super::values::Bytes;

/// What the lists of the splats of tiles may take: what is asked for, else a quarter of what is free, at most
/// [`LIST_MEMORY`]. The other quarters are for images and the splats themselves.
pub fn for_lists(asked: Option<Bytes>) -> u64 {
    asked.map_or_else(|| (free() / 4).min(LIST_MEMORY), |Bytes(bytes)| bytes)
}

/// Memory that is free for this process; all of it where the system does not say.
fn free() -> u64 {
    if !sysinfo::IS_SUPPORTED_SYSTEM {
        return u64::MAX;
    }
    let mut machine = Machine::new();
    machine.refresh_memory();
    let of_group = machine.cgroup_limits().map_or(u64::MAX, |limits| limits.free_memory);
    machine.available_memory().min(of_group)
}

/// Lets glibc give freed memory back to the system at once: blocks above 128 KiB, and what is free at the end of the heap. By default
/// glibc keeps blocks of up to 32 MiB for later ones. Conversions have few such blocks, and take 20 to 25 MB less in the same
/// time (SPZ and SOG of the four copies of `hqgarden` of docs/reliability.md). Other systems are left to themselves.
///
/// # Safety
/// The caller's thread is the only one: `mallopt` is not for programs whose other threads allocate meanwhile.
#[allow(unsafe_code, reason = "a call of the C library")]
pub unsafe fn give_back_at_once() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: the call takes two numbers, and there is no other thread.
    unsafe {
        libc::mallopt(libc::M_TRIM_THRESHOLD, 128 << 10);
    }
}

/// The system's allocator. Where the system has no memory left the process ends with one line and [`MAY_PASS`]; Rust's own way
/// is to abort. Files are whole then, as after any other end.
#[derive(Debug)]
pub struct Allocator;

#[global_allocator]
static ALLOCATOR: Allocator = Allocator;

// SAFETY: every call goes to the system's allocator, with the arguments of the caller, who keeps that allocator's rules. A
// pointer that is not null is the system's own.
#[allow(unsafe_code, reason = "allocators are unsafe traits")]
unsafe impl GlobalAlloc for Allocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as the impl's.
        given(unsafe { System.alloc(layout) }, layout.size())
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as the impl's.
        given(unsafe { System.alloc_zeroed(layout) }, layout.size())
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: as the impl's.
        given(unsafe { System.realloc(pointer, layout, size) }, size)
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as the impl's.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[inline(always)]
fn given(pointer: *mut u8, size: usize) -> *mut u8 {
    if pointer.is_null() {
        out_of_memory(size);
    }
    pointer
}

/// Ends the process. Nothing here allocates: neither the formatting nor standard error, which has no buffer.
#[cold]
#[inline(never)]
fn out_of_memory(size: usize) -> ! {
    let line = format_args!("error: memory: expected {size} more bytes, found none\n");
    // One write, and nobody to tell if it fails.
    let mut text = [0; 80];
    let mut rest = &mut text[..];
    let is_whole = rest.write_fmt(line).is_ok();
    let left = rest.len();
    if is_whole {
        let _ = stderr().write_all(&text[..80 - left]);
    }
    end()
}

/// Without the handlers that other code may have for the end of a process: they may allocate.
#[cfg(unix)]
fn end() -> ! {
    #[allow(unsafe_code, reason = "the standard library only has an exit that calls handlers")]
    // SAFETY: it ends the process.
    unsafe {
        libc::_exit(MAY_PASS.into())
    }
}

#[cfg(not(unix))]
fn end() -> ! {
    std::process::exit(MAY_PASS.into())
}
