//! Adjoints of operations other than convolution.
//!
//! Most are written from the side of the input: what each of its numbers gets from the result's. Where results read
//! places that only the data know, the side of the result is taken, and numbers are scattered.

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, dispatch, f32x16};

use super::math::derivative;
use super::plan::Step;
use crate::engine::block::{Block, LANES, Layout, Sources};
use crate::engine::ops::{Factor, load, run_len};
use crate::graph::{Op, pooled};

/// How a derivative is stored if a part of it may already exist.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Write {
    /// This is the first part.
    Set,
    /// There is one.
    Add,
}

impl Write {
    /// Writes `f` of each place. `f` is called at one place here, or `f` might not be inlined where vectors are enabled.
    #[inline(always)]
    pub fn each<S: Simd>(self, simd: S, out: &mut [Block], f: impl Fn(usize) -> f32x16<S>) {
        for (x, out) in out.iter_mut().enumerate() {
            self.pixel(simd, out, f(x));
        }
    }

    /// Writes a block of a pixel.
    #[inline(always)]
    fn pixel<S: Simd>(self, simd: S, out: &mut Block, v: f32x16<S>) {
        let before = match self {
            Self::Set => f32x16::splat(simd, 0.0),
            Self::Add => load(simd, out),
        };
        out.0 = (before + v).to_array();
    }

    /// Writes a number.
    #[inline(always)]
    pub fn number(self, out: &mut f32, v: f32) {
        match self {
            Self::Set => *out = v,
            Self::Add => *out += v,
        }
    }
}

/// The adjoint of `op` by one of its inputs.
pub struct Adjoint<'a> {
    pub op: &'a Op,
    pub step: &'a Step,
    /// Which input.
    pub input: usize,
    /// Results of the forward pass.
    pub values: Sources<'a>,
    /// Derivatives, without that which is written.
    pub v: Sources<'a>,
    /// The derivative by the result.
    pub v_result: &'a Layout,
    /// That by the input.
    pub v_input: &'a Layout,
}

impl Adjoint<'_> {
    /// Writes the derivative by the input to `out`, its blocks without anything before or after.
    pub fn run(&self, level: Level, out: &mut [Block], write: Write) {
        dispatch!(level, simd => self.run_on(simd, out, write));
    }

    #[inline(always)]
    fn run_on<S: Simd>(&self, simd: S, out: &mut [Block], write: Write) {
        if matches!(self.op, Op::Warp) && self.input == 0 {
            if write == Write::Set {
                out.fill(Block::default());
            }
            return self.scatter(simd, out);
        }
        let stride = self.v_input.stride();
        for (y, row) in out.chunks_exact_mut(self.v_input.row_len()).enumerate() {
            for (b, line) in row.chunks_exact_mut(stride).enumerate() {
                let line = &mut line[self.v_input.halo..][..self.v_input.shape.width];
                self.line(simd, y, b, line, write);
            }
        }
    }

    /// Block `b` of row `y` of the input.
    #[inline(always)]
    fn line<S: Simd>(&self, simd: S, y: usize, b: usize, out: &mut [Block], write: Write) {
        match *self.op {
            Op::Activate(activation) => {
                let (v, x, result) = (self.v(y, b), self.value(0, y, b), self.result(y, b));
                // Not by a closure: one as long as this might not be inlined where vectors are enabled.
                for (k, out) in out.iter_mut().enumerate() {
                    let slope = derivative(simd, activation, load(simd, &x[k]), load(simd, &result[k]));
                    write.pixel(simd, out, load(simd, &v[k]) * slope);
                }
            }
            Op::Add | Op::Shift { .. } => {
                let v = self.v(y, b);
                write.each(simd, out, |k| load(simd, &v[k]));
            }
            // At one place, as `each` says of what it is given.
            Op::Multiply | Op::Mix if self.is_factor() => self.over_channels(simd, y, b, out, write),
            Op::Multiply => {
                let (v, factor) = (self.v(y, b), self.factor(1, y, b));
                write.each(simd, out, |k| load(simd, &v[k]) * factor.at(simd, k));
            }
            Op::Mix => {
                let (v, t, one) = (self.v(y, b), self.factor(2, y, b), f32x16::splat(simd, 1.0));
                match self.input {
                    0 => write.each(simd, out, |k| load(simd, &v[k]) * (one - t.at(simd, k))),
                    _ => write.each(simd, out, |k| load(simd, &v[k]) * t.at(simd, k)),
                }
            }
            Op::MaxPool2 => {
                let v = self.v(y / 2, b);
                write.each(simd, out, |x| self.if_largest(simd, [x, y], b, load(simd, &v[x / 2])));
            }
            Op::Upsample { factor } => write.each(simd, out, |x| {
                let shape = self.v_result.shape;
                let mut sum = f32x16::splat(simd, 0.0);
                // What was cropped away has no derivative.
                for y in y * factor..((y + 1) * factor).min(shape.height) {
                    let v = self.v(y, b);
                    for x in x * factor..((x + 1) * factor).min(shape.width) {
                        sum += load(simd, &v[x]);
                    }
                }
                sum
            }),
            Op::Scale { factor } => {
                let v = self.v(y, b);
                write.each(simd, out, |k| load(simd, &v[k]) * factor);
            }
            Op::AveragePool { side, stride } => write.each(simd, out, |x| {
                let result = self.v_result.shape;
                let mut sum = f32x16::splat(simd, 0.0);
                // The windows that see the pixel: their centres are within half a side.
                let windows = |at: usize, length: usize| {
                    at.saturating_sub(side / 2).div_ceil(stride)..((at + side / 2) / stride + 1).min(length)
                };
                for wy in windows(y, result.height) {
                    let v = self.v(wy, b);
                    for wx in windows(x, result.width) {
                        let [rows, columns] = pooled(self.v_input.shape, [wx, wy], side, stride);
                        sum += load(simd, &v[wx]) * (1.0 / (rows.len() * columns.len()) as f32);
                    }
                }
                sum
            }),
            Op::ChannelMean => {
                let (v, share) = (self.v(y, 0), 1.0 / self.v_input.shape.channels as f32);
                write.each(simd, out, |x| f32x16::splat(simd, v[x].0[0] * share));
            }
            Op::Warp => self.flow(y, out, write),
            Op::ChannelMax => self.largest(simd, y, b, out, write),
            Op::PixelShuffle { .. } | Op::PixelUnshuffle { .. } => self.shuffled(y, b, out, write),
            Op::Concat => {
                let before = self.step.layouts[..self.input].iter().map(|l| l.shape.channels).sum();
                self.copied(y, b, out, write, [before, 0]);
            }
            Op::Slice { first, .. } => self.copied(y, b, out, write, [0, first]),
            // None is an operation of rows.
            Op::Input { .. } | Op::Conv2d(_) | Op::Prelu | Op::LayerNorm { .. } => {}
        }
    }

    /// Derivative by the result: block `b` of row `y`.
    #[inline(always)]
    fn v(&self, y: usize, b: usize) -> &[Block] {
        self.v.pixels(self.v_result, y, b)
    }

    /// Input `i`: block `b` of row `y`.
    #[inline(always)]
    fn value(&self, i: usize, y: usize, b: usize) -> &[Block] {
        self.values.pixels(&self.step.layouts[i], y, b)
    }

    /// The result: block `b` of row `y`.
    #[inline(always)]
    fn result(&self, y: usize, b: usize) -> &[Block] {
        self.values.pixels(&self.step.out, y, b)
    }

    #[inline(always)]
    fn factor(&self, i: usize, y: usize, b: usize) -> Factor<'_> {
        match self.step.layouts[i].shape.channels {
            1 => Factor { line: self.value(i, y, 0), single: true },
            _ => Factor { line: self.value(i, y, b), single: false },
        }
    }

    /// Whether the input multiplies others.
    #[inline(always)]
    fn is_factor(&self) -> bool {
        matches!((self.op, self.input), (Op::Multiply, 1) | (Op::Mix, 2))
    }

    /// The derivative by a factor of pixel x, row y, block b: by one of one channel the sum over all channels that it
    /// multiplies.
    #[inline(always)]
    fn over_channels<S: Simd>(&self, simd: S, y: usize, b: usize, out: &mut [Block], write: Write) {
        if self.v_input.shape.channels > 1 {
            return write.each(simd, out, |x| self.by_factor(simd, [x, y], b));
        }
        let (channels, lanes) = (self.v_result.shape.channels, f32x16::from_fn(simd, |lane| lane as f32));
        for (x, out) in out.iter_mut().enumerate() {
            let mut sums = f32x16::splat(simd, 0.0);
            for b in 0..self.v_result.blocks() {
                // Lanes without a channel may be anything.
                let is_channel = lanes.simd_lt((channels - b * LANES) as f32);
                sums += is_channel.select(self.by_factor(simd, [x, y], b), f32x16::splat(simd, 0.0));
            }
            write.number(&mut out.0[0], sum(sums.to_array()));
        }
    }

    /// What block `b` of pixel (x, y) adds to the derivative by its factor.
    #[inline(always)]
    fn by_factor<S: Simd>(&self, simd: S, [x, y]: [usize; 2], b: usize) -> f32x16<S> {
        let first = load(simd, &self.value(0, y, b)[x]);
        let multiplied = match self.op {
            Op::Mix => load(simd, &self.value(1, y, b)[x]) - first,
            _ => first,
        };
        load(simd, &self.v(y, b)[x]) * multiplied
    }

    /// `v` where pixel (x, y) is the first largest of the pixels that pool into one, else 0.
    #[inline(always)]
    fn if_largest<S: Simd>(&self, simd: S, [x, y]: [usize; 2], b: usize, v: f32x16<S>) -> f32x16<S> {
        let shape = self.v_input.shape;
        let (left, above) = (x / 2 * 2, y / 2 * 2);
        let value = load(simd, &self.value(0, y, b)[x]);
        let zero = f32x16::splat(simd, 0.0);
        let mut v = v;
        for other_y in above..(above + 2).min(shape.height) {
            let line = self.value(0, other_y, b);
            for other_x in left..(left + 2).min(shape.width) {
                let other = load(simd, &line[other_x]);
                v = match (other_y, other_x).cmp(&(y, x)) {
                    std::cmp::Ordering::Less => other.simd_lt(value).select(v, zero),
                    std::cmp::Ordering::Equal => v,
                    std::cmp::Ordering::Greater => value.simd_ge(other).select(v, zero),
                };
            }
        }
        v
    }

    /// The largest over channels: its derivative goes to the first channel that has it.
    #[inline(always)]
    fn largest<S: Simd>(&self, simd: S, y: usize, b: usize, out: &mut [Block], write: Write) {
        let (v, result) = (self.v(y, 0), self.result(y, 0));
        for (x, out) in out.iter_mut().enumerate() {
            let largest = f32x16::splat(simd, result[x].0[0]);
            let (mut found, mut lane) = (false, LANES);
            for b in 0..=b {
                // An earlier block's comes first.
                let lanes = (self.v_input.shape.channels - b * LANES).min(LANES);
                let equal =
                    load(simd, &self.value(0, y, b)[x]).simd_eq(largest).to_bitmask() & ((1 << lanes) - 1);
                lane = if found { LANES } else { equal.trailing_zeros() as usize };
                found |= equal != 0;
            }
            if write == Write::Set {
                *out = Block::default();
            }
            if let Some(out) = out.0.get_mut(lane) {
                *out += v[x].0[0];
            }
        }
    }

    /// Blocks of pixels that became channels, or channels that became blocks: where each number of the input went.
    #[inline(always)]
    fn shuffled(&self, y: usize, b: usize, out: &mut [Block], write: Write) {
        let result = self.v_result.shape;
        let line = |y: usize, c: usize| self.v(y, c / LANES);
        for c in b * LANES..self.v_input.shape.channels.min((b + 1) * LANES) {
            let lane = c % LANES;
            match *self.op {
                Op::PixelShuffle { factor: f } => {
                    let (channel, i, j) = (c / (f * f), c / f % f, c % f);
                    // What was cropped away has no derivative.
                    let line = match y * f + i {
                        y if y < result.height => &line(y, channel)[j.min(result.width)..],
                        _ => &[],
                    };
                    put(out.iter_mut(), lane, write, line.iter().step_by(f), channel);
                }
                Op::PixelUnshuffle { factor: f } => {
                    for j in 0..f.min(out.len()) {
                        let channel = c * f * f + y % f * f + j;
                        let out = out[j..].iter_mut().step_by(f);
                        put(out, lane, write, line(y / f, channel).iter(), channel);
                    }
                }
                // Nothing else is a shuffle.
                _ => {}
            }
        }
    }

    /// Copied channels: the result's channels from `target` on are the input's channels from `source` on. The input's
    /// other channels have no derivative.
    #[inline(always)]
    fn copied(&self, y: usize, b: usize, out: &mut [Block], write: Write, [target, source]: [usize; 2]) {
        let (result, input) = (self.v_result.shape.channels, self.v_input.shape.channels);
        if write == Write::Set {
            out.fill(Block::default());
        }
        let mut c = (b * LANES).max(source);
        while c < input.min((b + 1) * LANES) && target + c - source < result {
            let from = target + c - source;
            let count = run_len(c, input, from, result);
            let (to, lane) = (c % LANES, from % LANES);
            for (out, pixel) in out.iter_mut().zip(self.v(y, from / LANES)) {
                match count {
                    LANES => out.0.iter_mut().zip(&pixel.0).for_each(|(out, v)| *out += v),
                    _ => {
                        let pixel = &pixel.0[lane..lane + count];
                        out.0[to..to + count].iter_mut().zip(pixel).for_each(|(out, v)| *out += v);
                    }
                }
            }
            c += count;
        }
    }

    /// The derivative of a warp by its flow.
    fn flow(&self, y: usize, out: &mut [Block], write: Write) {
        let image = &self.step.layouts[0];
        let flow = self.value(1, y, 0);
        for (x, out) in out.iter_mut().enumerate() {
            let [dx, dy, ..] = flow[x].0;
            let (column, row) =
                (Place::new(x as f32 + dx, image.shape.width), Place::new(y as f32 + dy, image.shape.height));
            let mut sums = [0.0; 2];
            for c in 0..image.shape.channels {
                let at = |x: usize, y: usize| self.values.at(image, x, y, c);
                let [[a, b], [c_, d]] = row.pixels.map(|y| column.pixels.map(|x| at(x, y)));
                let v = self.v.at(self.v_result, x, y, c);
                sums[0] += v * ((b - a) * (1.0 - row.fraction) + (d - c_) * row.fraction);
                sums[1] += v * ((c_ - a) * (1.0 - column.fraction) + (d - b) * column.fraction);
            }
            for (k, place) in [column, row].into_iter().enumerate() {
                // Moving beyond the border changes nothing.
                write.number(&mut out.0[k], if place.inside { sums[k] } else { 0.0 });
            }
        }
    }

    /// Adds each number of the result's derivative to the pixels that it was interpolated from.
    #[inline(always)]
    fn scatter<S: Simd>(&self, simd: S, out: &mut [Block]) {
        let (result, input) = (self.v_result, self.v_input);
        for y in 0..result.shape.height {
            for x in 0..result.shape.width {
                let [dx, dy, ..] = self.value(1, y, 0)[x].0;
                let [px, py] = [x as f32 + dx, y as f32 + dy];
                let (column, row) = (Place::new(px, input.shape.width), Place::new(py, input.shape.height));
                for b in 0..result.blocks() {
                    let v = load(simd, &self.v(y, b)[x]);
                    for (y, wy) in row.pixels.into_iter().zip([1.0 - row.fraction, row.fraction]) {
                        let line = &mut out[y * input.row_len() + b * input.stride() + input.halo..];
                        for (x, wx) in column.pixels.into_iter().zip([1.0 - column.fraction, column.fraction])
                        {
                            line[x].0 = (load(simd, &line[x]) + v * (wx * wy)).to_array();
                        }
                    }
                }
            }
        }
    }
}

/// Writes channel `channel` of `source` to lane `lane` of `out`, zeros where there is no source.
#[inline(always)]
fn put<'a>(
    mut out: impl Iterator<Item = &'a mut Block>,
    lane: usize,
    write: Write,
    source: impl Iterator<Item = &'a Block>,
    channel: usize,
) {
    for pixel in source {
        let Some(out) = out.next() else { return };
        write.number(&mut out.0[lane], pixel.0[channel % LANES]);
    }
    out.for_each(|out| write.number(&mut out.0[lane], 0.0));
}

/// Pairs first, so that sums do not wait for each other.
#[inline(always)]
fn sum(numbers: [f32; LANES]) -> f32 {
    let mut sums = numbers;
    let mut count = LANES;
    while count > 1 {
        count /= 2;
        for k in 0..count {
            sums[k] += sums[k + count];
        }
    }
    sums[0]
}

/// Two pixels of a row or column, between which a place is.
#[derive(Clone, Copy, Debug)]
struct Place {
    pixels: [usize; 2],
    /// From the first to the second.
    fraction: f32,
    /// Whether it was in the image before it was moved there.
    inside: bool,
}

impl Place {
    /// `place`, with pixel centres at integers, moved into a row of `side` pixels.
    #[inline(always)]
    fn new(place: f32, side: usize) -> Self {
        let last = (side - 1) as f32;
        let inside = (0.0..=last).contains(&place);
        let place = place.clamp(0.0, last);
        // Not-a-number becomes 0 here.
        let first = (place as usize).min(side.saturating_sub(2));
        Self { pixels: [first, (first + 1).min(side - 1)], fraction: place - first as f32, inside }
    }
}
