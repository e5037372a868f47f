//! Scenes.
#![allow(unsafe_code, reason = "exported functions")]

use std::ffi::{CStr, c_char};
use std::sync::Arc;

use gs3::scene::format::{self, Budget, LoadOptions};
use gs3::scene::gaussians::{MAX_SH_DEGREE, sh_coefficient_count};
use gs3::scene::{Axes, Gaussians, OpacityMode, Scene, orbit};

use crate::camera::gs3_camera;
use crate::choice::{choice, flag};
use crate::descriptor::{self, Answer, Descriptor, Out};
use crate::handle;
use crate::log::{self, gs3_log_level};
use crate::memory::gs3_memory;
use crate::pixels::floats;
use crate::status::gs3_status::{GS3_ERROR_ARGUMENT, GS3_ERROR_SCENE};
use crate::status::{Fault, c_text, gs3_status, guard};

/// A scene of 3D Gaussians, which does not change. Any number of threads and handles may use it at once; it may be
/// destroyed while renderers show it.
#[derive(Debug)]
pub struct gs3_scene {
    scene: Arc<Scene>,
}

impl gs3_scene {
    pub const fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// Tells the host what it should know of the scene, and gives it.
    fn hand_out(scene: Scene, to: Out<*mut Self>) {
        for note in &scene.details().notes {
            log::tell(gs3_log_level::GS3_LOG_WARNING, &c_text(note));
        }
        if scene.dropped().total() > 0 {
            let text = format!("scene: {} invalid Gaussians were left out", scene.dropped().total());
            log::tell(gs3_log_level::GS3_LOG_WARNING, &c_text(&text));
        }
        let text = format!("scene: {} Gaussians", scene.gaussians().len());
        log::tell(gs3_log_level::GS3_LOG_INFO, &c_text(&text));
        to.write(Box::into_raw(Box::new(Self { scene: Arc::new(scene) })));
    }
}

/// What to open of a scene file; all 0 for all of it at its finest.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct gs3_scene_options {
    /// sizeof(gs3_scene_options).
    pub struct_size: u32,
    /// Of a streamed scene: 1 for its finest level of detail, 2 for the next, and so on; 0 for the finest that each part has.
    pub level_of_detail: u32,
    /// 1 to leave out the environment (sky, far background) of a streamed scene.
    pub without_environment: u32,
    /// Pointers in budget_cameras.
    pub budget_camera_count: u32,
    /// Which way the axes of the file point, as three letters (RDF: right, down, front), where that is not what the file
    /// states or its format says; else NULL.
    pub axes: *const c_char,
    /// Most Gaussians of a streamed SOG scene; each part has the level of detail that leaves the least error. Not together with
    /// level_of_detail. 0 for no budget.
    pub budget: u64,
    /// budget_camera_count cameras that show the scene: error counts where they see it. NULL if it may be seen from anywhere.
    pub budget_cameras: *const *const gs3_camera,
}

// SAFETY: as the trait demands.
unsafe impl Descriptor for gs3_scene_options {
    const BYTES: usize = 4 * 4 + 3 * 8;
    const LEAST: usize = 4;
}

/// The text at `from`, which the caller calls `field`.
///
/// # Safety
/// `from` is null or points to a text that ends with a zero, and stays for `'a`.
unsafe fn text<'a>(field: &str, from: *const c_char) -> Result<&'a str, Fault> {
    if from.is_null() {
        return Err(Fault::null(field));
    }
    // SAFETY: the contract of this function.
    let text = unsafe { CStr::from_ptr(from) };
    text.to_str().map_err(|_| Fault::argument(field, "UTF-8", text.to_string_lossy()))
}

/// Opens the scene file, or the folder of a streamed scene, at path (UTF-8): PLY, compressed PLY, .splat, .ksplat, SPZ, SOG,
/// glTF with KHR_gaussian_splatting, .rad, LCC2. options may be NULL. The handle is written to scene.
///
/// GS3_ERROR_FILE, with a text that names file and field, if there is no such scene.
///
/// # Safety
/// path and options->axes end with a zero; options->budget_cameras is null or points to that many pointers to cameras; scene
/// points to a pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_scene_open(
    path: *const c_char,
    options: *const gs3_scene_options,
    scene: *mut *mut gs3_scene,
) -> gs3_status {
    guard("gs3_scene_open", || {
        // SAFETY: the contract of this function.
        let (path, to) = unsafe { (text("path", path)?, Out::at("scene", scene)?) };
        // SAFETY: likewise.
        let options = unsafe { descriptor::read_or_default("options", options) }?;
        let axes = if options.axes.is_null() {
            None
        } else {
            // SAFETY: the contract of this function.
            let axes = unsafe { text("options: axes", options.axes) }?;
            let parsed = axes.parse::<Axes>();
            Some(parsed.map_err(|error| Fault::new(GS3_ERROR_ARGUMENT, error).within("options: axes"))?)
        };
        // SAFETY: likewise.
        let cameras = unsafe {
            gs3_camera::read_all(
                "options: budget_cameras",
                options.budget_cameras,
                options.budget_camera_count,
            )
        }?;
        let budget = (options.budget > 0).then_some(Budget { gaussians: options.budget, cameras });
        let options = LoadOptions {
            level_of_detail: options.level_of_detail.checked_sub(1),
            environment: !flag("options: without_environment", options.without_environment)?,
            axes,
            budget,
        };
        gs3_scene::hand_out(format::load(path, &options, &|_| {})?, to);
        Ok(())
    })
}

/// How opacities react to the widening of small Gaussians: a scene is rendered as it was trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub enum gs3_opacity_mode {
    /// As stored (3D Gaussian Splatting).
    GS3_OPACITY_MODE_DEFAULT = 0,
    /// Scaled as the Gaussian's area grows (Mip-Splatting; antialiased in gsplat).
    GS3_OPACITY_MODE_ANTIALIASED = 1,
}

/// Gaussians in the caller's memory, which is read during the call alone. Values are activated: scales are lengths, opacities
/// shares. The world's axes may point anywhere; cameras have the same.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct gs3_scene_arrays {
    /// sizeof(gs3_scene_arrays).
    pub struct_size: u32,
    /// Degree of the spherical harmonics, 0 to 4.
    pub sh_degree: u32,
    /// Number of Gaussians N, 1 or more.
    pub count: u64,
    /// Centres, world units, N x 3.
    pub means: *const f32,
    /// Standard deviations along the principal axes, world units, N x 3.
    pub scales: *const f32,
    /// Rotations from principal axes to world, quaternions w, x, y, z of any length but 0, N x 4.
    pub rotations: *const f32,
    /// Opacities, 0 to 1, N.
    pub opacities: *const f32,
    /// Coefficients of the spherical harmonics, N x (sh_degree + 1)^2 x 3, RGB innermost, in the order and with the signs of
    /// Kerbl et al. 2023: a colour that looks alike from everywhere has the first coefficient (colour - 0.5) / 0.28209479.
    pub sh: *const f32,
    /// A gs3_opacity_mode.
    pub opacity_mode: u32,
    /// Gaussians nearer to the camera than this, view-space z in world units, are not shown; 0 for a distance that suits the
    /// scene.
    pub near_plane: f32,
}

// SAFETY: as the trait demands.
unsafe impl Descriptor for gs3_scene_arrays {
    const BYTES: usize = 4 + 4 + 6 * 8 + 4 + 4;
    const LEAST: usize = 56;
}

/// Makes a scene of arrays. Gaussians with invalid values are left out; gs3_scene_query_info says how many. The handle is
/// written to scene.
///
/// GS3_ERROR_SCENE if no Gaussian is valid.
///
/// # Safety
/// arrays is as its structure describes; scene points to a pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_scene_from_arrays(
    arrays: *const gs3_scene_arrays,
    scene: *mut *mut gs3_scene,
) -> gs3_status {
    guard("gs3_scene_from_arrays", || {
        // SAFETY: the contract of this function.
        let (arrays, to) = unsafe { (descriptor::read("arrays", arrays)?, Out::at("scene", scene)?) };
        // SAFETY: likewise.
        let gaussians = unsafe { gaussians(&arrays) }.map_err(|fault| fault.within("arrays"))?;
        let modes = [
            (gs3_opacity_mode::GS3_OPACITY_MODE_DEFAULT as u32, OpacityMode::Default),
            (gs3_opacity_mode::GS3_OPACITY_MODE_ANTIALIASED as u32, OpacityMode::Antialiased),
        ];
        let mode = choice("arrays: opacity_mode", "gs3_opacity_mode", arrays.opacity_mode, &modes)?;
        let near = arrays.near_plane;
        if !(near >= 0.0 && near.is_finite()) {
            let expected = "0, or a positive finite distance";
            return Err(Fault::argument("arrays: near_plane", expected, near));
        }
        let scene = Scene::new(gaussians, mode)?;
        let near = if near > 0.0 { near } else { orbit::near_plane(&scene) };
        gs3_scene::hand_out(scene.with_near(near), to);
        Ok(())
    })
}

/// # Safety
/// As [`gs3_scene_from_arrays`].
unsafe fn gaussians(arrays: &gs3_scene_arrays) -> Result<Gaussians, Fault> {
    let degree = u8::try_from(arrays.sh_degree).ok().filter(|degree| *degree <= MAX_SH_DEGREE);
    let Some(degree) = degree else {
        return Err(Fault::argument("sh_degree", format_args!("0 to {MAX_SH_DEGREE}"), arrays.sh_degree));
    };
    if arrays.count == 0 {
        return Err(Fault::new(GS3_ERROR_SCENE, "count: expected 1 or more, found 0"));
    }
    let coefficients = 3 * sh_coefficient_count(degree);
    let read = |field: &str, data: *const f32, each: usize| {
        // SAFETY: the contract of this function.
        unsafe { floats(field, data, arrays.count.saturating_mul(each as u64)) }
    };
    let opacities = read("opacities", arrays.opacities, 1)?;
    let sh = read("sh", arrays.sh, coefficients)?;
    Ok(Gaussians {
        means: planes(read("means", arrays.means, 3)?),
        scales: planes(read("scales", arrays.scales, 3)?),
        rotations: planes(read("rotations", arrays.rotations, 4)?),
        opacities: opacities.to_vec(),
        sh_degree: degree,
        sh: sh.to_vec(),
    })
}

/// `[N][C]` as `C` planes of `N`.
fn planes<const C: usize>(numbers: &[f32]) -> [Vec<f32>; C] {
    std::array::from_fn(|c| numbers.iter().skip(c).step_by(C).copied().collect())
}

/// What a scene is.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct gs3_scene_info {
    /// sizeof(gs3_scene_info).
    pub struct_size: u32,
    /// Degree of the spherical harmonics.
    pub sh_degree: u32,
    /// Number of Gaussians.
    pub count: u64,
    /// Number of invalid Gaussians that were left out.
    pub dropped: u64,
    /// Where the scene's origin lies in the file's frame of reference, right-down-front.
    pub origin: [f64; 3],
    /// The likely centre of the scene, world units.
    pub center: [f64; 3],
    /// The likely upward direction, of length 1.
    pub up: [f64; 3],
    /// The distance from the centre within which nearly all of the scene lies, world units.
    pub radius: f64,
    /// Gaussians nearer to the camera than this, view-space z in world units, are not shown.
    pub near_plane: f32,
    /// A gs3_opacity_mode.
    pub opacity_mode: u32,
}

// SAFETY: as the trait demands.
unsafe impl Descriptor for gs3_scene_info {
    const BYTES: usize = 4 + 4 + 12 * 8 + 4 + 4;
    const LEAST: usize = 4;
}

/// Tells what a scene is.
///
/// # Safety
/// scene is a scene, and info points to a gs3_scene_info with struct_size set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_scene_query_info(
    scene: *const gs3_scene,
    info: *mut gs3_scene_info,
) -> gs3_status {
    guard("gs3_scene_query_info", || {
        // SAFETY: the contract of this function.
        let (scene, answer) = unsafe { (handle::read("scene", scene)?, Answer::at("info", info)?) };
        let scene = scene.scene();
        let bulk = orbit::Bulk::of(scene);
        answer.write(&gs3_scene_info {
            struct_size: 0,
            sh_degree: u32::from(scene.gaussians().sh_degree),
            count: scene.gaussians().len() as u64,
            dropped: scene.dropped().total() as u64,
            origin: scene.details().origin.to_array(),
            center: bulk.center.to_array(),
            up: bulk.up.to_array(),
            radius: bulk.radius,
            near_plane: scene.details().near,
            opacity_mode: match scene.opacity_mode() {
                OpacityMode::Default => gs3_opacity_mode::GS3_OPACITY_MODE_DEFAULT,
                OpacityMode::Antialiased => gs3_opacity_mode::GS3_OPACITY_MODE_ANTIALIASED,
            } as u32,
        });
        Ok(())
    })
}

/// Tells how much memory a scene has. It is the scene's own, however many renderers show it.
///
/// # Safety
/// scene is a scene, and memory points to a gs3_memory with struct_size set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_scene_query_memory(
    scene: *const gs3_scene,
    memory: *mut gs3_memory,
) -> gs3_status {
    guard("gs3_scene_query_memory", || {
        // SAFETY: the contract of this function.
        let (scene, answer) = unsafe { (handle::read("scene", scene)?, Answer::at("memory", memory)?) };
        let Gaussians { means, scales, rotations, opacities, sh, .. } = scene.scene().gaussians();
        let numbers = means.iter().chain(scales).chain(rotations).chain([opacities, sh]);
        let numbers: usize = numbers.map(Vec::capacity).sum();
        let notes: usize = scene.scene().details().notes.iter().map(String::capacity).sum();
        let bytes = numbers * size_of::<f32>() + notes + size_of::<Scene>();
        answer.write(&gs3_memory::new(bytes as u64, 0));
        Ok(())
    })
}

/// Destroys a scene; NULL is none. Renderers that show it keep what they show.
///
/// # Safety
/// scene is NULL, or a scene that nobody uses any more.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_scene_destroy(scene: *mut gs3_scene) {
    guard("gs3_scene_destroy", || {
        // SAFETY: the contract of this function.
        unsafe { handle::destroy(scene) };
        Ok(())
    });
}

/// A camera of a closed orbit of frames cameras (1 or more) that keeps the scene in view: that of number frame, counted from
/// 0. For programs that know nothing of the scene yet.
///
/// # Safety
/// scene is a scene, and camera points to a gs3_camera with struct_size set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gs3_camera_orbit(
    scene: *const gs3_scene,
    frame: u32,
    frames: u32,
    width: u32,
    height: u32,
    camera: *mut gs3_camera,
) -> gs3_status {
    /// An hour at 30 frames per second.
    const MOST: u32 = 108_000;
    guard("gs3_camera_orbit", || {
        // SAFETY: the contract of this function.
        let (scene, answer) = unsafe { (handle::read("scene", scene)?, Answer::at("camera", camera)?) };
        if !(1..=MOST).contains(&frames) {
            return Err(Fault::argument("frames", format_args!("1 to {MOST}"), frames));
        }
        let path = orbit::around(scene.scene(), frames as usize, width, height)?;
        let Some(camera) = path.cameras().get(frame as usize) else {
            return Err(Fault::argument("frame", format_args!("0 to {}", frames - 1), frame));
        };
        answer.write(&gs3_camera::of(camera));
        Ok(())
    })
}
