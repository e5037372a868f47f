//! Splats to tiles: a counting sort by tile.

use std::ops::Range;
use std::sync::atomic::{AtomicU32, Ordering};

use rayon::prelude::*;

use super::project::Projected;
use crate::settings::Culling;

/// Tile size in pixels. 32×16 keeps a tile's blending state (up to 22 values a pixel) near the first-level cache,
/// gives bands of 16 rows to share among threads, and its 4×4 blocks fill a 32-bit mask.
pub const TILE_WIDTH: usize = 32;
/// See [`TILE_WIDTH`].
pub const TILE_HEIGHT: usize = 16;

/// Bits of an id that name the splat within its projection job.
const LOCAL_BITS: u32 = 16;

/// Largest number of Gaussians in a projection job.
pub const MAX_JOB_SIZE: usize = 1 << LOCAL_BITS;

/// Splats by tile, in scene order whatever thread wrote them. An id holds the projection job in its upper half and the
/// index within in its lower.
#[derive(Default)]
pub struct Bins {
    /// Start of each tile's ids, `[tiles + 1]`.
    offsets: Vec<usize>,
    ids: Vec<AtomicU32>,
    groups: Vec<Group>,
}

/// What a thread finds of its jobs.
#[derive(Default)]
struct Group {
    /// Tile and id of every splat that touches the tile, in scene order.
    hits: Vec<[u32; 2]>,
    /// `[tiles]`: how many they are, then where the next goes.
    cursors: Vec<usize>,
}

impl Bins {
    /// Job and index of the splats of `tile`, in scene order.
    pub fn of_tile(&self, tile: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.ids[self.offsets[tile]..self.offsets[tile + 1]].iter().map(|id| {
            let id = id.load(Ordering::Relaxed);
            ((id >> LOCAL_BITS) as usize, (id & (MAX_JOB_SIZE as u32 - 1)) as usize)
        })
    }

    /// Fills the bins of a `columns`×`rows` grid of tiles.
    pub fn fill(&mut self, jobs: &[Projected], columns: usize, rows: usize, culling: Culling) {
        let tiles = columns * rows;
        let runs = balanced_groups(jobs, rayon::current_num_threads());
        self.groups.resize_with(runs.len(), Group::default);
        self.groups.par_iter_mut().zip(runs).for_each(|(Group { hits, cursors }, run)| {
            hits.clear();
            cursors.clear();
            cursors.resize(tiles, 0);
            for (job, projected) in run.clone().zip(&jobs[run]) {
                for local in 0..projected.splats.len() {
                    let id = (job << LOCAL_BITS | local) as u32;
                    for_each_tile(projected, local, culling, columns, |tile| {
                        hits.push([tile as u32, id]);
                        cursors[tile] += 1;
                    });
                }
            }
        });

        self.offsets.clear();
        self.offsets.reserve(tiles + 1);
        let mut total = 0;
        for tile in 0..tiles {
            self.offsets.push(total);
            for Group { cursors, .. } in &mut self.groups {
                total += std::mem::replace(&mut cursors[tile], total);
            }
        }
        self.offsets.push(total);
        if self.ids.len() < total {
            self.ids.resize_with(total, AtomicU32::default);
        }

        let ids = &self.ids;
        self.groups.par_iter_mut().for_each(|Group { hits, cursors }| {
            for &[tile, id] in &*hits {
                let cursor = &mut cursors[tile as usize];
                ids[*cursor].store(id, Ordering::Relaxed);
                *cursor += 1;
            }
        });
    }
}

/// Splits the jobs into `count` runs of about equally many splats.
fn balanced_groups(jobs: &[Projected], count: usize) -> Vec<Range<usize>> {
    let total: usize = jobs.iter().map(|job| job.splats.len()).sum();
    let share = total.div_ceil(count).max(1);
    let mut groups = Vec::with_capacity(count);
    let (mut start, mut in_group) = (0, 0);
    for (i, job) in jobs.iter().enumerate() {
        in_group += job.splats.len();
        if in_group >= share {
            groups.push(start..i + 1);
            (start, in_group) = (i + 1, 0);
        }
    }
    if start < jobs.len() {
        groups.push(start..jobs.len());
    }
    groups
}

/// Calls `visit` with each tile that `culling` assigns the splat to.
#[inline(always)]
fn for_each_tile(
    job: &Projected,
    local: usize,
    culling: Culling,
    columns: usize,
    mut visit: impl FnMut(usize),
) {
    let rect = job.rects[local];
    let (first_x, last_x) = (rect.x0 as usize / TILE_WIDTH, (rect.x1 as usize - 1) / TILE_WIDTH);
    let (first_y, last_y) = (rect.y0 as usize / TILE_HEIGHT, (rect.y1 as usize - 1) / TILE_HEIGHT);
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
    for y in first_y..=last_y {
        let (top, bottom) = ((y * TILE_HEIGHT) as f32, ((y + 1) * TILE_HEIGHT - 1) as f32);
        let (mut from, mut to) = (first_x, last_x);
        if culling == Culling::AccuTile {
            let [left, right] = splat.x_span(top, bottom);
            from = from.max((left.max(0.0) as usize) / TILE_WIDTH);
            to = to.min((right.max(0.0) as usize) / TILE_WIDTH);
        }
        for x in from..=to {
            let (left, right) = ((x * TILE_WIDTH) as f32, ((x + 1) * TILE_WIDTH - 1) as f32);
            if culling != Culling::Exact || splat.reaches(left, top, right, bottom) {
                visit(y * columns + x);
            }
        }
    }
}
