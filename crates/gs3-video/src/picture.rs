//! From display-encoded RGB to the colours of video (ITU-R BT.709-6): Y′CbCr, 8 bits, limited range, a quarter of the
//! colour samples (4:2:0).

use rayon::prelude::*;

use crate::VideoError;

/// Shares of red and blue in luma; green has the rest (BT.709-6, item 3.2).
const RED: f32 = 0.2126;
const BLUE: f32 = 0.0722;
const GREEN: f32 = 1.0 - RED - BLUE;

/// A frame in the format of video. Both sides are even: the last column or row of an odd frame is repeated, because
/// 4:2:0 has one colour sample for two pixels.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Picture {
    width: usize,
    height: usize,
    /// Luma `[height, width]`, 16 for black to 235 for white; then Cb and Cr `[height / 2, width / 2]`, 128 for grey. In
    /// one piece, as programs exchange such frames (I420).
    samples: Vec<u8>,
}

impl Picture {
    /// Converts `rgb`, the display-encoded 8-bit pixels of a frame of `size`, row by row. A colour sample lies at
    /// H.264's default place, on every other column and between two rows. It is the mean of both rows, weighted ¼, ½,
    /// ¼ over the columns around it.
    ///
    /// # Errors
    /// [`VideoError::Bytes`] if `rgb` is no such frame.
    pub fn from_rgb8(size: [u32; 2], rgb: &[u8]) -> Result<Self, VideoError> {
        let expected = 3_u64.saturating_mul(size[0].into()).saturating_mul(size[1].into());
        if expected != rgb.len() as u64 || rgb.is_empty() {
            return Err(VideoError::Bytes { size, expected, actual: rgb.len() });
        }
        let (columns, rows) = (size[0] as usize, size[1] as usize);
        let (width, height) = (columns.next_multiple_of(2), rows.next_multiple_of(2));
        let row = |y: usize| &rgb[3 * columns * y.min(rows - 1)..][..3 * columns];
        let mut samples = vec![0; width * height * 3 / 2];
        let (luma, chroma) = samples.split_at_mut(width * height);
        let (cb, cr) = chroma.split_at_mut(width * height / 4);
        let lines = luma.par_chunks_exact_mut(2 * width);
        let chroma = cb.par_chunks_exact_mut(width / 2).zip(cr.par_chunks_exact_mut(width / 2));
        lines.zip(chroma).enumerate().for_each(|(pair, (luma, (cb, cr)))| {
            let rows = [row(2 * pair), row(2 * pair + 1)];
            for (luma, row) in luma.chunks_exact_mut(width).zip(rows) {
                for (luma, rgb) in luma.iter_mut().zip(row.as_chunks::<3>().0) {
                    *luma = luma_of(rgb.map(f32::from));
                }
                let last = luma[columns - 1];
                luma[columns..].fill(last);
            }
            let sum = |column: usize| {
                let at = 3 * column.min(columns - 1);
                [0, 1, 2].map(|c| f32::from(rows[0][at + c]) + f32::from(rows[1][at + c]))
            };
            for (i, (cb, cr)) in cb.iter_mut().zip(cr).enumerate() {
                let [left, centre, right] = [(2 * i).saturating_sub(1), 2 * i, 2 * i + 1].map(sum);
                let mean = [0, 1, 2].map(|c| (left[c] + 2.0 * centre[c] + right[c]) / 8.0);
                [*cb, *cr] = chroma_of(mean);
            }
        });
        Ok(Self { width, height, samples })
    }

    /// Width and height in pixels, both even.
    #[must_use]
    pub const fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// All samples: luma `[height, width]`, Cb and Cr `[height / 2, width / 2]`.
    #[must_use]
    pub fn samples(&self) -> &[u8] {
        &self.samples
    }

    /// Luma, Cb and Cr.
    #[must_use]
    pub fn planes(&self) -> [&[u8]; 3] {
        let (luma, chroma) = self.samples.split_at(self.width * self.height);
        let (cb, cr) = chroma.split_at(chroma.len() / 2);
        [luma, cb, cr]
    }
}

/// Luma of a colour in `[0, 255]`, from 16 to 235.
fn luma_of([r, g, b]: [f32; 3]) -> u8 {
    // `as` rounds down.
    (16.5 + 219.0 / 255.0 * (RED * r + GREEN * g + BLUE * b)) as u8
}

/// Cb and Cr of a colour in `[0, 255]`, from 16 to 240.
fn chroma_of([r, g, b]: [f32; 3]) -> [u8; 2] {
    let luma = RED * r + GREEN * g + BLUE * b;
    // The differences of blue and red from luma reach ± (1 − their share).
    [(b, BLUE), (r, RED)].map(|(v, share)| (128.5 + 224.0 / 255.0 * (v - luma) / (2.0 * (1.0 - share))) as u8)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use super::*;

    /// Y′CbCr back to RGB, in double precision.
    fn rgb([y, cb, cr]: [u8; 3]) -> [f64; 3] {
        let (red, blue) = (0.2126, 0.0722);
        let y = (f64::from(y) - 16.0) / 219.0;
        let [cb, cr] = [cb, cr].map(|c| (f64::from(c) - 128.0) / 224.0);
        let (r, b) = (y + 2.0 * (1.0 - red) * cr, y + 2.0 * (1.0 - blue) * cb);
        [r, (y - red * r - blue * b) / (1.0 - red - blue), b].map(|v| 255.0 * v)
    }

    #[test]
    fn corners_of_the_cube_are_those_of_the_standard() {
        // 8-bit codes of colour bars at 100 % (BT.709-6, quantised as in its item 4.6).
        for (colour, code) in [
            ([0, 0, 0], [16, 128, 128]),
            ([255, 255, 255], [235, 128, 128]),
            ([255, 0, 0], [63, 102, 240]),
            ([0, 255, 0], [173, 42, 26]),
            ([0, 0, 255], [32, 240, 118]),
            ([255, 255, 0], [219, 16, 138]),
        ] {
            let picture = Picture::from_rgb8([2, 2], &colour.repeat(4)).unwrap();
            let [y, cb, cr] = picture.planes();
            assert_eq!([y[0], cb[0], cr[0]], code, "{colour:?}");
            assert_eq!(y, [code[0]; 4]);
        }
    }

    #[test]
    fn every_flat_colour_comes_back() {
        for r in (0..=255).step_by(15) {
            for g in (0..=255).step_by(17) {
                for b in (0..=255).step_by(5) {
                    let picture = Picture::from_rgb8([1, 1], &[r, g, b]).unwrap();
                    let [y, cb, cr] = picture.planes();
                    let back = rgb([y[0], cb[0], cr[0]]);
                    // Half a step of luma is 0.58 of 255, half a step of Cb or Cr up to 1.06 more.
                    for (back, colour) in back.into_iter().zip([r, g, b]) {
                        assert!((back - f64::from(colour)).abs() < 1.65, "{r} {g} {b}: {back}");
                    }
                }
            }
        }
    }

    #[test]
    fn odd_frames_end_in_their_last_column_and_row() {
        let size = [5, 3];
        let bytes: Vec<u8> = (0..3 * 5 * 3).map(|i| (i * 37 % 251) as u8).collect();
        let odd = Picture::from_rgb8(size, &bytes).unwrap();
        let pixel = |x: usize, y: usize| &bytes[3 * (5 * y.min(2) + x.min(4))..][..3];
        let even: Vec<u8> = (0..4).flat_map(|y| (0..6).flat_map(move |x| pixel(x, y).to_vec())).collect();
        assert_eq!(odd, Picture::from_rgb8([6, 4], &even).unwrap());
        assert_eq!((odd.size(), odd.samples().len()), ([6, 4], 36));
    }

    #[test]
    fn colour_samples_lie_on_even_columns_between_rows() {
        // A red column on grey: seen by the sample on it by a half, by that beside it by a quarter, of what red has.
        let red = Picture::from_rgb8([2, 2], &[255, 0, 0].repeat(4)).unwrap().planes()[2][0];
        let whole = f64::from(red) - 128.0;
        for (column, shares) in [(2, [0.0, 0.5, 0.0]), (3, [0.0, 0.25, 0.25])] {
            let mut bytes = vec![128; 3 * 6 * 2];
            for y in 0..2 {
                bytes[3 * (6 * y + column)..][..3].copy_from_slice(&[255, 0, 0]);
            }
            let picture = Picture::from_rgb8([6, 2], &bytes).unwrap();
            for (cr, share) in picture.planes()[2].iter().zip(shares) {
                assert!((f64::from(*cr) - 128.0 - whole * share).abs() <= 1.0, "column {column}: {cr}");
            }
        }
    }

    #[test]
    fn frames_of_another_length_are_refused() {
        let error = Picture::from_rgb8([4, 2], &[0; 23]).unwrap_err();
        assert_eq!(error.to_string(), "frame: expected 24 bytes, 3 for each of 4x2 pixels, found 23");
        assert!(Picture::from_rgb8([0, 2], &[]).is_err());
        assert!(Picture::from_rgb8([u32::MAX, u32::MAX], &[0; 12]).is_err());
    }
}
