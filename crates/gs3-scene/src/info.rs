//! What is in a scene: counts, extent and distributions, for people and, through serde, for programs.

use std::fmt;

use rayon::prelude::*;
use serde::{Serialize, Serializer};

use crate::scene::{AxesKnownBy, Details, Dropped, FileAxes, OpacityMode, Scene};

/// A summary of a [`Scene`].
///
/// ```
/// use gs3_scene::info::SceneInfo;
/// use gs3_scene::{Gaussians, OpacityMode, Scene};
///
/// let mut gaussians = Gaussians::zeroed(1, 0);
/// gaussians.means[0][0] = 2.0;
/// gaussians.rotations[0][0] = 1.0;
/// let info = SceneInfo::of(&Scene::new(gaussians, OpacityMode::Default)?);
/// assert_eq!((info.gaussians, info.bounds.max[0]), (1, 2.0));
/// # Ok::<(), gs3_scene::SceneError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SceneInfo {
    /// Number of Gaussians.
    pub gaussians: usize,
    /// Spherical-harmonics degree, 0 to 4.
    pub sh_degree: u8,
    /// `default` or `antialiased`.
    pub opacity_mode: &'static str,
    /// Which way the axes of the file point, and how that is known.
    pub file_axes: String,
    /// Where the scene's origin lies in the file, right-down-front: what is below is relative to it.
    pub origin: [f64; 3],
    /// The view-space z from which Gaussians are shown, world units.
    pub near: f32,
    /// Size of the parameters as f32, in bytes.
    pub f32_bytes: usize,
    /// Smallest box around the centres, in world units.
    pub bounds: Bounds,
    /// Box from the 1st to the 99th percentile of the centres on each axis: the scene without its floaters.
    pub robust_bounds: Bounds,
    /// Opacities, 0 to 1.
    pub opacity: Percentiles,
    /// Largest of each Gaussian's three standard deviations, in world units.
    pub largest_scale: Percentiles,
    /// Smallest of each Gaussian's three standard deviations, in world units.
    pub smallest_scale: Percentiles,
    /// Gaussians that were invalid in the source, by reason.
    #[serde(serialize_with = "with_total")]
    pub dropped: Dropped,
}

/// An axis-aligned box in world units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Bounds {
    /// Smallest x, y, z.
    pub min: [f32; 3],
    /// Largest x, y, z.
    pub max: [f32; 3],
}

/// Percentiles of a distribution (nearest rank).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Percentiles {
    /// The smallest value.
    pub min: f32,
    /// 5 % are below it.
    pub p5: f32,
    /// A quarter is below it.
    pub p25: f32,
    /// The median.
    pub p50: f32,
    /// Three quarters are below it.
    pub p75: f32,
    /// 95 % are below it.
    pub p95: f32,
    /// The largest value.
    pub max: f32,
}

impl SceneInfo {
    /// Summarises `scene`.
    #[must_use]
    pub fn of(scene: &Scene) -> Self {
        let gaussians = scene.gaussians();
        let axes: Vec<[f32; 4]> = (gaussians.means.par_iter())
            .map(|plane| {
                let mut values = plane.clone();
                [0.0, 0.01, 0.99, 1.0].map(|share| quantile(&mut values, share))
            })
            .collect();
        let bounds = |low: usize, high: usize| Bounds {
            min: std::array::from_fn(|axis| axes[axis][low]),
            max: std::array::from_fn(|axis| axes[axis][high]),
        };
        let scales = |pick: fn(f32, f32) -> f32| {
            let of = |i| gaussians.scale(i).into_iter().reduce(pick).unwrap_or_default();
            Percentiles::of((0..gaussians.len()).into_par_iter().map(of).collect())
        };
        let Details { origin, axes, near, .. } = scene.details();
        Self {
            gaussians: gaussians.len(),
            sh_degree: gaussians.sh_degree,
            opacity_mode: match scene.opacity_mode() {
                OpacityMode::Default => "default",
                OpacityMode::Antialiased => "antialiased",
            },
            file_axes: axes.to_string(),
            origin: origin.to_array(),
            near: *near,
            f32_bytes: gaussians.byte_size(),
            bounds: bounds(0, 3),
            robust_bounds: bounds(1, 2),
            opacity: Percentiles::of(gaussians.opacities.clone()),
            largest_scale: scales(f32::max),
            smallest_scale: scales(f32::min),
            dropped: scene.dropped(),
        }
    }
}

impl Percentiles {
    /// Of at least one value, none of them NaN: what a [`Scene`] guarantees.
    fn of(mut values: Vec<f32>) -> Self {
        let mut at = |share| quantile(&mut values, share);
        Self {
            min: at(0.0),
            p5: at(0.05),
            p25: at(0.25),
            p50: at(0.5),
            p75: at(0.75),
            p95: at(0.95),
            max: at(1.0),
        }
    }
}

/// The value that `share` of the others are below, nearest rank; 0 of none. Reorders `values`.
fn quantile(values: &mut [f32], share: f64) -> f32 {
    let rank = (values.len().saturating_sub(1) as f64 * share).round() as usize;
    if rank >= values.len() {
        return 0.0;
    }
    *values.select_nth_unstable_by(rank, f32::total_cmp).1
}

/// [`Dropped`] by reason, with its total.
fn with_total<S: Serializer>(dropped: &Dropped, serializer: S) -> Result<S::Ok, S::Error> {
    #[derive(Serialize)]
    struct WithTotal<'a> {
        total: usize,
        #[serde(flatten)]
        reasons: &'a Dropped,
    }
    WithTotal { total: dropped.total(), reasons: dropped }.serialize(serializer)
}

impl fmt::Display for SceneInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { gaussians, sh_degree, opacity_mode, .. } = self;
        let megabytes = self.f32_bytes as f64 / 1e6;
        writeln!(
            f,
            "Gaussians       {gaussians}, {megabytes:.1} MB as f32, SH degree {sh_degree}, {opacity_mode} opacity"
        )?;
        writeln!(f, "axes            {} in the file", self.file_axes)?;
        if self.origin != [0.0; 3] {
            let [x, y, z] = self.origin;
            writeln!(f, "origin          {x}, {y}, {z} in the file; what follows is relative to it")?;
        }
        writeln!(f, "near plane      {}", Digits(self.near.into()))?;
        writeln!(f, "bounds          {}", self.bounds)?;
        writeln!(f, "1 to 99 %       {}", self.robust_bounds)?;
        writeln!(f, "                min        5 %        25 %       50 %       75 %       95 %       max")?;
        writeln!(f, "opacity         {}", self.opacity)?;
        writeln!(f, "largest scale   {}", self.largest_scale)?;
        writeln!(f, "smallest scale  {}", self.smallest_scale)?;
        write!(f, "dropped         {}", self.dropped)
    }
}

impl fmt::Display for FileAxes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let known_by = match self.known_by {
            AxesKnownBy::Format => "as its format says",
            AxesKnownBy::File => "as the file states",
            AxesKnownBy::Caller => "as was asked for",
        };
        write!(f, "{} ({known_by})", self.axes)
    }
}

impl fmt::Display for Dropped {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            invalid_mean,
            invalid_scale,
            invalid_rotation,
            invalid_opacity,
            non_finite_sh,
            excessive_sh,
        } = *self;
        let reasons = [
            (invalid_mean, "invalid mean"),
            (invalid_scale, "invalid scale"),
            (invalid_rotation, "invalid rotation"),
            (invalid_opacity, "invalid opacity"),
            (non_finite_sh, "non-finite SH"),
            (excessive_sh, "excessive SH"),
        ];
        let reasons: Vec<String> =
            reasons.iter().filter(|(n, _)| *n > 0).map(|(n, reason)| format!("{n} {reason}")).collect();
        match reasons.is_empty() {
            true => write!(f, "0"),
            false => write!(f, "{} ({})", self.total(), reasons.join(", ")),
        }
    }
}

impl fmt::Display for Bounds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [min, max] = [self.min, self.max].map(|corner| corner.map(|v| Digits(v.into())));
        write!(f, "{}, {}, {}  to  {}, {}, {}", min[0], min[1], min[2], max[0], max[1], max[2])
    }
}

impl fmt::Display for Percentiles {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { min, p5, p25, p50, p75, p95, max } = *self;
        for value in [min, p5, p25, p50, p75, p95] {
            write!(f, "{:<11}", Digits(value.into()).to_string())?;
        }
        write!(f, "{}", Digits(max.into()))
    }
}

/// Shows a number by four significant digits: coordinates and scales span decades, and tell less in zeros than in
/// powers of ten.
#[derive(Clone, Copy, Debug)]
pub struct Digits(pub f64);

impl fmt::Display for Digits {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let value = self.0;
        match value.abs() {
            0.0 => write!(f, "0"),
            size @ 0.001..10_000.0 => {
                // Digits after the point: a size of 1 to 10 has three digits in all.
                let digits = (3.0 - size.log10().floor()).max(0.0) as usize;
                write!(f, "{value:.digits$}")
            }
            _ => write!(f, "{value:.3e}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_four_digits_that_tell_something() {
        for (value, expected) in [
            (0.0, "0"),
            (3.2e-7, "3.200e-7"),
            (0.001_234_56, "0.001235"),
            (-0.5, "-0.5000"),
            (1.0, "1.000"),
            (-12.345_6, "-12.35"),
            (9_876.5, "9876"),
            (54_321.0, "5.432e4"),
            (-1e38, "-1.000e38"),
        ] {
            assert_eq!(Digits(value).to_string(), expected);
        }
    }

    #[test]
    fn what_was_dropped_is_told_by_reason_and_in_all() {
        let dropped = Dropped { invalid_mean: 2, excessive_sh: 1, ..Dropped::default() };
        assert_eq!(dropped.to_string(), "3 (2 invalid mean, 1 excessive SH)");
        assert_eq!(Dropped::default().to_string(), "0");
        let mut gaussians = crate::Gaussians::zeroed(2, 0);
        gaussians.rotations[0] = vec![1.0; 2];
        gaussians.means[1][0] = f32::INFINITY;
        let info = SceneInfo::of(&Scene::new(gaussians, OpacityMode::Default).unwrap());
        let json = serde_json::to_value(&info).unwrap();
        assert_eq!((&json["gaussians"], &json["dropped"]["total"]), (&1.into(), &1.into()));
        assert_eq!(json["dropped"]["invalid_mean"], 1);
    }
}
