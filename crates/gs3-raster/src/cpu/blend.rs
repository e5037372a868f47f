//! Tiles to pixels: front-to-back blending of colour, exact image gradients, depth and normal.
//!
//! A tile is 8×4 blocks of 4×4 pixels, and a block is sixteen lanes. For each splat, front to back, a 32-bit mask has
//! the blocks that the support touches and that are not yet opaque. Only these blocks are evaluated. Gradients follow
//! UpscaleGS (Niedermayr et al. 2025), depth and normals RaDe-GS (Zhang et al. 2024).

use fearless_simd::{Simd, f32x16, mask32x16, prelude::*};

use super::bin::Bins;
use super::cover::{BLOCK, BLOCKS, Cover, RUN, TileSamples, block_first};
use super::grid::Grid;
use super::math::exp2;
use super::order::DepthOrder;
use super::project::{HALF_LOG2_E_SQRT, Projected, lanes};
use super::splat::Splat;
use crate::settings::{ExpectedDepth, MIN_ALPHA, Rules};

/// A pixel is finished before the contribution that would reduce its transmittance below this value (Kerbl et al.
/// 2023).
pub const MIN_TRANSMITTANCE: f32 = 1e-4;

/// Undoes the scaling of the Cholesky factor: 1 / (½ log₂ e).
pub const UNSCALE: f32 = 1.0 / (HALF_LOG2_E_SQRT * HALF_LOG2_E_SQRT);

/// Planes of a block's state.
pub mod plane {
    /// Transmittance while the pixel is open, 0 once it is finished.
    pub const TRANSMITTANCE: usize = 0;
    /// Transmittance at which the pixel was finished.
    pub const FINAL: usize = 1;
    /// Alpha, once the block is resolved.
    pub const ALPHA: usize = FINAL;
    /// Colour, three planes.
    pub const COLOR: usize = 2;
    /// ∂(1 − T)/∂x and ∂/∂y.
    pub const ALPHA_DX: usize = 5;
    pub const ALPHA_DY: usize = 6;
    /// ∂colour/∂x and ∂/∂y, three planes each.
    pub const COLOR_DX: usize = 7;
    pub const COLOR_DY: usize = 10;
    /// Contribution-weighted and median distance along the ray.
    pub const DISTANCE: usize = 13;
    pub const MEDIAN: usize = 14;
    /// Normal, three planes.
    pub const NORMAL: usize = 15;
    /// ∂²(1 − T)/∂x∂y and ∂²colour/∂x∂y, three planes.
    pub const ALPHA_DXY: usize = 18;
    pub const COLOR_DXY: usize = 19;
    pub const COUNT: usize = 22;
}

/// State of sixteen pixels, row by row.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub struct Block(pub [[f32; 16]; plane::COUNT]);

/// The outputs of [`blend_tile`]; kernels are compiled once for each.
pub const COLOR: usize = 0;
/// With gradients and median depth: the values of samples of the history.
pub const SAMPLES: usize = 1;
/// With mean depth and normal as well.
pub const GBUFFER: usize = 2;
/// With the mixed derivative as well.
pub const GBUFFER_MIXED: usize = 3;

/// The part of [`Rules`] that blending reads.
#[derive(Clone, Copy)]
pub struct BlendRules {
    /// Cap of contributions. A capped contribution is constant, so its derivatives are zero.
    pub max_alpha: f32,
    /// Whether the mean depth averages depths of centres, along z, instead of depths of surfaces, along the ray.
    pub has_depths_of_centers: bool,
}

impl From<Rules> for BlendRules {
    fn from(rules: Rules) -> Self {
        let has_depths_of_centers = rules.expected_depth == ExpectedDepth::Centers;
        Self { max_alpha: rules.max_alpha, has_depths_of_centers }
    }
}

/// How many splats ahead memory is prefetched: a splat is copied in about ten nanoseconds, and memory takes a hundred or more.
const AHEAD: usize = 16;

/// The state of a tile and its splats in order; one per thread, reused.
pub struct TileScratch {
    pub blocks: Box<[Block; BLOCKS]>,
    /// Positions in `splats`, front to back.
    pub order: DepthOrder,
    /// The splats in scene order.
    pub splats: Vec<Splat>,
    pub normals: Vec<[f32; 3]>,
    pub cover: Box<Cover>,
}

impl TileScratch {
    /// Forgets the splats.
    pub fn clear(&mut self) {
        self.splats.clear();
        self.normals.clear();
    }

    /// Asks for the memory of a splat of a projection job, to be taken later.
    #[inline(always)]
    pub fn prefetch<const OUTPUTS: usize>(job: &Projected, local: usize) {
        gs3_simd::prefetch(&job.splats[local..=local]);
        if OUTPUTS >= GBUFFER {
            gs3_simd::prefetch(&job.normals[local..=local]);
        }
    }

    /// Adds a splat of a projection job.
    #[inline(always)]
    pub fn take<const OUTPUTS: usize>(&mut self, job: &Projected, local: usize) {
        self.splats.push(job.splats[local]);
        if OUTPUTS >= GBUFFER {
            self.normals.push(job.normals[local]);
        }
    }
}

impl Default for TileScratch {
    fn default() -> Self {
        Self {
            blocks: Box::new([Block([[0.0; 16]; plane::COUNT]); BLOCKS]),
            order: DepthOrder::default(),
            splats: Vec::new(),
            normals: Vec::new(),
            cover: Box::default(),
        }
    }
}

/// Number of planes of a block's state that `outputs` needs: the first ones.
pub const fn planes(outputs: usize) -> usize {
    match outputs {
        COLOR => plane::ALPHA_DX,
        SAMPLES => plane::NORMAL,
        GBUFFER => plane::ALPHA_DXY,
        _ => plane::COUNT,
    }
}

/// Blends tile `tile` of `grid` into those of `scratch.blocks` in the bit mask `open`. Returns the mask of blocks that still have
/// open pixels.
#[inline(always)]
pub fn blend_tile<S: Simd, const OUTPUTS: usize>(
    s: S,
    jobs: &[Projected],
    bins: &Bins,
    tile: [usize; 2],
    grid: &Grid,
    rules: BlendRules,
    open: u32,
    scratch: &mut TileScratch,
) -> u32 {
    // All splats of the tile are first copied in scene order, which is near the order of memory. Then they are
    // visited by depth, so that random accesses stay within the second-level cache.
    scratch.clear();
    for ids in bins.of_tile(tile) {
        for (k, id) in ids.iter().enumerate() {
            if let Some(ahead) = ids.get(k + AHEAD) {
                let (job, local) = ahead.place();
                TileScratch::prefetch::<OUTPUTS>(&jobs[job], local);
            }
            let (job, local) = id.place();
            scratch.take::<OUTPUTS>(&jobs[job], local);
        }
    }
    scratch.order.sort_front_to_back(scratch.splats.iter().map(|splat| splat.depth_bits));
    let samples = grid.tile_samples(tile);
    let TileScratch { blocks, order, splats, normals, cover } = scratch;
    let of_tile = TileSplats { order: order.sorted(), splats, normals };
    blend_splats::<_, OUTPUTS>(s, &samples, grid.origin, rules, open, of_tile, cover, blocks)
}

/// The splats of a tile.
#[derive(Clone, Copy)]
pub struct TileSplats<'a> {
    /// Positions in the other two, front to back.
    pub order: &'a [u32],
    pub splats: &'a [Splat],
    /// Of [`GBUFFER`] and more.
    pub normals: &'a [[f32; 3]],
}

/// Blends the splats of a tile with `samples`, front to back, into its blocks in the bit mask `open`. Returns the mask of blocks
/// that still have open pixels. Rectangles of splats count from the pixel at position `origin`.
#[inline(always)]
pub fn blend_splats<S: Simd, const OUTPUTS: usize>(
    s: S,
    samples: &TileSamples,
    origin: [f32; 2],
    rules: BlendRules,
    mut open: u32,
    of_tile: TileSplats<'_>,
    cover: &mut Cover,
    blocks: &mut [Block; BLOCKS],
) -> u32 {
    for visited in of_tile.order.chunks(RUN) {
        cover.fill(s, of_tile.splats, visited, samples, origin, open);
        // Block by block, so that the state stays in registers during the run.
        for b in 0..BLOCKS {
            let touching = cover.of_block(b);
            if touching.len() == 0 {
                continue;
            }
            let mut state = State::load(s, &blocks[b]);
            let finished = state.blend_run::<OUTPUTS>(s, rules, samples.of_block(s, b), touching, of_tile);
            state.store::<OUTPUTS>(&mut blocks[b]);
            if finished {
                open &= !(1 << b);
            }
        }
        if open == 0 {
            break;
        }
    }
    open
}

/// Clears the state of a tile with `left` columns and rows inside the image; pixels outside start finished. Returns the mask of
/// blocks with open pixels.
pub fn start_tile<const OUTPUTS: usize>(blocks: &mut [Block; BLOCKS], left: [usize; 2]) -> u32 {
    let mut open = 0;
    for (b, block) in blocks.iter_mut().enumerate() {
        let [x, y] = block_first(b);
        if x >= left[0] || y >= left[1] {
            continue;
        }
        open |= 1 << b;
        start_block::<OUTPUTS>(block, [left[0] - x, left[1] - y]);
    }
    open
}

/// Clears the state of a block with `left` columns and rows inside the image. Pixels outside start finished.
#[inline(always)]
pub fn start_block<const OUTPUTS: usize>(block: &mut Block, left: [usize; 2]) {
    block.0[..planes(OUTPUTS)].fill([0.0; 16]);
    for lane in 0..16 {
        let inside = lane % BLOCK < left[0] && lane / BLOCK < left[1];
        block.0[plane::TRANSMITTANCE][lane] = if inside { 1.0 } else { 0.0 };
    }
}

/// A block's state in registers.
struct State<S: Simd> {
    transmittance: f32x16<S>,
    last: f32x16<S>,
    color: [f32x16<S>; 3],
    alpha_dx: f32x16<S>,
    alpha_dy: f32x16<S>,
    color_dx: [f32x16<S>; 3],
    color_dy: [f32x16<S>; 3],
    distance: f32x16<S>,
    median: f32x16<S>,
    normal: [f32x16<S>; 3],
    alpha_dxy: f32x16<S>,
    color_dxy: [f32x16<S>; 3],
}

impl<S: Simd> State<S> {
    #[inline(always)]
    fn load(s: S, block: &Block) -> Self {
        let plane = &block.0;
        Self {
            transmittance: f32x16::from_slice(s, &plane[plane::TRANSMITTANCE]),
            last: f32x16::from_slice(s, &plane[plane::FINAL]),
            color: load3(s, block, plane::COLOR),
            alpha_dx: f32x16::from_slice(s, &plane[plane::ALPHA_DX]),
            alpha_dy: f32x16::from_slice(s, &plane[plane::ALPHA_DY]),
            color_dx: load3(s, block, plane::COLOR_DX),
            color_dy: load3(s, block, plane::COLOR_DY),
            distance: f32x16::from_slice(s, &plane[plane::DISTANCE]),
            median: f32x16::from_slice(s, &plane[plane::MEDIAN]),
            normal: load3(s, block, plane::NORMAL),
            alpha_dxy: f32x16::from_slice(s, &plane[plane::ALPHA_DXY]),
            color_dxy: load3(s, block, plane::COLOR_DXY),
        }
    }

    /// Writes back the values that [`Self::blend_run`] changes for these outputs.
    #[inline(always)]
    fn store<const OUTPUTS: usize>(&self, block: &mut Block) {
        let plane = &mut block.0;
        self.transmittance.store_slice(&mut plane[plane::TRANSMITTANCE]);
        self.last.store_slice(&mut plane[plane::FINAL]);
        store3(self.color, plane, plane::COLOR);
        if OUTPUTS >= SAMPLES {
            self.alpha_dx.store_slice(&mut plane[plane::ALPHA_DX]);
            self.alpha_dy.store_slice(&mut plane[plane::ALPHA_DY]);
            store3(self.color_dx, plane, plane::COLOR_DX);
            store3(self.color_dy, plane, plane::COLOR_DY);
            self.median.store_slice(&mut plane[plane::MEDIAN]);
        }
        if OUTPUTS >= GBUFFER {
            self.distance.store_slice(&mut plane[plane::DISTANCE]);
            store3(self.normal, plane, plane::NORMAL);
        }
        if OUTPUTS == GBUFFER_MIXED {
            self.alpha_dxy.store_slice(&mut plane[plane::ALPHA_DXY]);
            store3(self.color_dxy, plane, plane::COLOR_DXY);
        }
    }

    /// Blends the splats in `touching` over the block. Returns whether all its pixels are finished.
    #[inline(always)]
    fn blend_run<const OUTPUTS: usize>(
        &mut self,
        s: S,
        rules: BlendRules,
        sample: [f32x16<S>; 2],
        touching: impl Iterator<Item = u32>,
        of_tile: TileSplats<'_>,
    ) -> bool {
        let zero = lanes(s, 0.0);
        let max_alpha = lanes(s, rules.max_alpha);
        for i in touching {
            let splat = &of_tile.splats[i as usize];
            let t = self.transmittance;
            let Some(contribution) = Contribution::of(s, splat, sample, t, max_alpha) else { continue };
            let Contribution { dx, dy, u, v, raw, alpha, after, blended, finished } = contribution;
            let weight = alpha * t;

            let color = lanes3(s, splat.color);
            for k in 0..3 {
                self.color[k] = color[k].mul_add(weight, self.color[k]);
            }
            if OUTPUTS >= SAMPLES {
                // g = (A·dx + B·dy, B·dx + C·dy) from the factor. Derivatives of α vanish where α is capped.
                let slope = raw.simd_lt(max_alpha).select(alpha, zero) * lanes(s, UNSCALE);
                let gx = lanes(s, splat.l11) * u;
                let gy = lanes(s, splat.l21).mul_add(u, lanes(s, splat.l22) * v);
                let (alpha_x, alpha_y) = (slope * gx, slope * gy);
                let weight_x = t.mul_add(alpha_x, zero - self.alpha_dx * alpha);
                let weight_y = t.mul_add(alpha_y, zero - self.alpha_dy * alpha);
                for k in 0..3 {
                    self.color_dx[k] = color[k].mul_add(weight_x, self.color_dx[k]);
                    self.color_dy[k] = color[k].mul_add(weight_y, self.color_dy[k]);
                }
                if OUTPUTS == GBUFFER_MIXED {
                    let b = lanes(s, splat.l11 * splat.l21);
                    let alpha_xy = slope * (gx * gy).mul_add(lanes(s, UNSCALE), zero - b);
                    let cross = self.alpha_dx.mul_add(alpha_y, self.alpha_dy * alpha_x);
                    let weight_xy = t.mul_add(alpha_xy, zero - cross) - self.alpha_dxy * alpha;
                    for k in 0..3 {
                        self.color_dxy[k] = color[k].mul_add(weight_xy, self.color_dxy[k]);
                    }
                    self.alpha_dxy += weight_xy;
                }
                // A(1 − α) + T·αx = A + weight_x; the other values are alike.
                self.alpha_dx += weight_x;
                self.alpha_dy += weight_y;

                let across = lanes(s, splat.ray_plane[1]).mul_add(dy, lanes(s, splat.ray_distance));
                let distance = lanes(s, splat.ray_plane[0]).mul_add(dx, across);
                let in_front = blended & t.simd_gt(lanes(s, 0.5));
                self.median = in_front.select(distance, self.median);
                if OUTPUTS >= GBUFFER {
                    let center = lanes(s, f32::from_bits(splat.depth_bits));
                    let distance = if rules.has_depths_of_centers { center } else { distance };
                    self.distance = distance.mul_add(weight, self.distance);
                    let normal = lanes3(s, of_tile.normals[i as usize]);
                    for k in 0..3 {
                        self.normal[k] = normal[k].mul_add(weight, self.normal[k]);
                    }
                }
            }

            self.transmittance = blended.select(after, t);
            if finished.any_true() {
                self.last = finished.select(t, self.last);
                self.transmittance = finished.select(zero, self.transmittance);
                if self.transmittance.simd_le(zero).all_true() {
                    return true;
                }
            }
        }
        false
    }
}

/// The contribution of one splat to sixteen pixels.
pub struct Contribution<S: Simd> {
    /// Mean − sample.
    dx: f32x16<S>,
    dy: f32x16<S>,
    /// See [`Splat`].
    u: f32x16<S>,
    v: f32x16<S>,
    /// α before it is capped.
    raw: f32x16<S>,
    /// α where it is blended, else 0.
    pub alpha: f32x16<S>,
    /// Transmittance behind the splat where it is blended.
    pub after: f32x16<S>,
    pub blended: mask32x16<S>,
    /// Pixels that are finished before this splat.
    pub finished: mask32x16<S>,
}

impl<S: Simd> Contribution<S> {
    /// `None` if the splat reaches no pixel with a positive transmittance `t`.
    #[inline(always)]
    pub fn of(
        s: S,
        splat: &Splat,
        sample: [f32x16<S>; 2],
        t: f32x16<S>,
        max_alpha: f32x16<S>,
    ) -> Option<Self> {
        let (zero, one) = (lanes(s, 0.0), lanes(s, 1.0));
        let dx = lanes(s, splat.mean[0]) - sample[0];
        let dy = lanes(s, splat.mean[1]) - sample[1];
        let u = lanes(s, splat.l11).mul_add(dx, lanes(s, splat.l21) * dy);
        let v = lanes(s, splat.l22) * dy;
        let q = u.mul_add(u, v * v);
        // The bound is known long before the exponential, so a mispredicted branch costs little.
        if (q.simd_gt(lanes(s, splat.support)) | t.simd_le(zero)).all_true() {
            return None;
        }
        let raw = lanes(s, splat.opacity) * exp2(s, zero - q);
        let hit = raw.simd_ge(lanes(s, MIN_ALPHA)) & t.simd_gt(zero);
        let alpha = raw.min(max_alpha);
        let after = t * (one - alpha);
        let ends = after.simd_lt(lanes(s, MIN_TRANSMITTANCE));
        let finished = hit & ends;
        let blended = hit & !ends;
        let alpha = blended.select(alpha, zero);
        Some(Self { dx, dy, u, v, raw, alpha, after, blended, finished })
    }
}

#[inline(always)]
fn load3<S: Simd>(s: S, block: &Block, first: usize) -> [f32x16<S>; 3] {
    [
        f32x16::from_slice(s, &block.0[first]),
        f32x16::from_slice(s, &block.0[first + 1]),
        f32x16::from_slice(s, &block.0[first + 2]),
    ]
}

#[inline(always)]
fn store3<S: Simd>(values: [f32x16<S>; 3], planes: &mut [[f32; 16]; plane::COUNT], first: usize) {
    for (k, value) in values.iter().enumerate() {
        value.store_slice(&mut planes[first + k]);
    }
}

#[inline(always)]
pub fn lanes3<S: Simd>(s: S, v: [f32; 3]) -> [f32x16<S>; 3] {
    [lanes(s, v[0]), lanes(s, v[1]), lanes(s, v[2])]
}
