//! One LR frame as exact point samples of the HR image: colour, gradient, inverse depth.

mod chunk;
mod fill;

use fearless_simd::{Simd, f32x16, mask32x16, prelude::*};
use gs3_scene::{BLOCK_SIDE, Margin, Planes};
use rayon::prelude::*;

use crate::cpu::displacement::Displacement;
pub(crate) use crate::cpu::lanes::CHUNK;
use chunk::Extent;
pub(crate) use chunk::{Chunk, DX, DY, Sample};

/// A sample is beside a nearer surface if its inverse depth is below this share of a neighbouring sample's inverse
/// depth. Larger ratios may be the slant of one surface. (Empirical: 0.95 gains 0.1 dB over 0.8 at 1920×1080, and
/// loses 0.15 at 160×90.)
pub(crate) const EDGE_RATIO: f32 = 0.9;

/// Share of a nearer surface's motion that counts as crossing its edge. Edges also lie along the motion, and not
/// every sample beside an edge shows it. (Empirical, at 1920×1080: 0 loses 0.2 to 0.3 dB where the camera moves; 0.3
/// to 1 are alike within 0.2. At 160×90, where texture often looks like an edge, 1 loses 0.5 dB.)
pub(crate) const CROSSING: f32 = 0.5;

/// The same for the samples of exact blocks, with a pixel between samples. (Empirical, frames 10 to 22 of nine paths: 1 gains
/// 0.0 to 0.15 dB over 0.5 on fungi and lacadiere, and loses at most 0.02 dB elsewhere. 2 gains up to 0.13 dB more there, and
/// loses up to 0.1 dB on hqgarden.)
pub(crate) const CROSSING_OF_BLOCKS: f32 = 1.0;

/// Added to the column and to the row of the LR sample nearest to a block's middle, before both are rounded down. A block
/// with its middle half-way between two samples takes the second one, however machines round. The samples' places are off
/// by 1e-3 LR pixels at most: 2⁻²³ of 8192.
pub(crate) const HALF_WAY: f32 = 2e-3;

/// The layout of a frame's samples.
#[derive(Clone, Debug, Default)]
enum Layout {
    /// Sixteen samples in a row of LR pixels are a chunk.
    #[default]
    Rows,
    /// A block of 4×4 HR pixels is a chunk; up to [`BLOCKS_PER_ROW`] blocks are a row of chunks.
    Blocks {
        /// First pixel of each block. As all values per chunk, unspecified beyond the end of a row.
        corners: Vec<[f32; 2]>,
        /// Blocks in each row.
        counts: Vec<usize>,
        /// Width and height of the picture, HR pixels.
        picture: [f32; 2],
    },
}

/// Most blocks in a row of chunks: the number of chunks in one mask of [`crate::cpu::boxes`].
const BLOCKS_PER_ROW: usize = 64;

/// The numbers of a vector's lanes. (Constants are loaded: a closure that fills lanes may be compiled without the
/// kernel's vector instructions.)
const LANES: [f32; CHUNK] = [0., 1., 2., 3., 4., 5., 6., 7., 8., 9., 10., 11., 12., 13., 14., 15.];

/// Pixel centres of a block along x, measured from the left edge of its first pixel.
const BLOCK_X: [f32; CHUNK] =
    [0.5, 1.5, 2.5, 3.5, 0.5, 1.5, 2.5, 3.5, 0.5, 1.5, 2.5, 3.5, 0.5, 1.5, 2.5, 3.5];

/// Pixel centres of a block along y.
const BLOCK_Y: [f32; CHUNK] =
    [0.5, 0.5, 0.5, 0.5, 1.5, 1.5, 1.5, 1.5, 2.5, 2.5, 2.5, 2.5, 3.5, 3.5, 3.5, 3.5];

/// Places of sixteen samples in HR pixels, and a mask of the samples that exist.
pub(crate) struct Places<S: Simd> {
    pub x: f32x16<S>,
    pub y: f32x16<S>,
    pub is_sample: mask32x16<S>,
}

/// The samples of one frame: either of an LR frame, `[height, width]`, with the samples in its margin, or of exact
/// blocks.
#[derive(Clone, Debug, Default)]
pub(crate) struct SampleFrame {
    layout: Layout,
    /// Width of an LR frame, in samples.
    pub width: usize,
    /// Number of rows of chunks.
    pub height: usize,
    /// Offset of the sample positions from the LR pixel centres, in LR pixels.
    pub jitter: [f32; 2],
    margin: Margin,
    /// `[height, chunks per row]`; the last chunk of a row may be partial.
    chunks: Vec<Chunk>,
    /// One extent per chunk.
    extents: Vec<Extent>,
    /// One displacement per chunk; empty as long as nothing has moved.
    displacements: Vec<Displacement>,
}

impl SampleFrame {
    /// Number of exact blocks.
    pub fn block_count(&self) -> usize {
        match &self.layout {
            Layout::Rows => 0,
            Layout::Blocks { counts, .. } => counts.iter().sum(),
        }
    }

    /// Whether the samples are exact blocks.
    pub const fn is_blocks(&self) -> bool {
        matches!(self.layout, Layout::Blocks { .. })
    }

    /// Keeps the exact blocks that `keep` accepts, by their row and their place in the row, and drops the others. Blocks stay
    /// in their rows, which are compact in the picture.
    pub fn retain_blocks(&mut self, keep: impl Fn(usize, usize) -> bool + Sync) {
        let Layout::Blocks { corners, counts, .. } = &mut self.layout else { return };
        let corners = corners.par_chunks_mut(BLOCKS_PER_ROW);
        let chunks = self.chunks.par_chunks_mut(BLOCKS_PER_ROW);
        let extents = self.extents.par_chunks_mut(BLOCKS_PER_ROW);
        let rows = counts.par_iter_mut().zip(corners).zip(chunks.zip(extents));
        rows.enumerate().with_min_len(64).for_each(|(row, ((count, corners), (chunks, extents)))| {
            // From the end, so that the block moved into a dropped block's place is one that stays.
            for k in (0..*count).rev().filter(|k| !keep(row, *k)) {
                *count -= 1;
                corners[k] = corners[*count];
                chunks[k] = chunks[*count];
                extents[k] = extents[*count];
            }
        });
    }

    /// The exact blocks in as much memory as they take, in the same order; none if they take at least half of their memory.
    pub fn packed(&self) -> Option<Self> {
        let Layout::Blocks { corners, counts, picture } = &self.layout else { return None };
        if self.block_count() * 2 >= self.chunks.len() {
            return None;
        }
        let of_row = |(row, count): (usize, &usize)| row * BLOCKS_PER_ROW..row * BLOCKS_PER_ROW + count;
        let places: Vec<usize> = counts.iter().enumerate().flat_map(of_row).collect();
        let corners: Vec<_> = places.iter().map(|place| corners[*place]).collect();
        let counts: Vec<_> = corners.chunks(BLOCKS_PER_ROW).map(<[_]>::len).collect();
        Some(Self {
            width: 0,
            height: counts.len(),
            jitter: self.jitter,
            margin: self.margin,
            chunks: places.par_iter().map(|place| self.chunks[*place]).collect(),
            extents: places.iter().map(|place| self.extents[*place]).collect(),
            displacements: Vec::new(),
            layout: Layout::Blocks { corners, counts, picture: *picture },
        })
    }

    /// Blocks that there is memory for.
    pub const fn capacity(&self) -> usize {
        self.chunks.capacity()
    }

    /// Places of the samples of chunk `chunk` of row `row`. LR pixels are `scale` HR pixels wide.
    #[inline(always)]
    pub fn places<S: Simd>(&self, simd: S, row: usize, chunk: usize, scale: f32) -> Places<S> {
        match &self.layout {
            Layout::Rows => {
                let column = chunk * CHUNK;
                let lanes = f32x16::from_slice(simd, &LANES);
                let [jx, jy] = self.offset();
                let first = f32x16::splat(simd, (column as f32 + 0.5 + jx) * scale);
                Places {
                    x: lanes.mul_add(scale, first),
                    y: f32x16::splat(simd, (row as f32 + 0.5 + jy) * scale),
                    is_sample: lanes.simd_lt((self.width - column) as f32),
                }
            }
            Layout::Blocks { corners, picture, .. } => {
                let [x, y] = corners[row * BLOCKS_PER_ROW + chunk];
                let x = f32x16::from_slice(simd, &BLOCK_X) + x;
                let y = f32x16::from_slice(simd, &BLOCK_Y) + y;
                Places { x, y, is_sample: x.simd_lt(picture[0]) & y.simd_lt(picture[1]) }
            }
        }
    }

    /// The first and last positions, along x and along y, of sixteen chunks of row `row` from `first` on, in HR
    /// pixels. Positions of chunks beyond the end of the row are unspecified.
    #[inline(always)]
    pub fn ends<S: Simd>(&self, simd: S, row: usize, first: usize, scale: f32) -> [[f32x16<S>; 2]; 2] {
        match &self.layout {
            Layout::Rows => {
                let [jx, jy] = self.offset();
                let start = (f32x16::from_slice(simd, &LANES) + first as f32) * CHUNK as f32;
                let end = (start + (CHUNK - 1) as f32).min((self.width - 1) as f32);
                let y = f32x16::splat(simd, (row as f32 + 0.5 + jy) * scale);
                [[(start + (0.5 + jx)) * scale, (end + (0.5 + jx)) * scale], [y, y]]
            }
            Layout::Blocks { corners, .. } => {
                let mut from = [[0.0; CHUNK]; 2];
                for (i, corner) in corners[row * BLOCKS_PER_ROW..].iter().skip(first).take(CHUNK).enumerate()
                {
                    (from[0][i], from[1][i]) = (corner[0] + 0.5, corner[1] + 0.5);
                }
                let [x, y] = [f32x16::load_array(simd, from[0]), f32x16::load_array(simd, from[1])];
                [[x, x + (BLOCK_SIDE - 1) as f32], [y, y + (BLOCK_SIDE - 1) as f32]]
            }
        }
    }

    /// Offset of the position of sample `(i, j)` from `(i + 0.5, j + 0.5)` in LR pixels of the picture: the jitter
    /// less the margin.
    #[inline(always)]
    pub fn offset(&self) -> [f32; 2] {
        let Margin { left, top, .. } = self.margin;
        [self.jitter[0] - left as f32, self.jitter[1] - top as f32]
    }

    /// Inverse depth of the sample in column `x` of row `y` of an LR frame.
    pub fn inverse_depth(&self, x: usize, y: usize) -> f32 {
        self.chunk(y, x / CHUNK).inverse_depth()[x % CHUNK]
    }

    /// The HR position and the inverse depth of the sample in column `x` of row `y` of an LR frame's picture. LR
    /// pixels are `scale` HR pixels wide.
    pub fn picture_place(&self, x: usize, y: usize, scale: f32) -> ([f32; 2], f32) {
        let Margin { left, top, .. } = self.margin;
        let at = [(x as f32 + 0.5 + self.jitter[0]) * scale, (y as f32 + 0.5 + self.jitter[1]) * scale];
        (at, self.inverse_depth(x + left as usize, y + top as usize))
    }

    /// Number of samples in a row and in a column of the picture.
    pub fn picture_size(&self) -> [usize; 2] {
        let Margin { left, top, right, bottom } = self.margin;
        [self.width - (left + right) as usize, self.height - (top + bottom) as usize]
    }

    /// The sample in column `x` of row `y` of the picture.
    #[inline(always)]
    pub fn picture_sample(&self, x: usize, y: usize) -> &Sample {
        self.sample(x + self.margin.left as usize, y + self.margin.top as usize)
    }

    /// Chunks per row of samples; the last chunk may be partial. Rows of exact blocks may have fewer chunks.
    pub const fn chunks_per_row(&self) -> usize {
        match self.layout {
            Layout::Rows => self.width.div_ceil(CHUNK),
            Layout::Blocks { .. } => BLOCKS_PER_ROW,
        }
    }

    /// Chunk `chunk` of row `row`.
    #[inline(always)]
    pub fn chunk(&self, row: usize, chunk: usize) -> &Chunk {
        &self.chunks[row * self.chunks_per_row() + chunk]
    }

    /// Displacements of the samples of chunk `chunk` of row `row`; none as long as nothing in the frame has moved.
    #[inline(always)]
    pub fn displacement(&self, row: usize, chunk: usize) -> Option<&Displacement> {
        self.displacements.get(row * self.chunks_per_row() + chunk)
    }

    /// The same, mutable. The first call allocates displacements for all chunks.
    pub fn displacement_mut(&mut self, row: usize, chunk: usize) -> Option<&mut Displacement> {
        if self.displacements.is_empty() {
            self.displacements.resize_with(self.chunks.len(), Displacement::default);
        }
        let at = row * self.chunks_per_row() + chunk;
        self.displacements.get_mut(at)
    }

    /// The extents of the chunks of row `row`.
    pub fn extents(&self, row: usize) -> &[Extent] {
        let count = match &self.layout {
            Layout::Rows => self.chunks_per_row(),
            Layout::Blocks { counts, .. } => counts[row],
        };
        &self.extents[row * self.chunks_per_row()..][..count]
    }

    /// The sample in column `x` of row `y`.
    #[inline(always)]
    pub fn sample(&self, x: usize, y: usize) -> &Sample {
        self.chunk(y, x / CHUNK).sample(x % CHUNK)
    }
}

/// Row `y` of the three colour planes.
pub(crate) fn rgb_rows(planes: &Planes<3>, y: usize) -> [&[f32]; 3] {
    std::array::from_fn(|c| planes.row(c, y))
}

#[cfg(test)]
mod tests;
