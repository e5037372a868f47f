//! Frames of a moving camera.

use std::sync::{Arc, Mutex, PoisonError};

use gs3::reconstruct::ResetReason;
use gs3::scene::Camera;
use gs3::{
    Backend, Kriging, Mode, Networks, PipelineSettings, Quality, Refine, Scale, Session, SessionSettings,
    Stage, Tier,
};
use numpy::PyReadonlyArray2;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use crate::arrays::{Pixels, single_camera};
use crate::cameras::CameraPath;
use crate::error;
use crate::scene::Scene;

/// A session.
#[derive(Debug)]
#[pyclass(frozen, module = "gs3._gs3")]
pub struct Renderer {
    session: Mutex<Session>,
}

/// The one of `all` that is called `name`.
pub fn named<T: Copy>(what: &str, name: &str, all: &[T], name_of: impl Fn(T) -> &'static str) -> PyResult<T> {
    all.iter().copied().find(|value| name_of(*value) == name).ok_or_else(|| {
        let names: Vec<&str> = all.iter().map(|value| name_of(*value)).collect();
        error::input(format_args!("{what}: expected one of {}, found {name:?}", names.join(", ")))
    })
}

pub const TIERS: [Tier; 3] = [Tier::Fast, Tier::Balanced, Tier::High];

/// The name of a reason as Python has it.
pub const fn reason(reason: ResetReason) -> &'static str {
    match reason {
        ResetReason::FirstFrame => "first_frame",
        ResetReason::CameraCut => "camera_cut",
        ResetReason::SizeOrTierChange => "size_or_tier_change",
        ResetReason::SceneChange => "scene_change",
        ResetReason::BackendChange => "backend_change",
        ResetReason::Failure => "failure",
        ResetReason::Keyframe => "keyframe",
        _ => "other",
    }
}

impl Renderer {
    /// Renders the frame of `camera`, and converts what there is to show.
    fn frames<'py>(
        &self,
        py: Python<'py>,
        camera: &Camera,
        poses: &[Camera],
        as_bytes: bool,
    ) -> PyResult<Bound<'py, PyList>> {
        // The lock of the session is taken without the interpreter's: another thread may hold one and wait for the other.
        let shown = py.detach(|| {
            let mut session = self.session.lock().unwrap_or_else(PoisonError::into_inner);
            let presented = session.render_with_poses(camera, poses).map_err(|e| error::of_pipeline(&e))?;
            Ok::<_, PyErr>(presented.iter().map(|image| Pixels::of(image, as_bytes)).collect::<Vec<_>>())
        })?;
        let frames = shown.into_iter().map(|pixels| pixels.into_numpy(py)).collect::<PyResult<Vec<_>>>()?;
        PyList::new(py, frames)
    }
}

#[pymethods]
impl Renderer {
    #[new]
    fn new(
        py: Python<'_>,
        scene: &Scene,
        mode: &str,
        scale: &str,
        quality: &str,
        refine: &str,
        in_between: u32,
        tier: Option<&str>,
        learned_interpolation: bool,
        kriging: &str,
        overscan: bool,
        keyframes: u32,
        backend: &str,
        background: [f32; 3],
    ) -> PyResult<Self> {
        let modes = [Mode::Native, Mode::Bicubic, Mode::SuperSample, Mode::Full];
        let krigings = [Kriging::Off, Kriging::Coarse, Kriging::On, Kriging::Fine];
        let scale: Scale = scale.parse().map_err(|e| error::input(format_args!("scale: {e}")))?;
        let pipeline = PipelineSettings {
            mode: named("mode", mode, &modes, Mode::name)?,
            scale,
            quality: named("quality", quality, &Quality::ALL, Quality::name)?,
            refine: refine.parse().map_err(|e| error::input(format_args!("refine: {e}")))?,
            in_between,
            kriging: named("kriging", kriging, &krigings, Kriging::name)?,
            overscan,
            keyframes,
            background,
            ..PipelineSettings::default()
        };
        let networks = match tier {
            None => Networks::default(),
            Some(tier) => {
                let tier = named("tier", tier, &TIERS, Tier::name)?;
                let shipped =
                    Networks::shipped(scale.of_networks(), tier).map_err(|e| error::of_network(&e))?;
                let interpolate = if learned_interpolation { shipped.interpolate } else { None };
                Networks { interpolate, ..shipped }
            }
        };
        let backend: Backend = backend.parse().map_err(|e| error::input(format_args!("backend: {e}")))?;
        let settings = SessionSettings { pipeline, networks, backend, ..SessionSettings::default() };
        let scene = Arc::clone(&scene.scene);
        let session = py.detach(|| Session::new(scene, settings)).map_err(|e| error::of_pipeline(&e))?;
        Ok(Self { session: Mutex::new(session) })
    }

    fn render<'py>(
        &self,
        py: Python<'py>,
        viewmat: PyReadonlyArray2<'py, f64>,
        k: PyReadonlyArray2<'py, f64>,
        width: u32,
        height: u32,
        as_bytes: bool,
    ) -> PyResult<Bound<'py, PyList>> {
        let camera = single_camera(&viewmat, &k, [width, height])?;
        self.frames(py, &camera, &[], as_bytes)
    }

    /// Frame `k` of `path`, with those between at the path's own poses.
    fn render_of_path<'py>(
        &self,
        py: Python<'py>,
        path: &CameraPath,
        k: usize,
        as_bytes: bool,
    ) -> PyResult<Bound<'py, PyList>> {
        let count = path.path.cameras().len();
        let camera = path.path.cameras().get(k).copied();
        let camera =
            camera.ok_or_else(|| error::input(format_args!("k: expected less than {count}, found {k}")))?;
        let settings =
            py.detach(|| self.session.lock().unwrap_or_else(PoisonError::into_inner).settings().pipeline);
        self.frames(py, &camera, &settings.poses_between(&path.path, k), as_bytes)
    }

    /// The same camera rasterized pixel by pixel, which leaves the history alone.
    fn native(
        &self,
        py: Python<'_>,
        viewmat: PyReadonlyArray2<'_, f64>,
        k: PyReadonlyArray2<'_, f64>,
        width: u32,
        height: u32,
        as_bytes: bool,
    ) -> PyResult<Py<PyAny>> {
        let camera = single_camera(&viewmat, &k, [width, height])?;
        let pixels = py.detach(|| {
            let mut session = self.session.lock().unwrap_or_else(PoisonError::into_inner);
            let image = session.reference(Mode::Native, &camera).map_err(|e| error::of_pipeline(&e))?;
            Ok::<_, PyErr>(Pixels::of(image, as_bytes))
        })?;
        pixels.into_numpy(py)
    }

    fn set_refine(&self, py: Python<'_>, refine: &str) -> PyResult<()> {
        let refine: Refine = refine.parse().map_err(|e| error::input(format_args!("refine: {e}")))?;
        let set = || self.session.lock().unwrap_or_else(PoisonError::into_inner).set_refine(refine);
        py.detach(set).map_err(|e| error::of_pipeline(&e))
    }

    fn reset(&self, py: Python<'_>) {
        let reset =
            || self.session.lock().unwrap_or_else(PoisonError::into_inner).reset(ResetReason::CameraCut);
        py.detach(reset);
    }

    /// Begins anew where frame `number` of a path has the bits of one run; gives that frame's number.
    fn begin_for(&self, py: Python<'_>, number: u64) -> u64 {
        py.detach(|| {
            let mut session = self.session.lock().unwrap_or_else(PoisonError::into_inner);
            let first = session.pipeline().first_of_warm_up(number);
            session.begin_at(first);
            first
        })
    }

    /// Figures of the last frame.
    fn stats<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (times, refined, reset, visible, backend, adapter, notices) = py.detach(|| {
            let mut session = self.session.lock().unwrap_or_else(PoisonError::into_inner);
            let notices = session.take_notices();
            let pipeline = session.pipeline();
            let (times, refined) = (pipeline.times(), pipeline.refined_share());
            let (reset, visible) = (pipeline.last_reset(), pipeline.visible_count());
            (times, refined, reset, visible, session.backend().name(), session.adapter(), notices)
        });
        let stages = PyDict::new(py);
        for stage in Stage::ALL {
            if let Some(time) = times.get(stage) {
                stages.set_item(stage.name(), time.as_secs_f64() * 1e3)?;
            }
        }
        let stats = PyDict::new(py);
        stats.set_item("stage_ms", stages)?;
        stats.set_item("refined_share", refined)?;
        stats.set_item("reset", reset.map(reason))?;
        stats.set_item("visible", visible)?;
        stats.set_item("backend", backend)?;
        stats.set_item("adapter", adapter)?;
        stats.set_item("notices", notices)?;
        Ok(stats)
    }
}
