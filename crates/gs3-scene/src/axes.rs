//! Which way the axes of a file point.

use std::fmt;
use std::str::FromStr;

use glam::{DMat3, DVec3};

/// The directions of the x, y and z axis, each one of right or left, up or down, front or back.
///
/// Scenes in memory are right-down-front ([`Axes::RDF`]), as PLY files of 3D Gaussian Splatting are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Axes {
    /// Letters of [`LETTERS`], one of each pair.
    letters: [u8; 3],
}

/// Pairs of opposite directions along the axes of right-down-front, the positive one first.
const LETTERS: [[u8; 2]; 3] = [*b"RL", *b"DU", *b"FB"];

/// The numbers of the SPZ extension `SPZ_ADOBE_coordinate_system`, from 1 on.
const CODES: [[u8; 3]; 16] = [
    *b"LDB", *b"RDB", *b"LUB", *b"RUB", *b"LDF", *b"RDF", *b"LUF", *b"RUF", *b"LFD", *b"RFD", *b"LFU",
    *b"RFU", *b"LBD", *b"RBD", *b"LBU", *b"RBU",
];

impl Axes {
    /// Right-down-front: scenes in memory, PLY.
    pub const RDF: Self = Self { letters: *b"RDF" };
    /// Right-up-back: SPZ.
    pub const RUB: Self = Self { letters: *b"RUB" };
    /// Right-front-up: LCC2.
    pub const RFU: Self = Self { letters: *b"RFU" };
    /// Left-up-front: glTF.
    pub const LUF: Self = Self { letters: *b"LUF" };

    /// The axes that have this number in SPZ's extension, 1 to 16.
    #[must_use]
    pub fn from_code(code: u32) -> Option<Self> {
        let index = usize::try_from(code).ok()?.checked_sub(1)?;
        CODES.get(index).map(|letters| Self { letters: *letters })
    }

    /// The number of these axes in SPZ's extension, where they have one.
    #[must_use]
    pub fn code(self) -> Option<u32> {
        CODES.iter().position(|letters| *letters == self.letters).map(|index| index as u32 + 1)
    }

    /// The orthogonal matrix from these axes to right-down-front.
    #[must_use]
    pub fn to_rdf(self) -> DMat3 {
        let column = |letter: u8| {
            let mut column = DVec3::ZERO;
            for (axis, [positive, negative]) in LETTERS.into_iter().enumerate() {
                if letter == positive {
                    column[axis] = 1.0;
                } else if letter == negative {
                    column[axis] = -1.0;
                }
            }
            column
        };
        let [x, y, z] = self.letters.map(column);
        DMat3::from_cols(x, y, z)
    }
}

impl FromStr for Axes {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let letters: Option<[u8; 3]> = text.to_ascii_uppercase().as_bytes().try_into().ok();
        // Every pair has exactly one letter.
        let is_complete = |letters: &[u8; 3]| {
            LETTERS.iter().all(|pair| letters.iter().filter(|letter| pair.contains(letter)).count() == 1)
        };
        letters.filter(is_complete).map(|letters| Self { letters }).ok_or_else(|| {
            format!(
                "expected where x, y and z point, as rdf (right, down, front) or rub (right, up, back), found {text}"
            )
        })
    }
}

impl fmt::Display for Axes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = |letter| match letter {
            b'R' => "right",
            b'L' => "left",
            b'D' => "down",
            b'U' => "up",
            b'F' => "front",
            _ => "back",
        };
        let [x, y, z] = self.letters.map(name);
        write!(f, "{x}-{y}-{z}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_are_named_numbered_and_turned() {
        assert_eq!(Axes::from_code(4), Some(Axes::RUB));
        assert_eq!(Axes::from_code(6), Some(Axes::RDF));
        assert_eq!("rub".parse(), Ok(Axes::RUB));
        assert_eq!("Luf".parse(), Ok(Axes::LUF));
        assert_eq!("fdr".parse::<Axes>().map(Axes::code), Ok(None));
        assert_eq!((Axes::from_code(0), Axes::from_code(17)), (None, None));
        for wrong in ["", "rd", "rdff", "rdx", "rrf", "rlf", "ördf"] {
            assert!(wrong.parse::<Axes>().is_err(), "{wrong}");
        }
        for code in 1..=16 {
            let axes = Axes::from_code(code).unwrap();
            assert_eq!(axes.code(), Some(code));
            assert_eq!(axes.to_rdf().determinant().abs(), 1.0);
        }
        assert_eq!(Axes::RUB.to_rdf(), DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)));
        // Right, front, up: what is up is along z.
        let rfu: Axes = "rfu".parse().unwrap();
        assert_eq!(rfu.to_rdf() * DVec3::Z, DVec3::NEG_Y);
        assert_eq!(rfu.to_rdf() * DVec3::Y, DVec3::Z);
        assert_eq!(Axes::LUF.to_string(), "left-up-front");
    }
}
