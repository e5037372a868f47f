//! Slabs: parts of a frame by depth. They are made one after the other, front to back, so only one slab's splats are in memory.
//! Pixels keep their state from one slab to the next. So the frame has the bits of a frame made at once.

use fearless_simd::{Level, dispatch};
use gs3_scene::Gaussians;
use rayon::prelude::*;

use super::bin::{Bins, TILE_HEIGHT, TILE_WIDTH};
use super::blend::{self, Block, TileScratch};
use super::cover::BLOCKS;
use super::grid::Grid;
use super::project::Projected;
use super::resolve::{Band, Resolver};
use crate::chunk::{CHUNK, Chunk, Frustum};
use crate::view::View;

/// Frames with more Gaussians in view are made in slabs. A splat takes 72 bytes (84 with a normal), so these are 264 MB
/// (308 MB) at most. Up to here one slab is faster, because exact pixels share its splats with the low-resolution frame. The largest capture
/// measured has 3.4 million Gaussians.
pub const MOST_AT_ONCE: usize = 7 << 19;

/// Gaussians of a slab, about: 9 MB of splats (11 MB with normals). With twice as many, a native frame of 1920×1080 takes an
/// eighth less time and 40 MB more (the four copies of `hqgarden` of docs/reliability.md).
pub const SLAB: usize = 1 << 17;

/// A slab has at least one Gaussian for so many values of state, which are read and written for each slab: of larger frames the
/// same share of the time as of a native frame of 1920×1080, which has 80 · [`SLAB`] values.
const VALUES_PER_GAUSSIAN: usize = 80;

/// Chunks are visited this many times a frame at most, on average. In scenes without spatial order every chunk is in every slab;
/// such frames have fewer slabs. A visit for nothing reads 12 of a Gaussian's 44 bytes of geometry, and computes its depth alone.
const MOST_VISITS: usize = 16;

/// One of so many Gaussians tells where to cut: four of a chunk. A slab of [`SLAB`] Gaussians has 2,048 of them.
const TELLING: usize = 64;

/// View-space depths z above `near` and below `far`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slab {
    pub near: f32,
    pub far: f32,
}

impl Slab {
    /// The part of `view` in the slab.
    pub const fn of(self, view: &View) -> View {
        View { near: self.near, far: self.far, ..*view }
    }
}

/// Which of a frame's slabs one is. A frame's only slab is both.
#[derive(Clone, Copy, Debug)]
pub struct SlabPlace {
    pub is_first: bool,
    pub is_last: bool,
}

impl SlabPlace {
    /// Slab `k` of `count`.
    pub const fn new(k: usize, count: usize) -> Self {
        Self { is_first: k == 0, is_last: k + 1 == count }
    }
}

/// The slabs of `view`, front to back. Every Gaussian in view is in one of them. The state of all pixels is `values` numbers.
pub fn slabs(
    gaussians: &Gaussians,
    chunks: &[Chunk],
    view: &View,
    values: usize,
    [most, of_slab]: [usize; 2],
) -> Vec<Slab> {
    let whole = Slab { near: view.near, far: view.far };
    if gaussians.len() <= most {
        return vec![whole];
    }
    let frustum = Frustum::new(view);
    let seen = |c: &usize| frustum.may_see(&chunks[*c]);
    let seen: Vec<usize> = (0..chunks.len()).into_par_iter().filter(seen).collect();
    if seen.len() * CHUNK <= most {
        return vec![whole];
    }
    let depth = |position: [f32; 3]| {
        view.rotate(std::array::from_fn(|k| position[k] - view.origin[k] - view.origin_rest[k]))[2]
    };
    let of_chunk = |c: &usize| {
        let members = c * CHUNK..((c + 1) * CHUNK).min(gaussians.len());
        members.step_by(TELLING).map(|i| depth([0, 1, 2].map(|k| gaussians.means[k][i])))
    };
    let telling = seen.par_iter().flat_map_iter(of_chunk);
    let mut depths: Vec<f32> = telling.filter(|z| *z > view.near && *z < view.far).collect();
    depths.par_sort_unstable_by(f32::total_cmp);
    let ranges: Vec<[f32; 2]> = seen
        .par_iter()
        .map(|c| {
            let Chunk { center, radius, .. } = chunks[*c];
            [depth(center) - radius, depth(center) + radius]
        })
        .collect();
    let mut step = (of_slab.max(values / VALUES_PER_GAUSSIAN) / TELLING).max(1);
    loop {
        let slabs = cut(&depths, step, whole);
        if slabs.len() == 1 || visits(&slabs, &ranges) <= MOST_VISITS * seen.len() {
            return slabs;
        }
        step *= 2;
    }
}

/// Cuts `whole` at every `step`th of the sorted `depths`. Equal depths stay in one slab.
fn cut(depths: &[f32], step: usize, whole: Slab) -> Vec<Slab> {
    let mut slabs = Vec::new();
    let mut near = whole.near;
    for far in depths.iter().copied().skip(step).step_by(step) {
        if far > near.next_up() {
            slabs.push(Slab { near, far });
            near = far.next_down();
        }
    }
    slabs.push(Slab { near, far: whole.far });
    slabs
}

/// How many slabs the `ranges` of depths meet, all together.
fn visits(slabs: &[Slab], ranges: &[[f32; 2]]) -> usize {
    let met = |[low, high]: &[f32; 2]| {
        let first = slabs.partition_point(|slab| slab.far <= *low);
        slabs.partition_point(|slab| slab.near < *high).saturating_sub(first)
    };
    ranges.par_iter().map(met).sum()
}

/// The state of a tile between two slabs.
pub struct TileState {
    /// The blocks with open pixels.
    pub open: u32,
    /// [`blend::planes`] of each block.
    planes: Vec<[f32; 16]>,
}

impl TileState {
    /// The state of a tile of `outputs`.
    pub fn new(outputs: usize) -> Self {
        Self { open: 0, planes: vec![[0.0; 16]; BLOCKS * blend::planes(outputs)] }
    }

    /// Stores `blocks`, those in the bit mask `open` with open pixels.
    pub fn store(&mut self, blocks: &[Block; BLOCKS], outputs: usize, open: u32) {
        let planes = blend::planes(outputs);
        self.open = open;
        for (block, state) in blocks.iter().zip(self.planes.chunks_exact_mut(planes)) {
            state.copy_from_slice(&block.0[..planes]);
        }
    }

    /// Loads all blocks. Returns the mask of those with open pixels.
    pub fn load(&self, blocks: &mut [Block; BLOCKS], outputs: usize) -> u32 {
        let planes = blend::planes(outputs);
        for (block, state) in blocks.iter_mut().zip(self.planes.chunks_exact(planes)) {
            block.0[..planes].copy_from_slice(state);
        }
        self.open
    }
}

/// What the tiles of a slab are blended from.
pub struct Blending<'a> {
    pub jobs: &'a [Projected],
    pub bins: &'a Bins,
    pub grid: &'a Grid,
    pub resolver: &'a Resolver,
    pub place: SlabPlace,
    pub level: Level,
}

impl Blending<'_> {
    /// Blends a tile's splats over its `state` of the slab before. The last slab goes to `out`. Frames of one slab have no state.
    pub fn tile<const OUTPUTS: usize>(
        &self,
        tile: [usize; 2],
        mut state: Option<&mut TileState>,
        scratch: &mut TileScratch,
        out: &mut Band<'_>,
    ) {
        let Self { jobs, bins, grid, resolver, place, level } = *self;
        let is_idle = state.as_ref().is_some_and(|state| state.open == 0 || bins.is_empty(tile));
        if is_idle && !place.is_first && !place.is_last {
            return;
        }
        let left = [grid.size[0] - tile[0] * TILE_WIDTH, grid.size[1] - tile[1] * TILE_HEIGHT];
        let mut open = match &state {
            Some(state) if !place.is_first => state.load(&mut scratch.blocks, OUTPUTS),
            _ => blend::start_tile::<OUTPUTS>(&mut scratch.blocks, left),
        };
        dispatch!(level, s => {
            if open != 0 {
                open = blend::blend_tile::<_, OUTPUTS>(s, jobs, bins, tile, grid, resolver.rules, open, scratch);
            }
            match &mut state {
                Some(state) if !place.is_last => state.store(&scratch.blocks, OUTPUTS, open),
                _ => resolver.resolve::<_, OUTPUTS>(s, &mut scratch.blocks, tile, grid, out),
            }
        });
    }
}

/// Whether a pixel of a block is not finished, by the transmittances of its state.
pub fn is_open(transmittances: &[f32; 16]) -> bool {
    transmittances.iter().any(|t| *t > 0.0)
}

#[cfg(test)]
mod tests {
    use gs3_scene::demo;

    use super::*;
    use crate::chunk;
    use crate::settings::{Outputs, RasterSettings};

    #[test]
    fn slabs_share_out_all_depths() {
        let scene = demo::scene().expect("the demo");
        let camera = demo::path().cameras()[0];
        let view = View::new(&camera, &RasterSettings::new(Outputs::Color), 0.2);
        let (gaussians, chunks) = (scene.gaussians(), chunk::of_gaussians(scene.gaussians()));
        let whole = Slab { near: view.near, far: view.far };
        let count = gaussians.len();
        assert_eq!(slabs(gaussians, &chunks, &view, 0, [count, 1]), [whole]);
        let found = slabs(gaussians, &chunks, &view, 0, [0, 50_000]);
        assert!((6..=11).contains(&found.len()), "{found:?}");
        // Large pictures have larger slabs.
        let large = slabs(gaussians, &chunks, &view, 100_000 * VALUES_PER_GAUSSIAN, [0, 50_000]);
        assert_eq!(large.len(), found.len().div_ceil(2));
        assert_eq!((found[0].near, found[found.len() - 1].far), (whole.near, whole.far));
        // Each begins with the first depth beyond the one before: depths from `far` on are in the next.
        for pair in found.windows(2) {
            assert_eq!(pair[1].near.next_up(), pair[0].far);
            assert!(pair[0].near.next_up() < pair[0].far);
        }
        // As many Gaussians in each as it asks for, but for the chunks at the edges of the view.
        let depth =
            |i: usize| view.rotate(std::array::from_fn(|k| gaussians.means[k][i] - view.origin[k]))[2];
        for slab in &found {
            let inside = (0..count).filter(|i| depth(*i) > slab.near && depth(*i) < slab.far).count();
            assert!((1..150_000).contains(&inside), "{slab:?}: {inside}");
        }
        // Where all Gaussians have one depth, there is nothing to cut.
        let mut flat = gaussians.clone();
        let last = found.last().expect("one");
        let inside = (0..count).find(|i| depth(*i) > last.near).expect("one");
        for plane in &mut flat.means {
            let position = plane[inside];
            plane.fill(position);
        }
        let chunks = chunk::of_gaussians(&flat);
        assert!(slabs(&flat, &chunks, &view, 0, [0, 50_000]).len() <= 2);
    }

    #[test]
    fn scenes_without_order_have_fewer_slabs() {
        let scene = demo::scene().expect("the demo");
        let camera = demo::path().cameras()[0];
        let view = View::new(&camera, &RasterSettings::new(Outputs::Color), 0.2);
        let ordered = scene.gaussians();
        // 7,919 is a prime that does not divide the number of Gaussians, so every one comes once.
        let count = ordered.len();
        let mut mixed = ordered.clone();
        for (from, to) in ordered.means.iter().zip(&mut mixed.means) {
            (0..count).for_each(|i| to[i] = from[i * 7_919 % count]);
        }
        let of = |gaussians| slabs(gaussians, &chunk::of_gaussians(gaussians), &view, 0, [0, 2_000]).len();
        let [ordered, mixed] = [of(ordered), of(&mixed)];
        assert!((8..=16).contains(&mixed) && 2 * ordered >= 3 * mixed, "{ordered} and {mixed} slabs");
    }
}
