//! The jitter of each frame, chosen from the samples of the frames before it.
//!
//! A fixed order of offsets spreads samples well only while the camera rests. In motion, the samples of the last
//! frames move with the surfaces. At some speeds, samples meet the same points of a surface frame after frame, in any
//! fixed order: motion and jitter resonate. But the current places of the past samples are known. So each frame is
//! sampled where past samples are missing: a greedy search for points of low energy (void and cluster, Ulichney 1993)
//! on the torus of an LR pixel.

use std::collections::VecDeque;

use glam::DVec2;
use gs3_scene::{Camera, Jitter};

use crate::depth_lattice::{DepthLattice, SKY};

/// Where LR frames are sampled within their pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sampling {
    /// At offsets of the exact S×S grid. Each frame is sampled where the frames before it were not
    /// ([`AdaptiveJitter`]). After S² frames a resting camera has sampled every HR pixel.
    #[default]
    Jittered,
    /// Always at pixel centres.
    Centered,
}

impl Sampling {
    /// The name in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Jittered => "jittered",
            Self::Centered => "centered",
        }
    }
}

/// σ of the Gaussian by which the energy of two samples falls with their distance, in HR pixels. (Empirical: on paths
/// through captured scenes, gains from 0.5 to 1.3 lie within 0.1 dB of each other; from 0.7 on, the slowest motions
/// leave places of the grid out.)
const SIGMA: f64 = 0.65;

/// Weight of a moved sample of age `a` frames: `1 / (1 + AGING a)`. (Empirical; 0 and 0.6 lose 0.04 dB.)
const AGING: f64 = 0.15;

/// Mean energies that differ by less than this count as equal, so that rounding does not decide.
const EQUAL: f64 = 1e-6;

/// Chooses the jitter of each frame from the offsets of the exact S×S grid ([`Jitter::grid`]), in LR pixels, so that
/// the frame samples what the last frames did not. A resting camera samples every HR pixel once in S² frames. A
/// first frame has the grid's first offset.
///
/// The same cameras and depths always give the same offsets.
#[derive(Clone, Debug)]
pub struct AdaptiveJitter {
    /// HR pixels between the samples of a frame.
    scale: f64,
    offsets: Jitter,
    /// The newest S² − 1 frames, newest first, whether or not the history has forgotten some of them.
    past: VecDeque<(Camera, [f32; 2])>,
}

impl AdaptiveJitter {
    /// Jitter for frames `scale` times coarser than the frames shown; always pixel centres if `sampling` says so.
    #[must_use]
    pub fn new(scale: u32, sampling: Sampling) -> Self {
        let offsets = match sampling {
            Sampling::Jittered => Jitter::grid(scale),
            Sampling::Centered => Jitter::none(),
        };
        Self { scale: f64::from(scale), offsets, past: VecDeque::new() }
    }

    /// Number of different offsets, S² or 1. A resting camera repeats the offsets after this number of frames.
    #[must_use]
    pub fn period(&self) -> usize {
        self.offsets.period()
    }

    /// Forgets earlier frames.
    pub fn reset(&mut self) {
        self.past.clear();
    }

    /// The offset `[x, y]` for the frame of `camera`, in LR pixels from the pixel centre. The frame counts as sampled
    /// there. `last` are depths of the previous frame; they are not read after a reset.
    pub fn next(&mut self, camera: &Camera, last: &DepthLattice) -> [f32; 2] {
        let offset = self.choose(camera, last);
        self.remember(camera, offset);
        offset
    }

    /// Remembers that the frame of `camera` was sampled at `offset`.
    pub fn remember(&mut self, camera: &Camera, offset: [f32; 2]) {
        self.past.truncate(self.period().saturating_sub(2));
        if self.period() > 1 {
            self.past.push_front((*camera, offset));
        }
    }

    /// The offset of the first frame, and of the first frame after a reset.
    #[must_use]
    pub fn first(&self) -> [f32; 2] {
        self.offsets.offset(0)
    }

    /// As [`Self::next`], without recording the frame: the offset of least energy, and among equals the first in the
    /// grid's order.
    #[must_use]
    pub fn choose(&self, camera: &Camera, last: &DepthLattice) -> [f32; 2] {
        let energies = self.energies(camera, last);
        // A resting camera must not repeat an offset, so that the grid becomes complete and every pixel exact. (In
        // all tests the energies alone ensure this; the check is the guarantee.)
        let is_taken = |offset| self.past.iter().any(|past| *past == (*camera, offset));
        let mut best: Option<(f64, [f32; 2])> = None;
        for (frame, energy) in energies.into_iter().enumerate() {
            let offset = self.offsets.offset(frame as u64);
            if !is_taken(offset) && best.is_none_or(|(least, _)| energy < least - EQUAL) {
                best = Some((energy, offset));
            }
        }
        best.map_or([0.0; 2], |(_, offset)| offset)
    }

    /// For each offset, the energy of its samples of `camera` with the remembered samples: the mean over the points
    /// of the previous frame that are in view. If no point shows a surface, points at infinity are used.
    fn energies(&self, camera: &Camera, last: &DepthLattice) -> Vec<f64> {
        let mut energies = vec![0.0; self.period()];
        let Some((last_camera, _)) = self.past.front() else { return energies };
        let size = |camera: &Camera| DVec2::new(f64::from(camera.width()), f64::from(camera.height()));
        let hit_nothing = last.points().all(|(_, depth)| depth <= 0.0);
        let mut count = 0.0;
        for (at, depth) in last.points().filter(|(_, depth)| *depth > 0.0 || hit_nothing) {
            let point = last_camera.unproject(at * size(last_camera), if hit_nothing { SKY } else { depth });
            let (now, depth) = camera.project(point);
            let is_in_view = now.cmpge(DVec2::ZERO).all() && now.cmple(size(camera)).all();
            if depth <= 0.0 || !is_in_view {
                continue;
            }
            count += 1.0;
            for (age, (past, offset)) in (1..).zip(&self.past) {
                let (then, depth) = past.project(point);
                if depth <= 0.0 {
                    continue;
                }
                // A sample that does not move stays exact at any age.
                let moved = then.distance_squared(now);
                let worth = 1.0 / (1.0 + AGING * f64::from(age) * moved / (moved + 1.0));
                let sample = self.sample(*offset) - then;
                for (frame, energy) in energies.iter_mut().enumerate() {
                    let candidate = self.sample(self.offsets.offset(frame as u64)) - now;
                    let apart = (candidate - sample) / self.scale;
                    let apart = (apart - apart.round()) * self.scale;
                    *energy += worth * (-apart.length_squared() / (2.0 * SIGMA * SIGMA)).exp();
                }
            }
        }
        energies.iter_mut().for_each(|energy| *energy /= f64::max(count, 1.0));
        energies
    }

    /// HR position of the sample at `offset` of the first LR pixel.
    fn sample(&self, offset: [f32; 2]) -> DVec2 {
        (DVec2::from(offset.map(f64::from)) + 0.5) * self.scale
    }
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DQuat, DVec3};
    use gs3_scene::Intrinsics;

    use super::*;

    /// A camera at x before a wall at z = 4, where a step of 1 is 200 pixels.
    fn camera(x: f64) -> Camera {
        let intrinsics = Intrinsics::from_fov_y(1600, 800, 2.0 * (400.0_f64 / 800.0).atan());
        Camera::new(DAffine3::from_translation(DVec3::new(-x, 0.0, 0.0)), intrinsics).unwrap()
    }

    const WALL: DepthLattice = DepthLattice([4.0; DepthLattice::LEN]);

    fn cell(scale: u32, offset: [f32; 2]) -> usize {
        let s = scale as f32;
        let [a, b] = offset.map(|v| (v * s + (s - 1.0) / 2.0).round() as usize);
        a + scale as usize * b
    }

    #[test]
    fn whatever_came_before_a_resting_camera_sees_every_pixel_once() {
        for scale in 1..=4 {
            let count = (scale * scale) as usize;
            // Steps of a fraction of a pixel and of whole pixels; after such steps moving samples crowd at some
            // places.
            for (moving, step) in [(0, 0.0), (1, 0.003), (7, 0.0012), (16, 0.005), (40, 0.02), (40, 0.0003)] {
                for depths in [WALL, DepthLattice::default()] {
                    let mut jitter = AdaptiveJitter::new(scale, Sampling::Jittered);
                    for k in 0..moving {
                        _ = jitter.next(&camera(step * f64::from(k) + 1e-3), &depths);
                    }
                    let mut seen = vec![0; count];
                    for _ in 0..3 * count {
                        seen[cell(scale, jitter.next(&camera(0.0), &depths))] += 1;
                    }
                    assert_eq!(seen, vec![3; count], "scale {scale} after {moving} frames");
                }
            }
        }
    }

    /// Largest distance in HR pixels from a place of the wall (on a grid of places) to the nearest sample of the last
    /// S² frames.
    fn largest_gap(path: &[(f64, [f32; 2])], scale: u32) -> f64 {
        let s = f64::from(scale);
        let mut largest = 0.0_f64;
        for place in 0..32 * 32 {
            let place = DVec2::new(f64::from(place % 32), f64::from(place / 32)) * s / 32.0;
            let mut nearest = f64::INFINITY;
            for (x, offset) in path.iter().rev().take((scale * scale) as usize) {
                // Samples move with the wall.
                let sample = (DVec2::from(offset.map(f64::from)) + 0.5) * s + DVec2::new(x * 200.0, 0.0);
                let apart = (sample - place) / s;
                nearest = nearest.min(((apart - apart.round()) * s).length());
            }
            largest = largest.max(nearest);
        }
        largest
    }

    #[test]
    fn samples_stay_spread_at_speeds_that_resonate_with_a_fixed_order() {
        let (mut fixed_worst, mut worst) = (0.0_f64, 0.0_f64);
        for speed in 0..20 {
            let speed = 0.05 + 0.2 * f64::from(speed);
            let mut jitter = AdaptiveJitter::new(4, Sampling::Jittered);
            let (mut adaptive, mut fixed) = (Vec::new(), Vec::new());
            for frame in 0..48 {
                let x = f64::from(frame) * speed / 200.0;
                adaptive.push((x, jitter.next(&camera(x), &WALL)));
                fixed.push((x, Jitter::grid(4).offset(frame as u64)));
            }
            fixed_worst = fixed_worst.max(largest_gap(&fixed, 4));
            worst = worst.max(largest_gap(&adaptive, 4));
        }
        // At best, sixteen samples of a 4×4 block leave gaps of √½ = 0.71 pixels.
        assert!(fixed_worst > 1.3, "{fixed_worst}");
        assert!(worst < 1.1, "{worst}");
    }

    #[test]
    fn where_nothing_was_hit_directions_count() {
        // Turning moves all points alike, at any depth.
        let offsets = |depths| -> Vec<_> {
            let mut jitter = AdaptiveJitter::new(4, Sampling::Jittered);
            let turned = |k: u32| DAffine3::from_quat(DQuat::from_rotation_y(0.003 * f64::from(k)));
            let camera = |k| Camera::new(turned(k), camera(0.0).intrinsics()).unwrap();
            (0..40).map(|k| jitter.next(&camera(k), &depths)).collect()
        };
        let wall = offsets(WALL);
        assert_eq!(offsets(DepthLattice::default()), wall);
        assert!(wall[16..].windows(2).all(|w| w[0] != w[1]), "{wall:?}");
    }

    #[test]
    fn centered_frames_stay_centered_and_a_reset_starts_anew() {
        let mut centered = AdaptiveJitter::new(4, Sampling::Centered);
        assert!((0..5).all(|_| centered.next(&camera(0.0), &WALL) == [0.0; 2]));
        let mut jitter = AdaptiveJitter::new(3, Sampling::Jittered);
        let five = |jitter: &mut AdaptiveJitter| -> Vec<_> {
            (0..5).map(|k| jitter.next(&camera(0.004 * f64::from(k)), &WALL)).collect()
        };
        let first = five(&mut jitter);
        jitter.reset();
        assert_eq!(five(&mut jitter), first);
    }
}
