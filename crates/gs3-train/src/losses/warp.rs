//! Occlusion-aware warp loss: errors along the motion.

use super::charbonnier::smooth_abs;
use super::{CHANNELS, Interior};

/// Where the pixels of a frame were in the frame before, on the LR grid.
#[derive(Clone, Copy, Debug)]
pub struct Moved<'a> {
    /// HR pixels per LR pixel along a side.
    pub scale: usize,
    /// Relative to themselves, in LR pixels, `[height, width, 2]`.
    pub motion: &'a [f32],
    /// Whether they were seen there, `[height, width]`, `[0, 1]`.
    pub validity: &'a [f32],
}

/// Charbonnier's loss of e − W(e₀), times validity, summed over the interior. e are the current errors. W(e₀) are the
/// previous frame's errors at the places where the pixels were, found bilinearly. Errors that move with their surface
/// cost nothing; errors that flicker while the surface moves do. Pixels that were not seen, and pixels at the border
/// without known errors, do not count.
///
/// The paper compares the images themselves. But the truth also changes along the motion, by reflections and
/// sampling. So here errors are compared: the loss vanishes at the truth.
///
/// Adds `factor` times the derivatives to `v_before` and `v_now`.
pub fn warp(
    interior: &Interior,
    moved: Moved<'_>,
    [before, now]: [&[f32]; 2],
    epsilon: f32,
    factor: f32,
    [v_before, v_now]: [&mut [f32]; 2],
) -> f64 {
    let width = interior.stride() / CHANNELS;
    let (rows, columns) = (interior.rows(), interior.columns());
    let (motion, scale) = (moved.motion.as_chunks::<2>().0, moved.scale as f32);
    let [before, now] = [before, now].map(|image| image.as_chunks::<CHANNELS>().0);
    let [v_before, v_now] = [v_before, v_now].map(|image| image.as_chunks_mut::<CHANNELS>().0);
    let mut sum = 0.0;
    for y in rows.clone() {
        let mut row_sum = [0.0_f32; CHANNELS];
        for x in columns.clone() {
            // A block of HR pixels moves like its LR pixel: motion interpolated between LR pixels may belong to no
            // surface.
            let lr = y / moved.scale * (width / moved.scale) + x / moved.scale;
            let valid = moved.validity[lr];
            let [from_x, from_y] = [x as f32 + scale * motion[lr][0], y as f32 + scale * motion[lr][1]];
            let inside = (columns.start as f32..(columns.end - 1) as f32).contains(&from_x)
                && (rows.start as f32..(rows.end - 1) as f32).contains(&from_y);
            if valid <= 0.0 || !inside {
                continue;
            }
            // Both are positive: casts round down.
            let (left, up) = (from_x as usize, from_y as usize);
            let (right_share, down_share) = (from_x - left as f32, from_y - up as f32);
            let first = up * width + left;
            let taps = [
                (first, (1.0 - right_share) * (1.0 - down_share)),
                (first + 1, right_share * (1.0 - down_share)),
                (first + width, (1.0 - right_share) * down_share),
                (first + width + 1, right_share * down_share),
            ];
            let at = y * width + x;
            let mut change = now[at];
            for (tap, share) in taps {
                for c in 0..CHANNELS {
                    change[c] -= share * before[tap][c];
                }
            }
            for c in 0..CHANNELS {
                let (value, slope) = smooth_abs(change[c], epsilon);
                row_sum[c] += valid * value;
                change[c] = factor * valid * slope;
                v_now[at][c] += change[c];
            }
            for (tap, share) in taps {
                for c in 0..CHANNELS {
                    v_before[tap][c] -= share * change[c];
                }
            }
        }
        sum += row_sum.iter().map(|v| f64::from(*v)).sum::<f64>();
    }
    sum
}
