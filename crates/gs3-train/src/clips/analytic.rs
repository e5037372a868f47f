//! What the pipeline without networks makes of a clip: where their training starts.

use half::f16;

use crate::clip::{Clip, ClipFrame, Network};
use crate::losses::CHANNELS;
use crate::psnr::{psnr, subtract};

/// The frame without networks: HR RGB and uncertainty, row by row. Empty if `frame` is none of a clip for `network`.
#[must_use]
pub fn analytic(network: Network, frame: &ClipFrame) -> Vec<[f32; 4]> {
    let pixels = |name: &str| {
        let values = plane(frame, name).as_chunks::<4>().0.iter();
        values.map(|pixel| pixel.map(f16::to_f32))
    };
    match network {
        Network::SuperSample => pixels("history").collect(),
        Network::Interpolate => pixels("before")
            .zip(pixels("after"))
            .zip(plane(frame, "share"))
            .map(|((before, after), share)| {
                std::array::from_fn(|c| before[c] + (after[c] - before[c]) * share.to_f32())
            })
            .collect(),
    }
}

/// PSNR of the frames without networks against native ones, in dB: the mean over frames.
#[must_use]
pub fn analytic_psnr(clip: &Clip) -> f64 {
    // At least 1: a clip that was not checked may have no columns.
    let width = (clip.lr[1] * clip.scale as usize).max(1);
    let mut errors = Vec::new();
    let frame_psnr = |frame: &ClipFrame| {
        let made = analytic(clip.network, frame);
        subtract(made.as_flattened(), [width, CHANNELS, 0], &frame.target, &mut errors);
        psnr(errors.iter().copied())
    };
    clip.frames.iter().map(frame_psnr).sum::<f64>() / clip.frames.len().max(1) as f64
}

pub(super) fn plane<'a>(frame: &'a ClipFrame, name: &str) -> &'a [f16] {
    frame.inputs.iter().find(|plane| plane.name == name).map_or(&[], |plane| &plane.values)
}
