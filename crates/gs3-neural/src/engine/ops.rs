//! Operations other than convolution, a row at a time.

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, dispatch, f32x16};
use rayon::prelude::*;

use super::block::{Block, LANES, Layout, Sources};
use super::conv::fill_halo;
use super::math::activate;
use crate::graph::{Border, Filter, Op};
use crate::reference::pooled;

/// Writes `op` of `inputs` to `out`, the blocks of `layout`.
pub fn run(
    level: Level,
    op: &Op,
    border: Border,
    sources: Sources<'_>,
    inputs: &[Layout],
    layout: &Layout,
    out: &mut [Block],
) {
    out.par_chunks_exact_mut(layout.row_len()).enumerate().for_each(|(y, out)| {
        run_row(level, op, border, sources, inputs, layout, y, out);
    });
}

/// Writes row `y`, with halo, of `op` of `inputs` to `out`, a row of `layout`.
pub fn run_row(
    level: Level,
    op: &Op,
    border: Border,
    sources: Sources<'_>,
    inputs: &[Layout],
    layout: &Layout,
    y: usize,
    out: &mut [Block],
) {
    let row = Row { sources, inputs, layout, y };
    dispatch!(level, simd => row.run(simd, op, out));
    fill_halo(border, layout, out);
}

/// Writes an image from outside, channels last and `factor` times as wide and high, to `out`: blocks of `factor`²
/// pixels become channels.
pub fn import(image: &[f32], factor: usize, border: Border, layout: &Layout, out: &mut [Block]) {
    out.par_chunks_exact_mut(layout.row_len()).enumerate().for_each(|(y, out)| {
        import_row(image, factor, layout, y, out, |out, v| *out = v);
        fill_halo(border, layout, out);
    });
}

/// Row `y` of [`import`] without halo; `write` puts each number into its place.
pub fn import_row(
    image: &[f32],
    factor: usize,
    layout: &Layout,
    y: usize,
    out: &mut [Block],
    write: impl Fn(&mut f32, f32),
) {
    let (stride, channels) = (layout.stride(), layout.shape.channels / (factor * factor));
    let image_row = layout.shape.width * factor * channels;
    if factor == 1 {
        let line = &image[y * image_row..][..image_row];
        for (b, out) in out.chunks_exact_mut(stride).enumerate() {
            let lanes = b * LANES..channels.min((b + 1) * LANES);
            for (out, pixel) in out[layout.halo..].iter_mut().zip(line.chunks_exact(channels)) {
                out.0.iter_mut().zip(&pixel[lanes.clone()]).for_each(|(out, v)| write(out, *v));
            }
        }
        return;
    }
    for c in 0..layout.shape.channels {
        let (channel, i, j) = (c / (factor * factor), c / factor % factor, c % factor);
        let line = &image[(y * factor + i) * image_row..][..image_row];
        let out = &mut out[c / LANES * stride + layout.halo..][..layout.shape.width];
        let numbers = line[j * channels + channel..].iter().step_by(factor * channels);
        for (out, v) in out.iter_mut().zip(numbers) {
            write(&mut out.0[c % LANES], *v);
        }
    }
}

/// Writes a tensor to an image, channels last and `factor` times as wide and high: the inverse of [`import`].
pub fn export(tensor: &[Block], layout: &Layout, factor: usize, image: &mut [f32]) {
    let image_rows = layout.shape.width * factor * factor * (layout.shape.channels / (factor * factor));
    let rows = tensor.par_chunks_exact(layout.row_len());
    image.par_chunks_exact_mut(image_rows).zip(rows).for_each(|(image, row)| {
        export_row(row, layout, factor, image);
    });
}

/// Writes a row of a tensor to the `factor` rows of an image that it makes.
pub fn export_row(row: &[Block], layout: &Layout, factor: usize, image: &mut [f32]) {
    let channels = layout.shape.channels / (factor * factor);
    let image_row = layout.shape.width * factor * channels;
    if factor == 1 {
        for (b, line) in row.chunks_exact(layout.stride()).enumerate() {
            let lanes = b * LANES..channels.min((b + 1) * LANES);
            for (pixel, block) in image.chunks_exact_mut(channels).zip(&line[layout.halo..]) {
                pixel[lanes.clone()].iter_mut().zip(&block.0).for_each(|(out, v)| *out = *v);
            }
        }
        return;
    }
    for c in 0..layout.shape.channels {
        let (channel, i, j) = (c / (factor * factor), c / factor % factor, c % factor);
        let line = &mut image[i * image_row..][..image_row];
        let pixels = &row[c / LANES * layout.stride() + layout.halo..][..layout.shape.width];
        let numbers = line[j * channels + channel..].iter_mut().step_by(factor * channels);
        for (out, pixel) in numbers.zip(pixels) {
            *out = pixel.0[c % LANES];
        }
    }
}

/// A row of an operation.
struct Row<'a> {
    sources: Sources<'a>,
    inputs: &'a [Layout],
    layout: &'a Layout,
    y: usize,
}

impl<'a> Row<'a> {
    #[inline(always)]
    fn run<S: Simd>(&self, simd: S, op: &Op, out: &mut [Block]) {
        let stride = self.layout.stride();
        if matches!(op, Op::PixelShuffle { .. } | Op::PixelUnshuffle { .. } | Op::Concat | Op::Slice { .. }) {
            return self.rearrange(op, out);
        }
        for (b, out) in out.chunks_exact_mut(stride).enumerate() {
            let out = &mut out[self.layout.halo..][..self.layout.shape.width];
            match op {
                Op::Activate(activation) => {
                    let [x] = self.lines([0], b);
                    each(simd, out, |k| activate(simd, *activation, load(simd, &x[k])));
                }
                Op::Add => {
                    let [x, y] = self.lines([0, 1], b);
                    each(simd, out, |k| load(simd, &x[k]) + load(simd, &y[k]));
                }
                Op::Multiply => {
                    let ([x], factor) = (self.lines([0], b), self.factor(1, b));
                    each(simd, out, |k| load(simd, &x[k]) * factor.at(simd, k));
                }
                Op::Mix => {
                    let ([x, y], t) = (self.lines([0, 1], b), self.factor(2, b));
                    each(simd, out, |k| {
                        let (x, y) = (load(simd, &x[k]), load(simd, &y[k]));
                        t.at(simd, k).mul_add(y - x, x)
                    });
                }
                Op::ChannelMean | Op::ChannelMax => self.over_channels(matches!(op, Op::ChannelMean), out),
                Op::Scale { factor } => {
                    let [x] = self.lines([0], b);
                    each(simd, out, |k| load(simd, &x[k]) * *factor);
                }
                Op::Shift { color } => {
                    let ([x], channels) = (self.lines([0], b), self.layout.shape.channels);
                    let lane = |l: usize| color.get(3 * (b * LANES + l) / channels).copied();
                    let color = Block(std::array::from_fn(|l| lane(l).unwrap_or_default()));
                    each(simd, out, |k| load(simd, &x[k]) + load(simd, &color));
                }
                Op::AveragePool { side, stride } => self.average_pool(simd, *side, *stride, b, out),
                Op::MaxPool2 => self.max_pool(simd, b, out),
                Op::Upsample { factor, filter } => self.upsample(simd, *factor, *filter, b, out),
                Op::Warp => {
                    let flow = self.sources.pixels(&self.inputs[1], self.y, 0);
                    each(simd, out, |k| {
                        let [dx, dy, ..] = flow[k].0;
                        self.bilinear(simd, b, k as f32 + dx, self.y as f32 + dy)
                    });
                }
                // Rearrangements were made above; convolutions and inputs have steps of their own.
                _ => {}
            }
        }
    }

    /// This row of inputs, block `b`.
    #[inline(always)]
    fn lines<const N: usize>(&self, inputs: [usize; N], b: usize) -> [&'a [Block]; N] {
        inputs.map(|input| self.sources.pixels(&self.inputs[input], self.y, b))
    }

    #[inline(always)]
    fn factor(&self, input: usize, b: usize) -> Factor<'a> {
        let single = self.inputs[input].shape.channels == 1;
        let [line] = self.lines([input], if single { 0 } else { b });
        Factor { line, single }
    }

    fn over_channels(&self, mean: bool, out: &mut [Block]) {
        let input = &self.inputs[0];
        let channels = input.shape.channels;
        for (x, out) in out.iter_mut().enumerate() {
            let values = (0..channels).map(|c| self.sources.at(input, x, self.y, c));
            out.0[0] = match mean {
                true => values.sum::<f32>() / channels as f32,
                false => values.fold(f32::NEG_INFINITY, f32::max),
            };
        }
    }

    #[inline(always)]
    fn max_pool<S: Simd>(&self, simd: S, b: usize, out: &mut [Block]) {
        let input = &self.inputs[0];
        let [last_y, last_x] = [input.shape.height - 1, input.shape.width - 1];
        let [above, below] =
            [2 * self.y, (2 * self.y + 1).min(last_y)].map(|y| self.sources.pixels(input, y, b));
        each(simd, out, |x| {
            let (left, right) = (2 * x, (2 * x + 1).min(last_x));
            let max = |line: &[Block]| load(simd, &line[left]).max(load(simd, &line[right]));
            max(above).max(max(below))
        });
    }

    #[inline(always)]
    fn average_pool<S: Simd>(&self, simd: S, side: usize, stride: usize, b: usize, out: &mut [Block]) {
        let input = &self.inputs[0];
        each(simd, out, |x| {
            let [rows, columns] = pooled(input.shape, [x, self.y], side, stride);
            let count = (rows.len() * columns.len()) as f32;
            let mut sum = f32x16::splat(simd, 0.0);
            for y in rows {
                for block in &self.sources.pixels(input, y, b)[columns.clone()] {
                    sum += load(simd, block);
                }
            }
            sum * (1.0 / count)
        });
    }

    #[inline(always)]
    fn upsample<S: Simd>(&self, simd: S, factor: usize, filter: Filter, b: usize, out: &mut [Block]) {
        match filter {
            Filter::Nearest => {
                let line = self.sources.pixels(&self.inputs[0], self.y / factor, b);
                each(simd, out, |x| load(simd, &line[x / factor]));
            }
            Filter::Bilinear => {
                let place = |x: usize| (x as f32 + 0.5) / factor as f32 - 0.5;
                each(simd, out, |x| self.bilinear(simd, b, place(x), place(self.y)));
            }
        }
    }

    /// Input 0 at (x, y), whose integers are pixels' centres, moved into the image.
    #[inline(always)]
    fn bilinear<S: Simd>(&self, simd: S, b: usize, x: f32, y: f32) -> f32x16<S> {
        let input = &self.inputs[0];
        let axis = |place: f32, side: usize| {
            let place = place.clamp(0.0, (side - 1) as f32);
            // Not-a-number becomes 0 here.
            let first = (place as usize).min(side.saturating_sub(2));
            (first, (first + 1).min(side - 1), place - first as f32)
        };
        let (left, right, fx) = axis(x, input.shape.width);
        let (above, below, fy) = axis(y, input.shape.height);
        let along_x = |y: usize| {
            let line = self.sources.pixels(input, y, b);
            let (a, b) = (load(simd, &line[left]), load(simd, &line[right]));
            (b - a).mul_add(fx, a)
        };
        let (a, b) = (along_x(above), along_x(below));
        (b - a).mul_add(fy, a)
    }

    fn rearrange(&self, op: &Op, out: &mut [Block]) {
        match op {
            Op::Slice { first, .. } => self.copy(|c| (0, first + c), out),
            Op::Concat => self.copy(
                |c| {
                    let (mut input, mut channel) = (0, c);
                    while channel >= self.inputs[input].shape.channels {
                        channel -= self.inputs[input].shape.channels;
                        input += 1;
                    }
                    (input, channel)
                },
                out,
            ),
            _ => self.shuffle(op, out),
        }
    }

    /// Copies every channel from the input and its channel that `source` names, as many at a time as lie side by side.
    fn copy(&self, source: impl Fn(usize) -> (usize, usize), out: &mut [Block]) {
        let (shape, mut c) = (self.layout.shape, 0);
        while c < shape.channels {
            let (input, channel) = source(c);
            let count = run_len(c, shape.channels, channel, self.inputs[input].shape.channels);
            let line = self.sources.pixels(&self.inputs[input], self.y, channel / LANES);
            let out = &mut out[c / LANES * self.layout.stride() + self.layout.halo..][..shape.width];
            match count {
                LANES => out.copy_from_slice(line),
                _ => {
                    let (to, from) = (c % LANES, channel % LANES);
                    for (out, pixel) in out.iter_mut().zip(line) {
                        out.0[to..to + count].copy_from_slice(&pixel.0[from..from + count]);
                    }
                }
            }
            c += count;
        }
    }

    fn shuffle(&self, op: &Op, out: &mut [Block]) {
        let (stride, shape, y) = (self.layout.stride(), self.layout.shape, self.y);
        for c in 0..shape.channels {
            let out = &mut out[c / LANES * stride + self.layout.halo..][..shape.width];
            let lane = c % LANES;
            match op {
                Op::PixelShuffle { factor: f } => {
                    // One pass for each column of the block: a pass reads one channel.
                    for j in 0..*f {
                        let channel = c * f * f + y % f * f + j;
                        let line = self.sources.pixels(&self.inputs[0], y / f, channel / LANES);
                        for (out, pixel) in out[j.min(shape.width)..].iter_mut().step_by(*f).zip(line) {
                            out.0[lane] = pixel.0[channel % LANES];
                        }
                    }
                }
                Op::PixelUnshuffle { factor: f } => {
                    let (channel, i, j) = (c / (f * f), c / f % f, c % f);
                    let line = self.sources.pixels(&self.inputs[0], y * f + i, channel / LANES);
                    for (out, pixel) in out.iter_mut().zip(line[j..].iter().step_by(*f)) {
                        out.0[lane] = pixel.0[channel % LANES];
                    }
                }
                // Nothing else is a shuffle.
                _ => {}
            }
        }
    }
}

/// How many channels from `to` of `to_channels` and from `from` of `from_channels` on lie side by side in one block
/// each.
pub fn run_len(to: usize, to_channels: usize, from: usize, from_channels: usize) -> usize {
    (LANES - to % LANES).min(LANES - from % LANES).min(to_channels - to).min(from_channels - from)
}

/// A line of factors: as many channels as what it multiplies, or one for all.
pub struct Factor<'a> {
    pub line: &'a [Block],
    pub single: bool,
}

impl Factor<'_> {
    #[inline(always)]
    pub fn at<S: Simd>(&self, simd: S, k: usize) -> f32x16<S> {
        match self.single {
            true => f32x16::splat(simd, self.line[k].0[0]),
            false => load(simd, &self.line[k]),
        }
    }
}

/// The 16 numbers of a block.
#[inline(always)]
pub fn load<S: Simd>(simd: S, block: &Block) -> f32x16<S> {
    f32x16::load_array_ref(simd, &block.0)
}

/// Writes `f` of each pixel's place.
#[inline(always)]
fn each<S: Simd>(_simd: S, out: &mut [Block], f: impl Fn(usize) -> f32x16<S>) {
    for (k, out) in out.iter_mut().enumerate() {
        out.0 = f(k).to_array();
    }
}
