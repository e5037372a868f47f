//! COLMAP's text files: one camera a line; two lines an image, the second with its observed points.

use std::str::{FromStr, SplitAsciiWhitespace};

use crate::format::quoted;

use super::{CamerasById, CaptureFault, PosedImage, intrinsics, parameter_count};

pub fn cameras(bytes: &[u8]) -> Result<CamerasById, CaptureFault> {
    let text = String::from_utf8_lossy(bytes);
    let mut cameras = CamerasById::new();
    for (number, line) in lines(&text).filter(|(_, line)| !line.is_empty()) {
        let mut words = Words { field: format!("line {number}"), words: line.split_ascii_whitespace() };
        let id = words.next("the camera's id")?;
        let model: String = words.next("a camera model")?;
        let size = [words.next("the width in pixels")?, words.next("the height in pixels")?];
        let parameters = (0..parameter_count(&format!("{} model", words.field), &model)?)
            .map(|_| words.next("a camera parameter"))
            .collect::<Result<Vec<f64>, _>>()?;
        cameras.insert(id, intrinsics(&words.field, size, &parameters)?);
    }
    Ok(cameras)
}

pub fn images(bytes: &[u8]) -> Result<Vec<PosedImage>, CaptureFault> {
    let text = String::from_utf8_lossy(bytes);
    let mut images = Vec::new();
    let mut lines = lines(&text);
    while let Some((number, line)) = lines.next() {
        // Only between images: the second line of an image without observed points is empty, too.
        if line.is_empty() {
            continue;
        }
        let field = format!("line {number}");
        let mut words = Words { field: field.clone(), words: line.split_ascii_whitespace() };
        words.next::<u32>("the image's id")?;
        let mut rotation = [0.0; 4];
        for value in &mut rotation {
            *value = words.next("a quaternion")?;
        }
        let mut translation = [0.0; 3];
        for value in &mut translation {
            *value = words.next("a translation")?;
        }
        let camera_id = words.next("a camera id")?;
        // Names may hold blanks: the rest of the line.
        let name = words.words.collect::<Vec<_>>().join(" ");
        if name.is_empty() {
            return Err(CaptureFault::field(&field, "an image name", "nothing"));
        }
        lines.next();
        images.push(PosedImage { field, name, camera_id, rotation, translation });
    }
    Ok(images)
}

/// Numbered lines without comments.
fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let numbered = text.lines().enumerate().map(|(i, line)| (i + 1, line.trim()));
    numbered.filter(|(_, line)| !line.starts_with('#'))
}

struct Words<'a> {
    field: String,
    words: SplitAsciiWhitespace<'a>,
}

impl Words<'_> {
    fn next<T: FromStr>(&mut self, expected: &str) -> Result<T, CaptureFault> {
        let word = self.words.next().ok_or_else(|| CaptureFault::field(&self.field, expected, "nothing"))?;
        word.parse().map_err(|_| CaptureFault::field(&self.field, expected, quoted(word)))
    }
}
