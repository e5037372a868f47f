//! `.rad` (Spark): chunks of Gaussians, each property a blob of its own encoding, whole or as a tree of levels of detail.
//!
//! Source: the encoder and decoder of Spark 2, version 1 of the format; it has no description of its own. Axes are those
//! of PLY. Of a tree its leaves are read, which are the whole scene.

mod decode;

use rayon::prelude::*;
use serde::Deserialize;

use super::error::LoadError;
use super::progress::{Progress, Work};
use super::source::{Files, Source, check_allowance, inside};
use super::{Decoded, memory};
use crate::gaussians::{SH_C0, Slots, sh_coefficient_count};
use crate::scene::OpacityMode;
use decode::Property;

/// The first bytes of a file, and of each chunk.
pub(super) const MAGIC: &[u8; 4] = b"RAD0";
const CHUNK_MAGIC: &[u8; 4] = b"RADC";

/// Bytes of JSON that are read at most.
const MOST_JSON: u64 = 64 << 20;

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
struct Meta {
    version: u32,
    #[serde(rename = "type")]
    kind: String,
    count: u64,
    #[serde(default)]
    max_sh: u8,
    #[serde(default)]
    lod_tree: bool,
    chunks: Vec<ChunkRange>,
    sh_code_count: Option<u64>,
}

#[derive(Debug, Deserialize)]
struct ChunkRange {
    /// From the end of the header on.
    offset: u64,
    bytes: u64,
    filename: Option<String>,
}

#[derive(Debug, Deserialize)]
struct ChunkMeta {
    version: u32,
    base: u64,
    count: u64,
    properties: Vec<Property>,
}

/// A chunk's description, and its properties' bytes.
struct Chunk {
    meta: ChunkMeta,
    payload: Vec<u8>,
}

/// Higher spherical harmonics that Gaussians share, `[codes, values]` for degrees 1 to 3.
type Codes = [Vec<f32>; 3];

pub(super) fn read(
    source: &Source<'_>,
    files: &dyn Files,
    progress: Progress<'_>,
) -> Result<Decoded, LoadError> {
    let name = source.name();
    let (meta, chunks_start): (Meta, u64) = json(source, 0, MAGIC, "header")?;
    let invalid =
        |field: &str, expected: &str, actual: String| LoadError::invalid(name, field, expected, actual);
    if meta.version != 1 {
        return Err(invalid("version", "1", meta.version.to_string()));
    }
    if meta.kind != "gsplat" {
        return Err(invalid("type", "\"gsplat\"", super::quoted(&meta.kind)));
    }
    if meta.max_sh > 3 {
        return Err(invalid("maxSh", "at most 3", meta.max_sh.to_string()));
    }
    let mut file_bytes = source.len();
    let mut chunks = Vec::with_capacity(meta.chunks.len());
    for (i, range) in meta.chunks.iter().enumerate() {
        let beside = match &range.filename {
            Some(file) => Some(files.open(&inside(name, &format!("chunks[{i}].filename"), "", file)?)?),
            None => None,
        };
        let chunk = match &beside {
            Some(file) => {
                file_bytes = file_bytes.saturating_add(file.len());
                Chunk::read(file, 0, file.len())?
            }
            None => Chunk::read(source, chunks_start.saturating_add(range.offset), range.bytes)?,
        };
        chunks.push(chunk);
    }
    let total: u64 = chunks.iter().fold(0, |sum, chunk| sum.saturating_add(chunk.meta.count));
    if total != meta.count {
        let expected = format!("{total}, as many as its chunks have");
        return Err(LoadError::invalid(name, "count", expected, meta.count.to_string()));
    }
    let floats = 11 + 3 * sh_coefficient_count(meta.max_sh) as u64;
    check_allowance(name, "count", file_bytes, total.checked_mul(floats * 4))?;
    let codes = match (meta.sh_code_count, chunks.first()) {
        (Some(count), Some(first)) => Some(first.codes(name, count, file_bytes)?),
        _ => None,
    };
    let work = Work::new(total, progress);
    let mut gaussians = memory::gaussians(name, total as usize, meta.max_sh)?;
    let mut is_leaf = vec![true; total as usize];
    let mut rest = (gaussians.slots(), &mut is_leaf[..]);
    let mut tasks = Vec::with_capacity(chunks.len());
    let mut base = 0;
    for chunk in &chunks {
        if chunk.meta.base != base {
            return Err(invalid("base of a chunk", &base.to_string(), chunk.meta.base.to_string()));
        }
        base += chunk.meta.count;
        let (slots, others) = rest.0.split_at(chunk.meta.count as usize);
        let (leaves, other_leaves) = rest.1.split_at_mut(chunk.meta.count as usize);
        rest = (others, other_leaves);
        tasks.push((chunk, slots, leaves));
    }
    tasks.into_par_iter().try_for_each(|(chunk, mut slots, leaves)| {
        chunk.decode(name, codes.as_ref(), &mut slots, leaves)?;
        work.add(leaves.len());
        Ok::<(), LoadError>(())
    })?;
    let mut notes = Vec::new();
    if meta.lod_tree {
        gaussians.retain(|_, i| is_leaf[i]);
        notes.push(
            "the file is a tree of levels of detail: its leaves, the finest level, are read".to_owned(),
        );
    }
    let above = gaussians.opacities.iter().filter(|opacity| **opacity > 1.0).count();
    if above > 0 {
        gaussians.opacities.iter_mut().for_each(|opacity| *opacity = opacity.min(1.0));
        notes.push(format!("{above} Gaussians have an opacity above 1, which is cut to 1"));
    }
    Ok(Decoded { notes, ..Decoded::new(gaussians, OpacityMode::Default) })
}

/// The JSON behind `magic` at `offset`, and where what follows it begins.
fn json<T: serde::de::DeserializeOwned>(
    source: &Source<'_>,
    offset: u64,
    magic: &[u8; 4],
    field: &str,
) -> Result<(T, u64), LoadError> {
    let mut head = [0; 8];
    source.read_at(offset, &mut head, field)?;
    let ([found @ .., _, _, _, _], length) = (head, u32::from_le_bytes([head[4], head[5], head[6], head[7]]));
    if found != *magic {
        let actual = format!("{found:02x?}");
        return Err(LoadError::invalid(source.name(), field, String::from_utf8_lossy(magic), actual));
    }
    let length = u64::from(length);
    if length > MOST_JSON {
        let (file, field) = (source.name().to_owned(), field.to_owned());
        return Err(LoadError::TooLarge { file, field, expected: MOST_JSON, actual: length });
    }
    source.check_extent(offset + 8, length, field)?;
    let mut text = vec![0; length as usize];
    source.read_at(offset + 8, &mut text, field)?;
    let value = serde_json::from_slice(&text)
        .map_err(|error| LoadError::invalid(source.name(), field, "the fields of RAD", error.to_string()))?;
    Ok((value, offset + 8 + length.next_multiple_of(8)))
}

impl Chunk {
    fn read(source: &Source<'_>, offset: u64, bytes: u64) -> Result<Self, LoadError> {
        source.check_extent(offset, bytes, "chunk")?;
        let (meta, start): (ChunkMeta, u64) = json(source, offset, CHUNK_MAGIC, "chunk")?;
        if meta.version != 1 {
            return Err(LoadError::invalid(
                source.name(),
                "version of a chunk",
                "1",
                meta.version.to_string(),
            ));
        }
        let mut length = [0; 8];
        source.read_at(start, &mut length, "payload size")?;
        let length = u64::from_le_bytes(length);
        source.check_extent(start + 8, length, "payload")?;
        let mut payload = vec![0; length as usize];
        source.read_at(start + 8, &mut payload, "payload")?;
        Ok(Self { meta, payload })
    }

    /// The values of property `name` of `count` elements of `dimensions`, element by element, where the chunk has it.
    fn values(
        &self,
        file: &str,
        name: &str,
        dimensions: usize,
        count: usize,
    ) -> Result<Option<Vec<f32>>, LoadError> {
        let property = self.meta.properties.iter().find(|property| property.property == name);
        property.map(|property| property.decode(file, &self.payload, dimensions, count)).transpose()
    }

    /// The harmonics that Gaussians share, which the first chunk has.
    fn codes(&self, file: &str, count: u64, file_bytes: u64) -> Result<Codes, LoadError> {
        let count = check_allowance(file, "shCodeCount", file_bytes, count.checked_mul(45 * 4))? / (45 * 4);
        let of = |degree: usize| {
            let values = self.values(file, &format!("sh{degree}_code"), 3 * (2 * degree + 1), count)?;
            Ok::<_, LoadError>(values.unwrap_or_default())
        };
        Ok([of(1)?, of(2)?, of(3)?])
    }

    fn decode(
        &self,
        file: &str,
        codes: Option<&Codes>,
        slots: &mut Slots<'_>,
        is_leaf: &mut [bool],
    ) -> Result<(), LoadError> {
        let count = slots.len();
        let required = |name: &str, dimensions: usize| {
            self.values(file, name, dimensions, count)?
                .ok_or_else(|| LoadError::invalid(file, name, "a property of this name", "none"))
        };
        for (i, values) in required("center", 3)?.as_chunks::<3>().0.iter().enumerate() {
            (0..3).for_each(|axis| slots.means[axis][i] = values[axis]);
        }
        for (i, values) in required("scales", 3)?.as_chunks::<3>().0.iter().enumerate() {
            (0..3).for_each(|axis| slots.scales[axis][i] = values[axis]);
        }
        // x, y, z, w.
        for (i, [x, y, z, w]) in required("orientation", 4)?.as_chunks::<4>().0.iter().enumerate() {
            [w, x, y, z].into_iter().enumerate().for_each(|(k, value)| slots.rotations[k][i] = *value);
        }
        slots.opacities.copy_from_slice(&required("alpha", 1)?);
        let stride = slots.sh_stride;
        for (i, values) in required("rgb", 3)?.as_chunks::<3>().0.iter().enumerate() {
            (0..3).for_each(|c| slots.sh[i * stride + c] = (values[c] - 0.5) / SH_C0);
        }
        let labels = match codes {
            Some(_) => self.values(file, "sh_label", 1, count)?,
            None => None,
        };
        for degree in 1..=3 {
            let (first, size) = (3 * degree * degree, 3 * (2 * degree + 1));
            if stride < first + size {
                break;
            }
            let own = self.values(file, &format!("sh{degree}"), size, count)?;
            for i in 0..count {
                let shared = codes.zip(labels.as_ref()).and_then(|(codes, labels)| {
                    let at = labels[i] as usize * size;
                    codes[degree - 1].get(at..at + size)
                });
                let of_gaussian = own.as_ref().map(|own| &own[i * size..(i + 1) * size]).or(shared);
                if let Some(values) = of_gaussian {
                    slots.sh[i * stride + first..i * stride + first + size].copy_from_slice(values);
                }
            }
        }
        if let Some(children) = self.values(file, "child_count", 1, count)? {
            is_leaf.iter_mut().zip(children).for_each(|(is_leaf, children)| *is_leaf = children == 0.0);
        }
        Ok(())
    }
}
