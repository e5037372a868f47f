//! Scenes: files and arrays in, arrays and files out.

use std::path::PathBuf;
use std::sync::Arc;

use gs3::scene::format::{self, Budget, LoadOptions};
use gs3::scene::gaussians::SH_C0;
use gs3::scene::{Axes, Gaussians, OpacityMode, demo};
use numpy::{
    PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::prelude::*;

use crate::arrays::{Matrices, check_shape, slice, to_numpy};
use crate::cameras::CameraPath;
use crate::raster::{self, KeptRasterizer};
use crate::{error, patience};

/// Gaussians that a thread copies at a time.
const AT_ONCE: usize = 1 << 14;

/// Gaussians that were checked, and how they are rendered. It does not change.
#[derive(Debug)]
#[pyclass(frozen, module = "gs3._gs3")]
pub struct Scene {
    pub scene: Arc<gs3::scene::Scene>,
    /// For [`Self::rasterize`].
    rasterizer: KeptRasterizer,
}

impl Scene {
    pub fn new(scene: gs3::scene::Scene) -> Self {
        Self { scene: Arc::new(scene), rasterizer: KeptRasterizer::default() }
    }

    fn gaussians(&self) -> &Gaussians {
        self.scene.gaussians()
    }

    /// Planes side by side, `[N, C]`.
    fn interleaved<'py, const C: usize>(
        &self,
        py: Python<'py>,
        planes: &[Vec<f32>; C],
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let count = planes[0].len();
        let values = py.detach(|| {
            let mut values = vec![0.0; count * C];
            values.par_chunks_mut(C * AT_ONCE).enumerate().for_each(|(block, out)| {
                for (i, row) in out.as_chunks_mut::<C>().0.iter_mut().enumerate() {
                    *row = std::array::from_fn(|c| planes[c][block * AT_ONCE + i]);
                }
            });
            values
        });
        to_numpy(py, values, [count, C])
    }
}

/// `C` planes from numbers side by side.
fn planes<const C: usize>(values: &[f32]) -> [Vec<f32>; C] {
    let rows = values.as_chunks::<C>().0;
    std::array::from_fn(|c| rows.par_iter().with_min_len(AT_ONCE).map(|row| row[c]).collect())
}

/// The first `to` of every `from` numbers.
fn leading(values: &[f32], from: usize, to: usize) -> Vec<f32> {
    if from == to {
        let mut copy = vec![0.0; values.len()];
        let size = AT_ONCE * from;
        copy.par_chunks_mut(size)
            .zip(values.par_chunks(size))
            .for_each(|(to, from)| to.copy_from_slice(from));
        return copy;
    }
    let mut copy = vec![0.0; values.len() / from * to];
    let rows = copy.par_chunks_exact_mut(to).zip(values.par_chunks_exact(from)).with_min_len(AT_ONCE);
    rows.for_each(|(row, all)| row.copy_from_slice(&all[..to]));
    copy
}

#[pymethods]
impl Scene {
    #[staticmethod]
    fn open(
        py: Python<'_>,
        path: PathBuf,
        level: Option<u32>,
        environment: bool,
        budget: Option<u64>,
        cameras: Option<&CameraPath>,
        axes: Option<&str>,
        progress: Option<Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let axes =
            axes.map(str::parse::<Axes>).transpose().map_err(|e| error::input(format_args!("axes: {e}")))?;
        let cameras = cameras.map_or_else(Vec::new, |path| path.path.cameras().to_vec());
        let budget = budget.map(|gaussians| Budget { gaussians, cameras });
        let options = LoadOptions { level_of_detail: level, environment, budget, axes };
        let what = path.display().to_string();
        let loaded = patience::run(py, &what, progress.as_ref(), |tell, stop| {
            format::load_until(&path, &options, tell, stop)
        })?;
        loaded.map(Self::new).map_err(|e| error::of_load(&e))
    }

    /// `sh` has `[N, K, 3]`, of which the first (`sh_degree` + 1)² are taken; or else `colors` `[N, 3]`, alike from everywhere.
    #[staticmethod]
    fn from_arrays(
        py: Python<'_>,
        means: PyReadonlyArray2<'_, f32>,
        quats: PyReadonlyArray2<'_, f32>,
        scales: PyReadonlyArray2<'_, f32>,
        opacities: PyReadonlyArray1<'_, f32>,
        sh: Option<PyReadonlyArray3<'_, f32>>,
        sh_degree: u8,
        colors: Option<PyReadonlyArray2<'_, f32>>,
        antialiased: bool,
    ) -> PyResult<Self> {
        let count = means.shape()[0];
        check_shape("means", &[count, 3], means.shape())?;
        check_shape("quats", &[count, 4], quats.shape())?;
        check_shape("scales", &[count, 3], scales.shape())?;
        check_shape("opacities", &[count], opacities.shape())?;
        let coefficients = (usize::from(sh_degree) + 1).pow(2);
        let (means, quats) = (slice("means", &means)?, slice("quats", &quats)?);
        let (scales, opacities) = (slice("scales", &scales)?, slice("opacities", &opacities)?);
        let stored = sh.as_ref().map_or(coefficients, |sh| sh.shape()[1].max(coefficients));
        if let Some(sh) = &sh {
            check_shape("sh", &[count, stored, 3], sh.shape())?;
        }
        if let Some(colors) = &colors {
            check_shape("colors", &[count, 3], colors.shape())?;
        }
        let sh = sh.as_ref().map(|sh| slice("sh", sh)).transpose()?;
        let colors = colors.as_ref().map(|colors| slice("colors", colors)).transpose()?;
        if let Some(least) = colors.and_then(|colors| colors.iter().copied().find(|value| *value < 0.0)) {
            return Err(error::input(format_args!("colors: expected numbers of at least 0, found {least}")));
        }
        let mode = if antialiased { OpacityMode::Antialiased } else { OpacityMode::Default };
        let made = py.detach(|| {
            let sh = match (sh, colors) {
                (Some(sh), _) => leading(sh, stored * 3, coefficients * 3),
                (None, Some(colors)) => {
                    colors.par_iter().with_min_len(AT_ONCE).map(|c| (c - 0.5) / SH_C0).collect()
                }
                (None, None) => Vec::new(),
            };
            let gaussians = Gaussians {
                means: planes(means),
                scales: planes(scales),
                rotations: planes(quats),
                opacities: leading(opacities, 1, 1),
                sh_degree,
                sh,
            };
            gs3::scene::Scene::new(gaussians, mode)
        });
        made.map(Self::new).map_err(error::input)
    }

    #[staticmethod]
    fn demo(py: Python<'_>) -> PyResult<Self> {
        py.detach(demo::scene).map(Self::new).map_err(error::input)
    }

    /// As [`raster::rasterize`].
    fn rasterize<'py>(
        &self,
        py: Python<'py>,
        viewmats: Matrices<'py>,
        ks: Matrices<'py>,
        width: u32,
        height: u32,
        near_plane: f32,
        far_plane: f32,
        eps2d: f32,
        backgrounds: Option<PyReadonlyArray2<'py, f32>>,
        render_mode: &str,
        planes: bool,
    ) -> PyResult<Bound<'py, PyDict>> {
        raster::rasterize(
            py,
            &self.scene,
            &self.rasterizer,
            viewmats,
            ks,
            width,
            height,
            near_plane,
            far_plane,
            eps2d,
            backgrounds,
            render_mode,
            planes,
        )
    }

    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        py.detach(|| format::save(&self.scene, path)).map_err(|e| error::of_save(&e))
    }

    fn losses(&self, py: Python<'_>, path: PathBuf) -> Vec<String> {
        py.detach(|| format::losses(&self.scene, path))
    }

    fn __len__(&self) -> usize {
        self.gaussians().len()
    }

    #[getter]
    fn sh_degree(&self) -> u8 {
        self.gaussians().sh_degree
    }

    #[getter]
    fn antialiased(&self) -> bool {
        self.scene.opacity_mode() == OpacityMode::Antialiased
    }

    #[getter]
    fn near(&self) -> f32 {
        self.scene.details().near
    }

    /// What the file's positions have more than the scene's.
    #[getter]
    fn origin(&self) -> [f64; 3] {
        self.scene.details().origin.to_array()
    }

    #[getter]
    fn dropped(&self) -> usize {
        self.scene.dropped().total()
    }

    #[getter]
    fn notes(&self) -> Vec<String> {
        self.scene.details().notes.clone()
    }

    fn means<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        self.interleaved(py, &self.gaussians().means)
    }

    fn quats<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        self.interleaved(py, &self.gaussians().rotations)
    }

    fn scales<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        self.interleaved(py, &self.gaussians().scales)
    }

    fn opacities<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f32>> {
        PyArray1::from_vec(py, py.detach(|| leading(&self.gaussians().opacities, 1, 1)))
    }

    fn sh<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let (count, stride) = (self.gaussians().len(), self.gaussians().sh_stride());
        let values = py.detach(|| leading(&self.gaussians().sh, stride, stride));
        to_numpy(py, values, [count, stride / 3, 3])
    }
}
