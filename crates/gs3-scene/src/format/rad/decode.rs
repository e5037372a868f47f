//! Encodings of properties.

use std::io::Read;

use flate2::read::DeflateDecoder;
use half::f16;
use serde::Deserialize;

use super::super::error::LoadError;

/// A property of a chunk's Gaussians, as the chunk describes it.
#[derive(Debug, Deserialize)]
pub(super) struct Property {
    /// From the start of the payload on.
    offset: u64,
    bytes: u64,
    pub(super) property: String,
    encoding: Encoding,
    compression: Option<Compression>,
    min: Option<f32>,
    max: Option<f32>,
}

/// How values are written; planes of one dimension after another but for [`Encoding::Oct88R8`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Encoding {
    F32,
    F16,
    /// All lowest bytes, then the next, …
    F32Lebytes,
    F16Lebytes,
    /// A byte between `min` and `max`.
    R8,
    /// The same, as differences within a dimension.
    R8Delta,
    /// A signed byte of `max`.
    S8,
    S8Delta,
    /// Logarithms as bytes; 0 is 0.
    #[serde(rename = "ln_0r8")]
    Ln0R8,
    LnF16,
    /// A rotation: octahedral axis in two bytes, angle in one.
    #[serde(rename = "oct88r8")]
    Oct88R8,
    U16,
    U32,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Compression {
    /// DEFLATE without a header, in spite of the name.
    Gz,
}

impl Property {
    /// `[count, dimensions]` values.
    pub(super) fn decode(
        &self,
        file: &str,
        payload: &[u8],
        dimensions: usize,
        count: usize,
    ) -> Result<Vec<f32>, LoadError> {
        let name = &self.property;
        let bytes_each = self.encoding.bytes(dimensions);
        let size = count * bytes_each;
        let bytes = usize::try_from(self.offset).ok().and_then(|start| {
            let end = start.checked_add(usize::try_from(self.bytes).ok()?)?;
            payload.get(start..end)
        });
        let Some(bytes) = bytes else {
            let actual = format!("{} bytes at {}", self.bytes, self.offset);
            return Err(LoadError::invalid(file, name, "bytes within the chunk", actual));
        };
        let unpacked;
        let bytes = match self.compression {
            None => bytes,
            Some(Compression::Gz) => {
                unpacked = inflate(file, name, bytes, size)?;
                &unpacked[..]
            }
        };
        if bytes.len() != size {
            let expected = format!("{size} bytes for {count} Gaussians");
            return Err(LoadError::invalid(file, name, expected, bytes.len().to_string()));
        }
        let needed = |bound: Option<f32>, what: &str| {
            bound.ok_or_else(|| LoadError::invalid(file, format!("{name}.{what}"), "a number", "none"))
        };
        let mut values = vec![0.0; count * dimensions];
        let plane = |d: usize, i: usize| d * count + i;
        let mut fill = |value: &mut dyn FnMut(usize) -> f32| {
            for d in 0..dimensions {
                for i in 0..count {
                    values[i * dimensions + d] = value(plane(d, i));
                }
            }
        };
        let word = |at: usize| [bytes[4 * at], bytes[4 * at + 1], bytes[4 * at + 2], bytes[4 * at + 3]];
        let half = |at: usize| u16::from_le_bytes([bytes[2 * at], bytes[2 * at + 1]]);
        let stride = count * dimensions;
        match self.encoding {
            Encoding::F32 => fill(&mut |at| f32::from_le_bytes(word(at))),
            Encoding::U32 => fill(&mut |at| u32::from_le_bytes(word(at)) as f32),
            Encoding::F16 => fill(&mut |at| f16::from_bits(half(at)).to_f32()),
            Encoding::U16 => fill(&mut |at| f32::from(half(at))),
            Encoding::LnF16 => fill(&mut |at| f16::from_bits(half(at)).to_f32().exp()),
            Encoding::F32Lebytes => {
                fill(&mut |at| f32::from_le_bytes([0, 1, 2, 3].map(|b| bytes[at + b * stride])));
            }
            Encoding::F16Lebytes => {
                fill(&mut |at| f16::from_le_bytes([bytes[at], bytes[at + stride]]).to_f32());
            }
            Encoding::R8 | Encoding::R8Delta => {
                let (min, max) = (needed(self.min, "min")?, needed(self.max, "max")?);
                let codes = if self.encoding == Encoding::R8 { bytes.to_vec() } else { summed(bytes, count) };
                fill(&mut |at| f32::from(codes[at]) / 255.0 * (max - min) + min);
            }
            Encoding::S8 | Encoding::S8Delta => {
                let max = needed(self.max, "max")?;
                let codes = if self.encoding == Encoding::S8 { bytes.to_vec() } else { summed(bytes, count) };
                fill(&mut |at| f32::from(codes[at] as i8) / 127.0 * max);
            }
            Encoding::Ln0R8 => {
                let (min, max) = (needed(self.min, "min")?, needed(self.max, "max")?);
                fill(&mut |at| match bytes[at] {
                    0 => 0.0,
                    code => (min + f32::from(code - 1) * (max - min) / 254.0).exp(),
                });
            }
            Encoding::Oct88R8 => {
                if dimensions != 4 {
                    return Err(LoadError::invalid(file, name, "an encoding of numbers", "one of rotations"));
                }
                for (to, [u, v, angle]) in
                    values.as_chunks_mut::<4>().0.iter_mut().zip(bytes.as_chunks::<3>().0)
                {
                    *to = rotation([*u, *v], *angle);
                }
            }
        }
        Ok(values)
    }
}

impl Encoding {
    /// Bytes of an element.
    const fn bytes(self, dimensions: usize) -> usize {
        match self {
            Self::F32 | Self::F32Lebytes | Self::U32 => 4 * dimensions,
            Self::F16 | Self::F16Lebytes | Self::LnF16 | Self::U16 => 2 * dimensions,
            Self::R8 | Self::R8Delta | Self::S8 | Self::S8Delta | Self::Ln0R8 => dimensions,
            Self::Oct88R8 => 3,
        }
    }
}

/// At most `size` bytes and one of what `bytes` unpack to.
fn inflate(file: &str, name: &str, bytes: &[u8], size: usize) -> Result<Vec<u8>, LoadError> {
    let mut unpacked = Vec::new();
    let read = DeflateDecoder::new(bytes).take(size as u64 + 1).read_to_end(&mut unpacked);
    read.map_err(|error| LoadError::invalid(file, name, "DEFLATE data", error.to_string()))?;
    Ok(unpacked)
}

/// Sums of the differences that `bytes` are, plane by plane of `count`.
fn summed(bytes: &[u8], count: usize) -> Vec<u8> {
    let mut sums = bytes.to_vec();
    for plane in sums.chunks_mut(count.max(1)) {
        let mut last = 0u8;
        for value in plane {
            last = last.wrapping_add(*value);
            *value = last;
        }
    }
    sums
}

/// The quaternion x, y, z, w of an axis on the octahedron, folded into a square, and an angle up to π.
fn rotation(square: [u8; 2], angle: u8) -> [f32; 4] {
    let [u, v] = square.map(|code| f32::from(code) / 255.0 * 2.0 - 1.0);
    let z = 1.0 - u.abs() - v.abs();
    let fold = (-z).max(0.0);
    let unfolded = |value: f32| if value >= 0.0 { value - fold } else { value + fold };
    let axis = [unfolded(u), unfolded(v), z];
    let length = axis.iter().map(|value| value * value).sum::<f32>().sqrt();
    let (sin, cos) = (f32::from(angle) / 255.0 * std::f32::consts::FRAC_PI_2).sin_cos();
    let [x, y, z] = axis.map(|value| value / length * sin);
    [x, y, z, cos]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn property(encoding: &str, bytes: usize) -> Property {
        let json = format!(
            r#"{{"offset": 0, "bytes": {bytes}, "property": "rgb", "encoding": "{encoding}", "min": -1, "max": 3}}"#
        );
        serde_json::from_str(&json).unwrap()
    }

    /// Two elements of two dimensions in every encoding of numbers.
    #[test]
    fn values_lie_in_planes() {
        let half = |v: f32| f16::from_f32(v).to_le_bytes();
        // The second and the third value of an encoding change places: element by element.
        let cases: [(&str, Vec<u8>, [f32; 4]); 9] = [
            (
                "f32",
                [1.0f32, 2.0, 3.0, 4.0].iter().flat_map(|v| v.to_le_bytes()).collect(),
                [1.0, 3.0, 2.0, 4.0],
            ),
            ("f16", [1.0, 2.0, 3.0, 4.0].into_iter().flat_map(half).collect(), [1.0, 3.0, 2.0, 4.0]),
            ("u16", vec![1, 0, 2, 0, 3, 0, 0, 1], [1.0, 3.0, 2.0, 256.0]),
            ("u32", vec![1, 0, 0, 0, 2, 0, 0, 0, 3, 0, 0, 0, 0, 1, 0, 0], [1.0, 3.0, 2.0, 256.0]),
            ("r8", vec![0, 255, 51, 102], [-1.0, -0.2, 3.0, 0.6]),
            ("r8_delta", vec![51, 51, 255, 1], [-0.2, 3.0, 0.6, -1.0]),
            ("s8", vec![127, 129, 0, 127], [3.0, 0.0, -3.0, 3.0]),
            ("s8_delta", vec![127, 2, 0, 127], [3.0, 0.0, -3.0, 3.0]),
            ("ln_0r8", vec![0, 1, 255, 128], [0.0, 3f32.exp(), (-1f32).exp(), 1f32.exp()]),
        ];
        for (encoding, bytes, expected) in cases {
            let values = property(encoding, bytes.len()).decode("f", &bytes, 2, 2).unwrap();
            for (value, expected) in values.iter().zip(expected) {
                assert!((value - expected).abs() < 1e-3 * expected.abs().max(1.0), "{encoding}: {values:?}");
            }
        }
        let bytes: Vec<u8> = [1.0f32, 2.0, 3.0, 4.0].iter().flat_map(|v| v.to_le_bytes()).collect();
        let planes: Vec<u8> =
            (0..4).flat_map(|b| bytes.iter().skip(b).step_by(4).copied().collect::<Vec<_>>()).collect();
        assert_eq!(property("f32_lebytes", 16).decode("f", &planes, 2, 2).unwrap(), [1.0, 3.0, 2.0, 4.0]);
        assert!(property("f32", 16).decode("f", &bytes[..8], 2, 2).is_err());
        assert!(property("f32", 8).decode("f", &bytes, 2, 2).is_err());
    }

    #[test]
    fn rotations_are_unit_quaternions_about_unfolded_axes() {
        // The centre of the square is z, its corners −z.
        let [x, y, z, w] = rotation([128, 128], 255);
        assert!(x.abs() < 0.01 && y.abs() < 0.01 && z > 0.99 && w.abs() < 1e-6);
        let [.., z, _] = rotation([255, 255], 255);
        assert!(z < -0.99);
        for code in 0..=255 {
            let q = rotation([code, code.wrapping_mul(7)], code.wrapping_mul(31));
            assert!((q.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-5, "{q:?}");
        }
    }
}
