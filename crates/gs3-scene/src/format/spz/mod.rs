//! SPZ (Niantic): a header and one array per attribute. Versions 1 to 3 are one gzip stream; in version 4 every array is
//! a Zstandard frame of its own.
//!
//! Source: the SPZ format description and its reference implementation, versions 1 to 4. Coordinates in a file are
//! right-up-back unless an extension states others; scenes here are, as in PLY, right-down-front, so y and z change
//! sign, and with them the quaternions' y and z and the spherical harmonics that are odd in them.

mod arrays;
mod extensions;
mod read;
mod streams;
mod write;

pub(super) use read::read;
pub use write::Clamped;
pub(super) use write::{Version, clamped, fractional_bits, step, write};

/// "NGSP" as a little-endian number.
const MAGIC: u32 = 0x5053_474e;

/// Bytes of the header of versions 1 to 3. The header of version 4 begins with the same bytes but the last.
const HEADER: usize = 16;

/// Bytes of the header of version 4.
const STREAMS_HEADER: usize = 32;

/// Bytes of an entry of the table of streams: the sizes compressed and not.
const STREAM_ENTRY: usize = 16;

/// Bit of the flags: trained with antialiasing.
const ANTIALIASED: u8 = 1;

/// Bit of the flags: extensions follow the arrays.
const EXTENDED: u8 = 2;

/// Colours cover more than 0 to 1, because higher harmonics may bring them back: code = dc · 0.15 + 0.5.
const COLOR_SCALE: f32 = 0.15;

/// Sign of each spherical-harmonics coefficient under y → −y, z → −z, the constant term first: the parity of
/// the number of y and z in its monomial.
const SH_SIGNS: [f32; 25] = [
    1.0, // constant
    -1.0, -1.0, 1.0, // y, z, x
    -1.0, 1.0, 1.0, -1.0, 1.0, // xy, yz, 2zz − xx − yy, xz, xx − yy
    -1.0, 1.0, -1.0, -1.0, 1.0, -1.0, 1.0, // y(…), xyz, y(…), z(…), x(…), z(…), x(…)
    -1.0, 1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0,
    1.0, // xy(…), yz(…), xy(…), yz(…), …, xz(…), xx − yy, xz(…), …
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
    /// `version` is 1 to 4, `sh_degree` at most 4.
    const fn new(version: u32, sh_degree: u8) -> Self {
        let sh = (crate::gaussians::sh_coefficient_count(sh_degree) - 1) * 3;
        let positions = if version == 1 { 6 } else { 9 };
        let rotations = if version <= 2 { 3 } else { 4 };
        Self { positions, alphas: 1, colors: 3, scales: 3, rotations, sh }
    }

    /// In the order of the file.
    const fn in_order(self) -> [usize; 6] {
        [self.positions, self.alphas, self.colors, self.scales, self.rotations, self.sh]
    }

    const fn total(self) -> usize {
        self.positions + self.alphas + self.colors + self.scales + self.rotations + self.sh
    }
}
