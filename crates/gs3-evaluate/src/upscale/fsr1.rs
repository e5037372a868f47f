//! AMD FidelityFX Super Resolution 1.0, from its public description: edge-adaptive spatial upsampling (EASU: a
//! Lanczos-like kernel of twelve taps, rotated and stretched along the local edge, clamped to its four nearest
//! samples), then robust contrast-adaptive sharpening (RCAS). Full-precision divisions and roots stand where shaders
//! approximate.
//!
//! Held against a second transcription (`oracle/upscale.py`), for want of an independent implementation outside
//! shaders.

use fearless_simd::prelude::*;
use fearless_simd::{dispatch, f32x16};
use gs3_scene::{GBuffer, Image, Planes};
use rayon::prelude::*;

use super::lattice::{LANES, PAD, Padded, Phase, PhaseRow, phases};
use super::{UpscaleError, Upscaler, check_size};

/// FSR 1: EASU followed by RCAS.
#[derive(Clone, Debug)]
pub struct Fsr1 {
    /// Sharpening in stops: each halves it, 0 is the strongest.
    stops: f32,
    lr: Padded,
    upsampled: Image,
    planar: Planes<3>,
}

impl Default for Fsr1 {
    /// The default of AMD's samples, 0.2 stops.
    fn default() -> Self {
        Self { stops: 0.2, lr: Padded::default(), upsampled: Image::default(), planar: Planes::default() }
    }
}

impl Upscaler for Fsr1 {
    fn upscale(&mut self, lr: &GBuffer, scale: u32, out: &mut Image) -> Result<(), UpscaleError> {
        check_size(lr, scale, out)?;
        // Both passes are defined on display-encoded colours in [0, 1].
        self.lr.fill(&lr.color, |v| v.clamp(0.0, 1.0));
        self.upsampled.resize(out.width(), out.height());
        easu(&self.lr, scale, lr.jitter, &mut self.upsampled);
        rcas(&self.upsampled, (-self.stops).exp2(), &mut self.planar, out);
        Ok(())
    }
}

/// Number of the taps' positions in a 4×4 grid around the place, corners left out: rows −1, 0, 1, 2.
///
/// ```text
///     b c
///   e f g h      the place lies between f, g, j, k
///   i j k l
///     n o
/// ```
const B: usize = 1;
const C: usize = 2;
const E: usize = 4;
const F: usize = 5;
const G: usize = 6;
const H: usize = 7;
const I: usize = 8;
const J: usize = 9;
const K: usize = 10;
const L: usize = 11;
const N: usize = 13;
const O: usize = 14;
const TAPS: [usize; 12] = [B, C, E, F, G, H, I, J, K, L, N, O];
/// For each of f, g, j, k: the samples above, left, centre, right, below.
const CROSSES: [[usize; 5]; 4] = [[B, E, F, G, J], [C, F, G, H, K], [F, I, J, K, N], [G, J, K, L, O]];

fn easu(lr: &Padded, scale: u32, jitter: [f32; 2], out: &mut Image) {
    let [xs, ys] = jitter.map(|jitter| phases(scale, jitter));
    let level = gs3_simd::level();
    let width = out.width();
    out.pixels_mut().par_chunks_exact_mut(width).enumerate().for_each_init(
        || PhaseRow::new(scale, lr),
        |phase_row, (y, row)| {
            let (k, r) = ((y / scale as usize) as isize, y % scale as usize);
            dispatch!(level, simd => easu_row(simd, lr, k, ys[r], &xs, phase_row));
            phase_row.interleave(row);
        },
    );
}

#[inline(always)]
fn easu_row<S: Simd>(simd: S, lr: &Padded, k: isize, down: Phase, xs: &[Phase], out: &mut PhaseRow) {
    let mut rows: [[&[f32]; 4]; 3] = [[&[]; 4]; 3];
    for (c, rows) in rows.iter_mut().enumerate() {
        for (i, row) in rows.iter_mut().enumerate() {
            *row = lr.row(c, k + down.offset - 1 + i as isize);
        }
    }
    for (r, across) in xs.iter().enumerate() {
        for block in 0..lr.blocks() {
            let at = (PAD + block * LANES).wrapping_add_signed(across.offset - 1);
            let zero = f32x16::splat(simd, 0.0);
            let mut taps = [[zero; 16]; 3];
            for (c, taps) in taps.iter_mut().enumerate() {
                for &tap in &TAPS {
                    let start = at + tap % 4;
                    taps[tap] = f32x16::from_slice(simd, &rows[c][tap / 4][start..start + LANES]);
                }
            }
            let colour = easu_pixels(simd, &taps, across.fraction, down.fraction);
            for (c, colour) in colour.iter().enumerate() {
                colour.store_slice(out.block(c, r, block));
            }
        }
    }
}

/// Sixteen pixels at the place `(px, py)` between their samples f, g, j, k.
#[inline(always)]
fn easu_pixels<S: Simd>(simd: S, taps: &[[f32x16<S>; 16]; 3], px: f32, py: f32) -> [f32x16<S>; 3] {
    let zero = f32x16::splat(simd, 0.0);
    let one = f32x16::splat(simd, 1.0);
    let mut luma = [zero; 16];
    for &tap in &TAPS {
        luma[tap] = taps[2][tap].mul_add(0.5, taps[0][tap].mul_add(0.5, taps[1][tap]));
    }
    // Direction and straightness of the edge, bilinearly weighted over the four nearest samples.
    let weights = [(1.0 - px) * (1.0 - py), px * (1.0 - py), (1.0 - px) * py, px * py];
    let (mut dir_x, mut dir_y, mut length) = (zero, zero, zero);
    for (&[up, left, centre, right, below], weight) in CROSSES.iter().zip(weights) {
        for (low, high, dir) in [(left, right, &mut dir_x), (up, below, &mut dir_y)] {
            let (low, mid, high) = (luma[low], luma[centre], luma[high]);
            let slope = high - low;
            let steepest = (high - mid).abs().max((mid - low).abs());
            *dir = slope.mul_add(weight, *dir);
            // 0/0 where nothing changes counts as 0.
            let share = (slope.abs() / steepest).max_precise(0.0).min_precise(1.0);
            length = (share * share).mul_add(weight, length);
        }
    }
    let norm2 = dir_x.mul_add(dir_x, dir_y * dir_y);
    let is_flat = norm2.simd_lt(1.0 / 32768.0);
    let norm = is_flat.select(one, norm2.sqrt());
    let (dir_x, dir_y) = (is_flat.select(one, dir_x) / norm, dir_y / norm);
    let length = (length * 0.5) * (length * 0.5);
    // From a disc to an ellipse along the edge: longer along it (up to √2 on diagonals), narrower across.
    let stretch = dir_x.mul_add(dir_x, dir_y * dir_y) / dir_x.abs().max(dir_y.abs());
    let scale_x = (stretch - 1.0).mul_add(length, one);
    let scale_y = length.mul_add(-0.5, one);
    // The strength of the negative lobe, and the window's end that follows from it.
    let lobe = length.mul_add((0.25 - 0.04) - 0.5, f32x16::splat(simd, 0.5));
    let end = one / lobe;
    let mut sums = [zero; 3];
    let mut total = zero;
    for &tap in &TAPS {
        let (x, y) = ((tap % 4) as f32 - 1.0 - px, (tap / 4) as f32 - 1.0 - py);
        let along = (dir_x * x + dir_y * y) * scale_x;
        let across = (dir_x * y - dir_y * x) * scale_y;
        let distance2 = along.mul_add(along, across * across).min(end);
        // (25/16 (2/5 d² − 1)² − (25/16 − 1)) (lobe d² − 1)² approximates Lanczos-2.
        let base = distance2.mul_add(2.0 / 5.0, -one);
        let window = lobe.mul_add(distance2, -one);
        let weight =
            (base * base).mul_add(25.0 / 16.0, f32x16::splat(simd, 1.0 - 25.0 / 16.0)) * (window * window);
        total += weight;
        for (sum, taps) in sums.iter_mut().zip(taps) {
            *sum = taps[tap].mul_add(weight, *sum);
        }
    }
    for (sum, taps) in sums.iter_mut().zip(taps) {
        let lowest = taps[F].min(taps[G]).min(taps[J].min(taps[K]));
        let highest = taps[F].max(taps[G]).max(taps[J].max(taps[K]));
        *sum = (*sum / total).max(lowest).min(highest);
    }
    sums
}

/// Largest magnitude of the sharpening lobe.
const RCAS_LIMIT: f32 = 0.25 - 1.0 / 16.0;

fn rcas(image: &Image, sharpness: f32, planar: &mut Planes<3>, out: &mut Image) {
    let (width, height) = (image.width(), image.height());
    planar.resize(width, height);
    planar.data_mut().par_chunks_exact_mut(width).enumerate().for_each(|(i, row)| {
        let (c, y) = (i / height, i % height);
        row.iter_mut().zip(image.row(y)).for_each(|(to, from)| *to = from[c]);
    });
    let mut padded = Padded::default();
    padded.fill(planar, |v| v);
    let padded = &padded;
    let level = gs3_simd::level();
    out.pixels_mut().par_chunks_exact_mut(width).enumerate().for_each_init(
        || PhaseRow::new(1, padded),
        |phase_row, (y, row)| {
            dispatch!(level, simd => rcas_row(simd, padded, y as isize, sharpness, phase_row));
            phase_row.interleave(row);
        },
    );
}

#[inline(always)]
fn rcas_row<S: Simd>(simd: S, image: &Padded, y: isize, sharpness: f32, out: &mut PhaseRow) {
    for block in 0..image.blocks() {
        let at = PAD + block * LANES;
        let zero = f32x16::splat(simd, 0.0);
        let mut centres = [zero; 3];
        let mut rings = [zero; 3];
        let mut lobe = f32x16::splat(simd, -RCAS_LIMIT);
        for c in 0..3 {
            let (row, above, below) = (image.row(c, y), image.row(c, y - 1), image.row(c, y + 1));
            let up = f32x16::from_slice(simd, &above[at..at + LANES]);
            let down = f32x16::from_slice(simd, &below[at..at + LANES]);
            let left = f32x16::from_slice(simd, &row[at - 1..at - 1 + LANES]);
            let right = f32x16::from_slice(simd, &row[at + 1..at + 1 + LANES]);
            let lowest = up.min(down).min(left.min(right));
            let highest = up.max(down).max(left.max(right));
            centres[c] = f32x16::from_slice(simd, &row[at..at + LANES]);
            rings[c] = up + down + left + right;
            // The lobe at which the result would reach 0, and the one at which it would reach 1. A black or a white
            // ring divides 0 by 0 and sets no limit of its own.
            let to_black = lowest / (highest * 4.0);
            let to_white =
                (f32x16::splat(simd, 1.0) - highest) / lowest.mul_add(4.0, f32x16::splat(simd, -4.0));
            lobe = lobe.max_precise((-to_black).max_precise(to_white));
        }
        let lobe = lobe.min(0.0) * sharpness;
        let norm = f32x16::splat(simd, 1.0) / lobe.mul_add(4.0, f32x16::splat(simd, 1.0));
        for c in 0..3 {
            (rings[c].mul_add(lobe, centres[c]) * norm).store_slice(out.block(c, 0, block));
        }
    }
}
