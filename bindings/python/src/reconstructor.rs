//! Frames of other renderers.

use std::sync::{Mutex, PoisonError};

use gs3::Kriging;
use gs3::reconstruct::{
    DepthEncoding, GBufferView, PlanesView, ReconstructorSettings, ResetReason, Sampling, Strides,
};
use gs3::scene::{Margin, Size};
use numpy::{PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyList;

use crate::arrays::{Pixels, single_camera, slice};
use crate::error;
use crate::renderer::{named, reason};

/// The library's reconstructor.
#[derive(Debug)]
#[pyclass(frozen, module = "gs3._gs3")]
pub struct Reconstructor {
    inner: Mutex<gs3::Reconstructor>,
}

/// `[height, width, channels]` with at least `C` channels; the first `C` are read.
fn planes<'a, const C: usize>(
    name: &str,
    array: &'a PyReadonlyArray3<'_, f32>,
) -> PyResult<PlanesView<'a, C>> {
    let &[height, width, channels] = array.shape() else {
        return Err(error::input(format_args!("{name}: no image")));
    };
    if channels < C {
        return Err(error::input(format_args!("{name}: expected at least {C} channels, found {channels}")));
    }
    PlanesView::interleaved(slice(name, array)?, Size::of(width, height), channels).map_err(error::input)
}

/// What the numbers of a depth buffer mean.
fn encoding(name: &str, near: f32, far: f32) -> PyResult<DepthEncoding> {
    Ok(match name {
        "distance" => DepthEncoding::Distance,
        "projective" => DepthEncoding::Projective { near, far },
        "reversed" => DepthEncoding::Reversed { near, far },
        "linear" => DepthEncoding::Linear { near, far },
        _ => {
            return Err(error::input(format_args!(
                "depth_encoding: expected distance, projective, reversed or linear, found {name:?}"
            )));
        }
    })
}

#[pymethods]
impl Reconstructor {
    #[new]
    fn new(
        scale: u32,
        in_between: usize,
        kriging: &str,
        widest_margin: u32,
        jittered: bool,
    ) -> PyResult<Self> {
        let krigings = [Kriging::Off, Kriging::Coarse, Kriging::On, Kriging::Fine];
        let settings = ReconstructorSettings {
            scale,
            sampling: if jittered { Sampling::Jittered } else { Sampling::Centered },
            kriging: named("kriging", kriging, &krigings, Kriging::name)?,
            widest_margin,
            in_between,
        };
        let inner = gs3::Reconstructor::new(settings).map_err(error::input)?;
        Ok(Self { inner: Mutex::new(inner) })
    }

    /// Jitter, margin (left, top, right, bottom) and reason of a reset of the next frame.
    fn next(
        &self,
        py: Python<'_>,
        viewmat: PyReadonlyArray2<'_, f64>,
        k: PyReadonlyArray2<'_, f64>,
        width: u32,
        height: u32,
    ) -> PyResult<([f32; 2], [u32; 4], Option<&'static str>)> {
        let camera = single_camera(&viewmat, &k, [width, height])?;
        let start = py.detach(|| self.inner.lock().unwrap_or_else(PoisonError::into_inner).next(&camera));
        let Margin { left, top, right, bottom } = start.margin;
        Ok((start.jitter, [left, top, right, bottom], start.reset.map(reason)))
    }

    fn reset(&self, py: Python<'_>) {
        py.detach(|| self.inner.lock().unwrap_or_else(PoisonError::into_inner).reset(ResetReason::CameraCut));
    }

    /// The frames to show, and why there is no history, if there is none.
    fn reconstruct<'py>(
        &self,
        py: Python<'py>,
        viewmat: PyReadonlyArray2<'py, f64>,
        k: PyReadonlyArray2<'py, f64>,
        width: u32,
        height: u32,
        color: PyReadonlyArray3<'py, f32>,
        depth: PyReadonlyArray2<'py, f32>,
        gradients: Option<[PyReadonlyArray3<'py, f32>; 2]>,
        motion: Option<PyReadonlyArray3<'py, f32>>,
        jitter: [f32; 2],
        margin: [u32; 4],
        depth_encoding: &str,
        near: f32,
        far: f32,
        as_bytes: bool,
    ) -> PyResult<(Bound<'py, PyList>, Option<&'static str>)> {
        let camera = single_camera(&viewmat, &k, [width, height])?;
        let &[rows, columns] = depth.shape() else { return Err(error::input("depth: no image")) };
        let strides = Strides { row: columns, pixel: 1, channel: 1 };
        let depth = PlanesView::new(slice("depth", &depth)?, Size::of(columns, rows), strides)
            .map_err(error::input)?;
        let gradients = match &gradients {
            Some([dx, dy]) => Some([planes("color_dx", dx)?, planes("color_dy", dy)?]),
            None => None,
        };
        let [left, top, right, bottom] = margin;
        let motion = motion.as_ref().map(|motion| planes("motion", motion)).transpose()?;
        let view = GBufferView {
            gradients,
            motion,
            encoding: encoding(depth_encoding, near, far)?,
            margin: Margin { left, top, right, bottom },
            ..GBufferView::new(planes("color", &color)?, depth, jitter)
        };
        let (frames, reset) = py.detach(|| {
            let mut inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
            let shown = inner.reconstruct(&camera, &view).map_err(error::input)?;
            let images = shown.in_between.iter().chain([shown.current]);
            Ok::<_, PyErr>((images.map(|i| Pixels::of(i, as_bytes)).collect::<Vec<_>>(), shown.reset))
        })?;
        let frames = frames.into_iter().map(|pixels| pixels.into_numpy(py)).collect::<PyResult<Vec<_>>>()?;
        Ok((PyList::new(py, frames)?, reset.map(reason)))
    }
}
