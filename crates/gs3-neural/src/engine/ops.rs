//! Operations other than convolution, a row or a strip of one at a time.

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, dispatch, f32x4, f32x16, i32x4};

use super::block::{Block, LANES, Layout, Sources};
use super::conv::fill_halo;
use super::exchange::{copy_fours, joined};
use super::math::activate;
use crate::graph::{Border, Op, pooled};

/// Writes row `y`, with halo, of `op` of `inputs` to `out`, a row of `layout`: a strip of it where that is one. Where
/// the first of `inputs` is `layout` itself, `out` holds it and becomes the result in its place ([`updates`]).
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
    let is_update = inputs.first() == Some(layout);
    let row = Row { sources, inputs, layout, is_update, y };
    dispatch!(level, simd => row.run(simd, op, out));
    fill_halo(border, layout, out);
}

/// How many of the first inputs of `op`, one of each pixel on its own, may become its result: any of them as its first.
pub fn updates(op: &Op) -> usize {
    match op {
        Op::Add => 2,
        Op::Activate(_) | Op::Multiply | Op::Mix | Op::Scale { .. } => 1,
        _ => 0,
    }
}

/// A row of an operation.
struct Row<'a> {
    sources: Sources<'a>,
    inputs: &'a [Layout],
    layout: &'a Layout,
    /// Whether the first input is what the result's place holds.
    is_update: bool,
    y: usize,
}

impl<'a> Row<'a> {
    #[inline(always)]
    fn run<S: Simd>(&self, simd: S, op: &Op, out: &mut [Block]) {
        let stride = self.layout.stride();
        if matches!(op, Op::PixelShuffle { .. } | Op::PixelUnshuffle { .. } | Op::Concat | Op::Slice { .. }) {
            return self.rearrange(simd, op, out);
        }
        for (b, out) in out.chunks_exact_mut(stride).enumerate() {
            let out = &mut out[self.layout.halo..][..self.layout.shape.width];
            match op {
                Op::Activate(activation) => {
                    // Not by a closure: one as long as this might not be inlined where vectors are enabled.
                    let input = self.first_input(b);
                    for (k, out) in out.iter_mut().enumerate() {
                        let x = load(simd, input.map_or(&*out, |line| &line[k]));
                        out.0 = activate(simd, *activation, x).to_array();
                    }
                }
                Op::Add => {
                    let [y] = self.lines([1], b);
                    self.each_of_first(simd, b, out, |x, k| x + load(simd, &y[k]));
                }
                Op::Multiply => {
                    let factor = self.factor(1, b);
                    self.each_of_first(simd, b, out, |x, k| x * factor.at(simd, k));
                }
                Op::Mix => {
                    let ([y], t) = (self.lines([1], b), self.factor(2, b));
                    self.each_of_first(simd, b, out, |x, k| t.at(simd, k).mul_add(load(simd, &y[k]) - x, x));
                }
                Op::ChannelMean | Op::ChannelMax => {
                    self.over_channels(simd, matches!(op, Op::ChannelMean), out)
                }
                Op::Scale { factor } => self.each_of_first(simd, b, out, |x, _| x * *factor),
                Op::Shift { color } => {
                    let ([x], channels) = (self.lines([0], b), self.layout.shape.channels);
                    let lane = |l: usize| color.get(3 * (b * LANES + l) / channels).copied();
                    let color = Block(std::array::from_fn(|l| lane(l).unwrap_or_default()));
                    each(simd, out, |k| load(simd, &x[k]) + load(simd, &color));
                }
                Op::AveragePool { side, stride } => self.average_pool(simd, *side, *stride, b, out),
                Op::MaxPool2 => self.max_pool(simd, b, out),
                Op::Upsample { factor } => {
                    let (line, first) =
                        (self.sources.line(&self.inputs[0], self.y / factor, b), self.sources.x());
                    each(simd, out, |k| load(simd, &line[(first + k) / factor]));
                }
                Op::Warp => {
                    let ([flow], first) = (self.lines([1], 0), self.sources.x());
                    each(simd, out, |k| {
                        let [dx, dy, ..] = flow[k].0;
                        self.bilinear(simd, b, (first + k) as f32 + dx, self.y as f32 + dy)
                    });
                }
                // Rearrangements were made above; convolutions and inputs have steps of their own.
                _ => {}
            }
        }
    }

    /// This row of the first input, block `b`; none if the result's place holds the input.
    #[inline(always)]
    fn first_input(&self, b: usize) -> Option<&'a [Block]> {
        if self.is_update { None } else { Some(self.lines([0], b)[0]) }
    }

    /// Writes `f` of each pixel of the first input and its place. `f` is called at one place here, or `f` might not be inlined
    /// where vectors are enabled.
    #[inline(always)]
    fn each_of_first<S: Simd>(
        &self,
        simd: S,
        b: usize,
        out: &mut [Block],
        f: impl Fn(f32x16<S>, usize) -> f32x16<S>,
    ) {
        let input = self.first_input(b);
        for (k, out) in out.iter_mut().enumerate() {
            let from = input.map_or(&*out, |line| &line[k]);
            out.0 = f(load(simd, from), k).to_array();
        }
    }

    /// This row of inputs, block `b`.
    #[inline(always)]
    fn lines<const N: usize>(&self, inputs: [usize; N], b: usize) -> [&'a [Block]; N] {
        inputs.map(|input| &self.sources.pixels(&self.inputs[input], self.y, b)[..self.layout.shape.width])
    }

    /// Of an input that has as many blocks as the result, or fewer, which then count for the others too.
    #[inline(always)]
    fn factor(&self, input: usize, b: usize) -> Factor<'a> {
        let single = self.inputs[input].shape.channels == 1;
        let [line] = self.lines([input], b % self.inputs[input].blocks());
        Factor { line, single }
    }

    /// The mean over all channels, or the largest. Lanes beyond the channels count nothing.
    #[inline(always)]
    fn over_channels<S: Simd>(&self, simd: S, mean: bool, out: &mut [Block]) {
        let channels = self.inputs[0].shape.channels;
        let last = channels.div_ceil(LANES) - 1;
        let lane = |lane: usize| if last * LANES + lane < channels { 1.0 } else { 0.0 };
        let is_there = load(simd, &Block(std::array::from_fn(lane))).simd_gt(0.0);
        let nothing = f32x16::splat(simd, if mean { 0.0 } else { f32::NEG_INFINITY });
        let ([line], first) = (self.lines([0], last), self.sources.first(&self.inputs[0]));
        let (row, stride) = (self.sources.row(&self.inputs[0], self.y), self.inputs[0].stride());
        let share = 1.0 / channels as f32;
        for (x, (out, block)) in out.iter_mut().zip(line).enumerate() {
            let mut all = is_there.select(load(simd, block), nothing);
            for b in 0..last {
                let block = load(simd, &row[b * stride + first + x]);
                all = if mean { all + block } else { all.max(block) };
            }
            let (a, b) = all.split();
            let half = if mean { a + b } else { a.max(b) };
            let (a, b) = half.split();
            let [a, b, c, d] = (if mean { a + b } else { a.max(b) }).to_array();
            out.0[0] = match mean {
                true => (a + b + (c + d)) * share,
                false => a.max(b).max(c.max(d)),
            };
        }
    }

    #[inline(always)]
    fn max_pool<S: Simd>(&self, simd: S, b: usize, out: &mut [Block]) {
        let (input, first) = (&self.inputs[0], self.sources.x());
        let [last_y, last_x] = [input.shape.height - 1, input.shape.width - 1];
        let [above, below] =
            [2 * self.y, (2 * self.y + 1).min(last_y)].map(|y| self.sources.line(input, y, b));
        each(simd, out, |k| {
            let x = first + k;
            let (left, right) = (2 * x, (2 * x + 1).min(last_x));
            let max = |line: &[Block]| load(simd, &line[left]).max(load(simd, &line[right]));
            max(above).max(max(below))
        });
    }

    #[inline(always)]
    fn average_pool<S: Simd>(&self, simd: S, side: usize, stride: usize, b: usize, out: &mut [Block]) {
        let (input, first) = (&self.inputs[0], self.sources.x());
        each(simd, out, |k| {
            let [rows, columns] = pooled(input.shape, [first + k, self.y], side, stride);
            let count = (rows.len() * columns.len()) as f32;
            let mut sum = f32x16::splat(simd, 0.0);
            for y in rows {
                for block in &self.sources.line(input, y, b)[columns.clone()] {
                    sum += load(simd, block);
                }
            }
            sum * (1.0 / count)
        });
    }

    /// Input 0 at (x, y), with pixel centres at integers, moved into the image.
    #[inline(always)]
    fn bilinear<S: Simd>(&self, simd: S, b: usize, x: f32, y: f32) -> f32x16<S> {
        let input = &self.inputs[0];
        let Corners { columns: [left, right], rows, fraction } =
            Corners::new(simd, [input.shape.width, input.shape.height], [x, y]);
        let [above, below] = rows.map(|y| self.sources.line(input, y, b));
        Corners::between(simd, [&above[left].0, &above[right].0, &below[left].0, &below[right].0], fraction)
    }

    #[inline(always)]
    fn rearrange<S: Simd>(&self, simd: S, op: &Op, out: &mut [Block]) {
        match op {
            Op::Slice { first, .. } => self.copy(simd, |c| (0, first + c), out),
            Op::Concat => self.copy(
                simd,
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
            Op::PixelShuffle { factor: 2 } if self.layout.shape.channels.is_multiple_of(LANES) => {
                self.shuffle_twos(simd, out);
            }
            _ => self.shuffle(op, out),
        }
    }

    /// [`Op::PixelShuffle`] by 2 to whole blocks. Each is made from four blocks, and a pixel has two of every four
    /// channels.
    #[inline(always)]
    fn shuffle_twos<S: Simd>(&self, simd: S, out: &mut [Block]) {
        for (b, out) in out.chunks_exact_mut(self.layout.stride()).enumerate() {
            let lines = [0, 1, 2, 3].map(|k| self.sources.line(&self.inputs[0], self.y / 2, 4 * b + k));
            let out = &mut out[self.layout.halo..][..self.layout.shape.width];
            for (k, out) in out.iter_mut().enumerate() {
                let x = self.sources.x() + k;
                let place = 2 * (self.y % 2) + x % 2;
                let fours = lines.map(|line| simd.load_four_interleaved_f32x4(&line[x / 2].0)[place]);
                out.0 = joined(simd, fours);
            }
        }
    }

    /// Copies every channel from the input and its channel that `source` names, as many at a time as lie side by side.
    #[inline(always)]
    fn copy<S: Simd>(&self, simd: S, source: impl Fn(usize) -> (usize, usize), out: &mut [Block]) {
        let (shape, mut c) = (self.layout.shape, 0);
        while c < shape.channels {
            let (input, channel) = source(c);
            let count = run_len(c, shape.channels, channel, self.inputs[input].shape.channels);
            let line = &self.sources.pixels(&self.inputs[input], self.y, channel / LANES)[..shape.width];
            let out = &mut out[c / LANES * self.layout.stride() + self.layout.halo..][..shape.width];
            let (to, from, fours) = (c % LANES, channel % LANES, count.next_multiple_of(4));
            if count == LANES {
                out.copy_from_slice(line);
            } else if to.max(from) + fours <= LANES {
                // Lanes beyond the channels hold anything, or are written next.
                for (out, pixel) in out.iter_mut().zip(line) {
                    copy_fours(simd, &pixel.0[from..from + fours], &mut out.0[to..to + fours]);
                }
            } else {
                for (out, pixel) in out.iter_mut().zip(line) {
                    out.0[to..to + count].copy_from_slice(&pixel.0[from..from + count]);
                }
            }
            c += count;
        }
    }

    fn shuffle(&self, op: &Op, out: &mut [Block]) {
        let (stride, shape, y) = (self.layout.stride(), self.layout.shape, self.y);
        let first = self.sources.x();
        for c in 0..shape.channels {
            let out = &mut out[c / LANES * stride + self.layout.halo..][..shape.width];
            let lane = c % LANES;
            match op {
                Op::PixelShuffle { factor: f } => {
                    // One pass for each column of the block: a pass reads one channel.
                    for k in 0..shape.width.min(*f) {
                        let (x, j) = ((first + k) / f, (first + k) % f);
                        let channel = c * f * f + y % f * f + j;
                        let line = &self.sources.line(&self.inputs[0], y / f, channel / LANES)[x..];
                        for (out, pixel) in out[k..].iter_mut().step_by(*f).zip(line) {
                            out.0[lane] = pixel.0[channel % LANES];
                        }
                    }
                }
                Op::PixelUnshuffle { factor: f } => {
                    let (channel, i, j) = (c / (f * f), c / f % f, c % f);
                    let line =
                        &self.sources.line(&self.inputs[0], y * f + i, channel / LANES)[first * f + j..];
                    for (out, pixel) in out.iter_mut().zip(line.iter().step_by(*f)) {
                        out.0[lane] = pixel.0[channel % LANES];
                    }
                }
                // Nothing else is a shuffle.
                _ => {}
            }
        }
    }
}

/// Writes the pixels of row `y` of an image of whole blocks, of `[width, height]`, moved by the tensor of `flow`, to
/// `out`, a strip of `layout`.
pub fn warp_image_row(
    level: Level,
    image: &[f32],
    size: [usize; 2],
    sources: Sources<'_>,
    flow: &Layout,
    layout: &Layout,
    y: usize,
    out: &mut [Block],
) {
    let flow = &sources.pixels(flow, y, 0)[..layout.shape.width];
    dispatch!(level, simd => warp_image(simd, image, size, flow, [sources.x(), y], layout, out));
}

#[inline(always)]
fn warp_image<S: Simd>(
    simd: S,
    image: &[f32],
    size: [usize; 2],
    flow: &[Block],
    [x, y]: [usize; 2],
    layout: &Layout,
    out: &mut [Block],
) {
    let (blocks, _) = image.as_chunks::<LANES>();
    for (k, flow) in flow.iter().enumerate() {
        let [dx, dy, ..] = flow.0;
        let place = [(x + k) as f32 + dx, y as f32 + dy];
        let Corners { columns: [left, right], rows: [above, below], fraction } =
            Corners::new(simd, size, place);
        for b in 0..layout.blocks() {
            let pixel = |x: usize, y: usize| &blocks[(y * size[0] + x) * layout.blocks() + b];
            let corners = [pixel(left, above), pixel(right, above), pixel(left, below), pixel(right, below)];
            out[b * layout.stride() + k].0 = Corners::between(simd, corners, fraction).to_array();
        }
    }
}

/// The four pixels around a place.
struct Corners {
    columns: [usize; 2],
    rows: [usize; 2],
    /// Of the way from the first column and row to the second.
    fraction: [f32; 2],
}

impl Corners {
    /// The neighbours of `place` (x, y), with pixel centres at integers, moved into an image of `[width, height]`.
    #[inline(always)]
    fn new<S: Simd>(simd: S, [width, height]: [usize; 2], [x, y]: [f32; 2]) -> Self {
        // Both axes at once.
        let axes = |x: f32, y: f32| f32x4::simd_from(simd, [x, y, 0.0, 0.0]);
        let last = axes((width - 1) as f32, (height - 1) as f32);
        let before_last = axes(width.saturating_sub(2) as f32, height.saturating_sub(2) as f32);
        // Not-a-number becomes 0 here.
        let place = axes(x, y).max_precise(0.0).min(last);
        let first = place.floor().min(before_last);
        let [fx, fy, ..] = (place - first).to_array();
        let [left, above, ..] = first.to_int::<i32x4<S>>().to_array().map(|first| first as usize);
        Self {
            columns: [left, (left + 1).min(width - 1)],
            rows: [above, (above + 1).min(height - 1)],
            fraction: [fx, fy],
        }
    }

    /// Bilinear between the four pixels, row by row.
    #[inline(always)]
    fn between<S: Simd>(simd: S, corners: [&[f32; LANES]; 4], [fx, fy]: [f32; 2]) -> f32x16<S> {
        // No closure: one of vectors would be a function compiled for narrow ones.
        let a = f32x16::load_array_ref(simd, corners[0]);
        let b = f32x16::load_array_ref(simd, corners[2]);
        let a = (f32x16::load_array_ref(simd, corners[1]) - a).mul_add(fx, a);
        let b = (f32x16::load_array_ref(simd, corners[3]) - b).mul_add(fx, b);
        (b - a).mul_add(fy, a)
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
