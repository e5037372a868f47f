//! Lenses that are no pinhole: where they show what a pinhole of the same focal length would show elsewhere.

use glam::DVec2;

/// The distortion of a lens, in the models of OpenCV and COLMAP.
///
/// Both map the slopes x/z and y/z of a ray, what a pinhole of focal length 1 sees, to what the lens shows, before focal
/// lengths and principal point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Lens {
    /// Polynomials of the squared radius, over and under a fraction line, tangential terms and a thin prism.
    Radial {
        /// k1 to k6; the last three are below the line.
        radial: [f64; 6],
        /// p1 and p2.
        tangential: [f64; 2],
        /// s1 to s4.
        prism: [f64; 4],
    },
    /// Polynomials of the angle to the axis, as in fisheye lenses; all 0 is an equidistant one.
    Fisheye {
        /// k1 to k6.
        radial: [f64; 6],
        /// p1 and p2.
        tangential: [f64; 2],
        /// s1 to s4.
        prism: [f64; 4],
    },
    /// The lens of Devernay and Faugeras (2001), by its angle in radians.
    FieldOfView(f64),
}

/// Below this radius directions have no angle, and lenses no distortion that a pixel shows.
const TINY: f64 = 1e-12;

impl Lens {
    /// A lens of Brown's model with up to four radial coefficients and two tangential ones.
    #[must_use]
    pub const fn brown(k1: f64, k2: f64, p1: f64, p2: f64, k3: f64) -> Self {
        Self::Radial { radial: [k1, k2, k3, 0.0, 0.0, 0.0], tangential: [p1, p2], prism: [0.0; 4] }
    }

    /// Whether this is a pinhole after all.
    #[must_use]
    pub fn is_pinhole(&self) -> bool {
        match self {
            Self::Radial { radial, tangential, prism } => {
                radial.iter().chain(tangential).chain(prism).all(|coefficient| *coefficient == 0.0)
            }
            Self::Fisheye { .. } => false,
            Self::FieldOfView(omega) => *omega == 0.0,
        }
    }

    /// Whether all coefficients are finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        match self {
            Self::Radial { radial, tangential, prism } | Self::Fisheye { radial, tangential, prism } => {
                radial.iter().chain(tangential).chain(prism).all(|coefficient| coefficient.is_finite())
            }
            Self::FieldOfView(omega) => omega.is_finite(),
        }
    }

    /// Where the lens shows the ray of slopes `pinhole`.
    #[must_use]
    pub fn distort(&self, pinhole: DVec2) -> DVec2 {
        match *self {
            Self::Radial { radial: [k1, k2, k3, k4, k5, k6], tangential, prism } => {
                let r2 = pinhole.length_squared();
                let over = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
                let under = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
                pinhole * (over / under) + shift(pinhole, tangential, prism)
            }
            Self::Fisheye { radial: [k1, k2, k3, k4, k5, k6], tangential, prism } => {
                let radius = pinhole.length();
                if radius < TINY {
                    return pinhole;
                }
                let equidistant = pinhole * (radius.atan() / radius);
                let t2 = equidistant.length_squared();
                let factor = 1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * (k4 + t2 * (k5 + t2 * k6)))));
                equidistant * factor + shift(equidistant * factor, tangential, prism)
            }
            Self::FieldOfView(omega) => {
                let radius = pinhole.length();
                if radius < TINY || omega.abs() < TINY {
                    return pinhole;
                }
                let shown = (2.0 * radius * (0.5 * omega).tan()).atan() / omega;
                pinhole * (shown / radius)
            }
        }
    }
}

/// Tangential terms and thin prism at `p`.
fn shift(p: DVec2, [p1, p2]: [f64; 2], [s1, s2, s3, s4]: [f64; 4]) -> DVec2 {
    let r2 = p.length_squared();
    let DVec2 { x, y } = p;
    DVec2::new(
        2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + r2 * (s1 + r2 * s2),
        p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y + r2 * (s3 + r2 * s4),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values computed by hand from the models' formulas.
    #[test]
    fn lenses_show_rays_where_their_models_say() {
        let p = DVec2::new(0.3, 0.4);
        let close = |lens: Lens, x: f64, y: f64| {
            let shown = lens.distort(p);
            assert!(shown.distance(DVec2::new(x, y)) < 1e-12, "{lens:?} shows {shown}");
        };
        // r² = 0.25: 1 + 0.1 · 0.25 + 0.2 · 0.0625 = 1.0375.
        close(Lens::brown(0.1, 0.2, 0.0, 0.0, 0.0), 0.3 * 1.0375, 0.4 * 1.0375);
        // 2 p1 x y, p1 (r² + 2 y²).
        close(Lens::brown(0.0, 0.0, 0.01, 0.0, 0.0), 0.3 + 0.0024, 0.4 + 0.0057);
        let equidistant = Lens::Fisheye { radial: [0.0; 6], tangential: [0.0; 2], prism: [0.0; 4] };
        let theta = 0.5f64.atan();
        close(equidistant, 0.6 * theta, 0.8 * theta);
        close(Lens::FieldOfView(1.0), 0.6 * 0.5f64.tan().atan(), 0.8 * 0.5f64.tan().atan());
        for lens in [equidistant, Lens::FieldOfView(0.0), Lens::brown(1.0, 2.0, 3.0, 4.0, 5.0)] {
            assert_eq!(lens.distort(DVec2::ZERO), DVec2::ZERO);
        }
        assert!(Lens::brown(0.0, 0.0, 0.0, 0.0, 0.0).is_pinhole() && !equidistant.is_pinhole());
    }
}
