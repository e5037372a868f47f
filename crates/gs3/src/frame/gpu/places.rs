//! What a frame reads back: where the parts lie, and what they tell.

use gs3_raster::{CapacityCheck, GpuRasterizer};
use gs3_reconstruct::DepthLattice;

use crate::error::PipelineError;

/// Bytes of [`DepthLattice`].
pub const LATTICE_BYTES: u64 = (DepthLattice::LEN * 4) as u64;

/// What a frame tells the CPU besides its images.
#[derive(Clone, Copy, Debug)]
pub struct Told {
    pub lattice: DepthLattice,
    /// Number of blocks chosen by the last frame with exact blocks.
    pub chosen: u32,
}

/// Byte offsets in the read-back buffer: the rasterizer's counters, the lattice, the number of chosen blocks, the frame, the
/// in-between frames.
#[derive(Clone, Copy, Debug)]
pub struct Places {
    pub lattice: u64,
    pub chosen: u64,
    pub image: u64,
    in_between: u64,
}

impl Places {
    pub fn new(counters: u64, image: u64) -> Self {
        let lattice = counters.next_multiple_of(4);
        let chosen = lattice + LATTICE_BYTES;
        let first = chosen + 4;
        Self { lattice, chosen, image: first, in_between: first + image }
    }

    /// What the frame of `bytes` tells; nothing after an overflow of the rasterizer's buffers.
    pub fn told(&self, bytes: &[u8], rasterizer: &mut GpuRasterizer) -> Result<Option<Told>, PipelineError> {
        let check = rasterizer.check_capacity_with(self.counters_in(bytes))?;
        let told = Told { lattice: self.lattice_in(bytes), chosen: self.chosen_in(bytes) };
        Ok((check != CapacityCheck::Grown).then_some(told))
    }

    /// The rasterizer's counters in `bytes`.
    fn counters_in<'a>(&self, bytes: &'a [u8]) -> &'a [u8] {
        part(bytes, 0, self.lattice)
    }

    /// The depths for the CPU in `bytes`.
    fn lattice_in(&self, bytes: &[u8]) -> DepthLattice {
        let mut depths = [0.0; DepthLattice::LEN];
        let found = part(bytes, self.lattice, self.chosen).as_chunks().0;
        depths.iter_mut().zip(found).for_each(|(to, depth)| *to = f32::from_le_bytes(*depth));
        DepthLattice::new(depths)
    }

    /// The number of chosen blocks in `bytes`.
    fn chosen_in(&self, bytes: &[u8]) -> u32 {
        part(bytes, self.chosen, self.image).first_chunk().map_or(0, |count| u32::from_le_bytes(*count))
    }

    /// The frame in `bytes`.
    pub fn image_in<'a>(&self, bytes: &'a [u8]) -> &'a [u8] {
        part(bytes, self.image, self.in_between)
    }

    /// The `k`-th in-between frame in `bytes`.
    pub fn in_between_in<'a>(&self, bytes: &'a [u8], k: usize) -> &'a [u8] {
        part(bytes, self.of_in_between(k), self.of_in_between(k + 1))
    }

    pub fn of_in_between(&self, k: usize) -> u64 {
        self.in_between + k as u64 * (self.in_between - self.image)
    }
}

fn part(bytes: &[u8], start: u64, end: u64) -> &[u8] {
    bytes.get(start as usize..end as usize).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_read_back_lies_apart() {
        let places = Places::new(18, 800);
        let bytes: Vec<u8> = (0..20 + 100 + 4 + 3 * 800).map(|k| (k % 251) as u8).collect();
        assert_eq!(places.counters_in(&bytes), &bytes[..20]);
        assert_eq!(
            places.lattice_in(&bytes).depths()[1],
            f32::from_le_bytes(bytes[24..28].try_into().unwrap())
        );
        assert_eq!(places.chosen_in(&bytes), u32::from_le_bytes(bytes[120..124].try_into().unwrap()));
        assert_eq!(places.image_in(&bytes), &bytes[124..924]);
        assert_eq!(places.in_between_in(&bytes, 1), &bytes[1724..2524]);
        assert_eq!(places.of_in_between(2), bytes.len() as u64);
    }
}
