//! Counts every allocation of the library, and by whom it was made.
//!
//! Memory that a handle needs is allocated by its own threads, and by the thread of a caller while its call runs
//! ([`crate::workers`]). Those threads work on the handle's account, and give back what they took from it: so what an
//! account says is what its handle has, without a word of bookkeeping in the library.
#![allow(unsafe_code, reason = "an allocator around the system's, and exported functions")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};

use crate::descriptor::{Answer, Descriptor};
use crate::status::gs3_status::GS3_ERROR_UNSUPPORTED;
use crate::status::{Fault, gs3_status, guard};

/// Most accounts at once, the one of nobody included.
const MOST: usize = 1024;

/// The account of threads that work for no handle.
const NOBODY: usize = 0;

/// Bytes allocated and not freed.
static BYTES: [AtomicI64; MOST] = [const { AtomicI64::new(0) }; MOST];

/// Which accounts have an owner.
static TAKEN: [AtomicBool; MOST] = [const { AtomicBool::new(false) }; MOST];

thread_local! {
    /// The account that this thread works on. It needs neither allocation nor a destructor, so allocators may read it.
    static CURRENT: Cell<usize> = const { Cell::new(NOBODY) };
}

fn count(bytes: i64) {
    BYTES[CURRENT.get()].fetch_add(bytes, Ordering::Relaxed);
}

/// The system's allocator, counted.
#[derive(Clone, Copy, Debug)]
pub struct Counting;

/// Layouts are no larger than `isize::MAX`.
const fn signed(bytes: usize) -> i64 {
    bytes as i64
}

// SAFETY: all four do what the system's allocator does with the same arguments.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller's contract.
        let memory = unsafe { System.alloc(layout) };
        if !memory.is_null() {
            count(signed(layout.size()));
        }
        memory
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller's contract.
        let memory = unsafe { System.alloc_zeroed(layout) };
        if !memory.is_null() {
            count(signed(layout.size()));
        }
        memory
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: the caller's contract.
        unsafe { System.dealloc(memory, layout) };
        count(-signed(layout.size()));
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: the caller's contract.
        let moved = unsafe { System.realloc(memory, layout, size) };
        if !moved.is_null() {
            count(signed(size) - signed(layout.size()));
        }
        moved
    }
}

/// The account of a handle.
#[derive(Debug)]
pub struct Account(usize);

impl Account {
    /// A new one, of 0 bytes.
    pub fn open() -> Result<Self, Fault> {
        let free = |index: &usize| {
            TAKEN[*index].compare_exchange(false, true, Ordering::AcqRel, Ordering::Relaxed).is_ok()
        };
        match (NOBODY + 1..MOST).find(free) {
            Some(index) => {
                BYTES[index].store(0, Ordering::Relaxed);
                Ok(Self(index))
            }
            None => {
                let text = format!("handles: expected at most {} at once, found one more", MOST - 1);
                Err(Fault::new(GS3_ERROR_UNSUPPORTED, text))
            }
        }
    }

    /// Its number, for [`work_on`].
    pub const fn number(&self) -> usize {
        self.0
    }

    /// Bytes allocated on it and not freed.
    pub fn bytes(&self) -> u64 {
        u64::try_from(BYTES[self.0].load(Ordering::Relaxed)).unwrap_or(0)
    }
}

impl Drop for Account {
    fn drop(&mut self) {
        // What its owner leaves is no longer anybody's.
        let rest = BYTES[self.0].swap(0, Ordering::Relaxed);
        BYTES[NOBODY].fetch_add(rest, Ordering::Relaxed);
        TAKEN[self.0].store(false, Ordering::Release);
    }
}

/// Lets this thread work on the account `number` until the value is dropped.
pub fn work_on(number: usize) -> Shift {
    Shift { before: CURRENT.replace(number) }
}

/// `value`, copied to nobody's account: what a call gives that outlives it.
pub fn outlive<T: Clone>(value: T) -> T {
    let shift = work_on(NOBODY);
    let copy = value.clone();
    drop(shift);
    // The original is freed on the account that it was allocated on.
    copy
}

/// While it lives, a thread works on another account.
#[derive(Debug)]
pub struct Shift {
    before: usize,
}

impl Drop for Shift {
    fn drop(&mut self) {
        CURRENT.set(self.before);
    }
}

/// What gs3_memory.device_bytes says of a GPU with a driver that does not tell.
pub const GS3_UNKNOWN_BYTES: u64 = u64::MAX;

/// Memory that is allocated and not freed, bytes.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct gs3_memory {
    /// sizeof(gs3_memory).
    pub struct_size: u32,
    /// 0.
    pub reserved: u32,
    /// Of the processor, without the stacks of threads.
    pub host_bytes: u64,
    /// Of a GPU's buffers: 0 without a GPU, GS3_UNKNOWN_BYTES where its driver does not tell.
    pub device_bytes: u64,
}

// SAFETY: as the trait demands.
unsafe impl Descriptor for gs3_memory {
    const BYTES: usize = 4 + 4 + 2 * 8;
    const LEAST: usize = 16;
}

impl gs3_memory {
    pub const fn new(host_bytes: u64, device_bytes: u64) -> Self {
        Self { struct_size: 0, reserved: 0, host_bytes, device_bytes }
    }
}

/// What the whole library has allocated on the processor: all handles, and what belongs to none. device_bytes is 0:
/// memory of GPUs is told by handle.
///
/// # Safety
/// `memory` points to a gs3_memory with struct_size set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_query_memory(memory: *mut gs3_memory) -> gs3_status {
    guard("gs3_query_memory", || {
        // SAFETY: the contract of this function.
        let answer = unsafe { Answer::at("memory", memory) }?;
        let bytes: i64 = BYTES.iter().map(|bytes| bytes.load(Ordering::Relaxed)).sum();
        answer.write(&gs3_memory::new(u64::try_from(bytes).unwrap_or(0), 0));
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn accounts_have_what_was_allocated_on_them() {
        let account = Account::open().unwrap();
        let work = work_on(account.number());
        let mut kept = vec![0_u8; 1000];
        drop(vec![0_u8; 5000]);
        kept.reserve_exact(2000);
        let outlived = outlive(vec![0_u8; 300]);
        drop(work);
        drop(outlived);
        assert_eq!(account.bytes(), kept.capacity() as u64);
        assert!(kept.capacity() >= 2000);
        let work = work_on(account.number());
        drop(kept);
        drop(work);
        assert_eq!(account.bytes(), 0);
    }
}
