//! Temporal super sampling without learning, on a GPU.

use std::fmt;

use bytemuck::Zeroable;
use gs3_compute::{Bound, BoundScan, Buffer, Gpu, GpuError, Kernel, Recorder, Scan, Slice, Use};
use gs3_scene::camera::MAX_SIDE;
use gs3_scene::{Camera, Margin, Size};

use super::blocks::BlockHistory;
use super::error::{GpuReconstructError, other_bound};
use super::frame::{FrameUniform, MAX_SOURCES, PHASES, PastUniform};
use super::image::{GpuImage, GpuPlanes};
use super::plan::{BLOCK_PIXELS, SuperSamplePlan};
use super::shaders;
use super::side_output::SideOutput;
use crate::cpu::nearest::EVERY;
use crate::error::{ReconstructError, check_frame_size, check_jitter, check_scale, check_size};
use crate::sample_grid::{SampleAxis, SampledPixels};
use crate::sequence::ResetReason;
use crate::settings::Kriging;
use crate::staleness::count_remembered;

/// A frame in the history.
#[derive(Clone, Copy, Debug)]
struct Past {
    camera: Camera,
    jitter: [f32; 2],
    margin: Margin,
    /// The part of the history's buffers that holds the frame.
    slot: u32,
    /// Of the frame's surfaces, per world unit; 0 if unknown.
    mean_inverse_depth: f32,
}

/// The frame recorded last.
#[derive(Clone, Copy, Debug)]
struct Pending {
    frame: Past,
    /// Number of past frames that it was made with; none without history.
    kept: Option<usize>,
}

/// Super-samples a sequence of jittered LR frames of one size in device memory, by the rules of
/// [`crate::SuperSampler`].
///
/// Memory: 80 B per LR pixel and remembered frame, which is 80 B per HR pixel; 68 of them are needed for the widest
/// margin as well. With [`SideOutput::ExpectedErrors`] the history also holds exact blocks of a quarter of the picture, 17 B
/// per HR pixel, and the samples that it reads them from take 12 B. Nothing is allocated after construction. Two submissions of the same frames give the same bits on
/// a device.
pub struct GpuSuperSampler {
    pub(super) gpu: Gpu,
    scale: u32,
    pub(super) plan: SuperSamplePlan,
    pub(super) uniform: Buffer,
    buffers: Vec<(&'static str, Buffer)>,
    remember: Kernel,
    predict: Kernel,
    find_ranges: Kernel,
    splat_depth: Bound,
    splat_color: Bound,
    scan_cells: BoundScan,
    list: Bound,
    rank: Bound,
    copy: Bound,
    accumulate: Kernel,
    /// If pixels are to be kriged.
    krige: Option<Kernel>,
    /// The innovation, `[LR height, LR width, 4]` of f32, or the errors of blocks.
    side_output: Option<(SideOutput, Buffer)>,
    /// The last frames, newest first.
    past: Vec<Past>,
    /// Exact blocks of these frames.
    pub(super) blocks: BlockHistory,
    /// The frame recorded last, until it is committed.
    pending: Option<Pending>,
    invalid: Option<ResetReason>,
}

impl fmt::Debug for GpuSuperSampler {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("GpuSuperSampler")
            .field("scale", &self.scale)
            .field("size", &self.plan.size)
            .field("invalid", &self.invalid)
            .finish_non_exhaustive()
    }
}

/// Super sampling from one G-buffer to one image.
#[derive(Clone, Debug)]
pub struct BoundSuperSampler {
    /// The uniform of the super sampler that made this binding.
    uniform: Buffer,
    remember: Bound,
    predict: Bound,
    find_ranges: Bound,
    accumulate: Bound,
    krige: Option<Bound>,
}

impl GpuSuperSampler {
    /// A super sampler of `scale` (1 to [`crate::MAX_SCALE`]) for frames of `size`, without history. Its LR frames may have
    /// `margin` pixels beyond each edge, 0 if they have none.
    ///
    /// # Errors
    /// [`GpuReconstructError`] if `scale`, `size` or `margin` is not supported, or the device has too little memory.
    pub fn new(
        gpu: &Gpu,
        scale: u32,
        size: Size,
        side_output: SideOutput,
        kriging: Kriging,
        margin: u32,
    ) -> Result<Self, GpuReconstructError> {
        Self::with_constants(gpu, [scale, margin], size, side_output, kriging, &[])
    }

    /// For tests: with kriging and without a side output. The samples of a cell are listed in the opposite order.
    ///
    /// # Errors
    /// As [`Self::new`].
    #[doc(hidden)]
    pub fn backward(gpu: &Gpu, scale: u32, size: Size, margin: u32) -> Result<Self, GpuReconstructError> {
        Self::with_constants(gpu, [scale, margin], size, SideOutput::None, Kriging::On, &[("BACKWARD", 1.0)])
    }

    fn with_constants(
        gpu: &Gpu,
        [scale, margin]: [u32; 2],
        size: Size,
        side_output: SideOutput,
        kriging: Kriging,
        list_constants: &[(&str, f64)],
    ) -> Result<Self, GpuReconstructError> {
        check_scale(scale)?;
        check_frame_size(size)?;
        // A margin wider than a frame is useless.
        if margin > MAX_SIDE {
            return Err(ReconstructError::Margin { max: MAX_SIDE, actual: margin }.into());
        }
        let has_blocks = side_output == SideOutput::ExpectedErrors;
        let plan = SuperSamplePlan::new(&gpu.capabilities().limits, size, scale, margin, has_blocks)?;
        let make = |(name, bytes): (&'static str, u64)| Ok((name, gpu.buffer(name, Use::Storage, bytes)?));
        let buffers = plan.buffers().into_iter().map(make).collect::<Result<Vec<_>, GpuError>>()?;
        let uniform = gpu.buffer("frame", Use::Uniform, size_of::<FrameUniform>() as u64)?;
        let kernel =
            |label: &str, source: String, entry: &str| gpu.module(label, &[&source])?.kernel(gpu, entry, &[]);
        let own = own_slices(&uniform, &buffers);
        let splat = gpu.module("splat", &[&shaders::splat()])?;
        let splat_depth = splat.kernel(gpu, "splat_depth", &[])?.bind(gpu, &own)?;
        let splat_color = splat.kernel(gpu, "splat_color", &[])?.bind(gpu, &own)?;
        let order = gpu.module("order", &[&shaders::order()])?;
        let list = order.kernel(gpu, "list", list_constants)?.bind(gpu, &own)?;
        let rank = order.kernel(gpu, "rank", &[])?.bind(gpu, &own)?;
        let copy = gpu.module("copy", &[&shaders::copy()])?.kernel(gpu, "copy", &[])?.bind(gpu, &own)?;
        let count = gpu.buffer_with("cells", Use::Storage, &[plan.cells() as u32])?;
        let [cells, sum] = ["cell_ends", "sum"].map(|name| named(&own, name));
        let scan_cells = Scan::new(gpu)?.bind(gpu, count.slice(), cells, sum)?;
        let side_output_buffer = match side_output {
            SideOutput::None => None,
            SideOutput::Innovation => {
                Some(gpu.buffer("innovation", Use::Storage, plan.innovation_bytes())?)
            }
            SideOutput::ExpectedErrors => {
                Some(gpu.buffer("block_errors", Use::Storage, plan.block_bytes())?)
            }
        };
        Ok(Self {
            gpu: gpu.clone(),
            side_output: side_output_buffer.map(|buffer| (side_output, buffer)),
            scale,
            uniform,
            buffers,
            remember: kernel("samples", shaders::samples(), "remember")?,
            predict: kernel("predict", shaders::predict(), "predict")?,
            find_ranges: kernel("rectification", shaders::rectification(), "find_ranges")?,
            splat_depth,
            splat_color,
            scan_cells,
            list,
            rank,
            copy,
            accumulate: kernel("tile", shaders::tile(&plan, side_output, kriging), "accumulate")?,
            krige: kriging
                .threshold()
                .map(|_| kernel("krige", shaders::krige(), "krige_marked"))
                .transpose()?,
            past: Vec::new(),
            blocks: BlockHistory::new(&plan),
            plan,
            pending: None,
            invalid: Some(ResetReason::FirstFrame),
        })
    }

    /// Drops the history. The next frame is reconstructed from its own samples alone.
    pub fn reset(&mut self, reason: ResetReason) {
        self.invalid = Some(reason);
    }

    /// The innovation of the last recorded frame ([`crate::SuperSampler::innovation`]), `[LR height, LR width, 4]` of
    /// f32, if it is computed.
    #[must_use]
    pub const fn innovation(&self) -> Option<&Buffer> {
        match &self.side_output {
            Some((SideOutput::Innovation, buffer)) => Some(buffer),
            _ => None,
        }
    }

    /// The errors expected of the last recorded frame ([`crate::SuperSampler::expected_errors`]), `[block rows, block
    /// columns]` of u32, if they are computed. [`super::GpuBlockSelector`] reads them.
    #[must_use]
    pub const fn expected_errors(&self) -> Option<&Buffer> {
        match &self.side_output {
            Some((SideOutput::ExpectedErrors, buffer)) => Some(buffer),
            _ => None,
        }
    }

    /// Why the next frame will have no history; none if it will have one.
    #[must_use]
    pub const fn history_invalid(&self) -> Option<ResetReason> {
        self.invalid
    }

    /// Binds the planes that frames are read from, and `out`, which they are written to. `padded` are the same frames
    /// with their margins; its rows lie as far apart as a frame with the widest margin is wide. Without margins, pass
    /// `planes` again.
    ///
    /// # Errors
    /// [`GpuReconstructError`] if `out` has another size, a plane is too small, or the device refuses.
    pub fn bind(
        &self,
        planes: &GpuPlanes<'_>,
        padded: &GpuPlanes<'_>,
        out: &GpuImage,
    ) -> Result<BoundSuperSampler, GpuReconstructError> {
        check_size("image", self.plan.size, out.size())?;
        planes.check(self.plan.lr)?;
        padded.check(self.plan.padded)?;
        let mut all = self.slices_with(planes);
        all.push(("image", out.pixels().slice()));
        all.extend(self.innovation().map(|buffer| ("innovation", buffer.slice())));
        all.extend(self.expected_errors().map(|buffer| ("block_errors", buffer.slice())));
        Ok(BoundSuperSampler {
            uniform: self.uniform.clone(),
            remember: self.remember.bind(&self.gpu, &self.slices_with(padded))?,
            predict: self.predict.bind(&self.gpu, &all)?,
            find_ranges: self.find_ranges.bind(&self.gpu, &all)?,
            accumulate: self.accumulate.bind(&self.gpu, &all)?,
            krige: self.krige.as_ref().map(|krige| krige.bind(&self.gpu, &all)).transpose()?,
        })
    }

    /// Records the reconstruction of the image of `camera` from the G-buffer that `bound` reads, and the history. The
    /// G-buffer is the LR frame of `camera`, sampled at `jitter`, with `margin` around it. At most once in a
    /// submission. [`Self::commit`] adds the frame to the history. A frame recorded again before the commit is
    /// replaced. `blocks` is the largest number of exact blocks that [`Self::record_blocks`] will remember; the oldest blocks
    /// give them their memory.
    ///
    /// # Errors
    /// [`GpuReconstructError`] if `bound` belongs to another super sampler, the size of `camera`, the jitter or the
    /// margin does not fit, or the device is lost. The history stays unchanged then.
    pub fn record(
        &mut self,
        recorder: &mut Recorder<'_>,
        bound: &BoundSuperSampler,
        camera: &Camera,
        jitter: [f32; 2],
        margin: Margin,
        blocks: u32,
    ) -> Result<(), GpuReconstructError> {
        if bound.uniform != self.uniform {
            return Err(other_bound("super sampling"));
        }
        check_size("camera", self.plan.size, camera.size())?;
        check_jitter(jitter)?;
        let (max, actual) = (self.plan.margin, margin.widest());
        if actual > max {
            return Err(ReconstructError::Margin { max, actual }.into());
        }
        let (all, history) = match self.invalid {
            Some(_) => (&[][..], &[][..]),
            None => (&self.past[..], self.fresh(camera)),
        };
        let slots = self.plan.frames;
        // When all slots are in use, the oldest frame is replaced. Forgotten frames keep their slots until the commit, because the
        // frame may be recorded again.
        let free = match all.last() {
            Some(oldest) if all.len() == slots as usize => oldest.slot,
            _ => first_free(all, slots),
        };
        let kept = &history[..history.len().min(slots as usize - 1)];
        let current = Past { camera: *camera, jitter, margin, slot: free, mean_inverse_depth: 0.0 };
        let mut uniform = self.uniform_of(&current, kept);
        let kept = self.invalid.is_none().then_some(kept.len());
        let layers = self.blocks.begin(blocks, camera, kept.map(|kept| kept as u32));
        uniform.layers = layers.len() as u32;
        for (to, (layer, frame, age)) in uniform.past[uniform.frames as usize..].iter_mut().zip(layers) {
            *to = PastUniform {
                first: self.plan.first_of_layer(layer),
                extent: self.plan.padded.to_array(),
                count: self.plan.layer_blocks * BLOCK_PIXELS,
                age,
                ..PastUniform::between(&frame, camera)
            };
        }
        recorder.write(&self.uniform.slice(), &[uniform])?;
        let sources = uniform.frames + uniform.layers;
        recorder.stage("super_sample.samples");
        recorder.dispatch(&bound.remember, self.plan.over_around);
        recorder.dispatch(&bound.predict, self.plan.over_samples);
        recorder.dispatch(&bound.find_ranges, self.plan.over_samples);
        recorder.stage("super_sample.splat");
        for (_, buffer) in self.buffers.iter().filter(|(name, _)| ["cell_ends", "nearest"].contains(name)) {
            recorder.clear(&buffer.slice());
        }
        if let Some((_, side_output)) = &self.side_output {
            recorder.clear(&side_output.slice());
        }
        let in_pre_pass = uniform.frames.div_ceil(EVERY as u32) + uniform.layers;
        recorder.dispatch(&self.splat_depth, self.plan.over_history(in_pre_pass));
        recorder.dispatch(&self.splat_color, self.plan.over_history(sources));
        recorder.stage("super_sample.order");
        self.scan_cells.record(recorder);
        recorder.dispatch(&self.list, self.plan.over_history(sources));
        recorder.dispatch(&self.rank, self.plan.over_history(sources));
        recorder.dispatch(&self.copy, self.plan.over_history(sources));
        recorder.stage("super_sample.tile");
        recorder.dispatch(&bound.accumulate, self.plan.over_tiles);
        if let Some(krige) = &bound.krige {
            recorder.stage("super_sample.krige");
            recorder.dispatch(krige, self.plan.over_kriged);
        }
        self.pending = Some(Pending { frame: current, kept });
        Ok(())
    }

    /// The past frames for a frame of `camera`, newest first. While layers of exact blocks are in use, frames are forgotten as on
    /// the CPU.
    fn fresh(&self, camera: &Camera) -> &[Past] {
        if !self.blocks.is_in_use() {
            return &self.past;
        }
        let past: Vec<_> = self.past.iter().map(|past| (past.camera, past.mean_inverse_depth)).collect();
        &self.past[..count_remembered(&past, camera, self.plan.frames as usize)]
    }

    /// Adds the frame recorded last to the history. The mean inverse depth ([`crate::DepthLattice::mean_inverse_depth`]) is of the
    /// frame's surfaces, per world unit; 0 if unknown. The depth tells how far the picture moves when the camera does.
    pub fn commit(&mut self, mean_inverse_depth: f32) {
        let Some(Pending { frame, kept }) = self.pending.take() else { return };
        // A reset since the frame was recorded is for the next frame.
        if kept.is_none() {
            self.invalid = None;
        }
        self.blocks.commit(&frame.camera, mean_inverse_depth, kept.map(|kept| kept as u32));
        self.past.truncate(kept.unwrap_or(0));
        // The frames of this history show one view: the depths of any tell of the others.
        for past in self.past.iter_mut().filter(|past| past.mean_inverse_depth == 0.0) {
            past.mean_inverse_depth = mean_inverse_depth;
        }
        self.past.insert(0, Past { mean_inverse_depth, ..frame });
    }

    /// The sampler's buffers and the buffers of `planes`, by the names in the kernels.
    fn slices_with<'a>(&'a self, planes: &GpuPlanes<'a>) -> Vec<(&'static str, Slice<'a>)> {
        let mut all = self.own_slices();
        all.push(("color_alpha", planes.color_alpha.slice()));
        all.push(("dx_median", planes.dx_median.slice()));
        all.push(("dy_expected", planes.dy_expected.slice()));
        all
    }

    /// The sampler's buffers, by the names in the kernels.
    pub(super) fn own_slices(&self) -> Vec<(&'static str, Slice<'_>)> {
        own_slices(&self.uniform, &self.buffers)
    }

    fn uniform_of(&self, current: &Past, kept: &[Past]) -> FrameUniform {
        let places = |jitter: f32| {
            let axis = SampleAxis::new(self.scale, jitter);
            let mut places = [[0.0; 4]; PHASES];
            for (to, place) in places.iter_mut().zip(axis.phases()) {
                *to = [place.index as f32, place.fraction, 0.0, 0.0];
            }
            places
        };
        let first_sampled = SampledPixels::new(current.jitter, self.scale);
        let first_sampled = first_sampled
            .map_or([u32::MAX; 2], |first_sampled| first_sampled.first.map(|first| first as u32));
        let mut past = [PastUniform::zeroed(); MAX_SOURCES];
        for ((age, to), frame) in (0..).zip(&mut past).zip([current].into_iter().chain(kept)) {
            let Margin { left, top, .. } = frame.margin;
            let samples = self.plan.padded.pixels() as u32;
            *to = PastUniform {
                offset: [frame.jitter[0] - left as f32, frame.jitter[1] - top as f32],
                first: frame.slot * samples,
                extent: frame.margin.padded(self.plan.lr).to_array(),
                count: samples,
                age,
                ..PastUniform::between(&frame.camera, &current.camera)
            };
        }
        FrameUniform {
            size: self.plan.size.to_array(),
            lr: self.plan.lr.to_array(),
            scale: self.scale,
            frames: kept.len() as u32 + 1,
            layers: 0,
            first_of_blocks: self.plan.first_of_layer(0),
            first_of_corners: self.plan.first_of_layer(self.plan.layers),
            _pad: 0,
            first_sampled,
            padded: self.plan.padded.to_array(),
            // Positions are given with pixel centres at whole numbers.
            cell_offset: current.jitter.map(|j| 0.5 / self.scale as f32 - 0.5 - j),
            x_places: places(current.jitter[0]),
            y_places: places(current.jitter[1]),
            past,
        }
    }
}

/// Further names of buffers: kernels that only read `nearest` or count in `cell_ends`, and what takes the memory of
/// `places` and `landed`, which are not needed any more once samples are in order.
const OTHER_NAMES: [(&str, &str); 4] = [
    ("nearest_found", "nearest"),
    ("cell_counts", "cell_ends"),
    ("ordered_b", "places"),
    ("ordered_c", "landed"),
];

/// The sampler's buffers, by the names in the kernels.
fn own_slices<'a>(
    uniform: &'a Buffer,
    buffers: &'a [(&'static str, Buffer)],
) -> Vec<(&'static str, Slice<'a>)> {
    let mut all: Vec<_> = buffers.iter().map(|(name, buffer)| (*name, buffer.slice())).collect();
    for (other, name) in OTHER_NAMES {
        all.push((other, named(&all, name)));
    }
    all.push(("frame", uniform.slice()));
    all
}

/// The buffer called `name`.
fn named<'a>(all: &[(&'static str, Slice<'a>)], name: &str) -> Slice<'a> {
    let found = all.iter().find(|(it, _)| *it == name);
    found.unwrap_or_else(|| unreachable!("the plan has a buffer {name}")).1
}

/// The first slot that no frame of `history` uses.
fn first_free(history: &[Past], slots: u32) -> u32 {
    (0..slots).find(|slot| history.iter().all(|past| past.slot != *slot)).unwrap_or(0)
}
