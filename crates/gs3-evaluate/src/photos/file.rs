//! Photos as files: PNG and JPEG.

use std::io::Cursor;
use std::path::Path;

use gs3_files::read_within;
use gs3_scene::camera::MAX_SIDE;
use gs3_scene::{Image, Size};
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use super::PhotoError;

/// The first bytes of JPEG files: start of image, and of the next marker.
const JPEG: [u8; 3] = [0xff, 0xd8, 0xff];

/// Bytes of a photo at most: 8,192×8,192 pixels of four 16-bit values, twice.
const MAX_BYTES: u64 = 1 << 30;

/// The size of the photo at `path`, from its header.
pub(super) fn size(path: &Path) -> Result<Size, PhotoError> {
    let bytes = read_bytes(path)?;
    if bytes.starts_with(&JPEG) {
        jpeg_size(&bytes)
    } else {
        png_reader(&bytes).map(|r| r.info().size().into())
    }
    .map_err(|message| decode_error(path, message))
}

/// The photo at `path`: display-encoded RGB in `[0, 1]` at 8 bits, fourth channel 1. Transparent pixels show
/// `background`, 16-bit values lose their low byte, grey becomes RGB; orientation tags and colour profiles are not
/// read.
pub(super) fn read(path: &Path, background: [f32; 3]) -> Result<Image, PhotoError> {
    let bytes = read_bytes(path)?;
    if bytes.starts_with(&JPEG) { read_jpeg(&bytes) } else { read_png(&bytes, background) }
        .map_err(|message| decode_error(path, message))
}

fn read_bytes(path: &Path) -> Result<Vec<u8>, PhotoError> {
    read_within(path, MAX_BYTES).map_err(|source| PhotoError::Read { path: path.into(), source })
}

fn decode_error(path: &Path, message: String) -> PhotoError {
    PhotoError::Decode { path: path.into(), message }
}

/// A reader at the first frame of an image with sides that cameras can have. This bounds the memory that is
/// allocated.
fn png_reader(bytes: &[u8]) -> Result<png::Reader<Cursor<&[u8]>>, String> {
    let mut decoder = png::Decoder::new(Cursor::new(bytes));
    decoder.set_transformations(png::Transformations::normalize_to_color8());
    let reader = decoder.read_info().map_err(|e| e.to_string())?;
    let (width, height) = reader.info().size();
    if width > MAX_SIDE || height > MAX_SIDE {
        return Err(format!("expected sides up to {MAX_SIDE}, found {width}x{height}"));
    }
    Ok(reader)
}

fn read_png(bytes: &[u8], background: [f32; 3]) -> Result<Image, String> {
    let mut reader = png_reader(bytes)?;
    let mut data = vec![0; reader.output_buffer_size().ok_or("too large")?];
    let info = reader.next_frame(&mut data).map_err(|e| e.to_string())?;
    let channels = info.color_type.samples();
    let pixel = |p: &[u8]| match *p {
        [v] => over([v; 3], 255, background),
        [v, a] => over([v; 3], a, background),
        [r, g, b] => over([r, g, b], 255, background),
        [r, g, b, a, ..] => over([r, g, b], a, background),
        [] => [0.0; 4],
    };
    let pixels = data[..info.buffer_size()].chunks_exact(channels).map(pixel).collect();
    Image::from_pixels(info.width as usize, info.height as usize, pixels)
        .ok_or_else(|| "a frame smaller than the image".into())
}

/// `color` of opacity `alpha` over `background`.
fn over(color: [u8; 3], alpha: u8, background: [f32; 3]) -> [f32; 4] {
    let alpha = f32::from(alpha) / 255.0;
    let [r, g, b] = [0, 1, 2].map(|c| f32::from(color[c]) / 255.0 * alpha + background[c] * (1.0 - alpha));
    [r, g, b, 1.0]
}

/// A decoder to RGB that takes only whole files.
fn jpeg_decoder(bytes: &[u8]) -> JpegDecoder<ZCursor<&[u8]>> {
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .set_max_width(MAX_SIDE as usize)
        .set_max_height(MAX_SIDE as usize)
        .jpeg_set_out_colorspace(ColorSpace::RGB);
    JpegDecoder::new_with_options(ZCursor::new(bytes), options)
}

fn jpeg_size(bytes: &[u8]) -> Result<Size, String> {
    let mut decoder = jpeg_decoder(bytes);
    decoder.decode_headers().map_err(|e| e.to_string())?;
    let (width, height) = decoder.dimensions().ok_or("no size in its header")?;
    Ok(Size::of(width, height))
}

fn read_jpeg(bytes: &[u8]) -> Result<Image, String> {
    let mut decoder = jpeg_decoder(bytes);
    let data = decoder.decode().map_err(|e| e.to_string())?;
    let (width, height) = decoder.dimensions().ok_or("no size in its header")?;
    let pixels = data.as_chunks().0.iter().map(|p: &[u8; 3]| over(*p, 255, [0.0; 3])).collect();
    Image::from_pixels(width, height, pixels).ok_or_else(|| "an unexpected number of values".into())
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::fs;

    use super::*;
    use crate::metrics::{Quantisation, psnr};

    fn data(name: &str) -> std::path::PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
    }

    #[test]
    fn jpeg_shows_what_png_does() {
        // Pillow wrote the JPEG file from the PNG one: quality 95, chroma at half resolution.
        let [png, jpeg] =
            ["coffee_test.png", "coffee_test.jpg"].map(|name| read(&data(name), [0.0; 3]).unwrap());
        assert_eq!(size(&data("coffee_test.jpg")).unwrap(), png.size());
        let psnr = psnr(&png, &jpeg, Quantisation::None).unwrap();
        assert!(psnr > 35.0, "{psnr}");
    }

    #[test]
    fn every_kind_of_png_becomes_rgb_over_the_background() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("photo.png");
        let write = |color, depth, data: &[u8]| {
            let mut encoder = png::Encoder::new(fs::File::create(&path).unwrap(), 1, 1);
            encoder.set_color(color);
            encoder.set_depth(depth);
            encoder.write_header().unwrap().write_image_data(data).unwrap();
            read(&path, [1.0, 0.0, 0.0]).unwrap().pixels()[0].map(|v| (v * 255.0).round() as u8)
        };
        use png::{BitDepth, ColorType};
        assert_eq!(write(ColorType::Rgb, BitDepth::Eight, &[10, 20, 30]), [10, 20, 30, 255]);
        assert_eq!(write(ColorType::Rgba, BitDepth::Eight, &[10, 20, 30, 0]), [255, 0, 0, 255]);
        assert_eq!(write(ColorType::Rgba, BitDepth::Eight, &[0, 200, 100, 51]), [204, 40, 20, 255]);
        assert_eq!(write(ColorType::Grayscale, BitDepth::Eight, &[7]), [7, 7, 7, 255]);
        assert_eq!(write(ColorType::GrayscaleAlpha, BitDepth::Eight, &[7, 255]), [7, 7, 7, 255]);
        assert_eq!(write(ColorType::Rgb, BitDepth::Sixteen, &[10, 99, 20, 0, 30, 1]), [10, 20, 30, 255]);
    }

    #[test]
    fn damaged_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("photo");
        for name in ["coffee_test.png", "coffee_test.jpg"] {
            let whole = fs::read(data(name)).unwrap();
            for length in [0, 2, 20, whole.len() / 2] {
                fs::write(&path, &whole[..length]).unwrap();
                let result = read(&path, [0.0; 3]);
                assert!(matches!(result, Err(PhotoError::Decode { .. })), "{name} cut to {length}");
            }
        }
        assert!(matches!(size(&folder.path().join("none")), Err(PhotoError::Read { .. })));
    }
}
