//! SPZ (Niantic): gzip around a 16-byte header and one array per attribute.
//!
//! Source: the SPZ format description, versions 2 and 3. Coordinates in the file are right-up-back; scenes
//! here are, as in PLY, right-down-front, so y and z change sign, and with them the quaternions' y and z and
//! the spherical harmonics that are odd in them.

mod read;
mod write;

pub(super) use read::read;
pub use write::Clamped;
pub(super) use write::{clamped, fractional_bits, step, write};

/// "NGSP" as a little-endian number.
const MAGIC: u32 = 0x5053_474e;

/// Bytes of the header.
const HEADER: usize = 16;

/// Bit of the flags: trained with antialiasing.
const ANTIALIASED: u8 = 1;

/// Bit of the flags: extensions follow the arrays.
const EXTENDED: u8 = 2;

/// Colours cover more than 0 to 1, because higher harmonics may bring them back: code = dc · 0.15 + 0.5.
const COLOR_SCALE: f32 = 0.15;

/// Sign of each spherical-harmonics coefficient under y → −y, z → −z, the constant term first: the parity of
/// the number of y and z in its monomial.
const SH_SIGNS: [f32; 16] = [
    1.0, // constant
    -1.0, -1.0, 1.0, // y, z, x
    -1.0, 1.0, 1.0, -1.0, 1.0, // xy, yz, 2zz − xx − yy, xz, xx − yy
    -1.0, 1.0, -1.0, -1.0, 1.0, -1.0, 1.0, // y(…), xyz, y(…), z(…), x(…), z(…), x(…)
];

/// The same for quaternions (w, x, y, z) and positions (x, y, z).
const QUATERNION_SIGNS: [f32; 4] = [1.0, 1.0, -1.0, -1.0];
const POSITION_SIGNS: [f32; 3] = [1.0, -1.0, -1.0];

/// Bytes per Gaussian of each array, in the order of the file.
#[derive(Clone, Copy)]
struct Sizes {
    positions: usize,
    alphas: usize,
    colors: usize,
    scales: usize,
    rotations: usize,
    sh: usize,
}

impl Sizes {
    /// `version` is 2 or 3, `sh_degree` at most 3.
    const fn new(version: u32, sh_degree: u8) -> Self {
        let sh = (crate::gaussians::sh_coefficient_count(sh_degree) - 1) * 3;
        let rotations = if version == 2 { 3 } else { 4 };
        Self { positions: 9, alphas: 1, colors: 3, scales: 3, rotations, sh }
    }

    const fn total(self) -> usize {
        self.positions + self.alphas + self.colors + self.scales + self.rotations + self.sh
    }
}
