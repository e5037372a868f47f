//! Frame interpolation: feature fusion U-Net with spatial attention and a temporal recurrent unit (the paper's LTFI).

use super::{FEATURES, Tier, add_residual, carried_state, check_scale};
use crate::graph::{Activation, Border, Conv2d, Graph, GraphBuilder, GraphError, Op, Tensor};

/// The network that makes the frame at time t between HR frames 0 and 1, both warped to t.
///
/// | input | channels | grid | |
/// |---|---|---|---|
/// | `before` | 4 | HR | frame 0 warped to t: RGB, uncertainty |
/// | `after` | 4 | HR | frame 1 warped to t |
/// | `share` | 1 | HR | weight of frame 1 by time, visibility and uncertainty, `[0, 1]` |
/// | `geometry` | 2 | LR | inverse depth of the frame's scale; t everywhere |
/// | `hidden` | `tier.hidden_channels()` | LR | the state of the last interpolated frame |
/// | `motion` | 2 | LR | where each pixel was in that frame, relative to itself, LR pixels |
/// | `validity` | 1 | LR | whether it was seen there, `[0, 1]` |
///
/// Outputs: `color` (HR, 4: RGB and uncertainty) = (1 − α) `before` + α `after` + residual, α = `share` + a learned
/// correction; that correction, `alpha_correction` (HR, 1), for the losses; and `hidden`. The residual is what the
/// features say and a linear map of both neighbours' blocks, `detail`: what warping blurs passes no few channels. It
/// is weighed by the blend's uncertainty, the correction, in (−1, 1), by the sum of the neighbours': where they are
/// exact, neither changes anything.
///
/// The paper fuses HR frame 0 with LR frame 1, so that super sampling of frame 1 runs beside it; here frame 1 comes
/// super-sampled, which costs that overlap and gains its detail.
///
/// # Errors
/// [`GraphError::Scale`] if there is no network for `scale`.
pub fn interpolate(scale: usize, tier: Tier) -> Result<Graph, GraphError> {
    check_scale(scale)?;
    let (c, block) = (tier.channels(), scale * scale);
    let merge = match tier {
        Tier::Fast => 1,
        Tier::Balanced | Tier::High => 3,
    };
    let features = |kernel| Conv2d::new(kernel, c).activation(FEATURES);
    let mut g = GraphBuilder::new("interpolate", 4, Border::Replicate);
    let [before, after] = [g.input("before", 4, scale), g.input("after", 4, scale)];
    let [share, geometry] = [g.input("share", 1, scale), g.input("geometry", 2, 1)];
    let hidden = carried_state(&mut g, tier.hidden_channels());

    // All on the LR grid, a block of HR pixels per LR pixel: HR planes are only rearranged.
    let unshuffle = Op::PixelUnshuffle { factor: scale };
    let before = g.layer("before.blocks", unshuffle, &[before]);
    let after = g.layer("after.blocks", unshuffle, &[after]);
    let share = g.layer("share.blocks", unshuffle, &[share]);
    let x = g.conv("fuse", features(1), &[before, after, share]);
    let fine = g.conv("enter", features(3), &[x, geometry]);
    let x = g.layer("enter.pool", Op::MaxPool2, &[fine]);
    let x = g.conv("middle.0", features(3), &[x]);
    let middle = g.conv("middle.1", features(3), &[x]);
    let x = g.layer("middle.pool", Op::MaxPool2, &[middle]);
    let x = g.conv("coarse.0", features(3), &[x]);
    let x = g.conv("coarse.1", features(3), &[x]);

    // One block of attention, at the finest level, weighs every skip: coarser ones see its maxima.
    let attention = attention(&mut g, fine);
    let coarser = g.layer("attention.pool", Op::MaxPool2, &[attention]);
    let fine = g.layer("enter.attended", Op::Multiply, &[fine, attention]);
    let middle = g.layer("middle.attended", Op::Multiply, &[middle, coarser]);

    let x = g.conv("up.middle", Conv2d::new(1, 4 * c), &[x]);
    let x = g.layer("up.middle.shuffle", Op::PixelShuffle { factor: 2 }, &[x, middle]);
    let x = g.conv("merge.middle", features(3), &[x, middle]);
    let x = g.conv("up.fine", Conv2d::new(1, 4 * c), &[x]);
    let x = g.layer("up.fine.shuffle", Op::PixelShuffle { factor: 2 }, &[x, fine]);
    let x = g.conv("merge.fine", features(merge), &[x, fine]);
    let hidden = g.gated_recurrent_unit("recurrent", 1, x, hidden);

    let refinement = g.conv("head.color", Conv2d::new(1, 3 * block), &[x, hidden]);
    let [colors, uncertainties] =
        [("rgb", 0, 3 * block), ("uncertainty", 3 * block, block)].map(|(part, first, count)| {
            [("before", before), ("after", after)].map(|(name, blocks)| {
                g.layer(&format!("{name}.{part}"), Op::Slice { first, count }, &[blocks])
            })
        });
    let detail = g.conv("detail", Conv2d { bias: false, ..Conv2d::new(1, 3 * block) }, &colors);
    let residual = g.layer("residual", Op::Add, &[refinement, detail]);
    // What decides between pixels of a block must not pass through the few channels of the features.
    let correction = Conv2d::new(1, block).activation(Activation::Tanh);
    let [of_before, of_after] = uncertainties;
    let correction = g.conv("head.alpha", correction, &[x, hidden, share, of_before, of_after]);
    let unsure = g.layer("uncertainties", Op::Add, &uncertainties);
    let correction = g.layer("correction", Op::Multiply, &[correction, unsure]);
    let alpha = g.layer("alpha.blocks", Op::Add, &[share, correction]);
    let every_alpha = g.layer("alpha.channels", Op::Concat, &[alpha; 4]);
    let blend = g.layer("blend", Op::Mix, &[before, after, every_alpha]);
    let image = add_residual(&mut g, blend, residual, None, block);
    let color = g.layer("image", Op::PixelShuffle { factor: scale }, &[image]);
    let correction = g.layer("alpha_correction", Op::PixelShuffle { factor: scale }, &[correction]);
    for (name, tensor) in [("color", color), ("alpha_correction", correction), ("hidden", hidden)] {
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
