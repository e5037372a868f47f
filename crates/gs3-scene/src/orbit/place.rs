//! An orbit within a place: a free ring with a clear view across.

use glam::DVec3;
use rayon::prelude::*;

use super::matter::Matter;

/// Points of the ring that are tried.
const EYES: usize = 12;

/// Radii that are tried, as shares of the place's smaller level extent.
const RADII: [f64; 6] = [0.35, 0.26, 0.2, 0.15, 0.11, 0.08];

/// Rays across an image, and down.
const RAYS: [usize; 2] = [7, 5];

/// The camera looks down on what it circles by 10°, enough to see the ground before it.
const TILT: f64 = 10.0 * std::f64::consts::PI / 180.0;

/// Largest optical depth from one point of a ring to the next, and from each outward.
const FREE: f32 = 0.5;

/// How far it is free outward, as a share of the extent.
const ELBOW: f64 = 0.03;

/// Things nearer than this share of the extent fill too much of the image.
const NEAR: f64 = 0.08;

/// Objects with Gaussians that appear larger than this were never seen from so near, and are blurred: 0.01 is 12
/// pixels of an image 1080 pixels high.
const SHARP: f64 = 0.01;

/// A level circle of eyes that look across it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Ring {
    /// Its centre, at the height of the eyes.
    pub center: DVec3,
    pub radius: f64,
}

/// The directions of a scene's level plane and its images.
#[derive(Clone, Copy)]
pub(super) struct Frame {
    /// Up, and two level directions; unit vectors.
    pub up: DVec3,
    pub level: [DVec3; 2],
    /// Half of the image's width and height at distance 1.
    pub half_size: [f64; 2],
}

impl Frame {
    /// The level direction of turn `share` of a circle.
    pub fn direction(&self, share: f64) -> DVec3 {
        let (sin, cos) = (std::f64::consts::TAU * share).sin_cos();
        self.level[0] * cos + self.level[1] * sin
    }
}

impl Ring {
    /// The eye at turn `share`, and what it looks at.
    pub fn view(&self, frame: &Frame, share: f64) -> (DVec3, DVec3) {
        let eye = self.center + self.radius * frame.direction(share);
        (eye, self.center - self.radius * TILT.tan() * frame.up)
    }

    /// The best free ring around one of `centers` in a place of the given level extent; none if nothing is free.
    pub fn best(matter: &Matter, frame: &Frame, centers: &[DVec3], extent: f64) -> Option<Self> {
        let rings: Vec<Self> = (centers.iter())
            .flat_map(|center| RADII.map(|radius| Self { center: *center, radius: radius * extent }))
            .collect();
        let scores: Vec<Option<f64>> =
            rings.par_iter().map(|ring| ring.score(matter, frame, extent)).collect();
        let scored = rings.iter().zip(scores).filter_map(|(ring, score)| Some((ring, score?)));
        // The first of equals.
        scored.reduce(|best, other| if other.1 > best.1 { other } else { best }).map(|(ring, _)| *ring)
    }

    /// How good the views are; none if something is in the way.
    fn score(&self, matter: &Matter, frame: &Frame, extent: f64) -> Option<f64> {
        let share = |k: usize| k as f64 / EYES as f64;
        let eyes: Vec<DVec3> = (0..=EYES).map(|k| self.view(frame, share(k)).0).collect();
        let is_blocked = |pair: &[DVec3]| {
            let outward = (pair[0] - self.center) * (1.0 + ELBOW * extent / self.radius);
            matter.between(pair[0], pair[1]) > FREE || matter.between(pair[0], self.center + outward) > FREE
        };
        if eyes.windows(2).any(is_blocked) {
            return None;
        }
        let views: Vec<f64> = (0..EYES).map(|k| self.view_score(matter, frame, share(k), extent)).collect();
        let mean = views.iter().sum::<f64>() / EYES as f64;
        let worst = views.iter().copied().fold(f64::INFINITY, f64::min);
        // The mean alone accepts one view into a hedge. The fourth root of the radius: a wider ring shows more, but a
        // better view matters more. (Chosen by looking at rings in a room, a flat and a garden.)
        Some((mean + worst) * (self.radius / extent).powf(0.25))
    }

    /// The share of an image that shows something sharp, less the share that shows something near or blurred.
    fn view_score(&self, matter: &Matter, frame: &Frame, share: f64, extent: f64) -> f64 {
        let (eye, target) = self.view(frame, share);
        let forward = (target - eye).normalize_or_zero();
        let right = forward.cross(frame.up).normalize_or_zero();
        let down = forward.cross(right);
        let mut sum = 0.0;
        for (i, j) in (0..RAYS[0]).flat_map(|i| (0..RAYS[1]).map(move |j| (i, j))) {
            let at = |k: usize, count: usize| 2.0 * (k as f64 + 0.5) / count as f64 - 1.0;
            let (x, y) = (frame.half_size[0] * at(i, RAYS[0]), frame.half_size[1] * at(j, RAYS[1]));
            let direction = (forward + x * right + y * down).normalize_or_zero();
            sum += match matter.hit(eye, direction, 3.0 * extent) {
                Some(hit) if hit.distance > NEAR * extent && hit.blur < SHARP => 1.0,
                Some(_) => -1.0,
                None => 0.0,
            };
        }
        sum / (RAYS[0] * RAYS[1]) as f64
    }
}
