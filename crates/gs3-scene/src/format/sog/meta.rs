//! `meta.json` and `lod-meta.json`.

use std::collections::BTreeMap;

use serde::de::{DeserializeOwned, IgnoredAny};
use serde::{Deserialize, Deserializer};

use super::super::error::{LoadError, quoted};
use super::super::source::Source;
use super::super::unused_note;
use super::version_1::MetaV1;
use crate::scene::OpacityMode;

/// `meta.json`, version 2; [`MetaV1`] becomes one, too.
#[derive(Debug, Deserialize)]
pub(super) struct Meta {
    pub(super) count: u64,
    /// How programs of before August 2026 say what `model` says.
    #[serde(default)]
    pub(super) antialias: bool,
    /// What projects the Gaussians: `default`, `antialiased` or `2dgs`.
    pub(super) model: Option<String>,
    pub(super) means: Means,
    pub(super) scales: Coded,
    pub(super) quats: Quats,
    pub(super) sh0: Coded,
    #[serde(skip)]
    pub(super) opacities: Opacities,
    #[serde(rename = "shN")]
    pub(super) sh_rest: Option<ShRest>,
    /// Fields that are not read.
    #[serde(flatten, deserialize_with = "keys")]
    pub(super) unused: Vec<String>,
}

/// Fields that say nothing about the picture.
const HARMLESS: [&str; 2] = ["version", "asset"];

fn keys<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<String>, D::Error> {
    let fields = BTreeMap::<String, IgnoredAny>::deserialize(deserializer)?;
    Ok(fields.into_keys().filter(|key| !HARMLESS.contains(&key.as_str())).collect())
}

/// Opacities of the 256 bytes.
#[derive(Debug)]
pub(super) struct Opacities(pub(super) [f32; 256]);

impl Default for Opacities {
    /// The opacities of version 2: code / 255.
    fn default() -> Self {
        Self(std::array::from_fn(|code| code as f32 / 255.0))
    }
}

/// Log-space bounds of the means, and the images of their low and high bytes.
#[derive(Debug, Deserialize)]
pub(super) struct Means {
    pub(super) mins: [f64; 3],
    pub(super) maxs: [f64; 3],
    pub(super) files: [String; 2],
}

/// An image with bytes that index one codebook for each of three channels.
#[derive(Debug, Deserialize)]
#[serde(from = "CodedAlike")]
pub(super) struct Coded {
    pub(super) codebooks: [Codebook; 3],
    pub(super) files: [String; 1],
}

/// An image with channels that share a codebook, as in version 2.
#[derive(Debug, Deserialize)]
struct CodedAlike {
    codebook: Codebook,
    files: [String; 1],
}

impl From<CodedAlike> for Coded {
    fn from(CodedAlike { codebook, files }: CodedAlike) -> Self {
        Self { codebooks: [codebook.clone(), codebook.clone(), codebook], files }
    }
}

#[derive(Debug, Deserialize)]
pub(super) struct Quats {
    pub(super) files: [String; 1],
}

/// The higher spherical harmonics: images of a palette's rows and of each Gaussian's row number.
#[derive(Debug, Deserialize)]
pub(super) struct ShRest {
    /// Rows of the palette; where it is not stated, as many as its image has.
    pub(super) count: Option<u32>,
    pub(super) bands: u8,
    pub(super) codebook: Codebook,
    pub(super) files: [String; 2],
}

/// Values of the 256 bytes. A byte without a value decodes to NaN, so that its Gaussian is dropped and counted.
#[derive(Clone, Debug, Deserialize)]
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
    /// What contains the Gaussians with their extents, in the file's axes.
    pub(super) bound: Option<Bound>,
    /// For each level, how much it differs from the leaf's finest one: 0 is not at all. Only with `lodErrors`.
    #[serde(default)]
    pub(super) errors: Vec<Option<f64>>,
}

/// A box along the axes, world units.
#[derive(Clone, Copy, Debug, Deserialize)]
pub(super) struct Bound {
    pub(super) min: [f64; 3],
    pub(super) max: [f64; 3],
}

/// Gaussians `offset` to `offset + count` of chunk `file`.
#[derive(Clone, Copy, Debug, Deserialize)]
pub(super) struct Run {
    pub(super) file: usize,
    pub(super) offset: usize,
    pub(super) count: usize,
}

#[derive(Deserialize)]
struct Version {
    version: Option<u64>,
}

impl Meta {
    /// The mode that the Gaussians were trained in, and what of the file is not used.
    pub(super) fn mode(&self) -> (OpacityMode, Vec<String>) {
        let mut notes: Vec<String> = unused_note("fields", &self.unused).into_iter().collect();
        let mode = match self.model.as_deref() {
            Some("antialiased") => OpacityMode::Antialiased,
            None if self.antialias => OpacityMode::Antialiased,
            None | Some("default") => OpacityMode::Default,
            Some(other) => {
                notes.push(format!(
                    "model {} is not known and not used: the scene is shown in default mode",
                    quoted(other)
                ));
                OpacityMode::Default
            }
        };
        (mode, notes)
    }

    pub(super) fn parse(source: &Source<'_>) -> Result<Self, LoadError> {
        match parse::<Version>(source)?.version {
            Some(2) => parse(source),
            Some(1) | None => Ok(parse::<MetaV1>(source)?.into_meta()),
            Some(other) => Err(LoadError::invalid(source.name(), "version", "1 or 2", other.to_string())),
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
