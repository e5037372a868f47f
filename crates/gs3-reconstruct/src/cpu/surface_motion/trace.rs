//! From a motion vector to a displacement in the world.

use glam::DVec2;
use gs3_scene::Camera;

use crate::cpu::samples::SampleFrame;
use crate::reprojection::{MIN_DIVISOR, Reprojection, SAME_SURFACE};

/// Surfaces whose vectors differ by less than this from what the cameras explain stand still, LR pixels: rounding is a
/// tenth of it, and over 16 frames even what moves just slower goes no farther than a quarter of an HR pixel at scale 4.
const STILL: f32 = 1.0 / 256.0;

/// The same as a share of the vector: what half precision, in which renderers keep vectors, rounds by at most.
const ROUNDING: f32 = 1.0 / 1024.0;

/// Surfaces may have come nearer by this share of their depth since the frame before, or gone as far away; depths there
/// that differ by more are another's.
const APPROACH: f32 = 0.1;

/// Vectors beyond this many frame widths or heights say that a surface was nowhere.
pub(super) const FARTHEST: f32 = 2.0;

/// Displacements have to be below this, world units, so that no sum of 64 of their squares overflows.
const LARGEST: f32 = 1e18;

/// A surface that was nowhere, or is infinitely far, disturbs what is seen in its place by this, HR pixels: as much as
/// makes the past count by what the current frame says of it alone.
const UNKNOWN: f32 = 8.0;

/// What one sample of the current frame says about the motion of its surface.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Surface {
    /// From where it was in the world to where it is, world units. 0 if it stands still.
    pub displacement: [f32; 3],
    /// How far it is from where it would be if it stood still, HR pixels; 0 if it does.
    pub residual: f32,
    /// Where it was in the frame before, HR pixels.
    pub origin: [f32; 2],
    /// Inverse depth now.
    pub inverse: f32,
    /// Inverse depth then; negative if it was nowhere.
    pub origin_inverse: f32,
}

impl Surface {
    pub fn is_still(&self) -> bool {
        self.residual == 0.0
    }
}

/// Whether inverse depths are those of one surface, whatever its slope.
pub(super) fn is_same(a: f32, b: f32) -> bool {
    (a - b).abs() <= SAME_SURFACE * a.max(b)
}

/// What vectors are followed with.
pub(super) struct Tracer<'a> {
    /// The one before, the current one.
    pub cameras: [&'a Camera; 2],
    /// From the current one to the one before.
    pub reprojection: Reprojection,
    pub before: &'a SampleFrame,
    pub scale: f32,
    /// The longest vectors, HR pixels.
    pub farthest: [f32; 2],
}

impl Tracer<'_> {
    /// Follows the vector of the sample at HR position `at` and inverse depth `inverse`, HR pixels.
    pub fn trace(&self, at: [f32; 2], inverse: f32, vector: [f32; 2]) -> Surface {
        let [u, v, q] = self.reprojection.apply(at, inverse);
        let origin = [at[0] + vector[0], at[1] + vector[1]];
        let is_ahead = q > MIN_DIVISOR;
        let residual = (origin[0] - u).hypot(origin[1] - v);
        let still = STILL * self.scale + ROUNDING * vector[0].hypot(vector[1]);
        if is_ahead && residual <= still {
            let origin_inverse = inverse / q;
            return Surface { inverse, origin: [u, v], origin_inverse, ..Surface::default() };
        }
        let nowhere = Surface { residual: UNKNOWN, inverse, origin_inverse: -1.0, ..Surface::default() };
        let is_far = vector.iter().zip(self.farthest).any(|(way, most)| way.abs() > most);
        // What is infinitely far has no displacement that could be told.
        if !is_ahead || is_far || inverse == 0.0 {
            return nowhere;
        }
        let expected = inverse / q;
        let origin_inverse = self.depth_before(origin, expected);
        let point = |camera: &Camera, [x, y]: [f32; 2], inverse: f32| {
            camera.unproject(DVec2::new(f64::from(x), f64::from(y)), 1.0 / f64::from(inverse))
        };
        let [before, now] = self.cameras;
        let displacement = point(now, at, inverse) - point(before, origin, origin_inverse);
        let displacement = displacement.to_array().map(|v| v as f32);
        if !displacement.iter().all(|v| v.abs() < LARGEST) {
            return nowhere;
        }
        Surface { displacement, residual, origin, inverse, origin_inverse }
    }

    /// The inverse depth that the frame before has at HR position `at`, of a surface that should be at about `expected`;
    /// that, where nothing like it is seen.
    fn depth_before(&self, at: [f32; 2], expected: f32) -> f32 {
        let [jx, jy] = self.before.offset();
        let place = [at[0] / self.scale - 0.5 - jx, at[1] / self.scale - 0.5 - jy];
        let last = [self.before.width, self.before.height].map(|side| side as f32 - 1.0);
        if place.iter().zip(last).any(|(place, last)| !(-0.5..=last + 0.5).contains(place)) {
            return expected;
        }
        let [x, y] = [0, 1].map(|axis| place[axis].max(0.0).min(last[axis]));
        let [i, j] = [x as usize, y as usize];
        let [right, below] = [(i + 1).min(self.before.width - 1), (j + 1).min(self.before.height - 1)];
        let (along_x, along_y) = (x - x.floor(), y - y.floor());
        let around = [
            (i, j, (1.0 - along_x) * (1.0 - along_y)),
            (right, j, along_x * (1.0 - along_y)),
            (i, below, (1.0 - along_x) * along_y),
            (right, below, along_x * along_y),
        ]
        .map(|(x, y, weight)| (self.before.inverse_depth(x, y), weight));
        let away = |inverse: f32| (inverse - expected).abs();
        let closest = around
            .iter()
            .map(|(inverse, _)| *inverse)
            .fold(f32::INFINITY, |a, b| if away(b) < away(a) { b } else { a });
        if away(closest) > APPROACH * expected {
            return expected;
        }
        let (mut sum, mut weights) = (0.0, 0.0);
        for (inverse, weight) in around {
            if is_same(inverse, closest) {
                (sum, weights) = (inverse.mul_add(weight, sum), weights + weight);
            }
        }
        if weights > 0.0 { sum / weights } else { closest }
    }
}
