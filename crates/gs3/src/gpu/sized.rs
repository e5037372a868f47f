//! What the frames of one size are made in.

use gs3_compute::{Bound, Buffer, Gpu, GpuError, Kernel, Readback, Recorder, Slice, Use};
use gs3_raster::{GpuGBuffer, GpuRasterizer, MAX_MARGIN, RasterSettings};
use gs3_reconstruct::gpu::{
    BoundInterpolator, BoundSuperSampler, GpuImage, GpuInterpolator, GpuNeighbor, GpuPlanes, GpuSuperSampler,
    Innovation, NeighborView,
};
use gs3_scene::{Camera, Margin};

use super::between::{Between, LearnedBetween};
use super::learned::{Learned, Place};
use crate::error::PipelineError;
use crate::lattice::{DepthLattice, LATTICE};
use crate::learned::Networks;
use crate::settings::{Mode, PipelineSettings};

/// Bytes of [`DepthLattice`].
const LATTICE_BYTES: u64 = (LATTICE * LATTICE * 4) as u64;

const LATTICE_WGSL: &str = include_str!("lattice.wgsl");

/// One of the two frames that are there at a time: the last one, and the one being made.
pub struct Side {
    pub gbuffer: GpuGBuffer,
    pub image: GpuImage,
    /// What it was seen by, once it is whole.
    pub view: Option<NeighborView>,
    /// The kernels that read and write it. They are bound when its G-buffer has its memory.
    bound: Option<BoundSide>,
}

struct BoundSide {
    super_sampler: BoundSuperSampler,
    lattice: Bound,
}

/// All memory and kernels of frames of one size.
pub struct Sized {
    gpu: Gpu,
    pub size: [u32; 2],
    pub super_sampler: GpuSuperSampler,
    learned: Option<Learned>,
    learned_between: Option<LearnedBetween>,
    interpolator: GpuInterpolator,
    pub sides: [Side; 2],
    /// The LR frame being made with its margin, where frames have margins.
    around: Option<GpuGBuffer>,
    /// The frame being made before a network refines it, where one does.
    analytic: Option<GpuImage>,
    /// Which of them was made last.
    pub newest: usize,
    /// The frames between both.
    pub between: Vec<GpuImage>,
    /// Interpolation into each of them, by which side is the newer one.
    bound_between: [Vec<BoundInterpolator>; 2],
    look: Kernel,
    /// Those of [`DepthLattice`], and the size of what they are taken from.
    lattice: Buffer,
    lattice_size: Buffer,
    pub readback: Readback,
    pub places: Places,
}

/// Where what is read back lies: the rasterizer's counters, the lattice, the frame, the frames between.
#[derive(Clone, Copy, Debug)]
pub struct Places {
    lattice: u64,
    image: u64,
    between: u64,
}

impl Places {
    fn new(counters: u64, image: u64) -> Self {
        let lattice = counters.next_multiple_of(4);
        let first = lattice + LATTICE_BYTES;
        Self { lattice, image: first, between: first + image }
    }

    /// Of all bytes the rasterizer's counters.
    pub fn counters_of<'a>(&self, bytes: &'a [u8]) -> &'a [u8] {
        part(bytes, 0, self.lattice)
    }

    /// Of all bytes the depths that the processor knows.
    pub fn lattice_of(&self, bytes: &[u8]) -> DepthLattice {
        let mut lattice = DepthLattice::default();
        let depths = part(bytes, self.lattice, self.image).as_chunks().0;
        lattice.0.iter_mut().zip(depths).for_each(|(to, depth)| *to = f32::from_le_bytes(*depth));
        lattice
    }

    /// Of all bytes the frame.
    pub fn image_of<'a>(&self, bytes: &'a [u8]) -> &'a [u8] {
        part(bytes, self.image, self.between)
    }

    /// Of all bytes the `k`-th frame between.
    pub fn between_of<'a>(&self, bytes: &'a [u8], k: usize) -> &'a [u8] {
        part(bytes, self.place_between(k), self.place_between(k + 1))
    }

    fn place_between(&self, k: usize) -> u64 {
        self.between + k as u64 * (self.between - self.image)
    }
}

fn part(bytes: &[u8], start: u64, end: u64) -> &[u8] {
    bytes.get(start as usize..end as usize).unwrap_or_default()
}

/// The planes that reconstruction reads of a G-buffer that has them.
pub fn planes(gbuffer: &GpuGBuffer) -> Result<GpuPlanes<'_>, GpuError> {
    let missing = || GpuError::Bindings {
        kernel: "reconstruction".to_owned(),
        expected: "a G-buffer with gradients and geometry".to_owned(),
        actual: "one without".to_owned(),
    };
    Ok(GpuPlanes {
        color_alpha: gbuffer.color_alpha().ok_or_else(missing)?,
        dx_median: gbuffer.dx_median().ok_or_else(missing)?,
        dy_expected: gbuffer.dy_expected().ok_or_else(missing)?,
    })
}

impl Sized {
    /// Frames of `size`, refined by `networks`; `counters` bytes of the rasterizer's are read back with each.
    pub fn new(
        gpu: &Gpu,
        settings: &PipelineSettings,
        networks: &Networks,
        size: [u32; 2],
        counters: u64,
    ) -> Result<Self, PipelineError> {
        let scale = settings.scale;
        let Networks { super_sample: weights, interpolate, .. } = networks;
        let innovation = if weights.is_some() { Innovation::Wanted } else { Innovation::NotWanted };
        let has_margins = settings.overscan_below(weights.as_deref());
        let margin = if has_margins { MAX_MARGIN } else { 0 };
        // First, because it checks scale and size, on which everything else builds.
        let kriging = settings.kriging_below(weights.as_deref());
        let super_sampler = GpuSuperSampler::new(gpu, scale, size, innovation, kriging, margin)?;
        let side = || {
            let image = GpuImage::new(gpu, size)?;
            Ok::<_, PipelineError>(Side { gbuffer: GpuGBuffer::default(), image, view: None, bound: None })
        };
        let sides = [side()?, side()?];
        let count = match settings.mode {
            Mode::Full => settings.displayed_per_rendered() - 1,
            Mode::Native | Mode::Bicubic | Mode::SuperSample => 0,
        };
        let between = (0..count).map(|_| GpuImage::new(gpu, size)).collect::<Result<Vec<_>, _>>()?;
        let places = Places::new(counters, sides[0].image.bytes());
        Ok(Self {
            gpu: gpu.clone(),
            size,
            super_sampler,
            learned: weights.as_ref().map(|weights| Learned::new(gpu, weights, size, scale)).transpose()?,
            learned_between: interpolate
                .as_ref()
                .filter(|_| count > 0)
                .map(|weights| LearnedBetween::new(gpu, weights, size, scale, count))
                .transpose()?,
            interpolator: GpuInterpolator::new(gpu, scale, size)?,
            sides,
            around: has_margins.then(GpuGBuffer::default),
            analytic: weights.as_ref().map(|_| GpuImage::new(gpu, size)).transpose()?,
            newest: 0,
            between,
            bound_between: [Vec::new(), Vec::new()],
            look: gpu.module("lattice", &[LATTICE_WGSL])?.kernel(gpu, "look", &[])?,
            lattice: gpu.buffer("lattice", Use::Storage, LATTICE_BYTES)?,
            lattice_size: gpu.buffer_with(
                "lattice size",
                Use::Uniform,
                &size.map(|side| side.div_ceil(scale)),
            )?,
            readback: Readback::new(gpu, places.place_between(count))?,
            places,
        })
    }

    /// Records the G-buffer of side `current`, which `camera` sees; where frames have no margins, without that of
    /// `settings`.
    pub fn record_rasterizing(
        &mut self,
        recorder: &mut Recorder<'_>,
        rasterizer: &mut GpuRasterizer,
        camera: &Camera,
        settings: &RasterSettings,
        current: usize,
    ) -> Result<(), PipelineError> {
        let gbuffer = &mut self.sides[current].gbuffer;
        match &mut self.around {
            Some(around) => rasterizer.record_within(recorder, camera, settings, around, gbuffer)?,
            None => {
                let settings = RasterSettings { margin: Margin::NONE, ..*settings };
                rasterizer.record(recorder, camera, &settings, gbuffer)?;
            }
        }
        Ok(())
    }

    /// Records super sampling of side `current`, whose G-buffer has been rasterized for `view`, and its refinement;
    /// `last` is the view of the other side, where it is the frame before.
    pub fn record_super_sampling(
        &mut self,
        recorder: &mut Recorder<'_>,
        current: usize,
        view: &NeighborView,
        margin: Margin,
        last: Option<&NeighborView>,
    ) -> Result<(), PipelineError> {
        let side = &mut self.sides[current];
        let bound = match &mut side.bound {
            Some(bound) => bound,
            none => {
                let planes = planes(&side.gbuffer)?;
                let buffers = [
                    ("size", self.lattice_size.slice()),
                    ("dx_median", planes.dx_median.slice()),
                    ("depths", self.lattice.slice()),
                ];
                let lattice = self.look.bind(&self.gpu, &buffers)?;
                let made = self.analytic.as_ref().unwrap_or(&side.image);
                let around = self.around.as_ref().map_or(Ok(planes), self::planes)?;
                let super_sampler = self.super_sampler.bind(&planes, &around, made)?;
                none.insert(BoundSide { super_sampler, lattice })
            }
        };
        let margin = if self.around.is_some() { margin } else { Margin::NONE };
        self.super_sampler.record(recorder, &bound.super_sampler, &view.camera, view.jitter, margin)?;
        recorder.dispatch(&bound.lattice, [1, 1, 1]);
        let (Some(learned), Some(analytic)) = (&mut self.learned, &self.analytic) else { return Ok(()) };
        let places = self.sides.each_ref().map(|side| Place { gbuffer: &side.gbuffer, refined: &side.image });
        let stages = (&self.super_sampler, &self.interpolator);
        learned.record(recorder, stages, analytic, places, current, view, last)
    }

    /// Records the frames at `moments` between the last one and side `current`, which `views` saw; none where there
    /// is no last one.
    pub fn record_between(
        &mut self,
        recorder: &mut Recorder<'_>,
        current: usize,
        views: [Option<&NeighborView>; 2],
        moments: &[(f64, Camera)],
    ) -> Result<(), PipelineError> {
        self.learned_between.iter_mut().for_each(|learned| learned.begin(current));
        let [Some(before), Some(after)] = views else { return Ok(()) };
        let views = [before, after];
        let [before, after] = [&self.sides[1 - current], &self.sides[current]];
        let before = GpuNeighbor { image: &before.image, planes: planes(&before.gbuffer)? };
        let after = GpuNeighbor { image: &after.image, planes: planes(&after.gbuffer)? };
        let interpolator = &self.interpolator;
        if let Some(learned) = &mut self.learned_between {
            for (k, ((t, camera), out)) in moments.iter().zip(&self.between).enumerate() {
                let t = *t as f32;
                let between = Between { interpolator, neighbors: [before, after], views, t, camera, out };
                learned.record(recorder, current, k, &between)?;
            }
            return Ok(());
        }
        if self.bound_between[current].is_empty() && !moments.is_empty() {
            let bind = |out| interpolator.bind(&before, &after, out);
            self.bound_between[current] = self.between.iter().map(bind).collect::<Result<_, _>>()?;
        }
        for ((t, camera), bound) in moments.iter().zip(&self.bound_between[current]) {
            interpolator.record(recorder, bound, views, *t as f32, camera)?;
        }
        Ok(())
    }

    /// Records the way back of what the next frame needs to know.
    pub fn record_facts(&self, recorder: &mut Recorder<'_>, counters: &Slice<'_>) {
        recorder.read_back(counters, &self.readback, 0);
        recorder.read_back(&self.lattice.part(0, LATTICE_BYTES), &self.readback, self.places.lattice);
    }

    /// Records the way back of side `current` and of the first `count` frames between.
    pub fn record_images(&self, recorder: &mut Recorder<'_>, current: usize, count: usize) {
        let images = [&self.sides[current].image].into_iter().chain(self.between.iter().take(count));
        let places = [self.places.image].into_iter().chain((0..count).map(|k| self.places.place_between(k)));
        for (image, place) in images.zip(places) {
            recorder.read_back(&image.pixels().part(0, image.bytes()), &self.readback, place);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_read_back_lies_apart() {
        let places = Places::new(18, 800);
        let bytes: Vec<u8> = (0..20 + 100 + 3 * 800).map(|k| (k % 251) as u8).collect();
        assert_eq!(places.counters_of(&bytes), &bytes[..20]);
        assert_eq!(places.lattice_of(&bytes).0[1], f32::from_le_bytes(bytes[24..28].try_into().unwrap()));
        assert_eq!(places.image_of(&bytes), &bytes[120..920]);
        assert_eq!(places.between_of(&bytes, 1), &bytes[1720..2520]);
        assert_eq!(places.place_between(2), bytes.len() as u64);
        gs3_compute::validate("lattice", &[LATTICE_WGSL]).unwrap();
    }
}
