//! The places of HR pixels between LR samples, and LR planes with repeated borders to read around them.
//!
//! HR pixels with the same remainder of their index modulo the scale are one *phase*: they lie at the same offset
//! from their LR sample. All filters here run phase by phase: their weights are then constants, and their taps
//! contiguous.

use gs3_scene::Planes;
use rayon::prelude::*;

/// The place of a phase on one axis: between samples `offset + k` and `offset + k + 1` for the `k`-th pixel of the
/// phase.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Phase {
    /// −2 to 1.
    pub offset: isize,
    /// `[0, 1)`.
    pub fraction: f32,
}

/// The phases of one axis: HR pixel `k S + r` lies at `k + (r + ½)/S − ½ − jitter` LR samples.
pub(super) fn phases(scale: u32, jitter: f32) -> Vec<Phase> {
    (0..scale)
        .map(|r| {
            let place = (f64::from(r) + 0.5) / f64::from(scale) - 0.5 - f64::from(jitter);
            // Jitters are f32 numbers such as 1/6: a pixel on a sample must not fall into the cell before it.
            let place = if (place - place.round()).abs() < 1e-6 { place.round() } else { place };
            Phase { offset: place.floor() as isize, fraction: (place - place.floor()) as f32 }
        })
        .collect()
}

/// Columns repeated at each side: jitter of a whole pixel and the widest filter (Lanczos, six taps) reach 2 + 3 out.
pub(super) const PAD: usize = 5;
/// Pixels computed at a time.
pub(super) const LANES: usize = 16;

/// Planes with `PAD` repeated columns at each side, rows rounded up so that every vector of [`LANES`] can be read.
#[derive(Clone, Debug, Default)]
pub(super) struct Padded {
    width: usize,
    height: usize,
    stride: usize,
    data: Vec<f32>,
}

impl Padded {
    /// Copies `planes`, mapping every value with `map`.
    pub fn fill<const C: usize>(&mut self, planes: &Planes<C>, map: impl Fn(f32) -> f32 + Sync) {
        (self.width, self.height) = (planes.width(), planes.height());
        self.stride = self.width.next_multiple_of(LANES) + 2 * PAD;
        self.data.resize(C * self.height * self.stride, 0.0);
        let (width, height) = (self.width, self.height);
        self.data.par_chunks_exact_mut(self.stride).enumerate().for_each(|(i, padded)| {
            let row = planes.row(i / height, i % height);
            padded[..PAD].fill(map(row[0]));
            padded[PAD..PAD + width].iter_mut().zip(row).for_each(|(to, from)| *to = map(*from));
            padded[PAD + width..].fill(map(row[width - 1]));
        });
    }

    /// Number of vectors that cover a row.
    pub fn blocks(&self) -> usize {
        self.width.div_ceil(LANES)
    }

    /// Row `y` (clamped to the image) of plane `c`; index `PAD + x` holds column `x`.
    pub fn row(&self, c: usize, y: isize) -> &[f32] {
        let y = y.clamp(0, self.height as isize - 1) as usize;
        let start = (c * self.height + y) * self.stride;
        &self.data[start..start + self.stride]
    }
}

/// One HR row phase by phase, to be interleaved: `[3, S, padded LR width]`.
#[derive(Clone, Debug)]
pub(super) struct PhaseRow {
    scale: usize,
    stride: usize,
    data: Vec<f32>,
}

impl PhaseRow {
    pub fn new(scale: u32, padded: &Padded) -> Self {
        let (scale, stride) = (scale as usize, padded.blocks() * LANES);
        Self { scale, stride, data: vec![0.0; 3 * scale * stride] }
    }

    /// Where block `block` of channel `c` and phase `r` goes.
    pub fn block(&mut self, c: usize, r: usize, block: usize) -> &mut [f32] {
        let start = (c * self.scale + r) * self.stride + block * LANES;
        &mut self.data[start..start + LANES]
    }

    /// Writes the row's pixels, fourth channel 0.
    pub fn interleave(&self, row: &mut [[f32; 4]]) {
        for r in 0..self.scale {
            let [red, green, blue] = [0, 1, 2].map(|c| &self.data[(c * self.scale + r) * self.stride..]);
            for (k, pixel) in row.iter_mut().skip(r).step_by(self.scale).enumerate() {
                *pixel = [red[k], green[k], blue[k], 0.0];
            }
        }
    }
}
