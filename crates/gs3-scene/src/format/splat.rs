//! `.splat` (antimatter15): 32 bytes per Gaussian and nothing else.

use std::io::{self, Write};

use rayon::prelude::*;

use super::error::LoadError;
use super::progress::{Progress, Work};
use super::rows::write_rows;
use super::source::Source;
use super::{BLOCK, Decoded, memory};
use crate::gaussians::{SH_C0, Slots};
use crate::scene::{OpacityMode, Scene};

/// Position and linear scale as 3 × f32 each, RGB and opacity as 4 × u8, quaternion (w first) as 4 × u8.
const RECORD: usize = 32;

pub(super) fn read(source: &Source<'_>, progress: Progress<'_>) -> Result<Decoded, LoadError> {
    if !source.len().is_multiple_of(RECORD as u64) {
        let expected = format!("a multiple of {RECORD} bytes");
        return Err(LoadError::invalid(source.name(), "size", expected, source.len().to_string()));
    }
    let count = (source.len() / RECORD as u64) as usize;
    let mut gaussians = memory::gaussians(source.name(), count, 0)?;
    let work = Work::new(count as u64, progress);
    gaussians.slots().blocks(BLOCK).into_par_iter().try_for_each(|(first, mut slots)| {
        let mut bytes = vec![0; slots.len() * RECORD];
        source.read_at((first * RECORD) as u64, &mut bytes, "records")?;
        for (i, record) in bytes.as_chunks::<RECORD>().0.iter().enumerate() {
            unpack(record, i, &mut slots);
        }
        work.add(slots.len());
        Ok::<(), LoadError>(())
    })?;
    Ok(Decoded::new(gaussians, OpacityMode::Default))
}

fn unpack(record: &[u8; RECORD], i: usize, slots: &mut Slots<'_>) {
    let float = |at: usize| f32::from_le_bytes([record[at], record[at + 1], record[at + 2], record[at + 3]]);
    for axis in 0..3 {
        slots.means[axis][i] = float(axis * 4);
        slots.scales[axis][i] = float(12 + axis * 4);
        slots.sh[i * 3 + axis] = (f32::from(record[24 + axis]) / 255.0 - 0.5) / SH_C0;
    }
    slots.opacities[i] = f32::from(record[27]) / 255.0;
    for component in 0..4 {
        slots.rotations[component][i] = (f32::from(record[28 + component]) - 128.0) / 128.0;
    }
}

/// Writes `scene`, with its Gaussians in order. Colours are the view-independent parts.
pub(super) fn write(scene: &Scene, writer: &mut impl Write) -> io::Result<()> {
    let gaussians = scene.gaussians();
    let origin = scene.details().origin;
    write_rows(writer, gaussians.len(), RECORD, |i, row| {
        let (floats, bytes) = row.split_at_mut(24);
        let mean = gaussians.mean(i);
        let position: [f32; 3] = std::array::from_fn(|axis| (f64::from(mean[axis]) + origin[axis]) as f32);
        let values = position.into_iter().chain(gaussians.scale(i));
        for (bytes, value) in floats.as_chunks_mut::<4>().0.iter_mut().zip(values) {
            *bytes = value.to_le_bytes();
        }
        let code = |value: f32| value.round().clamp(0.0, 255.0) as u8;
        for (byte, dc) in bytes[..3].iter_mut().zip(gaussians.sh_of(i)) {
            *byte = code((dc * SH_C0 + 0.5) * 255.0);
        }
        bytes[3] = code(gaussians.opacities[i] * 255.0);
        for (byte, value) in bytes[4..].iter_mut().zip(gaussians.rotation(i)) {
            *byte = code(value * 128.0 + 128.0);
        }
    })
}
