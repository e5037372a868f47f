use super::{Bf16Convolution, Source, Unit, rounded};
use crate::engine::block::{Block, LANES, Layout, Numbers, Remainder, Sources, Storage};
use crate::engine::conv::fill_halo;
use crate::graph::{Border, Conv2d, Shape};
use crate::random::Random;

#[test]
fn numbers_are_rounded_to_the_nearest() {
    // 1 + 2⁻⁷ is the next number after 1: half-way between them the even one, 1, and beyond it the other.
    for (value, expected) in [
        (1.0, 0x3F80),
        (1.0 + 2.0_f32.powi(-8), 0x3F80),
        (1.0 + 2.0_f32.powi(-8) + 2.0_f32.powi(-20), 0x3F81),
        (1.0 + 3.0 * 2.0_f32.powi(-8), 0x3F82),
        (-2.5, 0xC020),
        (0.0, 0),
        (f32::MAX, 0x7F7F),
    ] {
        assert_eq!(rounded(value), expected, "{value}");
    }
}

/// A tensor of f32 in ±1. Its lanes beyond the channels are NaN: nothing may read them.
fn tensor(layout: &Layout, border: Border, random: &mut Random) -> Vec<Block> {
    let mut tensor = vec![Block([f32::NAN; LANES]); layout.len()];
    for row in tensor.chunks_exact_mut(layout.row_len()) {
        for (b, line) in row.chunks_exact_mut(layout.stride()).enumerate() {
            let channels = (layout.shape.channels - b * LANES).min(LANES);
            line.iter_mut().flat_map(|block| &mut block.0[..channels]).for_each(|v| *v = random.signed());
        }
        fill_halo(border, layout, row);
    }
    tensor
}

/// The same tensor as `layout`, of bf16, stores it, in two strips.
fn stored(tensor: &[Block], of: &Layout, layout: &Layout, border: Border) -> Vec<Block> {
    // Old contents of the memory: tiles see them unless they are overwritten.
    let mut rows = vec![Block([f32::NAN; LANES]); layout.len()];
    let (width, half) = (of.shape.width, of.shape.width.div_ceil(2));
    for (row, from) in rows.chunks_exact_mut(layout.row_len()).zip(tensor.chunks_exact(of.row_len())) {
        for x in [0, width - half] {
            let strip = |line: &[Block]| line[of.halo + x..][..half].to_vec();
            let strip: Vec<Block> = from.chunks_exact(of.stride()).flat_map(strip).collect();
            super::store(&strip, half, row, layout, x);
        }
        super::fill_halo(border, layout, row);
    }
    rows
}

fn bf16(value: f32) -> f64 {
    f64::from(f32::from_bits(u32::from(rounded(value)) << 16))
}

/// A convolution of random numbers.
struct Case {
    conv: Conv2d,
    border: Border,
    /// Of f32, and the numbers.
    inputs: Vec<(Layout, Vec<Block>)>,
    weights: Vec<f32>,
    bias: Vec<f32>,
}

impl Case {
    fn new(conv: Conv2d, border: Border, channels: &[usize], width: usize, random: &mut Random) -> Self {
        let input = |channels: &usize, random: &mut Random| {
            let layout = Layout::whole(Shape { height: 4, width, channels: *channels }, conv.reach(), 0);
            (layout, tensor(&layout, border, random))
        };
        let inputs = channels.iter().map(|channels| input(channels, random)).collect();
        let count = conv.outputs * channels.iter().sum::<usize>() * conv.kernel * conv.kernel;
        let [weights, bias] =
            [count, conv.outputs].map(|count| (0..count).map(|_| random.signed()).collect());
        Self { conv, border, inputs, weights, bias }
    }

    /// Output `o` at (x, y): the sum of products of rounded numbers, and the sum of the products' magnitudes.
    fn sum(&self, o: usize, x: usize, y: usize) -> [f64; 2] {
        let Conv2d { kernel, dilation, .. } = self.conv;
        let (taps, all) = (kernel * kernel, self.weights.len() / self.conv.outputs);
        let (mut sum, mut size) = (f64::from(self.bias[o]), 1.0);
        let mut weights = self.weights[o * all..].chunks_exact(taps);
        for (layout, numbers) in &self.inputs {
            for c in 0..layout.shape.channels {
                let weights = weights.next().expect("weights for each channel");
                for (tap, weight) in weights.iter().enumerate() {
                    let place = |at: usize, tap: usize, len: usize| {
                        let place = (at + tap * dilation) as isize - self.conv.reach() as isize;
                        (place, place.clamp(0, len as isize - 1))
                    };
                    let (column, inside_x) = place(x, tap % kernel, layout.shape.width);
                    let (line, inside_y) = place(y, tap / kernel, layout.shape.height);
                    if self.border == Border::Replicate || (column, line) == (inside_x, inside_y) {
                        let value = Sources::all(numbers).at(layout, inside_x as usize, inside_y as usize, c);
                        let product = bf16(*weight) * bf16(value);
                        (sum, size) = (sum + product, size + product.abs());
                    }
                }
            }
        }
        [sum, size]
    }

    /// Checks the results of `unit` in strips of `width`. Each input is stored according to `numbers`.
    fn check(&self, unit: Unit, numbers: &[Numbers], width: usize) {
        let name = format!("{unit:?}: {:?}, {:?}, {numbers:?}, {width}", self.conv, self.border);
        let (mut layouts, mut arena) = (Vec::new(), Vec::new());
        for ((of, tensor), numbers) in self.inputs.iter().zip(numbers) {
            let layout = Layout { start: arena.len(), numbers: *numbers, ..*of };
            match numbers {
                Numbers::F32 => arena.extend_from_slice(tensor),
                Numbers::Bf16 => arena.extend(stored(tensor, of, &layout, self.border)),
            }
            layouts.push(layout);
        }
        let source = Source {
            conv: self.conv,
            border: self.border,
            inputs: &layouts,
            width,
            weights: &self.weights,
            bias: &self.bias,
        };
        let Some(convolution) = Bf16Convolution::new(unit, &source) else {
            return assert!(unit == Unit::Avx512Bf16 && width < 48, "{name}: none was made");
        };
        let Shape { height, width: columns, .. } = layouts[0].shape;
        let shape = Shape { height, width, channels: self.conv.outputs };
        let out = Layout { room: Storage::Strip, ..Layout::whole(shape, 0, 0) };
        for (x, y) in [0, columns - width].into_iter().flat_map(|x| (0..height).map(move |y| (x, y))) {
            spoil_memory_of_tiles();
            let mut actual = vec![Block([f32::NAN; LANES]); out.row_len()];
            let (_, rest) = Remainder::split(&mut arena, 0, 0);
            let (_, strips) = Remainder::split(&mut [], 0, 0);
            convolution.run_row(
                gs3_simd::level(),
                None,
                Sources::strip(rest, Remainder::default(), strips, x),
                &out,
                y,
                &mut actual,
            );
            for (o, k) in (0..self.conv.outputs).flat_map(|o| (0..width).map(move |k| (o, k))) {
                let value = f64::from(actual[o / LANES * width + k].0[o % LANES]);
                let [sum, size] = self.sum(o, x + k, y);
                // Rounding of f32 sums, in any order.
                let error = (value - sum).abs() / size;
                assert!(error < 1e-6, "{name}: ({}, {y}) of {o}: {value}, not {sum}", x + k);
            }
        }
    }
}

/// Leaves what are not numbers wherever the thread's tiles find their input.
fn spoil_memory_of_tiles() {
    let layout = Layout::whole(Shape { height: 1, width: 48, channels: 160 }, 1, 0);
    let mut arena = vec![Block([f32::NAN; LANES]); layout.len()];
    let (conv, border) = (Conv2d::new(3, 1), Border::Replicate);
    let weights = vec![0.0; 160 * 9];
    let source = Source { conv, border, inputs: &[layout], width: 48, weights: &weights, bias: &[] };
    if let Some(convolution) = Bf16Convolution::new(Unit::Amx, &source) {
        let out =
            Layout { room: Storage::Strip, ..Layout::whole(Shape { channels: 1, ..layout.shape }, 0, 0) };
        let (_, rest) = Remainder::split(&mut arena, 0, 0);
        let (_, strips) = Remainder::split(&mut [], 0, 0);
        let mut sums = vec![Block::default(); out.row_len()];
        convolution.run_row(
            gs3_simd::level(),
            None,
            Sources::strip(rest, Remainder::default(), strips, 0),
            &out,
            0,
            &mut sums,
        );
    }
}

#[test]
fn every_unit_sums_products_of_rounded_numbers() {
    let mut random = Random::new(7);
    // Kernel, dilation, channels of each input, outputs, width of the image, of a strip.
    for (kernel, dilation, channels, outputs, width, strip) in [
        (3, 1, &[16][..], 16, 96, 48),
        (3, 1, &[9], 64, 62, 48),
        (3, 1, &[5, 16, 3], 3, 60, 48),
        (3, 1, &[16, 18], 16, 50, 48),
        (3, 1, &[48], 48, 130, 48),
        (3, 2, &[24], 33, 61, 48),
        (1, 1, &[64], 48, 50, 48),
        (1, 1, &[1], 1, 48, 48),
        (5, 1, &[7], 17, 49, 48),
        (3, 1, &[40, 20], 20, 36, 36),
        (3, 1, &[12], 12, 17, 16),
    ] {
        for border in [Border::Zero, Border::Replicate] {
            let conv = Conv2d { dilation, ..Conv2d::new(kernel, outputs) };
            let case = Case::new(conv, border, channels, width, &mut random);
            for unit in [Unit::Avx512Bf16, Unit::Amx].into_iter().filter(|unit| unit.is_available()) {
                case.check(unit, &vec![Numbers::F32; channels.len()], strip);
            }
            if Unit::Amx.is_available() {
                let first = |k: usize| if k == 0 { Numbers::Bf16 } else { Numbers::F32 };
                let numbers: Vec<Numbers> = (0..channels.len()).map(first).collect();
                case.check(Unit::Amx, &numbers, strip);
                case.check(Unit::Amx, &vec![Numbers::Bf16; channels.len()], strip);
            }
        }
    }
    for unit in [Unit::Avx512Bf16, Unit::Amx].into_iter().filter(|unit| !unit.is_available()) {
        println!("skipped: this machine has no {unit:?}");
    }
}
