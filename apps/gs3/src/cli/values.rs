//! Values of options that are more than a word or a number.

use std::ops::Range;
use std::str::FromStr;

use clap::builder::RangedI64ValueParser;
use gs3::Dilation;
use gs3::reconstruct::MAX_SCALE;
use gs3::scene::Size;
use gs3::scene::camera::{MAX_CAMERA_SIDE, MAX_SIDE};

/// Reads a scale of at least `least`.
pub fn scale(least: i64) -> RangedI64ValueParser<u32> {
    clap::value_parser!(u32).range(least..=i64::from(MAX_SCALE))
}

/// Reads the size of what is rendered at once, `WxH`.
pub fn size(text: &str) -> Result<Size, String> {
    size_up_to(MAX_SIDE, text)
}

/// Reads the size of cameras, which may be larger than what is rendered at once.
pub fn camera_size(text: &str) -> Result<Size, String> {
    size_up_to(MAX_CAMERA_SIDE, text)
}

fn size_up_to(most: u32, text: &str) -> Result<Size, String> {
    let valid = |side: &str| side.parse().ok().filter(|v| (1..=most).contains(v));
    text.split_once('x')
        .and_then(|(w, h)| Some(Size { width: valid(w)?, height: valid(h)? }))
        .ok_or_else(|| format!("expected WIDTHxHEIGHT from 1x1 to {most}x{most}, found {text}"))
}

/// An amount of memory: bytes, or with K, M or G the 1024-fold, its square or its cube.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bytes(pub u64);

impl FromStr for Bytes {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let units = [("K", 10), ("M", 20), ("G", 30)];
        let unit = units.into_iter().find_map(|(unit, bits)| Some((text.strip_suffix(unit)?, bits)));
        let (number, bits) = unit.unwrap_or((text, 0));
        let bytes = number.parse().ok().and_then(|number: u64| number.checked_mul(1 << bits));
        bytes
            .filter(|bytes| *bytes > 0)
            .map(Self)
            .ok_or_else(|| format!("expected bytes, or a number with K, M or G, found {text}"))
    }
}

/// An angle of a field of view in degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Degrees(pub f64);

impl FromStr for Degrees {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let valid = text.parse().ok().filter(|v| *v > 0.0 && *v < 180.0);
        valid.map(Self).ok_or_else(|| format!("expected degrees between 0 and 180, found {text}"))
    }
}

/// A distance in world units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distance(pub f32);

impl FromStr for Distance {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let valid = text.parse().ok().filter(|v: &f32| v.is_finite() && *v >= f32::MIN_POSITIVE);
        valid.map(Self).ok_or_else(|| format!("expected a positive number, found {text}"))
    }
}

/// Frames `A..B`, B excluded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameRange(pub Range<usize>);

impl FromStr for FrameRange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let bounds = text.split_once("..").and_then(|(a, b)| Some(a.parse().ok()?..b.parse().ok()?));
        bounds
            .filter(|range: &Range<usize>| !range.is_empty())
            .map(Self)
            .ok_or_else(|| format!("expected A..B with A < B, found {text}"))
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DilationArg(pub Dilation);

impl FromStr for DilationArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let value = || text.parse().ok().filter(|v: &f32| v.is_finite() && *v >= 0.0).map(Dilation::Value);
        match text {
            "matched" => Some(Dilation::Matched),
            // The name that users of other programs know.
            "kerbl" | "stock" => Some(Dilation::Kerbl),
            _ => value(),
        }
        .map(Self)
        .ok_or_else(|| format!("expected matched, kerbl or a number of at least 0, found {text}"))
    }
}

/// A colour, each channel in `[0, 1]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rgb(pub [f32; 3]);

impl FromStr for Rgb {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        numbers(text)
            .filter(|rgb| rgb.iter().all(|v| (0.0..=1.0).contains(v)))
            .map(Self)
            .ok_or_else(|| format!("expected R,G,B from 0 to 1, found {text}"))
    }
}

/// Two numbers within ±1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair(pub [f32; 2]);

impl FromStr for Pair {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        numbers(text)
            .filter(|pair| pair.iter().all(|v| v.abs() <= 1.0))
            .map(Self)
            .ok_or_else(|| format!("expected X,Y from -1 to 1, found {text}"))
    }
}

fn numbers<const N: usize>(text: &str) -> Option<[f32; N]> {
    let numbers: Vec<f32> = text.split(',').map(|v| v.trim().parse().ok()).collect::<Option<_>>()?;
    numbers.try_into().ok()
}
