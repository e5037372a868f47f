//! The output of projection and the input of blending: one record per visible Gaussian.

/// Slack in pixels on either end of a span ([`Splat::x_span`], [`super::cover`]). It covers rounding. A tile, block or
/// pixel too many only costs time.
///
/// An end and the pixel that it must not miss are rounded sixteen times at most, each time by ε = 2⁻²⁴ of a distance or
/// less: l21·dy, its difference from the root, and the quotient by l11 (1, 1, and 5: the 2.5 ULP of a GPU); the mean less
/// the corner of the tile, the end, and the slack (3); dy less the corner and the row, as dy moves a slanted splat (2); the
/// pixel's dx, dy, l11·dx and l21·dy (4). Distances are up to 8192 px: 16·2⁻²⁴·8192 = 7.8e-3 px. The slack is 1.3 times as
/// much, and enough up to 10,000 px. Pictures in tiles may be larger: there a rim pixel with α of 1/255 may be missed. The
/// rounding of `dy_at_max_dx` counts in second order only, and [`super::project::SUPPORT_MARGIN`] is more than that.
pub const SPAN_SLACK: f32 = 0.01;

/// The slack's share of the span's length, beside [`SPAN_SLACK`]. The root and the pixel's u are rounded by at most 12·2⁻²⁴
/// of half the length, 3.6e-7 of the length. The share is 28 times as much, and costs 0.08 px of a span of 8192 px. (What
/// cancels in the root, support − v², is off by 3·2⁻²⁴·8 = 1.4e-6, and SUPPORT_MARGIN is more than that.)
pub const SPAN_SLACK_PER_PIXEL: f32 = 1e-5;

/// Factor of the support where it is tested against a tile ([`Splat::reaches`]); [`REACH_SLACK`] is added. Both cover
/// rounding, as far as stated here. A tile too many only costs time.
///
/// Where a long thin splat is slanted, the products in u = l11·dx + l21·dy cancel. Two products are rounded in the test and
/// two in blending, each by 2⁻²⁴ of L = |l11·dx|. So u² + v² is off by at most 2·√8·4·2⁻²⁴ L = 1.35e-6 L, as supports are
/// at most 8 (log₂ 255). Factor, slack and [`super::project::SUPPORT_MARGIN`] are 2.8e-3 there: enough up to L = 2,000. For
/// the thinnest splats of a dilation of 0.3 px², L is at most 0.78 of the distance from the mean (at a slant of 45°), so
/// this is at least 2,500 px. Farther away the test may leave out a tile that has only the rim of such a splat: pixels with
/// α within half a percent of 1/255 (at 8192 px).
pub const REACH_FACTOR: f32 = 1.0 + 1e-4;

/// See [`REACH_FACTOR`].
pub const REACH_SLACK: f32 = 1e-3;

/// A projected Gaussian. Lengths in pixels, positions in the frame of [`crate::view::View`] (samples at integers).
///
/// The quadratic form is stored as a Cholesky factor. With d = mean − sample, `u = l11·dx + l21·dy` and `v = l22·dy`,
/// the contribution is `opacity · 2^−(u² + v²)`. Unlike the conic A·dx² + 2B·dx·dy + C·dy², the sum of squares does
/// not cancel. So long thin splats keep their precision, and the exponent is never positive.
///
/// One cache line.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))]
pub struct Splat {
    pub mean: [f32; 2],
    pub l11: f32,
    pub l21: f32,
    pub l22: f32,
    pub opacity: f32,
    pub color: [f32; 3],
    /// Upper bound of u² + v² on the support: log₂(255·opacity) plus a slack for rounding.
    pub support: f32,
    /// Pixels that may lie in the support.
    pub rect: PixelRect,
    /// View-space z, as bits that sort as unsigned integers (z is positive).
    pub depth_bits: u32,
    /// Distance along the ray at the centre, world units (RaDe-GS, Zhang et al. 2024); 0 unless asked for.
    pub ray_distance: f32,
    /// Change of that distance per pixel of dx and of dy, world units; 0 unless asked for.
    pub ray_plane: [f32; 2],
}

const _: () = assert!(size_of::<Splat>() == 64);

/// Pixels `[x0, x1) × [y0, y1)` inside the image, counted from its first pixel, with the margin included
/// ([`crate::view::View::before`]).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PixelRect {
    pub x0: u16,
    pub y0: u16,
    pub x1: u16,
    pub y1: u16,
}

impl Splat {
    /// The dy in pixels where the support has its largest dx; the smallest dx is at the negative dy. On the support's edge,
    /// u² + v² is the support r², and dx = (u − l21/l22·v)/l11 is largest at v = −r·l21/√(l21² + l22²).
    #[inline(always)]
    pub fn dy_at_max_dx(&self) -> f32 {
        let squared = self.l21 * self.l21 + self.l22 * self.l22;
        -self.l21 / self.l22 * (self.support / squared).sqrt()
    }

    /// First and last x of the support over sample rows `y0..=y1`, with a slack for rounding. Valid only if the
    /// support reaches these rows (Speedy-Splat's AccuTile, Hanson et al. 2025).
    ///
    /// Over a band of rows, the support's right edge is farthest right at `dy_at_max_dx` or at the row nearest to it.
    /// The left edge follows by symmetry at the negative value. (dx runs against x: d = mean − sample.)
    #[inline(always)]
    pub fn x_span(&self, y0: f32, y1: f32) -> [f32; 2] {
        let (low, high) = (self.mean[1] - y1, self.mean[1] - y0);
        let edge = |dy: f32, side: f32| {
            let v = self.l22 * dy;
            (side * (self.support - v * v).max(0.0).sqrt() - self.l21 * dy) / self.l11
        };
        let dy_at_max_dx = self.dy_at_max_dx();
        let right = edge(dy_at_max_dx.min(high).max(low), 1.0);
        let left = edge((-dy_at_max_dx).min(high).max(low), -1.0);
        let slack = SPAN_SLACK + SPAN_SLACK_PER_PIXEL * (right - left);
        [self.mean[0] - right - slack, self.mean[0] - left + slack]
    }

    /// Whether the support reaches the rectangle of sample positions `[x0, x1] × [y0, y1]` (StopThePop, Radl et al.
    /// 2024). The quadratic form is convex, so if the centre is outside the rectangle, the minimum lies on an edge.
    #[inline]
    pub fn reaches(&self, x0: f32, y0: f32, x1: f32, y1: f32) -> bool {
        let [x, y] = self.mean;
        if (x0..=x1).contains(&x) && (y0..=y1).contains(&y) {
            return true;
        }
        let form = |dx: f32, dy: f32| {
            let (u, v) = (self.l11 * dx + self.l21 * dy, self.l22 * dy);
            u * u + v * v
        };
        let column = |edge: f32| {
            let dx = x - edge;
            let dy = -self.l11 * self.l21 * dx / (self.l21 * self.l21 + self.l22 * self.l22);
            form(dx, dy.min(y - y0).max(y - y1))
        };
        let row = |edge: f32| {
            let dy = y - edge;
            form((-self.l21 * dy / self.l11).min(x - x0).max(x - x1), dy)
        };
        // The slack covers rounding. One tile too many only costs time.
        let nearest = column(x0).min(column(x1)).min(row(y0)).min(row(y1));
        nearest <= self.support * REACH_FACTOR + REACH_SLACK
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Over all rows the span is that of the support's edge, and over some rows it holds the edge's points there.
    #[test]
    fn spans_hold_the_edge_of_the_support() {
        for (l11, l21, l22, support) in
            [(0.5, 0.0, 0.5, 2.0), (0.3, 0.9, 0.2, 8.0), (0.3, -0.9, 0.2, 8.0), (1.5, 0.2, 0.1, 1.0)]
        {
            let splat = Splat { mean: [100.0, 50.0], l11, l21, l22, support, ..Splat::default() };
            let edge: Vec<[f32; 2]> = (0..10_000)
                .map(|k| {
                    let (sin, cos) = (k as f32 / 10_000.0 * std::f32::consts::TAU).sin_cos();
                    let (u, v) = (support.sqrt() * cos, support.sqrt() * sin);
                    let dy = v / l22;
                    [100.0 - (u - l21 * dy) / l11, 50.0 - dy]
                })
                .collect();
            for (top, bottom) in [(-100.0, 200.0), (46.0, 49.0), (50.0, 50.5), (51.0, 54.0)] {
                let inside = edge.iter().filter(|[_, y]| (top..=bottom).contains(y));
                let [least, most] =
                    inside.fold([f32::INFINITY, f32::NEG_INFINITY], |[a, b], [x, _]| [a.min(*x), b.max(*x)]);
                let [left, right] = splat.x_span(top, bottom);
                assert!(left <= least && right >= most, "{splat:?}, rows {top} to {bottom}");
                if top < 0.0 {
                    assert!(left > least - 0.02 && right < most + 0.02, "{splat:?}: {left} to {right}");
                }
            }
        }
    }
}
