//! The contribution of each Gaussian to an image: the statistics for simplification by importance.
//!
//! A tile is blended twice: first for its colours, then again with these colours known, because the effect of a splat
//! depends on the colour behind it. Order, cover and contributions are the same as in blending.

use std::ops::Range;

use fearless_simd::{Simd, dispatch, f32x16, prelude::*, u32x16};
use gs3_scene::Camera;
use rayon::prelude::*;

use super::Rasterizer;
use super::bin::{Bins, Part, TILE_HEIGHT, TILE_WIDTH};
use super::blend::{self, BlendRules, Contribution, TileScratch, lanes3, plane};
use super::cover::{BLOCKS, RUN};
use super::grid::Grid;
use super::project::{ProjectOutputs, Projected, lanes};
use super::splat::Splat;
use crate::settings::{RasterError, RasterSettings};
use crate::view::View;

/// Rows of tiles per thread between two reductions. It limits the memory of statistics that are not yet added.
const ROWS_PER_THREAD: usize = 4;

/// Per-Gaussian statistics of rendered views, in the scene's order; each array is `[N]`.
///
/// Below, α is the contribution of a Gaussian at a pixel, T the transmittance in front of it and c its colour.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Importance {
    /// Σ over pixels of αT: the Gaussian's share of the image in pixels (Mini-Splatting, Fang and Wang 2024).
    pub weight: Vec<f64>,
    /// Number of pixels where the Gaussian is blended (α ≥ 1/255, in front of the place where blending stops).
    pub pixels: Vec<u64>,
    /// Number of pixels where no Gaussian has a larger αT. Among equal ones, the nearest counts.
    pub dominant: Vec<u64>,
    /// Σ over pixels of |∂colour/∂g|², summed over the three channels, where α = o·g with opacity o (Speedy-Splat,
    /// Hanson et al. 2025). The derivative is |o T (c − behind)|, where `behind` is the colour of everything behind
    /// the Gaussian, background included, as if the Gaussian did not cover it. As in training, the derivative passes
    /// through the cap of α at 0.99; otherwise the middle of an opaque Gaussian would count for nothing.
    pub sensitivity: Vec<f64>,
}

impl Importance {
    /// Zeros for `count` Gaussians.
    #[must_use]
    pub fn zeroed(count: usize) -> Self {
        Self {
            weight: vec![0.0; count],
            pixels: vec![0; count],
            dominant: vec![0; count],
            sensitivity: vec![0.0; count],
        }
    }

    /// Sets everything to zero.
    pub fn clear(&mut self) {
        self.weight.fill(0.0);
        self.pixels.fill(0);
        self.dominant.fill(0);
        self.sensitivity.fill(0.0);
    }

    /// Number of Gaussians.
    #[must_use]
    pub fn len(&self) -> usize {
        self.weight.len()
    }

    /// Whether there are no Gaussians.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.weight.is_empty()
    }

    fn check(&self, expected: usize) -> Result<(), RasterError> {
        let lengths = [self.weight.len(), self.pixels.len(), self.dominant.len(), self.sensitivity.len()];
        match lengths.into_iter().find(|&actual| actual != expected) {
            Some(actual) => Err(RasterError::ImportanceLength { expected, actual }),
            None => Ok(()),
        }
    }

    fn add(&mut self, index: usize, share: &Share) {
        self.weight[index] += f64::from(share.weight);
        self.pixels[index] += u64::from(share.pixels);
        self.dominant[index] += u64::from(share.dominant);
        self.sensitivity[index] += f64::from(share.sensitivity);
    }
}

impl Rasterizer {
    /// Adds the Gaussians' statistics in the image of `camera` with `settings` to `importance`. `settings.outputs` is
    /// not read. The sums have the same bits with any number of threads.
    ///
    /// # Errors
    /// [`RasterError`] if a setting is out of range or `importance` has not the scene's length. `importance` is
    /// unchanged then.
    pub fn importance(
        &mut self,
        camera: &Camera,
        settings: &RasterSettings,
        importance: &mut Importance,
    ) -> Result<(), RasterError> {
        settings.check()?;
        importance.check(self.scene.gaussians().len())?;
        let view = View::new(camera, settings, self.scene.details().near);
        self.slabs.clear();
        self.project(&view, ProjectOutputs { indices: true, ..ProjectOutputs::default() }, None);
        let grid = Grid::native(camera.size());
        self.last = None;
        let at_once = ROWS_PER_THREAD * rayon::current_num_threads();
        let parts = Bins::parts(&self.jobs, &grid, self.most_entries);
        let pieces = |part: Part| {
            let Range { start, end } = part.rows;
            let rows = (start..end).step_by(at_once).map(move |first| first..end.min(first + at_once));
            rows.map(move |rows| (part.clone(), rows))
        };
        for (part, rows) in parts.into_iter().flat_map(pieces) {
            if rows.start == part.rows.start {
                self.bins.fill(&self.jobs, &grid, &part, self.culling);
            }
            let (jobs, bins, level) = (&self.jobs, &self.bins, self.level);
            let rows: Vec<Vec<(u32, Share)>> = rows
                .into_par_iter()
                .map_init(Scratch::default, |scratch, row| {
                    let mut found = Vec::new();
                    for column in part.columns.clone() {
                        let tile = [column, row];
                        dispatch!(level, s => {
                            scratch.measure_tile(s, jobs, bins, tile, &grid, settings);
                        });
                        let places = bins.of_tile(tile).flatten().map(|id| id.place());
                        let shares = places.zip(&scratch.shares).filter(|(_, share)| share.pixels > 0);
                        found.extend(shares.map(|((job, local), &share)| (jobs[job].indices[local], share)));
                    }
                    found
                })
                .collect();
            // Tile by tile, in a fixed order: floating-point sums depend on their order.
            for (index, share) in rows.iter().flatten() {
                importance.add(*index as usize, share);
            }
        }
        Ok(())
    }
}

/// The statistics of one splat over one tile.
#[derive(Clone, Copy, Default)]
struct Share {
    weight: f32,
    sensitivity: f32,
    pixels: u32,
    dominant: u32,
}

/// State of sixteen pixels in the second pass.
#[derive(Clone, Copy, Default)]
struct Pixels {
    /// 0 once the pixel is finished.
    transmittance: [f32; 16],
    /// The colour of everything behind, as it reaches the eye.
    behind: [[f32; 16]; 3],
    /// Largest αT so far, and its splat as a position in the tile.
    largest: [f32; 16],
    owner: [u32; 16],
}

/// Scratch memory for measuring a tile; one per thread, reused.
struct Scratch {
    tile: TileScratch,
    pixels: [Pixels; BLOCKS],
    /// Per splat of the tile, in scene order.
    shares: Vec<Share>,
}

impl Default for Scratch {
    fn default() -> Self {
        Self { tile: TileScratch::default(), pixels: [Pixels::default(); BLOCKS], shares: Vec::new() }
    }
}

impl Scratch {
    /// Fills `self.shares` for tile `tile` of `grid`.
    #[inline(always)]
    fn measure_tile<S: Simd>(
        &mut self,
        s: S,
        jobs: &[Projected],
        bins: &Bins,
        tile_place: [usize; 2],
        grid: &Grid,
        settings: &RasterSettings,
    ) {
        let rules = BlendRules::from(settings.rules);
        let (x0, y0) = (tile_place[0] * TILE_WIDTH, tile_place[1] * TILE_HEIGHT);
        let left = [grid.size[0] - x0, grid.size[1] - y0];
        let open = blend::start_tile::<{ blend::COLOR }>(&mut self.tile.blocks, left);
        blend::blend_tile::<_, { blend::COLOR }>(
            s,
            jobs,
            bins,
            tile_place,
            grid,
            rules,
            open,
            &mut self.tile,
        );
        let Self { tile, pixels, shares } = self;
        start_pixels(pixels, tile, settings.background);
        let mut open = blend::start_tile::<{ blend::COLOR }>(&mut tile.blocks, left);
        for (pixels, block) in pixels.iter_mut().zip(&tile.blocks[..]) {
            pixels.transmittance = block.0[plane::TRANSMITTANCE];
        }
        shares.clear();
        shares.resize(tile.splats.len(), Share::default());

        let samples = grid.tile_samples(tile_place);
        let TileScratch { order, splats, cover, .. } = tile;
        for visited in order.sorted().chunks(RUN) {
            cover.fill(s, splats, visited, &samples, [0.0; 2], open);
            for b in 0..BLOCKS {
                let touching = cover.of_block(b);
                if touching.len() == 0 {
                    continue;
                }
                let sample = samples.of_block(s, b);
                if pixels[b].measure(s, rules, sample, touching, splats, shares) {
                    open &= !(1 << b);
                }
            }
            if open == 0 {
                break;
            }
        }
        for pixels in pixels.iter() {
            for (&owner, &largest) in pixels.owner.iter().zip(&pixels.largest) {
                if largest > 0.0 {
                    shares[owner as usize].dominant += 1;
                }
            }
        }
    }
}

/// Before the first splat, all of a pixel's colour is behind. Blocks outside the image hold an older tile's state;
/// they are never open.
#[inline(always)]
fn start_pixels(pixels: &mut [Pixels; BLOCKS], tile: &TileScratch, background: [f32; 3]) {
    for (pixels, block) in pixels.iter_mut().zip(&tile.blocks[..]) {
        *pixels = Pixels::default();
        for lane in 0..16 {
            let open = block.0[plane::TRANSMITTANCE][lane];
            let t = if open > 0.0 { open } else { block.0[plane::FINAL][lane] };
            for k in 0..3 {
                pixels.behind[k][lane] = block.0[plane::COLOR + k][lane] + t * background[k];
            }
        }
    }
}

impl Pixels {
    /// Adds the contributions of the splats in `touching` to these pixels. Returns whether all pixels are finished.
    #[inline(always)]
    fn measure<S: Simd>(
        &mut self,
        s: S,
        rules: BlendRules,
        sample: [f32x16<S>; 2],
        touching: impl Iterator<Item = u32>,
        splats: &[Splat],
        shares: &mut [Share],
    ) -> bool {
        let (zero, one) = (lanes(s, 0.0), lanes(s, 1.0));
        let max_alpha = lanes(s, rules.max_alpha);
        let mut t = f32x16::from_slice(s, &self.transmittance);
        let mut behind = self.behind.map(|plane| f32x16::from_slice(s, &plane));
        let mut largest = f32x16::from_slice(s, &self.largest);
        let mut owner = u32x16::from_slice(s, &self.owner);
        let mut all_finished = false;
        for index in touching {
            let splat = &splats[index as usize];
            let Some(contribution) = Contribution::of(s, splat, sample, t, max_alpha) else { continue };
            let Contribution { alpha, after, blended, finished, .. } = contribution;
            if blended.any_true() {
                let weight = alpha * t;
                let color = lanes3(s, splat.color);
                let uncover = one / (one - alpha);
                let mut squares = zero;
                for k in 0..3 {
                    behind[k] -= color[k] * weight;
                    // T (c − behind), where `behind` has already been attenuated by T (1 − α).
                    let change = t.mul_add(color[k], zero - behind[k] * uncover);
                    squares = change.mul_add(change, squares);
                }
                let squares = blended.select(squares, zero) * lanes(s, splat.opacity * splat.opacity);
                let leads = weight.simd_gt(largest);
                largest = leads.select(weight, largest);
                owner = leads.select(u32x16::splat(s, index), owner);
                let share = &mut shares[index as usize];
                share.weight += sum(weight);
                share.sensitivity += sum(squares);
                share.pixels += blended.to_bitmask().count_ones();
            }
            t = finished.select(zero, blended.select(after, t));
            if finished.any_true() && t.simd_le(zero).all_true() {
                all_finished = true;
                break;
            }
        }
        t.store_slice(&mut self.transmittance);
        for (vector, plane) in behind.iter().zip(&mut self.behind) {
            vector.store_slice(plane);
        }
        largest.store_slice(&mut self.largest);
        owner.store_slice(&mut self.owner);
        all_finished
    }
}

/// The sum of sixteen lanes, by halves.
#[inline(always)]
fn sum<S: Simd>(v: f32x16<S>) -> f32 {
    let mut lanes = [0.0; 16];
    v.store_slice(&mut lanes);
    let mut half = 8;
    while half > 0 {
        for i in 0..half {
            lanes[i] += lanes[i + half];
        }
        half /= 2;
    }
    lanes[0]
}
