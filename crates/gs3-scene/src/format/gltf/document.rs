//! The JSON of a glTF file, as far as it concerns Gaussians, and where its buffers are.

use std::collections::BTreeMap;

use percent_encoding::percent_decode_str;
use serde::Deserialize;
use serde::de::IgnoredAny;
use serde_json::Value;

use super::super::error::LoadError;
use super::super::source::{Files, Source, inside};
use super::{EXTENSION, MAGIC};

/// Bytes of JSON that are read at most.
const MOST_JSON: u64 = 64 << 20;

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct Document {
    pub(super) scene: Option<usize>,
    pub(super) scenes: Vec<SceneNodes>,
    pub(super) nodes: Vec<Node>,
    pub(super) meshes: Vec<Mesh>,
    pub(super) accessors: Vec<Accessor>,
    pub(super) buffer_views: Vec<BufferView>,
    buffers: Vec<BufferFile>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct SceneNodes {
    pub(super) nodes: Vec<usize>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Node {
    pub(super) children: Vec<usize>,
    pub(super) mesh: Option<usize>,
    pub(super) matrix: Option<[f64; 16]>,
    pub(super) translation: Option<[f64; 3]>,
    pub(super) rotation: Option<[f64; 4]>,
    pub(super) scale: Option<[f64; 3]>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Mesh {
    pub(super) primitives: Vec<Primitive>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Primitive {
    pub(super) attributes: BTreeMap<String, usize>,
    pub(super) extensions: BTreeMap<String, Value>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Accessor {
    pub(super) buffer_view: Option<usize>,
    #[serde(default)]
    pub(super) byte_offset: u64,
    pub(super) component_type: u32,
    #[serde(default)]
    pub(super) normalized: bool,
    pub(super) count: u64,
    #[serde(rename = "type")]
    pub(super) kind: String,
    pub(super) sparse: Option<IgnoredAny>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct BufferView {
    pub(super) buffer: usize,
    #[serde(default)]
    pub(super) byte_offset: u64,
    pub(super) byte_length: u64,
    pub(super) byte_stride: Option<u64>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct BufferFile {
    uri: Option<String>,
}

/// A buffer: bytes of a source from an offset on.
pub(super) struct Buffer<'a> {
    pub(super) source: Part<'a>,
    pub(super) start: u64,
    pub(super) length: u64,
}

/// The file itself or one beside it.
pub(super) enum Part<'a> {
    Own(&'a Source<'a>),
    Beside(Source<'a>),
}

impl<'a> Part<'a> {
    pub(super) const fn source(&self) -> &Source<'a> {
        match self {
            Self::Own(source) => source,
            Self::Beside(source) => source,
        }
    }
}

#[derive(Deserialize)]
struct Kind {
    asset: Option<Asset>,
}

#[derive(Deserialize)]
struct Asset {
    version: Option<Value>,
}

/// Whether the JSON text is a glTF document. Only glTF has an asset with a version.
pub(in super::super) fn is_gltf(json: &[u8]) -> bool {
    serde_json::from_slice::<Kind>(json)
        .is_ok_and(|kind| kind.asset.is_some_and(|a| a.version.is_some_and(|v| v.is_string())))
}

/// The document in `source` and its buffers.
pub(super) fn open<'a>(
    source: &'a Source<'a>,
    files: &'a dyn Files,
) -> Result<(Document, Vec<Buffer<'a>>), LoadError> {
    let (json, own) =
        if source.head(4)?.starts_with(MAGIC) { chunks(source)? } else { (text(source)?, None) };
    let document: Document = serde_json::from_slice(&json).map_err(|error| {
        LoadError::invalid(source.name(), "JSON", "the fields of glTF 2.0", error.to_string())
    })?;
    let mut buffers = Vec::with_capacity(document.buffers.len());
    for (i, buffer) in document.buffers.iter().enumerate() {
        let field = format!("buffers[{i}].uri");
        buffers.push(match (&buffer.uri, own) {
            (Some(uri), _) if uri.starts_with("data:") => {
                let expected = "a file beside this one, or none in a GLB";
                return Err(LoadError::invalid(source.name(), field, expected, "data within the JSON"));
            }
            (Some(uri), _) => {
                let name = percent_decode_str(uri).decode_utf8_lossy();
                let part = files.open(&inside(source.name(), &field, "", &name)?)?;
                Buffer { start: 0, length: part.len(), source: Part::Beside(part) }
            }
            (None, Some((start, length))) if i == 0 => Buffer { source: Part::Own(source), start, length },
            (None, _) => {
                return Err(LoadError::invalid(source.name(), field, "the name of a file", "none"));
            }
        });
    }
    Ok((document, buffers))
}

fn text(source: &Source<'_>) -> Result<Vec<u8>, LoadError> {
    check_json_size(source, source.len())?;
    Ok(source.bytes()?.into_owned())
}

fn check_json_size(source: &Source<'_>, actual: u64) -> Result<(), LoadError> {
    if actual > MOST_JSON {
        let (file, field) = (source.name().to_owned(), "JSON".to_owned());
        return Err(LoadError::TooLarge { file, field, expected: MOST_JSON, actual });
    }
    Ok(())
}

/// The JSON of a binary file, and where the bytes of its first buffer are.
type Chunks = (Vec<u8>, Option<(u64, u64)>);

fn chunks(source: &Source<'_>) -> Result<Chunks, LoadError> {
    let word = |at: u64, field: &str| -> Result<u32, LoadError> {
        let mut bytes = [0; 4];
        source.read_at(at, &mut bytes, field)?;
        Ok(u32::from_le_bytes(bytes))
    };
    let version = word(4, "version")?;
    if version != 2 {
        return Err(LoadError::invalid(source.name(), "version", "2", version.to_string()));
    }
    let json_length = u64::from(word(12, "length of the JSON chunk")?);
    let kind = word(16, "type of the first chunk")?.to_le_bytes();
    if kind != *b"JSON" {
        let actual = format!("{kind:02x?}");
        return Err(LoadError::invalid(source.name(), "type of the first chunk", "JSON", actual));
    }
    check_json_size(source, json_length)?;
    source.check_extent(20, json_length, "JSON chunk")?;
    let mut json = vec![0; json_length as usize];
    source.read_at(20, &mut json, "JSON chunk")?;
    let next = 20 + json_length;
    if source.len() < next + 8 {
        return Ok((json, None));
    }
    let length = u64::from(word(next, "length of the second chunk")?);
    let is_binary = word(next + 4, "type of the second chunk")?.to_le_bytes() == *b"BIN\0";
    if is_binary {
        source.check_extent(next + 8, length, "BIN chunk")?;
    }
    Ok((json, is_binary.then_some((next + 8, length))))
}

impl Primitive {
    /// What the extension says of this primitive, where it has it.
    pub(super) fn splatting(&self) -> Option<&Value> {
        self.extensions.get(EXTENSION)
    }

    /// The buffer view with the primitive's Gaussians as SPZ, by any of the drafts' names, and whether the extension of
    /// Khronos is around it.
    pub(super) fn compressed(&self) -> Option<(u64, bool)> {
        let view = |value: Option<&Value>| value?.get("bufferView")?.as_u64();
        let names = ["KHR_gaussian_splatting_compression_spz_2", "KHR_gaussian_splatting_compression_spz"];
        let within = self.splatting().and_then(|splatting| splatting.get("extensions"));
        let is_stated = self.splatting().is_some_and(|splatting| splatting.get("kernel").is_some());
        let inner = within.and_then(|within| names.iter().find_map(|name| view(within.get(*name))));
        let outer = || {
            let mut outer = names.iter().copied().chain(["KHR_spz_gaussian_splats_compression"]);
            outer.find_map(|name| view(self.extensions.get(name)))
        };
        inner.or_else(outer).map(|view| (view, is_stated))
    }
}
