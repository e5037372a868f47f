//! Rasterization in the shapes and by the rules of gsplat.

use std::sync::{Arc, Mutex, PoisonError};

use gs3::Culling;
use gs3::raster::{Outputs, RasterSettings, Rasterizer, Rules};
use gs3::scene::{Camera, GBuffer, Planes, Scene};
use numpy::PyReadonlyArray2;
use numpy::PyUntypedArrayMethods;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::prelude::*;

use crate::arrays::{self, Matrices, check_shape, slice, to_numpy};
use crate::error;

/// Pixels that a thread copies at a time.
const AT_ONCE: usize = 1 << 14;

/// A rasterizer of one scene from one call to the next, once it was needed.
#[derive(Debug, Default)]
pub struct KeptRasterizer(Mutex<Option<Rasterizer>>);

impl KeptRasterizer {
    fn rasterize(
        &self,
        scene: &Arc<Scene>,
        camera: &Camera,
        settings: &RasterSettings,
        out: &mut GBuffer,
    ) -> Result<(), gs3::raster::RasterError> {
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let rasterizer = kept.get_or_insert_with(|| Rasterizer::new(Arc::clone(scene), Culling::default()));
        rasterizer.rasterize(camera, settings, out)
    }
}

/// A plane of each of many frames, `[C, H, W, channels]`.
struct Batch {
    values: Vec<f32>,
    channels: usize,
}

impl Batch {
    fn new(pixels: usize, channels: usize) -> Self {
        Self { values: vec![0.0; pixels * channels], channels }
    }

    /// Copies `planes` to channels `first..` of frame `k`. `convert` gets each value and its pixel.
    fn take<const N: usize>(
        &mut self,
        k: usize,
        first: usize,
        planes: &Planes<N>,
        convert: impl Fn(usize, f32) -> f32 + Sync,
    ) {
        let (size, channels) = (planes.width() * planes.height(), self.channels);
        let sources: [&[f32]; N] = std::array::from_fn(|c| planes.plane(c));
        let frame = &mut self.values[k * size * channels..(k + 1) * size * channels];
        frame.par_chunks_mut(AT_ONCE * channels).enumerate().for_each(|(block, out)| {
            for (i, pixel) in out.chunks_exact_mut(channels).enumerate() {
                let place = block * AT_ONCE + i;
                for (to, source) in pixel[first..first + N].iter_mut().zip(sources) {
                    *to = convert(place, source[place]);
                }
            }
        });
    }

    fn give(self, dict: &Bound<'_, PyDict>, name: &str, [count, height, width]: [usize; 3]) -> PyResult<()> {
        let shape = [count, height, width, self.channels];
        dict.set_item(name, to_numpy(dict.py(), self.values, shape)?)
    }
}

/// What a batch of frames is asked for.
#[derive(Clone, Copy)]
struct Wanted {
    has_color: bool,
    has_depth: bool,
    /// Whether depth is divided by alpha.
    is_expected: bool,
    has_planes: bool,
}

/// Batches by the names that they get.
struct Batches {
    render: Batch,
    alphas: Batch,
    /// `color_dx`, `color_dy`, `normals`, `median_depth`.
    planes: Option<[Batch; 4]>,
}

impl Batches {
    fn new(pixels: usize, wanted: Wanted) -> Self {
        let channels = 3 * usize::from(wanted.has_color) + usize::from(wanted.has_depth);
        let planes = || [3, 3, 3, 1].map(|channels| Batch::new(pixels, channels));
        Self {
            render: Batch::new(pixels, channels),
            alphas: Batch::new(pixels, 1),
            planes: wanted.has_planes.then(planes),
        }
    }

    fn take(&mut self, k: usize, frame: &GBuffer, wanted: Wanted) {
        let same = |_: usize, value: f32| value;
        if wanted.has_color {
            self.render.take(k, 0, &frame.color, same);
        }
        self.alphas.take(k, 0, &frame.alpha, same);
        if let (true, Some(geometry)) = (wanted.has_depth, &frame.geometry) {
            let alpha = frame.alpha.plane(0);
            let place = self.render.channels - 1;
            self.render.take(k, place, &geometry.depth_expected, |pixel, depth| match wanted.is_expected {
                true => depth,
                false => depth * alpha[pixel],
            });
        }
        if let (Some([dx, dy, normals, median]), Some(gradients), Some(geometry)) =
            (&mut self.planes, &frame.gradients, &frame.geometry)
        {
            dx.take(k, 0, &gradients.color_dx, same);
            dy.take(k, 0, &gradients.color_dy, same);
            normals.take(k, 0, &geometry.normal, same);
            median.take(k, 0, &geometry.depth_median, same);
        }
    }
}

/// Rasterizes `scene`, which `kept` is of. `render_mode` is one of gsplat's. Gives `render`, `alphas` and, where `planes` are asked for, those, all
/// `[C, H, W, …]`.
pub fn rasterize<'py>(
    py: Python<'py>,
    scene: &Arc<Scene>,
    kept: &KeptRasterizer,
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
    let cameras = arrays::cameras(&viewmats, &ks, width, height)?;
    if let Some(backgrounds) = &backgrounds {
        check_shape("backgrounds", &[cameras.len(), 3], backgrounds.shape())?;
    }
    let backgrounds = backgrounds.as_ref().map(|b| slice("backgrounds", b)).transpose()?;
    let backgrounds = backgrounds.map(|values| values.as_chunks::<3>().0);
    let (has_color, has_depth, is_expected) = match render_mode {
        "RGB" => (true, false, false),
        "D" => (false, true, false),
        "ED" => (false, true, true),
        "RGB+D" => (true, true, false),
        "RGB+ED" => (true, true, true),
        _ => {
            return Err(error::input(format_args!(
                "render_mode: expected RGB, D, ED, RGB+D or RGB+ED, found {render_mode:?}"
            )));
        }
    };
    let wanted = Wanted { has_color, has_depth, is_expected, has_planes: planes };
    let outputs = if has_depth || planes { Outputs::GBuffer } else { Outputs::Color };
    let rules = Rules { near: Some(near_plane), far: far_plane, ..Rules::GSPLAT };
    let settings = RasterSettings { dilation: eps2d, rules, ..RasterSettings::new(outputs) };

    let (w, h) = (width as usize, height as usize);
    let mut batches = py.detach(|| Batches::new(cameras.len() * w * h, wanted));
    let mut frame = GBuffer::default();
    for (k, camera) in cameras.iter().enumerate() {
        py.check_signals()?;
        let background = backgrounds.map_or([0.0; 3], |values| values[k]);
        let settings = RasterSettings { background, ..settings };
        py.detach(|| -> Result<(), gs3::raster::RasterError> {
            kept.rasterize(scene, camera, &settings, &mut frame)?;
            batches.take(k, &frame, wanted);
            Ok(())
        })
        .map_err(error::input)?;
    }
    let (dict, shape) = (PyDict::new(py), [cameras.len(), h, w]);
    batches.render.give(&dict, "render", shape)?;
    batches.alphas.give(&dict, "alphas", shape)?;
    if let Some(planes) = batches.planes {
        for (name, batch) in ["color_dx", "color_dy", "normals", "median_depth"].into_iter().zip(planes) {
            batch.give(&dict, name, shape)?;
        }
    }
    Ok(dict)
}
