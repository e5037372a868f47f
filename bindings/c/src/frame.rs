//! What renderers and reconstructors have in common: history, in-between frames, what is told of a frame.
#![allow(unsafe_code, reason = "memory of the caller")]

use gs3::reconstruct::{Kriging, Sampling};
use gs3::scene::{Image, Size};
use gs3::{MAX_IN_BETWEEN, ResetReason, Stage, StageTimes};

use crate::choice::choice;
use crate::descriptor::Descriptor;
use crate::pixels::{Output, gs3_output};
use crate::status::Fault;

/// Where within their pixels low-resolution frames are sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub enum gs3_sampling {
    /// Where the frames before did not sample: after scale^2 frames a resting camera has seen every pixel.
    GS3_SAMPLING_JITTERED = 0,
    /// Always at pixel centres.
    GS3_SAMPLING_CENTERED = 1,
}

/// Which pixels are predicted from up to eight samples around them (gradient-enhanced kriging) instead of the mean of
/// first-order predictions: sharper in motion, and slower.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub enum gs3_kriging {
    /// None.
    GS3_KRIGING_OFF = 0,
    /// Where that mean errs most.
    GS3_KRIGING_COARSE = 1,
    /// Where it errs by about a step of 8 bits.
    GS3_KRIGING_ON = 2,
    /// Wherever it makes a difference.
    GS3_KRIGING_FINE = 3,
}

/// The choice of a gs3_sampling.
pub fn sampling(value: u32) -> Result<Sampling, Fault> {
    choice(
        "sampling",
        "gs3_sampling",
        value,
        &[
            (gs3_sampling::GS3_SAMPLING_JITTERED as u32, Sampling::Jittered),
            (gs3_sampling::GS3_SAMPLING_CENTERED as u32, Sampling::Centered),
        ],
    )
}

/// The choice of a gs3_kriging.
pub fn kriging(value: u32) -> Result<Kriging, Fault> {
    let all = [
        (gs3_kriging::GS3_KRIGING_OFF as u32, Kriging::Off),
        (gs3_kriging::GS3_KRIGING_COARSE as u32, Kriging::Coarse),
        (gs3_kriging::GS3_KRIGING_ON as u32, Kriging::On),
        (gs3_kriging::GS3_KRIGING_FINE as u32, Kriging::Fine),
    ];
    choice("kriging", "gs3_kriging", value, &all)
}

/// Most frames between two.
pub const GS3_MAX_IN_BETWEEN: u32 = 3;
const _: () = assert!(GS3_MAX_IN_BETWEEN == MAX_IN_BETWEEN);

/// Why a frame has no history. Such a frame is less sharp than those to come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub enum gs3_reset_reason {
    /// The frame has one.
    GS3_RESET_NONE = 0,
    /// It is the first.
    GS3_RESET_FIRST_FRAME = 1,
    /// The camera jumped, or the caller asked for it.
    GS3_RESET_CUT = 2,
    /// The size or the settings changed.
    GS3_RESET_SIZE = 3,
    /// The scene changed.
    GS3_RESET_SCENE = 4,
    /// Another machine renders.
    GS3_RESET_BACKEND = 5,
    /// The frame before failed.
    GS3_RESET_FAILURE = 6,
    /// A reason that this version of the header does not name.
    GS3_RESET_OTHER = 7,
    /// The frame is a keyframe, where all begins anew. In-between frames lead to it.
    GS3_RESET_KEYFRAME = 8,
}

/// The number of `reset`.
pub const fn reset_reason(reset: Option<ResetReason>) -> u32 {
    let reason = match reset {
        None => gs3_reset_reason::GS3_RESET_NONE,
        Some(ResetReason::FirstFrame) => gs3_reset_reason::GS3_RESET_FIRST_FRAME,
        Some(ResetReason::CameraCut) => gs3_reset_reason::GS3_RESET_CUT,
        Some(ResetReason::SizeOrTierChange) => gs3_reset_reason::GS3_RESET_SIZE,
        Some(ResetReason::SceneChange) => gs3_reset_reason::GS3_RESET_SCENE,
        Some(ResetReason::BackendChange) => gs3_reset_reason::GS3_RESET_BACKEND,
        Some(ResetReason::Failure) => gs3_reset_reason::GS3_RESET_FAILURE,
        Some(ResetReason::Keyframe) => gs3_reset_reason::GS3_RESET_KEYFRAME,
        Some(_) => gs3_reset_reason::GS3_RESET_OTHER,
    };
    reason as u32
}

/// What is told of a frame.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct gs3_frame_info {
    /// sizeof(gs3_frame_info).
    pub struct_size: u32,
    /// A gs3_reset_reason.
    pub reset_reason: u32,
    /// In-between frames that were made and written: all or, after a reset, none. Then the frame before stays on for their
    /// moments.
    pub in_between_count: u32,
    /// Share of the pixels that were rasterized exactly besides the low-resolution grid, 0 to 1.
    pub refined_share: f32,
    /// Time of each stage, milliseconds, 0 of one that did not run. Of a reconstructor they are 0.
    pub rasterize_ms: f32,
    /// See rasterize_ms.
    pub super_sample_ms: f32,
    /// See rasterize_ms.
    pub refine_ms: f32,
    /// See rasterize_ms.
    pub interpolate_ms: f32,
}

// SAFETY: as the trait demands.
unsafe impl Descriptor for gs3_frame_info {
    const BYTES: usize = 8 * 4;
    const LEAST: usize = 4;
}

impl gs3_frame_info {
    pub fn new(reset: Option<ResetReason>, between: usize, refined_share: f32, times: &StageTimes) -> Self {
        let ms = |stage| times.get(stage).map_or(0.0, |time| (time.as_secs_f64() * 1e3) as f32);
        Self {
            struct_size: 0,
            reset_reason: reset_reason(reset),
            in_between_count: between as u32,
            refined_share,
            rasterize_ms: ms(Stage::Rasterize),
            super_sample_ms: ms(Stage::SuperSample),
            refine_ms: ms(Stage::Refine),
            interpolate_ms: ms(Stage::Interpolate),
        }
    }
}

/// Where a call writes its frames.
#[derive(Clone, Debug)]
pub struct Outputs {
    current: Output,
    between: Vec<Output>,
}

impl Outputs {
    /// The outputs that a descriptor tells of, each of `size` pixels. `between` are pointers to `count` descriptors, null for
    /// none.
    ///
    /// # Safety
    /// All are as [`Output::read`] demands, and `between` is null or points to `count` pointers.
    pub unsafe fn read(
        current: *const gs3_output,
        between: *const *const gs3_output,
        count: u32,
        size: Size,
    ) -> Result<Self, Fault> {
        // SAFETY: the contract of this function.
        let current = unsafe { Output::read("output", current, size) }?;
        let count = if between.is_null() { 0 } else { count as usize };
        let output = |index: usize| {
            // SAFETY: the contract of this function; pointers are read wherever they lie.
            unsafe {
                Output::read(
                    &format!("in_between_outputs[{index}]"),
                    between.add(index).read_unaligned(),
                    size,
                )
            }
        };
        Ok(Self { current, between: (0..count).map(output).collect::<Result<_, _>>()? })
    }

    /// Writes the frames, and tells how many between.
    pub fn write<'a>(
        &self,
        current: &Image,
        between: impl Iterator<Item = &'a Image>,
        has_fourth: bool,
    ) -> Result<usize, Fault> {
        self.current.write(current, has_fourth)?;
        let mut count = 0;
        for (output, image) in self.between.iter().zip(between) {
            output.write(image, has_fourth)?;
            count += 1;
        }
        Ok(count)
    }
}

/// Checks how many frames between a call speaks of, before it reads what is said of them.
pub fn check_count(count: u32) -> Result<(), Fault> {
    if count <= GS3_MAX_IN_BETWEEN {
        return Ok(());
    }
    Err(Fault::argument("in_between_count", format_args!("0 to {GS3_MAX_IN_BETWEEN}"), count))
}

/// Checks how many frames between a call asks for: `made` or, where it wants none of them, 0.
pub fn check_between(count: u32, made: u32) -> Result<(), Fault> {
    if count == 0 || count == made {
        return Ok(());
    }
    Err(Fault::argument(
        "in_between_count",
        format_args!("0 or {made}, as the handle was created for"),
        count,
    ))
}
