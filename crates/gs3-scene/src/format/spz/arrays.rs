//! The arrays of a file, one an attribute, and what their bytes mean.

use half::f16;

use super::super::quaternion::with_largest;
use super::{COLOR_SCALE, Sizes};
use crate::gaussians::Slots;

/// The attributes of all Gaussians, in the file's axes.
pub(super) struct Arrays<'a> {
    positions: &'a [u8],
    alphas: &'a [u8],
    colors: &'a [u8],
    scales: &'a [u8],
    rotations: &'a [u8],
    sh: &'a [u8],
    sizes: Sizes,
    /// World units of one step of fixed-point positions.
    unit: f64,
}

impl<'a> Arrays<'a> {
    /// `arrays` in the order of the file, each with as many Gaussians × its size of `sizes`.
    pub(super) fn new(arrays: [&'a [u8]; 6], sizes: Sizes, fractional_bits: u8) -> Self {
        let [positions, alphas, colors, scales, rotations, sh] = arrays;
        let unit = f64::from(fractional_bits).exp2().recip();
        Self { positions, alphas, colors, scales, rotations, sh, sizes, unit }
    }

    /// Unpacks Gaussians `first` and following of the file into `slots`.
    pub(super) fn unpack(&self, first: usize, slots: &mut Slots<'_>) {
        for i in 0..slots.len() {
            self.unpack_one(first + i, i, slots);
        }
    }

    fn unpack_one(&self, from: usize, to: usize, slots: &mut Slots<'_>) {
        let Self { sizes, .. } = self;
        let of = |array: &'a [u8], size: usize| &array[from * size..(from + 1) * size];
        let sh = &mut slots.sh[to * slots.sh_stride..(to + 1) * slots.sh_stride];
        let (positions, scales) = (of(self.positions, sizes.positions), of(self.scales, sizes.scales));
        let colors = of(self.colors, sizes.colors);
        for axis in 0..3 {
            slots.means[axis][to] = self.position(positions, axis);
            slots.scales[axis][to] = (f32::from(scales[axis]) / 16.0 - 10.0).exp();
            sh[axis] = (f32::from(colors[axis]) / 255.0 - 0.5) / COLOR_SCALE;
        }
        slots.opacities[to] = f32::from(self.alphas[from]) / 255.0;
        let rotation = match *of(self.rotations, sizes.rotations) {
            [x, y, z] => first_three([x, y, z]),
            [a, b, c, d] => smallest_three(u32::from_le_bytes([a, b, c, d])),
            _ => [0.0; 4],
        };
        for (plane, value) in slots.rotations.iter_mut().zip(rotation) {
            plane[to] = value;
        }
        for (value, code) in sh[3..].iter_mut().zip(of(self.sh, sizes.sh)) {
            *value = (f32::from(*code) - 128.0) / 128.0;
        }
    }

    /// A coordinate: a 16-bit float in version 1, a 24-bit fixed-point number since.
    fn position(&self, bytes: &[u8], axis: usize) -> f32 {
        if bytes.len() == 6 {
            return f16::from_le_bytes([bytes[axis * 2], bytes[axis * 2 + 1]]).to_f32();
        }
        let [low, middle, high] = [bytes[axis * 3], bytes[axis * 3 + 1], bytes[axis * 3 + 2]];
        // In the upper three bytes, so that the shift back extends the sign.
        let fixed = i32::from_le_bytes([0, low, middle, high]) >> 8;
        (f64::from(fixed) * self.unit) as f32
    }
}

/// Versions 1 and 2: x, y, z as bytes, w not negative. Result in the order w, x, y, z.
fn first_three(xyz: [u8; 3]) -> [f32; 4] {
    with_largest(0, xyz.map(|v| f32::from(v) / 127.5 - 1.0))
}

/// Since version 3: the index of the largest component (x, y, z, w) in the top two bits, then the others, each a
/// sign bit and 9 bits of magnitude up to √½. Result in the order w, x, y, z.
fn smallest_three(packed: u32) -> [f32; 4] {
    let component = |shift: u32| {
        let bits = packed >> shift;
        let magnitude = (bits & 511) as f32 / 511.0 * std::f32::consts::FRAC_1_SQRT_2;
        if bits & 512 == 0 { magnitude } else { -magnitude }
    };
    let [x, y, z, w] = with_largest((packed >> 30) as usize, [component(20), component(10), component(0)]);
    [w, x, y, z]
}
