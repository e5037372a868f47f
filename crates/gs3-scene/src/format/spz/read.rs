//! Reading SPZ.

use std::io::Read;

use flate2::read::MultiGzDecoder;
use rayon::prelude::*;

use super::super::error::LoadError;
use super::super::progress::{Progress, Work};
use super::super::source::{Source, check_allowance};
use super::super::{BLOCK, Decoded, memory};
use super::arrays::Arrays;
use super::extensions::{Extensions, MOST_BYTES};
use super::{ANTIALIASED, EXTENDED, HEADER, MAGIC, Sizes, streams};
use crate::gaussians::{Gaussians, MAX_SH_DEGREE};
use crate::scene::OpacityMode;

/// Bytes unpacked at once.
const UNPACK_BYTES: usize = 1 << 20;

pub(super) struct Header {
    version: u32,
    pub(super) count: usize,
    pub(super) sh_degree: u8,
    /// Bits after the binary point of positions.
    fractional_bits: u8,
    pub(super) is_extended: bool,
    opacity_mode: OpacityMode,
}

/// Reads versions 1 to 4.
pub(in super::super) fn read(source: &Source<'_>, progress: Progress<'_>) -> Result<Decoded, LoadError> {
    if source.head(4)?.starts_with(&MAGIC.to_le_bytes()) {
        let mut head = [0; HEADER];
        source.read_at(0, &mut head, "header")?;
        let header = Header::parse(source.name(), &head, 4..=4)?;
        return decode(source, &header, progress, |sizes, work| {
            let (arrays, extensions) = streams::read(source, &header, sizes, work)?;
            Ok((Packed::Apart(arrays), extensions))
        });
    }
    let mut gzip = MultiGzDecoder::new(std::io::BufReader::with_capacity(1 << 16, source.cursor()));
    let mut head = [0; HEADER];
    fill(source, &mut gzip, &mut head, "header")?;
    let header = Header::parse(source.name(), &head, 1..=3)?;
    decode(source, &header, progress, |sizes, work| {
        let total = header.count * sizes.total();
        let mut bytes = Vec::new();
        while bytes.len() < total {
            let start = bytes.len();
            bytes.resize((start + UNPACK_BYTES).min(total), 0);
            fill(source, &mut gzip, &mut bytes[start..], "arrays")?;
            work.add(bytes.len() - start);
        }
        let extensions = read_rest(source, &mut gzip, &header, total)?;
        Ok((Packed::Together(bytes), extensions))
    })
}

/// The arrays of a file.
enum Packed {
    /// One after another.
    Together(Vec<u8>),
    Apart([Vec<u8>; 6]),
}

/// Decodes what `unpack` gives, on all cores.
fn decode(
    source: &Source<'_>,
    header: &Header,
    progress: Progress<'_>,
    unpack: impl FnOnce(Sizes, &Work<'_>) -> Result<(Packed, Extensions), LoadError>,
) -> Result<Decoded, LoadError> {
    let sizes = Sizes::new(header.version, header.sh_degree);
    // Both products fit 64 bits: the count has 32.
    let floats = 11 + Gaussians::zeroed(0, header.sh_degree).sh_stride() as u64;
    check_allowance(source.name(), "numPoints", source.len(), Some(header.count as u64 * floats * 4))?;
    // Unpacking is one stream, or one that is much longer than the others, and takes most of the time.
    let work = Work::new(2 * (header.count * sizes.total()) as u64, progress);
    let (packed, Extensions { axes, notes }) = unpack(sizes, &work)?;
    let arrays = match &packed {
        Packed::Apart(arrays) => arrays.each_ref().map(Vec::as_slice),
        Packed::Together(bytes) => {
            let mut rest = bytes.as_slice();
            sizes.in_order().map(|size| {
                let (array, others) = rest.split_at(header.count * size);
                rest = others;
                array
            })
        }
    };
    let arrays = Arrays::new(arrays, sizes, header.fractional_bits);
    let mut gaussians = memory::gaussians(source.name(), header.count, header.sh_degree)?;
    gaussians.slots().blocks(BLOCK).into_par_iter().for_each(|(first, mut slots)| {
        arrays.unpack(first, &mut slots);
        work.add(slots.len() * sizes.total());
    });
    Ok(Decoded { axes, notes, ..Decoded::new(gaussians, header.opacity_mode) })
}

fn fill(source: &Source<'_>, gzip: &mut impl Read, buffer: &mut [u8], field: &str) -> Result<(), LoadError> {
    let result = gzip.read_exact(buffer);
    result.map_err(|error| {
        unreadable(source, field, format!("{} more bytes of gzip data", buffer.len()), error)
    })
}

fn unreadable(source: &Source<'_>, field: &str, expected: String, error: std::io::Error) -> LoadError {
    match error.kind() {
        std::io::ErrorKind::UnexpectedEof
        | std::io::ErrorKind::InvalidInput
        | std::io::ErrorKind::InvalidData => {
            LoadError::invalid(source.name(), field, expected, error.to_string())
        }
        _ => LoadError::Io { file: source.name().to_owned(), source: error },
    }
}

/// Reads what follows the `total` bytes of the arrays, to the end: only there does gzip compare its checksum, and only
/// there does it show that the header states another count, degree or version than the file has.
///
/// Nothing follows, except where the header has the flag for it: then extensions of vendors do.
fn read_rest(
    source: &Source<'_>,
    gzip: &mut impl Read,
    header: &Header,
    total: usize,
) -> Result<Extensions, LoadError> {
    let Header { version, count, sh_degree, is_extended, .. } = *header;
    let most = if is_extended { MOST_BYTES } else { 0 };
    let end = "a whole gzip stream with its checksum".to_owned();
    let mut rest = Vec::new();
    gzip.take(most as u64 + 1)
        .read_to_end(&mut rest)
        .map_err(|error| unreadable(source, "end", end, error))?;
    if rest.len() > most {
        let expected = match is_extended {
            true => format!("at most {most} bytes of extensions"),
            false => format!(
                "{total} bytes for the {count} Gaussians of degree {sh_degree} of a file of version {version}"
            ),
        };
        return Err(LoadError::invalid(source.name(), "arrays", expected, "more"));
    }
    Extensions::read(source.name(), &rest)
}

impl Header {
    /// The first bytes of a file of one of `versions`.
    fn parse(
        file: &str,
        head: &[u8; HEADER],
        versions: std::ops::RangeInclusive<u32>,
    ) -> Result<Self, LoadError> {
        let word = |at: usize| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]);
        let invalid = |field: &str, expected: &str, actual: u32| {
            Err(LoadError::invalid(file, field, expected, actual.to_string()))
        };
        let (magic, version, count) = (word(0), word(4), word(8));
        let [sh_degree, fractional_bits, flags, _] = [head[12], head[13], head[14], head[15]];
        if magic != MAGIC {
            return Err(LoadError::invalid(file, "magic", "\"NGSP\"", format!("{magic:08x}")));
        }
        if !versions.contains(&version) {
            let expected = if versions.contains(&4) { "4 outside of gzip" } else { "1, 2 or 3 within gzip" };
            return invalid("version", expected, version);
        }
        if sh_degree > MAX_SH_DEGREE {
            return invalid("shDegree", &format!("at most {MAX_SH_DEGREE}"), u32::from(sh_degree));
        }
        if fractional_bits > 24 {
            return invalid("fractionalBits", "at most 24", u32::from(fractional_bits));
        }
        if flags & !(ANTIALIASED | EXTENDED) != 0 {
            return invalid("flags", "0 to 3", u32::from(flags));
        }
        let opacity_mode = match flags & ANTIALIASED {
            0 => OpacityMode::Default,
            _ => OpacityMode::Antialiased,
        };
        let is_extended = flags & EXTENDED != 0;
        Ok(Self { version, count: count as usize, sh_degree, fractional_bits, is_extended, opacity_mode })
    }
}
