//! One LR frame as exact point samples of the HR image: colour, gradient, inverse depth.

use gs3_scene::{GBuffer, Planes};
use rayon::prelude::*;

use crate::error::ReconstructError;
use crate::prefetch::prefetch;
use crate::reprojection::inverse_depth;

/// Samples of a row that are worked on together: one vector.
pub(crate) const CHUNK: usize = 16;

/// A sample is beside something nearer if its inverse depth is below this share of that of a sample around it: what is more may
/// be the slant of a surface. (Empirical: 0.95 gains 0.1 dB over 0.8 at 1920×1080, and loses 0.15 at 160×90.)
pub(crate) const BESIDE: f32 = 0.9;

/// How much of the way that something nearer moves counts: edges lie along it as well as across, and not every sample beside one
/// shows it. (Empirical, at 1920×1080: 0 loses 0.2 to 0.3 dB where the camera moves, 0.3 to 1 are alike within 0.2; at 160×90, where
/// a texture is often taken for an edge, 1 loses 0.5 dB.)
pub(crate) const CROSSING: f32 = 0.5;

/// What is known at one sample position. Four lanes per entry, so that each is one 128-bit load; the fourth lanes (1 for
/// the colour, 0 for its derivatives) make the weight accumulate beside the weighted colour.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C, align(16))]
pub(crate) struct Sample {
    /// RGB, 1.
    pub color: [f32; 4],
    /// ∂RGB/∂x per HR pixel, 0.
    pub dx: [f32; 4],
    /// ∂RGB/∂y per HR pixel, 0.
    pub dy: [f32; 4],
}

impl Sample {
    /// How much the colour changes per HR pixel: the norm of all its derivatives.
    fn slope(&self) -> f32 {
        let squares = |v: &[f32; 4]| v.iter().map(|v| v * v).sum::<f32>();
        (squares(&self.dx) + squares(&self.dy)).sqrt()
    }
}

/// The samples of one LR frame, `[height, width]`.
#[derive(Clone, Debug, Default)]
pub(crate) struct SampleFrame {
    pub width: usize,
    pub height: usize,
    /// Offset of the sample positions from the LR pixel centres, in LR pixels.
    pub jitter: [f32; 2],
    pub samples: Vec<Sample>,
    /// Red, green, blue once more, `[3, height, width]`, and a vector of anything.
    colors: Vec<f32>,
    /// `1 / z` of the median depth; 0 where nothing was hit; and a vector of anything. Empty if the frame came without
    /// geometry.
    pub inverse_depth: Vec<f32>,
    /// What the colour of a sample beside something nearer changes by, per HR pixel of parallax at depth 1, as the two move apart:
    /// it may show some of the other's edge. The inverse depth of the nearest of the eight samples around it, less its own,
    /// times its slope and [`CROSSING`]; 0 where none is nearer; and a vector of anything. Empty if the frame came without geometry.
    pub seams: Vec<f32>,
    /// Per chunk, `[height, chunks per row]`; empty if the frame came without geometry.
    pub chunks: Vec<Chunk>,
}

/// What [`CHUNK`] samples in a row have in common.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Chunk {
    /// Smallest inverse depth.
    pub far: f32,
    /// Largest inverse depth.
    pub near: f32,
    /// The colour of all samples if nothing was hit and nothing varies.
    pub bare: Option<[f32; 3]>,
}

impl SampleFrame {
    /// Takes over a checked G-buffer of an output `scale` times larger, reusing memory.
    ///
    /// # Errors
    /// [`ReconstructError::Missing`] if there are no gradients.
    pub fn fill(&mut self, gbuffer: &GBuffer, scale: u32) -> Result<(), ReconstructError> {
        let Some(gradients) = &gbuffer.gradients else {
            return Err(ReconstructError::Missing { what: "image gradients" });
        };
        let (width, height) = (gbuffer.width(), gbuffer.height());
        (self.width, self.height, self.jitter) = (width, height, gbuffer.jitter);
        self.samples.resize(width * height, Sample::default());
        let per_hr_pixel = 1.0 / scale as f32;
        self.samples.par_chunks_exact_mut(width).enumerate().with_min_len(8).for_each(|(y, row)| {
            let [r, g, b] = rgb_rows(&gbuffer.color, y);
            let [rx, gx, bx] = rgb_rows(&gradients.color_dx, y);
            let [ry, gy, by] = rgb_rows(&gradients.color_dy, y);
            for (i, sample) in row.iter_mut().enumerate() {
                sample.color = [r[i], g[i], b[i], 1.0];
                sample.dx = [rx[i] * per_hr_pixel, gx[i] * per_hr_pixel, bx[i] * per_hr_pixel, 0.0];
                sample.dy = [ry[i] * per_hr_pixel, gy[i] * per_hr_pixel, by[i] * per_hr_pixel, 0.0];
            }
        });
        match &gbuffer.geometry {
            Some(geometry) => self.fill_geometry(gbuffer, &geometry.depth_median),
            None => {
                self.inverse_depth.clear();
                self.seams.clear();
                self.chunks.clear();
            }
        }
        Ok(())
    }

    /// Takes over what only reprojection needs.
    fn fill_geometry(&mut self, gbuffer: &GBuffer, depth: &Planes<1>) {
        let (width, size) = (self.width, self.width * self.height);
        self.colors.resize(3 * size + CHUNK, 0.0);
        let colors = self.colors[..3 * size].par_chunks_mut(1 << 14);
        colors.zip(gbuffer.color.data().par_chunks(1 << 14)).for_each(|(to, from)| to.copy_from_slice(from));
        self.inverse_depth.resize(size + CHUNK, 0.0);
        self.chunks.resize(self.chunks_per_row() * self.height, Chunk::default());
        let depths = self.inverse_depth[..size].par_chunks_exact_mut(width);
        let chunks = self.chunks.par_chunks_exact_mut(width.div_ceil(CHUNK));
        let samples = self.samples.par_chunks_exact(width);
        let rows = depths.zip(chunks).zip(samples).enumerate().with_min_len(8);
        rows.for_each(|(y, ((row, chunks), samples))| {
            row.iter_mut().zip(depth.row(0, y)).for_each(|(w, &z)| *w = inverse_depth(z));
            for (chunk, (depths, samples)) in
                chunks.iter_mut().zip(row.chunks(CHUNK).zip(samples.chunks(CHUNK)))
            {
                *chunk = Chunk::of(depths, samples);
            }
        });
        self.find_seams();
    }

    /// Finds the samples of surfaces beside nearer ones.
    fn find_seams(&mut self) {
        let (width, size) = (self.width, self.width * self.height);
        self.seams.resize(size + CHUNK, 0.0);
        let (depths, samples, last) = (&self.inverse_depth, &self.samples, self.height - 1);
        let rows = self.seams[..size].par_chunks_exact_mut(width).enumerate().with_min_len(8);
        rows.for_each_init(Vec::new, |nearest, (y, seams)| {
            let row = |y: usize| &depths[y * width..][..width];
            // Of the three samples of a column; beyond the first and the last column there is nothing.
            nearest.clear();
            nearest.resize(width + 2, 0.0_f32);
            let columns = nearest[1..].iter_mut().zip(row(y.saturating_sub(1)));
            for (((most, above), here), below) in columns.zip(row(y)).zip(row((y + 1).min(last))) {
                *most = above.max(*here).max(*below);
            }
            for (x, seam) in seams.iter_mut().enumerate() {
                let near = nearest[x].max(nearest[x + 1]).max(nearest[x + 2]);
                let sample = y * width + x;
                let behind = CROSSING * (near - depths[sample]);
                *seam = if depths[sample] < near * BESIDE { behind * samples[sample].slope() } else { 0.0 };
            }
        });
    }

    /// Chunks per row of samples, the last of which may be a part.
    pub const fn chunks_per_row(&self) -> usize {
        self.width.div_ceil(CHUNK)
    }

    /// Asks for all there is about chunk `chunk` of row `row` to be brought into the caches.
    #[inline(always)]
    pub fn prefetch(&self, row: usize, chunk: usize) {
        let start = row * self.width + chunk * CHUNK;
        prefetch(&self.inverse_depth[start..start + CHUNK]);
        let [r, g, b] = self.colors(start);
        prefetch(r);
        prefetch(g);
        prefetch(b);
        prefetch(&self.samples[start..(start + CHUNK).min(self.samples.len())]);
    }

    /// The colours of the [`CHUNK`] samples from `first` on; anything beyond the end of the row.
    #[inline(always)]
    pub fn colors(&self, first: usize) -> [&[f32]; 3] {
        let size = self.width * self.height;
        let of = |c: usize| &self.colors[c * size + first..c * size + first + CHUNK];
        [of(0), of(1), of(2)]
    }
}

impl Chunk {
    fn of(depths: &[f32], samples: &[Sample]) -> Self {
        let far = depths.iter().fold(f32::INFINITY, |a, b| a.min(*b));
        let near = depths.iter().fold(0.0_f32, |a, b| a.max(*b));
        let first = Sample { color: samples[0].color, ..Sample::default() };
        let is_bare = near == 0.0 && samples.iter().all(|sample| *sample == first);
        let [r, g, b, _] = first.color;
        Self { far, near, bare: is_bare.then_some([r, g, b]) }
    }
}

/// Row `y` of the three colour planes.
pub(crate) fn rgb_rows(planes: &Planes<3>, y: usize) -> [&[f32]; 3] {
    std::array::from_fn(|c| planes.row(c, y))
}
