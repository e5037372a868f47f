//! Frames as PNG files.

use std::io::{self, Write};

use crate::size::Size;

/// Channels of 8-bit pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PngChannels {
    /// Red, green, blue.
    Rgb,
    /// The same and straight alpha.
    Rgba,
}

/// Writes rows of 8-bit pixels, sRGB without gaps, as a PNG file. The same pixels give the same bytes.
///
/// # Errors
/// What `writer` reports; [`io::ErrorKind::InvalidInput`] where `pixels` are not those of `size` and `channels`.
pub fn write_png(writer: impl Write, size: Size, channels: PngChannels, pixels: &[u8]) -> io::Result<()> {
    let mut writer = header(writer, size, channels)?;
    writer.write_image_data(pixels).map_err(told)?;
    writer.finish().map_err(told)
}

/// As [`write_png`], for images that memory does not hold: `rows` writes the pixels, row by row.
///
/// # Errors
/// What `writer` and `rows` report; [`io::ErrorKind::InvalidInput`] where the pixels are not those of `size` and `channels`.
pub fn write_png_rows(
    writer: impl Write,
    size: Size,
    channels: PngChannels,
    rows: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    let mut writer = header(writer, size, channels)?;
    let mut stream = writer.stream_writer_with_size(CHUNK_BYTES).map_err(told)?;
    rows(&mut stream)?;
    stream.finish().map_err(told)?;
    writer.finish().map_err(told)
}

/// Bytes of a chunk of compressed rows: long enough that a chunk's header and checksum are nothing beside it.
const CHUNK_BYTES: usize = 1 << 16;

fn header<W: Write>(writer: W, size: Size, channels: PngChannels) -> io::Result<png::Writer<W>> {
    let mut encoder = png::Encoder::new(writer, size.width, size.height);
    encoder.set_color(match channels {
        PngChannels::Rgb => png::ColorType::Rgb,
        PngChannels::Rgba => png::ColorType::Rgba,
    });
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    encoder.write_header().map_err(told)
}

/// An encoder's error: what the writer said, or that the pixels do not fit the image.
fn told(error: png::EncodingError) -> io::Error {
    match error {
        png::EncodingError::IoError(error) => error,
        other => io::Error::new(io::ErrorKind::InvalidInput, other),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_come_back_and_a_wrong_number_is_refused() {
        let pixels: Vec<u8> = (0..24).collect();
        let mut file = Vec::new();
        write_png(&mut file, Size::new(4, 2), PngChannels::Rgb, &pixels).unwrap();
        let mut reader = png::Decoder::new(io::Cursor::new(&file)).read_info().unwrap();
        let mut read = vec![0; 24];
        let info = reader.next_frame(&mut read).unwrap();
        assert_eq!(
            (info.width, info.height, info.color_type, read),
            (4, 2, png::ColorType::Rgb, pixels.clone())
        );
        let error = write_png(Vec::new(), Size::new(4, 2), PngChannels::Rgba, &pixels).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::InvalidInput, "{error}");
    }

    #[test]
    fn rows_give_the_file_of_the_whole() {
        let pixels: Vec<u8> = (0..=255).cycle().take(3 * 40 * 30).collect();
        let mut whole = Vec::new();
        write_png(&mut whole, Size::new(40, 30), PngChannels::Rgb, &pixels).unwrap();
        let mut rows = Vec::new();
        write_png_rows(&mut rows, Size::new(40, 30), PngChannels::Rgb, |rows| {
            pixels.chunks(3 * 40 * 7).try_for_each(|part| rows.write_all(part))
        })
        .unwrap();
        let decode = |file: &[u8]| {
            let mut reader = png::Decoder::new(io::Cursor::new(file)).read_info().unwrap();
            let mut read = vec![0; 3 * 40 * 30];
            reader.next_frame(&mut read).unwrap();
            reader.finish().unwrap();
            assert_eq!(reader.info().srgb, Some(png::SrgbRenderingIntent::Perceptual));
            read
        };
        assert!(decode(&rows) == pixels && decode(&whole) == pixels);
        // Too few, too many.
        for count in [12, 25] {
            let write = |rows: &mut dyn Write| rows.write_all(&[0; 25][..count]);
            let error = write_png_rows(Vec::new(), Size::new(4, 2), PngChannels::Rgb, write).unwrap_err();
            assert_eq!(error.kind(), io::ErrorKind::InvalidInput, "{count}: {error}");
        }
    }
}
