//! What can be asked without a handle.
#![allow(unsafe_code, reason = "exported functions")]

use std::ffi::c_char;

use gs3::compute::{AdapterKind, AdapterReport, adapters};
use gs3::reconstruct::MAX_SCALE;
use gs3::scene::Jitter;
use gs3::scene::camera::MAX_SIDE;

use crate::choice::or_default;
use crate::descriptor::{Answer, Descriptor, Out};
use crate::renderer::{GS3_NAME_BYTES, name};
use crate::status::{Fault, gs3_status, guard};

/// The version that this header describes: major * 10000 + minor * 100 + patch.
pub const GS3_VERSION: u32 = 100;

/// The version of the library. GS3_VERSION is the version of the header. Programs run with later libraries of the same major
/// number.
#[unsafe(no_mangle)]
pub extern "C" fn gs3_query_version() -> u32 {
    GS3_VERSION
}

/// A scale that was asked for, 0 for the default.
fn checked_scale(scale: u32) -> Result<u32, Fault> {
    let scale = or_default(scale, 4);
    if (1..=MAX_SCALE).contains(&scale) {
        return Ok(scale);
    }
    Err(Fault::argument("scale", format_args!("1 to {MAX_SCALE}, or 0 for 4"), scale))
}

/// Tells how large the low-resolution frames of an image of width x height pixels are: both divided by the
/// scale (0 for 4), rounded up.
///
/// # Safety
/// render_width and render_height point to numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_query_render_size(
    width: u32,
    height: u32,
    scale: u32,
    render_width: *mut u32,
    render_height: *mut u32,
) -> gs3_status {
    guard("gs3_query_render_size", || {
        let scale = checked_scale(scale)?;
        for (field, side) in [("width", width), ("height", height)] {
            if !(1..=MAX_SIDE).contains(&side) {
                return Err(Fault::argument(field, format_args!("1 to {MAX_SIDE}"), side));
            }
        }
        // SAFETY: the contract of this function.
        let (to_width, to_height) =
            unsafe { (Out::at("render_width", render_width)?, Out::at("render_height", render_height)?) };
        to_width.write(width.div_ceil(scale));
        to_height.write(height.div_ceil(scale));
        Ok(())
    })
}

/// Tells after how many frames a resting camera has been sampled everywhere at a scale (0 for 4): its square.
///
/// # Safety
/// count points to a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_query_jitter_count(scale: u32, count: *mut u32) -> gs3_status {
    guard("gs3_query_jitter_count", || {
        let scale = checked_scale(scale)?;
        // SAFETY: the contract of this function.
        unsafe { Out::at("count", count) }?.write(scale * scale);
        Ok(())
    })
}

/// Tells an offset of the sampling grid of a scale (0 for 4), in low-resolution pixels from the pixel centre, x right and y
/// down: that of number frame in the order that suits a resting camera, which repeats itself. gs3_reconstructor_query_next
/// chooses among the same by what the frames before sampled, which is better in motion.
///
/// # Safety
/// jitter points to two numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_query_jitter(scale: u32, frame: u64, jitter: *mut f32) -> gs3_status {
    guard("gs3_query_jitter", || {
        let scale = checked_scale(scale)?;
        // SAFETY: the contract of this function.
        let to = unsafe { Out::at("jitter", jitter.cast::<[f32; 2]>()) }?;
        to.write(Jitter::grid(scale).offset(frame));
        Ok(())
    })
}

/// What an adapter is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub enum gs3_adapter_kind {
    /// A graphics card with its own memory.
    GS3_ADAPTER_KIND_DISCRETE = 0,
    /// A graphics unit that shares the processor's memory.
    GS3_ADAPTER_KIND_INTEGRATED = 1,
    /// A share of a graphics card in a virtual machine.
    GS3_ADAPTER_KIND_VIRTUAL = 2,
    /// The driver does not say.
    GS3_ADAPTER_KIND_UNKNOWN = 3,
    /// The processor: slower than the library's own path on it.
    GS3_ADAPTER_KIND_SOFTWARE = 4,
}

/// A GPU as one programming interface shows it.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct gs3_adapter_info {
    /// sizeof(gs3_adapter_info).
    pub struct_size: u32,
    /// A gs3_adapter_kind.
    pub kind: u32,
    /// 1 if it has all that the library needs.
    pub is_usable: u32,
    /// 0.
    pub reserved: u32,
    /// Its name and the interface.
    pub name: [c_char; GS3_NAME_BYTES],
}

// SAFETY: as the trait demands.
unsafe impl Descriptor for gs3_adapter_info {
    const BYTES: usize = 4 * 4 + 128;
    const LEAST: usize = 4;
}

/// Tells how many adapters there are, 0 on a machine without a driver.
///
/// # Safety
/// count points to a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_query_adapter_count(count: *mut u32) -> gs3_status {
    guard("gs3_query_adapter_count", || {
        // SAFETY: the contract of this function.
        unsafe { Out::at("count", count) }?.write(adapters().len() as u32);
        Ok(())
    })
}

/// Tells what the adapter of number index is, counted from 0.
///
/// # Safety
/// info points to a gs3_adapter_info with struct_size set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_query_adapter(index: u32, info: *mut gs3_adapter_info) -> gs3_status {
    guard("gs3_query_adapter", || {
        // SAFETY: the contract of this function.
        let answer = unsafe { Answer::at("info", info) }?;
        let found = adapters();
        let Some(AdapterReport { name: text, api, kind, missing, .. }) = found.get(index as usize) else {
            let expected = format_args!("a number below {}, of adapters", found.len()).to_string();
            return Err(Fault::argument("index", expected, index));
        };
        let kind = match kind {
            AdapterKind::Discrete => gs3_adapter_kind::GS3_ADAPTER_KIND_DISCRETE,
            AdapterKind::Integrated => gs3_adapter_kind::GS3_ADAPTER_KIND_INTEGRATED,
            AdapterKind::Virtual => gs3_adapter_kind::GS3_ADAPTER_KIND_VIRTUAL,
            AdapterKind::Unknown => gs3_adapter_kind::GS3_ADAPTER_KIND_UNKNOWN,
            AdapterKind::Software => gs3_adapter_kind::GS3_ADAPTER_KIND_SOFTWARE,
        };
        answer.write(&gs3_adapter_info {
            struct_size: 0,
            kind: kind as u32,
            is_usable: u32::from(missing.is_none()),
            reserved: 0,
            name: name(&format!("{text} ({api})")),
        });
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn header_and_package_have_one_version() {
        let part = |text: &str| text.parse::<u32>().unwrap();
        let expected = part(env!("CARGO_PKG_VERSION_MAJOR")) * 10_000
            + part(env!("CARGO_PKG_VERSION_MINOR")) * 100
            + part(env!("CARGO_PKG_VERSION_PATCH"));
        assert_eq!(gs3_query_version(), expected);
    }

    #[test]
    fn every_scale_has_as_many_offsets_as_it_says() {
        for scale in 1..=MAX_SCALE {
            let mut count = 0;
            // SAFETY: a number that lives on.
            assert_eq!(unsafe { gs3_query_jitter_count(scale, &raw mut count) }, gs3_status::GS3_OK);
            assert_eq!(count as usize, Jitter::grid(scale).period());
        }
    }
}
