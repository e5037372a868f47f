//! The size of a picture, from its header.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use crate::size::Size;

/// Segments of a JPEG file that are looked through for its size; real ones have it within the first twenty.
const MOST_SEGMENTS: usize = 1000;

/// The size of the PNG, JPEG or WebP file at `path`, none if it is none of them.
pub(super) fn size(path: &Path) -> Option<Size> {
    // Before opening: opening a pipe would wait for its writer.
    if !path.metadata().is_ok_and(|found| found.is_file()) {
        return None;
    }
    of(&mut BufReader::new(File::open(path).ok()?)).filter(|size| size.width > 0 && size.height > 0)
}

fn of(file: &mut (impl Read + Seek)) -> Option<Size> {
    let mut head = [0; 30];
    let length = file.read(&mut head).ok()?;
    match &head[..length] {
        [0x89, b'P', b'N', b'G', _, _, _, _, _, _, _, _, b'I', b'H', b'D', b'R', size @ ..] => {
            let [width, height] = *size.first_chunk::<8>()?.as_chunks::<4>().0.first_chunk::<2>()?;
            Some(Size::new(u32::from_be_bytes(width), u32::from_be_bytes(height)))
        }
        [0xff, 0xd8, 0xff, ..] => jpeg(file),
        [b'R', b'I', b'F', b'F', _, _, _, _, b'W', b'E', b'B', b'P', ..] => {
            file.seek(SeekFrom::Start(0)).ok()?;
            let mut bytes = Vec::new();
            file.read_to_end(&mut bytes).ok()?;
            image_webp::WebPDecoder::new(std::io::Cursor::new(bytes))
                .ok()
                .map(|decoder| decoder.dimensions().into())
        }
        _ => None,
    }
}

/// The size in the start-of-frame segment.
fn jpeg(file: &mut (impl Read + Seek)) -> Option<Size> {
    file.seek(SeekFrom::Start(2)).ok()?;
    for _ in 0..MOST_SEGMENTS {
        let mut marker = [0; 2];
        file.read_exact(&mut marker).ok()?;
        // Any number of fill bytes may come before a marker.
        while marker[0] == 0xff && marker[1] == 0xff {
            file.read_exact(&mut marker[1..]).ok()?;
        }
        let mut length = [0; 2];
        file.read_exact(&mut length).ok()?;
        // All start-of-frame markers; between them lie tables and reserved ones.
        if marker[0] == 0xff && matches!(marker[1], 0xc0..=0xcf) && !matches!(marker[1], 0xc4 | 0xc8 | 0xcc) {
            let mut frame = [0; 5];
            file.read_exact(&mut frame).ok()?;
            let [_, h1, h0, w1, w0] = frame;
            let [width, height] = [[w1, w0], [h1, h0]].map(u16::from_be_bytes).map(u32::from);
            return Some(Size { width, height });
        }
        let rest = i64::from(u16::from_be_bytes(length)).checked_sub(2).filter(|rest| *rest >= 0)?;
        file.seek(SeekFrom::Current(rest)).ok()?;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    #[test]
    fn sizes_come_from_headers() {
        let mut png = Vec::new();
        let mut encoder = png::Encoder::new(&mut png, 480, 270);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.write_header().unwrap().write_image_data(&[0; 480 * 270]).unwrap();
        assert_eq!(of(&mut Cursor::new(&png)), Some(Size::new(480, 270)));
        let mut webp = Vec::new();
        image_webp::WebPEncoder::new(&mut webp)
            .encode(&[0; 3 * 5 * 3], 5, 3, image_webp::ColorType::Rgb8)
            .unwrap();
        assert_eq!(of(&mut Cursor::new(&webp)), Some(Size::new(5, 3)));
        // An application segment, a table, fill bytes, and a progressive frame.
        let jpeg = [
            &[0xff, 0xd8, 0xff, 0xe0, 0, 4, 1, 2, 0xff, 0xc4, 0, 3, 9, 0xff, 0xff, 0xff, 0xc2, 0, 11, 8][..],
            &[1, 14, 1, 224, 3],
        ]
        .concat();
        assert_eq!(of(&mut Cursor::new(&jpeg)), Some(Size::new(480, 270)));
        for length in 0..jpeg.len() - 1 {
            assert_eq!(of(&mut Cursor::new(&jpeg[..length])), None, "{length}");
        }
    }
}
