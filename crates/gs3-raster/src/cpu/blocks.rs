//! Exact blocks: pixels of the native image, made from the splats of a low-resolution frame.
//!
//! The low-resolution frame has projected, coloured and binned all splats of the native image. Its tiles span stride times as
//! many pixels along each axis: stride² native tiles. The splats that meet a tile's blocks are sorted. The blocks of a native
//! tile are blended together, from the splats with a rectangle that meets one of them.

use fearless_simd::{Simd, dispatch};
use gs3_scene::{BLOCK_SIDE, Camera, ExactBlock, ExactBlocks, Margin};
use rayon::prelude::*;

use super::bin::{Bins, Id, TILE_HEIGHT, TILE_WIDTH};
use super::blend::{self, Block, COLOR, SAMPLES, TileScratch, TileSplats, plane};
use super::block_rows::{BlockRows, MAX_ROWS, MAX_STRIDE};
use super::block_table::BlockTable;
use super::cover::{BLOCK, BLOCKS_X, TileSamples};
use super::grid::Grid;
use super::project::{ProjectOutputs, Projected};
use super::resolve::Resolver;
use super::slabs::{self, SlabPlace};
use super::{LastFrame, Rasterizer};
use crate::settings::{RasterError, RasterSettings};
use crate::view::View;

const _: () = assert!(BLOCK == BLOCK_SIDE);

/// Scratch memory for blending a tile or its blocks; one per thread, reused.
#[derive(Default)]
pub(super) struct Scratch {
    pub(super) tile: TileScratch,
    /// The splats that meet the tile's blocks.
    found: Vec<Id>,
    /// For each splat taken, the native tiles with blocks that its rectangle meets. Bit `MAX_STRIDE · row + column` is a
    /// native tile.
    met: Vec<u64>,
    /// For each native tile, the splats taken that meet its blocks, front to back.
    lists: Vec<Vec<u32>>,
}

/// The blocks of one tile.
struct TileBlocks<'a> {
    tile: [usize; 2],
    /// Native tile by native tile, in rows from the top.
    places: &'a [[u16; 2]],
    out: &'a mut [ExactBlock],
    /// What blending needs from slab to slab besides `out`; empty in frames of one slab.
    states: &'a mut [BlockState],
}

/// The planes of a block's state that [`ExactBlock`] does not have: [`STATE_PLANES`].
type BlockState = [[f32; 16]; 4];

/// The first tells whether a block is open.
const STATE_PLANES: [usize; 4] = [plane::TRANSMITTANCE, plane::FINAL, plane::ALPHA_DX, plane::ALPHA_DY];

impl Rasterizer {
    /// Rasterizes the native image's pixels in blocks of 4×4, with the splats of the last frame of
    /// [`Self::rasterize_low_resolution`]. `places` are columns and rows of blocks. Blocks beyond the image are left
    /// out, and a block named twice is made once. Colours have the same bits as by [`Self::rasterize_image`] with the
    /// same camera. Derivatives are per pixel of the native image.
    ///
    /// # Errors
    /// [`RasterError::NoFrame`] if no low-resolution frame was made before, or the frame had only colour.
    pub fn rasterize_blocks(
        &mut self,
        places: &[[u16; 2]],
        out: &mut ExactBlocks,
    ) -> Result<(), RasterError> {
        let Some(last) = self.last.take() else { return Err(RasterError::NoFrame) };
        self.make_blocks::<SAMPLES>(&last, places, out);
        // Blocks have brought the splats of `view`.
        let is_shared = last.is_shared || !out.is_empty();
        self.last = Some(LastFrame { is_shared, ..last });
        Ok(())
    }

    /// Rasterizes the pixels of [`Self::rasterize_image`] with the same `camera` and `settings` in blocks of 4×4, without a frame before.
    /// `places` are as in [`Self::rasterize_blocks`]. Blocks get colours only: derivatives and depths are 0. Only Gaussians
    /// that reach a block are coloured and sorted.
    ///
    /// # Errors
    /// [`RasterError`] if a setting is out of range; `out` is unchanged then.
    pub fn rasterize_image_blocks(
        &mut self,
        camera: &Camera,
        settings: &RasterSettings,
        places: &[[u16; 2]],
        out: &mut ExactBlocks,
    ) -> Result<(), RasterError> {
        settings.check()?;
        self.last = None;
        let settings = RasterSettings { margin: Margin::NONE, ..*settings };
        let view = View::new(camera, &settings, self.scene.details().near);
        let (grid, size) = (Grid::of_blocks(view.size), view.size.to_usize());
        self.make_blocks::<COLOR>(&LastFrame { view, grid, settings, size, is_shared: false }, places, out);
        Ok(())
    }

    fn make_blocks<const OUTPUTS: usize>(
        &mut self,
        last: &LastFrame,
        places: &[[u16; 2]],
        out: &mut ExactBlocks,
    ) {
        let LastFrame { view, grid, settings, size, is_shared } = last;
        // Tiles start at block boundaries: margins are whole blocks.
        let native_of = |[x, y]: [u16; 2]| {
            [
                (usize::from(x) * BLOCK + grid.before[0]) / TILE_WIDTH,
                (usize::from(y) * BLOCK + grid.before[1]) / TILE_HEIGHT,
            ]
        };
        let tile_of = |place: [u16; 2]| native_of(place).map(|at| at / grid.stride);
        let within =
            |[x, y]: &[u16; 2]| usize::from(*x) * BLOCK < size[0] && usize::from(*y) * BLOCK < size[1];
        // By tile, then by native tile, both in rows. Keys are made once: a comparison would divide twelve times.
        let keyed = |place: [u16; 2]| {
            let ([column, row], [native_column, native_row]) = (tile_of(place), native_of(place));
            let numbers = [row, column, native_row, native_column];
            (numbers.iter().fold(0, |key, number| key << 16 | *number as u64), [place[1], place[0]])
        };
        let mut keys: Vec<_> = places.iter().copied().filter(within).map(keyed).collect();
        keys.par_sort_unstable();
        keys.dedup();
        out.places.clear();
        out.places.extend(keys.into_iter().map(|(_, [y, x])| [x, y]));
        // What blocks held before is overwritten. New ones are written by all threads: one alone takes long to touch the new
        // pages of a frame that is exact as a whole.
        out.blocks.truncate(out.places.len());
        let new = out.places.len() - out.blocks.len();
        out.blocks.par_extend(rayon::iter::repeat_n(ExactBlock::EMPTY, new));
        if out.is_empty() {
            return;
        }

        let slabs = if *is_shared { self.slabs.clone() } else { self.slabs_of::<OUTPUTS>(view, grid) };
        self.slabs.clone_from(&slabs);
        let mut states = vec![[[0.0; 16]; 4]; if slabs.len() > 1 { out.places.len() } else { 0 }];
        let mut rest_states = &mut states[..];
        let mut tiles = Vec::new();
        let mut rest = &mut out.blocks[..];
        for places in out.places.chunk_by(|a, b| tile_of(*a) == tile_of(*b)) {
            let blocks = rest.split_off_mut(..places.len()).unwrap_or_default();
            let states = rest_states.split_off_mut(..places.len()).unwrap_or_default();
            tiles.push(TileBlocks { tile: tile_of(places[0]), places, out: blocks, states });
        }
        let resolver = Resolver::new(view, settings);
        // Only splats of a low-resolution frame are there already. Blocks alone need few of the image's splats.
        let wanted = (OUTPUTS == COLOR).then(|| BlockTable::new(&out.places, *size));
        for (k, slab) in slabs.iter().enumerate() {
            let slab_place = SlabPlace::new(k, slabs.len());
            // The splats of earlier slabs are no longer in memory.
            let is_at_hand = *is_shared && slabs.len() == 1;
            if !is_at_hand {
                let outputs = ProjectOutputs { depths: OUTPUTS >= SAMPLES, ..ProjectOutputs::default() };
                self.project(&slab.of(view), outputs, wanted.as_ref());
                self.parts = Bins::parts(&self.jobs, grid, self.most_entries);
                if let [whole] = &self.parts[..] {
                    self.bins.fill(&self.jobs, grid, whole, self.culling);
                }
            }
            let is_whole = self.parts.len() == 1;
            let mut tiles = &mut tiles[..];
            for part in &self.parts {
                // Parts are in the order of tiles.
                let end = (part.rows.end - 1, part.columns.end);
                let count = tiles.partition_point(|tile| (tile.tile[1], tile.tile[0]) < end);
                let of_part = tiles.split_off_mut(..count).unwrap_or_default();
                if of_part.is_empty() {
                    continue;
                }
                if !is_whole {
                    self.bins.fill(&self.jobs, grid, part, self.culling);
                }
                let (jobs, bins, level) = (&self.jobs, &self.bins, self.level);
                of_part.par_iter_mut().with_max_len(4).for_each(|tile| {
                    let mut scratch = self.scratch.get_or_default().borrow_mut();
                    dispatch!(level, s => {
                        scratch.fill::<_, OUTPUTS>(s, jobs, bins, grid, *size, &resolver, slab_place, tile);
                    });
                });
            }
        }
    }
}

impl Scratch {
    /// Makes the blocks of a tile.
    #[inline(always)]
    fn fill<S: Simd, const OUTPUTS: usize>(
        &mut self,
        s: S,
        jobs: &[Projected],
        bins: &Bins,
        grid: &Grid,
        size: [usize; 2],
        resolver: &Resolver,
        SlabPlace { is_first, is_last }: SlabPlace,
        tile: &mut TileBlocks<'_>,
    ) {
        let TileBlocks { tile, places, out, states } = tile;
        let (tile, places) = (*tile, *places);
        let is_finished = !is_first && !states.iter().any(|state| slabs::is_open(&state[0]));
        if is_finished && !is_last {
            return;
        }
        let corner = grid.tile_corner(tile);
        // Pixel of the tile, counted from its corner.
        let pixel =
            |place: [u16; 2]| [0, 1].map(|a| usize::from(place[a]) * BLOCK + grid.before[a] - corner[a]);
        let mut rows = [0_u64; MAX_ROWS];
        for place in places {
            let [x, y] = pixel(*place);
            rows[y / BLOCK] |= 1 << (x / BLOCK);
        }
        match is_finished {
            true => self.forget(),
            false => self.take_meeting::<OUTPUTS>(jobs, bins, tile, grid, &BlockRows::new(&rows)),
        }
        self.list();

        let Self { tile: TileScratch { blocks, splats, normals, cover, .. }, lists, .. } = self;
        let native_of = |place: [u16; 2]| {
            let [x, y] = pixel(place);
            [x / TILE_WIDTH, y / TILE_HEIGHT]
        };
        let (mut rest, mut rest_states) = (&mut out[..], &mut states[..]);
        for places in places.chunk_by(|a, b| native_of(*a) == native_of(*b)) {
            let out = rest.split_off_mut(..places.len()).unwrap_or_default();
            let states = rest_states.split_off_mut(..places.len()).unwrap_or_default();
            let native = native_of(places[0]);
            let first = [native[0] * TILE_WIDTH, native[1] * TILE_HEIGHT];
            let corner = [0, 1].map(|a| (corner[a] + first[a]) as f32 - grid.before[a] as f32);
            let samples = TileSamples { pitch: 1.0, corner };
            // The block's number in the native tile.
            let index = |place: [u16; 2]| {
                let [x, y] = pixel(place);
                (y - first[1]) / BLOCK * BLOCKS_X + (x - first[0]) / BLOCK
            };
            let left = |place: [u16; 2]| [0, 1].map(|a| size[a] - usize::from(place[a]) * BLOCK);
            let mut open = 0;
            for (k, place) in places.iter().enumerate() {
                let b = index(*place);
                if is_first {
                    blend::start_block::<OUTPUTS>(&mut blocks[b], left(*place));
                } else {
                    load(&mut blocks[b], &out[k], &states[k]);
                }
                open |= u32::from(slabs::is_open(&blocks[b].0[plane::TRANSMITTANCE])) << b;
            }
            let order = &lists[native[1] * MAX_STRIDE + native[0]][..];
            let of_tile = TileSplats { order, splats, normals };
            let (rules, origin) = (resolver.rules, grid.origin);
            blend::blend_splats::<_, OUTPUTS>(s, &samples, origin, rules, open, of_tile, cover, blocks);
            for (k, (place, out)) in places.iter().zip(out).enumerate() {
                let b = index(*place);
                let block = &mut blocks[b];
                if !is_last {
                    (*out, states[k]) = (exact::<OUTPUTS>(block), STATE_PLANES.map(|p| block.0[p]));
                    continue;
                }
                resolver.finish::<_, OUTPUTS>(s, block, samples.of_block(s, b), 1.0);
                *out = exact::<OUTPUTS>(block);
                clear_beyond(out, left(*place));
            }
        }
    }

    fn forget(&mut self) {
        self.tile.clear();
        self.found.clear();
        self.met.clear();
    }

    /// Takes the splats of `tile` with a rectangle that meets one of the tile's blocks.
    #[inline(always)]
    fn take_meeting<const OUTPUTS: usize>(
        &mut self,
        jobs: &[Projected],
        bins: &Bins,
        tile: [usize; 2],
        grid: &Grid,
        rows: &BlockRows,
    ) {
        let corner = grid.tile_corner(tile);
        self.forget();
        for ids in bins.of_tile(tile) {
            for id in ids {
                let (job, local) = id.place();
                let job = &jobs[job];
                let met = rows.native_tiles_met(job.rects[local], corner, grid.tile_size());
                if met != 0 {
                    // Splats are copied once all are found: by then memory has answered.
                    TileScratch::prefetch::<OUTPUTS>(job, local);
                    self.met.push(met);
                    self.found.push(*id);
                }
            }
        }
        for (job, local) in self.found.iter().map(|id| id.place()) {
            self.tile.take::<OUTPUTS>(&jobs[job], local);
        }
    }

    /// Lists the splats taken for the native tiles that they meet, front to back. The splats taken are in scene order, as all
    /// splats of a native tile are, so equal depths keep the native image's order.
    fn list(&mut self) {
        let Self { tile: TileScratch { order, splats, .. }, met, lists, .. } = self;
        lists.resize_with(MAX_STRIDE * MAX_STRIDE, Vec::new);
        lists.iter_mut().for_each(Vec::clear);
        order.sort_front_to_back(splats.iter().map(|splat| splat.depth_bits));
        for place in order.sorted() {
            let mut met = met[*place as usize];
            while met != 0 {
                lists[met.trailing_zeros() as usize].push(*place);
                met &= met - 1;
            }
        }
    }
}

/// The planes of a block that exact blocks have. Frames of colour alone have no other plane.
fn exact<const OUTPUTS: usize>(block: &Block) -> ExactBlock {
    let planes = |first: usize| [block.0[first], block.0[first + 1], block.0[first + 2]];
    if OUTPUTS == COLOR {
        return ExactBlock { color: planes(plane::COLOR), ..ExactBlock::EMPTY };
    }
    ExactBlock {
        color: planes(plane::COLOR),
        color_dx: planes(plane::COLOR_DX),
        color_dy: planes(plane::COLOR_DY),
        depth_median: block.0[plane::MEDIAN],
    }
}

/// Loads the state of a block from the slab before.
fn load(block: &mut Block, from: &ExactBlock, state: &BlockState) {
    let ExactBlock { color, color_dx, color_dy, depth_median } = from;
    for (first, planes) in [(plane::COLOR, color), (plane::COLOR_DX, color_dx), (plane::COLOR_DY, color_dy)] {
        block.0[first..first + 3].copy_from_slice(planes);
    }
    block.0[plane::MEDIAN] = *depth_median;
    for (p, plane) in STATE_PLANES.into_iter().zip(state) {
        block.0[p] = *plane;
    }
}

/// Sets pixels beyond the image to black and infinitely far. `left` columns and rows from the block's first pixel are
/// inside.
fn clear_beyond(block: &mut ExactBlock, left: [usize; 2]) {
    if left[0] >= BLOCK && left[1] >= BLOCK {
        return;
    }
    let ExactBlock { color, color_dx, color_dy, depth_median } = block;
    for plane in color.iter_mut().chain(color_dx).chain(color_dy).chain([depth_median]) {
        for (lane, value) in plane.iter_mut().enumerate() {
            if lane % BLOCK >= left[0] || lane / BLOCK >= left[1] {
                *value = 0.0;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use gs3_scene::{GBuffer, Image, Margin, block_grid, demo};

    use crate::{Culling, Importance, Outputs, RasterSettings, Rasterizer, Window, matched_dilation};

    /// Frames, blocks and importance have the same bits with memory for all entries at once, for some tiles of a row, and for
    /// one tile only; and in slabs.
    #[test]
    fn frames_in_parts_and_slabs_are_the_same() {
        let scene = Arc::new(demo::scene().expect("the demo"));
        let camera = demo::path().cameras()[0].resized(310, 170).expect("a valid size");
        let settings =
            RasterSettings { dilation: matched_dilation(2), ..RasterSettings::new(Outputs::GBuffer) };
        let [columns, rows] = block_grid(camera.size());
        let places: Vec<[u16; 2]> =
            (0..rows).flat_map(|y| (0..columns).step_by(3).map(move |x| [x as u16, y as u16])).collect();
        let run = |most_entries: u64, most_gaussians: [usize; 2]| {
            let mut rasterizer = Rasterizer::new(Arc::clone(&scene), Culling::AccuTile);
            rasterizer.most_entries = most_entries;
            rasterizer.most_gaussians = most_gaussians;
            let (mut image, mut counts) = (Image::default(), [[0; 2]; 4]);
            rasterizer.rasterize_image(&camera, &settings, &mut image).expect("valid settings");
            counts[0] = [rasterizer.slabs.len(), rasterizer.parts.len()];
            let mut lr = Vec::new();
            let mut made = Vec::new();
            // Samples on pixels, whose splats the blocks share, and samples elsewhere, whose splats they do not share.
            for (outputs, jitter) in [
                (Outputs::GBuffer, [0.25; 2]),
                (Outputs::Samples, [0.1; 2]),
                (Outputs::GBufferMixed, [0.1; 2]),
            ] {
                let settings = RasterSettings { outputs, jitter, ..settings };
                lr.push(GBuffer::default());
                rasterizer
                    .rasterize_low_resolution(&camera, 2, &settings, lr.last_mut().expect("one"))
                    .expect("valid settings");
                counts[lr.len()] = [rasterizer.slabs.len(), rasterizer.parts.len()];
                // Twice: the second run must work on the memory that the first run leaves. The first is of no block.
                for places in [&places[..0], &places, &places] {
                    let mut blocks = Default::default();
                    rasterizer.rasterize_blocks(places, &mut blocks).expect("a frame before");
                    made.push(blocks);
                }
            }
            let visible = rasterizer.visible_count();
            let (mut blocks, dense) = (Default::default(), &places[..places.len() / 2]);
            rasterizer
                .rasterize_image_blocks(&camera, &settings, dense, &mut blocks)
                .expect("valid settings");
            made.push(blocks);
            let mut importance = Importance::zeroed(scene.gaussians().len());
            rasterizer.importance(&camera, &settings, &mut importance).expect("valid settings");
            (image, lr, made, (visible, importance), counts)
        };
        let most = scene.gaussians().len();
        let whole = run(u64::MAX, [most, 1]);
        assert_eq!(whole.4, [[1, 1]; 4]);
        // 10 columns and 11 rows of tiles, and 5 and 6 of the coarser frame.
        for (most_entries, most_gaussians, counts) in [
            (1, [most, 1], [[1, 110], [1, 30], [1, 30], [1, 30]]),
            (20_000, [most, 1], [[1, 29], [1, 18], [1, 18], [1, 18]]),
            // Slabs, and parts of the last slab.
            (u64::MAX, [0, 100_000], [[5, 1]; 4]),
            (1_000, [0, 200_000], [[3, 68], [3, 28], [3, 28], [3, 28]]),
        ] {
            let many = run(most_entries, most_gaussians);
            if most_gaussians[0] == most {
                assert_eq!(many.4, counts);
            }
            assert_eq!(many.4.map(|[slabs, _]| slabs > 1), counts.map(|[slabs, _]| slabs > 1));
            assert_eq!(many.4.map(|[_, parts]| parts > 1), counts.map(|[_, parts]| parts > 1));
            assert_eq!(whole.0.pixels(), many.0.pixels());
            assert_eq!(whole.1, many.1);
            for (a, b) in whole.2.iter().zip(&many.2) {
                assert_eq!((&a.places, &a.blocks), (&b.places, &b.blocks));
            }
            assert!(whole.2.iter().any(|made| !made.is_empty()));
            assert_eq!(whole.3, many.3);
        }
    }

    /// A rasterizer whose frames are in slabs, at once and in slabs again makes what one makes at once, with all that frames can have.
    #[test]
    fn slabs_come_and_go() {
        let scene = Arc::new(demo::scene().expect("the demo"));
        let camera = demo::path().cameras()[40].resized(218, 130).expect("a valid size");
        let most = scene.gaussians().len();
        for culling in [Culling::Aabb3Sigma, Culling::Adr, Culling::Exact] {
            let run = |in_turn: [[usize; 2]; 3]| {
                let mut rasterizer = Rasterizer::new(Arc::clone(&scene), culling);
                let mut all = Vec::new();
                for most_gaussians in in_turn {
                    rasterizer.most_gaussians = most_gaussians;
                    let margin = Margin { left: 4, top: 0, right: 8, bottom: 3 };
                    let dilation = matched_dilation(4);
                    let settings =
                        RasterSettings { dilation, margin, ..RasterSettings::new(Outputs::Samples) };
                    let (mut lr, mut blocks) = (GBuffer::default(), Default::default());
                    rasterizer
                        .rasterize_low_resolution(&camera, 4, &settings, &mut lr)
                        .expect("valid settings");
                    let slabs = rasterizer.slabs.len();
                    let places: Vec<[u16; 2]> = (0..33).flat_map(|y| (0..55).map(move |x| [x, y])).collect();
                    rasterizer.rasterize_blocks(&places, &mut blocks).expect("a frame before");
                    let window = Window { left: 64, top: 32, width: 77, height: 60 };
                    let mut image = Image::default();
                    rasterizer
                        .rasterize_window(&camera, window, &settings, &mut image)
                        .expect("valid settings");
                    let mut importance = Importance::zeroed(most);
                    rasterizer.importance(&camera, &settings, &mut importance).expect("valid settings");
                    all.push((lr, blocks, image, importance, slabs));
                }
                all
            };
            let (whole, slabs) = ([most, 1], [0, 50_000]);
            let [expected, actual] = [run([whole; 3]), run([slabs, whole, slabs])];
            for (k, (a, b)) in expected.iter().zip(&actual).enumerate() {
                assert_eq!((a.4 > 1, b.4 > 1), (false, k != 1), "{culling:?}");
                assert!(a.0 == b.0 && a.1 == b.1 && a.2 == b.2 && a.3 == b.3, "{culling:?}, frame {k}");
            }
        }
    }
}
