//! 3D Gaussian Splatting PLY (Kerbl et al. 2023): one row per Gaussian, parameters before activation.

use rayon::prelude::*;

use super::super::Decoded;
use super::super::error::LoadError;
use super::super::progress::{Progress, Work};
use super::super::source::Source;
use super::column::{Column, Endian, Scalar};
use super::header::{Element, Encoding, Header};
use super::text::{Tokens, end_of};
use crate::gaussians::{Gaussians, Slots, sh_coefficient_count};

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
    /// Index within the Gaussian's spherical harmonics.
    Sh(usize),
}

/// The columns that make Gaussians.
struct Layout {
    columns: Vec<(Column, Target)>,
    row_bytes: usize,
    sh_degree: u8,
}

/// Reads the element `vertex`; others are skipped.
pub(super) fn read(
    source: &Source<'_>,
    header: &Header,
    progress: Progress<'_>,
) -> Result<Decoded, LoadError> {
    let vertex = header.element(source.name(), "vertex")?;
    let gaussians = match header.encoding {
        Encoding::Binary(endian) => read_binary(source, header, vertex, endian, progress)?,
        Encoding::Text => read_text(source, header, vertex, progress)?,
    };
    Ok((gaussians, header.opacity_mode))
}

fn read_binary(
    source: &Source<'_>,
    header: &Header,
    vertex: &Element,
    endian: Endian,
    progress: Progress<'_>,
) -> Result<Gaussians, LoadError> {
    let layout = Layout::new(source.name(), vertex, |_, (scalar, offset)| Column { scalar, endian, offset })?;
    let mut start = header.data_start;
    for element in header.elements.iter().take_while(|element| element.name != "vertex") {
        start = end_of(source, element, start, endian)?;
    }
    // Checks the count against the file before anything is allocated by it.
    end_of(source, vertex, start, endian)?;
    let count = vertex.count as usize;
    let mut gaussians = Gaussians::zeroed(count, layout.sh_degree);
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
    Ok(gaussians)
}

/// Text is turned into binary rows of f64, which then go the same way.
fn read_text(
    source: &Source<'_>,
    header: &Header,
    vertex: &Element,
    progress: Progress<'_>,
) -> Result<Gaussians, LoadError> {
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
    let mut gaussians = Gaussians::zeroed(vertex.count as usize, layout.sh_degree);
    let work = Work::new(vertex.count, progress);
    let mut rows = Vec::new();
    for (_, mut slots) in gaussians.slots().blocks(super::super::BLOCK) {
        rows.clear();
        for _ in 0..slots.len() * vertex.properties.len() {
            rows.extend_from_slice(&tokens.next("vertex")?.to_le_bytes());
        }
        layout.unpack(&rows, &mut slots);
        work.add(slots.len());
    }
    Ok(gaussians)
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
        let degree = (0..=3).find(|d| rest == 3 * (sh_coefficient_count(*d) - 1)).filter(|_| named == rest);
        let Some(sh_degree) = degree else {
            let expected = "0, 9, 24 or 45 properties, numbered from 0";
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
        Ok(Self { columns, row_bytes: row_bytes as usize, sh_degree })
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
                        column.each(rows, self.row_bytes, |i, value| plane[i] = value);
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
                    Target::Sh(index) => {
                        let sh = &mut slots.sh[first * stride + index..];
                        column.each(rows, self.row_bytes, |i, value| sh[i * stride] = value);
                    }
                }
            }
        }
    }
}
