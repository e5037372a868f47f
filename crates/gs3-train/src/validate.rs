//! What a network gains over reconstruction without learning, on clips it was not trained on; a single-image network
//! over bicubic interpolation.

use gs3::reconstruct::{ResampleKernel, resample};
use gs3::scene::{GBuffer, Image, Planes};
use gs3_neural::{Engine, Graph, Named, Weights};

use crate::clip::{ClipFile, ClipFrame, ClipWindow, HIDDEN};
use crate::clips::analytic;
use crate::error::TrainError;
use crate::losses::CHANNELS;
use crate::psnr::{psnr, subtract};
use crate::settings::MARGIN;
use crate::trained_network::TrainedNetwork;
use crate::unroll::{decode, displaced};

/// Gains of a network in dB.
#[derive(Clone, Debug, PartialEq)]
pub struct Validation {
    /// Of each clip.
    pub clips: Vec<Gain>,
    /// Means over clips; none without clips.
    pub mean: Option<[f64; 2]>,
}

/// What a network gains on a clip.
#[derive(Clone, Debug, PartialEq)]
pub struct Gain {
    /// The clip's name.
    pub name: String,
    /// Mean PSNR of its frames less the PSNR of frames without learning, or of bicubic interpolation, in dB.
    pub psnr: f64,
    /// The same of tPSNR, of frame differences.
    pub tpsnr: f64,
    /// Mean PSNR without learning, in dB.
    pub analytic: f64,
}

/// Runs `graph`, the graph of `subject`, with `weights` through all of `clips`. Work is spread over the current rayon
/// thread pool; results do not depend on its size.
///
/// # Errors
/// [`TrainError`] if a clip cannot be read or does not fit the network.
pub fn validate(
    subject: TrainedNetwork,
    graph: &Graph,
    weights: &Weights,
    clips: &[ClipFile],
) -> Result<Validation, TrainError> {
    let gains = clips.iter().map(|clip| gain(subject, graph, weights, clip));
    let gains: Vec<Gain> = gains.collect::<Result<_, _>>()?;
    let mean = |value: fn(&Gain) -> f64| gains.iter().map(value).sum::<f64>() / gains.len() as f64;
    let mean = (!gains.is_empty()).then(|| [mean(|gain| gain.psnr), mean(|gain| gain.tpsnr)]);
    Ok(Validation { clips: gains, mean })
}

fn gain(
    subject: TrainedNetwork,
    graph: &Graph,
    weights: &Weights,
    file: &ClipFile,
) -> Result<Gain, TrainError> {
    let mut engine = Engine::new(graph, weights, file.lr())?;
    let mut hidden = vec![0.0; engine.shape(HIDDEN).map_or(0, |shape| shape.len())];
    let hr = file.lr().map(|side| side * file.scale() as usize);
    // An input is called so, too.
    let output = graph.outputs().iter().find(|output| output.name == "color");
    let channels = output.map_or(CHANNELS, |output| graph.channels(output.tensor));
    let mut color = vec![0.0; hr[0] * hr[1] * channels];
    // Images that lie beside the native one are moved to it, and lack what comes in there.
    let margin = match subject {
        TrainedNetwork::Own { .. } => 0,
        TrainedNetwork::Published(_) => MARGIN * file.scale() as usize,
    };
    let is_input = |name: &str| graph.inputs().any(|(_, layer)| layer.name == name);
    let mut next = hidden.clone();
    let mut inputs = Vec::new();
    // Errors of this frame and the last: of the network's images, and of those without learning.
    let mut errors: [[Vec<f32>; 2]; 2] = Default::default();
    let (mut sums, mut changes) = ([0.0; 2], [0.0; 2]);
    for k in 0..file.frames() {
        // Frame by frame: a clip of whole images need not fit into memory.
        let [rows, columns] = file.lr();
        let clip = file.read(&ClipWindow { frames: k..k + 1, rows: 0..rows, columns: 0..columns })?;
        let Some(frame) = clip.frames.first() else { continue };
        decode(frame, &mut inputs);
        let named = frame.inputs.iter().zip(&inputs);
        // Clips hold more than single-image networks read.
        let named = named.filter(|(plane, _)| is_input(&plane.name));
        let mut images: Vec<Named<'_>> = named.map(|(plane, v)| (&*plane.name, &**v)).collect();
        if is_input(HIDDEN) {
            images.push((HIDDEN, &hidden));
            engine.run(&images, &mut [("color", &mut color), (HIDDEN, &mut next)])?;
        } else {
            engine.run(&images, &mut [("color", &mut color)])?;
        }
        std::mem::swap(&mut hidden, &mut next);
        let shown = match subject {
            TrainedNetwork::Own { .. } => None,
            TrainedNetwork::Published(_) => {
                let by = subject.displacement(frame, file.scale() as usize);
                Some(displaced(&color, hr[1], by))
            }
        };
        let start = match subject {
            TrainedNetwork::Own { network, .. } => analytic(network, frame),
            TrainedNetwork::Published(_) => bicubic(frame, &inputs, file)?,
        };
        let start = start.as_flattened();
        let images = [(&shown.as_ref().unwrap_or(&color)[..], channels), (start, CHANNELS)];
        for (which, (image, channels)) in images.into_iter().enumerate() {
            let [last, now] = &mut errors[which];
            std::mem::swap(last, now);
            subtract(image, [hr[1], channels, margin], &frame.target, now);
            sums[which] += psnr(now.iter().copied());
            if k > 0 {
                changes[which] += psnr(now.iter().zip(last.iter()).map(|(now, last)| now - last));
            }
        }
    }
    let frames = file.frames() as f64;
    let name = file.path().file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let [psnr, tpsnr] = [(sums, frames), (changes, (frames - 1.0).max(1.0))].map(|(v, n)| (v[0] - v[1]) / n);
    Ok(Gain { name, psnr, tpsnr, analytic: sums[1] / frames })
}

/// What single-image networks are compared with: bicubic interpolation of the LR frame where it was sampled, HR, row by
/// row.
fn bicubic(frame: &ClipFrame, inputs: &[Vec<f32>], file: &ClipFile) -> Result<Vec<[f32; 4]>, TrainError> {
    let ([height, width], scale) = (file.lr(), file.scale());
    let input = |name: &str| {
        let place = frame.inputs.iter().position(|plane| plane.name == name);
        place.and_then(|k| inputs.get(k)).map_or(&[][..], |image| &image[..])
    };
    let mut lr = GBuffer {
        color: Planes::new(width, height),
        alpha: Planes::new(width, height),
        ..GBuffer::default()
    };
    if let [x, y, ..] = input("jitter") {
        lr.jitter = [*x, *y];
    }
    for (k, value) in lr.color.data_mut().iter_mut().enumerate() {
        *value = input("color").get(k % (width * height) * 3 + k / (width * height)).copied().unwrap_or(0.0);
    }
    let mut image = Image::new(width * scale as usize, height * scale as usize);
    resample(&lr, scale, ResampleKernel::Bicubic, &mut image)?;
    Ok(image.pixels().to_vec())
}
