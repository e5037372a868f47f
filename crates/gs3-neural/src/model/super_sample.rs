//! Super sampling: gradient-aware interpolation and geometry-temporal recurrent refinement (the paper's GASS).

use super::{FEATURES, Tier, check_scale};
use crate::error::GraphError;
use crate::graph::{Border, Conv2d, Graph, GraphBuilder, Op};

/// The network that enlarges an LR frame by `scale` (2 or 4), given the frames before it.
///
/// | input | channels | grid | |
/// |---|---|---|---|
/// | `color` | 3 | LR | display-encoded, `[0, 1]` |
/// | `gradients` | 6 | LR | ∂x RGB, ∂y RGB per LR pixel |
/// | `compressed` | 6 | LR | g / (1 + \|g\|) of them |
/// | `geometry` | 4 | LR | inverse depth of the frame's scale, Nv, alpha, validity of the history |
/// | `jitter` | 2 | LR | offset of the samples in LR pixels, `[−½, ½]` |
/// | `history` | 3 | HR | the last HR frame, reprojected |
/// | `hidden` | `tier.channels()` | LR | the last state, reprojected, 0 where invalid |
///
/// Outputs: `color` (HR, 3) and `hidden`.
/// [`initial_weights`](super::initial_weights) starts the linear path `gai` as tensor cubic Hermite interpolation.
///
/// # Errors
/// [`GraphError::Scale`] if there is no network for `scale`.
pub fn super_sample(scale: usize, tier: Tier) -> Result<Graph, GraphError> {
    check_scale(scale)?;
    let (c, block) = (tier.channels(), 3 * scale * scale);
    let (blocks, gates) = match tier {
        Tier::Fast => (1, 1),
        Tier::Balanced => (2, 3),
        Tier::High => (3, 3),
    };
    let features = |kernel| Conv2d::new(kernel, c).activation(FEATURES);
    let mut g = GraphBuilder::new("super_sample", 1, Border::Replicate);
    let [color, gradients] = [g.input("color", 3, 1), g.input("gradients", 6, 1)];
    let [compressed, geometry] = [g.input("compressed", 6, 1), g.input("geometry", 4, 1)];
    let [jitter, history] = [g.input("jitter", 2, 1), g.input("history", 3, scale)];
    let hidden = g.input("hidden", c, 1);

    let gai = g.conv("gai.conv", Conv2d::new(3, block + 16), &[color, gradients]);
    let gai = g.conv("gai.mix", Conv2d::new(1, block), &[gai]);

    let history = g.layer("history.blocks", Op::PixelUnshuffle { factor: scale }, &[history]);
    let history = g.conv("history.conv", features(1), &[history]);
    let mut x = g.conv("enter", features(3), &[color, compressed, geometry, jitter, history]);
    for k in 0..blocks {
        x = g.conv(&format!("features.{k}"), features(3), &[x]);
    }
    let hidden = g.gated_recurrent_unit("recurrent", gates, x, hidden);
    let refinement = g.conv("refine", Conv2d::new(3, block), &[hidden]);

    let sum = g.layer("sum", Op::Add, &[gai, refinement]);
    let color = g.layer("image", Op::PixelShuffle { factor: scale }, &[sum]);
    g.output("color", color);
    g.output("hidden", hidden);
    g.finish()
}
