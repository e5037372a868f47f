//! Lossless WebP and PNG images as planes of bytes.

use std::io::Cursor;

use image_webp::WebPDecoder;

use super::super::error::LoadError;
use super::super::source::{Source, allowance, check_allowance};

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
        let invalid = |actual: String| {
            LoadError::invalid(name, "image", "a lossless WebP or a PNG image of 8 bits", actual)
        };
        let bytes = source.bytes()?;
        if bytes.starts_with(b"\x89PNG") {
            return Self::decode_png(name, &bytes, file_bytes);
        }
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

    /// The same for a PNG image; palettes and grey become RGB.
    fn decode_png(name: &str, bytes: &[u8], file_bytes: u64) -> Result<Self, LoadError> {
        let invalid = |actual: String| LoadError::invalid(name, "image", "a PNG image of 8 bits", actual);
        let limits = png::Limits { bytes: usize::try_from(allowance(file_bytes)).unwrap_or(usize::MAX) };
        let mut decoder = png::Decoder::new_with_limits(Cursor::new(bytes), limits);
        decoder.set_transformations(png::Transformations::EXPAND);
        let mut reader = decoder.read_info().map_err(|error| invalid(error.to_string()))?;
        let (width, height) = reader.info().size();
        if reader.info().bit_depth == png::BitDepth::Sixteen {
            return Err(invalid("16 bits".to_owned()));
        }
        let pixels = u64::from(width) * u64::from(height);
        check_allowance(name, "image", file_bytes, pixels.checked_mul(4))?;
        let size = reader.output_buffer_size().ok_or_else(|| invalid("one that is too large".to_owned()))?;
        let mut raw = vec![0; size];
        let frame = reader.next_frame(&mut raw).map_err(|error| invalid(error.to_string()))?;
        raw.truncate(frame.buffer_size());
        let (channels, bytes) = match frame.color_type {
            png::ColorType::Rgba => (4, raw),
            png::ColorType::GrayscaleAlpha => (
                4,
                raw.as_chunks()
                    .0
                    .iter()
                    .flat_map(|[grey, alpha]: &[u8; 2]| [*grey, *grey, *grey, *alpha])
                    .collect(),
            ),
            png::ColorType::Grayscale => (3, raw.iter().flat_map(|grey| [*grey; 3]).collect()),
            _ => (3, raw),
        };
        Ok(Self { width: width as usize, height: height as usize, channels, bytes })
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
