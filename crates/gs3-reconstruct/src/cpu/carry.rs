//! Carries the history along with moving objects.
//!
//! Before a frame is remembered, every past sample at a place where something moved away is moved by its surface's
//! displacement in the world. A sample of a moving surface that is not found again is lost. Afterwards, samples at
//! places where something moves now no longer count as resting, even if they do not move: something may hide them.

use fearless_simd::{Level, dispatch, f32x16, prelude::*};

use crate::cpu::boxes::Boxes;
use crate::cpu::displacement::Displacement;
use crate::cpu::samples::{CHUNK, SampleFrame};
use crate::cpu::surface_motion::{Departure, SurfaceMotion};
use crate::reprojection::{MIN_DIVISOR, Reprojection};

/// Places of sixteen samples of a frame in another frame: HR positions, inverse depths, and which samples are valid.
struct ChunkPositions {
    x: [f32; CHUNK],
    y: [f32; CHUNK],
    inverse_depth: [f32; CHUNK],
    /// Bit `i`: sample `i` is in front of the camera.
    is_there: u64,
}

/// Reprojects chunk `chunk` of row `row`.
fn reproject(
    level: Level,
    frame: &SampleFrame,
    reprojection: &Reprojection,
    scale: f32,
    [row, chunk]: [usize; 2],
) -> ChunkPositions {
    dispatch!(level, simd => {
        let places = frame.places(simd, row, chunk, scale);
        let w = f32x16::load_array_ref(simd, frame.chunk(row, chunk).inverse_depth());
        let [x, y, q] = match frame.displacement(row, chunk) {
            None => reprojection.apply_16(simd, places.x, places.y, w),
            Some(displacement) => {
                reprojection.apply_moved_16(simd, places.x, places.y, w, displacement.offsets(simd))
            }
        };
        let is_there = places.is_sample & q.simd_gt(MIN_DIVISOR);
        ChunkPositions {
            x: x.to_array(),
            y: y.to_array(),
            inverse_depth: (w / q).to_array(),
            is_there: is_there.to_bitmask() & 0xffff,
        }
    })
}

impl ChunkPositions {
    /// The valid samples.
    fn samples(&self) -> impl Iterator<Item = usize> + use<'_> {
        (0..CHUNK).filter(|i| self.is_there >> i & 1 == 1)
    }
}

/// Moves the samples of the LR frame `frame` to the current places of their surfaces, according to `motion`.
/// `reprojection` gives the samples' places in the previous frame, and `boxes` contain them.
pub(crate) fn advance(
    level: Level,
    frame: &mut SampleFrame,
    reprojection: &Reprojection,
    boxes: &Boxes,
    scale: f32,
    motion: &SurfaceMotion,
) {
    for row in 0..frame.height {
        for chunk in 0..frame.chunks_per_row() {
            let has_movers = frame.displacement(row, chunk).is_some_and(Displacement::has_movers);
            let Some(limits) = boxes.limits(row, chunk) else { continue };
            if !has_movers && !motion.any_left(limits) {
                continue;
            }
            let seen = reproject(level, frame, reprojection, scale, [row, chunk]);
            for i in seen.samples() {
                let of = frame.displacement(row, chunk);
                if of.is_some_and(|displacement| displacement.is_lost(i)) {
                    continue;
                }
                let is_mover = of.is_some_and(|displacement| displacement.is_mover(i));
                let departure = motion.departure([seen.x[i], seen.y[i]], seen.inverse_depth[i], is_mover);
                let by = match departure {
                    Departure::Moved(by) => Some(by),
                    Departure::Unknown if is_mover => None,
                    // A surface that stood still and is hidden now has most likely stayed.
                    Departure::Unknown | Departure::Still => continue,
                };
                let Some(displacement) = frame.displacement_mut(row, chunk) else { continue };
                match by {
                    Some(by) => displacement.shift(i, by),
                    None => displacement.lose(i),
                }
            }
        }
    }
}

/// Adds the surfaces' shifts at the samples' places to the samples of the LR frame `frame`. `reprojection` gives the
/// samples' places in the current frame, and `boxes` contain them.
pub(crate) fn add_surface_shifts(
    level: Level,
    frame: &mut SampleFrame,
    reprojection: &Reprojection,
    boxes: &Boxes,
    scale: f32,
    motion: &SurfaceMotion,
) {
    for row in 0..frame.height {
        for chunk in 0..frame.chunks_per_row() {
            let Some(limits) = boxes.limits(row, chunk) else { continue };
            if !motion.any_here(limits) {
                continue;
            }
            let seen = reproject(level, frame, reprojection, scale, [row, chunk]);
            for i in seen.samples() {
                let surface_shift = motion.surface_shift([seen.x[i], seen.y[i]]);
                if surface_shift > 0.0
                    && let Some(displacement) = frame.displacement_mut(row, chunk)
                {
                    displacement.add_surface_shift(i, surface_shift);
                }
            }
        }
    }
}
