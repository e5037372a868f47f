//! Frame interpolation: feature fusion U-Net with spatial attention and a temporal recurrent unit (the paper's LTFI).

use super::{FEATURES, Tier, check_scale};
use crate::error::GraphError;
use crate::graph::{Activation, Border, Conv2d, Graph, GraphBuilder, Op, Tensor};

/// The network that makes the frame at time t between HR frame 0 and LR frame 1, both warped to t.
///
/// | input | channels | grid | |
/// |---|---|---|---|
/// | `color_0` | 3 | HR | frame 0 warped to t, display-encoded |
/// | `color_1` | 3 | LR | frame 1 warped to t |
/// | `gradients_1` | 6 | LR | its warped gradients, ∂x RGB, ∂y RGB per LR pixel |
/// | `compressed_1` | 6 | LR | g / (1 + \|g\|) of them |
/// | `geometry` | 3 | LR | inverse depth of the frame's scale, Nv, alpha, warped to t |
/// | `validity` | 2 | LR | of both warps, `[0, 1]` |
/// | `time` | 1 | LR | t everywhere |
/// | `hidden` | `tier.channels()` | LR | the last state, warped to t, 0 where invalid |
///
/// Outputs: `color` (HR, 3) = α Î + (1 − α) `color_0`, where Î is a residual over `color_1`, enlarged
/// with its gradients; `estimate` (Î),
/// `alpha` (HR, 1) for the losses, and `hidden`.
///
/// # Errors
/// [`GraphError::Scale`] if there is no network for `scale`.
pub fn interpolate(scale: usize, tier: Tier) -> Result<Graph, GraphError> {
    check_scale(scale)?;
    let (c, block) = (tier.channels(), scale * scale);
    let up = if tier == Tier::Fast { 1 } else { 3 };
    let features = |kernel, channels| Conv2d::new(kernel, channels).activation(FEATURES);
    let mut g = GraphBuilder::new("interpolate", 1, Border::Replicate);
    let [color_0, color_1] = [g.input("color_0", 3, scale), g.input("color_1", 3, 1)];
    let [gradients, compressed] = [g.input("gradients_1", 6, 1), g.input("compressed_1", 6, 1)];
    let geometry = g.input("geometry", 3, 1);
    let [validity, time, hidden] =
        [g.input("validity", 2, 1), g.input("time", 1, 1), g.input("hidden", c, 1)];

    let blocks = g.layer("color_0.blocks", Op::PixelUnshuffle { factor: scale }, &[color_0]);
    let x = g.conv("color_0.conv", features(1, c), &[blocks]);
    let x = g.conv("enter", features(3, c), &[x, color_1, compressed, geometry, validity, time]);
    let fine = g.conv("fine", features(3, c), &[x]);
    let x = g.layer("fine.pool", Op::MaxPool2, &[fine]);
    let x = g.conv("middle.0", features(3, 2 * c), &[x]);
    let middle = g.conv("middle.1", features(3, 2 * c), &[x]);
    let x = g.layer("middle.pool", Op::MaxPool2, &[middle]);
    let x = g.conv("coarse.0", features(3, 2 * c), &[x]);
    let x = g.conv("coarse.1", features(3, 2 * c), &[x]);

    // One block of attention, at the finest level, weighs every skip: coarser ones see its maxima.
    let attention = attention(&mut g, fine);
    let coarser = g.layer("attention.pool", Op::MaxPool2, &[attention]);
    let fine = g.layer("fine.attended", Op::Multiply, &[fine, attention]);
    let middle = g.layer("middle.attended", Op::Multiply, &[middle, coarser]);

    let x = g.conv("up.middle", Conv2d::new(up, 4 * c), &[x]);
    let x = g.layer("up.middle.shuffle", Op::PixelShuffle { factor: 2 }, &[x, middle]);
    let x = g.conv("merge.middle", features(3, 2 * c), &[x, middle]);
    let x = g.conv("up.fine", Conv2d::new(up, 4 * c), &[x]);
    let x = g.layer("up.fine.shuffle", Op::PixelShuffle { factor: 2 }, &[x, fine]);
    let x = g.conv("merge.fine", features(3, c), &[x, fine]);
    let hidden = g.gated_recurrent_unit("recurrent", 1, x, hidden);

    // All on the LR grid, a block of HR pixels per LR pixel: HR planes are only rearranged.
    let base = g.conv("gai.conv", Conv2d::new(3, 3 * block), &[color_1, gradients]);
    let residual = g.conv("head.color", Conv2d::new(3, 3 * block), &[hidden]);
    let estimate = g.layer("estimate.blocks", Op::Add, &[base, residual]);
    let alpha = Conv2d::new(3, block).activation(Activation::Sigmoid);
    let alpha = g.conv("head.alpha", alpha, &[hidden]);
    let every_color = g.layer("alpha.colors", Op::Concat, &[alpha; 3]);
    let color = g.layer("color.blocks", Op::Mix, &[blocks, estimate, every_color]);
    let color = g.layer("color", Op::PixelShuffle { factor: scale }, &[color]);
    let estimate = g.layer("estimate", Op::PixelShuffle { factor: scale }, &[estimate]);
    let alpha = g.layer("alpha", Op::PixelShuffle { factor: scale }, &[alpha]);
    for (name, tensor) in [("color", color), ("estimate", estimate), ("alpha", alpha), ("hidden", hidden)] {
        g.output(name, tensor);
    }
    g.finish()
}

/// Where to look: σ(conv 7×7, dilation 3, of [mean over channels; largest over channels]).
fn attention(g: &mut GraphBuilder, x: Tensor) -> Tensor {
    let mean = g.layer("attention.mean", Op::ChannelMean, &[x]);
    let max = g.layer("attention.max", Op::ChannelMax, &[x]);
    let conv = Conv2d::new(7, 1).dilation(3).activation(Activation::Sigmoid);
    g.conv("attention", conv, &[mean, max])
}
