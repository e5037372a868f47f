//! Writing SPZ, version 3.

use std::io::{self, Write};

use flate2::Compression;
use flate2::write::GzEncoder;

use super::super::activation::log_scale;
use super::super::atomic::write_rows;
use super::super::quaternion::without_largest;
use super::{ANTIALIASED, COLOR_SCALE, HEADER, MAGIC, POSITION_SIGNS, QUATERNION_SIGNS, SH_SIGNS, Sizes};
use crate::scene::{OpacityMode, Scene};

const VERSION: u32 = 3;

/// Positions are 24-bit fixed-point numbers: at most this, at least its negative.
const LARGEST_FIXED: f64 = ((1 << 23) - 1) as f64;

/// More bits after the binary point than this bring nothing: an f32 has 24 in all.
const MOST_FRACTIONAL_BITS: i32 = 20;

/// Bits after the binary point that keep all positions of `scene` representable with the finest step; the
/// coordinate that is too large where none do.
pub(in super::super) fn fractional_bits(scene: &Scene) -> Result<u8, f32> {
    let means = scene.gaussians().means.iter().flatten();
    let largest = means.fold(0.0f32, |largest, value| largest.max(value.abs()));
    let bits = (LARGEST_FIXED / f64::from(largest.max(f32::MIN_POSITIVE))).log2().floor();
    match bits.min(f64::from(MOST_FRACTIONAL_BITS)) as i32 {
        bits @ 0.. => Ok(bits as u8),
        _ => Err(largest),
    }
}

/// The step that positions with so many bits after the binary point are rounded to, world units.
pub(in super::super) fn step(fractional_bits: u8) -> f32 {
    f32::from(fractional_bits).exp2().recip()
}

/// Writes `scene` with positions of the given [`fractional_bits`]. Higher harmonics keep all 8 bits, where
/// Niantic's encoder rounds them to 5 and 4 for a smaller file; they are cut at ±1.
pub(in super::super) fn write(scene: &Scene, fractional_bits: u8, writer: &mut impl Write) -> io::Result<()> {
    let gaussians = scene.gaussians();
    let sizes = Sizes::new(VERSION, gaussians.sh_degree);
    let count = u32::try_from(gaussians.len()).map_err(io::Error::other)?;
    let mut header = [0; HEADER];
    header[0..4].copy_from_slice(&MAGIC.to_le_bytes());
    header[4..8].copy_from_slice(&VERSION.to_le_bytes());
    header[8..12].copy_from_slice(&count.to_le_bytes());
    header[12] = gaussians.sh_degree;
    header[13] = fractional_bits;
    header[14] = if scene.opacity_mode() == OpacityMode::Antialiased { ANTIALIASED } else { 0 };

    let mut gzip = GzEncoder::new(writer, Compression::default());
    gzip.write_all(&header)?;
    let count = gaussians.len();
    let unit = f64::from(fractional_bits).exp2();
    write_rows(&mut gzip, count, sizes.positions, |i, row| {
        let signed = gaussians.mean(i).into_iter().zip(POSITION_SIGNS).map(|(value, sign)| value * sign);
        for (bytes, value) in row.as_chunks_mut::<3>().0.iter_mut().zip(signed) {
            let fixed = (f64::from(value) * unit).round().clamp(-LARGEST_FIXED, LARGEST_FIXED) as i32;
            let [low, middle, high, _] = fixed.to_le_bytes();
            *bytes = [low, middle, high];
        }
    })?;
    write_rows(&mut gzip, count, sizes.alphas, |i, row| row[0] = code(gaussians.opacities[i] * 255.0))?;
    write_rows(&mut gzip, count, sizes.colors, |i, row| {
        for (byte, dc) in row.iter_mut().zip(gaussians.sh_of(i)) {
            *byte = code((dc * COLOR_SCALE + 0.5) * 255.0);
        }
    })?;
    write_rows(&mut gzip, count, sizes.scales, |i, row| {
        for (byte, scale) in row.iter_mut().zip(gaussians.scale(i)) {
            *byte = code((log_scale(scale) + 10.0) * 16.0);
        }
    })?;
    write_rows(&mut gzip, count, sizes.rotations, |i, row| {
        row.copy_from_slice(&pack_rotation(gaussians.rotation(i)).to_le_bytes());
    })?;
    if sizes.sh > 0 {
        write_rows(&mut gzip, count, sizes.sh, |i, row| {
            for (k, (byte, value)) in row.iter_mut().zip(&gaussians.sh_of(i)[3..]).enumerate() {
                *byte = code(value * SH_SIGNS[1 + k / 3] * 128.0 + 128.0);
            }
        })?;
    }
    gzip.finish()?;
    Ok(())
}

/// The nearest byte.
fn code(value: f32) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}

/// `w, x, y, z` as in the reader's `smallest_three`.
fn pack_rotation(rotation: [f32; 4]) -> u32 {
    let [w, x, y, z]: [f32; 4] = std::array::from_fn(|i| rotation[i] * QUATERNION_SIGNS[i]);
    let (largest, others) = without_largest([x, y, z, w]);
    others.iter().fold(largest as u32, |packed, value| {
        let magnitude = (value.abs() * std::f32::consts::SQRT_2 * 511.0).round().min(511.0) as u32;
        packed << 10 | u32::from(*value < 0.0) << 9 | magnitude
    })
}
