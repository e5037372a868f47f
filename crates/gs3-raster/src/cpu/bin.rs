//! Splats to tiles, in one pass. The lists keep their memory from frame to frame, so no counting pass is needed.

use std::ops::Range;

use rayon::prelude::*;

use super::grid::Grid;
use super::project::Projected;
use super::splat::PixelRect;
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

/// A part of a frame, in tiles: whole rows, or a piece of one row.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Part {
    /// Rows of tiles.
    pub rows: Range<usize>,
    /// Columns of tiles.
    pub columns: Range<usize>,
}

impl Part {
    /// The place of `tile`, a column and a row in the part, among the part's tiles.
    #[inline(always)]
    const fn index(&self, [column, row]: [usize; 2]) -> usize {
        (row - self.rows.start) * (self.columns.end - self.columns.start) + column - self.columns.start
    }

    const fn len(&self) -> usize {
        (self.rows.end - self.rows.start) * (self.columns.end - self.columns.start)
    }
}

/// Splats by tile, in scene order, independent of the threads.
#[derive(Default)]
pub struct Bins {
    /// For each run of jobs, the lists of its splats, `[tiles or more]`: there are more after a larger part.
    runs: Vec<Vec<Vec<Id>>>,
    /// The tiles with lists.
    part: Part,
}

/// Bytes of memory for each entry: its id, and as much again while lists grow.
pub const ENTRY_BYTES: u64 = 2 * size_of::<Id>() as u64;

impl Bins {
    /// The splats of `tile`, in scene order: one slice for each run of jobs, empty if none of its splats touches the
    /// tile.
    #[inline(always)]
    pub fn of_tile(&self, tile: [usize; 2]) -> impl Iterator<Item = &[Id]> {
        let index = self.part.index(tile);
        self.runs.iter().map(move |tiles| &tiles[index][..])
    }

    /// Whether no splat touches `tile`.
    pub fn is_empty(&self, tile: [usize; 2]) -> bool {
        self.of_tile(tile).all(<[Id]>::is_empty)
    }

    /// Parts of `grid`, in the order of their tiles. Each part has at most `most` entries or is one tile.
    pub fn parts(jobs: &[Projected], grid: &Grid, most: u64) -> Vec<Part> {
        let ([columns, rows], [width, height]) = (grid.tiles(), grid.tile_size());
        if bound_of_entries(jobs, [width, height]) <= most {
            return vec![Part { rows: 0..rows, columns: 0..columns }];
        }
        let span =
            |from: u16, to: u16, side: usize| usize::from(from) / side..(usize::from(to) - 1) / side + 1;
        let of_rows = entries(jobs, rows, |rect| {
            Some((span(rect.y0, rect.y1, height), span(rect.x0, rect.x1, width).len()))
        });
        let mut parts = Vec::new();
        for rows in groups(&of_rows, most) {
            if of_rows[rows.clone()].iter().sum::<u64>() <= most {
                parts.push(Part { rows, columns: 0..columns });
                continue;
            }
            // A single row with too many.
            let row = rows.start;
            let of_columns = entries(jobs, columns, |rect| {
                span(rect.y0, rect.y1, height).contains(&row).then(|| (span(rect.x0, rect.x1, width), 1))
            });
            let pieces = groups(&of_columns, most).into_iter();
            parts.extend(pieces.map(|columns| Part { rows: rows.clone(), columns }));
        }
        parts
    }

    /// Fills the bins of the tiles of `part`.
    pub fn fill(&mut self, jobs: &[Projected], grid: &Grid, part: &Part, culling: Culling) {
        self.part = part.clone();
        let runs = balanced_runs(jobs, rayon::current_num_threads());
        self.runs.resize_with(runs.len(), Vec::new);
        self.runs.par_iter_mut().zip(runs).for_each(|(tiles, run)| {
            // Tiles keep their memory, also the tiles beyond a smaller part.
            tiles.resize_with(tiles.len().max(part.len()), Vec::new);
            tiles.iter_mut().for_each(Vec::clear);
            for (job, projected) in run.clone().zip(&jobs[run]) {
                for local in 0..projected.splats.len() {
                    let id = Id::new(job, local);
                    for_each_tile(projected, local, culling, grid, part, |tile| {
                        tiles[part.index(tile)].push(id);
                    });
                }
            }
        });
    }
}

/// Upper bound of the entries of all tiles, from the splats' boxes: a box of w×h pixels meets at most (w/W + 2)·(h/H + 2) tiles of
/// W×H pixels.
fn bound_of_entries(jobs: &[Projected], [width, height]: [usize; 2]) -> u64 {
    let [width, height] = [width as u64, height as u64];
    let of_job = |job: &Projected| {
        let [mut widths, mut heights, mut areas] = [0_u64; 3];
        for rect in &job.rects {
            let [w, h] = [u64::from(rect.x1 - rect.x0), u64::from(rect.y1 - rect.y0)];
            (widths, heights, areas) = (widths + w, heights + h, areas + w * h);
        }
        let tiles = 4 * width * height * job.rects.len() as u64;
        (areas + 2 * (widths * height + heights * width) + tiles).div_ceil(width * height)
    };
    jobs.par_iter().map(of_job).sum()
}

/// Upper bound of the entries of each of `count` rows or columns, from the splats' boxes. `of_box` gives the rows that a box
/// meets and its entries in each.
fn entries(
    jobs: &[Projected],
    count: usize,
    of_box: impl Fn(&PixelRect) -> Option<(Range<usize>, usize)> + Sync,
) -> Vec<u64> {
    // As differences from the row before.
    let zeros = || vec![0_i64; count + 1];
    let differences = jobs.par_iter().fold(zeros, |mut differences, job| {
        for (rows, of_each) in job.rects.iter().filter_map(&of_box) {
            differences[rows.start] += of_each as i64;
            differences[rows.end] -= of_each as i64;
        }
        differences
    });
    let differences = differences.reduce(zeros, |mut sum, differences| {
        sum.iter_mut().zip(differences).for_each(|(a, b)| *a += b);
        sum
    });
    let sums = differences[..count].iter().scan(0, |sum, difference| {
        *sum += difference;
        Some(*sum as u64)
    });
    sums.collect()
}

/// Groups of neighbours that have at most `most` entries together, or are one.
fn groups(entries: &[u64], most: u64) -> Vec<Range<usize>> {
    let mut groups = Vec::new();
    let (mut start, mut sum) = (0, 0);
    for (i, of_one) in entries.iter().enumerate() {
        if i > start && sum + of_one > most {
            groups.push(start..i);
            (start, sum) = (i, 0);
        }
        sum += of_one;
    }
    groups.push(start..entries.len());
    groups
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

/// Calls `visit` with each tile (column, row) of `part` that `culling` assigns the splat to.
#[inline(always)]
fn for_each_tile(
    job: &Projected,
    local: usize,
    culling: Culling,
    grid: &Grid,
    part: &Part,
    mut visit: impl FnMut([usize; 2]),
) {
    let [width, height] = grid.tile_size();
    let rect = job.rects[local];
    let (left_x, right_x) = (rect.x0 as usize / width, (rect.x1 as usize - 1) / width);
    let (top_y, bottom_y) = (rect.y0 as usize / height, (rect.y1 as usize - 1) / height);
    let (first_x, end_x) = (left_x.max(part.columns.start), (right_x + 1).min(part.columns.end));
    let (first_y, end_y) = (top_y.max(part.rows.start), (bottom_y + 1).min(part.rows.end));
    if end_x <= first_x || end_y <= first_y {
        return;
    }
    let (last_x, last_y) = (end_x - 1, end_y - 1);
    if left_x == right_x && top_y == bottom_y {
        visit([first_x, first_y]);
        return;
    }
    if left_x == right_x || top_y == bottom_y || !matches!(culling, Culling::AccuTile | Culling::Exact) {
        // The box is tight: a support in a single row or column of tiles reaches every tile of the box.
        for y in first_y..=last_y {
            for x in first_x..=last_x {
                visit([x, y]);
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
                visit([x, y]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Boxes meet no more tiles than the bound says, wherever they lie. The bound is at most five times what boxes at the worst place
    /// meet.
    #[test]
    fn entries_have_a_bound() {
        let (side, [width, height]) = (200_u16, [32_u16, 16]);
        for (w, h) in [(1, 1), (2, 1), (31, 15), (32, 16), (33, 17), (34, 18), (65, 100), (200, 200)] {
            let places = (0..=side - h).flat_map(|y| (0..=side - w).map(move |x| [x, y]));
            let rects: Vec<PixelRect> =
                places.map(|[x, y]| PixelRect { x0: x, y0: y, x1: x + w, y1: y + h }).collect();
            let tiles = |rect: &PixelRect| {
                let along = |from: u16, to: u16, side: u16| u64::from((to - 1) / side - from / side + 1);
                along(rect.x0, rect.x1, width) * along(rect.y0, rect.y1, height)
            };
            let most = rects.iter().map(tiles).max().expect("one") * rects.len() as u64;
            let jobs = [Projected { rects, ..Projected::default() }];
            let bound = bound_of_entries(&jobs, [width, height].map(usize::from));
            assert!(most <= bound, "{w}×{h}: {most} entries, bound {bound}");
            assert!(bound <= most * 5, "{w}×{h}: {most} entries, bound {bound}");
        }
    }

    /// Parts cover all tiles in order. No part exceeds the entry limit, unless a single tile does.
    #[test]
    fn parts_have_room() {
        let rect = |x0, y0, x1, y1| PixelRect { x0, y0, x1, y1 };
        // Ten rows of four columns: a splat everywhere, and ten in the fourth row.
        let mut rects = vec![rect(0, 0, 128, 160)];
        rects.extend([rect(0, 48, 128, 64); 10]);
        let jobs = [Projected { rects, ..Projected::default() }];
        let grid = Grid::native(gs3_scene::Size::new(128, 160));
        let rows = |rows| Part { rows, columns: 0..4 };
        let piece = |row, columns| Part { rows: row..row + 1, columns };
        assert_eq!(Bins::parts(&jobs, &grid, 1000), [rows(0..10)]);
        assert_eq!(Bins::parts(&jobs, &grid, 44), [rows(0..3), rows(3..4), rows(4..10)]);
        // 44 entries in the fourth row, 11 in each of its tiles.
        assert_eq!(Bins::parts(&jobs, &grid, 24), [rows(0..3), piece(3, 0..2), piece(3, 2..4), rows(4..10)]);
        let one = Bins::parts(&jobs, &grid, 1);
        assert_eq!((one.len(), &one[4]), (40, &piece(1, 0..1)));
        // Tiles of a coarser frame span more pixels: five rows of two columns, the ten splats in the second.
        let coarse = Grid { stride: 2, size: [64, 80], ..grid };
        let rows = |rows| Part { rows, columns: 0..2 };
        assert_eq!(Bins::parts(&jobs, &coarse, 22), [rows(0..1), rows(1..2), rows(2..5)]);
    }
}
