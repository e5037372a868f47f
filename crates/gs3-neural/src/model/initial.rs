//! Where training starts: gradient-aware interpolation as tensor cubic Hermite, everything else small.

use crate::graph::Graph;
use crate::weights::{Header, Weights};

/// Samples around an LR pixel that a 3×3 convolution sees, `[dy + 1][dx + 1]`: value, ∂x, ∂y per LR pixel.
type Block = [[[f64; 3]; 3]; 3];

/// Weights from which training starts: random features, heads that are zero, and, for super sampling, the linear path
/// exactly [`hermite_weights`] without jitter.
#[must_use]
pub fn initial_weights(graph: &Graph, header: Header, seed: u64) -> Weights {
    let scale = header.scale as usize;
    let mut weights = Weights::random(graph, header, seed);
    for head in ["refine.weight", "head.color.weight", "head.alpha.weight"] {
        if let Some(array) = weights.arrays.get_mut(head) {
            array.values_mut().fill(0.0);
        }
    }
    set_hermite(&mut weights, scale, [0.0; 2]);
    weights
}

/// Makes the linear path of a super sampling network tensor cubic Hermite interpolation of samples that lie `jitter` LR
/// pixels off their pixels' centres. The convolution's channels beyond the enlarged block are left, their mix is 0.
pub fn set_hermite(weights: &mut Weights, scale: usize, jitter: [f64; 2]) {
    let square = scale * scale;
    let map = hermite_weights(scale, jitter);
    if let Some(conv) = weights.arrays.get_mut("gai.conv.weight") {
        let (outputs, _) = conv.values_mut().as_chunks_mut::<{ 9 * 9 }>();
        for (o, output) in outputs.iter_mut().take(3 * square).enumerate() {
            output.fill(0.0);
            let (color, block) = (o / square, &map[o % square]);
            for tap in 0..9 {
                for (kind, weight) in block[tap / 3][tap % 3].iter().enumerate() {
                    // Inputs are RGB, ∂x RGB, ∂y RGB.
                    output[(3 * kind + color) * 9 + tap] = *weight as f32;
                }
            }
        }
    }
    if let Some(mix) = weights.arrays.get_mut("gai.mix.weight") {
        let inputs = mix.shape()[1];
        for (o, output) in mix.values_mut().chunks_exact_mut(inputs).enumerate() {
            output.fill(0.0);
            output[o] = 1.0;
        }
    }
}

/// Tensor cubic Hermite interpolation as a linear map of 3×3 samples, for each of the `scale`² HR pixels of an LR pixel,
/// row by row (UpscaleGS; mixed derivatives are ½ (Δx I_y + Δy I_x), one-sided at the block's border).
///
/// Samples lie `jitter` ∈ `(−½, ½)` LR pixels off the centres of their pixels, so HR pixel r of an LR pixel lies at
/// (r + ½)/S − ½ − jitter ∈ (−1, 1) samples from the middle one: within the block.
#[must_use]
pub fn hermite_weights(scale: usize, jitter: [f64; 2]) -> Vec<Block> {
    let place = |r: usize, jitter: f64| (r as f64 + 0.5) / scale as f64 - 0.5 - jitter;
    let mut map = Vec::with_capacity(scale * scale);
    for k in 0..scale * scale {
        let (x, y) = (place(k % scale, jitter[0]), place(k / scale, jitter[1]));
        let mut weights = Block::default();
        // The map is linear: its weights are its answers to single samples.
        for (tap, kind) in (0..9).flat_map(|tap| (0..3).map(move |kind| (tap, kind))) {
            let mut block = Block::default();
            block[tap / 3][tap % 3][kind] = 1.0;
            weights[tap / 3][tap % 3][kind] = hermite(&block, x, y);
        }
        map.push(weights);
    }
    map
}

/// The interpolant of `block` at (x, y) ∈ (−1, 1)² from its middle.
fn hermite(block: &Block, x: f64, y: f64) -> f64 {
    let (i, j) = (usize::from(x >= 0.0), usize::from(y >= 0.0));
    let (fx, fy) = (x + 1.0 - i as f64, y + 1.0 - j as f64);
    let mixed = |row: usize, column: usize| {
        let (left, right) = (column.saturating_sub(1), (column + 1).min(2));
        let (above, below) = (row.saturating_sub(1), (row + 1).min(2));
        let dx = (block[row][right][2] - block[row][left][2]) / (right - left) as f64;
        let dy = (block[below][column][1] - block[above][column][1]) / (below - above) as f64;
        0.5 * (dx + dy)
    };
    let [wx, wy] = [cubic(fx), cubic(fy)];
    let mut sum = 0.0;
    for (v, row) in [j, j + 1].into_iter().enumerate() {
        for (u, column) in [i, i + 1].into_iter().enumerate() {
            let [value, dx, dy] = block[row][column];
            let along_x = |value: f64, slope: f64| wx[u][0] * value + wx[u][1] * slope;
            sum += wy[v][0] * along_x(value, dx) + wy[v][1] * along_x(dy, mixed(row, column));
        }
    }
    sum
}

/// Weights of value and slope of the samples before and after, at `f` between them.
fn cubic(f: f64) -> [[f64; 2]; 2] {
    let (f2, f3) = (f * f, f * f * f);
    [[2.0 * f3 - 3.0 * f2 + 1.0, f3 - 2.0 * f2 + f], [3.0 * f2 - 2.0 * f3, f3 - f2]]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Hermite interpolation is exact for cubics along an axis and, by its mixed differences, for products of lines.
    #[test]
    fn polynomials_are_reproduced_at_any_jitter() {
        let value = |x: f64, y: f64| {
            0.3 + x - 0.7 * y + 0.4 * x * x - 0.2 * y * y + x * y + 0.5 * x.powi(3) - y.powi(3)
        };
        let dx = |x: f64, y: f64| 1.0 + 0.8 * x + y + 1.5 * x * x;
        let dy = |x: f64, y: f64| -0.7 - 0.4 * y + x - 3.0 * y * y;
        for (scale, jitter) in [(4, [0.0, 0.0]), (2, [0.0, 0.0]), (4, [0.375, -0.375]), (3, [-0.3, 0.1])] {
            for (k, weights) in hermite_weights(scale, jitter).iter().enumerate() {
                let at = |r: usize, jitter: f64| (r as f64 + 0.5) / scale as f64 - 0.5 - jitter;
                let (x, y) = (at(k % scale, jitter[0]), at(k / scale, jitter[1]));
                let mut sum = 0.0;
                for tap in 0..9 {
                    let (px, py) = ((tap % 3) as f64 - 1.0, (tap / 3) as f64 - 1.0);
                    let [w, wx, wy] = weights[tap / 3][tap % 3];
                    sum += w * value(px, py) + wx * dx(px, py) + wy * dy(px, py);
                }
                assert!((sum - value(x, y)).abs() < 1e-12, "×{scale} {jitter:?} {k}: {sum} {}", value(x, y));
            }
        }
    }
}
