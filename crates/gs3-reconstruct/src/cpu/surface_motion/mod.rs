//! The motion of moving objects in a frame: the renderer's motion vectors less the motion that the cameras explain.
//!
//! Vectors point backwards: from a surface's current place to its previous place. With the depths at both ends they
//! become displacements in the world, which stay valid under any camera motion afterwards. Remembered samples must
//! move forwards. So every vector is also entered at its previous place, the nearest surface first, and a sample that
//! was there finds its new place.

mod counts;
#[cfg(test)]
mod tests;
mod trace;

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use gs3_scene::{Camera, GBuffer, Planes};
use rayon::prelude::*;

use self::counts::Counts;
use self::trace::{FARTHEST, Surface, Tracer, is_same};
use crate::cpu::boxes::BoxLimits;
use crate::cpu::samples::SampleFrame;
use crate::reprojection::{Reprojection, inverse_depth};

/// What happened to a surface of the previous frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Departure {
    /// It stands still.
    Still,
    /// It moved by this displacement, in world units.
    Moved([f32; 3]),
    /// The current frame does not show it.
    Unknown,
}

/// Motion of the surfaces of a frame since the previous frame.
///
/// Memory: 72 B per LR pixel, margins included.
#[derive(Debug, Default)]
pub(crate) struct SurfaceMotion {
    width: usize,
    height: usize,
    /// HR pixels between samples.
    scale: f32,
    /// Offset of the first sample from the first pixel centre of the picture, LR pixels.
    offset: [f32; 2],
    /// LR pixels of the margin left of and above the picture.
    corner: [usize; 2],
    /// `[height, width]`.
    surfaces: Vec<Surface>,
    /// The surface that came from each pixel of the previous frame, [`encode`]d: `[height, width]`.
    arrivals: Vec<AtomicU64>,
    /// Counts of samples of moving objects, at their current places and at their previous places.
    here: Counts,
    left: Counts,
    /// Displacements of the picture's samples from the previous frame to the current one, of the previous frame's
    /// samples and of the current frame's; `[LR height, LR width]`.
    displacements: [Vec<[f32; 3]>; 2],
}

/// The previous frame and the current frame.
pub(crate) struct Frames<'a> {
    pub cameras: [&'a Camera; 2],
    pub before: &'a SampleFrame,
    /// The current frame with its margin.
    pub now: &'a GBuffer,
    /// HR pixels per LR pixel.
    pub scale: u32,
}

impl SurfaceMotion {
    /// Resets the motion: everything stands still.
    pub fn clear(&mut self) {
        self.displacements.iter_mut().for_each(Vec::clear);
    }

    /// Displacements of the samples of the previous frame and of the current frame, both without margins, in world
    /// units, `[LR height, LR width]`; none if nothing moves.
    pub fn displacements(&self) -> Option<[&[[f32; 3]]; 2]> {
        let [before, now] = &self.displacements;
        let moves = |of: &[[f32; 3]]| of.iter().any(|displacement| *displacement != [0.0; 3]);
        (moves(before) || moves(now)).then_some([before, now])
    }

    /// Computes the motion between `frames` from `vectors`, in LR pixels.
    pub fn set(&mut self, frames: &Frames<'_>, vectors: &Planes<2>) {
        let Frames { cameras: [camera_before, camera], before, now, scale } = *frames;
        let Some(geometry) = &now.geometry else { return };
        let depths = &geometry.depth_median;
        (self.width, self.height) = (now.width(), now.height());
        let (width, height) = (self.width, self.height);
        self.scale = scale as f32;
        self.corner = [now.margin.left as usize, now.margin.top as usize];
        self.offset = [0, 1].map(|axis| now.jitter[axis] - self.corner[axis] as f32);
        let tracer = Tracer {
            cameras: [camera_before, camera],
            reprojection: Reprojection::new(camera, camera_before),
            before,
            scale: self.scale,
            farthest: camera.size().to_array().map(|side| FARTHEST * side as f32),
        };
        self.surfaces.resize(width * height, Surface::default());
        let (scale, offset) = (self.scale, self.offset);
        let rows = self.surfaces.par_chunks_exact_mut(width).enumerate().with_min_len(4);
        rows.for_each(|(y, surfaces)| {
            let [vx, vy] = [0, 1].map(|c| vectors.row(c, y));
            for (x, surface) in surfaces.iter_mut().enumerate() {
                let at = [(x as f32 + 0.5 + offset[0]) * scale, (y as f32 + 0.5 + offset[1]) * scale];
                let vector = [vx[x] * scale, vy[x] * scale];
                *surface = tracer.trace(at, inverse_depth(depths.row(0, y)[x]), vector);
            }
        });
        self.enter_arrivals();
        let (surfaces, corner) = (&self.surfaces, self.corner);
        self.here.set([width, height], |count| {
            let movers = surfaces.iter().enumerate().filter(|(_, surface)| !surface.is_still());
            movers.for_each(|(k, _)| count([k % width, k / width]));
        });
        self.left.set([width, height], |count| {
            for surface in surfaces.iter().filter(|surface| !surface.is_still()) {
                if let Some([x, y]) = cell(surface, corner, scale, [width, height]) {
                    count([x, y]);
                }
            }
        });
        self.set_displacements(frames);
    }

    /// Enters every surface at its previous place.
    fn enter_arrivals(&mut self) {
        let Self { width, height, scale, corner, .. } = *self;
        self.arrivals.resize_with(width * height, AtomicU64::default);
        self.arrivals.par_iter_mut().with_min_len(1 << 14).for_each(|arrival| *arrival.get_mut() = 0);
        let arrivals = &self.arrivals;
        self.surfaces.par_iter().enumerate().with_min_len(1 << 12).for_each(|(k, surface)| {
            if let Some([x, y]) = cell(surface, corner, scale, [width, height]) {
                // The nearest surface wins, and the last of equal ones: the result does not depend on the threads.
                arrivals[y * width + x].fetch_max(encode(surface.origin_inverse, k), Relaxed);
            }
        });
    }

    /// Finds the displacements of the picture's samples.
    fn set_displacements(&mut self, frames: &Frames<'_>) {
        let [columns, rows] = frames.before.picture_size();
        // The displacements of the previous frame were computed as the current ones one frame ago.
        self.displacements.swap(0, 1);
        let [mut before, mut now] = std::mem::take(&mut self.displacements);
        before.resize(columns * rows, [0.0; 3]);
        now.resize(columns * rows, [0.0; 3]);
        let this = &*self;
        let now_rows = now.par_chunks_exact_mut(columns);
        let both = now_rows.zip(before.par_chunks_exact_mut(columns)).enumerate().with_min_len(4);
        both.for_each(|(y, (now, before))| {
            let first = (y + this.corner[1]) * this.width + this.corner[0];
            for (now, surface) in now.iter_mut().zip(&this.surfaces[first..]) {
                *now = surface.displacement;
            }
            for (x, before) in before.iter_mut().enumerate() {
                let (at, inverse) = frames.before.picture_place(x, y, this.scale);
                match this.departure(at, inverse, *before != [0.0; 3]) {
                    Departure::Still => *before = [0.0; 3],
                    Departure::Moved(by) => *before = by,
                    // A moving sample keeps its displacement.
                    Departure::Unknown => {}
                }
            }
        });
        self.displacements = [before, now];
    }

    /// What happened to the surface at HR position `at` with inverse depth `inverse` in the previous frame. A surface
    /// that was moving (`is_mover`) is not assumed to stand still for lack of evidence.
    pub fn departure(&self, at: [f32; 2], inverse: f32, is_mover: bool) -> Departure {
        let Self { width, height, corner, scale, .. } = *self;
        let Some([x, y]) = cell_of(at, corner, scale, [width, height]) else { return Departure::Unknown };
        let columns = x.saturating_sub(1)..(x + 2).min(width);
        let rows = y.saturating_sub(1)..(y + 2).min(height);
        if !is_mover && !self.left.any([columns.start, rows.start], [columns.end, rows.end]) {
            return Departure::Still;
        }
        let find = |cell: usize| {
            let k = decode(self.arrivals[cell].load(Relaxed))?;
            let surface = &self.surfaces[k];
            let away = [0, 1].map(|axis| surface.origin[axis] - at[axis]);
            let distance = away[0].mul_add(away[0], away[1] * away[1]);
            self.is_of(k, surface.origin_inverse, inverse).then_some((k, away, distance))
        };
        // Usually the surface is entered at its own pixel; otherwise the closest of the pixels around is taken.
        let mut found = find(y * width + x);
        if found.is_none() {
            for found_here in rows.flat_map(|y| columns.clone().map(move |x| y * width + x)).filter_map(find)
            {
                if found.is_none_or(|(.., least)| found_here.2 < least) {
                    found = Some(found_here);
                }
            }
        }
        match found {
            None => Departure::Unknown,
            Some((k, ..)) if self.surfaces[k].is_still() => Departure::Still,
            Some((k, away, _)) => Departure::Moved(self.displacement_beside(k, away.map(|v| -v / scale))),
        }
    }

    /// How far surfaces move, in HR pixels, where the current frame shows HR position `at`: the maximum of the four
    /// samples around it.
    pub fn surface_shift(&self, at: [f32; 2]) -> f32 {
        let Some(([x, y], _)) = self.cell_between(at) else { return 0.0 };
        let [right, below] = [(x + 1).min(self.width - 1), (y + 1).min(self.height - 1)];
        let of = |x: usize, y: usize| self.surfaces[y * self.width + x].residual;
        of(x, y).max(of(right, y)).max(of(x, below).max(of(right, below)))
    }

    /// Whether anything moved away from `limits` (HR pixels, pixel centres at whole numbers) since the previous
    /// frame.
    pub fn any_left(&self, limits: BoxLimits) -> bool {
        self.any_within(&self.left, limits)
    }

    /// Whether anything that moves is now within `limits` or next to it.
    pub fn any_here(&self, limits: BoxLimits) -> bool {
        self.any_within(&self.here, limits)
    }

    /// The moving samples with a previous place, as column and row.
    pub fn movers(&self) -> impl Iterator<Item = [usize; 2]> + use<'_> {
        let moves = |surface: &Surface| !surface.is_still() && surface.origin_inverse >= 0.0;
        let movers = self.surfaces.iter().enumerate().filter(move |(_, surface)| moves(surface));
        movers.map(|(k, _)| [k % self.width, k / self.width])
    }

    fn any_within(&self, counts: &Counts, limits: BoxLimits) -> bool {
        // Two samples more: the samples around a place, and the tolerance of the place.
        let first =
            |at: f32, axis: usize| (at / self.scale + self.corner[axis] as f32 - 2.0).max(0.0) as usize;
        let end = |at: f32, axis: usize| (at / self.scale + self.corner[axis] as f32 + 3.0).max(0.0) as usize;
        counts
            .any([first(limits.left, 0), first(limits.top, 1)], [end(limits.right, 0), end(limits.bottom, 1)])
    }

    /// The sample left of and above HR position `at`, and the offset from the sample to `at` in sample spacings.
    fn cell_between(&self, at: [f32; 2]) -> Option<([usize; 2], [f32; 2])> {
        let place = [0, 1].map(|axis| at[axis] / self.scale - 0.5 - self.offset[axis]);
        let last = [self.width, self.height].map(|side| side as f32 - 0.5);
        let is_in = place.iter().zip(last).all(|(place, last)| (-0.5..last).contains(place));
        let place = place.map(|v| v.max(0.0));
        is_in.then(|| (place.map(|v| v as usize), place.map(|v| v - v.floor())))
    }

    /// Whether two inverse depths, seen at most two samples apart, are both on the surface of sample `k`.
    fn is_of(&self, k: usize, a: f32, b: f32) -> bool {
        is_same(a, b) || (a - b).abs() <= 2.0 * self.slope(k)
    }

    /// Change of the inverse depth of the surface of sample `k` from sample to sample: the smaller of the changes to
    /// both sides, if they agree in sign, along x and along y.
    fn slope(&self, k: usize) -> f32 {
        let Self { width, height, .. } = *self;
        let along = |at: usize, len: usize, step: usize| {
            if at == 0 || at + 1 >= len {
                return 0.0;
            }
            let of = |k: usize| self.surfaces[k].inverse;
            let (before, after) = (of(k) - of(k - step), of(k + step) - of(k));
            if before * after > 0.0 { before.abs().min(after.abs()) } else { 0.0 }
        };
        along(k % width, width, 1) + along(k / width, height, width)
    }

    /// The displacement of the surface of sample `k` at a place `by` samples away from it, interpolated between the
    /// surrounding samples that move and are on the same surface.
    fn displacement_beside(&self, k: usize, by: [f32; 2]) -> [f32; 3] {
        let surface = &self.surfaces[k];
        let [column, row] = [(k % self.width) as f32 + by[0], (k / self.width) as f32 + by[1]];
        let [x, y] = [column.floor(), row.floor()];
        let (mut sum, mut weights) = ([0.0; 3], 0.0);
        for (u, v) in [(x, y), (x + 1.0, y), (x, y + 1.0), (x + 1.0, y + 1.0)] {
            if u < 0.0 || v < 0.0 || u >= self.width as f32 || v >= self.height as f32 {
                continue;
            }
            let other = &self.surfaces[v as usize * self.width + u as usize];
            let is_alike = !other.is_still() && self.is_of(k, other.inverse, surface.inverse);
            let weight = (1.0 - (column - u).abs()) * (1.0 - (row - v).abs());
            if is_alike && weight > 0.0 {
                sum = [0, 1, 2].map(|c| other.displacement[c].mul_add(weight, sum[c]));
                weights += weight;
            }
        }
        // Far outside of the surface's samples, the nearest sample is better than others with small weights.
        if weights > 0.25 { sum.map(|v| v / weights) } else { surface.displacement }
    }
}

/// The pixel of the previous frame that `surface` came from, on a grid of `size` with the margin. The grid's first
/// pixel is `corner` pixels before the picture.
fn cell(surface: &Surface, corner: [usize; 2], scale: f32, size: [usize; 2]) -> Option<[usize; 2]> {
    if surface.origin_inverse < 0.0 { None } else { cell_of(surface.origin, corner, scale, size) }
}

/// The pixel of HR position `at`.
fn cell_of(at: [f32; 2], corner: [usize; 2], scale: f32, size: [usize; 2]) -> Option<[usize; 2]> {
    let place = [0, 1].map(|axis| at[axis] / scale + corner[axis] as f32);
    let is_in = place.iter().zip(size).all(|(place, side)| (0.0..side as f32).contains(place));
    is_in.then(|| place.map(|v| v as usize))
}

/// Orders surfaces that came from one pixel: above 0, larger for nearer surfaces.
fn encode(inverse: f32, k: usize) -> u64 {
    // Bits of non-negative floats are ordered like the floats. There are far fewer than 2³² samples.
    u64::from(inverse.max(0.0).to_bits()) << 32 | (k as u64 + 1)
}

/// The sample that [`encode`] was given; none if there was none.
fn decode(arrival: u64) -> Option<usize> {
    (arrival as u32).checked_sub(1).map(|k| k as usize)
}
