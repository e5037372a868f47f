//! High-resolution frames from those of any renderer.
#![allow(unsafe_code, reason = "exported functions")]

use gs3::raster::MAX_MARGIN;
use gs3::reconstruct::{DepthEncoding, GBufferView, PlanesView, ReconstructorSettings};
use gs3::scene::{Camera, Margin, Size};
use gs3::{Reconstructor, ResetReason, StageTimes};

use crate::camera::gs3_camera;
use crate::choice::{choice, flag, or_default};
use crate::descriptor::{self, Answer, Descriptor, Out};
use crate::frame::{Outputs, check_between, check_count, gs3_frame_info, kriging, reset_reason, sampling};
use crate::handle::{self, Handle};
use crate::memory::gs3_memory;
use crate::pixels::{gs3_input, gs3_output};
use crate::status::{Fault, gs3_status, guard};

/// How a reconstructor reconstructs.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct gs3_reconstructor_desc {
    /// sizeof(gs3_reconstructor_desc).
    pub struct_size: u32,
    /// Width and height of what is shown over those of what is rendered, 1 to 8; 0 for 4.
    pub scale: u32,
    /// In-between frames that come before each frame, 0 to GS3_MAX_IN_BETWEEN.
    pub in_between_count: u32,
    /// A gs3_sampling.
    pub sampling: u32,
    /// A gs3_kriging.
    pub kriging: u32,
    /// Most pixels that the renderer can render beyond each edge, 0 to 32.
    pub widest_margin: u32,
    /// Threads of the reconstructor, at most 1024; 0 for as many as the machine runs at once.
    pub threads: u32,
    /// 0.
    pub reserved: u32,
}

// SAFETY: as the trait demands.
unsafe impl Descriptor for gs3_reconstructor_desc {
    const BYTES: usize = 8 * 4;
    const LEAST: usize = 4;
}

impl gs3_reconstructor_desc {
    fn settings(&self) -> Result<ReconstructorSettings, Fault> {
        check_count(self.in_between_count)?;
        if self.widest_margin > MAX_MARGIN {
            return Err(Fault::argument(
                "widest_margin",
                format_args!("0 to {MAX_MARGIN}"),
                self.widest_margin,
            ));
        }
        Ok(ReconstructorSettings {
            scale: or_default(self.scale, 4),
            sampling: sampling(self.sampling)?,
            kriging: kriging(self.kriging)?,
            widest_margin: self.widest_margin,
            in_between: self.in_between_count as usize,
        })
    }
}

/// Reconstructs the frames of one renderer, one after the other, on threads of its own. One call at a time may use it, from
/// any thread.
#[derive(Debug)]
pub struct gs3_reconstructor {
    handle: Handle<Reconstructor>,
}

/// Makes a reconstructor. desc may be NULL for all defaults. The handle is written to reconstructor.
///
/// # Safety
/// desc is NULL or as its structure describes, and reconstructor points to a pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_reconstructor_create(
    desc: *const gs3_reconstructor_desc,
    reconstructor: *mut *mut gs3_reconstructor,
) -> gs3_status {
    guard("gs3_reconstructor_create", || {
        // SAFETY: the contract of this function.
        let to = unsafe { Out::at("reconstructor", reconstructor) }?;
        // SAFETY: likewise.
        let desc = unsafe { descriptor::read_or_default::<gs3_reconstructor_desc>("desc", desc) }?;
        let make = || Ok::<_, Fault>(Reconstructor::new(desc.settings()?)?);
        let handle = Handle::new(desc.threads, make).map_err(|fault| fault.within("desc"))?;
        to.write(Box::into_raw(Box::new(gs3_reconstructor { handle })));
        Ok(())
    })
}

/// Reconstructs with other settings from the next frame on, which is a first one; threads are not read. If it fails, the old
/// ones stay.
///
/// # Safety
/// reconstructor is a reconstructor, and desc NULL or as its structure describes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_reconstructor_configure(
    reconstructor: *mut gs3_reconstructor,
    desc: *const gs3_reconstructor_desc,
) -> gs3_status {
    guard("gs3_reconstructor_configure", || {
        // SAFETY: the contract of this function.
        let reconstructor = unsafe { handle::read("reconstructor", reconstructor.cast_const()) }?;
        // SAFETY: likewise.
        let desc = unsafe { descriptor::read_or_default::<gs3_reconstructor_desc>("desc", desc) }?;
        reconstructor.handle.call(|reconstructor| {
            let settings = desc.settings().map_err(|fault| fault.within("desc"))?;
            *reconstructor = Reconstructor::new(settings)?;
            Ok::<_, Fault>(())
        })
    })
}

/// Pixels beyond the edges of a frame, of the grid that is rendered.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C)]
pub struct gs3_margin {
    /// Columns before the first.
    pub left: u32,
    /// Rows above the first.
    pub top: u32,
    /// Columns after the last.
    pub right: u32,
    /// Rows below the last.
    pub bottom: u32,
}

/// How a frame is to be rendered.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct gs3_frame_start {
    /// sizeof(gs3_frame_start).
    pub struct_size: u32,
    /// Why it will have no history, a gs3_reset_reason.
    pub reset_reason: u32,
    /// Where to sample: an offset from pixel centres, in pixels of the grid that is rendered, x right and y down.
    pub jitter: [f32; 2],
    /// Width of what is rendered, without the margin.
    pub render_width: u32,
    /// Height of what is rendered, without the margin.
    pub render_height: u32,
    /// What is worth rendering beyond the edges, at most widest_margin.
    pub margin: gs3_margin,
}

// SAFETY: as the trait demands.
unsafe impl Descriptor for gs3_frame_start {
    const BYTES: usize = 10 * 4;
    const LEAST: usize = 4;
}

/// Tells how the frame of a camera is to be rendered. The camera is that of the image shown: what is rendered has its
/// intrinsics divided by the scale. Asking changes nothing.
///
/// # Safety
/// reconstructor is a reconstructor, camera as its structure describes, and start points to a gs3_frame_start with
/// struct_size set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_reconstructor_query_next(
    reconstructor: *mut gs3_reconstructor,
    camera: *const gs3_camera,
    start: *mut gs3_frame_start,
) -> gs3_status {
    guard("gs3_reconstructor_query_next", || {
        // SAFETY: the contract of this function.
        let reconstructor = unsafe { handle::read("reconstructor", reconstructor.cast_const()) }?;
        // SAFETY: likewise.
        let (camera, answer) = unsafe { (gs3_camera::read("camera", camera)?, Answer::at("start", start)?) };
        let start = reconstructor.handle.call(|reconstructor| {
            let start = reconstructor.next(&camera);
            let rendered = camera.low_resolution(reconstructor.settings().scale);
            let Margin { left, top, right, bottom } = start.margin;
            Ok::<_, Fault>(gs3_frame_start {
                struct_size: 0,
                reset_reason: reset_reason(start.reset),
                jitter: start.jitter,
                render_width: rendered.width(),
                render_height: rendered.height(),
                margin: gs3_margin { left, top, right, bottom },
            })
        })?;
        answer.write(&start);
        Ok(())
    })
}

/// What the numbers of a depth buffer mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub enum gs3_depth_encoding {
    /// Distance along the view axis, world units; 0 where nothing was hit.
    GS3_DEPTH_ENCODING_DISTANCE = 0,
    /// Projective: 0 at the near plane, 1 at the far plane, where nothing was hit.
    GS3_DEPTH_ENCODING_PROJECTIVE = 1,
    /// Projective reversed: 1 at the near plane, 0 at the far plane, where nothing was hit.
    GS3_DEPTH_ENCODING_REVERSED = 2,
    /// Linear: 0 at the near plane, 1 at the far plane, where nothing was hit.
    GS3_DEPTH_ENCODING_LINEAR = 3,
}

/// A frame to reconstruct. All inputs are of render_width x render_height pixels, point samples at pixel centres moved by the
/// jitter, of the visible surface. They are read during the call alone.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct gs3_reconstruct_desc {
    /// sizeof(gs3_reconstruct_desc).
    pub struct_size: u32,
    /// 1 to forget the frames before, as at a cut. Cuts of the camera are found without.
    pub reset: u32,
    /// The camera of the image shown.
    pub camera: *const gs3_camera,
    /// Width of the inputs, the margin included: the camera's divided by the scale, rounded up, and the margin.
    pub render_width: u32,
    /// Height of the inputs, likewise.
    pub render_height: u32,
    /// Where the inputs were sampled: an offset from pixel centres, in pixels of the inputs, x right and y down, within -1 and 1.
    pub jitter: [f32; 2],
    /// Display-encoded red, green and blue, finite.
    pub color: *const gs3_input,
    /// Depth, one channel.
    pub depth: *const gs3_input,
    /// Where the frame goes. Its fourth channel is the uncertainty, 0 to 1: 0 where a pixel was sampled itself.
    pub output: *const gs3_output,
    /// A gs3_depth_encoding.
    pub depth_encoding: u32,
    /// Number of in_between_outputs and in_between_cameras: what the reconstructor was created for, or 0.
    pub in_between_count: u32,
    /// Distance of the near plane, world units. Distances have none.
    pub near_plane: f32,
    /// Distance of the far plane, world units; INFINITY where there is none. Distances have none.
    pub far_plane: f32,
    /// Derivatives of colour to the right, per pixel of the inputs; NULL to difference colours. Both or none are given.
    pub color_dx: *const gs3_input,
    /// Derivatives of colour downwards.
    pub color_dy: *const gs3_input,
    /// Where each surface was in the frame before, less where it is, two channels, x right and y down, without the jitter of
    /// either frame; finite. NULL where nothing but the camera moves.
    pub motion: *const gs3_input,
    /// Pixels of the inputs that 1 of motion stands for, in x and y; 0 for 1.
    pub motion_scale: [f32; 2],
    /// How much of the inputs lies beyond the edges of the picture.
    pub margin: gs3_margin,
    /// Where the in-between frames go that lie before this one, in order; NULL for nowhere.
    pub in_between_outputs: *const *const gs3_output,
    /// The true cameras of the in-between frames, in order; NULL for cameras between the previous one and this one.
    pub in_between_cameras: *const *const gs3_camera,
}

// SAFETY: as the trait demands.
unsafe impl Descriptor for gs3_reconstruct_desc {
    const BYTES: usize = 10 * 4 + 9 * 8 + 6 * 4;
    const LEAST: usize = 56;
}

/// A checked descriptor.
struct Frame<'a> {
    camera: Camera,
    view: GBufferView<'a>,
    poses: Vec<Camera>,
    outputs: Outputs,
    reset: bool,
}

impl gs3_reconstruct_desc {
    /// # Safety
    /// As [`gs3_reconstructor_reconstruct`].
    unsafe fn check<'a>(&self, vectors: &'a [f32]) -> Result<Frame<'a>, Fault> {
        let reset = flag("reset", self.reset)?;
        check_count(self.in_between_count)?;
        let (near, far) = (self.near_plane, self.far_plane);
        let encodings = [
            (gs3_depth_encoding::GS3_DEPTH_ENCODING_DISTANCE as u32, DepthEncoding::Distance),
            (
                gs3_depth_encoding::GS3_DEPTH_ENCODING_PROJECTIVE as u32,
                DepthEncoding::Projective { near, far },
            ),
            (gs3_depth_encoding::GS3_DEPTH_ENCODING_REVERSED as u32, DepthEncoding::Reversed { near, far }),
            (gs3_depth_encoding::GS3_DEPTH_ENCODING_LINEAR as u32, DepthEncoding::Linear { near, far }),
        ];
        let encoding = choice("depth_encoding", "gs3_depth_encoding", self.depth_encoding, &encodings)?;
        let gs3_margin { left, top, right, bottom } = self.margin;
        let size = Size::new(self.render_width, self.render_height);
        // SAFETY: the contract of this function.
        unsafe {
            let camera = gs3_camera::read("camera", self.camera)?;
            let color = gs3_input::read("color", self.color, size)?;
            let depth = gs3_input::read("depth", self.depth, size)?;
            let view = GBufferView {
                gradients: self.gradients(size)?,
                encoding,
                motion: if self.motion.is_null() { None } else { Some(PlanesView::planar(vectors, size)?) },
                margin: Margin { left, top, right, bottom },
                ..GBufferView::new(color, depth, self.jitter)
            };
            let poses =
                gs3_camera::read_all("in_between_cameras", self.in_between_cameras, self.in_between_count)?;
            let shown = camera.size();
            let outputs = Outputs::read(self.output, self.in_between_outputs, self.in_between_count, shown)?;
            Ok(Frame { camera, view, poses, outputs, reset })
        }
    }

    /// Motion in pixels of the inputs, plane after plane; empty where there is none.
    ///
    /// # Safety
    /// As [`gs3_reconstructor_reconstruct`].
    unsafe fn vectors(&self) -> Result<Vec<f32>, Fault> {
        if self.motion.is_null() {
            return Ok(Vec::new());
        }
        let size = Size::new(self.render_width, self.render_height);
        // SAFETY: the contract of this function.
        unsafe { gs3_input::read_scaled("motion", self.motion, size, self.motion_scale) }
    }

    /// # Safety
    /// As [`gs3_reconstructor_reconstruct`].
    unsafe fn gradients<'a>(&self, size: Size) -> Result<Option<[PlanesView<'a, 3>; 2]>, Fault> {
        if self.color_dx.is_null() && self.color_dy.is_null() {
            return Ok(None);
        }
        // SAFETY: the contract of this function.
        unsafe {
            let dx = gs3_input::read("color_dx", self.color_dx, size)?;
            let dy = gs3_input::read("color_dy", self.color_dy, size)?;
            Ok(Some([dx, dy]))
        }
    }
}

/// Reconstructs a frame and, if the reconstructor was created for any, those between the previous one and it. info may be
/// NULL.
///
/// If it fails, nothing was written, and the history is as before, but for a reset that was asked for.
///
/// # Safety
/// reconstructor is a reconstructor, desc as its structure describes, and info NULL or a gs3_frame_info with struct_size set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_reconstructor_reconstruct(
    reconstructor: *mut gs3_reconstructor,
    desc: *const gs3_reconstruct_desc,
    info: *mut gs3_frame_info,
) -> gs3_status {
    guard("gs3_reconstructor_reconstruct", || {
        // SAFETY: the contract of this function.
        let reconstructor = unsafe { handle::read("reconstructor", reconstructor.cast_const()) }?;
        // SAFETY: likewise.
        let answer = unsafe { Answer::at_or_none("info", info) }?;
        // SAFETY: likewise.
        let desc = unsafe { descriptor::read("desc", desc) }?;
        // SAFETY: likewise.
        let vectors = unsafe { desc.vectors() }.map_err(|fault| fault.within("desc"))?;
        // SAFETY: likewise.
        let frame = unsafe { desc.check(&vectors) }.map_err(|fault| fault.within("desc"))?;
        let made = reconstructor.handle.call(|reconstructor| {
            let Frame { camera, view, poses, outputs, reset } = &frame;
            check_between(desc.in_between_count, reconstructor.settings().in_between as u32)
                .map_err(|fault| fault.within("desc"))?;
            if *reset {
                reconstructor.reset(ResetReason::CameraCut);
            }
            let shown = reconstructor.reconstruct_with_poses(camera, view, poses)?;
            let count = outputs.write(shown.current, shown.in_between.iter(), true)?;
            Ok::<_, Fault>(gs3_frame_info::new(shown.reset, count, 0.0, &StageTimes::default()))
        })?;
        if let Some(answer) = answer {
            answer.write(&made);
        }
        Ok(())
    })
}

/// Forgets the frames before: the next one starts anew.
///
/// # Safety
/// reconstructor is a reconstructor.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_reconstructor_reset(reconstructor: *mut gs3_reconstructor) -> gs3_status {
    guard("gs3_reconstructor_reset", || {
        // SAFETY: the contract of this function.
        let reconstructor = unsafe { handle::read("reconstructor", reconstructor.cast_const()) }?;
        reconstructor.handle.call(|reconstructor| {
            reconstructor.reset(ResetReason::CameraCut);
            Ok::<_, Fault>(())
        })
    })
}

/// Tells how much memory a reconstructor has.
///
/// # Safety
/// reconstructor is a reconstructor, and memory points to a gs3_memory with struct_size set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_reconstructor_query_memory(
    reconstructor: *mut gs3_reconstructor,
    memory: *mut gs3_memory,
) -> gs3_status {
    guard("gs3_reconstructor_query_memory", || {
        // SAFETY: the contract of this function.
        let reconstructor = unsafe { handle::read("reconstructor", reconstructor.cast_const()) }?;
        // SAFETY: likewise.
        let answer = unsafe { Answer::at("memory", memory) }?;
        answer.write(&reconstructor.handle.memory(0));
        Ok(())
    })
}

/// Destroys a reconstructor; NULL is none.
///
/// # Safety
/// reconstructor is NULL, or a reconstructor that nobody uses any more.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_reconstructor_destroy(reconstructor: *mut gs3_reconstructor) {
    guard("gs3_reconstructor_destroy", || {
        // SAFETY: the contract of this function.
        unsafe { handle::destroy(reconstructor) };
        Ok(())
    });
}
