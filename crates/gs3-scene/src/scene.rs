//! A scene: Gaussians that have passed the border check, and how they are to be rendered.

use glam::DVec3;
use rayon::prelude::*;
use serde::Serialize;

use crate::axes::Axes;
use crate::camera::NEAR;
use crate::gaussians::{Gaussians, MAX_LENGTH, MAX_SH, MAX_SH_DEGREE, Slots, sh_coefficient_count};

/// Gaussians checked by one task: a few hundred microseconds of work, so that scheduling costs nothing.
const CHECK_BLOCK: usize = 16_384;

/// How opacity reacts to the dilation of the projected covariance. A scene is rendered in the mode it was trained in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OpacityMode {
    /// Opacity as stored (Kerbl et al. 2023).
    #[default]
    Default,
    /// Opacity scaled by the square root of the determinants' ratio before and after dilation (Mip-Splatting;
    /// gsplat's `antialiased`).
    Antialiased,
}

/// Gaussians that were invalid in the source and are not part of the scene, by reason. A Gaussian with several defects
/// counts once, under the first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct Dropped {
    /// NaN or infinite centre, or one beyond ±[`MAX_LENGTH`].
    pub invalid_mean: usize,
    /// NaN, infinite or negative scale, or one beyond [`MAX_LENGTH`].
    pub invalid_scale: usize,
    /// NaN, infinite or zero quaternion.
    pub invalid_rotation: usize,
    /// NaN opacity, or one outside `[0, 1]`.
    pub invalid_opacity: usize,
    /// NaN or infinite spherical-harmonics coefficient.
    pub non_finite_sh: usize,
    /// Spherical-harmonics coefficient beyond ±[`MAX_SH`].
    pub excessive_sh: usize,
}

impl Dropped {
    /// Number of dropped Gaussians.
    #[must_use]
    pub const fn total(&self) -> usize {
        self.invalid_mean
            + self.invalid_scale
            + self.invalid_rotation
            + self.invalid_opacity
            + self.non_finite_sh
            + self.excessive_sh
    }

    const fn plus(self, other: Self) -> Self {
        Self {
            invalid_mean: self.invalid_mean + other.invalid_mean,
            invalid_scale: self.invalid_scale + other.invalid_scale,
            invalid_rotation: self.invalid_rotation + other.invalid_rotation,
            invalid_opacity: self.invalid_opacity + other.invalid_opacity,
            non_finite_sh: self.non_finite_sh + other.non_finite_sh,
            excessive_sh: self.excessive_sh + other.excessive_sh,
        }
    }
}

/// Why Gaussians do not make a scene.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// An array does not have the length that the number of Gaussians asks for.
    #[error("{field}: expected {expected} values for {count} Gaussians, found {actual}")]
    Length {
        /// The array's name.
        field: &'static str,
        /// Number of Gaussians (the length of `opacities`).
        count: usize,
        /// Expected number of values.
        expected: usize,
        /// Actual number of values.
        actual: usize,
    },
    /// The spherical-harmonics degree is not supported.
    #[error("sh_degree: expected 0 to {MAX_SH_DEGREE}, found {actual}")]
    ShDegree {
        /// The degree found.
        actual: u8,
    },
    /// No valid Gaussian is left.
    #[error("the scene has no valid Gaussian: expected at least 1, found 0 ({dropped} dropped as invalid)")]
    Empty {
        /// Number of Gaussians dropped as invalid.
        dropped: usize,
    },
}

/// What belongs to a scene beside its Gaussians, mostly from its file.
#[derive(Clone, Debug, PartialEq)]
pub struct Details {
    /// Where the scene's origin lies in the file's frame of reference, right-down-front: positions of the file are
    /// means + origin. Not 0 where positions in the file are larger than an f32 keeps exactly.
    pub origin: DVec3,
    /// The upward direction, of length 1, where the file states one.
    pub up: Option<DVec3>,
    /// Which way the axes of the file point, and how that is known. In memory scenes are right-down-front.
    pub axes: FileAxes,
    /// Gaussians nearer than this view-space z, world units, are not shown; positive.
    pub near: f32,
    /// What the reader found and did not use, or assumed, and could change the picture: sentences of one line.
    pub notes: Vec<String>,
}

impl Default for Details {
    /// Details of a scene that was never in a file: near plane [`NEAR`], no notes.
    fn default() -> Self {
        let axes = FileAxes { axes: Axes::RDF, known_by: AxesKnownBy::Format };
        Self { origin: DVec3::ZERO, up: None, axes, near: NEAR, notes: Vec::new() }
    }
}

/// The axes of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FileAxes {
    /// Which way they point.
    pub axes: Axes,
    /// How that is known.
    pub known_by: AxesKnownBy,
}

/// How the axes of a file are known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AxesKnownBy {
    /// The format has no others, or says which they are where a file says nothing.
    Format,
    /// The file states them.
    File,
    /// The caller who loads the file states them.
    Caller,
}

/// A scene that is safe to render: at least one Gaussian, all values finite, scales not negative, quaternions
/// normalised, opacities in `[0, 1]`, spherical harmonics within ±[`MAX_SH`].
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    gaussians: Gaussians,
    opacity_mode: OpacityMode,
    dropped: Dropped,
    details: Details,
}

impl Scene {
    /// Checks `gaussians` once: drops and counts the invalid ones, normalises quaternions.
    ///
    /// # Errors
    /// [`SceneError`] if array lengths disagree, the degree is unknown, or no valid Gaussian is left.
    pub fn new(mut gaussians: Gaussians, opacity_mode: OpacityMode) -> Result<Self, SceneError> {
        check_lengths(&gaussians)?;
        let mut valid = vec![false; gaussians.len()];
        let dropped = valid
            .par_chunks_mut(CHECK_BLOCK)
            .zip(gaussians.slots().blocks(CHECK_BLOCK))
            .map(|(valid, (_, mut slots))| check_block(&mut slots, valid))
            .reduce(Dropped::default, Dropped::plus);
        if dropped.total() > 0 {
            gaussians.retain(|_, i| valid[i]);
        }
        if gaussians.is_empty() {
            return Err(SceneError::Empty { dropped: dropped.total() });
        }
        Ok(Self { gaussians, opacity_mode, dropped, details: Details::default() })
    }

    /// The Gaussians.
    #[must_use]
    pub const fn gaussians(&self) -> &Gaussians {
        &self.gaussians
    }

    /// The opacity mode that the scene was trained in.
    #[must_use]
    pub const fn opacity_mode(&self) -> OpacityMode {
        self.opacity_mode
    }

    /// What was invalid in the source and dropped.
    #[must_use]
    pub const fn dropped(&self) -> Dropped {
        self.dropped
    }

    /// What belongs to the scene beside its Gaussians.
    #[must_use]
    pub const fn details(&self) -> &Details {
        &self.details
    }

    /// The same scene with other details, from a file or from the scene that it is a part of. A near plane that is
    /// not positive and finite is ignored.
    #[must_use]
    pub fn with_details(mut self, details: Details) -> Self {
        let near = self.details.near;
        self.details = details;
        if !(self.details.near.is_finite() && self.details.near > 0.0) {
            self.details.near = near;
        }
        self
    }

    /// The same scene with another near plane, view-space z in world units. A near plane that is not positive and
    /// finite is ignored.
    #[must_use]
    pub fn with_near(self, near: f32) -> Self {
        let details = Details { near, ..self.details.clone() };
        self.with_details(details)
    }

    /// Gives the Gaussians back.
    #[must_use]
    pub fn into_gaussians(self) -> Gaussians {
        self.gaussians
    }
}

fn check_lengths(g: &Gaussians) -> Result<(), SceneError> {
    if g.sh_degree > MAX_SH_DEGREE {
        return Err(SceneError::ShDegree { actual: g.sh_degree });
    }
    let count = g.len();
    let planes = (g.means.iter().map(|p| ("means", p)))
        .chain(g.scales.iter().map(|p| ("scales", p)))
        .chain(g.rotations.iter().map(|p| ("rotations", p)));
    for (field, plane) in planes {
        if plane.len() != count {
            return Err(SceneError::Length { field, count, expected: count, actual: plane.len() });
        }
    }
    let expected = count * sh_coefficient_count(g.sh_degree) * 3;
    if g.sh.len() != expected {
        return Err(SceneError::Length { field: "sh", count, expected, actual: g.sh.len() });
    }
    Ok(())
}

/// Normalises the quaternions of a block, marks its valid Gaussians and counts the defects of the others.
fn check_block(slots: &mut Slots<'_>, valid: &mut [bool]) -> Dropped {
    let mut dropped = Dropped::default();
    for i in 0..valid.len() {
        valid[i] = is_valid(slots, i, &mut dropped);
    }
    dropped
}

/// Normalises the quaternion of Gaussian `i`; counts the first defect found.
fn is_valid(slots: &mut Slots<'_>, i: usize, dropped: &mut Dropped) -> bool {
    if !slots.means.iter().all(|plane| plane[i].abs() <= MAX_LENGTH) {
        dropped.invalid_mean += 1;
        return false;
    }
    if !slots.scales.iter().all(|plane| (0.0..=MAX_LENGTH).contains(&plane[i])) {
        dropped.invalid_scale += 1;
        return false;
    }
    let norm = (slots.rotations.iter()).map(|plane| f64::from(plane[i]).powi(2)).sum::<f64>().sqrt();
    if !norm.is_finite() || norm < f64::from(f32::MIN_POSITIVE) {
        dropped.invalid_rotation += 1;
        return false;
    }
    for plane in &mut slots.rotations {
        plane[i] = (f64::from(plane[i]) / norm) as f32;
    }
    if !(0.0..=1.0).contains(&slots.opacities[i]) {
        dropped.invalid_opacity += 1;
        return false;
    }
    let stride = slots.sh_stride;
    let sh = &slots.sh[i * stride..(i + 1) * stride];
    if sh.iter().all(|v| v.abs() <= MAX_SH) {
        return true;
    }
    if sh.iter().all(|v| v.is_finite()) {
        dropped.excessive_sh += 1;
    } else {
        dropped.non_finite_sh += 1;
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every defect is dropped under its own name, and the largest values that are none stay.
    #[test]
    fn invalid_gaussians_are_counted_by_reason() {
        let mut g = Gaussians::zeroed(12, 1);
        g.rotations[3] = vec![2.0; 12];
        (g.means[0][0], g.means[2][1]) = (-MAX_LENGTH, f32::NAN);
        g.means[1][10] = MAX_LENGTH.next_up();
        (g.scales[1][0], g.scales[1][2], g.scales[2][3]) = (MAX_LENGTH, -1e-9, MAX_LENGTH.next_up());
        g.rotations[3][4] = 0.0;
        g.opacities[5] = 1.1;
        let coefficient = |i: usize, k: usize| i * 12 + k;
        (g.sh[coefficient(0, 0)], g.sh[coefficient(0, 11)]) = (MAX_SH, -MAX_SH);
        // A Gaussian with both counts under the first.
        (g.sh[coefficient(6, 3)], g.sh[coefficient(6, 4)]) = (f32::NAN, 1e6);
        g.sh[coefficient(7, 11)] = f32::NEG_INFINITY;
        g.sh[coefficient(8, 0)] = f32::MAX;
        g.sh[coefficient(9, 11)] = -MAX_SH.next_up();
        let scene = Scene::new(g, OpacityMode::Default).unwrap();
        let expected = Dropped {
            invalid_mean: 2,
            invalid_scale: 2,
            invalid_rotation: 1,
            invalid_opacity: 1,
            non_finite_sh: 2,
            excessive_sh: 2,
        };
        assert_eq!((scene.dropped(), scene.dropped().total()), (expected, 10));
        assert_eq!(scene.gaussians().len(), 2);
        assert_eq!(scene.gaussians().sh_of(0)[0], MAX_SH);
        assert_eq!(scene.gaussians().rotation(1), [0.0, 0.0, 0.0, 1.0]);
    }
}
