//! What a comparison with photos found: `results.json`.

use serde::{Deserialize, Serialize};

use super::PhotoProtocol;
use super::approach::FASTEST;
use crate::methods::{MethodSpec, Spatial};
use crate::metrics::flip::DEFAULT_PIXELS_PER_DEGREE;
use crate::protocol::{Crop, Failure, MachineReport, PSNR_CAP, Subset};

/// Scores of one image, or their mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PhotoScore {
    /// PSNR in dB, capped at [`PSNR_CAP`].
    pub psnr: f64,
    /// SSIM, borders continued with zeros (Inria's convention).
    pub ssim: f64,
    /// Mean ꟻLIP.
    pub flip: f64,
}

/// One photo's scores.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PhotoImage {
    /// The photo's name in the capture.
    pub name: String,
    /// Width and height of what was compared.
    pub size: [usize; 2],
    /// Its scores on its own.
    #[serde(flatten)]
    pub score: PhotoScore,
    /// Its scores as the end of a short way to it; of methods without history the same.
    pub after_way: PhotoScore,
}

/// All scores of one method.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PhotoMethodScore {
    /// One per photo.
    pub images: Vec<PhotoImage>,
    /// Details of a few photos, by name.
    pub crops: Vec<(String, Crop)>,
}

/// One method's figures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PhotoRow {
    /// The method.
    pub method: String,
    /// All frames: photos have no others.
    pub subset: Subset,
    /// Means over the photos, each on its own.
    #[serde(flatten)]
    pub mean: PhotoScore,
    /// Means over the photos, each at the end of a short way to it.
    pub after_way: PhotoScore,
    /// How the LR frames came about; none for native rendering.
    pub lr_formation: Option<String>,
    /// Every photo.
    pub images: Vec<PhotoImage>,
}

/// The comparison's own facts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PhotoFacts {
    /// Name of the scene.
    pub scene: String,
    /// Number of its Gaussians.
    pub gaussians: usize,
    /// Where the cameras came from.
    pub capture: String,
    /// Number of photos of the capture.
    pub photos: usize,
    /// Number of photos judged.
    pub judged: usize,
    /// Names of photos of the capture that have no file.
    pub missing: Vec<String>,
    /// Every how manieth was judged.
    pub every: usize,
    /// HR over LR size.
    pub scale: u32,
    /// Background colour.
    pub background: [f32; 3],
    /// How figures are defined.
    pub conventions: Vec<String>,
    /// The machine.
    pub machine: MachineReport,
    /// Version of gs3.
    pub version: String,
    /// The command.
    pub command: String,
}

/// What a comparison with photos found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PhotoResults {
    /// The comparison's facts.
    pub protocol: PhotoFacts,
    /// One row per method.
    pub results: Vec<PhotoRow>,
    /// Methods that failed.
    pub failures: Vec<Failure>,
    /// Details by method and photo, for the page.
    #[serde(skip)]
    pub crops: Vec<(String, Vec<(String, Crop)>)>,
}

impl PhotoResults {
    pub(super) fn new(
        protocol: &PhotoProtocol,
        judged: usize,
        missing: Vec<String>,
        scores: Vec<(MethodSpec, PhotoMethodScore)>,
        failures: Vec<Failure>,
    ) -> Self {
        let (mut results, mut crops) = (Vec::new(), Vec::new());
        for (spec, score) in scores {
            results.push(row(spec, score.images));
            crops.push((spec.to_string(), score.crops));
        }
        Self { protocol: facts(protocol, judged, missing), results, failures, crops }
    }
}

fn row(spec: MethodSpec, images: Vec<PhotoImage>) -> PhotoRow {
    let mean = |score: fn(&PhotoImage) -> PhotoScore| {
        let mean = |value: fn(&PhotoScore) -> f64| {
            images.iter().map(|image| value(&score(image))).sum::<f64>() / images.len() as f64
        };
        PhotoScore { psnr: mean(|s| s.psnr), ssim: mean(|s| s.ssim), flip: mean(|s| s.flip) }
    };
    PhotoRow {
        method: spec.to_string(),
        subset: Subset::All,
        mean: mean(|image| image.score),
        after_way: mean(|image| image.after_way),
        lr_formation: (spec.spatial != Spatial::Native).then(|| spec.formation.name().to_owned()),
        images,
    }
}

fn facts(protocol: &PhotoProtocol, judged: usize, missing: Vec<String>) -> PhotoFacts {
    PhotoFacts {
        scene: protocol.scene_name.clone(),
        gaussians: protocol.scene.gaussians().len(),
        capture: protocol.capture_path.display().to_string(),
        photos: protocol.capture.cameras().len(),
        judged,
        missing,
        every: protocol.every.max(1),
        scale: protocol.scale,
        background: protocol.background,
        conventions: vec![
            "Ground truth: the photos, undistorted (captures that state lens distortion are refused), at the size of their \
             files and at 8 bits; a camera of another size with the same shape follows its photo. Transparent parts show the \
             background."
                .into(),
            format!(
                "Where low-resolution methods take part, all methods are judged without the last rows and columns that do not \
                 fill an LR pixel (up to {}).",
                protocol.scale - 1
            ),
            "Renders are rounded to 8 bits first.".into(),
            "On its own: every photo for itself, methods with history run without it.".into(),
            format!(
                "On the way: the photo is the last frame after {} others along the smooth curve from the nearest camera of the \
                 capture through the photo's, on which what is seen moves {FASTEST} pixels a frame at most. Methods without \
                 history show the same.",
                protocol.scale * protocol.scale
            ),
            format!("PSNR: one mean squared error over all RGB of an image, mean over images, capped at {PSNR_CAP} dB."),
            "SSIM: 11×11 Gaussian, σ = 1.5, biased, borders continued with zeros (Inria).".into(),
            format!("FLIP: LDR, {DEFAULT_PIXELS_PER_DEGREE:.2} pixels per degree, mean error."),
        ],
        machine: MachineReport::this(),
        version: env!("CARGO_PKG_VERSION").into(),
        command: protocol.command.clone(),
    }
}
