//! Extensions of vendors: records of a type, a length and as many bytes.

use super::super::error::LoadError;
use crate::axes::Axes;
use crate::scene::{AxesKnownBy, FileAxes};

/// Adobe's statement of the axes that the numbers are in.
const AXES: u32 = 0xadbe_0003;

/// Adobe's limits of an orbit, which are for viewers and change no picture.
const SAFE_ORBIT: u32 = 0xadbe_0002;

/// Most bytes of extensions that are read. Published extensions have 4 to 12 bytes each.
pub(super) const MOST_BYTES: usize = 1 << 20;

/// What extensions say.
#[derive(Debug)]
pub(super) struct Extensions {
    pub(super) axes: FileAxes,
    pub(super) notes: Vec<String>,
}

impl Default for Extensions {
    /// Of a file without any.
    fn default() -> Self {
        let axes = FileAxes { axes: Axes::RUB, known_by: AxesKnownBy::Format };
        Self { axes, notes: Vec::new() }
    }
}

impl Extensions {
    /// Of `records`, which is all of them.
    pub(super) fn read(file: &str, mut records: &[u8]) -> Result<Self, LoadError> {
        let mut extensions = Self::default();
        while !records.is_empty() {
            let record = records.split_first_chunk::<8>().and_then(|([a, b, c, d, length @ ..], rest)| {
                let (payload, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
                Some((u32::from_le_bytes([*a, *b, *c, *d]), payload, rest))
            });
            let Some((kind, payload, rest)) = record else {
                let actual = format!("{} bytes that are none", records.len());
                return Err(LoadError::invalid(file, "extensions", "a type, a length and its bytes", actual));
            };
            match kind {
                AXES => extensions.state_axes(file, payload)?,
                SAFE_ORBIT => {}
                other => extensions.notes.push(format!("extension {other:#010x} not used")),
            }
            records = rest;
        }
        Ok(extensions)
    }

    fn state_axes(&mut self, file: &str, payload: &[u8]) -> Result<(), LoadError> {
        let code = payload.try_into().map(u32::from_le_bytes);
        match code.map(|code| (code, Axes::from_code(code))) {
            // Not stated after all.
            Ok((0, _)) => {}
            Ok((_, Some(axes))) => self.axes = FileAxes { axes, known_by: AxesKnownBy::File },
            other => {
                let actual = other.map_or(format!("{} bytes", payload.len()), |(code, _)| code.to_string());
                let expected = "one of 16 coordinate systems, 0 to 16 in 4 bytes";
                return Err(LoadError::invalid(file, "coordinate system", expected, actual));
            }
        }
        Ok(())
    }
}

/// The record that states `axes`.
pub(super) fn axes_record(axes: Axes) -> Vec<u8> {
    let words = [AXES, 4, axes.code().unwrap_or(0)];
    words.into_iter().flat_map(u32::to_le_bytes).collect()
}
