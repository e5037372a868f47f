//! Slabs: parts of a frame by depth, made one after the other, front to back, so that the splats of huge scenes need not be in
//! memory at once. Pixels keep their state from one slab to the next, so the frame has the bits of a frame made at once.

use gs3_scene::Gaussians;
use rayon::prelude::*;

use super::blend::{self, Block, plane};
use super::cover::BLOCKS;
use crate::chunk::{CHUNK, Chunk, Frustum};
use crate::view::View;

/// Frames with more Gaussians in view are made in slabs. Up to here, at most 310 MB of splats, one slab is faster, because exact
/// pixels share its splats with the low-resolution frame. The largest capture measured has 3.4 million Gaussians.
pub const MOST_AT_ONCE: usize = 7 << 19;

/// Gaussians of a slab, about: at most 11 MB of splats. With twice as many, a frame takes an eighth less time and 40 MB more
/// (13.6 million Gaussians in view; docs/reliability.md).
pub const SLAB: usize = 1 << 17;

/// One of so many Gaussians tells where to cut.
const TELLING: usize = 64;

/// View-space depths z: above the first, below the second.
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

/// Which of a frame's slabs one is; both where the frame has one slab.
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

/// The slabs of `view`, front to back. Every Gaussian in view is in one of them.
pub fn slabs(gaussians: &Gaussians, chunks: &[Chunk], view: &View, [most, of_slab]: [usize; 2]) -> Vec<Slab> {
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
    let depth = |i: usize| {
        let offset: [f32; 3] = std::array::from_fn(|k| gaussians.means[k][i] - view.origin[k]);
        view.rotate(offset)[2]
    };
    let of_chunk = |c: &usize| c * CHUNK..((c + 1) * CHUNK).min(gaussians.len());
    let telling = seen.par_iter().flat_map_iter(|c| of_chunk(c).step_by(TELLING).map(depth));
    let mut depths: Vec<f32> = telling.filter(|z| *z > view.near && *z < view.far).collect();
    depths.par_sort_unstable_by(f32::total_cmp);
    let step = (of_slab / TELLING).max(1);
    let mut slabs = Vec::new();
    let mut near = view.near;
    for far in depths.iter().copied().skip(step).step_by(step) {
        // A slab that begins below `far` ends above.
        if far > near.next_up() {
            slabs.push(Slab { near, far });
            near = far.next_down();
        }
    }
    slabs.push(Slab { near, far: view.far });
    slabs
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

/// Whether a pixel of the block is not finished.
pub fn is_open(block: &Block) -> bool {
    block.0[plane::TRANSMITTANCE].iter().any(|t| *t > 0.0)
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
        assert_eq!(slabs(gaussians, &chunks, &view, [count, 1]), [whole]);
        let found = slabs(gaussians, &chunks, &view, [0, 50_000]);
        assert!((6..=11).contains(&found.len()), "{found:?}");
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
        assert!(slabs(&flat, &chunks, &view, [0, 50_000]).len() <= 2);
    }
}
