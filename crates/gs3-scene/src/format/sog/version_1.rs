//! `meta.json` of version 1, from before the format had a version: bounds where version 2 has codebooks.

use serde::Deserialize;

use super::meta::{Codebook, Coded, Means, Meta, Opacities, Quats, ShRest};

/// Files that state no version.
#[derive(Debug, Deserialize)]
pub(super) struct MetaV1 {
    means: MeansV1,
    scales: Bounded3,
    quats: Quats,
    sh0: Bounded4,
    #[serde(rename = "shN")]
    sh_rest: Option<ShRestV1>,
}

#[derive(Debug, Deserialize)]
struct MeansV1 {
    /// Number of Gaussians, and 3.
    shape: [u64; 2],
    mins: [f64; 3],
    maxs: [f64; 3],
    files: [String; 2],
}

#[derive(Debug, Deserialize)]
struct Bounded3 {
    mins: [f32; 3],
    maxs: [f32; 3],
    files: [String; 1],
}

/// Colours, and the logit of the opacity.
#[derive(Debug, Deserialize)]
struct Bounded4 {
    mins: [f32; 4],
    maxs: [f32; 4],
    files: [String; 1],
}

#[derive(Debug, Deserialize)]
struct ShRestV1 {
    /// Number of Gaussians, and of their values.
    shape: [u64; 2],
    mins: f32,
    maxs: f32,
    files: [String; 2],
}

/// The values of the 256 bytes between two bounds.
fn evenly(min: f32, max: f32) -> Codebook {
    Codebook(std::array::from_fn(|code| min + (max - min) * (code as f32 / 255.0)))
}

impl MetaV1 {
    /// The same in the terms of version 2. The palette's size is not stated: `rows` of them, of the given number of
    /// values, fit its image. Values other than 9, 24 or 45 give no harmonics of higher degree.
    pub(super) fn into_meta(self) -> Meta {
        let Self { means, scales, quats, sh0, sh_rest } = self;
        let axes = |b: &Bounded3| [0, 1, 2].map(|k| evenly(b.mins[k], b.maxs[k]));
        let opacity = evenly(sh0.mins[3], sh0.maxs[3]).0.map(|logit| 1.0 / (1.0 + (-logit).exp()));
        let sh_rest = sh_rest.and_then(|rest| {
            let bands = (1..=3u8).find(|degree| rest.shape[1] == u64::from(degree * (degree + 2)) * 3)?;
            let codebook = evenly(rest.mins, rest.maxs);
            Some(ShRest { count: None, bands, codebook, files: rest.files })
        });
        Meta {
            count: means.shape[0],
            antialias: false,
            model: None,
            means: Means { mins: means.mins, maxs: means.maxs, files: means.files },
            scales: Coded { codebooks: axes(&scales), files: scales.files },
            quats,
            sh0: Coded { codebooks: [0, 1, 2].map(|k| evenly(sh0.mins[k], sh0.maxs[k])), files: sh0.files },
            opacities: Opacities(opacity),
            sh_rest,
            unused: Vec::new(),
        }
    }
}
