//! Displacements that pixels share because they move about alike.

use fearless_simd::{Simd, f32x16, prelude::*};

/// Pixels are gathered at once if their displacements differ by at most this many pixels, along x and along y. They
/// are moved by the middle of the displacements. The largest error is 5/16 px: 1/4 px of a rigid patch, or 3/16 px of a
/// rigid row and half of 1/4 px of its patch. In-between frames are as near to the truth as with 1/16 px, or up to
/// 0.06 dB nearer, on seven paths (docs/performance.md).
pub(crate) const RIGID: f32 = 0.5;

/// Pixels whose displacements differ by at least this many pixels have their own displacements. Between [`RIGID`] and
/// this value, displacements are interpolated between the shared one and the pixel's own one. Machines that round a
/// value to different sides of a limit then make nearly the same frames.
pub(crate) const LOOSE: f32 = 1.0;

/// The share of own displacements in those of pixels, by the range of the displacements along x and y: 0 up to
/// [`RIGID`], 1 from [`LOOSE`] on.
#[inline(always)]
pub(crate) fn looseness<S: Simd>(simd: S, [x, y]: [f32x16<S>; 2]) -> f32x16<S> {
    let ramp = ((x.max(y) - RIGID) * (1.0 / (LOOSE - RIGID))).max(0.0);
    // Ranges that are no numbers are not below the limit.
    (x.simd_lt(LOOSE) & y.simd_lt(LOOSE)).select(ramp, f32x16::splat(simd, 1.0))
}

/// The displacement of pixels with this share of their own one.
#[inline(always)]
pub(crate) fn toward<S: Simd>(shared: f32x16<S>, own: f32x16<S>, looseness: f32x16<S>) -> f32x16<S> {
    // What is wholly loose takes nothing of `shared`, which may not be finite.
    looseness.simd_lt(1.0).select((own - shared).mul_add(looseness, shared), own)
}

#[cfg(test)]
mod tests {
    use fearless_simd::dispatch;

    use super::*;

    #[test]
    fn displacements_become_the_pixels_own_gradually() {
        let half = 0.5 * (RIGID + LOOSE);
        for (range, expected) in [
            ([0.0, 0.0], 0.0),
            ([RIGID, 0.1], 0.0),
            ([0.1, half], 0.5),
            ([LOOSE, 0.0], 1.0),
            ([9.0, 9.0], 1.0),
        ] {
            let [loose, moved] = dispatch!(gs3_simd::level(), simd => {
                let splat = |v: f32| f32x16::splat(simd, v);
                let loose = looseness(simd, range.map(splat));
                [loose[0], toward(splat(3.0), splat(5.0), loose)[0]]
            });
            assert_eq!([loose, moved], [expected, 3.0 + 2.0 * expected], "{range:?}");
        }
    }

    #[test]
    fn displacements_that_are_no_numbers_are_not_shared() {
        for range in [[f32::NAN; 2], [f32::NAN, 0.0], [0.0, f32::NAN]] {
            let own = dispatch!(gs3_simd::level(), simd => {
                let splat = |v: f32| f32x16::splat(simd, v);
                let loose = looseness(simd, range.map(splat));
                [f32::NAN, f32::INFINITY].map(|shared| toward(splat(shared), splat(5.0), loose)[0])
            });
            assert_eq!(own, [5.0, 5.0], "{range:?}");
        }
    }
}
