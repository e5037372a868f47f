//! The inputs of the networks besides images: planes on the LR grid, channels last, with the names of the graphs.
//!
//! Training and rendering both fill the planes here, so a network gets the same inputs while it runs as in training.

use gs3_neural::Named;
use gs3_reconstruct::{
    Depth, DepthView, Interpolator, Motion, Neighbor, ReconstructError, Reprojected, inverse_depth,
};
use gs3_scene::{Camera, GBuffer, Gradients, Image, Planes, Size};
use rayon::prelude::*;

/// A frame that a hidden state belongs to.
#[derive(Clone, Copy, Debug)]
pub struct CameraDepth<'a> {
    /// The HR camera.
    pub camera: &'a Camera,
    /// Depths on the camera's LR grid.
    pub depth: Depth<'a>,
}

impl<'a> CameraDepth<'a> {
    /// The frame of `gbuffer`, an LR frame of the HR camera `camera`.
    ///
    /// # Errors
    /// [`ReconstructError::Missing`] if `gbuffer` has no geometry.
    pub fn of_gbuffer(camera: &'a Camera, gbuffer: &'a GBuffer) -> Result<Self, ReconstructError> {
        match &gbuffer.geometry {
            Some(geometry) => Ok(Self { camera, depth: Depth::Z(&geometry.depth_median) }),
            None => Err(ReconstructError::Missing { what: "depth" }),
        }
    }

    /// The depths without jitter: states lie on the LR grid itself, independent of the samples' places within pixels.
    fn view(&self, scale: u32) -> DepthView<'a> {
        DepthView { camera: self.camera.low_resolution(scale), jitter: [0.0; 2], depth: self.depth }
    }
}

/// Where each value of the last frame's hidden state moves in the current frame.
#[derive(Clone, Debug, Default)]
struct Carry {
    motion: Motion,
    /// `[height, width, 2]`.
    flow: Vec<f32>,
    /// `[height, width, 1]`.
    validity: Vec<f32>,
}

impl Carry {
    fn set(
        &mut self,
        now: CameraDepth<'_>,
        previous: Option<CameraDepth<'_>>,
        scale: u32,
        len: usize,
    ) -> Result<(), ReconstructError> {
        match previous {
            Some(previous) => {
                self.motion.set(&now.view(scale), &previous.view(scale))?;
                interleave(&mut self.flow, &[self.motion.flow.plane(0), self.motion.flow.plane(1)]);
                interleave(&mut self.validity, &[self.motion.validity.plane(0)]);
            }
            None => {
                for (plane, channels) in [(&mut self.flow, 2), (&mut self.validity, 1)] {
                    plane.clear();
                    plane.resize(channels * len, 0.0);
                }
            }
        }
        Ok(())
    }
}

/// Above this uncertainty (pixel²) the previous frame and the drift may get full weight. In motion most pixels have a
/// larger uncertainty; pixels beside a sample have a smaller one.
pub(crate) const UNCERTAIN: f32 = 0.2;

/// Inputs of the super-sampling network ([`gs3_neural::model::super_sample`]).
#[derive(Debug)]
pub struct SuperSampleFeatures {
    scale: u32,
    interpolator: Interpolator,
    /// The previous frame, reprojected to the current camera.
    reprojected: Reprojected,
    /// `[HR height, HR width]`.
    share: Vec<f32>,
    /// `[HR height, HR width, 3]`.
    drift: Vec<f32>,
    /// For each HR column, the LR sample before it and the fraction of the way to the next sample.
    columns: Vec<(usize, f32)>,
    /// `[height, width, 4]`.
    innovation: Vec<f32>,
    /// `[height, width, 3]`.
    previous_innovation: Vec<f32>,
    has_previous: bool,
    color: Vec<f32>,
    gradients: Vec<f32>,
    compressed: Vec<f32>,
    geometry: Vec<f32>,
    jitter: Vec<f32>,
    carry: Carry,
}

impl SuperSampleFeatures {
    /// Features for frames `scale` times the size of their G-buffers.
    ///
    /// # Errors
    /// [`ReconstructError::Scale`] if `scale` is not supported.
    pub fn new(scale: u32) -> Result<Self, ReconstructError> {
        Ok(Self {
            scale,
            interpolator: Interpolator::new(scale)?,
            reprojected: Reprojected::default(),
            share: Vec::new(),
            drift: Vec::new(),
            columns: Vec::new(),
            innovation: Vec::new(),
            previous_innovation: Vec::new(),
            has_previous: false,
            color: Vec::new(),
            gradients: Vec::new(),
            compressed: Vec::new(),
            geometry: Vec::new(),
            jitter: Vec::new(),
            carry: Carry::default(),
        })
    }

    /// Makes these the features of the analytic frame `now`. `innovation`
    /// ([`gs3_reconstruct::SuperSampler::innovation`]) is the difference of the frame's samples from the history.
    /// `previous` is the previous frame as the network refined it, if there is one; it gives the hidden state and the
    /// image for blending.
    ///
    /// # Errors
    /// [`ReconstructError`] if the image or a plane of `now` has another size than its camera, if gradients or
    /// geometry are missing, if its alpha or normals are not finite, or if `innovation` or `previous` has another
    /// size. Colours and gradients are not checked here: analytic super sampling has checked them before.
    pub fn set(
        &mut self,
        now: Neighbor<'_>,
        innovation: &[[f32; 4]],
        previous: Option<Neighbor<'_>>,
    ) -> Result<(), ReconstructError> {
        let Neighbor { camera, gbuffer, image, .. } = now;
        let scale = self.scale;
        let Some(gradients) = &gbuffer.gradients else {
            return Err(ReconstructError::Missing { what: "image gradients" });
        };
        let Some(geometry) = &gbuffer.geometry else {
            return Err(ReconstructError::Missing { what: "depth" });
        };
        check_size("image", camera.size(), image.size())?;
        let lr = camera.low_resolution(scale).size();
        check_size("G-buffer", lr, gbuffer.size())?;
        for planes in [&gradients.color_dx, &gradients.color_dy] {
            check_size("G-buffer gradients", lr, planes.size())?;
        }
        check_size("G-buffer depth", lr, geometry.depth_median.size())?;
        check_size("G-buffer normals", lr, geometry.normal.size())?;
        check_size("G-buffer alpha", lr, gbuffer.alpha.size())?;
        if !geometry.normal.is_finite() {
            return Err(ReconstructError::NotFinite { what: "G-buffer normals" });
        }
        if !gbuffer.alpha.is_finite() {
            return Err(ReconstructError::NotFinite { what: "G-buffer alpha" });
        }
        let len = gbuffer.width() * gbuffer.height();
        let before = previous.map(|p| CameraDepth::of_gbuffer(p.camera, p.gbuffer)).transpose()?;
        self.carry.set(CameraDepth::of_gbuffer(camera, gbuffer)?, before, scale, len)?;
        if innovation.len() != len {
            let (expected, actual) = (gbuffer.size(), Size::of(innovation.len(), 1));
            return Err(ReconstructError::Size { what: "innovation", expected, actual });
        }
        self.innovation.clear();
        self.innovation.extend_from_slice(innovation.as_flattened());
        self.previous_innovation.resize(3 * len, 0.0);
        self.has_previous = previous.is_some();
        match previous {
            Some(previous) => self.set_previous(now, previous)?,
            None => self.previous_innovation.fill(0.0),
        }
        self.set_share_and_drift(image, innovation, gbuffer.width(), gbuffer.jitter);
        let [r, g, b] = [0, 1, 2].map(|c| gbuffer.color.plane(c));
        interleave(&mut self.color, &[r, g, b]);
        let Gradients { color_dx: dx, color_dy: dy, .. } = gradients;
        let slopes = [dx.plane(0), dx.plane(1), dx.plane(2), dy.plane(0), dy.plane(1), dy.plane(2)];
        interleave(&mut self.gradients, &slopes);
        self.compressed.resize(6 * len, 0.0);
        self.compressed.par_iter_mut().zip(&self.gradients).with_min_len(4096).for_each(|(to, g)| {
            *to = g / (1.0 + g.abs());
        });
        self.set_geometry(camera, gbuffer, &geometry.depth_median, &geometry.normal, scale);
        self.jitter.resize(2 * len, 0.0);
        self.jitter.as_chunks_mut().0.fill(gbuffer.jitter);
        Ok(())
    }

    /// The previous frame at the current camera, and the difference of the samples from it.
    fn set_previous(&mut self, now: Neighbor<'_>, previous: Neighbor<'_>) -> Result<(), ReconstructError> {
        self.interpolator.reproject(previous, now, &mut self.reprojected)?;
        let visibility = self.reprojected.visibility.plane(0);
        let GBuffer { color, jitter, .. } = now.gbuffer;
        let [width, lr_width] = [now.image.width(), color.width()];
        let scale = self.scale as f32;
        let last = [width - 1, now.image.height() - 1];
        // The pixel that a sample lies in.
        let pixel = |sample: usize, axis: usize| {
            (((sample as f32 + 0.5 + jitter[axis]) * scale) as usize).min(last[axis])
        };
        let before = self.reprojected.image.pixels();
        let rows = self.previous_innovation.par_chunks_exact_mut(3 * lr_width);
        rows.enumerate().with_min_len(8).for_each(|(j, out)| {
            let row = pixel(j, 1) * width;
            for (i, out) in out.as_chunks_mut::<3>().0.iter_mut().enumerate() {
                let at = row + pixel(i, 0);
                *out = std::array::from_fn(|c| visibility[at] * (color.row(c, j)[i] - before[at][c]));
            }
        });
        Ok(())
    }

    /// Sets the previous frame's share, and the innovation interpolated between the jittered LR samples: bilinear,
    /// and constant beyond the outermost samples. One pass sets both, because both read the uncertainty of `image`,
    /// which is then in a cache.
    fn set_share_and_drift(
        &mut self,
        image: &Image,
        innovation: &[[f32; 4]],
        lr_width: usize,
        jitter: [f32; 2],
    ) {
        let scale = self.scale as f32;
        let lr_height = innovation.len() / lr_width;
        // Place of a pixel: in LR samples from the first sample.
        let place = |pixel: usize, axis: usize, samples: usize| {
            let at = (pixel as f32 + 0.5) / scale - 0.5 - jitter[axis];
            at.clamp(0.0, (samples - 1) as f32)
        };
        let width = image.width();
        self.columns.clear();
        self.columns.extend((0..width).map(|x| {
            let at = place(x, 0, lr_width);
            (at as usize, at.fract())
        }));
        let columns = &self.columns;
        self.share.resize(image.pixels().len(), 0.0);
        self.drift.resize(3 * image.pixels().len(), 0.0);
        let visibility = self.has_previous.then(|| self.reprojected.visibility.plane(0));
        let rows = self.drift.par_chunks_exact_mut(3 * width).zip(self.share.par_chunks_exact_mut(width));
        let rows = rows.zip(image.pixels().par_chunks_exact(width)).enumerate();
        let line = || vec![[0.0; 4]; lr_width + 1];
        rows.with_min_len(16).for_each_init(line, |line, (y, ((drift, share), pixels))| {
            let uncertain = |pixel: &[f32; 4]| (pixel[3] / UNCERTAIN).min(1.0);
            match visibility {
                Some(visibility) => {
                    let seen = &visibility[y * width..][..width];
                    for ((share, pixel), seen) in share.iter_mut().zip(pixels).zip(seen) {
                        *share = seen * uncertain(pixel);
                    }
                }
                None => share.fill(0.0),
            }
            // Not fused, here and below: outside of kernels compiled for wide vectors, a fused multiply-add would be
            // a function call.
            let mix = |a: [f32; 4], b: [f32; 4], t: f32| -> [f32; 4] {
                std::array::from_fn(|c| a[c] + (b[c] - a[c]) * t)
            };
            let at = place(y, 1, lr_height);
            let [above, below] = [at as usize, (at as usize + 1).min(lr_height - 1)];
            let [above, below] = [above, below].map(|j| &innovation[j * lr_width..][..lr_width]);
            for ((line, above), below) in line.iter_mut().zip(above).zip(below) {
                *line = mix(*above, *below, at.fract());
            }
            // One more sample with zero weight: no pixel lies beyond the last sample.
            let pixels = pixels.iter().zip(columns);
            for (drift, (pixel, &(left, across))) in drift.as_chunks_mut::<3>().0.iter_mut().zip(pixels) {
                let mixed = mix(line[left], line[left + 1], across);
                let uncertain = uncertain(pixel);
                *drift = std::array::from_fn(|c| mixed[c] * uncertain);
            }
        });
    }

    /// Inverse depth relative to the frame's mean, cosine between normal and ray, alpha.
    fn set_geometry(
        &mut self,
        camera: &Camera,
        gbuffer: &GBuffer,
        depth: &Planes<1>,
        normal: &Planes<3>,
        scale: u32,
    ) {
        let (width, height) = (gbuffer.width(), gbuffer.height());
        let camera = camera.low_resolution(scale);
        let intrinsics = camera.intrinsics();
        let [fx, fy, cx, cy] = [intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy].map(|v| v as f32);
        let typical = typical(depth.plane(0), inverse_depth);
        self.geometry.resize(3 * width * height, 0.0);
        self.geometry.par_chunks_exact_mut(3 * width).enumerate().for_each(|(y, row)| {
            let [nx, ny, nz] = [0, 1, 2].map(|c| normal.row(c, y));
            let (z, alpha) = (depth.row(0, y), gbuffer.alpha.row(0, y));
            let ray_y = (y as f32 + 0.5 + gbuffer.jitter[1] - cy) / fy;
            for (x, out) in row.as_chunks_mut::<3>().0.iter_mut().enumerate() {
                let ray_x = (x as f32 + 0.5 + gbuffer.jitter[0] - cx) / fx;
                let toward = -(nx[x] * ray_x + ny[x] * ray_y + nz[x]);
                let cosine = toward / (ray_x * ray_x + ray_y * ray_y + 1.0).sqrt();
                *out = [relative(inverse_depth(z[x]), typical), cosine, alpha[x]];
            }
        });
    }

    /// All inputs of the network except its state, `hidden`. `history` is the image that [`Self::set`] was given.
    #[must_use]
    pub fn named<'a>(&'a self, history: &'a Image) -> [Named<'a>; 13] {
        // Without a previous frame its share is 0, so any image will do.
        let previous = if self.has_previous { &self.reprojected.image } else { history };
        [
            ("history", history.pixels().as_flattened()),
            ("previous", previous.pixels().as_flattened()),
            ("share", &self.share),
            ("drift", &self.drift),
            ("innovation", &self.innovation),
            ("previous_innovation", &self.previous_innovation),
            ("color", &self.color),
            ("gradients", &self.gradients),
            ("compressed", &self.compressed),
            ("geometry", &self.geometry),
            ("jitter", &self.jitter),
            ("motion", &self.carry.flow),
            ("validity", &self.carry.validity),
        ]
    }
}

/// LR inputs of the interpolation network ([`gs3_neural::model::interpolate`]).
#[derive(Clone, Debug, Default)]
pub struct InterpolateFeatures {
    geometry: Vec<f32>,
    carry: Carry,
}

impl InterpolateFeatures {
    /// Makes these the features of the in-between frame at time `t`, seen by the HR `camera` with the inverse depths
    /// `inverse_depth` on the LR grid. The hidden state comes from `previous`, the in-between frame before, if there
    /// is one.
    ///
    /// # Errors
    /// [`ReconstructError`] if sizes do not match.
    pub fn set(
        &mut self,
        camera: &Camera,
        inverse_depth: &Planes<1>,
        t: f32,
        previous: Option<CameraDepth<'_>>,
        scale: u32,
    ) -> Result<(), ReconstructError> {
        let now = CameraDepth { camera, depth: Depth::Inverse(inverse_depth) };
        let plane = inverse_depth.plane(0);
        self.carry.set(now, previous, scale, plane.len())?;
        let typical = typical(plane, |w| w);
        self.geometry.resize(2 * plane.len(), 0.0);
        for (out, w) in self.geometry.as_chunks_mut().0.iter_mut().zip(plane) {
            *out = [relative(*w, typical), t];
        }
        Ok(())
    }

    /// All inputs of the network except its state, `hidden`. The HR images `before` and `after` (RGB and uncertainty)
    /// and the HR plane `share` are given by the caller.
    #[must_use]
    pub fn named<'a>(&'a self, before: &'a [f32], after: &'a [f32], share: &'a [f32]) -> [Named<'a>; 6] {
        [
            ("before", before),
            ("after", after),
            ("share", share),
            ("geometry", &self.geometry),
            ("motion", &self.carry.flow),
            ("validity", &self.carry.validity),
        ]
    }
}

/// Checks that `actual` is the size `expected` of the input `what`.
fn check_size(what: &'static str, expected: Size, actual: Size) -> Result<(), ReconstructError> {
    if expected == actual { Ok(()) } else { Err(ReconstructError::Size { what, expected, actual }) }
}

/// The mean inverse depth of pixels that show a surface; 1 if no pixel does.
fn typical(plane: &[f32], inverse: impl Fn(f32) -> f32) -> f32 {
    let (mut sum, mut count) = (0.0_f64, 0_usize);
    for w in plane.iter().map(|v| inverse(*v)).filter(|w| *w > 0.0) {
        sum += f64::from(w);
        count += 1;
    }
    if count > 0 { (sum / count as f64) as f32 } else { 1.0 }
}

/// An inverse depth independent of the scene's unit: 0 at infinity, ½ at the frame's mean, towards 1 near the camera.
fn relative(inverse: f32, typical: f32) -> f32 {
    inverse / (inverse + typical)
}

/// Interleaves planes, channels last.
fn interleave(out: &mut Vec<f32>, planes: &[&[f32]]) {
    /// Pixels of a task: with six channels, 24 KiB of input and 24 KiB of output, which stay in a first-level cache.
    const PIXELS: usize = 1024;
    let (channels, len) = (planes.len(), planes.first().map_or(0, |plane| plane.len()));
    out.resize(channels * len, 0.0);
    out.par_chunks_mut(channels * PIXELS).enumerate().with_min_len(8).for_each(|(k, out)| {
        for (c, plane) in planes.iter().enumerate() {
            let plane = &plane[k * PIXELS..];
            out.iter_mut().skip(c).step_by(channels).zip(plane).for_each(|(to, v)| *to = *v);
        }
    });
}
