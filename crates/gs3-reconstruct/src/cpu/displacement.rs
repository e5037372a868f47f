//! How far remembered samples have moved since they were taken, where that is not the camera's doing.

use fearless_simd::{Simd, f32x16, prelude::*};

use crate::cpu::lanes::CHUNK;

/// What has become of the samples of a chunk.
#[derive(Clone, Debug, Default)]
#[repr(align(64))]
pub(crate) struct Displacement {
    /// From where a sample was taken to where its surface is now, world units.
    offset: [[f32; CHUNK]; 3],
    /// How far surfaces have moved at the places where the sample was seen, its own included, HR pixels: so far it may
    /// have become hidden, or contradicted, though neither it nor the camera moves.
    surface_shift: [f32; CHUNK],
    /// Bit `i`: the surface of sample `i` has moved.
    movers: u16,
    /// Bit `i`: nobody knows where sample `i` went.
    lost: u16,
}

impl Displacement {
    /// World offsets, x, y and z.
    #[inline(always)]
    pub fn offsets<S: Simd>(&self, simd: S) -> [f32x16<S>; 3] {
        let [x, y, z] = &self.offset;
        [f32x16::load_array_ref(simd, x), f32x16::load_array_ref(simd, y), f32x16::load_array_ref(simd, z)]
    }

    /// How far surfaces have moved where the samples were seen, HR pixels; ∞ for samples that are lost.
    #[inline(always)]
    pub fn surface_shift<S: Simd>(&self, simd: S) -> f32x16<S> {
        f32x16::load_array_ref(simd, &self.surface_shift)
    }

    /// Whether any sample is of a surface that has moved.
    pub const fn has_movers(&self) -> bool {
        self.movers != 0
    }

    /// Whether the surface of sample `i` has moved.
    pub const fn is_mover(&self, i: usize) -> bool {
        self.movers >> i & 1 == 1
    }

    /// Whether nobody knows where sample `i` went.
    pub const fn is_lost(&self, i: usize) -> bool {
        self.lost >> i & 1 == 1
    }

    /// Tells that the surface of sample `i` moves, wherever it goes.
    pub const fn mark(&mut self, i: usize) {
        self.movers |= 1 << i;
    }

    /// Moves the surface of sample `i` by `by`, world units.
    pub fn shift(&mut self, i: usize, by: [f32; 3]) {
        self.mark(i);
        for (offset, by) in self.offset.iter_mut().zip(by) {
            offset[i] += by;
        }
    }

    /// Tells that nobody knows where sample `i` went.
    pub fn lose(&mut self, i: usize) {
        self.lost |= 1 << i;
        self.surface_shift[i] = f32::INFINITY;
    }

    /// Tells that surfaces moved by `pixels` HR pixels where sample `i` is seen.
    pub fn add_surface_shift(&mut self, i: usize, pixels: f32) {
        self.surface_shift[i] += pixels;
    }
}
