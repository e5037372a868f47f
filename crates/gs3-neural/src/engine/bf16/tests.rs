use fearless_simd::Level;

use super::{Bf16Convolution, Source, Unit, rounded};
use crate::engine::block::{Block, LANES, Layout, Rest, Room, Sources};
use crate::engine::conv::fill_halo;
use crate::graph::{Activation, Border, Conv2d};
use crate::random::Random;
use crate::shape::Shape;

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

/// A tensor of numbers in ±1 whose lanes beyond the channels are not numbers: nothing may read them.
fn tensor(layout: &Layout, border: Border, random: &mut Random) -> Vec<Block> {
    let mut rows = Vec::new();
    for _ in 0..layout.shape.height {
        let lane = |b: usize, l: usize, random: &mut Random| {
            if b * LANES + l < layout.shape.channels { random.signed() } else { f32::NAN }
        };
        let mut row: Vec<Block> = (0..layout.row_len())
            .map(|k| Block(std::array::from_fn(|l| lane(k / layout.stride(), l, random))))
            .collect();
        fill_halo(border, layout, &mut row);
        rows.extend(row);
    }
    rows
}

fn bf16(value: f32) -> f64 {
    f64::from(f32::from_bits(u32::from(rounded(value)) << 16))
}

/// All strips of an image against sums in f64 of products of rounded numbers.
#[test]
fn every_unit_sums_products_of_rounded_numbers() {
    for unit in [Unit::Pairs, Unit::Tiles] {
        if !unit.is_available() {
            println!("skipped: this machine does not have {unit:?}");
            continue;
        }
        let mut random = Random::new(7);
        // Kernel, dilation, channels of each input, outputs, width of the image, of a strip.
        for (kernel, dilation, channels, outputs, width, strip) in [
            (3, 1, &[16][..], 16, 96, 48),
            (3, 1, &[9], 64, 62, 48),
            (3, 1, &[5, 16, 3], 3, 60, 48),
            (3, 1, &[48], 48, 130, 48),
            (3, 2, &[24], 33, 61, 48),
            (1, 1, &[64], 48, 50, 48),
            (1, 1, &[1], 1, 48, 48),
            (5, 1, &[7], 17, 49, 48),
            (3, 1, &[40, 20], 20, 36, 36),
            (3, 1, &[12], 12, 17, 16),
        ] {
            for border in [Border::Zero, Border::Replicate] {
                let case =
                    format!("{unit:?}: {kernel}, {dilation}, {channels:?} → {outputs}, {width}, {border:?}");
                let conv =
                    Conv2d { dilation, activation: Activation::Identity, ..Conv2d::new(kernel, outputs) };
                let (height, all) = (4, channels.iter().sum::<usize>());
                let mut arena = Vec::new();
                let inputs: Vec<Layout> = channels
                    .iter()
                    .map(|channels| {
                        let shape = Shape { height, width, channels: *channels };
                        let layout = Layout::whole(shape, conv.reach(), arena.len());
                        arena.extend(tensor(&layout, border, &mut random));
                        layout
                    })
                    .collect();
                let weights: Vec<f32> =
                    (0..outputs * all * kernel * kernel).map(|_| random.signed()).collect();
                let bias: Vec<f32> = (0..outputs).map(|_| random.signed()).collect();
                let source =
                    Source { conv, border, inputs: &inputs, width: strip, weights: &weights, bias: &bias };
                let Some(convolution) = Bf16Convolution::new(unit, &source) else {
                    assert!(unit == Unit::Pairs && strip < 48, "{case}: none was made");
                    continue;
                };
                let shape = Shape { height, width: strip, channels: outputs };
                let out = Layout { shape, halo: 0, start: 0, room: Room::Strip };
                for (x, y) in [0, width - strip].into_iter().flat_map(|x| (0..height).map(move |y| (x, y))) {
                    let mut actual = vec![Block([f32::NAN; LANES]); out.row_len()];
                    let (_, rest) = Rest::split(&mut arena, 0, 0);
                    let (_, strips) = Rest::split(&mut [], 0, 0);
                    convolution.run_row(Level::new(), Sources::strip(rest, strips, x), &out, y, &mut actual);
                    let all_rows = Sources::all(&arena);
                    for o in 0..outputs {
                        for k in 0..strip {
                            let (mut sum, mut size, mut first) = (f64::from(bias[o]), 1.0, 0);
                            for layout in &inputs {
                                for c in 0..layout.shape.channels {
                                    for tap in 0..kernel * kernel {
                                        let at = |place: usize, tap: usize| {
                                            (place + tap * dilation) as isize - conv.reach() as isize
                                        };
                                        let (column, line) = (at(x + k, tap % kernel), at(y, tap / kernel));
                                        let inside = |v: isize, len: usize| v.clamp(0, len as isize - 1);
                                        let (cx, cy) = (inside(column, width), inside(line, height));
                                        if border == Border::Zero && (cx, cy) != (column, line) {
                                            continue;
                                        }
                                        let weight = weights[(o * all + first + c) * kernel * kernel + tap];
                                        let product = bf16(weight)
                                            * bf16(all_rows.at(layout, cx as usize, cy as usize, c));
                                        sum += product;
                                        size += product.abs();
                                    }
                                }
                                first += layout.shape.channels;
                            }
                            let value = f64::from(actual[o / LANES * strip + k].0[o % LANES]);
                            // Rounding of f32 sums, in whatever order.
                            let error = (value - sum).abs() / size;
                            assert!(error < 1e-6, "{case}: ({}, {y}) of {o}: {value}, not {sum}", x + k);
                        }
                    }
                }
            }
        }
    }
}
