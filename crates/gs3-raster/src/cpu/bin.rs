//! Splats to tiles, in one pass. The lists keep their memory from frame to frame, so no counting pass is needed.

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

/// Number of bits in an id for the splat within its projection job.
const LOCAL_BITS: u32 = 16;

/// Largest number of Gaussians in a projection job.
pub const MAX_JOB_SIZE: usize = 1 << LOCAL_BITS;

/// A splat's id: its projection job in the upper half, and its index in the job in the lower half.
#[derive(Clone, Copy)]
pub struct Id(u32);

impl Id {
    const fn new(job: usize, local: usize) -> Self {
        Self((job << LOCAL_BITS | local) as u32)
    }

    /// The job, and the index in the job.
    #[inline(always)]
    pub const fn place(self) -> (usize, usize) {
        ((self.0 >> LOCAL_BITS) as usize, self.0 as usize % MAX_JOB_SIZE)
    }
}

/// Splats by tile, in scene order, independent of the threads.
#[derive(Default)]
pub struct Bins {
    /// For each run of jobs, the lists of its splats, `[tiles or more]`: there are more after a larger frame.
    runs: Vec<Vec<Vec<Id>>>,
    /// The number of the first tile with a list.
    first_tile: usize,
}

/// Largest number of bin entries at once, unless a single row of tiles has more: 128 MiB of ids, and as much again
/// while lists grow. Frames of captures have up to a tenth of it. A frame with more entries is made in bands of rows.
pub const MOST_ENTRIES: u64 = 1 << 25;

impl Bins {
    /// The splats of `tile`, in scene order: one slice for each run of jobs, empty if none of its splats touches the
    /// tile.
    #[inline(always)]
    pub fn of_tile(&self, tile: usize) -> impl Iterator<Item = &[Id]> {
        self.runs.iter().map(move |tiles| &tiles[tile - self.first_tile][..])
    }

    /// Bands of rows of tiles of `grid`, in order. Each band has at most `most` entries or is one row high.
    pub fn bands(jobs: &[Projected], grid: &Grid, most: u64) -> Vec<Range<usize>> {
        let ([columns, rows], [width, height]) = (grid.tiles(), grid.tile_size());
        let splats: u64 = jobs.iter().map(|job| job.rects.len() as u64).sum();
        if splats.saturating_mul((columns * rows) as u64) <= most {
            return std::iter::once(0..rows).collect();
        }
        // Upper bound of the entries of each row, from the splats' boxes, as differences from the row before.
        let differences = jobs
            .par_iter()
            .fold(
                || vec![0_i64; rows + 1],
                |mut differences, job| {
                    for rect in &job.rects {
                        let tiles = (rect.x1 as usize - 1) / width - rect.x0 as usize / width + 1;
                        differences[rect.y0 as usize / height] += tiles as i64;
                        differences[(rect.y1 as usize - 1) / height + 1] -= tiles as i64;
                    }
                    differences
                },
            )
            .reduce(
                || vec![0; rows + 1],
                |mut sum, differences| {
                    sum.iter_mut().zip(differences).for_each(|(a, b)| *a += b);
                    sum
                },
            );
        let mut groups = Vec::new();
        let (mut start, mut entries, mut of_row) = (0, 0, 0);
        for (row, difference) in differences[..rows].iter().enumerate() {
            of_row += difference;
            if row > start && entries + of_row > most as i64 {
                groups.push(start..row);
                (start, entries) = (row, 0);
            }
            entries += of_row;
        }
        groups.push(start..rows);
        groups
    }

    /// Fills the bins of the tiles of `grid` in the rows `rows`.
    pub fn fill(&mut self, jobs: &[Projected], grid: &Grid, rows: Range<usize>, culling: Culling) {
        let [columns, _] = grid.tiles();
        self.first_tile = rows.start * columns;
        let (first_tile, count) = (self.first_tile, rows.len() * columns);
        let runs = balanced_runs(jobs, rayon::current_num_threads());
        self.runs.resize_with(runs.len(), Vec::new);
        self.runs.par_iter_mut().zip(runs).for_each(|(tiles, run)| {
            // Tiles keep their memory, also the tiles beyond a smaller frame.
            tiles.resize_with(tiles.len().max(count), Vec::new);
            tiles.iter_mut().for_each(Vec::clear);
            for (job, projected) in run.clone().zip(&jobs[run]) {
                for local in 0..projected.splats.len() {
                    let id = Id::new(job, local);
                    for_each_tile(projected, local, culling, grid, &rows, |tile| {
                        tiles[tile - first_tile].push(id);
                    });
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

/// Calls `visit` with each tile within `rows` that `culling` assigns the splat to.
#[inline(always)]
fn for_each_tile(
    job: &Projected,
    local: usize,
    culling: Culling,
    grid: &Grid,
    rows: &Range<usize>,
    mut visit: impl FnMut(usize),
) {
    let ([columns, _], [width, height]) = (grid.tiles(), grid.tile_size());
    let rect = job.rects[local];
    let (first_x, last_x) = (rect.x0 as usize / width, (rect.x1 as usize - 1) / width);
    let (top_y, bottom_y) = (rect.y0 as usize / height, (rect.y1 as usize - 1) / height);
    let (first_y, end_y) = (top_y.max(rows.start), (bottom_y + 1).min(rows.end));
    if end_y <= first_y {
        return;
    }
    let last_y = end_y - 1;
    if first_x == last_x && top_y == bottom_y {
        visit(first_y * columns + first_x);
        return;
    }
    if first_x == last_x || top_y == bottom_y || !matches!(culling, Culling::AccuTile | Culling::Exact) {
        // The box is tight: a support in a single row or column of tiles reaches every tile of the box.
        for y in first_y..=last_y {
            for x in first_x..=last_x {
                visit(y * columns + x);
            }
        }
        return;
    }
    let splat = &job.splats[local];
    // From places counted from the first pixel to positions.
    let [origin_x, origin_y] = grid.origin;
    for y in first_y..=last_y {
        let top = (y * height) as f32 + origin_y;
        let bottom = top + (height - 1) as f32;
        let (mut from, mut to) = (first_x, last_x);
        if culling == Culling::AccuTile {
            let [left, right] = splat.x_span(top, bottom);
            from = from.max(((left - origin_x).max(0.0) as usize) / width);
            to = to.min(((right - origin_x).max(0.0) as usize) / width);
        }
        for x in from..=to {
            let left = (x * width) as f32 + origin_x;
            let right = left + (width - 1) as f32;
            if culling != Culling::Exact || splat.reaches(left, top, right, bottom) {
                visit(y * columns + x);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::splat::PixelRect;
    use super::*;

    /// Bands cover all rows in order. No band exceeds the entry limit, unless a single row does.
    #[test]
    fn bands_have_room() {
        let rect = |x0, y0, x1, y1| PixelRect { x0, y0, x1, y1 };
        // Ten rows of four columns: a splat everywhere, and ten in the fourth row.
        let mut rects = vec![rect(0, 0, 128, 160)];
        rects.extend([rect(0, 48, 128, 64); 10]);
        let jobs = [Projected { rects, ..Projected::default() }];
        let grid = Grid::native([128, 160]);
        assert_eq!(Bins::bands(&jobs, &grid, 1000), std::iter::once(0..10).collect::<Vec<_>>());
        assert_eq!(Bins::bands(&jobs, &grid, 12), [0..3, 3..4, 4..7, 7..10]);
        assert_eq!(Bins::bands(&jobs, &grid, 1).len(), 10);
        // Tiles of a coarser frame span more pixels: five rows of two columns, the ten splats in the second.
        let coarse = Grid { stride: 2, size: [64, 80], ..grid };
        assert_eq!(Bins::bands(&jobs, &coarse, 6), [0..1, 1..2, 2..5]);
    }
}
