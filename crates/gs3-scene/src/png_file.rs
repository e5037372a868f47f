//! Frames as PNG files.

use std::io::{self, Write};

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
/// What `writer` reports; [`io::ErrorKind::InvalidInput`] where `pixels` are not `width` × `height` × channels.
pub fn write_png(
    writer: impl Write,
    [width, height]: [u32; 2],
    channels: PngChannels,
    pixels: &[u8],
) -> io::Result<()> {
    let mut encoder = png::Encoder::new(writer, width, height);
    encoder.set_color(match channels {
        PngChannels::Rgb => png::ColorType::Rgb,
        PngChannels::Rgba => png::ColorType::Rgba,
    });
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(pixels)?;
    Ok(writer.finish()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_come_back_and_a_wrong_number_is_refused() {
        let pixels: Vec<u8> = (0..24).collect();
        let mut file = Vec::new();
        write_png(&mut file, [4, 2], PngChannels::Rgb, &pixels).unwrap();
        let mut reader = png::Decoder::new(io::Cursor::new(&file)).read_info().unwrap();
        let mut read = vec![0; 24];
        let info = reader.next_frame(&mut read).unwrap();
        assert_eq!(
            (info.width, info.height, info.color_type, read),
            (4, 2, png::ColorType::Rgb, pixels.clone())
        );
        assert!(write_png(Vec::new(), [4, 2], PngChannels::Rgba, &pixels).is_err());
    }
}
