//! How far remembered samples have moved since they were taken, apart from the camera's motion.

use fearless_simd::{Simd, f32x16, prelude::*};

use crate::cpu::lanes::CHUNK;

/// The displacements of the samples of a chunk.
#[derive(Clone, Debug, Default)]
#[repr(align(64))]
pub(crate) struct Displacement {
    /// From the place where a sample was taken to its surface's current place, in world units.
    offset: [[f32; CHUNK]; 3],
    /// How far surfaces have moved at the places where the sample was seen, its own surface included, in HR pixels.
    /// By such a distance the sample may have become hidden or wrong, even if neither it nor the camera moves.
    surface_shift: [f32; CHUNK],
    /// Bit `i`: the surface of sample `i` has moved.
    movers: u16,
    /// Bit `i`: the place of sample `i` is unknown.
    lost: u16,
}

impl Displacement {
    /// World offsets, x, y and z.
    #[inline(always)]
    pub fn offsets<S: Simd>(&self, simd: S) -> [f32x16<S>; 3] {
        let [x, y, z] = &self.offset;
        [f32x16::load_array_ref(simd, x), f32x16::load_array_ref(simd, y), f32x16::load_array_ref(simd, z)]
    }

    /// How far surfaces have moved where the samples were seen, in HR pixels; ∞ for lost samples.
    #[inline(always)]
    pub fn surface_shift<S: Simd>(&self, simd: S) -> f32x16<S> {
        f32x16::load_array_ref(simd, &self.surface_shift)
    }

    /// Whether any sample's surface has moved.
    pub const fn has_movers(&self) -> bool {
        self.movers != 0
    }

    /// Whether the surface of sample `i` has moved.
    pub const fn is_mover(&self, i: usize) -> bool {
        self.movers >> i & 1 == 1
    }

    /// Whether the place of sample `i` is unknown.
    pub const fn is_lost(&self, i: usize) -> bool {
        self.lost >> i & 1 == 1
    }

    /// Marks the surface of sample `i` as moving, with an unchanged offset.
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

    /// Marks the place of sample `i` as unknown.
    pub fn lose(&mut self, i: usize) {
        self.lost |= 1 << i;
        self.surface_shift[i] = f32::INFINITY;
    }

    /// Adds `pixels` HR pixels of surface motion at the place of sample `i`.
    pub fn add_surface_shift(&mut self, i: usize, pixels: f32) {
        self.surface_shift[i] += pixels;
    }
}
