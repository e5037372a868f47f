//! One LR frame as exact point samples of the HR image: colour, gradient, inverse depth.

use fearless_simd::{Level, Simd, dispatch, f32x16, mask32x16, prelude::*};
use gs3_scene::{BLOCK_SIDE, ExactBlock, ExactBlocks, GBuffer, Gradients, Margin, Planes};
use rayon::prelude::*;

use crate::cpu::displacement::Displacement;
pub(crate) use crate::cpu::lanes::CHUNK;
use crate::cpu::lanes::load;
use crate::error::ReconstructError;
use crate::reprojection::inverse_depth_16;

/// A sample is beside a nearer surface if its inverse depth is below this share of a neighbouring sample's inverse
/// depth. Larger ratios may be the slant of one surface. (Empirical: 0.95 gains 0.1 dB over 0.8 at 1920×1080, and
/// loses 0.15 at 160×90.)
pub(crate) const EDGE_RATIO: f32 = 0.9;

/// Share of a nearer surface's motion that counts as crossing its edge. Edges also lie along the motion, and not
/// every sample beside an edge shows it. (Empirical, at 1920×1080: 0 loses 0.2 to 0.3 dB where the camera moves; 0.3
/// to 1 are alike within 0.2. At 160×90, where texture often looks like an edge, 1 loses 0.5 dB.)
pub(crate) const CROSSING: f32 = 0.5;

/// The values of one sample: RGB, ∂RGB/∂x and ∂RGB/∂y per HR pixel.
pub(crate) type Sample = [f32; 9];

/// Index of the first derivative in a sample.
pub(crate) const DX: usize = 3;
pub(crate) const DY: usize = 6;

/// Number of f32 values in all samples of a chunk.
const SAMPLES: usize = CHUNK * size_of::<Sample>() / size_of::<f32>();

/// [`CHUNK`] samples in a row. All values of these samples lie in consecutive cache lines. (In separate planes, one
/// chunk would lie on six pages, and super sampling would wait for their addresses.) Samples beyond the end of the
/// row are black and infinitely far.
///
/// First come the samples, then planes of the values that are read for all samples at once. Everything is one array,
/// so that loading four numbers is valid at the last three numbers of a sample.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct Chunk([f32; SAMPLES + 5 * CHUNK]);

impl Chunk {
    const EMPTY: Self = Self([0.0; SAMPLES + 5 * CHUNK]);

    /// `1 / z` of the median depth; 0 where there is no surface, and for frames without geometry.
    #[inline(always)]
    pub fn inverse_depth(&self) -> &[f32; CHUNK] {
        self.plane(0)
    }

    /// Colour change, per HR pixel of parallax at depth 1, of a sample beside a nearer surface. Such a sample may contain
    /// part of the nearer surface's edge, which moves away from the sample. The value is the inverse depth of the nearest
    /// of the eight samples around the sample, less the sample's own, times [`CROSSING`] and the norm of all derivatives
    /// of the sample; 0 where no neighbour is nearer.
    #[inline(always)]
    pub fn edge_slopes(&self) -> &[f32; CHUNK] {
        self.plane(1)
    }

    /// Red, green and blue again, as planes.
    #[inline(always)]
    pub fn colors(&self) -> [&[f32; CHUNK]; 3] {
        [self.plane(2), self.plane(3), self.plane(4)]
    }

    /// Sample `i`.
    #[inline(always)]
    pub fn sample(&self, i: usize) -> &Sample {
        &self.samples()[i]
    }

    /// RGB, ∂RGB/∂x and ∂RGB/∂y of sample `i`, each with an unspecified fourth number.
    #[inline(always)]
    pub fn quads(&self, i: usize) -> [&[f32]; 3] {
        let first = i * (SAMPLES / CHUNK);
        let numbers = &self.0[first..first + DY + 4];
        [&numbers[..4], &numbers[DX..DX + 4], &numbers[DY..]]
    }

    fn samples(&self) -> &[Sample] {
        self.0[..SAMPLES].as_chunks().0
    }

    #[inline(always)]
    fn plane(&self, k: usize) -> &[f32; CHUNK] {
        &self.0[SAMPLES..].as_chunks().0[k]
    }

    /// Writes plane `k`: [`Self::inverse_depth`], [`Self::edge_slopes`] or one of [`Self::colors`].
    #[inline(always)]
    fn set_plane<S: Simd>(&mut self, k: usize, values: f32x16<S>) {
        values.store_array(&mut self.0[SAMPLES..].as_chunks_mut().0[k]);
    }

    /// Writes number `k` of every sample.
    #[inline(always)]
    fn set_samples<S: Simd>(&mut self, k: usize, values: f32x16<S>) {
        let samples: &mut [Sample] = self.0[..SAMPLES].as_chunks_mut().0;
        samples.iter_mut().zip(values.to_array()).for_each(|(sample, value)| sample[k] = value);
    }
}

/// Values that the samples of a chunk share.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Extent {
    /// Smallest inverse depth.
    pub far: f32,
    /// Largest inverse depth.
    pub near: f32,
    /// The colour of all samples, if there is no surface and the colour is constant.
    pub bare: Option<[f32; 3]>,
}

/// The layout of a frame's samples.
#[derive(Clone, Debug, Default)]
enum Layout {
    /// Sixteen samples in a row of LR pixels are a chunk.
    #[default]
    Rows,
    /// A block of 4×4 HR pixels is a chunk; [`BLOCKS_PER_ROW`] blocks are a row of chunks.
    Blocks {
        /// First pixel of each block.
        corners: Vec<[f32; 2]>,
        /// Width and height of the picture, HR pixels.
        picture: [f32; 2],
    },
}

/// Blocks in a row of chunks: the number of chunks in one mask of [`crate::cpu::boxes`].
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
    /// Copies a checked G-buffer of an output `scale` times larger. Memory is reused.
    ///
    /// # Errors
    /// [`ReconstructError::Missing`] if `gbuffer` has no gradients.
    pub fn fill(&mut self, level: Level, gbuffer: &GBuffer, scale: u32) -> Result<(), ReconstructError> {
        let Some(gradients) = &gbuffer.gradients else {
            return Err(ReconstructError::Missing { what: "image gradients" });
        };
        self.layout = Layout::Rows;
        (self.width, self.height) = (gbuffer.width(), gbuffer.height());
        (self.jitter, self.margin) = (gbuffer.jitter, gbuffer.margin);
        let per_row = self.chunks_per_row();
        self.chunks.resize(per_row * self.height, Chunk::EMPTY);
        self.extents.resize(per_row * self.height, Extent::default());
        self.displacements.clear();
        let depth = gbuffer.geometry.as_ref().map(|geometry| &geometry.depth_median);
        let planes =
            SamplePlanes { color: &gbuffer.color, gradients, depth, per_hr_pixel: 1.0 / scale as f32 };
        let rows = self.chunks.par_chunks_exact_mut(per_row).zip(self.extents.par_chunks_exact_mut(per_row));
        rows.enumerate().with_min_len(8).for_each_init(Vec::new, |nearest, (y, (chunks, extents))| {
            dispatch!(level, simd => {
                planes.find_nearest(simd, y, nearest);
                for (k, (chunk, extent)) in chunks.iter_mut().zip(extents).enumerate() {
                    *extent = planes.fill_chunk(simd, [k * CHUNK, y], nearest, chunk);
                }
            });
        });
        Ok(())
    }

    /// Copies exact blocks of a picture of `[width, height]`. Memory is reused.
    pub fn fill_blocks(&mut self, level: Level, blocks: &ExactBlocks, picture: [usize; 2]) {
        let corner = |[column, row]: &[u16; 2]| [*column, *row].map(|k| (usize::from(k) * BLOCK_SIDE) as f32);
        let corners = blocks.places.iter().map(corner).collect();
        self.layout = Layout::Blocks { corners, picture: picture.map(|side| side as f32) };
        (self.width, self.height) = (0, blocks.len().div_ceil(BLOCKS_PER_ROW));
        (self.jitter, self.margin) = ([0.0; 2], Margin::NONE);
        self.chunks.resize(blocks.len(), Chunk::EMPTY);
        self.extents.resize(blocks.len(), Extent::default());
        self.displacements.clear();
        let chunks = self.chunks.par_iter_mut().zip(&mut self.extents).zip(&blocks.blocks).with_min_len(64);
        chunks.for_each(|((chunk, extent), block)| {
            dispatch!(level, simd => *extent = fill_block(simd, block, chunk));
        });
    }

    /// Number of chunks.
    pub fn chunk_count(&self) -> usize {
        self.chunks.len()
    }

    /// Whether the samples are exact blocks.
    pub const fn is_blocks(&self) -> bool {
        matches!(self.layout, Layout::Blocks { .. })
    }

    /// Keeps the exact blocks with a number that `keep` accepts, and drops the others.
    pub fn retain_blocks(&mut self, keep: impl Fn(usize) -> bool) {
        let Layout::Blocks { corners, .. } = &mut self.layout else { return };
        // From the end, so that the block moved into a dropped block's place is one that stays.
        for k in (0..corners.len()).rev().filter(|k| !keep(*k)) {
            corners.swap_remove(k);
            self.chunks.swap_remove(k);
            self.extents.swap_remove(k);
        }
        self.height = corners.len().div_ceil(BLOCKS_PER_ROW);
    }

    /// Row, and place in the row, of chunk `k` among all blocks.
    pub const fn row_of_block(k: usize) -> (usize, usize) {
        (k / BLOCKS_PER_ROW, k % BLOCKS_PER_ROW)
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
            Layout::Blocks { corners, picture } => {
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

    /// Chunks per row of samples; the last chunk may be partial. The last row of exact blocks may have fewer chunks.
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
        let rest = &self.extents[row * self.chunks_per_row()..];
        &rest[..self.chunks_per_row().min(rest.len())]
    }

    /// The sample in column `x` of row `y`.
    #[inline(always)]
    pub fn sample(&self, x: usize, y: usize) -> &Sample {
        self.chunk(y, x / CHUNK).sample(x % CHUNK)
    }
}

/// Fills the chunk of an exact block.
#[inline(always)]
fn fill_block<S: Simd>(simd: S, block: &ExactBlock, chunk: &mut Chunk) -> Extent {
    let zero = f32x16::splat(simd, 0.0);
    let (mut squares, mut is_bare) = (zero, mask32x16::splat(simd, true));
    for c in 0..3 {
        let load = |plane: &[f32; 16]| f32x16::load_array_ref(simd, plane);
        let (color, dx, dy) = (load(&block.color[c]), load(&block.color_dx[c]), load(&block.color_dy[c]));
        squares = dx.mul_add(dx, dy.mul_add(dy, squares));
        is_bare &= color.simd_eq(color[0]) & dx.simd_eq(0.0) & dy.simd_eq(0.0);
        chunk.set_plane(2 + c, color);
        chunk.set_samples(c, color);
        chunk.set_samples(DX + c, dx);
        chunk.set_samples(DY + c, dy);
    }
    let here = inverse_depth_16(simd, f32x16::load_array_ref(simd, &block.depth_median));
    let depths = here.to_array();
    // The nearest of the pixels around each pixel, within the block.
    let mut nearest = depths;
    for (i, nearest) in nearest.iter_mut().enumerate() {
        let (x, y) = (i % BLOCK_SIDE, i / BLOCK_SIDE);
        for v in y.saturating_sub(1)..(y + 2).min(BLOCK_SIDE) {
            for u in x.saturating_sub(1)..(x + 2).min(BLOCK_SIDE) {
                *nearest = nearest.max(depths[v * BLOCK_SIDE + u]);
            }
        }
    }
    let near = f32x16::load_array(simd, nearest);
    chunk.set_plane(0, here);
    let change = (near - here) * CROSSING * squares.sqrt();
    chunk.set_plane(1, here.simd_lt(near * EDGE_RATIO).select(change, zero));
    let [r, g, b] = chunk.colors().map(|plane| plane[0]);
    let is_bare = here.reduce_max() == 0.0 && is_bare.all_true();
    Extent { far: here.reduce_min(), near: here.reduce_max(), bare: is_bare.then_some([r, g, b]) }
}

/// The planes that samples are made from.
struct SamplePlanes<'a> {
    color: &'a Planes<3>,
    gradients: &'a Gradients,
    depth: Option<&'a Planes<1>>,
    /// LR pixels per HR pixel.
    per_hr_pixel: f32,
}

impl SamplePlanes<'_> {
    /// Per column of row `y`, the largest inverse depth of the samples in this row, the row above and the row below,
    /// from entry 1 on. Entries beyond the first and the last column are 0.
    #[inline(always)]
    fn find_nearest<S: Simd>(&self, simd: S, y: usize, nearest: &mut Vec<f32>) {
        let (width, height) = (self.color.width(), self.color.height());
        nearest.clear();
        nearest.resize(width.next_multiple_of(CHUNK) + 2, 0.0);
        let Some(depth) = self.depth else { return };
        let (above, below) = (y.saturating_sub(1), (y + 1).min(height - 1));
        for first in (0..width).step_by(CHUNK) {
            let at = |y: usize| inverse_depth_16(simd, load(simd, &depth.row(0, y)[first..]));
            at(above).max(at(y)).max(at(below)).store_slice(&mut nearest[1 + first..][..CHUNK]);
        }
    }

    /// Fills the chunk with its first sample in column `first` of row `y`.
    #[inline(always)]
    fn fill_chunk<S: Simd>(
        &self,
        simd: S,
        [first, y]: [usize; 2],
        nearest: &[f32],
        chunk: &mut Chunk,
    ) -> Extent {
        let zero = f32x16::splat(simd, 0.0);
        let count = CHUNK.min(self.color.width() - first);
        let is_sample = f32x16::from_fn(simd, |i| i as f32).simd_lt(count as f32);
        let Gradients { color_dx, color_dy, .. } = self.gradients;
        let (mut squares, mut is_bare) = (zero, mask32x16::splat(simd, true));
        for c in 0..3 {
            let color = load(simd, &self.color.row(c, y)[first..]);
            let dx = load(simd, &color_dx.row(c, y)[first..]) * self.per_hr_pixel;
            let dy = load(simd, &color_dy.row(c, y)[first..]) * self.per_hr_pixel;
            squares = dx.mul_add(dx, dy.mul_add(dy, squares));
            is_bare &= color.simd_eq(color[0]) & dx.simd_eq(0.0) & dy.simd_eq(0.0);
            chunk.set_plane(2 + c, color);
            chunk.set_samples(c, color);
            chunk.set_samples(DX + c, dx);
            chunk.set_samples(DY + c, dy);
        }
        let here = match self.depth {
            Some(depth) => inverse_depth_16(simd, load(simd, &depth.row(0, y)[first..])),
            None => zero,
        };
        chunk.set_plane(0, here);
        let column = |k: usize| f32x16::from_slice(simd, &nearest[first + k..][..CHUNK]);
        let near = column(0).max(column(1)).max(column(2));
        let change = (near - here) * CROSSING * squares.sqrt();
        chunk.set_plane(1, here.simd_lt(near * EDGE_RATIO).select(change, zero));
        let far = is_sample.select(here, f32x16::splat(simd, f32::INFINITY)).reduce_min();
        let near = here.reduce_max();
        let [r, g, b] = chunk.colors().map(|plane| plane[0]);
        let is_bare = near == 0.0 && (is_bare | !is_sample).all_true();
        Extent { far, near, bare: is_bare.then_some([r, g, b]) }
    }
}

/// Row `y` of the three colour planes.
pub(crate) fn rgb_rows(planes: &Planes<3>, y: usize) -> [&[f32]; 3] {
    std::array::from_fn(|c| planes.row(c, y))
}

#[cfg(test)]
mod tests {
    use gs3_scene::Geometry;

    use super::*;
    use crate::reprojection::inverse_depth;

    /// Width of a full chunk and a partial one.
    const WIDTH: usize = 21;
    const HEIGHT: usize = 4;

    /// A frame with arbitrary values. From row 2 on it has one colour and no surface, except for its last sample.
    fn gbuffer() -> GBuffer {
        let value = |k: usize| (k * 7919 % 1009) as f32 / 1009.0;
        let is_bare = |k: usize| k % (WIDTH * HEIGHT) >= 2 * WIDTH;
        let planes = |seed: usize, bare: f32| {
            let mut planes = Planes::<3>::new(WIDTH, HEIGHT);
            for (k, v) in planes.data_mut().iter_mut().enumerate() {
                *v = if is_bare(k) { bare } else { value(k + seed) };
            }
            planes
        };
        let mut depth_median = Planes::<1>::new(WIDTH, HEIGHT);
        for (k, z) in depth_median.data_mut().iter_mut().enumerate() {
            *z = if is_bare(k) { 0.0 } else { 1.0 + value(3 * k) };
        }
        depth_median.data_mut()[WIDTH * HEIGHT - 1] = 2.0;
        let gradients = Gradients { color_dx: planes(11, 0.0), color_dy: planes(23, 0.0), color_dxy: None };
        GBuffer {
            color: planes(5, 0.25),
            gradients: Some(gradients),
            geometry: Some(Geometry { depth_median, ..Geometry::default() }),
            ..GBuffer::default()
        }
    }

    #[test]
    fn chunks_hold_what_the_gbuffer_says() -> Result<(), ReconstructError> {
        let gbuffer = gbuffer();
        let mut frame = SampleFrame::default();
        frame.fill(gs3_simd::level(), &gbuffer, 2)?;
        let (Some(gradients), Some(geometry)) = (&gbuffer.gradients, &gbuffer.geometry) else {
            return Err(ReconstructError::Missing { what: "all" });
        };
        let inverse = |x: usize, y: usize| inverse_depth(geometry.depth_median.row(0, y)[x]);
        for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))) {
            let (chunk, lane) = (frame.chunk(y, x / CHUNK), x % CHUNK);
            let mut squares = 0.0;
            for c in 0..3 {
                let color = gbuffer.color.row(c, y)[x];
                let [dx, dy] =
                    [&gradients.color_dx, &gradients.color_dy].map(|planes| planes.row(c, y)[x] / 2.0);
                let sample = frame.sample(x, y);
                assert_eq!([sample[c], sample[DX + c], sample[DY + c]], [color, dx, dy], "{x}, {y}");
                assert_eq!(chunk.colors()[c][lane], color);
                assert_eq!(chunk.quads(lane).map(|quad| quad[c]), [color, dx, dy]);
                squares += dx * dx + dy * dy;
            }
            assert_eq!(chunk.inverse_depth()[lane], inverse(x, y));
            let around = (y.saturating_sub(1)..(y + 2).min(HEIGHT))
                .flat_map(|y| (x.saturating_sub(1)..(x + 2).min(WIDTH)).map(move |x| (x, y)));
            let near = around.map(|(x, y)| inverse(x, y)).fold(0.0, f32::max);
            let is_beside = inverse(x, y) < near * EDGE_RATIO;
            let expected = if is_beside { CROSSING * (near - inverse(x, y)) * squares.sqrt() } else { 0.0 };
            assert!(
                (chunk.edge_slopes()[lane] - expected).abs() <= 1e-6,
                "{x}, {y}: {}",
                chunk.edge_slopes()[lane]
            );
        }
        let row_of = |x: usize, y: usize| (x..(x + CHUNK).min(WIDTH)).map(move |x| inverse(x, y));
        for (x, y) in [(0, 0), (CHUNK, 1), (CHUNK, HEIGHT - 1)] {
            let extent = frame.extents(y)[x / CHUNK];
            let far = row_of(x, y).fold(f32::INFINITY, f32::min);
            let near = row_of(x, y).fold(0.0, f32::max);
            assert_eq!(extent, Extent { far, near, bare: None }, "{x}, {y}");
        }
        let bare = Some([0.25; 3]);
        assert_eq!(frame.extents(2).iter().map(|extent| extent.bare).collect::<Vec<_>>(), [bare, bare]);
        Ok(())
    }
}
