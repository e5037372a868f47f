//! What the pipeline without networks makes of a clip: where their training starts.

use half::f16;

use crate::clip::{Clip, Frame, Network, from_unorm};

/// The frame without networks: HR RGB and uncertainty, row by row. Empty if `frame` is none of a clip for `network`.
#[must_use]
pub fn analytic(network: Network, frame: &Frame) -> Vec<[f32; 4]> {
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
    let psnr = |frame: &Frame| {
        let native = frame.target.as_chunks::<3>().0;
        let made = analytic(clip.network, frame);
        let error = |(pixel, native): (&[f32; 4], &[u16; 3])| -> f64 {
            (0..3).map(|c| f64::from(pixel[c].clamp(0.0, 1.0) - from_unorm(native[c])).powi(2)).sum()
        };
        let sum: f64 = made.iter().zip(native).map(error).sum();
        // No better than what 16 bits hold, as for windows that show nothing.
        let mean = (sum / (3 * native.len().max(1)) as f64).max(1e-10);
        -10.0 * mean.log10()
    };
    clip.frames.iter().map(psnr).sum::<f64>() / clip.frames.len().max(1) as f64
}

pub(super) fn plane<'a>(frame: &'a Frame, name: &str) -> &'a [f16] {
    frame.inputs.iter().find(|plane| plane.name == name).map_or(&[], |plane| &plane.values)
}
