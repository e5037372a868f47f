//! Reading.

use glam::{DAffine3, DMat3, DQuat, DVec3};
use rayon::prelude::*;

use super::super::error::{LoadError, quoted};
use super::super::progress::{Progress, Work};
use super::super::source::{Files, Source, check_allowance};
use super::super::{BLOCK, Decoded, memory, origin, spz, unused_note};
use super::EXTENSION;
use super::document::{Buffer, Document, Node, Primitive, open};
use super::values::Values;
use crate::axes::Axes;
use crate::gaussians::{Gaussians, MAX_SH_DEGREE, Slots, sh_coefficient_count};
use crate::scene::{AxesKnownBy, FileAxes, OpacityMode};
use crate::transform::{Similarity, transform};

/// How far from equal the three scales of a node, and from a rotation the rest of it, may be: rounding of f32.
const SKEW: f64 = 1e-4;

/// Nodes above one another that are followed.
const DEEPEST: usize = 256;

/// Reads all primitives of Gaussians of the document's scene.
pub(in super::super) fn read(
    source: &Source<'_>,
    files: &dyn Files,
    progress: Progress<'_>,
) -> Result<Decoded, LoadError> {
    let (document, buffers) = open(source, files)?;
    let reader = Reader { file: source.name(), document: &document, buffers: &buffers };
    let placed = reader.placed()?;
    if placed.is_empty() {
        let primitives: usize = document.meshes.iter().map(|mesh| mesh.primitives.len()).sum();
        let actual = format!("a glTF scene of {primitives} primitives, none with {EXTENSION}: a mesh");
        return Err(LoadError::NotGaussians { file: source.name().to_owned(), actual });
    }
    let mut notes = Vec::new();
    let mut mode = OpacityMode::Default;
    let shifts = [0, 1, 2].map(|axis| placed.iter().map(|(_, place)| place.shift[axis]).collect());
    let origin = origin::of(shifts);
    let counts: u64 = placed.iter().map(|(primitive, _)| reader.count(primitive)).sum();
    let work = Work::new(counts, progress);
    let mut all: Option<Gaussians> = None;
    for (primitive, place) in placed {
        let (mut gaussians, of_primitive) = reader.decode(primitive, &work, &mut notes)?;
        if of_primitive == OpacityMode::Antialiased {
            mode = of_primitive;
        }
        transform(&mut gaussians, &Similarity { shift: place.shift - origin, ..place });
        match &mut all {
            None => all = Some(gaussians),
            Some(all) => all.append(&gaussians),
        }
    }
    notes.dedup();
    let axes = FileAxes { axes: Axes::LUF, known_by: AxesKnownBy::Format };
    Ok(Decoded { axes, origin, notes, ..Decoded::new(all.unwrap_or_default(), mode) })
}

struct Reader<'a> {
    file: &'a str,
    document: &'a Document,
    buffers: &'a [Buffer<'a>],
}

/// A primitive of Gaussians, and where it is.
type Placed<'a> = (&'a Primitive, Similarity);

impl<'a> Reader<'a> {
    fn invalid(&self, field: impl Into<String>, expected: &str, actual: impl Into<String>) -> LoadError {
        LoadError::invalid(self.file, field, expected, actual)
    }

    /// The primitives of Gaussians under the roots of the scene, or of all scenes where the document has none.
    fn placed(&self) -> Result<Vec<Placed<'a>>, LoadError> {
        let Document { scene, scenes, nodes, meshes, .. } = self.document;
        let roots: Vec<usize> = match scenes.get(scene.unwrap_or(0)) {
            Some(scene) => scene.nodes.clone(),
            // Without scenes, every node that is no child of another.
            None => {
                let is_child = |i: &usize| nodes.iter().any(|node| node.children.contains(i));
                (0..nodes.len()).filter(|i| !is_child(i)).collect()
            }
        };
        let mut placed = Vec::new();
        let mut is_visited = vec![false; nodes.len()];
        let mut open: Vec<(usize, DAffine3, usize)> =
            roots.into_iter().rev().map(|root| (root, DAffine3::IDENTITY, 0)).collect();
        while let Some((index, parent, depth)) = open.pop() {
            let Some(node) = nodes.get(index) else {
                return Err(self.invalid("nodes", &format!("one of {}", nodes.len()), index.to_string()));
            };
            if std::mem::replace(&mut is_visited[index], true) || depth > DEEPEST {
                return Err(self.invalid(
                    format!("nodes[{index}]"),
                    "a tree of nodes",
                    "a node met twice, or too deep",
                ));
            }
            let global = parent * local(node);
            let primitives = match node.mesh {
                None => &[][..],
                Some(mesh) => match meshes.get(mesh) {
                    Some(mesh) => &mesh.primitives[..],
                    None => {
                        return Err(self.invalid(format!("nodes[{index}].mesh"), "a mesh", mesh.to_string()));
                    }
                },
            };
            for primitive in primitives {
                if primitive.splatting().is_some() || primitive.compressed().is_some() {
                    placed.push((primitive, self.similarity(index, &global)?));
                }
            }
            open.extend(node.children.iter().rev().map(|child| (*child, global, depth + 1)));
        }
        Ok(placed)
    }

    fn similarity(&self, index: usize, global: &DAffine3) -> Result<Similarity, LoadError> {
        let matrix = global.matrix3;
        let scale = matrix.determinant().abs().cbrt();
        let to_from = matrix * scale.recip();
        let skew = to_from * to_from.transpose() - DMat3::IDENTITY;
        let is_similar = scale.is_finite()
            && scale > 0.0
            && global.translation.is_finite()
            && skew.to_cols_array().iter().all(|v| v.abs() < SKEW);
        if !is_similar {
            let expected = "a rotation, translation and uniform scale of Gaussians";
            return Err(self.invalid(format!("nodes[{index}]"), expected, format!("{matrix}")));
        }
        Ok(Similarity { to_from, scale, shift: global.translation })
    }

    /// How many Gaussians a primitive says it has; 0 where it does not.
    fn count(&self, primitive: &Primitive) -> u64 {
        let accessor = primitive.attributes.get("POSITION").and_then(|i| self.document.accessors.get(*i));
        accessor.map_or(0, |accessor| accessor.count)
    }

    fn decode(
        &self,
        primitive: &Primitive,
        work: &Work<'_>,
        notes: &mut Vec<String>,
    ) -> Result<(Gaussians, OpacityMode), LoadError> {
        self.check_extension(primitive, notes)?;
        if let Some((view, is_stated)) = primitive.compressed() {
            return self.decode_spz(view, is_stated, notes);
        }
        let named = |name: &str| format!("{EXTENSION}:{name}");
        let values = |name: &str, components: usize| match primitive.attributes.get(name) {
            Some(index) => {
                Values::new(self.file, self.document, self.buffers, name, *index, components).map(Some)
            }
            None => Ok(None),
        };
        let required = |name: &str, components: usize| {
            values(name, components)?
                .ok_or_else(|| self.invalid(format!("attributes.{name}"), "an accessor", "none"))
        };
        let positions = required("POSITION", 3)?;
        let rotations = required(&named("ROTATION"), 4)?;
        let scales = required(&named("SCALE"), 3)?;
        let opacities = required(&named("OPACITY"), 1)?;
        let coefficient = |degree: usize, k: usize| named(&format!("SH_DEGREE_{degree}_COEF_{k}"));
        let mut sh = vec![required(&coefficient(0, 0), 3)?];
        let mut sh_degree = 0;
        for degree in 1..=MAX_SH_DEGREE {
            let of_degree = (0..=2 * usize::from(degree))
                .map(|k| values(&coefficient(degree.into(), k), 3))
                .collect::<Result<Option<Vec<_>>, _>>()?;
            // A degree is there in whole or not at all.
            let Some(of_degree) = of_degree else { break };
            sh.extend(of_degree);
            sh_degree = degree;
        }
        let used = |name: &String| {
            let known = ["ROTATION", "SCALE", "OPACITY"].map(named);
            let is_sh = (0..=usize::from(sh_degree))
                .any(|degree| (0..=2 * degree).any(|k| *name == coefficient(degree, k)));
            name == "POSITION" || name == "COLOR_0" || known.contains(name) || is_sh
        };
        let unused: Vec<String> =
            primitive.attributes.keys().filter(|name| !used(name)).map(|n| quoted(n)).collect();
        notes.extend(unused_note("attributes", &unused));

        let count = positions.count;
        for (name, other) in [("ROTATION", &rotations), ("SCALE", &scales), ("OPACITY", &opacities)]
            .into_iter()
            .chain(sh.iter().map(|values| ("SH", values)))
        {
            if other.count != count {
                let expected = format!("{count} elements, as many as positions");
                return Err(self.invalid(format!("{EXTENSION}:{name}"), &expected, other.count.to_string()));
            }
        }
        let floats = 11 + 3 * sh_coefficient_count(sh_degree) as u64;
        let file_bytes = self.buffers.iter().map(|buffer| buffer.length).sum();
        check_allowance(self.file, "count", file_bytes, (count as u64).checked_mul(floats * 4))?;
        let mut gaussians = memory::gaussians(self.file, count, sh_degree)?;
        gaussians.slots().blocks(BLOCK).into_par_iter().try_for_each(|(first, mut slots)| {
            let count = slots.len();
            let Slots {
                means,
                scales: to_scales,
                rotations: to_rotations,
                opacities: to_opacities,
                sh: to_sh,
                sh_stride,
            } = &mut slots;
            positions.each(first, count, |i, v| (0..3).for_each(|axis| means[axis][i] = v[axis]))?;
            scales.each(first, count, |i, v| (0..3).for_each(|axis| to_scales[axis][i] = v[axis]))?;
            rotations.each(first, count, |i, [x, y, z, w]| {
                [w, x, y, z].into_iter().enumerate().for_each(|(k, value)| to_rotations[k][i] = value);
            })?;
            opacities.each(first, count, |i, v| to_opacities[i] = v[0])?;
            for (k, values) in sh.iter().enumerate() {
                values.each(first, count, |i, v| {
                    to_sh[i * *sh_stride + 3 * k..][..3].copy_from_slice(&v[..3]);
                })?;
            }
            work.add(count);
            Ok::<(), LoadError>(())
        })?;
        Ok((gaussians, OpacityMode::Default))
    }

    /// Refuses another kernel, and tells what is not done.
    fn check_extension(&self, primitive: &Primitive, notes: &mut Vec<String>) -> Result<(), LoadError> {
        let Some(fields) = primitive.splatting().and_then(|value| value.as_object()) else { return Ok(()) };
        let text = |key: &str| fields.get(key).and_then(|value| value.as_str());
        if let Some(kernel) = text("kernel").filter(|kernel| *kernel != "ellipse") {
            return Err(self.invalid(format!("{EXTENSION}.kernel"), "\"ellipse\"", quoted(kernel)));
        }
        for (key, known) in [
            ("colorSpace", &["srgb_rec709_display"][..]),
            ("projection", &["perspective"]),
            ("sortingMethod", &["cameraDistance", "zDepth"]),
        ] {
            if let Some(value) = text(key).filter(|value| !known.contains(value)) {
                notes.push(format!("{key} {} is not used: {} is assumed", quoted(value), known[0]));
            }
        }
        let known = ["kernel", "colorSpace", "projection", "sortingMethod", "extensions"];
        let unused: Vec<String> =
            fields.keys().filter(|key| !known.contains(&key.as_str())).map(|k| quoted(k)).collect();
        notes.extend(unused_note(&format!("fields of {EXTENSION}"), &unused));
        Ok(())
    }

    /// The Gaussians of a compressed primitive. Where the extension of Khronos says what they are, their numbers are
    /// SPZ's, right-up-back, for a primitive in left-up-front; the older profile keeps the numbers.
    fn decode_spz(
        &self,
        view: u64,
        is_stated: bool,
        notes: &mut Vec<String>,
    ) -> Result<(Gaussians, OpacityMode), LoadError> {
        let field = || format!("bufferViews[{view}]");
        let Some(view) = usize::try_from(view).ok().and_then(|view| self.document.buffer_views.get(view))
        else {
            return Err(self.invalid(field(), "a buffer view", "none"));
        };
        let buffer = self.buffers.get(view.buffer);
        let end = view.byte_offset.saturating_add(view.byte_length);
        let Some(buffer) = buffer.filter(|buffer| end <= buffer.length) else {
            return Err(self.invalid(field(), "bytes within a buffer", format!("some up to {end}")));
        };
        let mut bytes = vec![0; view.byte_length as usize];
        buffer.source.source().read_at(buffer.start + view.byte_offset, &mut bytes, "bufferView")?;
        let label = format!("{} ({})", self.file, field());
        let decoded = spz::read(&Source::memory(label, bytes), &|_| {})?;
        notes.extend(decoded.notes);
        let mut gaussians = decoded.gaussians;
        if is_stated {
            let luf_from_rdf = Axes::LUF.to_rdf().transpose();
            transform(&mut gaussians, &Similarity::orthogonal(luf_from_rdf * decoded.axes.axes.to_rdf()));
        }
        Ok((gaussians, decoded.opacity_mode))
    }
}

/// What a node does, from its matrix or its parts.
fn local(node: &Node) -> DAffine3 {
    if let Some(m) = node.matrix {
        let column = |c: usize| DVec3::new(m[4 * c], m[4 * c + 1], m[4 * c + 2]);
        return DAffine3 {
            matrix3: DMat3::from_cols(column(0), column(1), column(2)),
            translation: column(3),
        };
    }
    let rotation = DQuat::from_array(node.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]));
    let rotation = if rotation.length() > 0.0 { rotation.normalize() } else { DQuat::IDENTITY };
    DAffine3::from_scale_rotation_translation(
        DVec3::from(node.scale.unwrap_or([1.0; 3])),
        rotation,
        DVec3::from(node.translation.unwrap_or([0.0; 3])),
    )
}
