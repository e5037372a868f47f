//! Tiles to pixels: front-to-back blending of colour, exact image gradients, depth and normal.
//!
//! A tile is 8×4 blocks of 4×4 pixels; a block is sixteen lanes. For each splat, front to back, a 32-bit mask names the
//! blocks that its support touches and that are not yet opaque; only those are evaluated. Gradients follow UpscaleGS
//! (Niedermayr et al. 2025), depth and normals RaDe-GS (Zhang et al. 2024).

use fearless_simd::{Simd, f32x16, prelude::*};

use super::bin::{Bins, TILE_HEIGHT, TILE_WIDTH, splat_of_key};
use super::math::exp2;
use super::project::{HALF_LOG2_E_SQRT, Projected};
use super::splat::{MIN_ALPHA, Splat, SplatGeometry};

/// Contributions are capped here (Kerbl et al. 2023); a capped contribution is constant, its derivatives are zero.
const MAX_ALPHA: f32 = 0.99;

/// A pixel is finished before the contribution that would bring its transmittance below this (Kerbl et al. 2023).
const MIN_TRANSMITTANCE: f32 = 1e-4;

/// Undoes the scaling of the Cholesky factor: 1 / (½ log₂ e).
const UNSCALE: f32 = 1.0 / (HALF_LOG2_E_SQRT * HALF_LOG2_E_SQRT);

/// Side of a block in pixels.
pub const BLOCK: usize = 4;
const BLOCKS_X: usize = TILE_WIDTH / BLOCK;
const BLOCKS_Y: usize = TILE_HEIGHT / BLOCK;
const BLOCKS: usize = BLOCKS_X * BLOCKS_Y;

/// Planes of a block's state.
pub mod plane {
    /// Transmittance while the pixel is open, 0 once it is finished.
    pub const TRANSMITTANCE: usize = 0;
    /// Transmittance at which the pixel was finished.
    pub const FINAL: usize = 1;
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
    pub const ALPHA_DXDY: usize = 18;
    pub const COLOR_DXDY: usize = 19;
    pub const COUNT: usize = 22;
}

/// State of sixteen pixels, row by row.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub struct Block(pub [[f32; 16]; plane::COUNT]);

/// What [`blend_tile`] computes; kernels are compiled once for each.
pub const COLOR: usize = 0;
/// With gradients, depth and normal.
pub const GBUFFER: usize = 1;
/// With the mixed derivative too.
pub const GBUFFER_MIXED: usize = 2;

/// State of a tile and its sorted keys; one per thread, reused.
pub struct TileScratch {
    pub blocks: Box<[Block; BLOCKS]>,
    keys: Vec<u64>,
    splats: Vec<Splat>,
    geometry: Vec<SplatGeometry>,
}

impl Default for TileScratch {
    fn default() -> Self {
        Self {
            blocks: Box::new([Block([[0.0; 16]; plane::COUNT]); BLOCKS]),
            keys: Vec::new(),
            splats: Vec::new(),
            geometry: Vec::new(),
        }
    }
}

/// Blends tile `(column, row)` of an image of `size` pixels into `scratch.blocks`.
#[inline(always)]
pub fn blend_tile<S: Simd, const OUTPUTS: usize>(
    s: S,
    jobs: &[Projected],
    bins: &Bins,
    [column, row]: [usize; 2],
    [width, height]: [usize; 2],
    scratch: &mut TileScratch,
) {
    let (x0, y0) = (column * TILE_WIDTH, row * TILE_HEIGHT);
    let mut open = start_tile::<OUTPUTS>(&mut scratch.blocks, width - x0, height - y0);
    let columns = width.div_ceil(TILE_WIDTH);
    scratch.keys.clear();
    scratch.keys.extend(bins.keys(row * columns + column));
    scratch.keys.sort_unstable();
    let TileScratch { blocks, keys, splats, geometry } = scratch;

    let lane_x = f32x16::from_slice(s, &LANE_X);
    let lane_y = f32x16::from_slice(s, &LANE_Y);
    for keys in keys.chunks(GATHER) {
        // Copying a run of splats first lets their cache misses overlap; blending one by one would wait for each.
        splats.clear();
        splats.extend(keys.iter().map(|&key| {
            let (job, local) = splat_of_key(key);
            jobs[job].splats[local]
        }));
        if OUTPUTS != COLOR {
            geometry.clear();
            geometry.extend(keys.iter().map(|&key| {
                let (job, local) = splat_of_key(key);
                jobs[job].geometry[local]
            }));
        }
        for (i, splat) in splats.iter().enumerate() {
            let mut touched = block_mask(splat, x0, y0) & open;
            if touched == 0 {
                continue;
            }
            let none = SplatGeometry::default();
            let kernel = SplatKernel::new(s, splat, if OUTPUTS == COLOR { &none } else { &geometry[i] });
            while touched != 0 {
                let b = touched.trailing_zeros() as usize;
                touched &= touched - 1;
                let x = splat.mean[0] - (x0 + b % BLOCKS_X * BLOCK) as f32;
                let y = splat.mean[1] - (y0 + b / BLOCKS_X * BLOCK) as f32;
                let dx = lanes(s, x) - lane_x;
                let dy = lanes(s, y) - lane_y;
                if kernel.blend::<OUTPUTS>(s, dx, dy, &mut blocks[b].0) {
                    open &= !(1 << b);
                }
            }
        }
        if open == 0 {
            break;
        }
    }
}

/// Splats copied at a time: 256 × 88 B stay in the second-level cache beside the tile's state.
const GATHER: usize = 256;

const LANE_X: [f32; 16] = [0., 1., 2., 3., 0., 1., 2., 3., 0., 1., 2., 3., 0., 1., 2., 3.];
const LANE_Y: [f32; 16] = [0., 0., 0., 0., 1., 1., 1., 1., 2., 2., 2., 2., 3., 3., 3., 3.];

/// Clears the state; pixels outside the image start finished. Returns the mask of blocks with open pixels.
fn start_tile<const OUTPUTS: usize>(
    blocks: &mut [Block; BLOCKS],
    width_left: usize,
    height_left: usize,
) -> u32 {
    let planes = match OUTPUTS {
        COLOR => plane::ALPHA_DX,
        GBUFFER => plane::ALPHA_DXDY,
        _ => plane::COUNT,
    };
    let mut open = 0;
    for (b, block) in blocks.iter_mut().enumerate() {
        let (x, y) = (b % BLOCKS_X * BLOCK, b / BLOCKS_X * BLOCK);
        if x >= width_left || y >= height_left {
            continue;
        }
        open |= 1 << b;
        block.0[..planes].fill([0.0; 16]);
        for lane in 0..16 {
            let inside = x + lane % BLOCK < width_left && y + lane / BLOCK < height_left;
            block.0[plane::TRANSMITTANCE][lane] = if inside { 1.0 } else { 0.0 };
        }
    }
    open
}

/// Blocks of the tile at `(x0, y0)` that the support touches.
#[inline(always)]
fn block_mask(splat: &Splat, x0: usize, y0: usize) -> u32 {
    let rect = splat.rect;
    let clip = |v: u16, origin: usize, size: usize| (v as usize).saturating_sub(origin).min(size);
    let (left, right) = (clip(rect.x0, x0, TILE_WIDTH), clip(rect.x1, x0, TILE_WIDTH));
    let (top, bottom) = (clip(rect.y0, y0, TILE_HEIGHT), clip(rect.y1, y0, TILE_HEIGHT));
    if left >= right || top >= bottom {
        return 0;
    }
    let (bx0, bx1) = (left / BLOCK, (right - 1) / BLOCK);
    let (by0, by1) = (top / BLOCK, (bottom - 1) / BLOCK);
    let row_bits = |from: usize, to: usize| ((2_u32 << to) - 1) & !((1_u32 << from) - 1) & 0xff;
    if bx1 - bx0 < 2 || by1 == by0 {
        // 0x01010101 repeats a row's byte in every row.
        let rows = (0x0101_0101_u32 >> (8 * (BLOCKS_Y - 1 - (by1 - by0)))) << (8 * by0);
        return row_bits(bx0, bx1) * rows;
    }
    let mut mask = 0;
    for by in by0..=by1 {
        let y = (y0 + by * BLOCK) as f32;
        let [from, to] = splat.x_span(y, y + (BLOCK - 1) as f32);
        let from = (from - x0 as f32).max(0.0) as usize / BLOCK;
        let to = to - x0 as f32;
        if to < 0.0 || from > bx1 {
            continue;
        }
        let (from, to) = (from.max(bx0), (to as usize / BLOCK).min(bx1));
        if from <= to {
            mask |= row_bits(from, to) << (by * BLOCKS_X);
        }
    }
    mask
}

/// A splat's constants in all lanes.
struct SplatKernel<S: Simd> {
    l11: f32x16<S>,
    l21: f32x16<S>,
    l22: f32x16<S>,
    opacity: f32x16<S>,
    color: [f32x16<S>; 3],
    ray_distance: f32x16<S>,
    ray_plane: [f32x16<S>; 2],
    normal: [f32x16<S>; 3],
}

impl<S: Simd> SplatKernel<S> {
    #[inline(always)]
    fn new(s: S, splat: &Splat, geometry: &SplatGeometry) -> Self {
        Self {
            l11: lanes(s, splat.l11),
            l21: lanes(s, splat.l21),
            l22: lanes(s, splat.l22),
            opacity: lanes(s, splat.opacity),
            color: lanes3(s, splat.color),
            ray_distance: lanes(s, geometry.ray_distance),
            ray_plane: [lanes(s, geometry.ray_plane[0]), lanes(s, geometry.ray_plane[1])],
            normal: lanes3(s, geometry.normal),
        }
    }

    /// Blends the splat over one block; `dx`, `dy` are mean − sample. Returns whether the block is finished.
    #[inline(always)]
    fn blend<const OUTPUTS: usize>(
        &self,
        s: S,
        dx: f32x16<S>,
        dy: f32x16<S>,
        state: &mut [[f32; 16]; plane::COUNT],
    ) -> bool {
        let (zero, one) = (lanes(s, 0.0), lanes(s, 1.0));
        let u = self.l11.mul_add(dx, self.l21 * dy);
        let v = self.l22 * dy;
        let raw = self.opacity * exp2(s, zero - u.mul_add(u, v * v));
        let t = f32x16::from_slice(s, &state[plane::TRANSMITTANCE]);
        let hit = raw.simd_ge(lanes(s, MIN_ALPHA)) & t.simd_gt(zero);
        if !hit.any_true() {
            return false;
        }
        let alpha = raw.min(lanes(s, MAX_ALPHA));
        let after = t * (one - alpha);
        let finished = hit & after.simd_lt(lanes(s, MIN_TRANSMITTANCE));
        let blended = hit & after.simd_ge(lanes(s, MIN_TRANSMITTANCE));
        let alpha = blended.select(alpha, zero);
        let weight = alpha * t;

        for k in 0..3 {
            accumulate(s, &mut state[plane::COLOR + k], self.color[k], weight);
        }
        if OUTPUTS >= GBUFFER {
            // g = (A·dx + B·dy, B·dx + C·dy) from the factor; α derivatives vanish where α is capped.
            let slope = raw.simd_lt(lanes(s, MAX_ALPHA)).select(alpha, zero);
            let gx = self.l11 * u * lanes(s, UNSCALE);
            let gy = self.l21.mul_add(u, self.l22 * v) * lanes(s, UNSCALE);
            let (alpha_x, alpha_y) = (slope * gx, slope * gy);
            let old_x = f32x16::from_slice(s, &state[plane::ALPHA_DX]);
            let old_y = f32x16::from_slice(s, &state[plane::ALPHA_DY]);
            let weight_x = t.mul_add(alpha_x, zero - old_x * alpha);
            let weight_y = t.mul_add(alpha_y, zero - old_y * alpha);
            for k in 0..3 {
                accumulate(s, &mut state[plane::COLOR_DX + k], self.color[k], weight_x);
                accumulate(s, &mut state[plane::COLOR_DY + k], self.color[k], weight_y);
            }
            if OUTPUTS == GBUFFER_MIXED {
                let b = self.l11 * self.l21 * lanes(s, UNSCALE);
                let alpha_xy = slope * gx.mul_add(gy, zero - b);
                let old_xy = f32x16::from_slice(s, &state[plane::ALPHA_DXDY]);
                let cross = old_x.mul_add(alpha_y, old_y * alpha_x);
                let fresh = t.mul_add(alpha_xy, zero - cross);
                let weight_xy = fresh - old_xy * alpha;
                for k in 0..3 {
                    accumulate(s, &mut state[plane::COLOR_DXDY + k], self.color[k], weight_xy);
                }
                (old_xy + weight_xy).store_slice(&mut state[plane::ALPHA_DXDY]);
            }
            // A(1 − α) + T·αx = A + weight_x, and likewise for the others.
            (old_x + weight_x).store_slice(&mut state[plane::ALPHA_DX]);
            (old_y + weight_y).store_slice(&mut state[plane::ALPHA_DY]);

            let distance = self.ray_plane[0].mul_add(dx, self.ray_plane[1].mul_add(dy, self.ray_distance));
            accumulate(s, &mut state[plane::DISTANCE], distance, weight);
            let in_front = blended & t.simd_gt(lanes(s, 0.5));
            let median = f32x16::from_slice(s, &state[plane::MEDIAN]);
            in_front.select(distance, median).store_slice(&mut state[plane::MEDIAN]);
            for k in 0..3 {
                accumulate(s, &mut state[plane::NORMAL + k], self.normal[k], weight);
            }
        }

        let t_next = blended.select(after, t);
        if finished.any_true() {
            let last = f32x16::from_slice(s, &state[plane::FINAL]);
            finished.select(t, last).store_slice(&mut state[plane::FINAL]);
            let t_next = finished.select(zero, t_next);
            t_next.store_slice(&mut state[plane::TRANSMITTANCE]);
            return t_next.simd_le(zero).all_true();
        }
        t_next.store_slice(&mut state[plane::TRANSMITTANCE]);
        false
    }
}

#[inline(always)]
fn lanes<S: Simd>(s: S, v: f32) -> f32x16<S> {
    f32x16::splat(s, v)
}

#[inline(always)]
fn lanes3<S: Simd>(s: S, v: [f32; 3]) -> [f32x16<S>; 3] {
    [lanes(s, v[0]), lanes(s, v[1]), lanes(s, v[2])]
}

/// `plane += a · b`.
#[inline(always)]
fn accumulate<S: Simd>(s: S, plane: &mut [f32; 16], a: f32x16<S>, b: f32x16<S>) {
    a.mul_add(b, f32x16::from_slice(s, plane)).store_slice(plane);
}
