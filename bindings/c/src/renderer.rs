//! Whole frames of a scene.
#![allow(unsafe_code, reason = "exported functions")]

mod settings;

use std::ffi::c_char;
use std::sync::{Arc, Mutex, PoisonError};

use gs3::scene::{Camera, Scene};
use gs3::{Backend, Mode, ResetReason, Session, SessionSettings};

use crate::camera::gs3_camera;
use crate::choice::flag;
use crate::descriptor::{self, Answer, Descriptor, Out};
use crate::frame::{Outputs, check_between, check_count, gs3_frame_info};
use crate::handle::{self, Handle};
use crate::log::{self, gs3_log_level};
use crate::memory::{GS3_UNKNOWN_BYTES, gs3_memory, outlive};
use crate::pixels::gs3_output;
use crate::scene::gs3_scene;
use crate::status::{Fault, c_text, gs3_status, guard};

/// How frames come about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub enum gs3_mode {
    /// Low-resolution frames super-sampled over time.
    GS3_MODE_SUPER_SAMPLE = 0,
    /// The same, and frames interpolated before each.
    GS3_MODE_FULL = 1,
    /// Every pixel rasterized.
    GS3_MODE_NATIVE = 2,
    /// Low-resolution frames enlarged: the baseline.
    GS3_MODE_BICUBIC = 3,
}

/// What renders.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub enum gs3_backend {
    /// A GPU where there is one, and the CPU where there is none, where it is emulated, or once it fails.
    GS3_BACKEND_AUTO = 0,
    /// The CPU.
    GS3_BACKEND_CPU = 1,
    /// A GPU, an emulated one too. Where it fails, calls do.
    GS3_BACKEND_GPU = 2,
}

/// The networks that refine frames. Of scale 2 there is BALANCED, of scale 4 all, of other scales none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub enum gs3_networks {
    /// None.
    GS3_NETWORKS_NONE = 0,
    /// The fastest.
    GS3_NETWORKS_FAST = 1,
    /// Those between.
    GS3_NETWORKS_BALANCED = 2,
    /// The best.
    GS3_NETWORKS_HIGH = 3,
}

/// Which pixels are rasterized exactly besides the low-resolution grid: the blocks of 4 x 4 with the largest expected error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub enum gs3_refine {
    /// Those with an expected error that would be seen, within the budget of the quality.
    GS3_REFINE_AUTO = 0,
    /// None.
    GS3_REFINE_OFF = 1,
    /// A share of all, refine_value, 0 to 1.
    GS3_REFINE_SHARE = 2,
    /// As many as fit into refine_value milliseconds a frame.
    GS3_REFINE_FRAME_TIME = 3,
}

/// What GS3_REFINE_AUTO may spend. Above 1920 * 1080 pixels no more pixels are exact than there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub enum gs3_quality {
    /// 17.5 % of the pixels, errors of 5.75 steps of 8 bits.
    GS3_QUALITY_BALANCED = 0,
    /// 8 % of the pixels, errors of twelve steps.
    GS3_QUALITY_FAST = 1,
    /// 30 % of the pixels, errors of three steps.
    GS3_QUALITY_HIGH = 2,
}

/// How much small Gaussians are widened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub enum gs3_dilation {
    /// By 0.3 px^2 of the image shown: low-resolution samples are exact samples of it.
    GS3_DILATION_MATCHED = 0,
    /// By 0.3 px^2 of the grid that is rasterized.
    GS3_DILATION_KERBL = 1,
    /// By dilation_value, px^2 of the grid that is rasterized.
    GS3_DILATION_VALUE = 2,
}

/// How a renderer renders. All 0 is a good choice.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct gs3_renderer_desc {
    /// sizeof(gs3_renderer_desc).
    pub struct_size: u32,
    /// A gs3_mode.
    pub mode: u32,
    /// Width and height of what is shown over those of what is rasterized, 1 to 8; 0 for 4 up to 2560 * 1440 pixels and with
    /// networks, and 6 above. Native frames do not read it.
    pub scale: u32,
    /// A gs3_backend. gs3_renderer_configure does not read it.
    pub backend: u32,
    /// The GPU: 0 for the fastest, n for number n - 1 of gs3_query_adapter. gs3_renderer_configure does not read it.
    pub adapter: u32,
    /// Threads of the renderer, at most 1024; 0 for as many as the machine runs at once. gs3_renderer_configure does not read
    /// it.
    pub threads: u32,
    /// A gs3_networks.
    pub networks: u32,
    /// 1 for in-between frames that a network refines too; gains little.
    pub networks_between: u32,
    /// A gs3_refine.
    pub refine: u32,
    /// What the gs3_refine says.
    pub refine_value: f32,
    /// A gs3_quality.
    pub quality: u32,
    /// A gs3_kriging. Networks have theirs.
    pub kriging: u32,
    /// 1 to rasterize what lies beyond the edges that the camera turns to. Networks do anyway.
    pub overscan: u32,
    /// In-between frames of GS3_MODE_FULL, 1 to GS3_MAX_IN_BETWEEN; 0 for 2.
    pub in_between_count: u32,
    /// A gs3_sampling.
    pub sampling: u32,
    /// A gs3_dilation.
    pub dilation: u32,
    /// What the gs3_dilation says.
    pub dilation_value: f32,
    /// Display-encoded red, green and blue behind everything.
    pub background: [f32; 3],
}

// SAFETY: as the trait demands.
unsafe impl Descriptor for gs3_renderer_desc {
    const BYTES: usize = 20 * 4;
    const LEAST: usize = 4;
}

/// Renders one scene along a sequence of cameras, on threads of its own. One call at a time may use it, from any thread.
#[derive(Debug)]
pub struct gs3_renderer {
    handle: Handle<Session>,
    /// The scene that the session shows, once more: so what the session drops is never the last of it, and scenes are on
    /// nobody's account.
    scene: Mutex<Arc<Scene>>,
}

/// Tells the host what the session wants people to be told.
fn tell(notices: Vec<String>) {
    notices.iter().for_each(|notice| log::tell(gs3_log_level::GS3_LOG_WARNING, &c_text(notice)));
}

impl gs3_renderer {
    /// Runs `call`, and tells the host of what happened.
    fn call<R: Send>(&self, call: impl FnOnce(&mut Session) -> Result<R, Fault> + Send) -> Result<R, Fault> {
        let result = self.handle.call(call);
        let notices = |session: &mut Session| Ok::<_, Fault>(outlive(session.take_notices()));
        // After an internal error there are none.
        self.handle.call(notices).into_iter().for_each(tell);
        result
    }
}

/// Makes a renderer of a scene. desc may be NULL for all defaults. The handle is written to renderer.
///
/// GS3_ERROR_DEVICE if a GPU that was asked for cannot be opened or has no room for the scene.
///
/// # Safety
/// scene is a scene, desc NULL or as its structure describes, and renderer points to a pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_renderer_create(
    scene: *const gs3_scene,
    desc: *const gs3_renderer_desc,
    renderer: *mut *mut gs3_renderer,
) -> gs3_status {
    guard("gs3_renderer_create", || {
        // SAFETY: the contract of this function.
        let (scene, to) = unsafe { (handle::read("scene", scene)?, Out::at("renderer", renderer)?) };
        // SAFETY: likewise.
        let desc = unsafe { descriptor::read_or_default::<gs3_renderer_desc>("desc", desc) }?;
        let make = || {
            let (pipeline, networks) = desc.settings()?;
            let settings = SessionSettings {
                pipeline,
                networks,
                backend: desc.backend()?,
                adapter: desc.adapter.checked_sub(1).map(|number| number as usize),
                ..SessionSettings::default()
            };
            Ok::<_, Fault>(Session::new(Arc::clone(scene.scene()), settings)?)
        };
        let handle = Handle::new(desc.threads, make).map_err(|fault| fault.within("desc"))?;
        let renderer = gs3_renderer { handle, scene: Mutex::new(Arc::clone(scene.scene())) };
        let machine = renderer.call(|session| Ok(outlive(session.adapter())))?;
        let machine = machine.as_deref().unwrap_or("the CPU");
        log::tell(gs3_log_level::GS3_LOG_INFO, &c_text(&format!("renderer: {machine}")));
        to.write(Box::into_raw(Box::new(renderer)));
        Ok(())
    })
}

/// Renders with other settings from the next frame on, which is a first one, on the same machine. If it fails, the old ones
/// stay.
///
/// # Safety
/// renderer is a renderer, and desc NULL or as its structure describes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_renderer_configure(
    renderer: *mut gs3_renderer,
    desc: *const gs3_renderer_desc,
) -> gs3_status {
    guard("gs3_renderer_configure", || {
        // SAFETY: the contract of this function.
        let renderer = unsafe { handle::read("renderer", renderer.cast_const()) }?;
        // SAFETY: likewise.
        let desc = unsafe { descriptor::read_or_default::<gs3_renderer_desc>("desc", desc) }?;
        renderer.call(|session| {
            let (settings, networks) = desc.settings().map_err(|fault| fault.within("desc"))?;
            Ok(session.set_pipeline(settings, &networks)?)
        })
    })
}

/// Shows another scene from the next frame on. If it fails, the old one stays.
///
/// # Safety
/// renderer is a renderer, and scene a scene.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_renderer_set_scene(
    renderer: *mut gs3_renderer,
    scene: *const gs3_scene,
) -> gs3_status {
    guard("gs3_renderer_set_scene", || {
        // SAFETY: the contract of this function.
        let (renderer, scene) =
            unsafe { (handle::read("renderer", renderer.cast_const())?, handle::read("scene", scene)?) };
        let scene = Arc::clone(scene.scene());
        renderer.call(|session| Ok(session.set_scene(Arc::clone(&scene))?))?;
        *renderer.scene.lock().unwrap_or_else(PoisonError::into_inner) = scene;
        Ok(())
    })
}

/// A frame to render.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct gs3_render_desc {
    /// sizeof(gs3_render_desc).
    pub struct_size: u32,
    /// 1 to forget the frames before, as at a cut. Cuts of the camera are found without.
    pub reset: u32,
    /// The camera.
    pub camera: *const gs3_camera,
    /// Where the frame goes. Its fourth channel is opacity in native frames, else 1.
    pub output: *const gs3_output,
    /// Where the in-between frames go that lie before this one, in order; NULL for nowhere.
    pub in_between_outputs: *const *const gs3_output,
    /// The true cameras of the in-between frames, in order; NULL for cameras between the previous one and this one.
    pub in_between_cameras: *const *const gs3_camera,
    /// Number of both: what the renderer was created for, or 0.
    pub in_between_count: u32,
    /// 0.
    pub reserved: u32,
}

// SAFETY: as the trait demands.
unsafe impl Descriptor for gs3_render_desc {
    const BYTES: usize = 2 * 4 + 4 * 8 + 2 * 4;
    const LEAST: usize = 24;
}

/// Renders a frame, and in GS3_MODE_FULL those between the previous one and it. info may be NULL.
///
/// If it fails, nothing was written, and the next frame begins as if this one had not been asked for, or without history.
///
/// # Safety
/// renderer is a renderer, desc as its structure describes, and info NULL or a gs3_frame_info with struct_size set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_renderer_render(
    renderer: *mut gs3_renderer,
    desc: *const gs3_render_desc,
    info: *mut gs3_frame_info,
) -> gs3_status {
    guard("gs3_renderer_render", || {
        // SAFETY: the contract of this function.
        let renderer = unsafe { handle::read("renderer", renderer.cast_const()) }?;
        // SAFETY: likewise.
        let answer = unsafe { Answer::at_or_none("info", info) }?;
        // SAFETY: likewise.
        let desc = unsafe { descriptor::read("desc", desc) }?;
        let reset = flag("desc: reset", desc.reset)?;
        // SAFETY: likewise.
        let (camera, poses, outputs) = unsafe { inputs(&desc) }.map_err(|fault| fault.within("desc"))?;
        let made = renderer.call(|session| {
            let settings = session.settings().pipeline;
            check_between(desc.in_between_count, settings.displayed_per_rendered() as u32 - 1)
                .map_err(|fault| fault.within("desc"))?;
            if reset {
                session.reset(ResetReason::CameraCut);
            }
            session.render_with_poses(&camera, &poses)?;
            let pipeline = session.pipeline();
            let frames = pipeline.presented();
            let reset = pipeline.last_reset();
            // After a reset those between are the frame before, held.
            let between = frames.in_between.into_iter().flatten().filter(|_| reset.is_none());
            let count = outputs.write(frames.current, between, settings.mode == Mode::Native)?;
            Ok(gs3_frame_info::new(reset, count, pipeline.refined_share(), &pipeline.times()))
        })?;
        if let Some(answer) = answer {
            answer.write(&made);
        }
        Ok(())
    })
}

/// # Safety
/// As [`gs3_renderer_render`].
unsafe fn inputs(desc: &gs3_render_desc) -> Result<(Camera, Vec<Camera>, Outputs), Fault> {
    let gs3_render_desc { output, in_between_outputs, in_between_cameras, .. } = *desc;
    check_count(desc.in_between_count)?;
    // SAFETY: the contract of this function.
    unsafe {
        let camera = gs3_camera::read("camera", desc.camera)?;
        let poses = gs3_camera::read_all("in_between_cameras", in_between_cameras, desc.in_between_count)?;
        let size = camera.size();
        let outputs = Outputs::read(output, in_between_outputs, desc.in_between_count, size)?;
        Ok((camera, poses, outputs))
    }
}

/// Forgets the frames before: the next one starts anew.
///
/// # Safety
/// renderer is a renderer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_renderer_reset(renderer: *mut gs3_renderer) -> gs3_status {
    guard("gs3_renderer_reset", || {
        // SAFETY: the contract of this function.
        let renderer = unsafe { handle::read("renderer", renderer.cast_const()) }?;
        renderer.call(|session| {
            session.reset(ResetReason::CameraCut);
            Ok(())
        })
    })
}

/// Bytes of gs3_renderer_info.adapter, the zero at its end included.
pub const GS3_NAME_BYTES: usize = 128;

/// What a renderer is.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct gs3_renderer_info {
    /// sizeof(gs3_renderer_info).
    pub struct_size: u32,
    /// What renders now: GS3_BACKEND_CPU or GS3_BACKEND_GPU.
    pub backend: u32,
    /// In-between frames that come before each frame.
    pub in_between_count: u32,
    /// Frames after which a resting camera has been sampled everywhere, for frames of the size of the last one.
    pub jitter_count: u32,
    /// Threads of the renderer.
    pub threads: u32,
    /// 0.
    pub reserved: u32,
    /// Name and interface of the GPU, empty of the CPU.
    pub adapter: [c_char; GS3_NAME_BYTES],
}

// SAFETY: as the trait demands.
unsafe impl Descriptor for gs3_renderer_info {
    const BYTES: usize = 6 * 4 + 128;
    const LEAST: usize = 4;
}

/// As much of `text` as there is room for.
pub fn name(text: &str) -> [c_char; GS3_NAME_BYTES] {
    let mut name = [0; GS3_NAME_BYTES];
    let end = text.floor_char_boundary(GS3_NAME_BYTES - 1);
    for (to, byte) in name.iter_mut().zip(text[..end].bytes()) {
        *to = byte as c_char;
    }
    name
}

/// Tells what a renderer is.
///
/// # Safety
/// renderer is a renderer, and info points to a gs3_renderer_info with struct_size set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_renderer_query_info(
    renderer: *mut gs3_renderer,
    info: *mut gs3_renderer_info,
) -> gs3_status {
    guard("gs3_renderer_query_info", || {
        // SAFETY: the contract of this function.
        let (renderer, answer) =
            unsafe { (handle::read("renderer", renderer.cast_const())?, Answer::at("info", info)?) };
        let info = renderer.call(|session| {
            let backend = match session.backend() {
                Backend::Gpu => gs3_backend::GS3_BACKEND_GPU,
                Backend::Cpu | Backend::Auto => gs3_backend::GS3_BACKEND_CPU,
            };
            Ok(gs3_renderer_info {
                struct_size: 0,
                backend: backend as u32,
                in_between_count: session.settings().pipeline.displayed_per_rendered() as u32 - 1,
                jitter_count: session.pipeline().jitter_period() as u32,
                threads: rayon::current_num_threads() as u32,
                reserved: 0,
                adapter: name(&session.adapter().unwrap_or_default()),
            })
        })?;
        answer.write(&info);
        Ok(())
    })
}

/// Tells how much memory a renderer has, besides its scene.
///
/// # Safety
/// renderer is a renderer, and memory points to a gs3_memory with struct_size set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_renderer_query_memory(
    renderer: *mut gs3_renderer,
    memory: *mut gs3_memory,
) -> gs3_status {
    guard("gs3_renderer_query_memory", || {
        // SAFETY: the contract of this function.
        let (renderer, answer) =
            unsafe { (handle::read("renderer", renderer.cast_const())?, Answer::at("memory", memory)?) };
        let device_bytes = renderer.call(|session| {
            Ok(match session.backend() {
                Backend::Gpu => session.device_bytes().unwrap_or(GS3_UNKNOWN_BYTES),
                Backend::Cpu | Backend::Auto => 0,
            })
        })?;
        answer.write(&renderer.handle.memory(device_bytes));
        Ok(())
    })
}

/// Destroys a renderer; NULL is none.
///
/// # Safety
/// renderer is NULL, or a renderer that nobody uses any more.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_renderer_destroy(renderer: *mut gs3_renderer) {
    guard("gs3_renderer_destroy", || {
        // SAFETY: the contract of this function.
        unsafe { handle::destroy(renderer) };
        Ok(())
    });
}
