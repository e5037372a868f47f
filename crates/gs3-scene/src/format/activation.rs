//! Activated parameters back to what files store.

/// Opacities are kept this far from 0 and 1, where the logit is infinite and other programs stumble; one in
/// 16 million is far below the 1/255 that shows.
const OPACITY_MARGIN: f32 = 1.0 / (1 << 24) as f32;

/// The inverse of the sigmoid, finite.
pub(super) fn logit(opacity: f32) -> f32 {
    let opacity = f64::from(opacity.clamp(OPACITY_MARGIN, 1.0 - OPACITY_MARGIN));
    (opacity / (1.0 - opacity)).ln() as f32
}

/// The logarithm of a scale, finite: flat Gaussians get the smallest normal number.
pub(super) fn log_scale(scale: f32) -> f32 {
    scale.max(f32::MIN_POSITIVE).ln()
}
