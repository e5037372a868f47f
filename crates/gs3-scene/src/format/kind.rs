//! Formats, detected by content, or by name if a format has no signature.

use serde_json::Value;

use super::archive::Archive;
use super::error::LoadError;
use super::source::Source;
use super::{gltf, has_extension, lcc2, rad};

/// The detected formats.
pub(super) enum Kind<'a> {
    Ply,
    Spz,
    /// A bundle, or a `meta.json`.
    Sog,
    StreamedSog,
    Splat,
    Ksplat,
    Gltf,
    Rad,
    Lcc2(Value),
    /// An archive with one scene in it.
    Zip(Archive<'a>),
}

/// Files that people have and that hold no Gaussians in a way that is read: what they begin with, and what they are.
const OTHERS: [(&[u8], &str); 10] = [
    (b"LASF", "a point cloud (LAS or LAZ)"),
    (b"ASTM-E57", "a point cloud (E57)"),
    (b"# .PCD", "a point cloud (PCD)"),
    (b"PXR-USDC", "a scene of OpenUSD"),
    (b"#usda", "a scene of OpenUSD"),
    (b"Kaydara FBX", "a mesh (FBX)"),
    (b"# Blender", "a mesh (OBJ)"),
    (b"mtllib", "a mesh (OBJ)"),
    (b"solid ", "a mesh (STL)"),
    (b"RADC", "one chunk of a .rad scene; the scene's file begins with RAD0"),
];

impl<'a> Kind<'a> {
    pub(super) fn of(source: &'a Source<'a>) -> Result<Self, LoadError> {
        let head = source.head(16)?;
        let not_gaussians = |actual: &str| LoadError::NotGaussians {
            file: source.name().to_owned(),
            actual: actual.to_owned(),
        };
        if head.starts_with(b"ply") {
            Ok(Self::Ply)
        } else if head.starts_with(b"NGSP") {
            Ok(Self::Spz)
        } else if head.starts_with(b"PK\x03\x04") {
            let archive = Archive::open(source)?;
            Ok(if archive.is_bundle() { Self::Sog } else { Self::Zip(archive) })
        } else if head.starts_with(gltf::MAGIC) {
            Ok(Self::Gltf)
        } else if head.starts_with(rad::MAGIC) {
            Ok(Self::Rad)
        } else if has_extension(source.name(), "splat") {
            // Before signatures so short that coordinates may begin with them.
            Ok(Self::Splat)
        } else if has_extension(source.name(), "ksplat") {
            Ok(Self::Ksplat)
        } else if head.starts_with(&[0x1f, 0x8b]) {
            Ok(Self::Spz)
        } else if head.trim_ascii_start().starts_with(b"{") {
            Self::of_json(source)
        } else if let Some((_, what)) = OTHERS.iter().find(|(start, _)| head.starts_with(start)) {
            Err(not_gaussians(what))
        } else {
            let actual = head.iter().map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(" ");
            let actual =
                if actual.is_empty() { "an empty file".to_owned() } else { format!("bytes {actual}") };
            Err(LoadError::UnknownFormat { file: source.name().to_owned(), actual })
        }
    }

    fn of_json(source: &Source<'_>) -> Result<Self, LoadError> {
        let bytes = source.bytes()?;
        if gltf::is_gltf(&bytes) {
            return Ok(Self::Gltf);
        }
        let parsed = serde_json::from_slice::<Value>(&bytes)
            .or_else(|_| serde_json::from_slice(&lcc2::without_trailing_commas(&bytes)));
        let json = parsed.map_err(|error| {
            LoadError::invalid(source.name(), "JSON", "a description of a scene", error.to_string())
        })?;
        let has = |key: &str| json.get(key).is_some();
        if lcc2::is_index(&json) {
            Ok(Self::Lcc2(json))
        } else if has("tree") {
            Ok(Self::StreamedSog)
        } else if has("totalLevel") && has("attributes") {
            let actual = "an LCC scene of version 1, which is not read; LCC Studio exports PLY".to_owned();
            Err(LoadError::NotGaussians { file: source.name().to_owned(), actual })
        } else if has("frames") || has("camera_path") {
            let actual = "cameras, which --path takes".to_owned();
            Err(LoadError::NotGaussians { file: source.name().to_owned(), actual })
        } else {
            Ok(Self::Sog)
        }
    }
}
