//! The device memory of frames of one size, and the recording of each stage.

use gs3_compute::{Bound, Buffer, Gpu, Kernel, Readback, Recorder, Slice, Submission, Use, constants};
use gs3_raster::{
    EXACT_BLOCK_BYTES, GpuBlocks, GpuGBuffer, GpuRasterizer, LowResolution, Outputs, RasterSettings,
};
use gs3_reconstruct::gpu::{
    BoundBlocks, BoundInterpolator, BoundSuperSampler, GpuBlockSelector, GpuImage, GpuInterpolator,
    GpuNeighbor, GpuSuperSampler, NeighborView, SideOutput,
};
use gs3_reconstruct::{BlockBudget, DepthLattice};
use gs3_scene::{Camera, GBuffer, Margin, Size};

use super::super::inputs::{FrameInputs, Frames, ReadBack};
use super::super::plan::FramePlan;
use super::GpuPresented;
use super::places::{LATTICE_BYTES, Places, Told};
use crate::error::PipelineError;
use crate::learned::gpu::{GpuLearnedInterpolator, GpuLearnedSuperSampler, InBetween, Refined, planes};

/// Depths on the lattice: entry `sample_depths`.
fn depth_lattice_source() -> String {
    constants(&[("SIDE", DepthLattice::SIDE), ("DEPTHS", DepthLattice::LEN)])
        + include_str!("depth_lattice.wgsl")
}

/// One of the two frames in memory: the previous frame, or the frame being made.
struct Side {
    gbuffer: GpuGBuffer,
    image: GpuImage,
    /// Camera and jitter of the frame, once the frame is complete.
    view: Option<NeighborView>,
    /// The kernels that read and write this frame. They are bound once the G-buffer has its memory.
    bound: Option<BoundSide>,
    /// The exact blocks of this frame, once frames have some.
    blocks: Option<GpuBlocks>,
}

struct BoundSide {
    super_sampler: BoundSuperSampler,
    lattice: Bound,
}

/// The choice of exact blocks, and what the next frames remember of them.
struct Refinement {
    selector: GpuBlockSelector,
    samples: Buffer,
    remember: BoundBlocks,
}

impl Refinement {
    fn new(gpu: &Gpu, size: Size, super_sampler: &GpuSuperSampler) -> Result<Self, PipelineError> {
        let missing = PipelineError::Internal { expected: "a super sampler with expected errors" };
        let selector = GpuBlockSelector::new(gpu, size, super_sampler.expected_errors().ok_or(missing)?)?;
        // Pictures of a few pixels remember none.
        let bytes = u64::from(super_sampler.block_room().max(1)) * EXACT_BLOCK_BYTES;
        let samples = gpu.buffer("exact samples", Use::Storage, bytes)?;
        Ok(Self { remember: super_sampler.bind_blocks(&selector, &samples)?, selector, samples })
    }
}

/// All memory and kernels of frames of one size.
pub struct FrameMemory {
    gpu: Gpu,
    size: Size,
    super_sampler: GpuSuperSampler,
    learned_super_sampler: Option<GpuLearnedSuperSampler>,
    /// What exact blocks need, made by the first frame that has some.
    refinement: Option<Refinement>,
    interpolator: GpuInterpolator,
    learned_interpolator: Option<GpuLearnedInterpolator>,
    sides: [Side; 2],
    /// Index of the side that was made last.
    newest: usize,
    /// The LR frame being made with its margin, if frames have margins.
    padded: Option<GpuGBuffer>,
    /// The frame being made before a network refines it, if there is a network.
    analytic: Option<GpuImage>,
    /// The in-between frames.
    in_between: Vec<GpuImage>,
    /// How many in-between frames belong to the frame made last.
    in_between_made: usize,
    /// The interpolation into each in-between frame, indexed by the newer side.
    bound_in_between: [Vec<BoundInterpolator>; 2],
    sample_depths: Kernel,
    /// The depths of [`DepthLattice`], and the LR size that they are sampled from.
    lattice: Buffer,
    lattice_size: Buffer,
    readback: Readback,
    /// Counters and depths of frames that nobody waits for, in turn.
    late: [Readback; 2],
    places: Places,
}

impl FrameMemory {
    /// The memory in `slot` if it has the size of `camera`, else new memory put there. `counters` are the
    /// rasterizer's.
    pub fn fitting<'a>(
        slot: &'a mut Option<Self>,
        gpu: &Gpu,
        plan: &FramePlan,
        camera: &Camera,
        counters: &Slice<'_>,
    ) -> Result<&'a mut Self, PipelineError> {
        let size = camera.size();
        if slot.as_ref().is_some_and(|memory| memory.size != size) {
            *slot = None;
        }
        match slot {
            Some(memory) => Ok(memory),
            none => Ok(none.insert(Self::new(gpu, plan, size, counters.bytes())?)),
        }
    }

    /// Memory for frames of `size`. Each frame reads back `counters` bytes of the rasterizer's counters.
    fn new(gpu: &Gpu, plan: &FramePlan, size: Size, counters: u64) -> Result<Self, PipelineError> {
        let scale = plan.scale.at(size);
        let super_sample = &plan.networks.super_sample;
        let side_output =
            if super_sample.is_some() { SideOutput::Innovation } else { SideOutput::ExpectedErrors };
        // The super sampler comes first: it checks scale and size, and everything else depends on them.
        let super_sampler =
            GpuSuperSampler::new(gpu, scale, size, side_output, plan.kriging, plan.widest_margin)?;
        let side = || {
            let image = GpuImage::new(gpu, size)?;
            Ok::<_, PipelineError>(Side {
                gbuffer: GpuGBuffer::default(),
                image,
                view: None,
                bound: None,
                blocks: None,
            })
        };
        let sides = [side()?, side()?];
        let count = plan.most_in_between() as usize;
        let in_between = (0..count).map(|_| GpuImage::new(gpu, size)).collect::<Result<Vec<_>, _>>()?;
        let places = Places::new(counters, sides[0].image.bytes());
        let learned_super_sampler = |weights| GpuLearnedSuperSampler::new(gpu, weights, size, scale);
        let learned_interpolator = |weights| GpuLearnedInterpolator::new(gpu, weights, size, scale, count);
        let lr_size = size.map(|side| side.div_ceil(scale));
        let lattice = gpu.module("lattice", &[&depth_lattice_source()])?;
        Ok(Self {
            gpu: gpu.clone(),
            size,
            super_sampler,
            learned_super_sampler: super_sample.as_ref().map(learned_super_sampler).transpose()?,
            refinement: None,
            interpolator: GpuInterpolator::new(gpu, scale, size)?,
            learned_interpolator: plan.networks.interpolate.as_ref().map(learned_interpolator).transpose()?,
            sides,
            newest: 0,
            padded: (plan.widest_margin > 0).then(GpuGBuffer::default),
            analytic: super_sample.as_ref().map(|_| GpuImage::new(gpu, size)).transpose()?,
            in_between,
            in_between_made: 0,
            bound_in_between: [Vec::new(), Vec::new()],
            sample_depths: lattice.kernel(gpu, "sample_depths", &[])?,
            lattice: gpu.buffer("lattice", Use::Storage, LATTICE_BYTES)?,
            lattice_size: gpu.buffer_with("lattice size", Use::Uniform, &lr_size.to_array())?,
            readback: Readback::new(gpu, places.of_in_between(count))?,
            late: [Readback::new(gpu, places.image)?, Readback::new(gpu, places.image)?],
            places,
        })
    }

    /// Index of the side that the frame being made uses; the other side is the previous frame.
    const fn current(&self) -> usize {
        1 - self.newest
    }

    /// Camera and jitter of the previous frame, if the frame being made has a history.
    fn previous_view(&self, inputs: &FrameInputs) -> Option<NeighborView> {
        self.sides[self.newest].view.filter(|_| inputs.reset.is_none())
    }

    /// Records the G-buffer of the frame being made, which may have exact blocks.
    pub fn rasterize(
        &mut self,
        recorder: &mut Recorder<'_>,
        inputs: &FrameInputs,
        plan: &FramePlan,
        has_blocks: bool,
        rasterizer: &mut GpuRasterizer,
    ) -> Result<(), PipelineError> {
        let settings = plan.raster(Outputs::GBuffer, inputs);
        let frame = LowResolution { camera: &inputs.camera, scale: inputs.scale, has_blocks };
        let current = self.current();
        let gbuffer = &mut self.sides[current].gbuffer;
        match &mut self.padded {
            Some(padded) => rasterizer.record_padded(recorder, frame, &settings, padded, gbuffer)?,
            None => {
                let settings = RasterSettings { margin: Margin::NONE, ..settings };
                rasterizer.record_low_resolution(recorder, frame, &settings, gbuffer)?;
            }
        }
        Ok(())
    }

    /// Records the exact blocks of the frame being made, after super sampling without a network.
    pub fn refine(
        &mut self,
        recorder: &mut Recorder<'_>,
        budget: BlockBudget,
        rasterizer: &mut GpuRasterizer,
    ) -> Result<(), PipelineError> {
        let current = self.current();
        let Refinement { selector, samples, remember } = match &mut self.refinement {
            Some(refinement) => refinement,
            none => none.insert(Refinement::new(&self.gpu, self.size, &self.super_sampler)?),
        };
        selector.record(recorder, budget)?;
        let Side { image, blocks, .. } = &mut self.sides[current];
        let [chosen, image] = [selector.chosen(), image.pixels()];
        let new = || GpuBlocks::new(chosen.clone(), image.clone(), samples.clone());
        rasterizer.record_blocks(recorder, blocks.get_or_insert_with(new))?;
        Ok(self.super_sampler.record_blocks(recorder, remember)?)
    }

    /// Records super sampling of the frame being made, after the G-buffer has been rasterized. At most `blocks` exact blocks
    /// follow.
    pub fn super_sample(
        &mut self,
        recorder: &mut Recorder<'_>,
        inputs: &FrameInputs,
        blocks: u32,
    ) -> Result<(), PipelineError> {
        let (current, previous_view) = (self.current(), self.previous_view(inputs));
        if let Some(reason) = inputs.reset {
            self.super_sampler.reset(reason);
        }
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
                let lattice = self.sample_depths.bind(&self.gpu, &buffers)?;
                let made = self.analytic.as_ref().unwrap_or(&side.image);
                let padded = self.padded.as_ref().map_or(Ok(planes), self::planes)?;
                let super_sampler = self.super_sampler.bind(&planes, &padded, made)?;
                none.insert(BoundSide { super_sampler, lattice })
            }
        };
        let margin = if self.padded.is_some() { inputs.margin } else { Margin::NONE };
        let FrameInputs { camera, jitter, .. } = inputs;
        self.super_sampler.record(recorder, &bound.super_sampler, camera, *jitter, margin, blocks)?;
        recorder.dispatch(&bound.lattice, [1, 1, 1]);
        let (Some(learned), Some(analytic)) = (&mut self.learned_super_sampler, &self.analytic) else {
            return Ok(());
        };
        let places = self.sides.each_ref().map(|side| Refined { gbuffer: &side.gbuffer, image: &side.image });
        let stages = (&self.super_sampler, &self.interpolator);
        let view = view_of(inputs);
        learned.record(recorder, stages, analytic, places, current, &view, previous_view.as_ref())
    }

    /// Records the in-between frames of the previous frame and the one being made.
    pub fn interpolate(
        &mut self,
        recorder: &mut Recorder<'_>,
        inputs: &FrameInputs,
    ) -> Result<(), PipelineError> {
        let current = self.current();
        self.learned_interpolator.iter_mut().for_each(|learned| learned.begin(current));
        if inputs.moments.is_empty() {
            return Ok(());
        }
        let missing = PipelineError::Internal { expected: "a previous frame on the device" };
        // A keyframe has no history, but in-between frames lead to it.
        let views = [&self.sides[self.newest].view.ok_or(missing)?, &view_of(inputs)];
        let [before, after] = [&self.sides[self.newest], &self.sides[current]];
        let before = GpuNeighbor { image: &before.image, planes: planes(&before.gbuffer)? };
        let after = GpuNeighbor { image: &after.image, planes: planes(&after.gbuffer)? };
        let interpolator = &self.interpolator;
        if let Some(learned) = &mut self.learned_interpolator {
            for (k, (moment, out)) in inputs.moments.iter().zip(&self.in_between).enumerate() {
                let (t, camera) = (moment.t, &moment.camera);
                let frame = InBetween { interpolator, neighbors: [before, after], views, t, camera, out };
                learned.record(recorder, current, k, &frame)?;
            }
            return Ok(());
        }
        if self.bound_in_between[current].is_empty() {
            let bind = |out| interpolator.bind(&before, &after, out);
            self.bound_in_between[current] = self.in_between.iter().map(bind).collect::<Result<_, _>>()?;
        }
        for (moment, bound) in inputs.moments.iter().zip(&self.bound_in_between[current]) {
            interpolator.record(recorder, bound, views, moment.t, &moment.camera)?;
        }
        Ok(())
    }

    /// The frames' size.
    pub const fn size(&self) -> Size {
        self.size
    }

    /// Records the copies that `read_back` asks for, of a frame that may have exact blocks.
    pub fn record_read_back(
        &self,
        recorder: &mut Recorder<'_>,
        inputs: &FrameInputs,
        read_back: ReadBack,
        has_blocks: bool,
        counters: &Slice<'_>,
    ) {
        // The frame being made uses the readback of its side: the frame before the last one has been received.
        let readback = if read_back == ReadBack::Late { &self.late[self.current()] } else { &self.readback };
        recorder.read_back(counters, readback, 0);
        recorder.read_back(&self.lattice.part(0, LATTICE_BYTES), readback, self.places.lattice);
        if let Some(Refinement { selector, .. }) =
            self.refinement.as_ref().filter(|_| has_blocks && read_back != ReadBack::Late)
        {
            recorder.read_back(&selector.chosen_count().part(0, 4), readback, self.places.chosen);
        }
        if read_back != ReadBack::Images {
            return;
        }
        let mut read_image = |image: &GpuImage, place| {
            recorder.read_back(&image.pixels().part(0, image.bytes()), &self.readback, place);
        };
        read_image(&self.sides[self.current()].image, self.places.image);
        for (k, image) in self.in_between.iter().take(inputs.moments.len()).enumerate() {
            read_image(image, self.places.of_in_between(k));
        }
    }

    /// Index of the side that the last committed frame used.
    pub const fn newest(&self) -> usize {
        self.newest
    }

    /// Waits for the frame of `submission`, which was made on `side` and read back late. Returns nothing after an overflow:
    /// the frame is incomplete.
    pub async fn receive_late(
        &self,
        gpu: &Gpu,
        submission: &Submission,
        side: usize,
        rasterizer: &mut GpuRasterizer,
    ) -> Result<Option<Told>, PipelineError> {
        let told = self.late[side].read(gpu, submission, |bytes| self.places.told(bytes, rasterizer));
        told.await?
    }

    /// Waits for the frame of `submission` and receives the data read back; images, if they were read back, go into
    /// `frames`. Returns nothing after an overflow: the frame must be rendered again.
    pub async fn receive(
        &self,
        gpu: &Gpu,
        submission: &Submission,
        rasterizer: &mut GpuRasterizer,
        inputs: &FrameInputs,
        read_back: ReadBack,
        frames: &mut Frames,
    ) -> Result<Option<Told>, PipelineError> {
        let (image, in_between) = (&mut frames.current.image, &mut frames.in_between);
        let received = self.readback.read(gpu, submission, |bytes| -> Result<_, PipelineError> {
            let Some(told) = self.places.told(bytes, rasterizer)? else { return Ok(None) };
            if read_back == ReadBack::Images {
                let decoder = &self.sides[self.current()].image;
                decoder.decode(self.places.image_in(bytes), image);
                for (k, image) in in_between.iter_mut().take(inputs.moments.len()).enumerate() {
                    decoder.decode(self.places.in_between_in(bytes, k), image);
                }
            }
            Ok(Some(told))
        });
        received.await?
    }

    /// Makes the frame submitted last the previous frame of the next one. The mean inverse depth is of the frame's surfaces, per
    /// world unit; 0 if unknown.
    pub fn commit(&mut self, inputs: &FrameInputs, mean_inverse_depth: f32) {
        self.super_sampler.commit(mean_inverse_depth);
        self.newest = self.current();
        self.sides[self.newest].view = Some(view_of(inputs));
        self.in_between_made = inputs.moments.len();
    }

    /// Share of the picture's blocks that `chosen` blocks are.
    pub fn share_of(&self, chosen: u32) -> f32 {
        self.refinement.as_ref().map_or(0.0, |refinement| chosen as f32 / refinement.selector.blocks() as f32)
    }

    /// The frame committed last and its in-between frames.
    pub fn presented(&self) -> GpuPresented<'_> {
        let in_between = self.in_between.get(..self.in_between_made).unwrap_or_default();
        GpuPresented { in_between, current: &self.sides[self.newest].image }
    }

    /// Reads the LR G-buffer of the frame committed last.
    pub async fn read_gbuffer(&self, gpu: &Gpu, out: &mut GBuffer) -> Result<(), PipelineError> {
        Ok(self.sides[self.newest].gbuffer.read_async(gpu, out).await?)
    }
}

fn view_of(inputs: &FrameInputs) -> NeighborView {
    NeighborView { camera: inputs.camera, jitter: inputs.jitter }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shader_is_valid_and_its_numbers_are_explained() {
        gs3_compute::validate("lattice", &[&depth_lattice_source()]).unwrap();
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/src/frame/gpu");
        assert_eq!(gs3_test_support::check_literals(folder), 1);
    }
}
