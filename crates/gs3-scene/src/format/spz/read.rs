//! Reading SPZ.

use std::io::Read;

use flate2::read::MultiGzDecoder;
use rayon::prelude::*;

use super::super::error::LoadError;
use super::super::progress::{Progress, Work};
use super::super::quaternion::with_largest;
use super::super::source::{Source, check_allowance};
use super::super::{BLOCK, Decoded};
use super::{
    ANTIALIASED, COLOR_SCALE, EXTENDED, HEADER, MAGIC, POSITION_SIGNS, QUATERNION_SIGNS, SH_SIGNS, Sizes,
};
use crate::gaussians::{Gaussians, MAX_SH_DEGREE, Slots};
use crate::scene::OpacityMode;

/// Bytes unpacked at once.
const UNPACK_BYTES: usize = 1 << 20;

/// Bytes of extensions that are read at most. Those that are published have 4 to 12 each.
const MOST_EXTENSION_BYTES: usize = 1 << 20;

/// The extension by which Adobe states other axes than those of the format, and its values for these: not stated, and
/// right-up-back.
const AXES_EXTENSION: u32 = 0xadbe_0003;
const USUAL_AXES: [u32; 2] = [0, 4];

struct Header {
    version: u32,
    count: usize,
    sh_degree: u8,
    /// Bits after the binary point of positions.
    fractional_bits: u8,
    /// Whether extensions follow the arrays.
    is_extended: bool,
    opacity_mode: OpacityMode,
}

/// Reads versions 2 and 3.
pub(in super::super) fn read(source: &Source<'_>, progress: Progress<'_>) -> Result<Decoded, LoadError> {
    let mut gzip = MultiGzDecoder::new(std::io::BufReader::with_capacity(1 << 16, source.cursor()));
    let mut head = [0; HEADER];
    fill(source, &mut gzip, &mut head, "header")?;
    let header = Header::parse(source.name(), &head)?;
    let sizes = Sizes::new(header.version, header.sh_degree);

    let mut gaussians = Gaussians::zeroed(0, header.sh_degree);
    // Both products fit 64 bits: the count has 32.
    let floats = 11 + gaussians.sh_stride() as u64;
    check_allowance(source.name(), "numPoints", source.len(), Some(header.count as u64 * floats * 4))?;
    let total = header.count * sizes.total();

    // Unpacking is one stream and takes most of the time; the decoding that follows uses all cores.
    let work = Work::new(2 * total as u64, progress);
    let mut bytes = Vec::new();
    while bytes.len() < total {
        let start = bytes.len();
        bytes.resize((start + UNPACK_BYTES).min(total), 0);
        fill(source, &mut gzip, &mut bytes[start..], "arrays")?;
        work.add(bytes.len() - start);
    }
    check_rest(source, &mut gzip, &header, total)?;
    gaussians = Gaussians::zeroed(header.count, header.sh_degree);
    let arrays = Arrays::split(&bytes, header.count, sizes);
    gaussians.slots().blocks(BLOCK).into_par_iter().for_each(|(first, mut slots)| {
        for i in 0..slots.len() {
            arrays.unpack(&header, sizes, first + i, i, &mut slots);
        }
        work.add(slots.len() * sizes.total());
    });
    Ok((gaussians, header.opacity_mode))
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
/// Nothing follows, except where the header has the flag for it: then extensions of vendors do, each a type, a length
/// and as many bytes. They are for viewers, such as limits of an orbit, and are skipped as in Niantic's reader, all but
/// one.
fn check_rest(
    source: &Source<'_>,
    gzip: &mut impl Read,
    header: &Header,
    total: usize,
) -> Result<(), LoadError> {
    let Header { version, count, sh_degree, is_extended, .. } = *header;
    let most = if is_extended { MOST_EXTENSION_BYTES } else { 0 };
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
    check_extensions(source, &rest)
}

/// Whether `records` are extensions under which the arrays mean what they always mean.
fn check_extensions(source: &Source<'_>, mut records: &[u8]) -> Result<(), LoadError> {
    while !records.is_empty() {
        let record = records.split_first_chunk::<8>().and_then(|([a, b, c, d, length @ ..], rest)| {
            let (payload, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
            Some((u32::from_le_bytes([*a, *b, *c, *d]), payload, rest))
        });
        let Some((kind, payload, rest)) = record else {
            let actual = format!("{} bytes that are none", records.len());
            return Err(LoadError::invalid(
                source.name(),
                "extensions",
                "a type, a length and its bytes",
                actual,
            ));
        };
        let axes = payload.try_into().map(u32::from_le_bytes);
        if kind == AXES_EXTENSION && !axes.is_ok_and(|axes| USUAL_AXES.contains(&axes)) {
            let actual = axes.map_or(format!("{} bytes", payload.len()), |axes| axes.to_string());
            let expected = "right-up-back (0 or 4)";
            return Err(LoadError::invalid(source.name(), "coordinate system", expected, actual));
        }
        records = rest;
    }
    Ok(())
}

impl Header {
    fn parse(file: &str, head: &[u8; HEADER]) -> Result<Self, LoadError> {
        let word = |at: usize| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]);
        let invalid = |field: &str, expected: &str, actual: u32| {
            Err(LoadError::invalid(file, field, expected, actual.to_string()))
        };
        let (magic, version, count) = (word(0), word(4), word(8));
        let [sh_degree, fractional_bits, flags, _reserved] = [head[12], head[13], head[14], head[15]];
        if magic != MAGIC {
            return Err(LoadError::invalid(file, "magic", "\"NGSP\"", format!("{magic:08x}")));
        }
        if !(2..=3).contains(&version) {
            return invalid("version", "2 or 3", version);
        }
        if sh_degree > MAX_SH_DEGREE {
            return invalid("shDegree", "at most 3", u32::from(sh_degree));
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

/// The attributes of all Gaussians, one array after another.
struct Arrays<'a> {
    positions: &'a [u8],
    alphas: &'a [u8],
    colors: &'a [u8],
    scales: &'a [u8],
    rotations: &'a [u8],
    sh: &'a [u8],
}

impl<'a> Arrays<'a> {
    /// `bytes` has `count` × the total of `sizes`.
    fn split(bytes: &'a [u8], count: usize, sizes: Sizes) -> Self {
        let mut rest = bytes;
        let mut take = |size: usize| {
            let (array, others) = rest.split_at(count * size);
            rest = others;
            array
        };
        Self {
            positions: take(sizes.positions),
            alphas: take(sizes.alphas),
            colors: take(sizes.colors),
            scales: take(sizes.scales),
            rotations: take(sizes.rotations),
            sh: take(sizes.sh),
        }
    }

    /// Unpacks Gaussian `from` of the file into slot `to`.
    fn unpack(&self, header: &Header, sizes: Sizes, from: usize, to: usize, slots: &mut Slots<'_>) {
        let of = |array: &'a [u8], size: usize| &array[from * size..(from + 1) * size];
        let unit = f64::from(header.fractional_bits).exp2().recip();
        let sh = &mut slots.sh[to * slots.sh_stride..(to + 1) * slots.sh_stride];
        let (positions, scales) = (of(self.positions, sizes.positions), of(self.scales, sizes.scales));
        for axis in 0..3 {
            let [low, middle, high] = [positions[axis * 3], positions[axis * 3 + 1], positions[axis * 3 + 2]];
            // In the upper three bytes, so that the shift back extends the sign.
            let fixed = i32::from_le_bytes([0, low, middle, high]) >> 8;
            slots.means[axis][to] = (f64::from(fixed) * unit) as f32 * POSITION_SIGNS[axis];
            slots.scales[axis][to] = (f32::from(scales[axis]) / 16.0 - 10.0).exp();
            let color = f32::from(of(self.colors, sizes.colors)[axis]);
            sh[axis] = (color / 255.0 - 0.5) / COLOR_SCALE;
        }
        slots.opacities[to] = f32::from(self.alphas[from]) / 255.0;
        let rotation = match *of(self.rotations, sizes.rotations) {
            [x, y, z] => first_three([x, y, z]),
            [a, b, c, d] => smallest_three(u32::from_le_bytes([a, b, c, d])),
            _ => [0.0; 4],
        };
        for component in 0..4 {
            slots.rotations[component][to] = rotation[component] * QUATERNION_SIGNS[component];
        }
        for (i, code) in of(self.sh, sizes.sh).iter().enumerate() {
            sh[3 + i] = (f32::from(*code) - 128.0) / 128.0 * SH_SIGNS[1 + i / 3];
        }
    }
}

/// Version 2: x, y, z as bytes, w not negative. Result in the order w, x, y, z.
fn first_three(xyz: [u8; 3]) -> [f32; 4] {
    with_largest(0, xyz.map(|v| f32::from(v) / 127.5 - 1.0))
}

/// Version 3: the index of the largest component (x, y, z, w) in the top two bits, then the others, each a
/// sign bit and 9 bits of magnitude up to √½. Result in the order w, x, y, z.
fn smallest_three(packed: u32) -> [f32; 4] {
    let component = |shift: u32| {
        let bits = packed >> shift;
        let magnitude = (bits & 511) as f32 / 511.0 * std::f32::consts::FRAC_1_SQRT_2;
        if bits & 512 == 0 { magnitude } else { -magnitude }
    };
    let [x, y, z, w] = with_largest((packed >> 30) as usize, [component(20), component(10), component(0)]);
    [w, x, y, z]
}
