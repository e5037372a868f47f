//! The choice of the blocks that are worth rasterizing exactly; see `cpu/select.rs`.

use bytemuck::{Pod, Zeroable};
use gs3_compute::{Bound, BoundSort, Buffer, Gpu, GpuError, Pairs, Recorder, Slice, Sort, Use, grid};
use gs3_scene::{BLOCK_SIDE, Size, block_grid};

use super::error::GpuReconstructError;
use super::shaders;
use crate::cpu::select::BlockBudget;
use crate::cpu::tile::PER_LAPLACIAN;

/// Invocations of the workgroups of `select.wgsl`.
pub const GROUP: u32 = 256;

/// Units of the sum of the squared corrections of a pixel, three numbers in `[0, 1]`: 2²⁴ make the least error of
/// the highest quality, half a step of 8 bits, 516 units a block. Rounding changes a block by at most 8 units.
pub const ERROR_UNITS: f32 = (1 << 24) as f32;

/// The largest sum of squared corrections of a pixel that counts: more than any picture has. The 16 pixels of a block then
/// sum to at most 2³⁰ units.
pub const LARGEST_ERROR: f32 = 4.0;

/// Bits of the keys of `select.wgsl`: one number more than 2³⁰ units.
const KEY_BITS: u32 = 31;

/// `Selection` of `select.wgsl`.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct Selection {
    blocks: u32,
    most: u32,
    least: u32,
    wants_all: u32,
}

impl Selection {
    fn new(blocks: u32, budget: BlockBudget) -> Self {
        let most = budget.blocks_of(blocks as usize) as u32;
        let numbers = (3 * BLOCK_SIDE * BLOCK_SIDE) as f32;
        let least = budget.least_error.max(0.0) * numbers / PER_LAPLACIAN * ERROR_UNITS;
        Self { blocks, most, least: least as u32, wants_all: u32::from(budget.least_error < 0.0) }
    }
}

/// Chooses blocks of 4×4 pixels on a device, by the rules of [`crate::select_blocks`]: the largest expected errors
/// first, and among equal errors the first in row order.
#[derive(Debug)]
pub struct GpuBlockSelector {
    size: Size,
    blocks: u32,
    uniform: Buffer,
    chosen: Buffer,
    chosen_count: Buffer,
    /// Numbers of all blocks, the chosen ones first.
    sorted: Buffer,
    rank: Bound,
    sort: BoundSort,
    choose: Bound,
    groups: [u32; 3],
}

impl GpuBlockSelector {
    /// A selector for pictures of `size` that reads `errors` of [`super::GpuSuperSampler::expected_errors`].
    ///
    /// # Errors
    /// [`GpuReconstructError`] if the device has too little memory.
    pub fn new(gpu: &Gpu, size: Size, errors: &Buffer) -> Result<Self, GpuReconstructError> {
        let [columns, rows] = block_grid(size).map(|count| count as u32);
        let blocks = columns * rows;
        let buffer = |name| gpu.buffer(name, Use::Storage, u64::from(blocks) * 4);
        let keys = [buffer("keys")?, buffer("keys")?];
        let numbers = [buffer("numbers")?, buffer("numbers")?];
        let (chosen, chosen_count) = (buffer("chosen")?, gpu.buffer("chosen_count", Use::Storage, 4)?);
        let uniform = gpu.buffer("selection", Use::Uniform, size_of::<Selection>() as u64)?;
        let count = gpu.buffer_with("blocks", Use::Storage, &[blocks])?;

        let sort = Sort::new(gpu, blocks, KEY_BITS)?;
        let sorted = sort.plan().result();
        let pairs = [0, 1].map(|k: usize| Pairs { keys: keys[k].slice(), values: numbers[k].slice() });
        let module = gpu.module("select", &[&shaders::select()])?;
        let bind = |entry: &str, k: usize| -> Result<Bound, GpuError> {
            let buffers: [(&'static str, Slice<'_>); 6] = [
                ("selection", uniform.slice()),
                ("block_errors", errors.slice()),
                ("keys", keys[k].slice()),
                ("numbers", numbers[k].slice()),
                ("chosen", chosen.slice()),
                ("chosen_count", chosen_count.slice()),
            ];
            module.kernel(gpu, entry, &[])?.bind(gpu, &buffers)
        };
        Ok(Self {
            size,
            blocks,
            rank: bind("rank", 0)?,
            sort: sort.bind(gpu, count.slice(), pairs)?,
            choose: bind("choose", sorted)?,
            groups: grid(blocks.div_ceil(GROUP))?,
            uniform,
            chosen,
            chosen_count,
            sorted: numbers[sorted].clone(),
        })
    }

    /// Records the choice of the blocks of the frame recorded last, within `budget`.
    ///
    /// # Errors
    /// [`GpuReconstructError`] if the device is lost.
    pub fn record(
        &self,
        recorder: &mut Recorder<'_>,
        budget: BlockBudget,
    ) -> Result<(), GpuReconstructError> {
        recorder.write(&self.uniform.slice(), &[Selection::new(self.blocks, budget)])?;
        recorder.stage("refine.select");
        recorder.clear(&self.chosen.slice());
        recorder.clear(&self.chosen_count.slice());
        recorder.dispatch(&self.rank, self.groups);
        self.sort.record(recorder);
        recorder.dispatch(&self.choose, self.groups);
        Ok(())
    }

    /// `[block rows, block columns]` of u32: the block's number among the chosen blocks, from 1 on, with the largest error
    /// first; 0 for the other blocks.
    #[must_use]
    pub const fn chosen(&self) -> &Buffer {
        &self.chosen
    }

    /// The number of chosen blocks, a u32.
    #[must_use]
    pub const fn chosen_count(&self) -> &Buffer {
        &self.chosen_count
    }

    /// The picture's size.
    pub(super) const fn size(&self) -> Size {
        self.size
    }

    /// Numbers of the picture's blocks, row by row, as u32: the chosen blocks come first, in the order of their errors.
    #[must_use]
    pub const fn sorted(&self) -> &Buffer {
        &self.sorted
    }

    /// The number of blocks of the picture.
    #[must_use]
    pub const fn blocks(&self) -> u32 {
        self.blocks
    }
}

#[cfg(test)]
mod tests {
    use gs3_compute::assert_layout;

    use super::*;

    #[test]
    fn layouts_are_those_of_the_shader() {
        let source = shaders::select();
        assert_layout!(&[&source], Selection, Selection { blocks, most, least, wants_all });
    }

    #[test]
    fn budgets_are_numbers_of_blocks_and_units() {
        let step = (0.5_f32 / 255.0).powi(2);
        let Selection { most, least, wants_all, .. } =
            Selection::new(1000, BlockBudget { most: 0.06, least_error: step });
        assert_eq!((most, least, wants_all), (60, 516, 0));
        let Selection { most, least, wants_all, .. } = Selection::new(1000, BlockBudget::ALL);
        assert_eq!((most, least, wants_all), (1000, 0, 1));
    }
}
