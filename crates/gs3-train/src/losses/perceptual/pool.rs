//! The largest of 3×3 at every second pixel, SqueezeNet's pooling.

/// A pooling of a part of an image, `[height, width, channels]`. Windows at its end are cut off.
#[derive(Clone, Debug)]
pub struct Pool {
    /// Columns of the whole image.
    width: usize,
    channels: usize,
    /// First row and column of the part.
    start: usize,
    /// Rows and columns of the part.
    size: [usize; 2],
}

impl Pool {
    /// Pools the part that begins at (`start`, `start`) and has `more` rows and columns less than an image of
    /// `[height, width]`. None if it is smaller than a window.
    pub fn new([height, width]: [usize; 2], channels: usize, start: usize, more: usize) -> Option<Self> {
        let size = [height.checked_sub(more)?, width.checked_sub(more)?];
        size.iter().all(|side| *side >= 3).then_some(Self { width, channels, start, size })
    }

    /// Rows and columns of the result: as many as windows that begin within the part, the last one whole or cut off by
    /// one.
    pub fn result(&self) -> [usize; 2] {
        self.size.map(|side| (side - 3).div_ceil(2) + 1)
    }

    /// Pools `image` to `out`.
    pub fn forward(&self, image: &[f32], out: &mut Vec<f32>) {
        let [rows, columns] = self.result();
        out.clear();
        out.resize(rows * columns * self.channels, f32::NEG_INFINITY);
        for (k, out) in out.chunks_exact_mut(self.channels).enumerate() {
            for tap in self.taps(k % columns, k / columns) {
                out.iter_mut().zip(&image[tap..tap + self.channels]).for_each(|(out, v)| *out = out.max(*v));
            }
        }
    }

    /// Adds the derivative by the image to `v_image`, given that by the result. Of equal numbers the first was the
    /// largest.
    pub fn backward(&self, image: &[f32], out: &[f32], v_out: &[f32], v_image: &mut [f32]) {
        let columns = self.result()[1];
        let mut left = vec![0.0; self.channels];
        let pixels = out.chunks_exact(self.channels).zip(v_out.chunks_exact(self.channels));
        for (k, (out, v_out)) in pixels.enumerate() {
            left.copy_from_slice(v_out);
            for tap in self.taps(k % columns, k / columns) {
                let range = tap..tap + self.channels;
                let places = image[range.clone()].iter().zip(&mut v_image[range]);
                for ((out, left), (v, v_image)) in out.iter().zip(&mut left).zip(places) {
                    let mine = if v == out { *left } else { 0.0 };
                    *v_image += mine;
                    *left -= mine;
                }
            }
        }
    }

    /// Where the pixels of the window of (x, y) are.
    fn taps(&self, x: usize, y: usize) -> impl Iterator<Item = usize> + use<> {
        let (width, channels, start) = (self.width, self.channels, self.start);
        let end = |at: usize, side: usize| (2 * at + 3).min(side);
        let (right, down) = (end(x, self.size[1]), end(y, self.size[0]));
        (2 * y..down)
            .flat_map(move |y| (2 * x..right).map(move |x| ((start + y) * width + start + x) * channels))
    }
}
