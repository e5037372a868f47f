//! 3D Gaussian Splatting PLY (Kerbl et al. 2023): one row per Gaussian, parameters before activation.

use glam::DVec3;
use rayon::prelude::*;

use super::super::error::{LoadError, quoted};
use super::super::progress::{Progress, Work};
use super::super::source::Source;
use super::super::{Decoded, memory, origin, unused_note};
use super::column::{Column, Endian, Scalar};
use super::header::{Element, Encoding, Header};
use super::text::{Tokens, end_of};
use crate::gaussians::{Gaussians, MAX_SH_DEGREE, Slots, sh_coefficient_count};

/// Bytes that a task reads at once: large enough for the system call to cost nothing, small enough for the
/// cache.
const READ_BYTES: usize = 1 << 20;

/// Bytes of rows that all columns pass over while they stay in the first-level cache.
const TILE_BYTES: usize = 1 << 14;

/// Where the value of a column goes.
#[derive(Clone, Copy, Debug)]
enum Target {
    Mean(usize),
    /// Logarithm of the scale.
    Scale(usize),
    Rotation(usize),
    /// Logit of the opacity.
    Opacity,
    /// Standard deviation of Mip-Splatting's 3D filter, in world units; after scales and opacity.
    Filter,
    /// Index within the Gaussian's spherical harmonics.
    Sh(usize),
}

/// The columns that make Gaussians.
struct Layout {
    columns: Vec<(Column, Target)>,
    row_bytes: usize,
    sh_degree: u8,
    /// Subtracted from positions before they lose precision.
    origin: DVec3,
}

/// Properties that 3D Gaussian Splatting declares and never uses.
const NORMALS: [&str; 3] = ["nx", "ny", "nz"];

/// Rows that the origin is found from, evenly spread.
const SAMPLED_ROWS: u64 = 1024;

/// Reads the element `vertex`; others are skipped.
pub(super) fn read(
    source: &Source<'_>,
    header: &Header,
    progress: Progress<'_>,
) -> Result<Decoded, LoadError> {
    let vertex = header.element(source.name(), "vertex")?;
    check_kind(source.name(), header, vertex)?;
    let (gaussians, origin) = match header.encoding {
        Encoding::Binary(endian) => read_binary(source, header, vertex, endian, progress)?,
        Encoding::Text => read_text(source, header, vertex, progress)?,
    };
    let used = |name: &str| {
        ["x", "y", "z", "opacity", FILTER].contains(&name)
            || ["scale_", "rot_", "f_dc_", "f_rest_"].iter().any(|prefix| name.starts_with(prefix))
    };
    let used: Vec<&str> =
        vertex.properties.iter().map(|p| p.name.as_str()).filter(|name| used(name)).collect();
    let notes = unused_properties(vertex, &used).into_iter().chain(header.unused_elements(&["vertex"]));
    Ok(Decoded { origin, ..header.decoded(gaussians, notes.collect()) })
}

/// The 3D filter of Mip-Splatting (Yu et al. 2024).
const FILTER: &str = "filter_3D";

/// Refuses points and meshes, which are in PLY files as well.
fn check_kind(file: &str, header: &Header, vertex: &Element) -> Result<(), LoadError> {
    let of_gaussians = ["opacity", "scale_0", "rot_0", "f_dc_0"];
    if vertex.properties.iter().any(|property| of_gaussians.contains(&property.name.as_str())) {
        return Ok(());
    }
    let faces = ["face", "faces", "tristrips"];
    let is_mesh = header.elements.iter().any(|e| e.count > 0 && faces.contains(&e.name.as_str()));
    let kind = if is_mesh { "a mesh" } else { "a point cloud" };
    let names: Vec<&str> = vertex.properties.iter().map(|property| property.name.as_str()).take(8).collect();
    let actual = format!("{kind} ({} vertices with {})", vertex.count, quoted(&names.join(", ")));
    Err(LoadError::NotGaussians { file: file.to_owned(), actual })
}

/// That `vertex` has properties other than `used`, if it has any.
pub(super) fn unused_properties(vertex: &Element, used: &[&str]) -> Option<String> {
    let names = vertex.properties.iter().map(|property| property.name.as_str());
    let unused: Vec<String> =
        names.filter(|name| !used.contains(name) && !NORMALS.contains(name)).map(quoted).collect();
    unused_note("vertex properties", &unused)
}

fn read_binary(
    source: &Source<'_>,
    header: &Header,
    vertex: &Element,
    endian: Endian,
    progress: Progress<'_>,
) -> Result<(Gaussians, DVec3), LoadError> {
    let column = |_, (scalar, offset)| Column { scalar, endian, offset };
    let mut layout = Layout::new(source.name(), vertex, column)?;
    let mut start = header.data_start;
    for element in header.elements.iter().take_while(|element| element.name != "vertex") {
        start = end_of(source, element, start, endian)?;
    }
    // Checks the count against the file before anything is allocated by it.
    end_of(source, vertex, start, endian)?;
    let count = vertex.count as usize;
    if layout.has_precise_positions() {
        layout.origin = sampled_origin(source, &layout, start, vertex.count)?;
    }
    let mut gaussians = memory::gaussians(source.name(), count, layout.sh_degree)?;
    let work = Work::new(vertex.count, progress);
    let rows_at_once = (READ_BYTES / layout.row_bytes).max(1);
    gaussians.slots().blocks(rows_at_once).into_par_iter().try_for_each_init(
        || vec![0; rows_at_once * layout.row_bytes],
        |buffer, (first, mut slots)| {
            let rows = &mut buffer[..slots.len() * layout.row_bytes];
            source.read_at(start + (first * layout.row_bytes) as u64, rows, "element \"vertex\"")?;
            layout.unpack(rows, &mut slots);
            work.add(slots.len());
            Ok(())
        },
    )?;
    Ok((gaussians, layout.origin))
}

/// The origin for positions of more than single precision in binary rows from `start`.
fn sampled_origin(source: &Source<'_>, layout: &Layout, start: u64, count: u64) -> Result<DVec3, LoadError> {
    let sampled = count.min(SAMPLED_ROWS);
    let mut rows = vec![0; sampled as usize * layout.row_bytes];
    for (k, row) in rows.chunks_exact_mut(layout.row_bytes).enumerate() {
        // In 128 bits: the product of two counts of rows.
        let index = (k as u128 * u128::from(count) / u128::from(sampled)) as u64;
        source.read_at(start + index * layout.row_bytes as u64, row, "element \"vertex\"")?;
    }
    Ok(layout.origin_of(&rows))
}

/// Text is turned into binary rows of f64, which then go the same way.
fn read_text(
    source: &Source<'_>,
    header: &Header,
    vertex: &Element,
    progress: Progress<'_>,
) -> Result<(Gaussians, DVec3), LoadError> {
    let column = |index, _| Column { scalar: Scalar::F64, endian: Endian::Little, offset: index * 8 };
    let mut layout = Layout::new(source.name(), vertex, column)?;
    layout.row_bytes = vertex.properties.len() * 8;
    // A value takes a digit and a separator at least; the last may lack its separator.
    let least = vertex.count.saturating_mul(vertex.properties.len() as u64 * 2).saturating_sub(1);
    source.check_extent(header.data_start, least, "element \"vertex\"")?;
    let mut tokens = Tokens::new(source, header)?;
    for element in header.elements.iter().take_while(|element| element.name != "vertex") {
        tokens.skip(element)?;
    }
    let mut gaussians = memory::gaussians(source.name(), vertex.count as usize, layout.sh_degree)?;
    let work = Work::new(vertex.count, progress);
    let mut rows = Vec::new();
    for (first, mut slots) in gaussians.slots().blocks(super::super::BLOCK) {
        rows.clear();
        for _ in 0..slots.len() * vertex.properties.len() {
            rows.extend_from_slice(&tokens.next("vertex")?.to_le_bytes());
        }
        if first == 0 {
            layout.origin = layout.origin_of(&rows);
        }
        layout.unpack(&rows, &mut slots);
        work.add(slots.len());
    }
    Ok((gaussians, layout.origin))
}

impl Layout {
    /// Finds the columns by their names; `column` makes one of a property's index, type and offset.
    fn new(
        file: &str,
        vertex: &Element,
        column: impl Fn(usize, (Scalar, usize)) -> Column,
    ) -> Result<Self, LoadError> {
        let invalid = |field: &str, expected: &str, actual: &str| {
            LoadError::invalid(file, format!("vertex.{field}"), expected, actual)
        };
        let Some(row_bytes) = vertex.row_bytes() else {
            return Err(invalid("properties", "scalars", "a list"));
        };
        let has = |name: &str| vertex.properties.iter().any(|property| property.name == name);
        if has("scale_0") && has("scale_1") && !has("scale_2") {
            return Err(invalid(
                "scale_2",
                "three scales",
                "two (2D Gaussian Splatting, which has no volume)",
            ));
        }
        let rest = (0..).take_while(|i| has(&format!("f_rest_{i}"))).count();
        let named = vertex.properties.iter().filter(|property| property.name.starts_with("f_rest_")).count();
        let degree = (0..=MAX_SH_DEGREE)
            .find(|d| rest == 3 * (sh_coefficient_count(*d) - 1))
            .filter(|_| named == rest);
        let Some(sh_degree) = degree else {
            let expected = "0, 9, 24, 45 or 72 properties, numbered from 0";
            return Err(invalid("f_rest_*", expected, &format!("{named}, {rest} numbered in sequence")));
        };

        let mut columns = Vec::new();
        let mut add = |name: &str, target: Target| {
            let index = vertex.properties.iter().position(|property| property.name == name);
            let (Some(index), Some(found)) = (index, vertex.find(name)) else {
                return Err(invalid(name, "a property of this name", "none"));
            };
            columns.push((column(index, found), target));
            Ok(())
        };
        for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
            add(name, Target::Mean(axis))?;
        }
        for axis in 0..3 {
            add(&format!("scale_{axis}"), Target::Scale(axis))?;
        }
        for component in 0..4 {
            add(&format!("rot_{component}"), Target::Rotation(component))?;
        }
        add("opacity", Target::Opacity)?;
        for channel in 0..3 {
            add(&format!("f_dc_{channel}"), Target::Sh(channel))?;
        }
        // Channel-major in the file: all coefficients of red, then of green, then of blue.
        for i in 0..rest {
            let (channel, coefficient) = (i / (rest / 3), 1 + i % (rest / 3));
            add(&format!("f_rest_{i}"), Target::Sh(coefficient * 3 + channel))?;
        }
        if has(FILTER) {
            add(FILTER, Target::Filter)?;
        }
        Ok(Self { columns, row_bytes: row_bytes as usize, sh_degree, origin: DVec3::ZERO })
    }

    /// Whether the file has positions in more than single precision.
    fn has_precise_positions(&self) -> bool {
        let is_precise = |scalar| matches!(scalar, Scalar::F64 | Scalar::I32 | Scalar::U32);
        self.columns
            .iter()
            .any(|(column, target)| matches!(target, Target::Mean(_)) && is_precise(column.scalar))
    }

    /// The origin for a scene; `rows` are a sample of the scene.
    fn origin_of(&self, rows: &[u8]) -> DVec3 {
        let mut positions = [const { Vec::new() }; 3];
        for (column, target) in &self.columns {
            if let Target::Mean(axis) = *target {
                column.each_f64(rows, self.row_bytes, |_, value| positions[axis].push(value));
            }
        }
        origin::of(positions)
    }

    /// Activates `rows` into `slots`, one row each.
    fn unpack(&self, rows: &[u8], slots: &mut Slots<'_>) {
        let rows_per_tile = (TILE_BYTES / self.row_bytes).max(1);
        let stride = slots.sh_stride;
        for (tile, rows) in rows.chunks(rows_per_tile * self.row_bytes).enumerate() {
            let first = tile * rows_per_tile;
            let last = first + rows.len() / self.row_bytes;
            for (column, target) in &self.columns {
                match *target {
                    Target::Mean(axis) => {
                        let plane = &mut slots.means[axis][first..last];
                        match self.origin[axis] {
                            0.0 => column.each(rows, self.row_bytes, |i, value| plane[i] = value),
                            origin => column.each_f64(rows, self.row_bytes, |i, value| {
                                plane[i] = (value - origin) as f32
                            }),
                        }
                    }
                    Target::Scale(axis) => {
                        let plane = &mut slots.scales[axis][first..last];
                        column.each(rows, self.row_bytes, |i, value| plane[i] = value.exp());
                    }
                    Target::Rotation(component) => {
                        let plane = &mut slots.rotations[component][first..last];
                        column.each(rows, self.row_bytes, |i, value| plane[i] = value);
                    }
                    Target::Opacity => {
                        let plane = &mut slots.opacities[first..last];
                        column.each(rows, self.row_bytes, |i, value| plane[i] = 1.0 / (1.0 + (-value).exp()));
                    }
                    Target::Filter => {
                        column.each(rows, self.row_bytes, |i, filter| widen(slots, first + i, filter));
                    }
                    Target::Sh(index) => {
                        let sh = &mut slots.sh[first * stride + index..];
                        column.each(rows, self.row_bytes, |i, value| sh[i * stride] = value);
                    }
                }
            }
        }
    }
}

/// Convolves Gaussian `i` with a round one of standard deviation `filter` that keeps its mass, as Mip-Splatting does
/// before it projects: variances add, and opacity shrinks as the volume grows. A filter that is no number leaves no
/// valid Gaussian.
fn widen(slots: &mut Slots<'_>, i: usize, filter: f32) {
    let mut shrunk = 1.0;
    for plane in &mut slots.scales {
        let before = f64::from(plane[i]);
        let after = before.hypot(f64::from(filter));
        plane[i] = after as f32;
        // Of a flat Gaussian that no filter widens nothing changes.
        shrunk *= if after == 0.0 { 1.0 } else { before / after };
    }
    slots.opacities[i] = (f64::from(slots.opacities[i]) * shrunk) as f32;
}
