//! What moves in a frame by itself: the renderer's motion vectors less what the cameras explain.
//!
//! Vectors lead back: from where a surface is to where it was. With the depths at both ends they become displacements in
//! the world, which stay true whatever the camera does afterwards. What is remembered has to go forward; so every vector
//! is also entered where it leads to, the nearest surface first, and whoever was there finds where it went.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use glam::DVec2;
use gs3_scene::{Camera, GBuffer, Planes};
use rayon::prelude::*;

use crate::boxes::Limits;
use crate::reprojection::{MIN_DIVISOR, Reprojection, SAME_SURFACE, inverse_depth};
use crate::samples::SampleFrame;

/// Surfaces whose vectors differ by less than this from what the cameras explain stand still, LR pixels: rounding is a
/// tenth of it, and over 16 frames even what moves just slower goes no farther than a quarter of an HR pixel at scale 4.
const STILL: f32 = 1.0 / 256.0;

/// The same as a share of the vector: what half precision, in which renderers keep vectors, rounds by at most.
const ROUNDING: f32 = 1.0 / 1024.0;

/// Surfaces may have come nearer by this share of their depth since the frame before, or gone as far away; depths there
/// that differ by more are another's.
const APPROACH: f32 = 0.1;

/// Vectors beyond this many frame widths or heights say that a surface was nowhere.
const FARTHEST: f32 = 2.0;

/// Displacements have to be below this, world units, so that no sum of 64 of their squares overflows.
const LARGEST: f32 = 1e18;

/// A surface that was nowhere, or is infinitely far, disturbs what is seen in its place by this, HR pixels: as much as
/// makes the past count by what the current frame says of it alone.
const UNKNOWN: f32 = 8.0;

/// What one sample of the current frame says about the motion of its surface.
#[derive(Clone, Copy, Debug, Default)]
struct Surface {
    /// From where it was in the world to where it is, world units. 0 if it stands still.
    displacement: [f32; 3],
    /// How far it is from where it would be if it stood still, HR pixels; 0 if it does.
    residual: f32,
    /// Where it was in the frame before, HR pixels.
    origin: [f32; 2],
    /// Inverse depth now.
    inverse: f32,
    /// Inverse depth then; negative if it was nowhere.
    origin_inverse: f32,
}

impl Surface {
    fn is_still(&self) -> bool {
        self.residual == 0.0
    }
}

/// What became of a surface that the frame before saw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Departure {
    /// It stands still.
    Still,
    /// It moved by so much, world units.
    Moved([f32; 3]),
    /// The current frame does not see it.
    Unknown,
}

/// Motion of the surfaces of a frame since the frame before.
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
    /// Which surface came from a pixel of the frame before, [`encode`]d: `[height, width]`.
    arrivals: Vec<AtomicU64>,
    /// Samples of things that move, at their places now, and at those where they were.
    here: Counts,
    left: Counts,
    /// Displacements of the picture's samples, from the frame before to the current one: those of the frame before, and
    /// those of the current one; `[LR height, LR width]`.
    displacements: [Vec<[f32; 3]>; 2],
}

/// The frame before and the current one.
pub(crate) struct Frames<'a> {
    pub cameras: [&'a Camera; 2],
    pub before: &'a SampleFrame,
    /// With its margin.
    pub now: &'a GBuffer,
    /// HR pixels per LR pixel.
    pub scale: u32,
}

impl SurfaceMotion {
    /// Forgets everything: what comes next stands still.
    pub fn clear(&mut self) {
        self.displacements.iter_mut().for_each(Vec::clear);
    }

    /// Displacements of the samples of the frame before, and of the current one, both without margins, world units,
    /// `[LR height, LR width]`; none if nothing moves.
    pub fn displacements(&self) -> Option<[&[[f32; 3]]; 2]> {
        let [before, now] = &self.displacements;
        let moves = |of: &[[f32; 3]]| of.iter().any(|displacement| *displacement != [0.0; 3]);
        (moves(before) || moves(now)).then_some([before, now])
    }

    /// Makes this the motion between `frames` that `vectors`, LR pixels, tell.
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
            farthest: [camera.width(), camera.height()].map(|side| FARTHEST * side as f32),
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

    /// Enters every surface where it was.
    fn enter_arrivals(&mut self) {
        let Self { width, height, scale, corner, .. } = *self;
        self.arrivals.resize_with(width * height, AtomicU64::default);
        self.arrivals.par_iter_mut().with_min_len(1 << 14).for_each(|arrival| *arrival.get_mut() = 0);
        let arrivals = &self.arrivals;
        self.surfaces.par_iter().enumerate().with_min_len(1 << 12).for_each(|(k, surface)| {
            if let Some([x, y]) = cell(surface, corner, scale, [width, height]) {
                // The nearest wins, and of those the last: the result does not depend on the threads.
                arrivals[y * width + x].fetch_max(encode(surface.origin_inverse, k), Relaxed);
            }
        });
    }

    /// Finds the displacements of the picture's samples.
    fn set_displacements(&mut self, frames: &Frames<'_>) {
        let [columns, rows] = frames.before.picture_size();
        // Those of the frame before were its own.
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
                    // What moved goes on as it did.
                    Departure::Unknown => {}
                }
            }
        });
        self.displacements = [before, now];
    }

    /// What became of what was seen in the frame before at `at`, HR pixels, and inverse depth `inverse`. What moved
    /// already (`is_mover`) does not stand still for lack of evidence.
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
        // Mostly its own pixel has it; else the closest of those around.
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

    /// How far surfaces move where the current frame shows HR position `at`, HR pixels: the most of the four samples
    /// around it.
    pub fn unrest(&self, at: [f32; 2]) -> f32 {
        let Some(([x, y], _)) = self.cell_between(at) else { return 0.0 };
        let [right, below] = [(x + 1).min(self.width - 1), (y + 1).min(self.height - 1)];
        let of = |x: usize, y: usize| self.surfaces[y * self.width + x].residual;
        of(x, y).max(of(right, y)).max(of(x, below).max(of(right, below)))
    }

    /// Whether anything within `limits`, HR pixels, pixel centres at whole numbers, moved from there since the frame
    /// before.
    pub fn any_left(&self, limits: Limits) -> bool {
        self.any_within(&self.left, limits)
    }

    /// Whether anything that moves is now within `limits`, or next to it.
    pub fn any_here(&self, limits: Limits) -> bool {
        self.any_within(&self.here, limits)
    }

    /// The samples that move and were somewhere, column and row.
    pub fn movers(&self) -> impl Iterator<Item = [usize; 2]> + use<'_> {
        let moves = |surface: &Surface| !surface.is_still() && surface.origin_inverse >= 0.0;
        let movers = self.surfaces.iter().enumerate().filter(move |(_, surface)| moves(surface));
        movers.map(|(k, _)| [k % self.width, k / self.width])
    }

    fn any_within(&self, counts: &Counts, limits: Limits) -> bool {
        // Two samples more: those around a place, and those that a place may be off.
        let first =
            |at: f32, axis: usize| (at / self.scale + self.corner[axis] as f32 - 2.0).max(0.0) as usize;
        let end = |at: f32, axis: usize| (at / self.scale + self.corner[axis] as f32 + 3.0).max(0.0) as usize;
        counts
            .any([first(limits.left, 0), first(limits.top, 1)], [end(limits.right, 0), end(limits.bottom, 1)])
    }

    /// The sample left of and above HR position `at`, and the way from there to `at` in spacings of samples.
    fn cell_between(&self, at: [f32; 2]) -> Option<([usize; 2], [f32; 2])> {
        let place = [0, 1].map(|axis| at[axis] / self.scale - 0.5 - self.offset[axis]);
        let last = [self.width, self.height].map(|side| side as f32 - 0.5);
        let is_in = place.iter().zip(last).all(|(place, last)| (-0.5..last).contains(place));
        let place = place.map(|v| v.max(0.0));
        is_in.then(|| (place.map(|v| v as usize), place.map(|v| v - v.floor())))
    }

    /// Whether inverse depths, seen two samples apart at most, are both of the surface of sample `k`.
    fn is_of(&self, k: usize, a: f32, b: f32) -> bool {
        is_same(a, b) || (a - b).abs() <= 2.0 * self.slope(k)
    }

    /// By how much inverse depths of the surface of sample `k` change from sample to sample: the smaller of the changes
    /// to both sides, where they agree in sign, along x and along y.
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

    /// The displacement of the surface of sample `k` at a place that is `by` samples away from it: between the samples
    /// around that move and are of the same surface.
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
        // Far outside of the surface's samples its nearest is better than what little of others counts.
        if weights > 0.25 { sum.map(|v| v / weights) } else { surface.displacement }
    }
}

/// Whether inverse depths are those of one surface, whatever its slope.
fn is_same(a: f32, b: f32) -> bool {
    (a - b).abs() <= SAME_SURFACE * a.max(b)
}

/// What vectors are followed with.
struct Tracer<'a> {
    /// The one before, the current one.
    cameras: [&'a Camera; 2],
    /// From the current one to the one before.
    reprojection: Reprojection,
    before: &'a SampleFrame,
    scale: f32,
    /// The longest vectors, HR pixels.
    farthest: [f32; 2],
}

impl Tracer<'_> {
    /// Follows the vector of the sample at HR position `at` and inverse depth `inverse`, HR pixels.
    fn trace(&self, at: [f32; 2], inverse: f32, vector: [f32; 2]) -> Surface {
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

/// The pixel of the frame before, among `size` with the margin whose first is `corner` pixels before the picture, that
/// `surface` came from.
fn cell(surface: &Surface, corner: [usize; 2], scale: f32, size: [usize; 2]) -> Option<[usize; 2]> {
    if surface.origin_inverse < 0.0 { None } else { cell_of(surface.origin, corner, scale, size) }
}

/// The same of HR position `at`.
fn cell_of(at: [f32; 2], corner: [usize; 2], scale: f32, size: [usize; 2]) -> Option<[usize; 2]> {
    let place = [0, 1].map(|axis| at[axis] / scale + corner[axis] as f32);
    let is_in = place.iter().zip(size).all(|(place, side)| (0.0..side as f32).contains(place));
    is_in.then(|| place.map(|v| v as usize))
}

/// Orders surfaces that came from one pixel: above 0, the nearer the larger.
fn encode(inverse: f32, k: usize) -> u64 {
    // The bits of numbers that are not negative are ordered as they are; samples are far fewer than 2³².
    u64::from(inverse.max(0.0).to_bits()) << 32 | (k as u64 + 1)
}

/// The sample that [`encode`] was told; none where there was none.
fn decode(arrival: u64) -> Option<usize> {
    (arrival as u32).checked_sub(1).map(|k| k as usize)
}

/// How many there are in rectangles of a grid.
#[derive(Debug, Default)]
struct Counts {
    size: [usize; 2],
    /// Of each corner between pixels, how many are left of and above it: `[height + 1, width + 1]`.
    sums: Vec<u32>,
}

impl Counts {
    /// Counts what `all` hands over, column and row, on a grid of `size`.
    fn set(&mut self, size: [usize; 2], all: impl FnOnce(&mut dyn FnMut([usize; 2]))) {
        let stride = size[0] + 1;
        self.size = size;
        self.sums.clear();
        self.sums.resize(stride * (size[1] + 1), 0);
        let sums = &mut self.sums;
        all(&mut |[x, y]| sums[(y + 1) * stride + x + 1] += 1);
        for y in 1..=size[1] {
            let mut in_row = 0;
            for x in 1..stride {
                in_row += self.sums[y * stride + x];
                self.sums[y * stride + x] = self.sums[(y - 1) * stride + x] + in_row;
            }
        }
    }

    /// Whether there are any from column and row `first` to before `end`.
    fn any(&self, first: [usize; 2], end: [usize; 2]) -> bool {
        let stride = self.size[0] + 1;
        let [end_x, end_y] = [end[0].min(self.size[0]), end[1].min(self.size[1])];
        let [x, y] = [first[0].min(end_x), first[1].min(end_y)];
        let at = |x: usize, y: usize| self.sums[y * stride + x];
        at(end_x, end_y) + at(x, y) > at(x, end_y) + at(end_x, y)
    }
}

#[cfg(test)]
mod tests {
    use gs3_scene::{Geometry, Gradients, Intrinsics, Margin};

    use super::*;

    const SCALE: u32 = 4;
    const SIZE: [usize; 2] = [24, 16];
    const MARGIN: usize = 3;

    /// A wall five units away and before it, at depth 3, a square of 6×6 LR pixels, with its margin.
    fn gbuffer(left: f32) -> GBuffer {
        let [width, height] = SIZE.map(|side| side + 2 * MARGIN);
        let mut depth_median = Planes::<1>::new(width, height);
        for (k, z) in depth_median.data_mut().iter_mut().enumerate() {
            *z = if is_square(k, width, left) { 3.0 } else { 5.0 };
        }
        let (color, plane) = (Planes::new(width, height), || Planes::new(width, height));
        GBuffer {
            margin: Margin::all(MARGIN as u32),
            color,
            gradients: Some(Gradients { color_dx: plane(), color_dy: plane(), color_dxy: None }),
            geometry: Some(Geometry { depth_median, ..Geometry::default() }),
            ..GBuffer::default()
        }
    }

    /// Whether sample `k` is of the square whose left edge is `left` of the picture's.
    fn is_square(k: usize, width: usize, left: f32) -> bool {
        let [x, y] = [k % width, k / width].map(|v| v as f32 + 0.5 - MARGIN as f32);
        (left..left + 6.0).contains(&x) && (5.0..11.0).contains(&y)
    }

    fn camera() -> Camera {
        let [width, height] = SIZE.map(|side| side as u32 * SCALE);
        Camera::new(glam::DAffine3::IDENTITY, Intrinsics::from_fov_y(width, height, 0.8)).expect("valid")
    }

    /// The square has moved from `from` to `to`, LR pixels.
    fn motion(from: f32, to: f32) -> SurfaceMotion {
        let (before, now, camera) = (gbuffer(from), gbuffer(to), camera());
        let mut frame = SampleFrame::default();
        frame.fill(gs3_simd::level(), &before, SCALE).expect("complete");
        let mut vectors = Planes::<2>::new(now.width(), now.height());
        let width = now.width();
        for (k, x) in vectors.plane_mut(0).iter_mut().enumerate() {
            *x = if is_square(k, width, to) { from - to } else { 0.0 };
        }
        let mut motion = SurfaceMotion::default();
        let frames = Frames { cameras: [&camera, &camera], before: &frame, now: &now, scale: SCALE };
        motion.set(&frames, &vectors);
        motion
    }

    /// The HR position of an LR position.
    fn at(x: f32, y: f32) -> [f32; 2] {
        [x, y].map(|v| v * SCALE as f32)
    }

    #[test]
    fn what_left_is_found_where_it_was() {
        let motion = motion(6.0, 9.0);
        // Three LR pixels are twelve HR pixels, at depth 3.
        let way = (12.0 * 3.0 / camera().intrinsics().fx) as f32;
        let moved = |departure: Departure| match departure {
            Departure::Moved([x, y, z]) => (x - way).abs() < 1e-5 && y.abs() < 1e-6 && z.abs() < 1e-6,
            _ => false,
        };
        let square = |x: f32, y: f32| motion.departure(at(x, y), 1.0 / 3.0, false);
        assert!(moved(square(8.3, 7.9)), "{:?}", square(8.3, 7.9));
        assert!(moved(square(6.1, 5.1)), "at its corner: {:?}", square(6.1, 5.1));
        let wall = |x: f32, y: f32| motion.departure(at(x, y), 0.2, false);
        assert_eq!(wall(2.5, 8.0), Departure::Still, "nothing moves here");
        assert_eq!(wall(5.6, 8.0), Departure::Still, "beside what moved");
        assert_eq!(wall(9.0, 8.0), Departure::Unknown, "it was hidden, nobody saw it");
        // What has moved before and is not found again is not taken to rest.
        assert_eq!(motion.departure(at(2.5, 8.0), 1.0, true), Departure::Unknown);
        assert_eq!(motion.departure(at(2.5, 8.0), 1.0, false), Departure::Still);
        assert_eq!(motion.departure(at(-100.0, 8.0), 0.2, false), Departure::Unknown, "outside");
    }

    #[test]
    fn what_is_seen_where_something_moves_is_disturbed() {
        let motion = motion(6.0, 9.0);
        assert_eq!(motion.unrest(at(12.0, 8.0)), 12.0);
        assert_eq!(motion.unrest(at(8.6, 8.0)), 12.0, "between its samples and those of the wall");
        assert_eq!(motion.unrest(at(7.5, 8.0)), 0.0, "where it was");
        let limits = |left: f32, right: f32| {
            let [left, right] = [left, right].map(|v| v * SCALE as f32);
            Limits { left, right, top: 30.0, bottom: 30.0 }
        };
        assert!(motion.any_here(limits(9.0, 10.0)) && !motion.any_here(limits(-3.0, 4.0)));
        assert!(motion.any_left(limits(6.0, 7.0)) && !motion.any_left(limits(16.0, 20.0)));
        assert_eq!(motion.movers().count(), 36);
    }

    #[test]
    fn both_frames_have_displacements() {
        let motion = motion(6.0, 9.0);
        let [before, now] = motion.displacements().expect("something moves");
        let columns = |of: &[[f32; 3]]| {
            let moves = |x: &usize| of[8 * SIZE[0] + x] != [0.0; 3];
            (0..SIZE[0]).filter(moves).collect::<Vec<_>>()
        };
        assert_eq!(columns(before), [6, 7, 8, 9, 10, 11]);
        assert_eq!(columns(now), [9, 10, 11, 12, 13, 14]);
        let still = self::motion(6.0, 6.0);
        assert!(still.displacements().is_none());
    }

    #[test]
    fn rectangles_are_counted() {
        let size = [7, 5];
        let is_in = |x: usize, y: usize| (3 * x + 5 * y) % 7 == 1;
        let mut counts = Counts::default();
        counts.set(size, |count| {
            for (x, y) in (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| (x, y))) {
                if is_in(x, y) {
                    count([x, y]);
                }
            }
        });
        for (x0, x1) in (0..9).flat_map(|a| (a..9).map(move |b| (a, b))) {
            for (y0, y1) in (0..7).flat_map(|a| (a..7).map(move |b| (a, b))) {
                let mut cells = (y0..y1.min(5)).flat_map(|y| (x0..x1.min(7)).map(move |x| (x, y)));
                let expected = cells.any(|(x, y)| is_in(x, y));
                assert_eq!(counts.any([x0, y0], [x1, y1]), expected, "{x0}..{x1}, {y0}..{y1}");
            }
        }
    }
}
