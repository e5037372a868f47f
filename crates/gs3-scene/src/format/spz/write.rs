//! Writing SPZ, versions 3 and 4.

use std::fmt;
use std::io::{self, Seek, SeekFrom, Write};
use std::iter;

use flate2::Compression;
use flate2::write::GzEncoder;
use rayon::prelude::*;
use ruzstd::encoding::{CompressionLevel, compress};

use super::super::activation::log_scale;
use super::super::quaternion::without_largest;
use super::super::rows::{Rows, write_rows};
use super::extensions::axes_record;
use super::{
    ANTIALIASED, COLOR_SCALE, EXTENDED, MAGIC, POSITION_SIGNS, QUATERNION_SIGNS, SH_SIGNS, STREAMS_HEADER,
    Sizes,
};
use crate::axes::Axes;
use crate::gaussians::Gaussians;
use crate::scene::{OpacityMode, Scene};

/// The versions that are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in super::super) enum Version {
    /// One gzip stream; spherical harmonics up to degree 3.
    Three,
    /// A Zstandard frame for each array.
    #[default]
    Four,
}

impl Version {
    /// Its number in files.
    const fn number(self) -> u32 {
        match self {
            Self::Three => 3,
            Self::Four => 4,
        }
    }

    /// The axes that its files are written in, which they state. Programs that do not look take version 3 for what the
    /// specification says, right-up-back, as gs3 does, and version 4 for what its commonest writers, splat-transform and
    /// SuperSplat, make and read: right-down-front.
    const fn axes(self) -> Axes {
        match self {
            Self::Three => Axes::RUB,
            Self::Four => Axes::RDF,
        }
    }

    const fn signs(self) -> Signs {
        match self {
            Self::Three => Signs { positions: POSITION_SIGNS, rotations: QUATERNION_SIGNS, sh: SH_SIGNS },
            Self::Four => Signs { positions: [1.0; 3], rotations: [1.0; 4], sh: [1.0; 25] },
        }
    }

    /// The largest degree of spherical harmonics that it has.
    pub(in super::super) const fn max_sh_degree(self) -> u8 {
        match self {
            Self::Three => 3,
            Self::Four => 4,
        }
    }
}

/// What values are multiplied by to be in a file's axes.
#[derive(Clone, Copy)]
struct Signs {
    positions: [f32; 3],
    /// Of w, x, y, z.
    rotations: [f32; 4],
    sh: [f32; 25],
}

/// Positions are 24-bit fixed-point numbers: at most this, at least its negative.
const LARGEST_FIXED: f64 = ((1 << 23) - 1) as f64;

/// More bits after the binary point than this bring nothing: an f32 has 24 in all.
const MOST_FRACTIONAL_BITS: i32 = 20;

/// Bits after the binary point that keep all positions of `scene` representable with the finest step; the
/// coordinate that is too large where none do.
pub(in super::super) fn fractional_bits(scene: &Scene) -> Result<u8, f64> {
    let origin = scene.details().origin;
    let of_axis = |(axis, plane): (usize, &Vec<f32>)| {
        plane.iter().fold(0.0f64, |largest, value| largest.max((f64::from(*value) + origin[axis]).abs()))
    };
    let largest = scene.gaussians().means.iter().enumerate().map(of_axis).fold(0.0, f64::max);
    let bits = (LARGEST_FIXED / largest.max(f64::from(f32::MIN_POSITIVE))).log2().floor();
    match bits.min(f64::from(MOST_FRACTIONAL_BITS)) as i32 {
        bits @ 0.. => Ok(bits as u8),
        _ => Err(largest),
    }
}

/// The step that positions with so many bits after the binary point are rounded to, world units.
pub(in super::super) fn step(fractional_bits: u8) -> f32 {
    f32::from(fractional_bits).exp2().recip()
}

/// How many Gaussians a file changes beyond rounding, because their values lie outside of what it can hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Clamped {
    /// A scale is larger than the largest, or all three are smaller than the smallest: the Gaussian is shrunk or grown.
    /// One that is merely flatter stays as good as flat.
    pub scales: usize,
    /// A spherical-harmonics coefficient is out of range: the colour is another, from all or some sides.
    pub sh: usize,
}

impl fmt::Display for Clamped {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [smallest, largest] = [0.0, 255.0].map(|code: f32| (code / 16.0 - 10.0).exp());
        let constant = 0.5 / COLOR_SCALE;
        if self.scales > 0 {
            write!(
                f,
                "{} Gaussians are larger than {largest:.0}, or smaller than {smallest:.1e} on every axis",
                self.scales
            )?;
        }
        if self.scales > 0 && self.sh > 0 {
            f.write_str(", and ")?;
        }
        if self.sh > 0 {
            write!(
                f,
                "{} Gaussians have spherical harmonics outside ±1 (constant terms ±{constant:.2})",
                self.sh
            )?;
        }
        f.write_str(": they are cut to that")
    }
}

/// What [`write`] cuts of `scene`.
pub(in super::super) fn clamped(scene: &Scene, version: Version) -> Clamped {
    let (gaussians, signs) = (scene.gaussians(), version.signs());
    let counted = |i| Clamped {
        scales: usize::from(is_scale_clamped(gaussians, i)),
        sh: usize::from(is_sh_clamped(gaussians, i, &signs)),
    };
    let plus = |a: Clamped, b: Clamped| Clamped { scales: a.scales + b.scales, sh: a.sh + b.sh };
    (0..gaussians.len()).into_par_iter().map(counted).reduce(Clamped::default, plus)
}

fn is_scale_clamped(gaussians: &Gaussians, i: usize) -> bool {
    let codes = gaussians.scale(i).map(|scale| scale_code(scale).round());
    codes.iter().any(|code| *code > 255.0) || codes.iter().all(|code| *code < 0.0)
}

fn is_sh_clamped(gaussians: &Gaussians, i: usize, signs: &Signs) -> bool {
    let (constant, rest) = gaussians.sh_of(i).split_at(3);
    let rest = rest.iter().enumerate().map(|(k, value)| sh_code(k, *value, signs));
    let mut codes = constant.iter().map(|dc| color_code(*dc)).chain(rest);
    codes.any(|code| !(0.0..=255.0).contains(&code.round()))
}

/// Writes `scene` with positions of the given [`fractional_bits`], in [`Version::axes`]. The scene's degree is at
/// most the degree of `version`. Higher harmonics keep all 8 bits; Niantic's encoder rounds them to 5 and 4 bits for
/// a smaller file. [`clamped`] reports the values that are cut.
pub(in super::super) fn write(
    scene: &Scene,
    version: Version,
    fractional_bits: u8,
    mut writer: impl Write + Seek + Send,
) -> io::Result<()> {
    let degree = scene.gaussians().sh_degree;
    let sizes = Sizes::new(version.number(), degree);
    let count = u32::try_from(scene.gaussians().len()).map_err(io::Error::other)?;
    let antialiased = if scene.opacity_mode() == OpacityMode::Antialiased { ANTIALIASED } else { 0 };
    let mut header = Vec::with_capacity(STREAMS_HEADER);
    for word in [MAGIC, version.number(), count] {
        header.extend_from_slice(&word.to_le_bytes());
    }
    header.extend_from_slice(&[degree, fractional_bits, antialiased | EXTENDED]);
    let unit = f64::from(fractional_bits).exp2();
    let arrays = Arrays { scene, signs: version.signs(), sizes, unit };
    let extension = axes_record(version.axes());
    match version {
        Version::Three => {
            header.push(0);
            let mut gzip = GzEncoder::new(writer, Compression::default());
            gzip.write_all(&header)?;
            for k in arrays.present() {
                arrays.write(k, &mut gzip)?;
            }
            gzip.write_all(&extension)?;
            gzip.finish()?;
            Ok(())
        }
        Version::Four => {
            let present: Vec<usize> = arrays.present().collect();
            header.push(present.len() as u8);
            let table_start = STREAMS_HEADER + extension.len();
            header.extend_from_slice(&(table_start as u32).to_le_bytes());
            header.resize(STREAMS_HEADER, 0);
            writer.write_all(&header)?;
            writer.write_all(&extension)?;
            let table = writer.stream_position()?;
            writer.write_all(&vec![0; present.len() * 16])?;
            // The first, which is large and of random bits, goes to the file at once, while the others wait in memory.
            let (first, others) = rayon::join(
                || arrays.compress(present[0], &mut writer),
                || {
                    let compressed = present[1..].par_iter().map(|k| {
                        let mut frame = Vec::new();
                        arrays.compress(*k, &mut frame).map(|size| (frame, size))
                    });
                    compressed.collect::<io::Result<Vec<(Vec<u8>, u64)>>>()
                },
            );
            let (first, others) = (first?, others?);
            let end_of_first = writer.stream_position()?;
            others.iter().try_for_each(|(frame, _)| writer.write_all(frame))?;
            let end = writer.stream_position()?;
            writer.seek(SeekFrom::Start(table))?;
            let lengths = others.iter().map(|(frame, size)| (frame.len() as u64, *size));
            for (length, size) in
                iter::once((end_of_first - table - 16 * present.len() as u64, first)).chain(lengths)
            {
                writer.write_all(&length.to_le_bytes())?;
                writer.write_all(&size.to_le_bytes())?;
            }
            writer.seek(SeekFrom::Start(end))?;
            Ok(())
        }
    }
}

/// What the compressor writes to: it panics where it cannot write, so the first error waits here.
struct Drain<W> {
    writer: W,
    result: io::Result<()>,
}

impl<W: Write> Write for Drain<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.result.is_ok() {
            self.result = self.writer.write_all(bytes);
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// The arrays of a file.
struct Arrays<'a> {
    scene: &'a Scene,
    signs: Signs,
    sizes: Sizes,
    /// Steps of positions in a world unit.
    unit: f64,
}

impl Arrays<'_> {
    /// The extensions that have bytes, by their place in the file.
    fn present(&self) -> impl Iterator<Item = usize> {
        let sizes = self.sizes.in_order();
        (0..sizes.len()).filter(move |k| sizes[*k] > 0)
    }

    /// Writes the array at place `k`.
    fn write(&self, k: usize, writer: &mut impl Write) -> io::Result<()> {
        let size = self.sizes.in_order()[k];
        write_rows(writer, self.scene.gaussians().len(), size, |i, row| self.pack(k, i, row))
    }

    /// Writes the array at place `k` as a Zstandard frame, and gives its size before.
    fn compress(&self, k: usize, writer: impl Write) -> io::Result<u64> {
        let (count, size) = (self.scene.gaussians().len(), self.sizes.in_order()[k]);
        let mut drain = Drain { writer, result: Ok(()) };
        compress(
            Rows::new(count, size, |i, row| self.pack(k, i, row)),
            &mut drain,
            CompressionLevel::Fastest,
        );
        drain.result.map(|()| (count * size) as u64)
    }

    /// The row of Gaussian `i` in the array at place `k`.
    fn pack(&self, k: usize, i: usize, row: &mut [u8]) {
        let gaussians = self.scene.gaussians();
        match k {
            0 => self.pack_position(gaussians.mean(i), row),
            1 => row[0] = code(gaussians.opacities[i] * 255.0),
            2 => {
                for (byte, dc) in row.iter_mut().zip(gaussians.sh_of(i)) {
                    *byte = code(color_code(*dc));
                }
            }
            3 => {
                for (byte, scale) in row.iter_mut().zip(gaussians.scale(i)) {
                    *byte = code(scale_code(scale));
                }
            }
            4 => row.copy_from_slice(&pack_rotation(gaussians.rotation(i), &self.signs).to_le_bytes()),
            _ => {
                for (k, (byte, value)) in row.iter_mut().zip(&gaussians.sh_of(i)[3..]).enumerate() {
                    *byte = code(sh_code(k, *value, &self.signs));
                }
            }
        }
    }

    fn pack_position(&self, mean: [f32; 3], row: &mut [u8]) {
        let origin = self.scene.details().origin;
        for (axis, bytes) in row.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let value = (f64::from(mean[axis]) + origin[axis]) * f64::from(self.signs.positions[axis]);
            let fixed = (value * self.unit).round().clamp(-LARGEST_FIXED, LARGEST_FIXED) as i32;
            let [low, middle, high, _] = fixed.to_le_bytes();
            *bytes = [low, middle, high];
        }
    }
}

/// Constant terms, scales and higher coefficients (number `k` of their row), scaled to the range 0 to 255 of a file
/// and rounded.
fn color_code(dc: f32) -> f32 {
    (dc * COLOR_SCALE + 0.5) * 255.0
}

fn scale_code(scale: f32) -> f32 {
    (log_scale(scale) + 10.0) * 16.0
}

fn sh_code(k: usize, value: f32, signs: &Signs) -> f32 {
    value * signs.sh[1 + k / 3] * 128.0 + 128.0
}

/// The nearest byte.
fn code(value: f32) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}

/// `w, x, y, z` as in the reader's `smallest_three`.
fn pack_rotation(rotation: [f32; 4], signs: &Signs) -> u32 {
    let [w, x, y, z]: [f32; 4] = std::array::from_fn(|i| rotation[i] * signs.rotations[i]);
    let (largest, others) = without_largest([x, y, z, w]);
    others.iter().fold(largest as u32, |packed, value| {
        let magnitude = (value.abs() * std::f32::consts::SQRT_2 * 511.0).round().min(511.0) as u32;
        packed << 10 | u32::from(*value < 0.0) << 9 | magnitude
    })
}
