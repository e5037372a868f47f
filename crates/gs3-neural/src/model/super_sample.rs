//! Super sampling: gradient-aware interpolation and geometry-temporal recurrent refinement (the paper's GASS).

use super::{FEATURES, Tier, add_residual, carried_state, check_scale};
use crate::graph::{Activation, Border, Conv2d, Graph, GraphBuilder, GraphError, Op};

/// The network that enlarges an LR frame by `scale`, 1 to 8, given the frames before it.
///
/// | input | channels | grid | |
/// |---|---|---|---|
/// | `history` | 4 | HR | RGB of the frame reconstructed without learning, but kriged, from this LR frame and its past, and its uncertainty |
/// | `previous` | 4 | HR | the network's own image of the frame before, warped to this one |
/// | `share` | 1 | HR | how far `previous` may count, `[0, 1]`: 0 where it is hidden or `history` is exact |
/// | `drift` | 3 | HR | RGB of `innovation`, interpolated between samples; 0 where `history` is exact |
/// | `innovation` | 4 | LR | RGB that the LR samples differ by from what the past alone predicts there, and how much it knows |
/// | `previous_innovation` | 3 | LR | RGB that the LR samples differ by from `previous` at their pixels; 0 where it was hidden |
/// | `color` | 3 | LR | display-encoded, `[0, 1]` |
/// | `gradients` | 6 | LR | ∂x RGB, ∂y RGB per LR pixel |
/// | `compressed` | 6 | LR | g / (1 + \|g\|) of them |
/// | `geometry` | 3 | LR | inverse depth of the frame's scale, Nv, alpha |
/// | `jitter` | 2 | LR | offset of the samples in LR pixels, `[−½, ½]` |
/// | `hidden` | `tier.hidden_channels()` | LR | the last state |
/// | `motion` | 2 | LR | where each pixel was in the last frame, relative to itself, LR pixels |
/// | `validity` | 1 | LR | whether it was seen there, `[0, 1]` |
///
/// Outputs: `color` (HR, 4) = (1 − α) `history` + α `previous` + β `drift` + a residual weighed by the uncertainty,
/// with α at most `share` and β in `[0, 1]`; and `hidden`.
///
/// `innovation` shows how far the past is wrong, where it can be known: reprojection errs, colours depend on the view.
/// `history` cannot show it, since it agrees with the samples at their places. `previous_innovation` shows how far the
/// network's own past is.
///
/// The paper's gradient-aware interpolation is a linear map of the 3×3 block of (I, ∂x, ∂y), started at tensor Hermite.
/// Under jitter that map differs for every offset, so the Hermite part comes exact in `history`; `gai` learns,
/// linearly, what a best map adds to it.
///
/// # Errors
/// [`GraphError::Scale`] if there is no network for `scale`.
pub fn super_sample(scale: usize, tier: Tier) -> Result<Graph, GraphError> {
    check_scale(scale)?;
    let (c, block) = (tier.channels(), scale * scale);
    let (blocks, refine) = match tier {
        Tier::Fast | Tier::Balanced => (1, 1),
        Tier::High => (2, 3),
    };
    let features = |kernel| Conv2d::new(kernel, c).activation(FEATURES);
    let mut g = GraphBuilder::new("super_sample", 5, Border::Replicate);
    let [history, previous] = [g.input("history", 4, scale), g.input("previous", 4, scale)];
    let [share, drift] = [g.input("share", 1, scale), g.input("drift", 3, scale)];
    let [innovation, of_previous] = [g.input("innovation", 4, 1), g.input("previous_innovation", 3, 1)];
    let [color, gradients] = [g.input("color", 3, 1), g.input("gradients", 6, 1)];
    let [compressed, geometry] = [g.input("compressed", 6, 1), g.input("geometry", 3, 1)];
    let jitter = g.input("jitter", 2, 1);
    let hidden = carried_state(&mut g, tier.hidden_channels());

    let unshuffle = Op::PixelUnshuffle { factor: scale };
    let history = g.layer("history.blocks", unshuffle, &[history]);
    let previous = g.layer("previous.blocks", unshuffle, &[previous]);
    let share = g.layer("share.blocks", unshuffle, &[share]);
    let drift = g.layer("drift.blocks", unshuffle, &[drift]);
    let past = g.conv("history.conv", features(1), &[history, previous, share, of_previous]);
    let x = g.conv("enter", features(3), &[past, color, compressed, geometry, jitter, innovation]);
    let mut x = g.conv("features.0", features(3), &[x]);
    // Residual, so that a network can grow into one of more blocks ([`super::grown`]).
    for k in 1..blocks {
        let more = g.conv(&format!("features.{k}"), features(3), &[x]);
        x = g.layer(&format!("features.{k}.sum"), Op::Add, &[x, more]);
    }
    let hidden = g.gated_recurrent_unit("recurrent", 1, x, hidden);
    let refinement = g.conv("refine", Conv2d::new(refine, 3 * block), &[x, hidden]);
    let gai = g.conv("gai", Conv2d { bias: false, ..Conv2d::new(3, 3 * block) }, &[color, gradients]);

    let residual = g.layer("residual", Op::Add, &[refinement, gai]);
    // What decides between pixels of a block must not pass through the few channels of the features.
    let uncertainty = g.layer("uncertainty.blocks", Op::Slice { first: 3 * block, count: block }, &[history]);
    let share_of = Conv2d::new(1, block).activation(Activation::Sigmoid);
    let alpha = g.conv("head.alpha", share_of, &[x, hidden, uncertainty, share]);
    let alpha = g.layer("alpha.blocks", Op::Multiply, &[alpha, share]);
    let every_alpha = g.layer("alpha.channels", Op::Concat, &[alpha; 4]);
    let blend = g.layer("blend", Op::Mix, &[history, previous, every_alpha]);
    let beta = g.conv("head.beta", share_of, &[x, hidden, uncertainty, share]);
    let every_beta = g.layer("beta.channels", Op::Concat, &[beta; 3]);
    let drift = g.layer("drift.weighed", Op::Multiply, &[drift, every_beta]);
    let image = add_residual(&mut g, blend, residual, Some(drift), block);
    let color = g.layer("image", Op::PixelShuffle { factor: scale }, &[image]);
    g.output("color", color);
    g.output("hidden", hidden);
    g.finish()
}
