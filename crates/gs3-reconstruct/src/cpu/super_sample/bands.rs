//! The pixels of a frame: bands of rows, filled a tile at a time with the samples of all remembered frames.

use std::ops::Range;
use std::slice;

use fearless_simd::{Simd, dispatch};
use gs3_scene::{Image, block_grid};
use gs3_simd::prefetch;
use rayon::prelude::*;

use super::SuperSampler;
use crate::cpu::boxes::BoxLimits;
use crate::cpu::kriging::Neighborhoods;
use crate::cpu::nearest::{EVERY, RIM};
use crate::cpu::splat::REACH;
use crate::cpu::tile::{Tile, Wanted};
use crate::cpu::tile_size::{RING, TILE_HEIGHT, TILE_WIDTH};
use crate::sample_grid::SampledPixels;
use crate::settings::MAX_PAST;

/// Rows of pixels in a strip. The samples of all frames are added to one strip of a tile before the next strip, so
/// that the strip's pixels stay in the first-level cache.
const STRIP: f32 = 8.0;

/// Number of chunks of samples that are queued before they are added.
const QUEUE: usize = 256;

/// How many chunks ahead memory is prefetched: sixteen samples take about a hundred nanoseconds, and memory takes a
/// few hundred.
const AHEAD: usize = 3;

/// The same for passes that read depths only.
const DEPTHS_AHEAD: usize = 8;

/// Most frames in the history, exact blocks counted as frames of their own.
const MAX_SOURCES: usize = 2 * MAX_PAST;

/// A chunk of samples of a past frame.
#[derive(Clone, Copy, Debug, Default)]
struct Task {
    source: u16,
    row: u16,
    chunk: u16,
}

/// Whole rows of pixels, and the rows of current samples on these pixels.
struct Band<'a> {
    top: usize,
    pixels: &'a mut [[f32; 4]],
    errors: &'a mut [f32],
    innovation: &'a mut [[f32; 4]],
    /// Index of the first row of `innovation` among all rows.
    first_row: usize,
}

impl SuperSampler {
    /// Combines the past samples with the interpolated current frame.
    pub(super) fn accumulate(&mut self, out: &mut Image) {
        let size = out.size();
        let [width, _] = size.to_usize();
        let mut innovation = std::mem::take(&mut self.innovation);
        let frame = &self.past[0].frame;
        let [columns, lines] = frame.picture_size();
        innovation.clear();
        innovation.resize(columns * lines, [0.0; 4]);
        let mut errors = std::mem::take(&mut self.errors);
        let blocks = block_grid(size);
        errors.clear();
        errors.resize(blocks[0] * blocks[1], 0.0);
        let band_errors = errors.chunks_mut(TILE_HEIGHT / 4 * blocks[0]);
        let sampled = SampledPixels::new(frame.jitter, self.scale);
        let mut rest = &mut innovation[..];
        let bands: Vec<Band<'_>> =
            (out.pixels_mut().chunks_mut(TILE_HEIGHT * width).zip(band_errors).enumerate())
                .map(|(band, (pixels, errors))| {
                    let top = band * TILE_HEIGHT;
                    let rows = sampled.map_or(0..0, |sampled| sampled.rows(top, pixels.len() / width));
                    let rows = rows.start.min(lines)..rows.end.min(lines);
                    let part = rest.split_off_mut(..rows.len() * columns).unwrap_or_default();
                    Band { top, pixels, errors, innovation: part, first_row: rows.start }
                })
                .collect();
        let neighborhoods = || self.kriging.threshold().map(Neighborhoods::new);
        bands.into_par_iter().for_each_init(neighborhoods, |neighborhoods, band| {
            self.tiles.with(neighborhoods, |tile| {
                dispatch!(self.level, simd => self.fill_band(simd, band, size.to_usize(), sampled, tile));
            });
        });
        (self.innovation, self.errors) = (innovation, errors);
    }

    /// Fills a band of an image of `[width, height]`, in the memory of `tile`. The current samples lie on the pixels
    /// of `sampled`.
    #[inline(always)]
    fn fill_band<'a, S: Simd>(
        &'a self,
        simd: S,
        band: Band<'_>,
        [width, height]: [usize; 2],
        sampled: Option<SampledPixels>,
        tile: &mut Tile<'a>,
    ) {
        let Band { top, pixels: rows, errors, innovation, first_row } = band;
        let with_ring = |start: usize, count: usize, all: usize| {
            let first = start.saturating_sub(RING);
            (first, (start + count + RING).min(all) - first)
        };
        let rows_wanted = rows.len() / width;
        (tile.top, tile.height) = with_ring(top, rows_wanted, height);
        let mut of_past: [Range<usize>; MAX_SOURCES] = [const { 0..0 }; MAX_SOURCES];
        for (past, of_past) in self.past.iter().zip(&mut of_past) {
            *of_past = past.boxes.rows_meeting(self.limits(tile, past.age).wider(RIM as f32 - REACH));
        }
        for left in (0..width).step_by(TILE_WIDTH) {
            let wanted =
                Wanted { left, top, width: TILE_WIDTH.min(width - left), height: rows_wanted, stride: width };
            (tile.left, tile.width) = with_ring(left, wanted.width, width);
            let bare = self.bare_color(simd, tile, &of_past);
            if let Some([r, g, b]) = bare {
                for row in rows.chunks_exact_mut(width) {
                    row[left..left + wanted.width].fill([r, g, b, 0.0]);
                }
                continue;
            }
            let current = &self.past[0].frame;
            tile.begin(simd, &self.surface, self.scale as f32);
            if let Some(sampled) = &sampled {
                tile.clear_pixels(sampled);
            }
            self.splat_depths(simd, tile, &of_past);
            self.add_frames(simd, tile, 1, &of_past);
            if let Some(sampled) = &sampled {
                tile.insert_current(sampled, current, &wanted, innovation, first_row);
            }
            self.add_frames(simd, tile, 0, &of_past[..1]);
            tile.resolve(simd, &wanted, rows, errors);
        }
    }

    /// The pixels where samples of the frame of age `age` can affect `tile`. Past samples reach out by a few pixels;
    /// the current frame is interpolated from samples within a cell.
    fn limits(&self, tile: &Tile<'_>, age: usize) -> BoxLimits {
        let reach = if age == 0 { REACH.max(self.scale as f32 + 1.0) } else { REACH };
        let ends = |first: usize, count: usize| [first as f32 - reach, (first + count) as f32 + reach];
        let ([left, right], [top, bottom]) = (ends(tile.left, tile.width), ends(tile.top, tile.height));
        BoxLimits { left, right, top, bottom }
    }

    /// The colour of the tile if the current frame and the history show only background of one colour there.
    /// `of_past` are the row ranges to examine.
    #[inline(always)]
    fn bare_color<S: Simd>(&self, simd: S, tile: &Tile<'_>, of_past: &[Range<usize>]) -> Option<[f32; 3]> {
        let mut color = None;
        for (past, rows) in self.past.iter().zip(of_past) {
            let limits = self.limits(tile, past.age);
            for (row, chunk) in past.boxes.chunks_meeting(simd, rows.clone(), limits) {
                let bare = past.frame.extents(row)[chunk].bare?;
                if *color.get_or_insert(bare) != bare {
                    return None;
                }
            }
        }
        color
    }

    /// Finds the nearest depths in `tile` and around it. `of_past` are the row ranges to examine.
    #[inline(always)]
    fn splat_depths<S: Simd>(&self, simd: S, tile: &mut Tile<'_>, of_past: &[Range<usize>]) {
        let rim = RIM as f32;
        let limits = self.limits(tile, 1).wider(rim - REACH);
        tile.nearest.clear();
        let frames = self.past.iter().zip(of_past).filter(|(past, _)| past.age.is_multiple_of(EVERY));
        for (past, rows) in frames {
            let source = past.source(self.scale);
            let (mut waiting, mut count) = ([(0, 0); DEPTHS_AHEAD], 0);
            for (row, chunk) in past.boxes.chunks_meeting(simd, rows.clone(), limits) {
                prefetch(past.frame.chunk(row, chunk).inverse_depth());
                let (row, chunk) = std::mem::replace(&mut waiting[count % DEPTHS_AHEAD], (row, chunk));
                count += 1;
                if count > DEPTHS_AHEAD {
                    tile.splat_depth(simd, &source, row, chunk);
                }
            }
            for (row, chunk) in &waiting[..count.min(DEPTHS_AHEAD)] {
                tile.splat_depth(simd, &source, *row, *chunk);
            }
        }
        tile.nearest.spread(simd);
    }

    /// Adds samples of past frames to `tile`, strip by strip: frames of ages from `youngest` to the end of `of_past`,
    /// the row ranges to examine.
    #[inline(always)]
    fn add_frames<'a, S: Simd>(
        &'a self,
        simd: S,
        tile: &mut Tile<'a>,
        youngest: usize,
        of_past: &[Range<usize>],
    ) {
        let limits = self.limits(tile, 1);
        let (mut from, end) = (limits.top, limits.bottom);
        let (mut queue, mut count) = ([Task::default(); QUEUE], 0);
        while from <= end {
            // A chunk belongs to the strip that it begins in. A chunk that begins above the tile belongs to the first
            // strip.
            let first = if from == limits.top { f32::NEG_INFINITY } else { from };
            let strip = first..from + STRIP;
            for (k, (past, rows)) in self.past.iter().zip(of_past).enumerate().skip(youngest) {
                for (row, chunk) in past.boxes.chunks_beginning(simd, rows.clone(), limits, strip.clone()) {
                    // All of these numbers are far below 2¹⁶.
                    queue[count] = Task { source: k as u16, row: row as u16, chunk: chunk as u16 };
                    count += 1;
                    if count == QUEUE {
                        self.add_all(tile, &queue);
                        count = 0;
                    }
                }
            }
            from += STRIP;
        }
        self.add_all(tile, &queue[..count]);
    }

    /// Adds chunks of samples to `tile`, in order.
    fn add_all<'a>(&'a self, tile: &mut Tile<'a>, tasks: &[Task]) {
        dispatch!(self.level, simd => for (k, task) in tasks.iter().enumerate() {
            if let Some(next) = tasks.get(k + AHEAD) {
                let frame = &self.past[next.source as usize].frame;
                prefetch(slice::from_ref(frame.chunk(next.row as usize, next.chunk as usize)));
            }
            let source = self.past[task.source as usize].source(self.scale);
            tile.splat_color(simd, &source, &self.rectification, task.row as usize, task.chunk as usize);
        });
    }
}
