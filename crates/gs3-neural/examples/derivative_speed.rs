//! How fast derivatives are: a training step's forward and backward pass over a batch, one image a thread.
//!
//! `cargo run --release -p gs3-neural --example derivative_speed [width height [batch]]`
//!
//! GFLOP/s count the convolutions' multiply-adds three times: the result, the derivative by the input and that by the
//! weights, also where inputs have none.

use std::time::{Duration, Instant};

use gs3_neural::model::{Tier, interpolate, super_sample};
use gs3_neural::{
    Activation, Border, Conv2d, Differentiator, Graph, GraphBuilder, Header, Random, Shape, Weights,
};
use rayon::prelude::*;

fn main() {
    let mut numbers = std::env::args().skip(1).filter_map(|side| side.parse().ok());
    let mut next = |default: usize| numbers.next().unwrap_or(default);
    let (width, height, batch) = (next(64), next(64), next(8));
    println!("{} threads, {batch} images of {width}×{height}", rayon::current_num_threads());
    for channels in [16, 32, 48] {
        let mut g = GraphBuilder::new(&format!("5 convolutions {channels}"), 1, Border::Replicate);
        let mut x = g.input("hidden", channels, 1);
        for k in 0..5 {
            let conv = Conv2d::new(3, channels).activation(Activation::Relu);
            x = g.conv(&format!("conv.{k}"), conv, &[x]);
        }
        g.output("y", x);
        report(&g.finish().expect("a graph"), [height, width], batch, "");
    }
    for tier in Tier::ALL {
        for graph in [super_sample(4, tier), interpolate(4, tier)] {
            report(&graph.expect("a network"), [height, width], batch, tier.name());
        }
    }
}

fn report(graph: &Graph, lr: [usize; 2], batch: usize, tier: &str) {
    let work = 2.0 * graph.multiply_adds_per_pixel(lr).expect("a size") * (lr[0] * lr[1] * batch) as f64;
    let [forward, whole] = time(graph, lr, batch);
    println!(
        "{} {tier}: forward {:.2} ms, {:.0} GFLOP/s; with backward {:.2} ms, {:.0} GFLOP/s",
        graph.name(),
        1e3 * forward.as_secs_f64(),
        work / forward.as_secs_f64() / 1e9,
        1e3 * whole.as_secs_f64(),
        3.0 * work / whole.as_secs_f64() / 1e9
    );
}

/// The shortest of several passes over a batch: forward alone, and all that a step needs, packing of the weights and
/// the sum over the batch included.
fn time(graph: &Graph, lr: [usize; 2], batch: usize) -> [Duration; 2] {
    let weights = Weights::random(graph, Header::of(graph, 4), 1);
    let differentiator = Differentiator::new(graph, lr, &["hidden"]).expect("a size");
    let mut random = Random::new(1);
    let mut image = |shape: Option<Shape>| -> Vec<f32> {
        (0..shape.map_or(0, |s| s.len())).map(|_| random.unit()).collect()
    };
    let (input, output) = (|n: &str| differentiator.input_shape(n), |n: &str| differentiator.output_shape(n));
    let images: Vec<(&str, Vec<f32>)> =
        graph.inputs().map(|(_, layer)| (layer.name.as_str(), image(input(&layer.name)))).collect();
    let v_outputs: Vec<(&str, Vec<f32>)> =
        graph.outputs().iter().map(|o| (o.name.as_str(), image(output(&o.name)))).collect();
    let images: Vec<(&str, &[f32])> = images.iter().map(|(name, image)| (*name, &image[..])).collect();
    let v_outputs: Vec<(&str, &[f32])> = v_outputs.iter().map(|(name, v)| (*name, &v[..])).collect();
    let mut items: Vec<_> = (0..batch)
        .map(|_| {
            let v_hidden = image(input("hidden"));
            (differentiator.tape(), differentiator.scratch(), differentiator.v_weights(), v_hidden)
        })
        .collect();
    let mut best = [Duration::MAX; 2];
    for _ in 0..12 {
        let start = Instant::now();
        let packed = differentiator.pack(&weights).expect("its weights");
        items.par_iter_mut().for_each(|(tape, ..)| {
            differentiator.forward(&packed, &images, tape).expect("its images");
        });
        best[0] = best[0].min(start.elapsed());
        items.par_iter_mut().for_each(|(tape, scratch, v_weights, v_hidden)| {
            v_weights.values_mut().for_each(|array| array.values_mut().fill(0.0));
            let mut v_inputs = [("hidden", &mut v_hidden[..])];
            differentiator
                .backward(&packed, tape, scratch, &v_outputs, v_weights, &mut v_inputs)
                .expect("its images");
        });
        let mut sums = differentiator.v_weights();
        for (.., v_weights, _) in &items {
            for (sum, v) in sums.values_mut().zip(v_weights.values()) {
                sum.values_mut().iter_mut().zip(v.values()).for_each(|(sum, v)| *sum += v);
            }
        }
        best[1] = best[1].min(start.elapsed());
    }
    best
}
