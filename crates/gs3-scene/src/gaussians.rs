//! The Gaussians of a scene as a structure of arrays, activated: what the rasterizer reads.

/// `N` 3D Gaussians, one array per component so that sixteen of them load as sixteen lanes.
///
/// Values are activated (linear scale, opacity in `[0, 1]`), as a renderer needs them; readers apply `exp` and
/// `sigmoid` once. The fields may hold anything until [`crate::Scene::new`] has dropped invalid Gaussians.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gaussians {
    /// Centres in world units: planes `x`, `y`, `z`, each `[N]`.
    pub means: [Vec<f32>; 3],
    /// Standard deviations along the principal axes in world units, positive: planes `[N]`.
    pub scales: [Vec<f32>; 3],
    /// Rotations from principal axes to world as quaternions `w`, `x`, `y`, `z`: planes `[N]`. Normalised by
    /// [`crate::Scene::new`].
    pub rotations: [Vec<f32>; 4],
    /// Opacities in `[0, 1]`, `[N]`.
    pub opacities: Vec<f32>,
    /// Spherical-harmonics degree, 0 to 4.
    pub sh_degree: u8,
    /// Spherical-harmonics coefficients, `[N, (sh_degree + 1)², 3]` (coefficient-major, RGB innermost; the constant
    /// term first), in the sign convention and order of Kerbl et al. 2023: a channel is ½ + [`SH_C0`] · the constant
    /// term + what depends on the direction, at least 0.
    pub sh: Vec<f32>,
}

/// Largest spherical-harmonics degree that 3D Gaussian Splatting scenes use: 3 in nearly all, 4 in some.
pub const MAX_SH_DEGREE: u8 = 4;

/// The largest coordinate by magnitude, and the largest scale, that a scene may have: distances to such Gaussians and
/// what is made of them by slopes of rays stay eight orders of magnitude below the largest f32.
pub const MAX_LENGTH: f32 = 1e30;

/// The largest spherical-harmonics coefficient by magnitude that a scene may have: the largest number of 16 bits, in
/// which GPUs keep them. Trained ones are below 10. The 25 functions add up to at most √(25 · 25 / 4π) < 8 in any direction, so
/// that no colour overflows.
pub const MAX_SH: f32 = 65_504.0;

/// The constant spherical harmonic, 1 / (2 √π): a colour c that looks alike from everywhere has the constant term (c −
/// ½) / `SH_C0`.
pub const SH_C0: f32 = 0.28209479177387814;

/// The factor of the three functions of degree 1, −y, z and −x: √3 / (2 √π).
pub const SH_C1: f32 = 0.488_602_511_902_919_9;

/// The factors of degree 2, in the order of Kerbl et al. 2023: xy, yz, 2z² − x² − y², xz, x² − y².
pub const SH_C2: [f32; 5] = [
    1.092_548_430_592_079_2,
    -1.092_548_430_592_079_2,
    0.315_391_565_252_520_05,
    -1.092_548_430_592_079_2,
    0.546_274_215_296_039_6,
];

/// The factors of degree 3, in the order of Kerbl et al. 2023: y(3x² − y²), xyz, y(4z² − x² − y²),
/// z(2z² − 3x² − 3y²), x(4z² − x² − y²), z(x² − y²), x(x² − 3y²).
pub const SH_C3: [f32; 7] = [
    -0.590_043_589_926_643_5,
    2.890_611_442_640_554,
    -0.457_045_799_464_465_8,
    0.373_176_332_590_115_4,
    -0.457_045_799_464_465_8,
    1.445_305_721_320_277,
    -0.590_043_589_926_643_5,
];

/// The factors of degree 4, in the same order: xy(x² − y²), yz(3x² − y²), xy(7z² − 1), yz(7z² − 3), 35z⁴ − 30z² + 3,
/// xz(7z² − 3), (x² − y²)(7z² − 1), xz(x² − 3y²), x²(x² − 3y²) − y²(3x² − y²), of a unit vector.
pub const SH_C4: [f32; 9] = [
    2.503_342_941_796_704_6,
    -1.770_130_769_779_930_4,
    0.946_174_695_757_560_1,
    -0.669_046_543_557_289_2,
    0.105_785_546_915_204_31,
    -0.669_046_543_557_289_2,
    0.473_087_347_878_780_04,
    -1.770_130_769_779_930_4,
    0.625_835_735_449_176_1,
];

/// Number of spherical-harmonics coefficients per colour channel at `degree`, the constant term included.
#[must_use]
pub const fn sh_coefficient_count(degree: u8) -> usize {
    (degree as usize + 1) * (degree as usize + 1)
}

impl Gaussians {
    /// `count` zeroed Gaussians of the given spherical-harmonics degree, for a reader to fill in place.
    #[must_use]
    pub fn zeroed(count: usize, sh_degree: u8) -> Self {
        let plane = || vec![0.0; count];
        Self {
            means: std::array::from_fn(|_| plane()),
            scales: std::array::from_fn(|_| plane()),
            rotations: std::array::from_fn(|_| plane()),
            opacities: plane(),
            sh_degree,
            sh: vec![0.0; count * sh_coefficient_count(sh_degree) * 3],
        }
    }

    /// Number of Gaussians `N`.
    #[must_use]
    pub fn len(&self) -> usize {
        self.opacities.len()
    }

    /// Whether there are no Gaussians.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.opacities.is_empty()
    }

    /// The centre of Gaussian `i` in world units.
    #[must_use]
    pub fn mean(&self, i: usize) -> [f32; 3] {
        [self.means[0][i], self.means[1][i], self.means[2][i]]
    }

    /// The three standard deviations of Gaussian `i` in world units.
    #[must_use]
    pub fn scale(&self, i: usize) -> [f32; 3] {
        [self.scales[0][i], self.scales[1][i], self.scales[2][i]]
    }

    /// The rotation of Gaussian `i` as a quaternion `[w, x, y, z]`.
    #[must_use]
    pub fn rotation(&self, i: usize) -> [f32; 4] {
        [self.rotations[0][i], self.rotations[1][i], self.rotations[2][i], self.rotations[3][i]]
    }

    /// Floats per Gaussian in [`Self::sh`].
    #[must_use]
    pub const fn sh_stride(&self) -> usize {
        sh_coefficient_count(self.sh_degree) * 3
    }

    /// The spherical-harmonics coefficients of Gaussian `i`, `[(sh_degree + 1)², 3]`.
    #[must_use]
    pub fn sh_of(&self, i: usize) -> &[f32] {
        let stride = self.sh_stride();
        &self.sh[i * stride..(i + 1) * stride]
    }

    /// Size of the parameters as f32, in bytes.
    #[must_use]
    pub fn byte_size(&self) -> usize {
        self.len() * (3 + 3 + 4 + 1 + self.sh_stride()) * size_of::<f32>()
    }

    /// Appends `other`, padding the lower of the two spherical-harmonics degrees with zeros.
    pub fn append(&mut self, other: &Self) {
        let degree = self.sh_degree.max(other.sh_degree);
        self.pad_sh_to(degree);
        for (to, from) in self.means.iter_mut().zip(&other.means) {
            to.extend_from_slice(from);
        }
        for (to, from) in self.scales.iter_mut().zip(&other.scales) {
            to.extend_from_slice(from);
        }
        for (to, from) in self.rotations.iter_mut().zip(&other.rotations) {
            to.extend_from_slice(from);
        }
        self.opacities.extend_from_slice(&other.opacities);
        let (stride, other_stride) = (self.sh_stride(), other.sh_stride());
        self.sh.reserve(other.len() * stride);
        for row in other.sh.chunks_exact(other_stride) {
            self.sh.extend_from_slice(row);
            self.sh.resize(self.sh.len() + stride - other_stride, 0.0);
        }
    }

    fn pad_sh_to(&mut self, degree: u8) {
        if degree == self.sh_degree {
            return;
        }
        let from = self.sh_stride();
        let to = sh_coefficient_count(degree) * 3;
        let mut padded = vec![0.0; self.len() * to];
        for (row, old) in padded.chunks_exact_mut(to).zip(self.sh.chunks_exact(from)) {
            row[..from].copy_from_slice(old);
        }
        self.sh = padded;
        self.sh_degree = degree;
    }

    /// The Gaussians as slots to fill, for readers that write disjoint ranges from several threads.
    pub(crate) fn slots(&mut self) -> Slots<'_> {
        let sh_stride = self.sh_stride();
        Slots {
            means: self.means.each_mut().map(Vec::as_mut_slice),
            scales: self.scales.each_mut().map(Vec::as_mut_slice),
            rotations: self.rotations.each_mut().map(Vec::as_mut_slice),
            opacities: &mut self.opacities,
            sh: &mut self.sh,
            sh_stride,
        }
    }

    /// Keeps the Gaussians for which `keep` holds, in order, in place.
    pub fn retain(&mut self, keep: impl Fn(&Self, usize) -> bool) {
        let stride = self.sh_stride();
        let mut kept = 0;
        for i in 0..self.len() {
            if !keep(self, i) {
                continue;
            }
            if kept != i {
                let planes = self.means.iter_mut().chain(&mut self.scales).chain(&mut self.rotations);
                for plane in planes {
                    plane[kept] = plane[i];
                }
                self.opacities[kept] = self.opacities[i];
                self.sh.copy_within(i * stride..(i + 1) * stride, kept * stride);
            }
            kept += 1;
        }
        let planes = self.means.iter_mut().chain(&mut self.scales).chain(&mut self.rotations);
        for plane in planes {
            plane.truncate(kept);
        }
        self.opacities.truncate(kept);
        self.sh.truncate(kept * stride);
    }
}

/// A mutable range of [`Gaussians`]: the same planes, borrowed, so that threads can fill disjoint ranges.
pub(crate) struct Slots<'a> {
    pub(crate) means: [&'a mut [f32]; 3],
    pub(crate) scales: [&'a mut [f32]; 3],
    pub(crate) rotations: [&'a mut [f32]; 4],
    pub(crate) opacities: &'a mut [f32],
    /// `[N, sh_stride]`.
    pub(crate) sh: &'a mut [f32],
    /// Floats per Gaussian in `sh`.
    pub(crate) sh_stride: usize,
}

impl<'a> Slots<'a> {
    pub(crate) fn len(&self) -> usize {
        self.opacities.len()
    }

    /// The first `count` slots and the others; `count` is at most [`Self::len`].
    pub(crate) fn split_at(self, count: usize) -> (Self, Self) {
        let (means, means_rest) = split_planes(self.means, count);
        let (scales, scales_rest) = split_planes(self.scales, count);
        let (rotations, rotations_rest) = split_planes(self.rotations, count);
        let (opacities, opacities_rest) = self.opacities.split_at_mut(count);
        let sh_stride = self.sh_stride;
        let (sh, sh_rest) = self.sh.split_at_mut(count * sh_stride);
        (
            Self { means, scales, rotations, opacities, sh, sh_stride },
            Self {
                means: means_rest,
                scales: scales_rest,
                rotations: rotations_rest,
                opacities: opacities_rest,
                sh: sh_rest,
                sh_stride,
            },
        )
    }

    /// Ranges of `size` slots (the last may be shorter), each with the index of its first slot.
    pub(crate) fn blocks(self, size: usize) -> Vec<(usize, Self)> {
        let mut blocks = Vec::with_capacity(self.len().div_ceil(size));
        let (mut first, mut rest) = (0, self);
        while rest.len() > size {
            let (block, others) = rest.split_at(size);
            blocks.push((first, block));
            first += size;
            rest = others;
        }
        if rest.len() > 0 {
            blocks.push((first, rest));
        }
        blocks
    }
}

fn split_planes<const PLANES: usize>(
    planes: [&mut [f32]; PLANES],
    count: usize,
) -> ([&mut [f32]; PLANES], [&mut [f32]; PLANES]) {
    let mut rest = [const { None }; PLANES];
    let mut index = 0;
    let first = planes.map(|plane| {
        let (first, others) = plane.split_at_mut(count);
        rest[index] = Some(others);
        index += 1;
        first
    });
    // Every element was set by the map above, which visits each plane once.
    (first, rest.map(Option::unwrap_or_default))
}
