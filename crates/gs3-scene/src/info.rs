//! What is in a scene: counts, extent and distributions, for people and, through serde, for programs.

use std::fmt;

use rayon::prelude::*;
use serde::Serialize;

use crate::scene::{Dropped, OpacityMode, Scene};

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
    /// Spherical-harmonics degree, 0 to 3.
    pub sh_degree: u8,
    /// `default` or `antialiased`.
    pub opacity_mode: &'static str,
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
    pub dropped: DroppedInfo,
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

/// [`Dropped`] with its total.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct DroppedInfo {
    /// All of them.
    pub total: usize,
    /// NaN or infinite centre.
    pub non_finite_mean: usize,
    /// NaN, infinite or negative scale.
    pub invalid_scale: usize,
    /// NaN, infinite or zero quaternion.
    pub invalid_rotation: usize,
    /// NaN opacity, or one outside `[0, 1]`.
    pub invalid_opacity: usize,
    /// NaN or infinite spherical-harmonics coefficient.
    pub non_finite_sh: usize,
    /// Spherical-harmonics coefficient beyond ±[`crate::gaussians::MAX_SH`].
    pub excessive_sh: usize,
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
        Self {
            gaussians: gaussians.len(),
            sh_degree: gaussians.sh_degree,
            opacity_mode: match scene.opacity_mode() {
                OpacityMode::Default => "default",
                OpacityMode::Antialiased => "antialiased",
            },
            f32_bytes: gaussians.byte_size(),
            bounds: bounds(0, 3),
            robust_bounds: bounds(1, 2),
            opacity: Percentiles::of(gaussians.opacities.clone()),
            largest_scale: scales(f32::max),
            smallest_scale: scales(f32::min),
            dropped: scene.dropped().into(),
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

impl From<Dropped> for DroppedInfo {
    fn from(dropped: Dropped) -> Self {
        let Dropped {
            non_finite_mean,
            invalid_scale,
            invalid_rotation,
            invalid_opacity,
            non_finite_sh,
            excessive_sh,
        } = dropped;
        Self {
            total: dropped.total(),
            non_finite_mean,
            invalid_scale,
            invalid_rotation,
            invalid_opacity,
            non_finite_sh,
            excessive_sh,
        }
    }
}

impl fmt::Display for SceneInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "Gaussians       {}", self.gaussians)?;
        writeln!(f, "SH degree       {}", self.sh_degree)?;
        writeln!(f, "opacity mode    {}", self.opacity_mode)?;
        writeln!(f, "size as f32     {:.1} MB", self.f32_bytes as f64 / 1e6)?;
        writeln!(f, "bounds          {}", self.bounds)?;
        writeln!(f, "1–99 % bounds   {}", self.robust_bounds)?;
        writeln!(f, "                min       5 %       25 %      50 %      75 %      95 %      max")?;
        writeln!(f, "opacity         {}", self.opacity)?;
        writeln!(f, "largest scale   {}", self.largest_scale)?;
        writeln!(f, "smallest scale  {}", self.smallest_scale)?;
        let d = self.dropped;
        write!(
            f,
            "dropped         {} (centre {}, scale {}, rotation {}, opacity {}, colour {})",
            d.total,
            d.non_finite_mean,
            d.invalid_scale,
            d.invalid_rotation,
            d.invalid_opacity,
            d.non_finite_sh + d.excessive_sh
        )
    }
}

impl fmt::Display for Bounds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [a, b, c] = self.min;
        let [d, e, g] = self.max;
        write!(f, "x {a:.4} to {d:.4}, y {b:.4} to {e:.4}, z {c:.4} to {g:.4}")
    }
}

impl fmt::Display for Percentiles {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for value in [self.min, self.p5, self.p25, self.p50, self.p75, self.p95, self.max] {
            // Four significant digits in ten columns: scales span decades.
            let text = match value.abs() {
                0.0 => "0".to_owned(),
                0.001..10_000.0 => format!("{value:.4}"),
                _ => format!("{value:.2e}"),
            };
            write!(f, "{text:<10}")?;
        }
        Ok(())
    }
}
