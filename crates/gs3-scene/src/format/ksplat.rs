//! `.ksplat` (GaussianSplats3D by mkkellogg): sections of records, positions of compressed ones within buckets.
//!
//! Source: the layout that GaussianSplats3D's `SplatBuffer` reads and writes, versions 0.1 and later; the format has no
//! description of its own. Axes are right-down-front, as in PLY.

use half::f16;
use rayon::prelude::*;

use super::error::LoadError;
use super::progress::{Progress, Work};
use super::source::{Source, check_allowance};
use super::{BLOCK, Decoded, memory};
use crate::gaussians::{SH_C0, Slots, sh_coefficient_count};
use crate::scene::OpacityMode;

/// Bytes of the header of the file, and of each section's.
const HEADER: usize = 4096;
const SECTION_HEADER: usize = 1024;

/// Sections that a file may have: the format's own programs write one for each degree or level.
const MOST_SECTIONS: u32 = 1 << 16;

/// Range of spherical harmonics where the file states none.
const DEFAULT_SH: f32 = 1.5;

/// How records are compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Compression {
    /// All values are f32.
    None,
    /// Positions are u16 within buckets, others f16.
    Half,
    /// The same, spherical harmonics as bytes.
    Byte,
}

impl Compression {
    /// Bytes of a position, of another value, and of a spherical-harmonics value.
    const fn sizes(self) -> [usize; 3] {
        match self {
            Self::None => [4, 4, 4],
            Self::Half => [2, 2, 2],
            Self::Byte => [2, 2, 1],
        }
    }
}

/// A part of the file. Its Gaussians have one layout.
struct Section {
    count: usize,
    sh_degree: u8,
    record: usize,
    /// Where its records begin.
    records_start: u64,
    /// Gaussians in a full bucket.
    bucket_size: usize,
    full_buckets: usize,
    /// Gaussians in each of the buckets after the full ones, added up.
    partial_ends: Vec<usize>,
    centers: Vec<[f32; 3]>,
    /// World units of one step of compressed positions, and the step that is the bucket's centre.
    step: f32,
    middle: f32,
}

/// What all sections share.
struct File {
    compression: Compression,
    sh_range: [f32; 2],
}

pub(super) fn read(source: &Source<'_>, progress: Progress<'_>) -> Result<Decoded, LoadError> {
    let name = source.name();
    let mut head = vec![0; HEADER];
    source.read_at(0, &mut head, "header")?;
    let fields = Fields(&head);
    if fields.byte(0) != 0 || fields.byte(1) == 0 {
        let actual = format!("{}.{}", fields.byte(0), fields.byte(1));
        return Err(LoadError::invalid(name, "version", "0.1 or later, below 1", actual));
    }
    let (most_sections, section_count) = (fields.u32(4), fields.u32(8));
    if most_sections > MOST_SECTIONS || section_count > most_sections {
        let expected = format!("at most {MOST_SECTIONS} sections, and no more than there is room for");
        return Err(LoadError::invalid(
            name,
            "sections",
            expected,
            format!("{section_count} of {most_sections}"),
        ));
    }
    let compression = match fields.u16(20) {
        0 => Compression::None,
        1 => Compression::Half,
        2 => Compression::Byte,
        other => return Err(LoadError::invalid(name, "compression level", "0, 1 or 2", other.to_string())),
    };
    let bound = |at: usize, default: f32| match fields.f32(at) {
        0.0 => default,
        stated => stated,
    };
    let file = File { compression, sh_range: [bound(36, -DEFAULT_SH), bound(40, DEFAULT_SH)] };
    let mut sections = Vec::new();
    let mut start = (HEADER + most_sections as usize * SECTION_HEADER) as u64;
    for i in 0..section_count as usize {
        let section = Section::read(source, &file, i, &mut start)?;
        if section.count > 0 {
            sections.push(section);
        }
    }
    let count: usize = sections.iter().map(|section| section.count).sum();
    let stated = fields.u32(16);
    if stated as usize != count {
        let expected = format!("{count}, as many as its sections have");
        return Err(LoadError::invalid(name, "splat count", expected, stated.to_string()));
    }
    let degree = sections.iter().map(|section| section.sh_degree).max().unwrap_or(0);
    let floats = 11 + 3 * sh_coefficient_count(degree) as u64;
    check_allowance(name, "splat count", source.len(), (count as u64).checked_mul(floats * 4))?;
    let work = Work::new(count as u64, progress);
    let mut gaussians = memory::gaussians(name, count, degree)?;
    let mut rest = gaussians.slots();
    for section in &sections {
        let (slots, others) = rest.split_at(section.count);
        rest = others;
        slots.blocks(BLOCK).into_par_iter().try_for_each(|(first, mut slots)| {
            let mut bytes = vec![0; slots.len() * section.record];
            source.read_at(section.records_start + (first * section.record) as u64, &mut bytes, "records")?;
            for (i, record) in bytes.chunks_exact(section.record).enumerate() {
                file.unpack(section, first + i, record, i, &mut slots);
            }
            work.add(slots.len());
            Ok::<(), LoadError>(())
        })?;
    }
    Ok(Decoded::new(gaussians, OpacityMode::Default))
}

impl Section {
    /// Reads the header of section `i` and what precedes its records, which are checked to be there; moves `start` behind
    /// them.
    fn read(source: &Source<'_>, file: &File, i: usize, start: &mut u64) -> Result<Self, LoadError> {
        let mut head = [0; SECTION_HEADER];
        source.read_at((HEADER + i * SECTION_HEADER) as u64, &mut head, "section header")?;
        let fields = Fields(&head);
        let invalid = |field: &str, expected: String, actual: String| {
            LoadError::invalid(source.name(), format!("section {i} {field}"), expected, actual)
        };
        let [count, room, bucket_size, bucket_count] = [0, 4, 8, 12].map(|at| fields.u32(at));
        let (full, partial) = (fields.u32(32), fields.u32(36));
        let sh_degree = fields.u16(40);
        if count > room {
            return Err(invalid("splat count", format!("at most {room}"), count.to_string()));
        }
        if sh_degree > 3 {
            return Err(invalid("SH degree", "at most 3".to_owned(), sh_degree.to_string()));
        }
        let sh_degree = sh_degree as u8;
        let is_bucketed = file.compression != Compression::None;
        let storage = u64::from(fields.u16(20));
        if is_bucketed && bucket_count > 0 && storage < 12 {
            return Err(invalid("bucket storage size", "12 or more".to_owned(), storage.to_string()));
        }
        let partial_bytes = u64::from(partial) * 4;
        source.check_extent(*start, partial_bytes, "lengths of buckets")?;
        let mut lengths = vec![0; partial_bytes as usize];
        source.read_at(*start, &mut lengths, "lengths of buckets")?;
        let mut end = full as usize * bucket_size as usize;
        let partial_ends = (lengths.as_chunks::<4>().0.iter())
            .map(|length| {
                end = end.saturating_add(u32::from_le_bytes(*length) as usize);
                end
            })
            .collect();
        let centers_start = *start + partial_bytes;
        let centers_bytes = u64::from(bucket_count) * storage;
        source.check_extent(centers_start, centers_bytes, "buckets")?;
        let mut buckets = vec![0; centers_bytes as usize];
        source.read_at(centers_start, &mut buckets, "buckets")?;
        let center = |bytes: &[u8]| [0, 4, 8].map(|at| Fields(bytes).f32(at));
        let centers: Vec<[f32; 3]> = if storage < 12 {
            Vec::new()
        } else {
            buckets.chunks_exact(storage as usize).map(center).collect()
        };
        let [position, other, sh] = file.compression.sizes();
        let record = 3 * position + 7 * other + 4 + sh * 3 * (sh_coefficient_count(sh_degree) - 1);
        let records_start = centers_start + centers_bytes;
        let bytes = u64::from(room) * record as u64;
        // The last section may end with its last record.
        source.check_extent(records_start, u64::from(count) * record as u64, "records")?;
        *start = records_start + bytes;
        let range = match fields.u32(24) {
            0 if file.compression == Compression::None => 1,
            0 => 32_767,
            stated => stated,
        };
        Ok(Self {
            count: count as usize,
            sh_degree,
            record,
            records_start,
            bucket_size: bucket_size as usize,
            full_buckets: full as usize,
            partial_ends,
            centers,
            step: fields.f32(16) * 0.5 / range as f32,
            middle: range as f32,
        })
    }

    /// The centre of the bucket of Gaussian `i`; no number where there is none, so that the Gaussian is dropped and
    /// counted.
    fn center(&self, i: usize) -> [f32; 3] {
        let full = self.full_buckets * self.bucket_size;
        let bucket = match i.checked_div(self.bucket_size) {
            Some(bucket) if i < full => bucket,
            _ => self.full_buckets + self.partial_ends.partition_point(|end| *end <= i),
        };
        self.centers.get(bucket).copied().unwrap_or([f32::NAN; 3])
    }
}

impl File {
    /// Unpacks Gaussian `index` of `section` into slot `to`.
    fn unpack(&self, section: &Section, index: usize, record: &[u8], to: usize, slots: &mut Slots<'_>) {
        let fields = Fields(record);
        let [position, other, sh_size] = self.compression.sizes();
        let value = |at: usize, size: usize| match size {
            4 => fields.f32(at),
            2 => f16::from_bits(fields.u16(at)).to_f32(),
            _ => {
                let [min, max] = self.sh_range;
                f32::from(fields.byte(at)) / 255.0 * (max - min) + min
            }
        };
        let center = if self.compression == Compression::None { [0.0; 3] } else { section.center(index) };
        let (scales, rotation) = (3 * position, 3 * position + 3 * other);
        for axis in 0..3 {
            slots.means[axis][to] = match self.compression {
                Compression::None => fields.f32(4 * axis),
                _ => (f32::from(fields.u16(2 * axis)) - section.middle) * section.step + center[axis],
            };
            slots.scales[axis][to] = value(scales + axis * other, other);
        }
        for (k, plane) in slots.rotations.iter_mut().enumerate() {
            plane[to] = value(rotation + k * other, other);
        }
        let color = rotation + 4 * other;
        let stride = slots.sh_stride;
        let sh = &mut slots.sh[to * stride..(to + 1) * stride];
        for (k, constant) in sh[..3].iter_mut().enumerate() {
            *constant = (f32::from(fields.byte(color + k)) / 255.0 - 0.5) / SH_C0;
        }
        slots.opacities[to] = f32::from(fields.byte(color + 3)) / 255.0;
        // Degree by degree, within a degree all of red, then of green, then of blue.
        let mut at = color + 4;
        for degree in 1..=usize::from(section.sh_degree) {
            let functions = 2 * degree + 1;
            for channel in 0..3 {
                for k in 0..functions {
                    sh[(degree * degree + k) * 3 + channel] = value(at, sh_size);
                    at += sh_size;
                }
            }
        }
    }
}

/// Little-endian values at offsets; 0 beyond the end.
struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    fn bytes<const N: usize>(&self, at: usize) -> [u8; N] {
        self.0.get(at..).and_then(|rest| rest.first_chunk()).copied().unwrap_or([0; N])
    }

    fn byte(&self, at: usize) -> u8 {
        u8::from_le_bytes(self.bytes(at))
    }

    fn u16(&self, at: usize) -> u16 {
        u16::from_le_bytes(self.bytes(at))
    }

    fn u32(&self, at: usize) -> u32 {
        u32::from_le_bytes(self.bytes(at))
    }

    fn f32(&self, at: usize) -> f32 {
        f32::from_le_bytes(self.bytes(at))
    }
}
