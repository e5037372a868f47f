//! The origin of scenes with positions that need more than single precision.

use glam::DVec3;

/// How many times farther than the scene is wide its middle must lie for an origin there: eight times cost an f32 three
/// of its 24 bits. (Empirical; which scenes get an origin changes by it, but no picture by more than a rounding.)
const FAR: f64 = 8.0;

/// Scenes are taken to be at least this wide, world units: within 1,024 units of 0 an f32 has steps of 6e-5 at most, and a
/// scene needs no origin.
const WIDE: f64 = 128.0;

/// An origin near the middle of the given positions (x, y and z of a sample), 0 on axes where single precision loses
/// nothing by positions as they are. A whole number, so that sums with it are as exact as doubles can be.
pub(super) fn of(positions: [Vec<f64>; 3]) -> DVec3 {
    DVec3::from(positions.map(|mut values| {
        values.retain(|value| value.is_finite());
        values.sort_unstable_by(f64::total_cmp);
        let at =
            |share: f64| values.get(((values.len().max(1) - 1) as f64 * share).round() as usize).copied();
        let (Some(low), Some(middle), Some(high)) = (at(0.1), at(0.5), at(0.9)) else { return 0.0 };
        if middle.abs() > FAR * (high - low).max(WIDE) { middle.round() } else { 0.0 }
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn far_scenes_get_an_origin_and_others_none() {
        let around =
            |middle: f64, width: f64| (0..100).map(|k| middle + width * (k as f64 / 99.0 - 0.5)).collect();
        let utm = of([around(500_000.25, 4.0), around(4.5e6, 4.0), around(3.0, 4.0)]);
        assert_eq!(utm, DVec3::new(500_000.0, 4.5e6, 0.0));
        assert_eq!(
            of([around(1023.0, 1.0), around(-1025.0, 1.0), vec![f64::NAN]]),
            DVec3::new(0.0, -1025.0, 0.0)
        );
        assert_eq!(of([const { Vec::new() }; 3]), DVec3::ZERO);
    }
}
