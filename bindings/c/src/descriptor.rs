//! Descriptors of any length: the one place that reads what a caller describes and writes what it asks for.
//!
//! Each begins with its size in bytes, by which versions of the library tell what they do not know of each other:
//!
//! - A shorter descriptor, of a program compiled for an older version, lacks fields. They are 0, which means the default.
//! - A longer one, of a program compiled for a newer version, has fields that this version does not know. It is accepted if
//!   they are 0, which changes nothing.
//! - Results are written as far as both sides know them; what this version does not know becomes 0.
//!
//! A size at the beginning, and no chain of structures: one structure a call is enough for what gs3 is told, and programs
//! fill it with one initialiser.
#![allow(unsafe_code, reason = "memory of the caller")]

use std::ptr;

use crate::status::Fault;
use crate::status::gs3_status::GS3_ERROR_DESCRIPTOR;

/// Longer descriptors are none: the number is not a size, but what lay in memory that nobody set.
const MOST: usize = 1 << 12;

/// A structure of the header that begins with its size.
///
/// # Safety
/// It is `repr(C)`, its first field is the `u32` size, and it may be all zeros.
pub unsafe trait Descriptor: Copy {
    /// Bytes of all fields on 64-bit machines. It has no others, so that fields which are added do not lie in what programs
    /// left undefined.
    const BYTES: usize;
    /// Bytes that a program of any version sets: up to the last field that has no default.
    const LEAST: usize;
}

/// The size that the structure at `from` says it has, checked against what it may have.
///
/// # Safety
/// `from` is null or points to a `u32` that is readable.
unsafe fn size_of_descriptor<T: Descriptor>(field: &str, from: *const T) -> Result<usize, Fault> {
    const { assert!(size_of::<T>() == T::BYTES || size_of::<usize>() < 8) };
    if from.is_null() {
        return Err(Fault::null(field));
    }
    if !from.is_aligned() {
        let expected = format_args!("an address divisible by {}", align_of::<T>()).to_string();
        return Err(Fault::argument(field, expected, format_args!("{from:p}")));
    }
    // SAFETY: not null, aligned, and readable by the contract of this function.
    let size = unsafe { from.cast::<u32>().read() } as usize;
    if (T::LEAST..=MOST).contains(&size) {
        return Ok(size);
    }
    let (least, usual) = (T::LEAST, size_of::<T>());
    let text =
        format!("{field}: struct_size: expected {usual} (at least {least}, at most {MOST}), found {size}");
    Err(Fault::new(GS3_ERROR_DESCRIPTOR, text))
}

/// The descriptor at `from`, which the caller calls `field`.
///
/// # Safety
/// `from` is null or points to as many readable bytes as its first field, a `u32`, says.
pub unsafe fn read<T: Descriptor>(field: &str, from: *const T) -> Result<T, Fault> {
    // SAFETY: null, or readable by the contract of this function.
    let size = unsafe { size_of_descriptor(field, from) }?;
    let known = size.min(size_of::<T>());
    // SAFETY: `Descriptor` demands that all zeros are one.
    let mut descriptor: T = unsafe { std::mem::zeroed() };
    // SAFETY: `size` bytes are readable by the contract of this function, `known` is no more than those and than the
    // descriptor has, and the descriptor is a variable of its own.
    unsafe { ptr::copy_nonoverlapping(from.cast::<u8>(), (&raw mut descriptor).cast::<u8>(), known) };
    for place in known..size {
        // SAFETY: within the `size` readable bytes.
        let byte = unsafe { from.cast::<u8>().add(place).read() };
        if byte != 0 {
            let text = format!(
                "{field}: expected zeros after the {known} bytes that this version of gs3 knows, found {byte} at {place}"
            );
            return Err(Fault::new(GS3_ERROR_DESCRIPTOR, text));
        }
    }
    Ok(descriptor)
}

/// As [`read`], where null stands for a descriptor of defaults.
///
/// # Safety
/// As [`read`].
pub unsafe fn read_or_default<T: Descriptor>(field: &str, from: *const T) -> Result<T, Fault> {
    if from.is_null() {
        // SAFETY: `Descriptor` demands that all zeros are one.
        return Ok(unsafe { std::mem::zeroed() });
    }
    // SAFETY: the contract of this function.
    unsafe { read(field, from) }
}

/// A structure of the caller that a result goes to.
#[derive(Debug)]
pub struct Answer<T> {
    to: *mut T,
    size: usize,
}

impl<T: Descriptor> Answer<T> {
    /// The structure at `to`, which the caller calls `field`. Its size is checked here, before the call does anything.
    ///
    /// # Safety
    /// `to` is null, or points to as many bytes as its first field says, which stay writable until [`Self::write`].
    pub unsafe fn at(field: &str, to: *mut T) -> Result<Self, Fault> {
        // SAFETY: the contract of this function.
        let size = unsafe { size_of_descriptor(field, to.cast_const()) }?;
        Ok(Self { to, size })
    }

    /// As [`Self::at`], where null is nobody who asks.
    ///
    /// # Safety
    /// As [`Self::at`].
    pub unsafe fn at_or_none(field: &str, to: *mut T) -> Result<Option<Self>, Fault> {
        if to.is_null() {
            return Ok(None);
        }
        // SAFETY: the contract of this function.
        unsafe { Self::at(field, to) }.map(Some)
    }

    /// Writes `value` as far as the caller's structure goes, all but its size.
    pub fn write(self, value: &T) {
        let (head, known) = (size_of::<u32>(), self.size.min(size_of::<T>()));
        let (from, to) = (ptr::from_ref(value).cast::<u8>(), self.to.cast::<u8>());
        // SAFETY: `at` demands `size` writable bytes; `known` is no more than those and than the value has; the value is the
        // library's own, so the two do not overlap.
        unsafe {
            ptr::copy_nonoverlapping(from.add(head), to.add(head), known - head);
            ptr::write_bytes(to.add(known), 0, self.size - known);
        }
    }
}

/// Where a call writes a number or a handle.
#[derive(Debug)]
pub struct Out<T>(*mut T);

impl<T> Out<T> {
    /// The memory at `to`, which the caller calls `field`.
    ///
    /// # Safety
    /// `to` is null, or stays writable until [`Self::write`].
    pub unsafe fn at(field: &str, to: *mut T) -> Result<Self, Fault> {
        if to.is_null() { Err(Fault::null(field)) } else { Ok(Self(to)) }
    }

    /// Writes `value`.
    pub fn write(self, value: T) {
        // SAFETY: `at` demands writable memory; no alignment is taken for granted.
        unsafe { self.0.write_unaligned(value) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::status::gs3_status;

    #[derive(Clone, Copy, Debug, PartialEq)]
    #[repr(C)]
    struct Sample {
        struct_size: u32,
        needed: u32,
        added: u64,
    }

    // SAFETY: as the trait demands.
    unsafe impl Descriptor for Sample {
        const BYTES: usize = 16;
        const LEAST: usize = 8;
    }

    #[derive(Clone, Copy)]
    #[repr(C)]
    struct Newer {
        sample: Sample,
        unknown: u64,
    }

    const NEWER: Newer = Newer { sample: Sample { struct_size: 24, needed: 5, added: 6 }, unknown: 0 };

    fn status(from: *const Sample) -> gs3_status {
        // SAFETY: null or a structure that has at least the bytes it says, as all callers below see to.
        unsafe { read("sample", from) }.unwrap_err().status
    }

    #[test]
    fn shorter_ones_lack_and_longer_ones_must_not_have() {
        let older = Sample { struct_size: 8, needed: 5, added: 6 };
        // SAFETY: a structure of this type.
        let read_older = unsafe { read("sample", &raw const older) }.unwrap();
        assert_eq!(read_older, Sample { struct_size: 8, needed: 5, added: 0 });
        let newer = NEWER;
        // SAFETY: a structure of 24 bytes, as it says.
        let read_newer = unsafe { read("sample", (&raw const newer).cast::<Sample>()) }.unwrap();
        assert_eq!(read_newer, NEWER.sample);
        let unknown = Newer { unknown: 1 << 56, ..NEWER };
        assert_eq!(status((&raw const unknown).cast()), GS3_ERROR_DESCRIPTOR);
        for struct_size in [0, 7, 4097, u32::MAX] {
            let wrong = Sample { struct_size, ..older };
            assert_eq!(status(&raw const wrong), GS3_ERROR_DESCRIPTOR, "{struct_size}");
        }
        assert_eq!(status(ptr::null()), gs3_status::GS3_ERROR_ARGUMENT);
    }

    #[test]
    fn results_end_where_either_side_ends() {
        let value = Sample { struct_size: 0, needed: 7, added: 8 };
        let mut older = Sample { struct_size: 8, needed: 0, added: 99 };
        // SAFETY: a structure of this type that lives on.
        unsafe { Answer::at("sample", &raw mut older) }.unwrap().write(&value);
        assert_eq!(older, Sample { struct_size: 8, needed: 7, added: 99 });
        let mut newer = Newer { unknown: u64::MAX, ..NEWER };
        // SAFETY: a structure of 24 bytes, as it says, that lives on.
        unsafe { Answer::at("sample", (&raw mut newer).cast::<Sample>()) }.unwrap().write(&value);
        assert_eq!(newer.sample, Sample { struct_size: 24, ..value });
        assert_eq!(newer.unknown, 0);
    }
}
