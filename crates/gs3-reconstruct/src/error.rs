//! Errors of the inputs of reconstruction.

use gs3_scene::camera::MAX_SIDE;
use gs3_scene::{GBuffer, Image, Margin, Planes, Size};

/// Why a reconstruction did not run. After an error nothing has been written and the history is unchanged.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ReconstructError {
    /// The scale factor is outside the supported range.
    #[error("scale: expected 1 to {max}, found {actual}", max = crate::MAX_SCALE)]
    Scale {
        /// The scale found.
        actual: u32,
    },
    /// An input does not have the size that the output requires.
    #[error("{what}: expected {expected} pixels, found {actual}")]
    Size {
        /// Which input.
        what: &'static str,
        /// The size expected.
        expected: Size,
        /// The size found.
        actual: Size,
    },
    /// Frames cannot have this size.
    #[error("frame size: expected 1x1 to {MAX_SIDE}x{MAX_SIDE}, found {actual}")]
    FrameSize {
        /// The size found.
        actual: Size,
    },
    /// The G-buffer lacks planes that this reconstruction needs.
    #[error("G-buffer: expected {what}, found none")]
    Missing {
        /// The planes missing.
        what: &'static str,
    },
    /// A plane has numbers that are not finite: they would spread from frame to frame.
    #[error("{what}: expected finite numbers, found NaN or infinity")]
    NotFinite {
        /// Which plane.
        what: &'static str,
    },
    /// The jitter is not finite or moves samples by more than a pixel.
    #[error("jitter: expected finite offsets within one low-resolution pixel, found [{}, {}]", actual[0], actual[1])]
    Jitter {
        /// The jitter found.
        actual: [f32; 2],
    },
    /// The margin is wider than the memory allows. Around the G-buffer of a picture no margin is allowed.
    #[error("margin: expected at most {max} pixels beyond each edge, found {actual}")]
    Margin {
        /// The widest margin allowed on a side.
        max: u32,
        /// The widest side found.
        actual: u32,
    },
    /// The G-buffer with a margin belongs to another frame.
    #[error("G-buffer with margin: expected the jitter of the one without, [{}, {}], found [{}, {}]", expected[0], expected[1], actual[0], actual[1])]
    JitterAround {
        /// Jitter of the picture.
        expected: [f32; 2],
        /// The jitter found.
        actual: [f32; 2],
    },
    /// The caller's memory ends before the end of the image.
    #[error("G-buffer: expected at least {expected} numbers in memory, found {actual}")]
    TooShort {
        /// Numbers that the image needs.
        expected: usize,
        /// Numbers found.
        actual: usize,
    },
    /// The distances of the clip planes of a depth encoding are not valid.
    #[error("clip planes: expected 0 < near < far, found near {near} and far {far}")]
    ClipPlanes {
        /// Distance of the near plane.
        near: f32,
        /// Distance of the far plane.
        far: f32,
    },
    /// The number of cameras between two frames is not the number of in-between frames.
    #[error("cameras between two frames: expected none or {expected}, found {actual}")]
    Poses {
        /// Number of in-between frames.
        expected: usize,
        /// Number of cameras given.
        actual: usize,
    },
    /// The time of an in-between frame is outside (0, 1).
    #[error("time: expected a value between 0 and 1, found {actual}")]
    Time {
        /// The time found.
        actual: f32,
    },
}

/// Checks the scale factor.
pub(crate) fn check_scale(scale: u32) -> Result<(), ReconstructError> {
    if (1..=crate::MAX_SCALE).contains(&scale) {
        Ok(())
    } else {
        Err(ReconstructError::Scale { actual: scale })
    }
}

/// Checks the size of frames in device memory. There the size does not come from a checked camera.
#[cfg(feature = "gpu")]
pub(crate) fn check_frame_size(size: Size) -> Result<(), ReconstructError> {
    let is_size = size.to_array().iter().all(|side| (1..=MAX_SIDE).contains(side));
    if is_size { Ok(()) } else { Err(ReconstructError::FrameSize { actual: size }) }
}

/// Checks that `actual` is the size `expected` of the input `what`.
pub(crate) fn check_size(what: &'static str, expected: Size, actual: Size) -> Result<(), ReconstructError> {
    if expected == actual { Ok(()) } else { Err(ReconstructError::Size { what, expected, actual }) }
}

/// Checks that all numbers of the plane `what` are finite.
pub(crate) fn check_finite<const C: usize>(
    what: &'static str,
    planes: &Planes<C>,
) -> Result<(), ReconstructError> {
    if planes.is_finite() { Ok(()) } else { Err(ReconstructError::NotFinite { what }) }
}

/// Checks that `jitter` is usable.
pub(crate) fn check_jitter(jitter: [f32; 2]) -> Result<(), ReconstructError> {
    let is_usable = jitter.iter().all(|j| j.abs() <= 1.0);
    if is_usable { Ok(()) } else { Err(ReconstructError::Jitter { actual: jitter }) }
}

/// Checks that `gbuffer` is the LR frame of an output of `size`, without margin, and that its jitter is usable.
pub(crate) fn check_gbuffer(gbuffer: &GBuffer, scale: u32, size: Size) -> Result<(), ReconstructError> {
    let expected = size.map(|side| side.div_ceil(scale));
    if gbuffer.margin != Margin::NONE {
        return Err(ReconstructError::Margin { max: 0, actual: gbuffer.margin.widest() });
    }
    check_planes(gbuffer, expected)
}

/// Checks that `padded` is the frame of `gbuffer` with a margin. `gbuffer` has been checked.
pub(crate) fn check_padded(padded: &GBuffer, gbuffer: &GBuffer) -> Result<(), ReconstructError> {
    let (expected, actual) = (gbuffer.jitter, padded.jitter);
    if expected != actual {
        return Err(ReconstructError::JitterAround { expected, actual });
    }
    check_planes(padded, padded.margin.padded(gbuffer.size()))
}

/// Checks that all planes of `gbuffer` that exist have the size `expected`, and that its jitter is usable.
fn check_planes(gbuffer: &GBuffer, expected: Size) -> Result<(), ReconstructError> {
    check_size("G-buffer", expected, gbuffer.size())?;
    check_jitter(gbuffer.jitter)?;
    if let Some(gradients) = &gbuffer.gradients {
        for plane in [&gradients.color_dx, &gradients.color_dy].into_iter().chain(&gradients.color_dxy) {
            check_size("G-buffer gradients", expected, plane.size())?;
        }
    }
    if let Some(geometry) = &gbuffer.geometry {
        check_size("G-buffer depth", expected, geometry.depth_median.size())?;
    }
    Ok(())
}

/// Checks that `gbuffer` is the LR frame of `out`; the size of `out` is the size of the HR frame.
pub(crate) fn check_frame_of(out: &Image, gbuffer: &GBuffer, scale: u32) -> Result<(), ReconstructError> {
    check_scale(scale)?;
    let (lr, size) = (gbuffer.size(), out.size());
    if lr.pixels() == 0 {
        return Err(ReconstructError::Missing { what: "colour" });
    }
    if size.pixels() == 0 {
        let expected = lr.map(|side| side.saturating_mul(scale));
        return Err(ReconstructError::Size { what: "image", expected, actual: size });
    }
    check_gbuffer(gbuffer, scale, size)
}
