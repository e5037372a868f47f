//! Planes and images in the caller's memory.
#![allow(unsafe_code, reason = "memory of the caller")]

use std::ffi::c_void;
use std::mem::MaybeUninit;
use std::slice;

use gs3::reconstruct::{PlanesView, Strides};
use gs3::scene::{Image, Size};
use rayon::prelude::*;

use crate::choice::{choice, flag};
use crate::descriptor::{self, Descriptor};
use crate::status::Fault;
use crate::status::gs3_status::GS3_ERROR_LAYOUT;

/// What a number of an input is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub enum gs3_number {
    /// 32-bit float of the machine's byte order.
    GS3_NUMBER_FLOAT32 = 0,
}

/// Numbers of a frame that a call reads: channel c of the pixel in column x of row y lies at
/// data + y * row_stride + x * pixel_stride + c * channel_stride. Row 0 is the topmost.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct gs3_input {
    /// sizeof(gs3_input).
    pub struct_size: u32,
    /// A gs3_number.
    pub number: u32,
    /// The first number, at an address divisible by 4.
    pub data: *const c_void,
    /// Bytes that may be read from data on.
    pub size: u64,
    /// Bytes from row to row, 0 for rows without gaps. Strides are divisible by 4.
    pub row_stride: u64,
    /// Bytes from pixel to pixel of a row, 0 for pixels without gaps (of as many channels as are read).
    pub pixel_stride: u64,
    /// Bytes from channel to channel of a pixel, 0 for 4. Of planes one after the other it is a plane's size.
    pub channel_stride: u64,
}

// SAFETY: as the trait demands.
unsafe impl Descriptor for gs3_input {
    const BYTES: usize = 4 + 4 + 5 * 8;
    const LEAST: usize = 24;
}

/// Bytes of a number.
const FLOAT: u64 = size_of::<f32>() as u64;

impl gs3_input {
    /// The numbers that the descriptor at `from`, which the caller calls `field`, tells of: `C` channels of `size` pixels.
    ///
    /// # Safety
    /// `from` is as [`descriptor::read`] demands, and its memory stays readable for `'a`.
    pub unsafe fn read<'a, const C: usize>(
        field: &str,
        from: *const Self,
        size: Size,
    ) -> Result<PlanesView<'a, C>, Fault> {
        // SAFETY: the contract of this function.
        let input = unsafe { descriptor::read(field, from) }?;
        // SAFETY: likewise.
        let view = unsafe { input.numbers::<C>(size) }
            .and_then(|(data, strides)| Ok(PlanesView::new(data, size, strides)?));
        view.map_err(|fault| fault.within(field))
    }

    /// As [`Self::read`], each channel times its factor (0 for 1): planes without gaps.
    ///
    /// # Safety
    /// As [`Self::read`].
    pub unsafe fn read_scaled<const C: usize>(
        field: &str,
        from: *const Self,
        size: Size,
        factors: [f32; C],
    ) -> Result<Vec<f32>, Fault> {
        // SAFETY: the contract of this function. All of the numbers are seen to be there before they are read.
        let (data, strides) = unsafe {
            Self::read::<C>(field, from, size)?;
            descriptor::read(field, from)?.numbers::<C>(size)?
        };
        let [width, height] = size.to_usize();
        let mut scaled = Vec::with_capacity(C * width * height);
        for (c, factor) in factors.into_iter().enumerate() {
            let factor = if factor == 0.0 { 1.0 } else { factor };
            for y in 0..height {
                let row = y * strides.row + c * strides.channel;
                scaled.extend((0..width).map(|x| factor * data[row + x * strides.pixel]));
            }
        }
        Ok(scaled)
    }

    /// What lies in memory, and how.
    ///
    /// # Safety
    /// As [`Self::read`].
    unsafe fn numbers<'a, const C: usize>(&self, size: Size) -> Result<(&'a [f32], Strides), Fault> {
        choice("number", "gs3_number", self.number, &[(gs3_number::GS3_NUMBER_FLOAT32 as u32, ())])?;
        let channel = or_else(self.channel_stride, || FLOAT);
        let pixel = or_else(self.pixel_stride, || C as u64 * FLOAT);
        let row = or_else(self.row_stride, || pixel.saturating_mul(u64::from(size.width)));
        for (field, bytes) in [("row_stride", row), ("pixel_stride", pixel), ("channel_stride", channel)] {
            if bytes % FLOAT != 0 {
                return Err(layout(field, "bytes divisible by 4", bytes));
            }
        }
        // SAFETY: the contract of this function.
        let data = unsafe { floats("data", self.data.cast(), self.size / FLOAT) }?;
        let numbers = |bytes: u64| usize::try_from(bytes / FLOAT).unwrap_or(usize::MAX);
        Ok((data, Strides { row: numbers(row), pixel: numbers(pixel), channel: numbers(channel) }))
    }
}

/// `count` numbers from `data` on, which the caller calls `field`.
///
/// # Safety
/// `data` is null, or that many numbers are readable there for `'a`.
pub unsafe fn floats<'a>(field: &str, data: *const f32, count: u64) -> Result<&'a [f32], Fault> {
    if data.is_null() {
        return Err(Fault::null(field));
    }
    if !data.is_aligned() {
        return Err(layout(field, "an address divisible by 4", format_args!("{data:p}")));
    }
    let most = isize::MAX as u64 / FLOAT;
    if count > most {
        return Err(layout(field, format_args!("at most {most} numbers"), count));
    }
    // SAFETY: neither null nor unaligned, no larger than memory can be, and readable by the contract of this function.
    Ok(unsafe { slice::from_raw_parts(data, count as usize) })
}

/// What the pixels of an output are. Colours are display-encoded red, green and blue. The function that writes the output
/// says what the fourth channel is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub enum gs3_format {
    /// Four 32-bit floats, nominally 0 to 1, not clamped. Their address needs no alignment.
    GS3_FORMAT_RGBA_FLOAT32 = 0,
    /// Three 32-bit floats.
    GS3_FORMAT_RGB_FLOAT32 = 1,
    /// Four bytes, 0 to 255, clamped and rounded to nearest.
    GS3_FORMAT_RGBA8 = 2,
    /// Three bytes.
    GS3_FORMAT_RGB8 = 3,
}

/// An image that a call writes: the pixel in column x of row y lies at data + y * row_stride + x * pixel_stride. Row 0 is the
/// topmost. Bytes between pixels and rows stay as they are.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct gs3_output {
    /// sizeof(gs3_output).
    pub struct_size: u32,
    /// A gs3_format.
    pub format: u32,
    /// The first pixel. It may lie at any address.
    pub data: *mut c_void,
    /// Bytes that may be written from data on.
    pub size: u64,
    /// Bytes from row to row: 0 for rows without gaps, or at least the bytes of a row.
    pub row_stride: u64,
    /// Bytes from pixel to pixel of a row: 0 for pixels without gaps, or at least the bytes of a pixel.
    pub pixel_stride: u64,
    /// 1 for a fourth channel of 1 (or 255) instead of the frame's own.
    pub opaque: u32,
    /// 0.
    pub reserved: u32,
}

// SAFETY: as the trait demands.
unsafe impl Descriptor for gs3_output {
    const BYTES: usize = 4 + 4 + 4 * 8 + 4 + 4;
    const LEAST: usize = 24;
}

/// Rows that a thread writes at a time.
const ROWS_AT_ONCE: usize = 16;

/// A checked [`gs3_output`]: all pixels lie within its memory, and none in another.
#[derive(Clone, Copy, Debug)]
pub struct Output {
    format: gs3_format,
    data: *mut u8,
    size: Size,
    row_stride: usize,
    pixel_stride: usize,
    opaque: bool,
}

// SAFETY: the caller lends its memory to the call, whatever threads do its work.
unsafe impl Send for Output {}
// SAFETY: likewise; threads write different rows.
unsafe impl Sync for Output {}

impl Output {
    /// The output of `size` pixels that the descriptor at `from`, which the caller calls `field`, tells of.
    ///
    /// # Safety
    /// `from` is as [`descriptor::read`] demands, and its memory stays writable until the last [`Self::write`].
    pub unsafe fn read(field: &str, from: *const gs3_output, size: Size) -> Result<Self, Fault> {
        // SAFETY: the contract of this function.
        let output = unsafe { descriptor::read(field, from) }?;
        Self::check(&output, size).map_err(|fault| fault.within(field))
    }

    fn check(output: &gs3_output, size: Size) -> Result<Self, Fault> {
        use gs3_format::{
            GS3_FORMAT_RGB_FLOAT32, GS3_FORMAT_RGB8, GS3_FORMAT_RGBA_FLOAT32, GS3_FORMAT_RGBA8,
        };
        let formats = [GS3_FORMAT_RGBA_FLOAT32, GS3_FORMAT_RGB_FLOAT32, GS3_FORMAT_RGBA8, GS3_FORMAT_RGB8];
        let formats = formats.map(|format| (format as u32, format));
        let format = choice("format", "gs3_format", output.format, &formats)?;
        let opaque = flag("opaque", output.opaque)?;
        if output.data.is_null() {
            return Err(Fault::null("data"));
        }
        let bytes: u64 = match format {
            GS3_FORMAT_RGBA_FLOAT32 => 16,
            GS3_FORMAT_RGB_FLOAT32 => 12,
            GS3_FORMAT_RGBA8 => 4,
            GS3_FORMAT_RGB8 => 3,
        };
        let [width, height] = size.to_array().map(u64::from);
        // The bytes from the first to behind the last of `count` pieces of `bytes`, `stride` apart.
        let extent = |count: u64, stride: u64, bytes: u64| {
            count.checked_sub(1).map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(bytes))
        };
        let pixel = or_else(output.pixel_stride, || bytes);
        if pixel < bytes {
            return Err(layout("pixel_stride", format_args!("0 or at least {bytes} bytes"), pixel));
        }
        let row_bytes = extent(width, pixel, bytes).unwrap_or(u64::MAX);
        let row = or_else(output.row_stride, || row_bytes.max(width.saturating_mul(pixel)));
        if row < row_bytes {
            return Err(layout("row_stride", format_args!("0 or at least {row_bytes} bytes"), row));
        }
        let needed = extent(height, row, row_bytes).unwrap_or(u64::MAX);
        if output.size < needed || needed > isize::MAX as u64 {
            let expected = format!("at least {needed} bytes for {size} pixels");
            return Err(layout("size", expected, output.size));
        }
        let [row_stride, pixel_stride] = [row, pixel].map(|stride| stride as usize);
        Ok(Self { format, data: output.data.cast(), size, row_stride, pixel_stride, opaque })
    }

    /// Writes `image`. With `has_fourth` its fourth channel is written; else the fourth channel becomes 1.
    pub fn write(&self, image: &Image, has_fourth: bool) -> Result<(), Fault> {
        let (expected, actual) = (self.size, image.size());
        if expected != actual {
            return Err(Fault::argument("output", format!("{expected} pixels"), format!("{actual} pixels")));
        }
        let is_opaque = self.opaque || !has_fourth;
        let fourth = move |pixel: &[f32; 4]| if is_opaque { 1.0 } else { pixel[3] };
        match self.format {
            gs3_format::GS3_FORMAT_RGBA_FLOAT32 => self.write_pixels::<16>(image, move |pixel| {
                let [r, g, b, _] = *pixel;
                bytes_of([r, g, b, fourth(pixel)])
            }),
            gs3_format::GS3_FORMAT_RGB_FLOAT32 => {
                self.write_pixels::<12>(image, |pixel| bytes_of([pixel[0], pixel[1], pixel[2]]));
            }
            gs3_format::GS3_FORMAT_RGBA8 => self.write_pixels::<4>(image, move |pixel| {
                let [r, g, b, _] = *pixel;
                [r, g, b, fourth(pixel)].map(byte)
            }),
            gs3_format::GS3_FORMAT_RGB8 => {
                self.write_pixels::<3>(image, |pixel| [pixel[0], pixel[1], pixel[2]].map(byte));
            }
        }
        Ok(())
    }

    fn write_pixels<const N: usize>(&self, image: &Image, bytes: impl Fn(&[f32; 4]) -> [u8; N] + Sync) {
        let [width, height] = self.size.to_usize();
        let row_bytes = (width - 1) * self.pixel_stride + N;
        (0..height).into_par_iter().with_min_len(ROWS_AT_ONCE).for_each(|y| {
            // SAFETY: `check` has seen that all rows lie within the caller's memory, which `read` demands to be writable,
            // and that they do not overlap; this row is written by this thread alone. Nothing in it is taken to be set.
            let row = unsafe {
                let start = self.data.add(y * self.row_stride).cast::<MaybeUninit<u8>>();
                slice::from_raw_parts_mut(start, row_bytes)
            };
            for (to, pixel) in row.chunks_mut(self.pixel_stride).zip(image.row(y)) {
                for (to, byte) in to.iter_mut().zip(bytes(pixel)) {
                    to.write(byte);
                }
            }
        });
    }
}

/// Clamped to 0 to 1 and rounded to nearest, as [`Image::to_rgb8`] does: `as` saturates and maps NaN to 0.
fn byte(value: f32) -> u8 {
    (value * 255.0 + 0.5) as u8
}

/// The bytes of `N / 4` numbers.
fn bytes_of<const C: usize, const N: usize>(numbers: [f32; C]) -> [u8; N] {
    let mut bytes = [0; N];
    for (to, number) in bytes.chunks_exact_mut(size_of::<f32>()).zip(numbers) {
        to.copy_from_slice(&number.to_ne_bytes());
    }
    bytes
}

/// A layout that does not fit.
fn layout(field: &str, expected: impl std::fmt::Display, actual: impl std::fmt::Display) -> Fault {
    Fault { status: GS3_ERROR_LAYOUT, ..Fault::argument(field, expected, actual) }
}

/// `value`, or the default where it is 0.
fn or_else(value: u64, default: impl FnOnce() -> u64) -> u64 {
    if value == 0 { default() } else { value }
}
