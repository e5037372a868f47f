//! Writing a GLB.

use std::io::{self, Write};

use glam::DVec3;
use rayon::prelude::*;
use serde_json::{Value, json};

use super::super::rows::write_rows;
use super::{EXTENSION, MAGIC};
use crate::axes::Axes;
use crate::gaussians::Gaussians;
use crate::scene::Scene;
use crate::transform::sh_functions;

/// Signs of x, y and z from right-down-front to left-up-front, a half turn about z, …
const POSITION_SIGNS: [f32; 3] = [-1.0, -1.0, 1.0];

/// … and of the quaternions' w, x, y, z.
const ROTATION_SIGNS: [f32; 4] = [1.0, -1.0, -1.0, 1.0];

/// What an attribute has of a Gaussian.
#[derive(Clone, Copy)]
enum Part {
    Position,
    Rotation,
    Scale,
    Opacity,
    /// Coefficient and the sign that the half turn gives its function.
    Sh(usize, f32),
}

impl Part {
    const fn kind(self) -> (&'static str, usize) {
        match self {
            Self::Position | Self::Scale | Self::Sh(..) => ("VEC3", 3),
            Self::Rotation => ("VEC4", 4),
            Self::Opacity => ("SCALAR", 1),
        }
    }

    /// The values of Gaussian `i`; those beyond the kind's number are 0.
    fn values(self, g: &Gaussians, i: usize) -> [f32; 4] {
        let three = |[a, b, c]: [f32; 3]| [a, b, c, 0.0];
        match self {
            Self::Position => {
                let mean = g.mean(i);
                three(std::array::from_fn(|axis| mean[axis] * POSITION_SIGNS[axis]))
            }
            Self::Rotation => {
                let q = g.rotation(i);
                let [w, x, y, z] = std::array::from_fn(|k| q[k] * ROTATION_SIGNS[k]);
                [x, y, z, w]
            }
            Self::Scale => three(g.scale(i)),
            Self::Opacity => [g.opacities[i], 0.0, 0.0, 0.0],
            Self::Sh(k, sign) => {
                let sh = &g.sh_of(i)[3 * k..3 * k + 3];
                [sh[0] * sign, sh[1] * sign, sh[2] * sign, 0.0]
            }
        }
    }
}

/// The attributes by name.
fn attributes(sh_degree: u8) -> Vec<(String, Part)> {
    let named = |name: &str| format!("{EXTENSION}:{name}");
    let mut attributes = vec![
        ("POSITION".to_owned(), Part::Position),
        (named("ROTATION"), Part::Rotation),
        (named("SCALE"), Part::Scale),
        (named("OPACITY"), Part::Opacity),
    ];
    // A direction in which no function is 0: turned, each is the same or its negative.
    let d = DVec3::new(0.36, 0.48, 0.8);
    let (here, turned) = (sh_functions(d), sh_functions(DVec3::new(-d.x, -d.y, d.z)));
    for degree in 0..=usize::from(sh_degree) {
        for k in 0..=2 * degree {
            let coefficient = degree * degree + k;
            let sign = (here[coefficient] * turned[coefficient]).signum() as f32;
            attributes.push((named(&format!("SH_DEGREE_{degree}_COEF_{k}")), Part::Sh(coefficient, sign)));
        }
    }
    attributes
}

/// Whether a file of `scene` stays within the 4 GiB that the format's lengths can state.
pub(in super::super) fn fits(scene: &Scene) -> bool {
    let g = scene.gaussians();
    let bytes = (g.len() as u64).saturating_mul((11 + g.sh_stride() as u64) * 4);
    // And a little for the JSON.
    bytes.saturating_add(1 << 20) < u64::from(u32::MAX)
}

/// Writes `scene`, which [`fits`]: all values as f32, in left-up-front; its origin is the translation of its node.
pub(in super::super) fn write(scene: &Scene, writer: &mut impl Write) -> io::Result<()> {
    let gaussians = scene.gaussians();
    let attributes = attributes(gaussians.sh_degree);
    let count = gaussians.len();
    let length: usize = attributes.iter().map(|(_, part)| part.kind().1 * 4 * count).sum();
    let mut json = serde_json::to_vec(&document(scene, &attributes, length))?;
    json.resize(json.len().next_multiple_of(4), b' ');
    let total = 12 + 8 + json.len() + 8 + length;
    let word = |value: usize| u32::try_from(value).map(u32::to_le_bytes).map_err(io::Error::other);
    writer.write_all(MAGIC)?;
    writer.write_all(&word(2)?)?;
    writer.write_all(&word(total)?)?;
    writer.write_all(&word(json.len())?)?;
    writer.write_all(b"JSON")?;
    writer.write_all(&json)?;
    writer.write_all(&word(length)?)?;
    writer.write_all(b"BIN\0")?;
    for (_, part) in attributes {
        let size = part.kind().1;
        write_rows(writer, count, size * 4, |i, row| {
            for (bytes, value) in row.as_chunks_mut::<4>().0.iter_mut().zip(part.values(gaussians, i)) {
                *bytes = value.to_le_bytes();
            }
        })?;
    }
    Ok(())
}

fn document(scene: &Scene, attributes: &[(String, Part)], length: usize) -> Value {
    let gaussians = scene.gaussians();
    let count = gaussians.len();
    let mut offset = 0;
    let (mut views, mut accessors) = (Vec::new(), Vec::new());
    let mut names = serde_json::Map::new();
    for (i, (name, part)) in attributes.iter().enumerate() {
        let (kind, size) = part.kind();
        let bytes = size * 4 * count;
        views.push(json!({ "buffer": 0, "byteOffset": offset, "byteLength": bytes }));
        let mut accessor = json!({ "bufferView": i, "componentType": 5126, "count": count, "type": kind });
        if i == 0 {
            let bound = |pick: fn(f32, f32) -> f32| {
                let of = |axis: usize| {
                    let values = gaussians.means[axis].par_iter().map(|value| value * POSITION_SIGNS[axis]);
                    values.reduce_with(pick).unwrap_or_default()
                };
                [of(0), of(1), of(2)]
            };
            accessor["min"] = json!(bound(f32::min));
            accessor["max"] = json!(bound(f32::max));
        }
        accessors.push(accessor);
        names.insert(name.clone(), json!(i));
        offset += bytes;
    }
    let mut node = json!({ "mesh": 0 });
    let origin = Axes::LUF.to_rdf().transpose() * scene.details().origin;
    if origin != DVec3::ZERO {
        node["translation"] = json!(origin.to_array());
    }
    json!({
        "asset": { "version": "2.0", "generator": concat!("gs3 ", env!("CARGO_PKG_VERSION")) },
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [node],
        "meshes": [{ "primitives": [{
            "mode": 0,
            "attributes": names,
            "extensions": { EXTENSION: {
                "kernel": "ellipse", "colorSpace": "srgb_rec709_display",
                "projection": "perspective", "sortingMethod": "cameraDistance",
            } },
        }] }],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{ "byteLength": length }],
    })
}
