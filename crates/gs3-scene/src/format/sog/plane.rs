//! Lossless WebP images as planes of bytes.

use std::io::Cursor;

use image_webp::WebPDecoder;

use super::super::error::LoadError;
use super::super::source::{Source, check_allowance};

/// A decoded image: `width` × `height` pixels of 3 (RGB) or 4 (RGBA) bytes.
pub(super) struct Plane {
    pub(super) width: usize,
    pub(super) height: usize,
    channels: usize,
    bytes: Vec<u8>,
}

impl Plane {
    /// Decodes `source`. `file_bytes`, the size of the whole scene's files, bounds the memory it may take.
    pub(super) fn decode(source: &Source<'_>, file_bytes: u64) -> Result<Self, LoadError> {
        let name = source.name();
        let invalid = |actual: String| LoadError::invalid(name, "image", "a lossless WebP image", actual);
        let bytes = source.bytes()?;
        let mut decoder =
            WebPDecoder::new(Cursor::new(&*bytes)).map_err(|error| invalid(error.to_string()))?;
        if decoder.is_animated() {
            return Err(invalid("an animation".to_owned()));
        }
        if decoder.is_lossy() {
            return Err(invalid("a lossy one (its values are corrupt)".to_owned()));
        }
        let (width, height) = decoder.dimensions();
        let (width, height) = (width as usize, height as usize);
        // The decoder works on four channels even where it gives three.
        let pixels = width as u64 * height as u64;
        check_allowance(name, "image", file_bytes, pixels.checked_mul(4))?;
        let channels = if decoder.has_alpha() { 4 } else { 3 };
        let mut plane = Self { width, height, channels, bytes: vec![0; width * height * channels] };
        decoder.read_image(&mut plane.bytes).map_err(|error| invalid(error.to_string()))?;
        Ok(plane)
    }

    /// The pixel at linear index `i`; alpha is 255 where the image has none.
    pub(super) fn pixel(&self, i: usize) -> [u8; 4] {
        match self.channels {
            4 => {
                let p = &self.bytes[i * 4..i * 4 + 4];
                [p[0], p[1], p[2], p[3]]
            }
            _ => {
                let p = &self.bytes[i * 3..i * 3 + 3];
                [p[0], p[1], p[2], 255]
            }
        }
    }

    /// Refuses an image with fewer pixels than Gaussians.
    pub(super) fn check_holds(&self, name: &str, count: usize) -> Result<(), LoadError> {
        if self.width * self.height < count {
            let actual = format!("{} × {}", self.width, self.height);
            return Err(LoadError::invalid(name, "image size", format!("at least {count} pixels"), actual));
        }
        Ok(())
    }
}
