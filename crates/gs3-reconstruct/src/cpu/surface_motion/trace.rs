//! From a motion vector to a displacement in the world.

use glam::DVec2;
use gs3_scene::Camera;

use crate::cpu::samples::SampleFrame;
use crate::reprojection::{MIN_DIVISOR, Reprojection, SAME_SURFACE};

/// A surface stands still if its vector differs by less than this from the cameras' motion, in LR pixels. Rounding is
/// a tenth of this value. Over 16 frames, a surface that moves just slower goes at most a quarter of an HR pixel at
/// scale 4.
const STILL: f32 = 1.0 / 256.0;

/// The same tolerance as a share of the vector: the largest rounding error of half precision, in which renderers keep
/// vectors.
const ROUNDING: f32 = 1.0 / 1024.0;

/// Largest change of a surface's depth since the previous frame, as a share of the depth. Depths that differ by more
/// belong to another surface.
const APPROACH: f32 = 0.1;

/// A vector longer than this many frame widths or heights means that the surface was nowhere in the previous frame.
pub(super) const FARTHEST: f32 = 2.0;

/// Displacements must be below this value, in world units, so that no sum of 64 of their squares overflows.
const LARGEST: f32 = 1e18;

/// Surface shift, in HR pixels, where a surface was nowhere or is infinitely far: enough that past samples count only
/// as far as the current frame confirms them.
const UNKNOWN: f32 = 8.0;

/// The motion of the surface of one sample of the current frame.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Surface {
    /// Displacement in the world from its previous place to its current place, world units. 0 if it stands still.
    pub displacement: [f32; 3],
    /// Distance from where it would be if it stood still, in HR pixels; 0 if it stands still.
    pub residual: f32,
    /// Its place in the previous frame, HR pixels.
    pub origin: [f32; 2],
    /// Current inverse depth.
    pub inverse: f32,
    /// Previous inverse depth; negative if the surface was nowhere.
    pub origin_inverse: f32,
}

impl Surface {
    pub fn is_still(&self) -> bool {
        self.residual == 0.0
    }
}

/// Whether two inverse depths are on one surface, at any slope.
pub(super) fn is_same(a: f32, b: f32) -> bool {
    (a - b).abs() <= SAME_SURFACE * a.max(b)
}

/// The inputs for tracing vectors.
pub(super) struct Tracer<'a> {
    /// The previous camera and the current camera.
    pub cameras: [&'a Camera; 2],
    /// From the current camera to the previous camera.
    pub reprojection: Reprojection,
    pub before: &'a SampleFrame,
    pub scale: f32,
    /// The longest vectors, HR pixels.
    pub farthest: [f32; 2],
}

impl Tracer<'_> {
    /// Traces the vector `vector` of the sample at HR position `at` with inverse depth `inverse`. Positions and
    /// vectors are in HR pixels.
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
        // An infinitely far surface has no finite displacement.
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

    /// The inverse depth in the previous frame at HR position `at`, of a surface expected at about `expected`.
    /// Returns `expected` if there is no similar depth.
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
