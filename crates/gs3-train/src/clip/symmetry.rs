//! The eight ways to lay a square down: clips mirrored and turned are clips of a mirrored and turned world.

use half::f16;

use super::{Clip, ClipFrame, ClipPlane};

/// A way to lay an image down.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Symmetry {
    /// Rows become columns; before anything is mirrored.
    pub transposed: bool,
    /// Left and right change places.
    pub mirrored_x: bool,
    /// Top and bottom change places.
    pub mirrored_y: bool,
}

/// Planes with x and y parts as channels, and the length of a part: derivatives are RGB each.
const VECTORS: [(&str, usize); 4] = [("gradients", 3), ("compressed", 3), ("jitter", 1), ("motion", 1)];

impl Symmetry {
    /// All eight.
    pub const ALL: [Self; 8] = {
        let mut all = [Self { transposed: false, mirrored_x: false, mirrored_y: false }; 8];
        let mut k = 0;
        while k < 8 {
            all[k] = Self { transposed: k & 1 > 0, mirrored_x: k & 2 > 0, mirrored_y: k & 4 > 0 };
            k += 1;
        }
        all
    };

    /// `clip` laid down so.
    #[must_use]
    pub fn apply(self, clip: Clip) -> Clip {
        if self == Self::default() {
            return clip;
        }
        let (lr, scale) = (clip.lr, clip.scale as usize);
        let hr = lr.map(|side| side * scale);
        let plane = |plane: ClipPlane| {
            let size = if plane.values.len() == lr[0] * lr[1] * plane.channels { lr } else { hr };
            let mut values = self.pixels(&plane.values, size, plane.channels);
            if let Some((_, part)) = VECTORS.iter().find(|(name, _)| *name == plane.name) {
                values.chunks_exact_mut(2 * part).for_each(|pixel| self.turn(pixel));
            }
            ClipPlane { values, ..plane }
        };
        let frame = |frame: ClipFrame| ClipFrame {
            inputs: frame.inputs.into_iter().map(plane).collect(),
            target: self.pixels(&frame.target, hr, 3),
        };
        let frames = clip.frames.into_iter().map(frame).collect();
        Clip { lr: if self.transposed { [lr[1], lr[0]] } else { lr }, frames, ..clip }
    }

    /// The pixels of an image of `[height, width]`, laid down so.
    fn pixels<T: Copy>(self, values: &[T], size: [usize; 2], channels: usize) -> Vec<T> {
        // Pixels of a known size are copied several times as fast.
        match channels {
            1 => self.pixels_of::<T, 1>(values, size),
            2 => self.pixels_of::<T, 2>(values, size),
            3 => self.pixels_of::<T, 3>(values, size),
            4 => self.pixels_of::<T, 4>(values, size),
            6 => self.pixels_of::<T, 6>(values, size),
            _ => self.places(size).flat_map(|k| &values[k * channels..(k + 1) * channels]).copied().collect(),
        }
    }

    fn pixels_of<T: Copy, const N: usize>(self, values: &[T], size: [usize; 2]) -> Vec<T> {
        let pixels = values.as_chunks::<N>().0;
        let mut out = Vec::with_capacity(values.len());
        self.places(size).for_each(|k| out.extend_from_slice(&pixels[k]));
        out
    }

    /// Where the pixels of an image of `[height, width]` come from, row by row.
    fn places(self, [height, width]: [usize; 2]) -> impl Iterator<Item = usize> {
        let [rows, columns] = if self.transposed { [width, height] } else { [height, width] };
        (0..rows).flat_map(move |y| {
            (0..columns).map(move |x| {
                let x = if self.mirrored_x { columns - 1 - x } else { x };
                let y = if self.mirrored_y { rows - 1 - y } else { y };
                if self.transposed { x * width + y } else { y * width + x }
            })
        })
    }

    /// The x and the y part of a vector, laid down so.
    fn turn(self, vector: &mut [f16]) {
        let (x, y) = vector.split_at_mut(vector.len() / 2);
        if self.transposed {
            x.swap_with_slice(y);
        }
        if self.mirrored_x {
            x.iter_mut().for_each(|v| *v = -*v);
        }
        if self.mirrored_y {
            y.iter_mut().for_each(|v| *v = -*v);
        }
    }
}
