//! Rotations and reflections of Gaussians with their spherical harmonics.

use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;

use crate::gaussians::{Gaussians, MAX_SH_DEGREE, SH_C0, SH_C1, SH_C2, SH_C3, SH_C4, Slots};

/// Gaussians that one task transforms.
const BLOCK: usize = 4096;

/// Directions from which [`ShTransform`] is found: more than the 25 functions, evenly over the sphere, so that the
/// equations are well conditioned.
const DIRECTIONS: usize = 128;

/// Entries of [`ShTransform`] below this are rounding. A change of axes has entries 0 and ±1 only.
const ROUNDING: f64 = 1e-12;

/// All functions up to degree 4 along the unit vector `d`, in the order and with the signs of Kerbl et al. 2023.
#[must_use]
pub fn sh_functions(d: DVec3) -> [f64; 25] {
    let DVec3 { x, y, z } = d;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let shapes = [
        1.0,
        -y,
        z,
        -x,
        x * y,
        y * z,
        2.0 * zz - xx - yy,
        x * z,
        xx - yy,
        y * (3.0 * xx - yy),
        x * y * z,
        y * (4.0 * zz - xx - yy),
        z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        x * (4.0 * zz - xx - yy),
        z * (xx - yy),
        x * (xx - 3.0 * yy),
        x * y * (xx - yy),
        y * z * (3.0 * xx - yy),
        x * y * (7.0 * zz - 1.0),
        y * z * (7.0 * zz - 3.0),
        zz * (35.0 * zz - 30.0) + 3.0,
        x * z * (7.0 * zz - 3.0),
        (xx - yy) * (7.0 * zz - 1.0),
        x * z * (xx - 3.0 * yy),
        xx * (xx - 3.0 * yy) - yy * (3.0 * xx - yy),
    ];
    let factors = [SH_C0, SH_C1, SH_C1, SH_C1].into_iter().chain(SH_C2).chain(SH_C3).chain(SH_C4);
    let mut values = [0.0; 25];
    for ((value, shape), factor) in values.iter_mut().zip(shapes).zip(factors) {
        *value = shape * f64::from(factor);
    }
    values
}

/// What a rotation or reflection of space does to spherical harmonics: a matrix for each degree.
#[derive(Clone, Debug)]
pub struct ShTransform {
    /// For degrees 1 to 4 the non-zero entries `(row, column, value)`, rows and columns counted within the degree.
    degrees: [Vec<(usize, usize, f32)>; MAX_SH_DEGREE as usize],
}

impl ShTransform {
    /// The transform of the orthogonal matrix `to_from`: coefficients of a function f become coefficients of d ↦
    /// f(to_from⁻¹ d).
    ///
    /// The transform is found numerically. The functions of a degree span a space that orthogonal matrices map to
    /// itself, so the transform is the least-squares solution over directions all around.
    #[must_use]
    pub fn new(to_from: DMat3) -> Self {
        // Directions of a Fibonacci spiral.
        let direction = |k: usize| {
            let z = 1.0 - 2.0 * (k as f64 + 0.5) / DIRECTIONS as f64;
            let angle = k as f64 * std::f64::consts::PI * (3.0 - 5.0f64.sqrt());
            let radius = (1.0 - z * z).sqrt();
            DVec3::new(radius * angle.cos(), radius * angle.sin(), z)
        };
        let from: Vec<[f64; 25]> =
            (0..DIRECTIONS).map(|k| sh_functions(to_from.transpose() * direction(k))).collect();
        let to: Vec<[f64; 25]> = (0..DIRECTIONS).map(|k| sh_functions(direction(k))).collect();
        Self { degrees: std::array::from_fn(|k| solve(k + 1, &from, &to)) }
    }

    /// Transforms one Gaussian's coefficients in place: `[K, 3]`, K = 1, 4, 9, 16 or 25.
    pub fn apply(&self, sh: &mut [f32]) {
        for (k, entries) in self.degrees.iter().enumerate() {
            let degree = k + 1;
            let (start, end) = (degree * degree * 3, (degree + 1) * (degree + 1) * 3);
            let Some(of_degree) = sh.get_mut(start..end) else { break };
            let mut sums = [0.0; 27];
            for (row, column, value) in entries {
                for c in 0..3 {
                    sums[row * 3 + c] += value * of_degree[column * 3 + c];
                }
            }
            let count = of_degree.len();
            of_degree.copy_from_slice(&sums[..count]);
        }
    }
}

/// The matrix of `degree` with which `to · matrix = from`, its entries that are not 0.
fn solve(degree: usize, from: &[[f64; 25]], to: &[[f64; 25]]) -> Vec<(usize, usize, f32)> {
    let first = degree * degree;
    let size = 2 * degree + 1;
    // Normal equations, [toᵀ·to | toᵀ·from], solved by elimination with pivots.
    let mut rows = vec![vec![0.0; 2 * size]; size];
    for (a, b) in to.iter().zip(from) {
        for (i, row) in rows.iter_mut().enumerate() {
            for j in 0..size {
                row[j] += a[first + i] * a[first + j];
                row[size + j] += a[first + i] * b[first + j];
            }
        }
    }
    for k in 0..size {
        let pivot = (k..size).max_by(|a, b| rows[*a][k].abs().total_cmp(&rows[*b][k].abs())).unwrap_or(k);
        rows.swap(k, pivot);
        let scale = 1.0 / rows[k][k];
        rows[k].iter_mut().for_each(|value| *value *= scale);
        let pivot_row = rows[k].clone();
        for (i, row) in rows.iter_mut().enumerate() {
            let factor = row[k];
            if i != k {
                row.iter_mut().zip(&pivot_row).for_each(|(value, above)| *value -= factor * above);
            }
        }
    }
    let entries = rows.iter().enumerate().flat_map(|(i, row)| (0..size).map(move |j| (i, j, row[size + j])));
    entries.filter(|(.., value)| value.abs() > ROUNDING).map(|(i, j, value)| (i, j, value as f32)).collect()
}

/// An orthogonal matrix, a scale and a shift: p ↦ scale · (to_from · p) + shift.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// Rotation or reflection: orthogonal.
    pub to_from: DMat3,
    /// Positive.
    pub scale: f64,
    /// In the units of the result.
    pub shift: DVec3,
}

impl Similarity {
    /// The similarity of an orthogonal matrix, without scale and shift.
    #[must_use]
    pub const fn orthogonal(to_from: DMat3) -> Self {
        Self { to_from, scale: 1.0, shift: DVec3::ZERO }
    }
}

/// Moves Gaussians, turns or reflects them with their spherical harmonics, and scales them.
pub(crate) fn transform(gaussians: &mut Gaussians, by: &Similarity) {
    if *by == Similarity::orthogonal(DMat3::IDENTITY) {
        return;
    }
    let transform = Transform::new(by);
    gaussians.slots().blocks(BLOCK).into_par_iter().for_each(|(_, mut slots)| transform.apply(&mut slots));
}

/// [`Similarity`], prepared for many Gaussians.
pub(crate) struct Transform {
    by: Similarity,
    sh: ShTransform,
    turn: Turn,
}

/// What happens to the rotations Q of ellipsoids. Their covariance sees no signs of principal axes, so any matrix that
/// leads to the same axes but for signs will do.
enum Turn {
    /// Of a diagonal matrix F of signs, F·Q·F: the quaternion's parts change sign, and nothing is rounded.
    Signs([f32; 4]),
    /// Of another matrix R, R·Q, or −R·Q where R reflects.
    By(DQuat),
}

impl Transform {
    pub(crate) fn new(by: &Similarity) -> Self {
        let to_from = by.to_from;
        let signs = DVec3::new(to_from.x_axis.x, to_from.y_axis.y, to_from.z_axis.z);
        let turn = if to_from == DMat3::from_diagonal(signs) && signs.abs() == DVec3::ONE {
            let [x, y, z] = signs.to_array().map(|sign| sign as f32);
            Turn::Signs([1.0, y * z, x * z, x * y])
        } else {
            let proper = if to_from.determinant() < 0.0 { -to_from } else { to_from };
            Turn::By(DQuat::from_mat3(&proper).normalize())
        };
        Self { by: *by, sh: ShTransform::new(to_from), turn }
    }

    pub(crate) fn apply(&self, slots: &mut Slots<'_>) {
        let Similarity { to_from, scale, shift } = self.by;
        for i in 0..slots.len() {
            let mean = DVec3::from([0, 1, 2].map(|axis| f64::from(slots.means[axis][i])));
            let moved = scale * (to_from * mean) + shift;
            let q = [0, 1, 2, 3].map(|k| slots.rotations[k][i]);
            let turned = match &self.turn {
                Turn::Signs(signs) => std::array::from_fn(|k| q[k] * signs[k]),
                Turn::By(rotation) => {
                    let [w, x, y, z] = q.map(f64::from);
                    let turned = *rotation * DQuat::from_xyzw(x, y, z, w);
                    [turned.w, turned.x, turned.y, turned.z].map(|value| value as f32)
                }
            };
            for (plane, value) in slots.rotations.iter_mut().zip(turned) {
                plane[i] = value;
            }
            for axis in 0..3 {
                slots.means[axis][i] = moved[axis] as f32;
                slots.scales[axis][i] *= scale as f32;
            }
        }
        for sh in slots.sh.chunks_exact_mut(slots.sh_stride) {
            self.sh.apply(sh);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(sh: &[f32], d: DVec3) -> f64 {
        sh_functions(d).iter().zip(sh.iter().step_by(3)).map(|(f, c)| f * f64::from(*c)).sum()
    }

    /// A turned function, looked at along a turned direction, is the function.
    #[test]
    fn harmonics_turn_and_reflect_with_space() {
        let turn = DMat3::from_quat(DQuat::from_xyzw(0.3, -0.5, 0.2, 0.7).normalize());
        let mirror = DMat3::from_cols(DVec3::Y, DVec3::X, DVec3::NEG_Z);
        let flip = DMat3::from_diagonal(DVec3::new(1.0, -1.0, 1.0));
        for matrix in [turn, mirror, flip, turn * flip] {
            let before: Vec<f32> = (0..75).map(|k| ((k * 37 % 19) as f32 - 9.0) / 9.0).collect();
            let mut after = before.clone();
            ShTransform::new(matrix).apply(&mut after);
            for d in [DVec3::X, DVec3::new(0.6, 0.0, -0.8), DVec3::new(1.0, 2.0, -0.5).normalize()] {
                let (a, b) = (value(&before, d), value(&after, matrix * d));
                assert!((a - b).abs() < 1e-5, "{matrix}: {a} is not {b}");
            }
        }
    }

    /// The transformed covariance has the transformed principal axes.
    #[test]
    fn gaussians_turn_reflect_and_grow() {
        let covariance = |g: &Gaussians| {
            let [w, x, y, z] = g.rotation(0).map(f64::from);
            let r = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w));
            let s = DMat3::from_diagonal(DVec3::from(g.scale(0).map(f64::from)));
            r * s * s * r.transpose()
        };
        let mut before = Gaussians::zeroed(1, 1);
        for (k, value) in [0.5, -0.5, 0.1, 0.7].into_iter().enumerate() {
            before.rotations[k][0] = value;
        }
        for axis in 0..3 {
            before.means[axis][0] = [1.0, -2.0, 0.5][axis];
            before.scales[axis][0] = [0.1, 1.0, 3.0][axis];
        }
        for to_from in [
            DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0)),
            DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)),
            DMat3::from_cols(DVec3::Z, DVec3::X, DVec3::Y),
            DMat3::from_cols(DVec3::Y, DVec3::X, DVec3::Z),
        ] {
            let by = Similarity { to_from, scale: 2.0, shift: DVec3::new(0.0, 10.0, 0.0) };
            let mut after = before.clone();
            transform(&mut after, &by);
            let norm = before.rotation(0).iter().map(|v| v * v).sum::<f32>();
            assert!((after.rotation(0).iter().map(|v| v * v).sum::<f32>() - norm).abs() < 1e-6);
            let expected = 4.0 * (to_from * covariance(&before) * to_from.transpose());
            assert!((covariance(&after) - expected).to_cols_array().iter().all(|v| v.abs() < 1e-5));
            let mean = DVec3::from(after.mean(0).map(f64::from));
            assert!(mean.distance(2.0 * (to_from * DVec3::new(1.0, -2.0, 0.5)) + by.shift) < 1e-6);
        }
    }
}
