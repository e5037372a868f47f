//! Sixteen samples as they lie in memory.

use fearless_simd::{Simd, f32x16, prelude::*};

use crate::cpu::lanes::CHUNK;

/// The values of one sample: RGB, ∂RGB/∂x and ∂RGB/∂y per HR pixel.
pub(crate) type Sample = [f32; 9];

/// Index of the first derivative in a sample.
pub(crate) const DX: usize = 3;
pub(crate) const DY: usize = 6;

/// Number of f32 values in all samples of a chunk.
const SAMPLES: usize = CHUNK * size_of::<Sample>() / size_of::<f32>();

/// [`CHUNK`] samples in a row. All values of these samples lie in consecutive cache lines. (In separate planes, one
/// chunk would lie on six pages, and super sampling would wait for their addresses.) Samples beyond the end of the
/// row are black and infinitely far.
///
/// First come the samples, then planes of the values that are read for all samples at once. Everything is one array,
/// so that loading four numbers is valid at the last three numbers of a sample.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct Chunk([f32; SAMPLES + 5 * CHUNK]);

impl Chunk {
    pub(super) const EMPTY: Self = Self([0.0; SAMPLES + 5 * CHUNK]);

    /// `1 / z` of the median depth; 0 where there is no surface, and for frames without geometry.
    #[inline(always)]
    pub fn inverse_depth(&self) -> &[f32; CHUNK] {
        self.plane(0)
    }

    /// Colour change, per HR pixel of parallax at depth 1, of a sample beside a nearer surface. Such a sample may contain
    /// part of the nearer surface's edge, which moves away from the sample. The value is the inverse depth of the nearest
    /// of the eight samples around the sample, less the sample's own, times [`CROSSING`](super::CROSSING) and the norm of
    /// all derivatives of the sample; 0 where no neighbour is nearer by [`EDGE_RATIO`](super::EDGE_RATIO). For a sample of an
    /// exact block, the neighbours are the block's samples around the sample and nine LR samples around the block's middle,
    /// and [`CROSSING_OF_BLOCKS`](super::CROSSING_OF_BLOCKS) is the factor.
    #[inline(always)]
    pub fn edge_slopes(&self) -> &[f32; CHUNK] {
        self.plane(1)
    }

    /// Red, green and blue again, as planes.
    #[inline(always)]
    pub fn colors(&self) -> [&[f32; CHUNK]; 3] {
        [self.plane(2), self.plane(3), self.plane(4)]
    }

    /// Sample `i`.
    #[inline(always)]
    pub fn sample(&self, i: usize) -> &Sample {
        &self.samples()[i]
    }

    /// RGB, ∂RGB/∂x and ∂RGB/∂y of sample `i`, each with an unspecified fourth number.
    #[inline(always)]
    pub fn quads(&self, i: usize) -> [&[f32]; 3] {
        let first = i * (SAMPLES / CHUNK);
        let numbers = &self.0[first..first + DY + 4];
        [&numbers[..4], &numbers[DX..DX + 4], &numbers[DY..]]
    }

    fn samples(&self) -> &[Sample] {
        self.0[..SAMPLES].as_chunks().0
    }

    #[inline(always)]
    fn plane(&self, k: usize) -> &[f32; CHUNK] {
        &self.0[SAMPLES..].as_chunks().0[k]
    }

    /// Writes plane `k`: [`Self::inverse_depth`], [`Self::edge_slopes`] or one of [`Self::colors`].
    #[inline(always)]
    pub(super) fn set_plane<S: Simd>(&mut self, k: usize, values: f32x16<S>) {
        values.store_array(&mut self.0[SAMPLES..].as_chunks_mut().0[k]);
    }

    /// Writes number `k` of every sample.
    #[inline(always)]
    pub(super) fn set_samples<S: Simd>(&mut self, k: usize, values: f32x16<S>) {
        let samples: &mut [Sample] = self.0[..SAMPLES].as_chunks_mut().0;
        samples.iter_mut().zip(values.to_array()).for_each(|(sample, value)| sample[k] = value);
    }
}

/// Values that the samples of a chunk share.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Extent {
    /// Smallest inverse depth.
    pub far: f32,
    /// Largest inverse depth.
    pub near: f32,
    /// The colour of all samples, if there is no surface and the colour is constant.
    pub bare: Option<[f32; 3]>,
}
