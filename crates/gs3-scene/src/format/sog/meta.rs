//! `meta.json` and `lod-meta.json`.

use std::collections::BTreeMap;

use serde::Deserialize;
use serde::de::{DeserializeOwned, IgnoredAny};

use super::super::error::LoadError;
use super::super::source::Source;

/// `meta.json`, version 2.
#[derive(Debug, Deserialize)]
pub(super) struct Meta {
    pub(super) count: u64,
    #[serde(default)]
    pub(super) antialias: bool,
    pub(super) means: Means,
    pub(super) scales: Coded,
    pub(super) quats: Quats,
    pub(super) sh0: Coded,
    #[serde(rename = "shN")]
    pub(super) sh_rest: Option<ShRest>,
}

/// Log-space bounds of the means, and the images of their low and high bytes.
#[derive(Debug, Deserialize)]
pub(super) struct Means {
    pub(super) mins: [f64; 3],
    pub(super) maxs: [f64; 3],
    pub(super) files: [String; 2],
}

/// An image whose bytes index a codebook.
#[derive(Debug, Deserialize)]
pub(super) struct Coded {
    pub(super) codebook: Codebook,
    pub(super) files: [String; 1],
}

#[derive(Debug, Deserialize)]
pub(super) struct Quats {
    pub(super) files: [String; 1],
}

/// The higher spherical harmonics: images of a palette's rows and of each Gaussian's row number.
#[derive(Debug, Deserialize)]
pub(super) struct ShRest {
    pub(super) count: u32,
    pub(super) bands: u8,
    pub(super) codebook: Codebook,
    pub(super) files: [String; 2],
}

/// Values of the 256 bytes. A byte without a value decodes to NaN, so that its Gaussian is dropped and counted.
#[derive(Debug, Deserialize)]
#[serde(from = "Vec<Option<f32>>")]
pub(super) struct Codebook(pub(super) [f32; 256]);

impl From<Vec<Option<f32>>> for Codebook {
    fn from(values: Vec<Option<f32>>) -> Self {
        let mut table = [f32::NAN; 256];
        for (slot, value) in table.iter_mut().zip(values) {
            *slot = value.unwrap_or(f32::NAN);
        }
        // Early writers gave `null` for the first and evenly spaced values otherwise; readers extrapolate.
        if table[0].is_nan() {
            table[0] = table[1] + (table[1] - table[255]) / 255.0;
        }
        Self(table)
    }
}

/// `lod-meta.json`, version 1 or from before versions.
#[derive(Debug, Deserialize)]
pub(super) struct LodMeta {
    #[serde(default)]
    pub(super) version: Option<u32>,
    #[serde(rename = "lodLevels")]
    pub(super) level_count: u32,
    pub(super) environment: Option<String>,
    pub(super) filenames: Vec<String>,
    pub(super) tree: Node,
}

/// A node of the tree: an inner one has children, a leaf one range of Gaussians per level of detail.
#[derive(Debug, Deserialize)]
pub(super) struct Node {
    #[serde(default)]
    pub(super) children: Vec<Self>,
    #[serde(default)]
    pub(super) lods: BTreeMap<u32, Run>,
}

/// Gaussians `offset` to `offset + count` of chunk `file`.
#[derive(Clone, Copy, Debug, Deserialize)]
pub(super) struct Run {
    pub(super) file: usize,
    pub(super) offset: usize,
    pub(super) count: usize,
}

#[derive(Deserialize)]
struct Kind {
    tree: Option<IgnoredAny>,
}

#[derive(Deserialize)]
struct Version {
    version: Option<u64>,
}

/// Whether the JSON text is a `lod-meta.json`.
pub(in super::super) fn is_streamed(source: &Source<'_>) -> Result<bool, LoadError> {
    Ok(parse::<Kind>(source)?.tree.is_some())
}

impl Meta {
    pub(super) fn parse(source: &Source<'_>) -> Result<Self, LoadError> {
        match parse::<Version>(source)?.version {
            Some(2) => parse(source),
            Some(other) => Err(LoadError::invalid(source.name(), "version", "2", other.to_string())),
            None => {
                let actual = "none (version 1, or not SOG at all)";
                Err(LoadError::invalid(source.name(), "version", "2", actual))
            }
        }
    }
}

impl LodMeta {
    pub(super) fn parse(source: &Source<'_>) -> Result<Self, LoadError> {
        let meta: Self = parse(source)?;
        match meta.version {
            None | Some(1) => Ok(meta),
            Some(other) => Err(LoadError::invalid(source.name(), "version", "1", other.to_string())),
        }
    }
}

fn parse<T: DeserializeOwned>(source: &Source<'_>) -> Result<T, LoadError> {
    serde_json::from_slice(&source.bytes()?).map_err(|error| {
        LoadError::invalid(source.name(), "JSON", "the fields of the SOG specification", error.to_string())
    })
}
