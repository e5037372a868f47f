//! Compressed PLY (PlayCanvas): chunks of 256 Gaussians with bounds, and 16 bytes per Gaussian within them.

use rayon::prelude::*;

use super::super::error::LoadError;
use super::super::progress::{Progress, Work};
use super::super::quaternion::with_largest;
use super::super::source::Source;
use super::super::{BLOCK, Decoded, memory};
use super::column::{Column, Endian, Scalar};
use super::header::{Element, Encoding, Header};
use super::text::end_of;
use super::vertices::unused_properties;
use crate::gaussians::{MAX_SH_DEGREE, SH_C0, Slots, sh_coefficient_count};

/// Gaussians that share bounds.
pub(super) const CHUNK: usize = 256;

/// Bounds of position, log scale and colour: what 0 and 1 stand for, `[min, max][quantity][axis]`.
type Bounds = [[[f32; 3]; 3]; 2];

/// An element's rows in the file.
struct Rows {
    start: u64,
    row_bytes: usize,
    count: usize,
}

/// Reads the elements `chunk`, `vertex` and, if present, `sh`.
pub(super) fn read(
    source: &Source<'_>,
    header: &Header,
    progress: Progress<'_>,
) -> Result<Decoded, LoadError> {
    let file = source.name();
    let Encoding::Binary(endian) = header.encoding else {
        return Err(LoadError::invalid(file, "format", "binary for a compressed PLY", "ascii"));
    };
    let vertex = header.element(file, "vertex")?;
    let words = ["packed_position", "packed_rotation", "packed_scale", "packed_color"];
    let mut packed = Vec::with_capacity(words.len());
    for name in words {
        packed.push(find(file, vertex, name, endian, &[Scalar::U32, Scalar::I32])?);
    }
    let sh = header.elements.iter().find(|element| element.name == "sh");
    let sh_columns = sh.map(|element| sh_columns(file, element, vertex, endian)).transpose()?;
    let sh_degree = sh_columns.as_ref().map_or(0, |(degree, _)| *degree);

    let bounds = read_bounds(source, header, endian)?;
    let rows = rows_of(source, header, vertex, endian)?;
    let sh_rows = sh.map(|element| rows_of(source, header, element, endian)).transpose()?;
    if bounds.len() < rows.count.div_ceil(CHUNK) {
        let expected = format!("{} rows for {} vertices", rows.count.div_ceil(CHUNK), rows.count);
        return Err(LoadError::invalid(file, "element \"chunk\"", expected, bounds.len().to_string()));
    }
    let mut gaussians = memory::gaussians(file, rows.count, sh_degree)?;
    let work = Work::new(rows.count as u64, progress);
    gaussians.slots().blocks(BLOCK).into_par_iter().try_for_each(|(first, mut slots)| {
        let count = slots.len();
        let read = |rows: &Rows, name: &str| {
            let mut bytes = vec![0; count * rows.row_bytes];
            source.read_at(rows.start + (first * rows.row_bytes) as u64, &mut bytes, name)?;
            Ok(bytes)
        };
        let vertices = read(&rows, "element \"vertex\"")?;
        for (i, row) in vertices.chunks_exact(rows.row_bytes).enumerate() {
            let values = [packed[0].word(row), packed[1].word(row), packed[2].word(row), packed[3].word(row)];
            unpack(values, &bounds[(first + i) / CHUNK], i, &mut slots);
        }
        if let (Some(rows), Some((_, columns))) = (&sh_rows, &sh_columns) {
            unpack_sh(&read(rows, "element \"sh\"")?, rows.row_bytes, columns, &mut slots);
        }
        work.add(slots.len());
        Ok::<(), LoadError>(())
    })?;
    let unused = unused_properties(vertex, &words);
    let notes = unused.into_iter().chain(header.unused_elements(&["chunk", "vertex", "sh"]));
    Ok(header.decoded(gaussians, notes.collect()))
}

/// A column of one of the given types.
fn find(
    file: &str,
    element: &Element,
    name: &str,
    endian: Endian,
    types: &[Scalar],
) -> Result<Column, LoadError> {
    match element.find(name) {
        Some((scalar, offset)) if types.contains(&scalar) => Ok(Column { scalar, endian, offset }),
        found => {
            let actual = found.map_or_else(|| "none".to_owned(), |(scalar, _)| format!("{scalar:?}"));
            let field = format!("{}.{name}", element.name);
            Err(LoadError::invalid(file, field, format!("a property of type {:?}", types[0]), actual))
        }
    }
}

/// Finds the rows of `element`, which must have some bytes each, and checks that they are all there.
fn rows_of(
    source: &Source<'_>,
    header: &Header,
    element: &Element,
    endian: Endian,
) -> Result<Rows, LoadError> {
    let mut start = header.data_start;
    for before in header.elements.iter().take_while(|before| before.name != element.name) {
        start = end_of(source, before, start, endian)?;
    }
    end_of(source, element, start, endian)?;
    match element.row_bytes() {
        Some(row_bytes @ 1..) => {
            Ok(Rows { start, row_bytes: row_bytes as usize, count: element.count as usize })
        }
        _ => {
            let field = format!("element \"{}\"", element.name);
            Err(LoadError::invalid(source.name(), field, "scalar properties", "none, or a list"))
        }
    }
}

fn read_bounds(source: &Source<'_>, header: &Header, endian: Endian) -> Result<Vec<Bounds>, LoadError> {
    let file = source.name();
    let chunk = header.element(file, "chunk")?;
    let rows = rows_of(source, header, chunk, endian)?;
    let mut bytes = vec![0; rows.count * rows.row_bytes];
    source.read_at(rows.start, &mut bytes, "element \"chunk\"")?;
    // Files from before colours had bounds keep colours within 0 and 1.
    let default = [[[0.0; 3]; 3], [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]];
    let mut bounds = vec![default; rows.count];
    let names = [["x", "y", "z"], ["scale_x", "scale_y", "scale_z"], ["r", "g", "b"]];
    for (side, prefix) in ["min", "max"].into_iter().enumerate() {
        for (quantity, names) in names.iter().enumerate() {
            for (axis, name) in names.iter().enumerate() {
                let name = format!("{prefix}_{name}");
                if quantity == 2 && chunk.find("min_r").is_none() {
                    continue;
                }
                let column = find(file, chunk, &name, endian, &[Scalar::F32, Scalar::F64])?;
                column.each(&bytes, rows.row_bytes, |i, value| bounds[i][side][quantity][axis] = value);
            }
        }
    }
    Ok(bounds)
}

/// The degree and, for each column of `sh`, its place among a Gaussian's coefficients.
fn sh_columns(
    file: &str,
    sh: &Element,
    vertex: &Element,
    endian: Endian,
) -> Result<(u8, Vec<(Column, usize)>), LoadError> {
    if sh.count != vertex.count {
        let expected = format!("{} rows, as many as vertices", vertex.count);
        return Err(LoadError::invalid(file, "element \"sh\"", expected, sh.count.to_string()));
    }
    let rest = sh.properties.len();
    let Some(degree) = (1..=MAX_SH_DEGREE).find(|d| rest == 3 * (sh_coefficient_count(*d) - 1)) else {
        return Err(LoadError::invalid(
            file,
            "element \"sh\"",
            "9, 24, 45 or 72 properties",
            rest.to_string(),
        ));
    };
    let mut columns = Vec::with_capacity(rest);
    for i in 0..rest {
        // Channel-major, as in the uncompressed format.
        let (channel, coefficient) = (i / (rest / 3), 1 + i % (rest / 3));
        let column = find(file, sh, &format!("f_rest_{i}"), endian, &[Scalar::U8])?;
        columns.push((column, coefficient * 3 + channel));
    }
    Ok((degree, columns))
}

/// Unpacks position (11, 10, 11 bits), rotation (2, 10, 10, 10), log scale (11, 10, 11) and colour with
/// opacity (8 each), the first field in the highest bits.
fn unpack([position, rotation, scale, color]: [u32; 4], bounds: &Bounds, i: usize, slots: &mut Slots<'_>) {
    let [min, max] = bounds;
    let lerp =
        |quantity: usize, axis: usize, t: f32| min[quantity][axis] * (1.0 - t) + max[quantity][axis] * t;
    let (position, scale) = (unpack_11_10_11(position), unpack_11_10_11(scale));
    for axis in 0..3 {
        slots.means[axis][i] = lerp(0, axis, position[axis]);
        slots.scales[axis][i] = lerp(1, axis, scale[axis]).exp();
    }
    // Components within ±√½, in the order of rot_0..3 (w first) without the one that the top bits name.
    let component = |shift: u32| (unorm(rotation, shift, 10) - 0.5) * std::f32::consts::SQRT_2;
    let quaternion = with_largest((rotation >> 30) as usize, [component(20), component(10), component(0)]);
    for (plane, value) in slots.rotations.iter_mut().zip(quaternion) {
        plane[i] = value;
    }
    let constant = &mut slots.sh[i * slots.sh_stride..i * slots.sh_stride + 3];
    for (channel, value) in constant.iter_mut().enumerate() {
        let shade = lerp(2, channel, unorm(color, 24 - 8 * channel as u32, 8));
        *value = (shade - 0.5) / SH_C0;
    }
    slots.opacities[i] = unorm(color, 0, 8);
}

/// Coefficients lie within ±4; the two end codes are exact, the others stand for the middle of their interval.
fn unpack_sh(rows: &[u8], row_bytes: usize, columns: &[(Column, usize)], slots: &mut Slots<'_>) {
    let stride = slots.sh_stride;
    for (column, index) in columns {
        column.each(rows, row_bytes, |i, code| {
            let unit = match code {
                0.0 => 0.0,
                255.0 => 1.0,
                code => (code + 0.5) / 256.0,
            };
            slots.sh[i * stride + index] = (unit - 0.5) * 8.0;
        });
    }
}

fn unpack_11_10_11(packed: u32) -> [f32; 3] {
    [unorm(packed, 21, 11), unorm(packed, 11, 10), unorm(packed, 0, 11)]
}

/// The `bits` bits from `shift` on as a share of their largest value.
fn unorm(packed: u32, shift: u32, bits: u32) -> f32 {
    let largest = (1u32 << bits) - 1;
    ((packed >> shift) & largest) as f32 / largest as f32
}
