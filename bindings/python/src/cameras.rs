//! Camera paths: files and arrays in, arrays out.

use std::path::PathBuf;

use gs3::scene::camera_path::Pace;
use gs3::scene::capture::{self, CaptureError, CaptureFault, CaptureOptions};
use gs3::scene::glam::{DMat3, DVec3};
use gs3::scene::transform::Similarity;
use gs3::scene::{Size, demo};
use numpy::{PyArray2, PyArray3};
use pyo3::prelude::*;

use crate::arrays::{self, Matrices, k_of, to_numpy, view_of};
use crate::error;

/// Cameras in order, and the frame rate. It does not change.
#[derive(Debug)]
#[pyclass(frozen, module = "gs3._gs3")]
pub struct CameraPath {
    pub path: gs3::scene::CameraPath,
}

fn of_capture(error: &CaptureError) -> PyErr {
    if matches!(error.fault, CaptureFault::Read(_)) { error::file(error) } else { error::input(error) }
}

#[pymethods]
impl CameraPath {
    #[staticmethod]
    fn load(
        py: Python<'_>,
        path: PathBuf,
        size: Option<(u32, u32)>,
        fov_y: Option<f64>,
        dataparser: Option<PathBuf>,
        origin: [f64; 3],
    ) -> PyResult<Self> {
        let options = CaptureOptions { size: size.map(Size::from), fov_y, dataparser };
        let path = py.detach(|| capture::load_with(path, &options)).map_err(|e| of_capture(&e))?;
        if origin == [0.0; 3] {
            return Ok(Self { path });
        }
        let shift = -DVec3::from(origin);
        let moved = path.in_moved_world(&Similarity { shift, ..Similarity::orthogonal(DMat3::IDENTITY) });
        Ok(Self { path: moved.map_err(error::input)? })
    }

    #[staticmethod]
    fn demo() -> Self {
        Self { path: demo::path() }
    }

    #[staticmethod]
    fn from_arrays(
        viewmats: Matrices<'_>,
        ks: Matrices<'_>,
        width: u32,
        height: u32,
        frames_per_second: f64,
        cycle: bool,
    ) -> PyResult<Self> {
        let cameras = arrays::cameras(&viewmats, &ks, width, height)?;
        let path = gs3::scene::CameraPath::new(cameras, frames_per_second, cycle).map_err(error::input)?;
        Ok(Self { path })
    }

    fn resized(&self, width: u32, height: u32) -> PyResult<Self> {
        self.path.resized(width, height).map(|path| Self { path }).map_err(error::input)
    }

    fn smoothed(&self, frames: usize) -> Self {
        Self { path: self.path.smoothed(frames, Pace::Speed) }
    }

    fn part(&self, first: usize, end: usize) -> PyResult<Self> {
        let cameras = self.path.cameras().get(first..end).unwrap_or_default().to_vec();
        let rate = self.path.frames_per_second();
        let path = gs3::scene::CameraPath::new(cameras, rate, false).map_err(error::input)?;
        Ok(Self { path })
    }

    fn __len__(&self) -> usize {
        self.path.cameras().len()
    }

    #[getter]
    fn frames_per_second(&self) -> f64 {
        self.path.frames_per_second()
    }

    #[getter]
    fn is_cycle(&self) -> bool {
        self.path.is_cycle()
    }

    #[getter]
    fn names(&self) -> Vec<String> {
        (0..self.__len__()).map(|k| self.path.name(k).unwrap_or_default().to_owned()).collect()
    }

    #[getter]
    fn notes(&self) -> Vec<String> {
        self.path.facts().notes.clone()
    }

    fn viewmats<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        to_numpy(py, self.path.cameras().iter().flat_map(view_of).collect(), [self.__len__(), 4, 4])
    }

    fn ks<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        to_numpy(py, self.path.cameras().iter().flat_map(k_of).collect(), [self.__len__(), 3, 3])
    }

    /// Width and height.
    fn sizes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i64>>> {
        let sizes = self.path.cameras().iter().flat_map(|c| c.size().to_array().map(i64::from));
        to_numpy(py, sizes.collect(), [self.__len__(), 2])
    }
}
