//! Derivatives of colours, for frames without derivatives of their own.

use gs3_scene::{Gradients, Planes};
use rayon::prelude::*;

use crate::reprojection::inverse_depth;

/// Neighbours belong to different surfaces if their inverse depths differ by more than this share of the larger one.
/// (Empirical; see [`difference`].)
const SAME_SURFACE: f32 = 0.1;

/// Derivatives of `color` per pixel of its grid, by differences to neighbours on the same surface. `depth`, the
/// distance along the view axis, tells surfaces apart. Differences are central if both neighbours are on the surface,
/// one-sided if one is, and 0 if none is.
///
/// They are cruder than exact derivatives, because they lack the detail that the LR grid does not resolve.
pub fn difference(color: &Planes<3>, depth: &Planes<1>, out: &mut Gradients) {
    let (width, height) = (color.width(), color.height());
    out.color_dxy = None;
    out.color_dx.resize(width, height);
    out.color_dy.resize(width, height);
    let across = out.color_dx.data_mut().par_chunks_exact_mut(width.max(1));
    let down = out.color_dy.data_mut().par_chunks_exact_mut(width.max(1));
    across.zip(down).enumerate().with_min_len(8).for_each(|(k, (dx, dy))| {
        let (c, y) = (k / height, k % height);
        let [above, below] = [y.saturating_sub(1), (y + 1).min(height - 1)];
        let [colors, colors_above, colors_below] = [y, above, below].map(|y| color.row(c, y));
        let [depths, depths_above, depths_below] = [y, above, below].map(|y| depth.row(0, y));
        for x in 0..width {
            let [left, right] = [x.saturating_sub(1), (x + 1).min(width - 1)];
            let here = (colors[x], inverse_depth(depths[x]));
            let at = |colors: &[f32], depths: &[f32], x: usize| (colors[x], inverse_depth(depths[x]));
            dx[x] = slope(at(colors, depths, left), here, at(colors, depths, right));
            dy[x] = slope(at(colors_above, depths_above, x), here, at(colors_below, depths_below, x));
        }
    });
}

/// The slope at the second of three values, given with their inverse depths.
fn slope(before: (f32, f32), here: (f32, f32), after: (f32, f32)) -> f32 {
    let is_same = |other: f32| (other - here.1).abs() <= SAME_SURFACE * other.max(here.1);
    match (is_same(before.1), is_same(after.1)) {
        (true, true) => 0.5 * (after.0 - before.0),
        (true, false) => here.0 - before.0,
        (false, true) => after.0 - here.0,
        (false, false) => 0.0,
    }
}
