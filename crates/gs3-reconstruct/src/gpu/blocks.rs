//! Exact blocks in the history of a device; see `refine` in `cpu/super_sample.rs`.

use bytemuck::{Pod, Zeroable};
use gs3_compute::{Bound, Buffer, Recorder, Use, grid};
use gs3_scene::{BLOCK_SIDE, Camera};

use super::error::{GpuReconstructError, other_bound};
use super::plan::{BLOCK_PIXELS, SuperSamplePlan};
use super::select::{GROUP, GpuBlockSelector};
use super::shaders;
use super::super_sample::GpuSuperSampler;
use crate::error::check_size;
use crate::staleness::are_blocks_stale;

/// `Remembered` of `blocks.wgsl`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
struct Remembered {
    first: u32,
    count: u32,
    room: u32,
    columns: u32,
}

/// A layer with exact blocks of a frame.
#[derive(Clone, Copy, Debug)]
struct Layer {
    camera: Camera,
    /// Of the frame's surfaces, per world unit; 0 if unknown.
    mean_inverse_depth: f32,
    /// In frames.
    age: u32,
    /// Whether the frame recorded last has written over it.
    is_overwritten: bool,
}

impl Layer {
    /// Whether a frame of `camera` still remembers the layer. `oldest` is the age of the oldest LR frame that it remembers.
    fn is_fresh(&self, camera: &Camera, oldest: u32) -> bool {
        let Self { camera: then, mean_inverse_depth, age, is_overwritten } = self;
        !is_overwritten
            && *age <= oldest
            && !are_blocks_stale(*age as usize, then, *mean_inverse_depth, camera)
    }
}

/// Consecutive layers; after the last layer comes the first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Taken {
    first: u32,
    count: u32,
}

impl Taken {
    /// Whether `layer` is one of them, of `all` layers.
    const fn has(self, layer: u32, all: u32) -> bool {
        (layer + all - self.first) % all < self.count
    }
}

/// Which layers hold exact blocks of which frame. A frame with exact blocks takes the oldest layers.
#[derive(Debug)]
pub struct BlockHistory {
    layers: Vec<Option<Layer>>,
    layer_blocks: u32,
    /// The layer that the next frame begins with.
    next: u32,
    /// The layers for the blocks of the frame recorded last.
    pending: Option<Taken>,
    /// Whether these blocks were recorded.
    is_recorded: bool,
}

impl BlockHistory {
    pub fn new(plan: &SuperSamplePlan) -> Self {
        Self {
            layers: vec![None; plan.layers as usize],
            layer_blocks: plan.layer_blocks,
            next: 0,
            pending: None,
            is_recorded: false,
        }
    }

    /// Whether blocks of frames before the one recorded last were remembered. A layer is in use even if no block was chosen for it.
    pub fn is_in_use(&self) -> bool {
        self.layers.iter().any(Option::is_some)
    }

    /// Begins a frame of `camera` with at most `blocks` exact blocks. `oldest` is the age of the oldest LR frame that it remembers;
    /// none without history. Returns the layers that it remembers: number, camera of the blocks' frame, and age.
    pub fn begin(&mut self, blocks: u32, camera: &Camera, oldest: Option<u32>) -> Vec<(u32, Camera, u32)> {
        let all = self.layers.len() as u32;
        let count = blocks.div_ceil(self.layer_blocks.max(1)).min(all);
        // A part of a path has the same layers as the whole path: a history begins with the first layer.
        let taken = Taken { first: oldest.map_or(0, |_| self.next), count };
        (self.pending, self.is_recorded) = (Some(taken), false);
        let known = self.layers.iter().zip(0..).filter_map(|(layer, k)| {
            let layer = (*layer)?;
            let is_known = layer.is_fresh(camera, oldest?) && !taken.has(k, all);
            is_known.then_some((k, layer.camera, layer.age))
        });
        known.collect()
    }

    /// The blocks of the frame begun last are written into its layers: nothing else is remembered there any more.
    fn record(&mut self) {
        self.is_recorded = true;
        let all = self.layers.len() as u32;
        if let Some(taken) = self.pending {
            let layers = self.layers.iter_mut().zip(0..).filter(|(_, k)| taken.has(*k, all));
            layers.flat_map(|(layer, _)| layer).for_each(|layer| layer.is_overwritten = true);
        }
    }

    /// Adds the frame of `camera` that was begun last. `oldest` is the value that the frame was begun with. The mean inverse depth
    /// is of the frame's surfaces, per world unit; 0 if unknown.
    pub fn commit(&mut self, camera: &Camera, mean_inverse_depth: f32, oldest: Option<u32>) {
        if oldest.is_none() {
            self.next = 0;
        }
        for layer in &mut self.layers {
            *layer = layer.filter(|layer| oldest.is_some_and(|oldest| layer.is_fresh(camera, oldest)));
        }
        // The frames of this history show one view: the depths of any tell of the others.
        for layer in self.layers.iter_mut().flatten().filter(|layer| layer.mean_inverse_depth == 0.0) {
            layer.mean_inverse_depth = mean_inverse_depth;
        }
        let all = self.layers.len() as u32;
        if let Some(taken) = self.pending.take().filter(|taken| self.is_recorded && taken.count > 0) {
            let layers = self.layers.iter_mut().zip(0..).filter(|(_, k)| taken.has(*k, all));
            let newest = Layer { camera: *camera, mean_inverse_depth, age: 0, is_overwritten: false };
            layers.for_each(|(layer, _)| *layer = Some(newest));
            self.next = (taken.first + taken.count) % all;
        }
        self.layers.iter_mut().flatten().for_each(|layer| layer.age += 1);
    }
}

/// The kernel that remembers exact blocks, bound to their buffers.
#[derive(Clone, Debug)]
pub struct BoundBlocks {
    /// The uniform of the super sampler that made this binding.
    frame: Buffer,
    uniform: Buffer,
    remember: Bound,
    columns: u32,
}

impl GpuSuperSampler {
    /// Number of exact blocks that the history holds; 0 if it holds none ([`super::SideOutput`]).
    #[must_use]
    pub fn block_room(&self) -> u32 {
        self.plan.block_room()
    }

    /// Binds the exact blocks that `selector` chooses. `samples` holds, for [`Self::block_room`] of them or fewer, in the
    /// order of their numbers, three arrays of `[blocks, 16, 4]` f32: RGB, display-encoded, and median depth z, 0 for none;
    /// ∂RGB/∂x and 0; ∂RGB/∂y and 0, each per HR pixel.
    ///
    /// # Errors
    /// [`GpuReconstructError`] if `selector` is of another size, or the device refuses.
    pub fn bind_blocks(
        &self,
        selector: &GpuBlockSelector,
        samples: &Buffer,
    ) -> Result<BoundBlocks, GpuReconstructError> {
        check_size("exact blocks", self.plan.size, selector.size())?;
        let uniform = self.gpu.buffer("remembered", Use::Uniform, size_of::<Remembered>() as u64)?;
        let mut all = self.own_slices();
        all.push(("remembered", uniform.slice()));
        all.push(("exact_samples", samples.slice()));
        all.push(("numbers", selector.sorted().slice()));
        all.push(("chosen_count", selector.chosen_count().slice()));
        let module = self.gpu.module("blocks", &[&shaders::blocks()])?;
        let remember = module.kernel(&self.gpu, "remember_blocks", &[])?.bind(&self.gpu, &all)?;
        let columns = self.plan.size.width.div_ceil(BLOCK_SIDE as u32);
        Ok(BoundBlocks { frame: self.uniform.clone(), remember, columns, uniform })
    }

    /// Records that the exact blocks of the frame recorded last are remembered: the next frames reproject their samples.
    ///
    /// # Errors
    /// [`GpuReconstructError`] if `bound` belongs to another super sampler, or the device is lost.
    pub fn record_blocks(
        &mut self,
        recorder: &mut Recorder<'_>,
        bound: &BoundBlocks,
    ) -> Result<(), GpuReconstructError> {
        if bound.frame != self.uniform {
            return Err(other_bound("exact blocks"));
        }
        let Some(Taken { first, count }) = self.blocks.pending.filter(|taken| taken.count > 0) else {
            return Ok(());
        };
        let of_layers = |layers: u32| layers * self.plan.layer_blocks;
        let remembered = Remembered {
            first: of_layers(first),
            count: of_layers(count),
            room: self.plan.block_room(),
            columns: bound.columns,
        };
        recorder.write(&bound.uniform.slice(), &[remembered])?;
        recorder.stage("refine.remember");
        recorder.dispatch(&bound.remember, grid((remembered.count * BLOCK_PIXELS).div_ceil(GROUP))?);
        self.blocks.record();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use gs3_compute::{Limits, assert_layout};
    use gs3_scene::{Intrinsics, Size};

    use super::*;

    #[test]
    fn layouts_are_those_of_the_shader() {
        let source = shaders::blocks();
        assert_layout!(&[&source], Remembered, Remembered { first, count, room, columns });
    }

    /// Blocks stay until their layer is taken again or their frame is forgotten.
    #[test]
    fn layers_are_taken_in_turn() {
        let limits = Limits { buffer_bytes: 1 << 30, binding_bytes: 1 << 30, ..Limits::LEAST };
        let plan = SuperSamplePlan::new(&limits, Size::new(640, 384), 4, 0, true).expect("fits");
        assert_eq!((plan.layers, plan.layer_blocks), (4, 960));
        let camera =
            Camera::new(glam::DAffine3::IDENTITY, Intrinsics::from_fov_y(640, 384, 1.0)).expect("valid");
        let mut history = BlockHistory::new(&plan);
        // Six frames are remembered, the current one included.
        let frame = |history: &mut BlockHistory, blocks: u32, is_reset: bool, is_recorded: bool| {
            let oldest = (!is_reset).then_some(5);
            let known = history.begin(blocks, &camera, oldest);
            if is_recorded {
                history.record();
            }
            history.commit(&camera, 0.5, oldest);
            known.iter().map(|(layer, _, age)| [*layer, *age]).collect::<Vec<_>>()
        };
        // All blocks of a first frame: as many as there is room for.
        assert_eq!(frame(&mut history, 15_360, true, true), [[0; 2]; 0]);
        // The next frame has layer 0, and not yet the frame after it.
        assert_eq!(frame(&mut history, 922, false, true), [[1, 1], [2, 1], [3, 1]]);
        assert_eq!(frame(&mut history, 961, false, true), [[0, 1], [3, 2]]);
        assert_eq!(frame(&mut history, 0, false, true), [[0, 2], [1, 1], [2, 1], [3, 3]]);
        // A frame recorded again, and one that has no blocks in the end.
        assert_eq!(frame(&mut history, 1, false, false), [[0, 3], [1, 2], [2, 2]]);
        assert_eq!(frame(&mut history, 1, false, true), [[0, 4], [1, 3], [2, 3]]);
        assert_eq!(frame(&mut history, 0, false, true), [[0, 5], [1, 4], [2, 4], [3, 1]]);
        assert_eq!(frame(&mut history, 0, false, true), [[1, 5], [2, 5], [3, 2]]);
        // A reset forgets all, and begins with the first layer.
        assert_eq!(frame(&mut history, 10, true, true), [[0; 2]; 0]);
        assert_eq!(frame(&mut history, 0, false, true), [[0, 1]]);
        // A frame recorded again with fewer blocks: what was overwritten is not remembered as an older frame's.
        history.begin(2881, &camera, Some(5));
        history.record();
        assert!(history.begin(1, &camera, Some(5)).is_empty());
    }

    /// Blocks older than six frames are forgotten once the picture has moved. All blocks are forgotten with the LR frames of their
    /// age.
    #[test]
    fn blocks_are_forgotten_by_how_far_the_picture_has_moved() {
        let limits = Limits { buffer_bytes: 1 << 30, binding_bytes: 1 << 30, ..Limits::LEAST };
        let plan = SuperSamplePlan::new(&limits, Size::new(640, 384), 4, 0, true).expect("fits");
        let camera = |degrees: f64| {
            let pose = glam::DAffine3::from_rotation_y(degrees.to_radians());
            Camera::new(pose, Intrinsics::from_fov_y(640, 384, 1.0)).expect("valid")
        };
        // Whether the frame after frames at these `degrees` remembers blocks of the first.
        let is_known = |degrees: &[f64], next: f64, oldest: u32| {
            let mut history = BlockHistory::new(&plan);
            for (frame, camera) in degrees.iter().map(|degrees| camera(*degrees)).enumerate() {
                let oldest = (frame > 0).then_some(oldest);
                history.begin(u32::from(frame == 0), &camera, oldest);
                history.record();
                history.commit(&camera, 0.5, oldest);
            }
            !history.begin(0, &camera(next), Some(oldest)).is_empty()
        };
        let turning = [0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0, 16.0];
        assert!(
            [1, 6, 7, 15].map(|age| is_known(&[0.0; 15][..age], 0.0, 15)) == [true; 4],
            "at rest all stay"
        );
        assert_eq!(
            [1, 6, 7, 8].map(|age| is_known(&turning[..age], turning[age], 15)),
            [true, true, false, false]
        );
        assert!(!is_known(&turning[..8], 0.0, 15), "what is forgotten stays forgotten");
        assert_eq!([3, 4].map(|age| is_known(&[0.0; 15][..age], 0.0, 3)), [true, false]);
        // Frames of unknown depth get the depth of the next frame with a known depth. The camera walks a third of the depth
        // in seven steps.
        let walking = |depths: [f32; 7]| {
            let mut history = BlockHistory::new(&plan);
            let at = |frame: usize| {
                let pose = glam::DAffine3::from_translation(glam::DVec3::new(-0.1 * frame as f64, 0.0, 0.0));
                Camera::new(pose, Intrinsics::from_fov_y(640, 384, 1.0)).expect("valid")
            };
            for (frame, mean_inverse_depth) in depths.into_iter().enumerate() {
                let oldest = (frame > 0).then_some(15);
                history.begin(u32::from(frame == 0), &at(frame), oldest);
                history.record();
                history.commit(&at(frame), mean_inverse_depth, oldest);
            }
            !history.begin(0, &at(7), Some(15)).is_empty()
        };
        assert!(walking([0.0; 7]), "nothing is known");
        assert!(!walking([0.5; 7]) && !walking([0.0, 0.0, 0.5, 0.5, 0.5, 0.5, 0.5]));
        // A frame recorded again after its blocks have taken all layers counts the blocks before as in use.
        let (mut history, camera) = (BlockHistory::new(&plan), camera(0.0));
        for oldest in [None, Some(1)] {
            assert_eq!(history.is_in_use(), oldest.is_some());
            assert_eq!(history.begin(3840, &camera, oldest).len(), 0);
            history.record();
            assert_eq!(history.is_in_use(), oldest.is_some());
            history.begin(1, &camera, oldest);
            history.commit(&camera, 0.5, oldest);
            if oldest.is_none() {
                history.begin(1, &camera, oldest);
                history.record();
                history.commit(&camera, 0.5, oldest);
            }
        }
        assert!(!history.is_in_use(), "the blocks that were overwritten are forgotten");
    }
}
