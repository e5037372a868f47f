//! Clips to look at.

use gs3::scene::Image;

use super::analytic::{analytic, plane};
use crate::clip::{Clip, ClipFrame, from_unorm};

/// Errors are small: they are shown eight times as large, around grey.
const ERROR_GAIN: f32 = 8.0;

/// Shown side by side: native frame, frame without networks, its uncertainty (its root), its error ×8 around grey, and
/// how much of the last frame's state is valid.
const PICTURES: usize = 5;

/// A picture of a clip, its frames one below the other.
#[must_use]
pub fn preview(clip: &Clip) -> Image {
    let [height, width] = clip.lr.map(|side| side * clip.scale as usize);
    let mut image = Image::new(PICTURES * width, clip.frames.len() * height);
    let rows = image.pixels_mut().chunks_exact_mut(PICTURES * width);
    for (number, row) in rows.enumerate() {
        let (frame, y) = (&clip.frames[number / height], number % height);
        let pictures = Pictures::of(clip, frame, y);
        row.copy_from_slice(&pictures.concat());
    }
    image
}

/// Rows of pictures.
struct Pictures;

impl Pictures {
    /// Row `y` of all pictures of `frame`.
    fn of(clip: &Clip, frame: &ClipFrame, y: usize) -> [Vec<[f32; 4]>; PICTURES] {
        let (scale, width) = (clip.scale as usize, clip.lr[1] * clip.scale as usize);
        let at = y * width..(y + 1) * width;
        let made = &analytic(clip.network, frame)[at.clone()];
        let native: Vec<_> = frame.target.as_chunks::<3>().0[at]
            .iter()
            .map(|rgb| {
                let [r, g, b] = rgb.map(from_unorm);
                [r, g, b, 1.0]
            })
            .collect();
        let gray = |v: f32| [v, v, v, 1.0];
        let error = made
            .iter()
            .zip(&native)
            .map(|(made, native)| std::array::from_fn(|c| 0.5 + ERROR_GAIN * (made[c] - native[c])));
        let validity = &plane(frame, "validity")[y / scale * clip.lr[1]..][..clip.lr[1]];
        [
            made.to_vec(),
            made.iter().map(|p| gray(p[3].max(0.0).sqrt())).collect(),
            error.collect(),
            (0..width).map(|x| gray(validity[x / scale].to_f32())).collect(),
            native,
        ]
    }
}
