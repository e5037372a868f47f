//! The published rule has steps; at a step, single precision may rightly fall on the other side.

use super::{ALPHA_MIN, NEAR, Splat, TRANSMITTANCE_MIN};

/// Half-width of the band around an α step, relative. Single precision knows a splat's centre to about 2⁻¹⁷ px in an
/// image of 256 px; at the 1/255 step a splat of σ = 0.14 px (the least that matched dilation leaves) changes by
/// 3.3/σ = 24 per px, so by 2e-4.
const ALPHA_BAND: f64 = 1e-3;
/// Half-width of the band around the transmittance steps, relative: a product of some 100 factors of relative error
/// up to 1e-5 each.
pub const TRANSMITTANCE_BAND: f64 = 1e-3;
/// View depths closer than this, relative, may sort either way: a few roundings of sums of larger terms.
const DEPTH_BAND: f64 = 4e-6;

/// Which steps are near at a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutOffs {
    /// Some α is near 1/255.
    pub alpha_min: bool,
    /// Some α is near where it is capped, where gradients vanish at once.
    pub alpha_max: bool,
    /// Blending nearly stopped, or nearly did not.
    pub stop: bool,
    /// Two blended splats are nearly equally deep.
    pub order: bool,
    /// A splat is nearly at the near plane.
    pub near_plane: bool,
    /// How far the transmittance before any splat is from 0.5 at least, relative. Matters to the median depth only.
    pub to_median: f64,
}

impl Default for CutOffs {
    fn default() -> Self {
        Self {
            alpha_min: false,
            alpha_max: false,
            stop: false,
            order: false,
            near_plane: false,
            to_median: f64::INFINITY,
        }
    }
}

impl CutOffs {
    /// Whether colour, gradients, alpha, expected depth and normal may differ by a step.
    pub fn any(&self) -> bool {
        self.alpha_min || self.alpha_max || self.stop || self.order || self.near_plane
    }

    /// Whether the median depth may be another splat's.
    pub fn median(&self) -> bool {
        self.to_median < TRANSMITTANCE_BAND
    }

    pub(super) fn note_alpha(&mut self, unclamped: f64, max_alpha: f64) {
        self.alpha_min |= is_near(unclamped, ALPHA_MIN, ALPHA_BAND);
        self.alpha_max |= is_near(unclamped, max_alpha, ALPHA_BAND);
    }

    pub(super) fn note_splat(&mut self, splat: &Splat, last_z: f64) {
        self.near_plane |= is_near_plane(splat.z);
        self.order |= splat.z - last_z < DEPTH_BAND * (1.0 + splat.z);
    }

    pub(super) fn note_transmittance(&mut self, before: f64, after: f64) {
        self.to_median = self.to_median.min((before / 0.5 - 1.0).abs());
        self.stop |= is_near(after, TRANSMITTANCE_MIN, TRANSMITTANCE_BAND * 10.0);
    }
}

/// Whether rounding decides if a splat at view depth `z` is culled.
pub(super) fn is_near_plane(z: f64) -> bool {
    (z - NEAR).abs() < DEPTH_BAND
}

fn is_near(value: f64, step: f64, band: f64) -> bool {
    (value / step - 1.0).abs() < band
}
