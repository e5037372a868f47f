//! How fast the engine is: multiply-adds per second of convolutions and networks against the machine's peak.
//!
//! `cargo run --release -p gs3-neural --example engine_speed [width height] [bf16]`: in bf16 where the machine has
//! it. Shares of the peak still refer to f32.

use std::hint::black_box;
use std::time::{Duration, Instant};

use fearless_simd::prelude::*;
use fearless_simd::{Simd, dispatch, f32x16};
use gs3_neural::model::{Tier, initial_weights, interpolate, super_sample};
use gs3_neural::{Activation, Arithmetic, Border, Conv2d, Engine, Graph, GraphBuilder, Header, Op, Random};

/// Independent sums: more than the latency of two multiply-add units times their number, within 32 registers.
const CHAINS: usize = 24;

fn main() {
    let mut sides = std::env::args().skip(1).filter_map(|side| side.parse().ok());
    let (width, height): (usize, usize) = (sides.next().unwrap_or(480), sides.next().unwrap_or(270));
    let arithmetic = match std::env::args().any(|arg| arg == "bf16") {
        true => Arithmetic::Bf16,
        false => Arithmetic::F32,
    };
    let peak = peak();
    println!("{} threads, peak {:.0} GFLOP/s", rayon::current_num_threads(), peak / 1e9);
    for (kernel, inputs, outputs) in
        [(3, 32, 32), (3, 16, 16), (3, 48, 48), (3, 64, 32), (3, 9, 64), (1, 64, 48)]
    {
        // What is measured is the difference between a network of many such convolutions and one of a single: both
        // add up as many results, since what nothing reads is not computed.
        let chain = |convolutions: usize| {
            let mut g = GraphBuilder::new("conv", 1, Border::Replicate);
            let x = g.input("x", 16, 1);
            // A cheap way to many channels.
            let wide = g.conv("wide", Conv2d::new(1, inputs), &[x]);
            let mut y = g.conv("first", Conv2d::new(1, outputs), &[wide]);
            let mut result = y;
            for k in 0..=LAYERS {
                if k < convolutions {
                    let conv = Conv2d::new(kernel, outputs).activation(Activation::Relu);
                    result = g.conv(&format!("conv.{k}"), conv, &[wide]);
                }
                y = g.layer(&format!("sum.{k}"), Op::Add, &[y, result]);
            }
            let y = g.layer("mean", Op::ChannelMean, &[y]);
            g.output("y", y);
            time(&g.finish().expect("a graph"), [height, width], arithmetic)
        };
        let work = 2.0 * (kernel * kernel * inputs * outputs * LAYERS * width * height) as f64;
        let seconds = (chain(LAYERS + 1) - chain(1)).as_secs_f64();
        let rate = work / seconds;
        println!(
            "conv {kernel}×{kernel} {inputs}→{outputs}: {:.2} ms, {:.0} GFLOP/s, {:.0} % of the peak",
            1e3 * seconds / LAYERS as f64,
            rate / 1e9,
            100.0 * rate / peak
        );
    }
    for tier in Tier::ALL {
        for graph in [super_sample(4, tier), interpolate(4, tier)] {
            let graph = graph.expect("a network");
            let lr = [height, width];
            let work = 2.0 * graph.multiply_adds_per_pixel(lr).expect("a size") * (width * height) as f64;
            let time = time(&graph, lr, arithmetic);
            println!(
                "{} {}: {:.1} ms, {:.0} % of the peak",
                graph.name(),
                tier.name(),
                1e3 * time.as_secs_f64(),
                100.0 * work / time.as_secs_f64() / peak
            );
        }
    }
}

/// Convolutions timed together.
const LAYERS: usize = 8;

/// The shortest of several runs of `graph` with all its outputs.
fn time(graph: &Graph, lr: [usize; 2], arithmetic: Arithmetic) -> Duration {
    let weights = initial_weights(graph, Header::of(graph, 4), 1);
    let mut engine = Engine::with_arithmetic(graph, &weights, lr, arithmetic).expect("an engine");
    let mut random = Random::new(1);
    let names: Vec<&str> = graph.inputs().map(|(_, layer)| layer.name.as_str()).collect();
    let len = |name: &str| engine.shape(name).map_or(0, |shape| shape.len());
    let images: Vec<Vec<f32>> = names.iter().map(|n| (0..len(n)).map(|_| random.unit()).collect()).collect();
    let images: Vec<(&str, &[f32])> = names.iter().copied().zip(images.iter().map(Vec::as_slice)).collect();
    // What a frame needs.
    let wanted = ["color", "hidden", "y"];
    let outputs: Vec<&str> =
        wanted.into_iter().filter(|n| graph.outputs().iter().any(|o| o.name == *n)).collect();
    let shapes = graph.shapes(lr).expect("a size");
    let mut results: Vec<(&str, Vec<f32>)> = outputs
        .iter()
        .map(|n| {
            let output = graph.outputs().iter().find(|o| o.name == *n).expect("it was found above");
            (*n, vec![0.0; shapes[output.tensor.index()].len()])
        })
        .collect();
    let mut best = Duration::MAX;
    for _ in 0..24 {
        let mut outputs: Vec<(&str, &mut [f32])> =
            results.iter_mut().map(|(n, r)| (*n, &mut r[..])).collect();
        let start = Instant::now();
        engine.run(&images, &mut outputs).expect("it runs");
        best = best.min(start.elapsed());
    }
    best
}

/// Floating-point operations per second of all threads at once, in multiply-adds of 16 lanes.
fn peak() -> f64 {
    let level = gs3_simd::level();
    (0..10)
        .map(|_| {
            let start = Instant::now();
            let rounds = 4_000_000_usize;
            rayon::broadcast(|_| dispatch!(level, simd => black_box(chains(simd, rounds, black_box(0.999)))));
            let operations = rayon::current_num_threads() * rounds * CHAINS * 16 * 2;
            operations as f64 / start.elapsed().as_secs_f64()
        })
        .fold(0.0, f64::max)
}

#[inline(always)]
fn chains<S: Simd>(simd: S, rounds: usize, factor: f32) -> f32 {
    let mut sums = [f32x16::splat(simd, 1.0); CHAINS];
    let factor = f32x16::splat(simd, factor);
    for _ in 0..rounds {
        for sum in &mut sums {
            *sum = sum.mul_add(factor, factor);
        }
    }
    sums.iter().map(|sum| sum.to_array().iter().sum::<f32>()).sum()
}
