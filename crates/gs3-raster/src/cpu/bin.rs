//! Splats to tiles, in one pass: lists that keep their memory from frame to frame need no count of what will be in
//! them.

use std::ops::Range;

use rayon::prelude::*;

use super::grid::Grid;
use super::project::Projected;
use crate::settings::Culling;

/// Tile size in samples. 32×16 keeps a tile's blending state (up to 22 values a pixel) near the first-level cache,
/// gives bands of 16 rows to share among threads, and its 4×4 blocks fill a 32-bit mask.
pub const TILE_WIDTH: usize = 32;
/// See [`TILE_WIDTH`].
pub const TILE_HEIGHT: usize = 16;

/// Bits of an id that name the splat within its projection job.
const LOCAL_BITS: u32 = 16;

/// Largest number of Gaussians in a projection job.
pub const MAX_JOB_SIZE: usize = 1 << LOCAL_BITS;

/// A splat: its projection job in the upper half, the index within in the lower.
#[derive(Clone, Copy)]
pub struct Id(u32);

impl Id {
    const fn new(job: usize, local: usize) -> Self {
        Self((job << LOCAL_BITS | local) as u32)
    }

    /// Job and index within.
    #[inline(always)]
    pub const fn place(self) -> (usize, usize) {
        ((self.0 >> LOCAL_BITS) as usize, self.0 as usize % MAX_JOB_SIZE)
    }
}

/// Splats by tile, in scene order whatever thread finds them.
#[derive(Default)]
pub struct Bins {
    /// For each run of jobs what is found of it, `[tiles or more]`: more after a larger frame.
    runs: Vec<Vec<Vec<Id>>>,
}

impl Bins {
    /// The splats of `tile`, in scene order: a slice for each run of jobs, empty where none of them touches it.
    #[inline(always)]
    pub fn of_tile(&self, tile: usize) -> impl Iterator<Item = &[Id]> {
        self.runs.iter().map(move |tiles| &tiles[tile][..])
    }

    /// Fills the bins of the tiles of `grid`.
    pub fn fill(&mut self, jobs: &[Projected], grid: &Grid, culling: Culling) {
        let [columns, rows] = grid.tiles();
        let runs = balanced_runs(jobs, rayon::current_num_threads());
        self.runs.resize_with(runs.len(), Vec::new);
        self.runs.par_iter_mut().zip(runs).for_each(|(tiles, run)| {
            // Tiles keep their memory, those beyond a smaller frame, too.
            tiles.resize_with(tiles.len().max(columns * rows), Vec::new);
            tiles.iter_mut().for_each(Vec::clear);
            for (job, projected) in run.clone().zip(&jobs[run]) {
                for local in 0..projected.splats.len() {
                    let id = Id::new(job, local);
                    for_each_tile(projected, local, culling, grid, |tile| tiles[tile].push(id));
                }
            }
        });
    }
}

/// Splits the jobs into `count` runs of about equally many splats.
fn balanced_runs(jobs: &[Projected], count: usize) -> Vec<Range<usize>> {
    let total: usize = jobs.iter().map(|job| job.splats.len()).sum();
    let share = total.div_ceil(count).max(1);
    let mut runs = Vec::with_capacity(count);
    let (mut start, mut in_run) = (0, 0);
    for (i, job) in jobs.iter().enumerate() {
        in_run += job.splats.len();
        if in_run >= share {
            runs.push(start..i + 1);
            (start, in_run) = (i + 1, 0);
        }
    }
    if start < jobs.len() {
        runs.push(start..jobs.len());
    }
    runs
}

/// Calls `visit` with each tile that `culling` assigns the splat to.
#[inline(always)]
fn for_each_tile(job: &Projected, local: usize, culling: Culling, grid: &Grid, mut visit: impl FnMut(usize)) {
    let ([columns, _], [width, height]) = (grid.tiles(), grid.tile_size());
    let rect = job.rects[local];
    let (first_x, last_x) = (rect.x0 as usize / width, (rect.x1 as usize - 1) / width);
    let (first_y, last_y) = (rect.y0 as usize / height, (rect.y1 as usize - 1) / height);
    if first_x == last_x && first_y == last_y {
        visit(first_y * columns + first_x);
        return;
    }
    if first_x == last_x || first_y == last_y || !matches!(culling, Culling::AccuTile | Culling::Exact) {
        // The box is tight: the support reaches every tile of a single row or column.
        for y in first_y..=last_y {
            for x in first_x..=last_x {
                visit(y * columns + x);
            }
        }
        return;
    }
    let splat = &job.splats[local];
    // From places counted from the first pixel to positions.
    let [before_x, before_y] = grid.before.map(|pixels| pixels as f32);
    for y in first_y..=last_y {
        let top = (y * height) as f32 - before_y;
        let bottom = top + (height - 1) as f32;
        let (mut from, mut to) = (first_x, last_x);
        if culling == Culling::AccuTile {
            let [left, right] = splat.x_span(top, bottom);
            from = from.max(((left + before_x).max(0.0) as usize) / width);
            to = to.min(((right + before_x).max(0.0) as usize) / width);
        }
        for x in from..=to {
            let left = (x * width) as f32 - before_x;
            let right = left + (width - 1) as f32;
            if culling != Culling::Exact || splat.reaches(left, top, right, bottom) {
                visit(y * columns + x);
            }
        }
    }
}
