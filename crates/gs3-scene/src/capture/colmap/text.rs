//! COLMAP's text files: one camera a line; two lines an image, the second with its observed points.

use std::str::{FromStr, SplitAsciiWhitespace};

use crate::format::quoted;

use super::{Calibration, CamerasById, CaptureFault, PosedImage, calibration, parameter_count};

pub fn cameras(bytes: &[u8]) -> Result<CamerasById, CaptureFault> {
    let text = String::from_utf8_lossy(bytes);
    let mut cameras = CamerasById::new();
    for (number, line) in lines(&text).filter(|(_, line)| !line.is_empty()) {
        let mut words = Words { field: format!("line {number}"), words: line.split_ascii_whitespace() };
        let id = words.next("the camera's id")?;
        cameras.insert(id, camera(words));
    }
    Ok(cameras)
}

/// What follows the id of a camera.
fn camera(mut words: Words<'_>) -> Result<Calibration, CaptureFault> {
    let model: String = words.next("a camera model")?;
    let size = [words.next("the width in pixels")?, words.next("the height in pixels")?];
    let parameters = (0..parameter_count(&format!("{} model", words.field), &model)?)
        .map(|_| words.next("a camera parameter"))
        .collect::<Result<Vec<f64>, _>>()?;
    calibration(&words.field, &model, size, &parameters)
}

/// Images, whether each is followed by its line of observed points, as COLMAP writes them, or none is, as some programs
/// do: a line of points has a multiple of three numbers, and one of an image nine words and a name.
pub fn images(bytes: &[u8]) -> Result<Vec<PosedImage>, CaptureFault> {
    let text = String::from_utf8_lossy(bytes);
    let mut images = Vec::new();
    let mut may_be_points = false;
    for (number, line) in lines(&text) {
        // Between images, or the second line of an image without observed points.
        if line.is_empty() {
            may_be_points = false;
            continue;
        }
        if may_be_points && is_points(line) {
            may_be_points = false;
            continue;
        }
        images.push(image(number, line)?);
        may_be_points = true;
    }
    Ok(images)
}

/// Whether `line` has observed points: x, y and the number of a point, −1 for none, again and again. A line of an image
/// that is one word too long for that has a name that is a whole number.
fn is_points(line: &str) -> bool {
    let mut words = line.split_ascii_whitespace();
    let mut count = 0;
    while let (Some(x), rest) = (words.next(), [words.next(), words.next()]) {
        let [Some(y), Some(id)] = rest else { return false };
        let is_number = |word: &str| word.parse::<f64>().is_ok();
        if !(is_number(x) && is_number(y) && id.parse::<i64>().is_ok()) {
            return false;
        }
        count += 1;
    }
    count > 0
}

fn image(number: usize, line: &str) -> Result<PosedImage, CaptureFault> {
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
    let name = after_words(line, 9);
    if name.is_empty() {
        return Err(CaptureFault::field(&field, "an image name", "nothing"));
    }
    Ok(PosedImage { field, name: name.to_owned(), camera_id, rotation, translation })
}

/// What follows the first `count` words of `line`: a name, which may hold blanks, also several in a row.
fn after_words(line: &str, count: usize) -> &str {
    (0..count).fold(line.trim_start(), |rest, _| {
        let end = rest.find(|c: char| c.is_ascii_whitespace()).unwrap_or(rest.len());
        rest[end..].trim_start()
    })
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
