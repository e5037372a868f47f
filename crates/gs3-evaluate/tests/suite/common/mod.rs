//! Test images.

use std::path::PathBuf;

use gs3_scene::{GBuffer, Image, Planes};

/// Path of a file in `tests/data`.
pub fn data(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

/// An 8-bit RGB PNG of `tests/data` as an image.
pub fn image(name: &str) -> Image {
    let file = std::io::BufReader::new(std::fs::File::open(data(name)).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    assert_eq!((info.color_type, info.bit_depth), (png::ColorType::Rgb, png::BitDepth::Eight));
    let pixels = bytes
        .chunks_exact(3)
        .map(|p| [p[0], p[1], p[2]].map(|v| f32::from(v) / 255.0))
        .map(|[r, g, b]| [r, g, b, 1.0]);
    Image::from_pixels(info.width as usize, info.height as usize, pixels.collect()).unwrap()
}

/// The part of `image` that starts at `(left, top)`.
#[allow(dead_code, reason = "not every test binary crops")]
pub fn crop(image: &Image, left: usize, top: usize, width: usize, height: usize) -> Image {
    let pixels = (top..top + height).flat_map(|y| image.row(y)[left..left + width].to_vec()).collect();
    Image::from_pixels(width, height, pixels).unwrap()
}

/// A G-buffer that holds an image as its colour.
#[allow(dead_code, reason = "not every test binary upscales")]
pub fn gbuffer(image: &Image) -> GBuffer {
    let (width, height) = (image.width(), image.height());
    let mut lr = GBuffer {
        color: Planes::new(width, height),
        alpha: Planes::new(width, height),
        ..GBuffer::default()
    };
    for c in 0..3 {
        let plane = &mut lr.color.data_mut()[c * width * height..][..width * height];
        plane.iter_mut().zip(image.pixels()).for_each(|(to, from)| *to = from[c]);
    }
    lr
}
