//! ꟻLIP for low-dynamic-range images (Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström, Fairchild 2020): the
//! difference that a viewer sees when flipping between two images.

use gs3_scene::{Image, Planes};
use rayon::prelude::*;

use super::planes::{filter_columns, filter_rows};
use super::{BAND_ROWS, MetricError, displayed, same_size};

/// Pixels per degree of visual angle of the published default: a 0.7 m wide 3840-pixel display seen from 0.7 m.
pub const DEFAULT_PIXELS_PER_DEGREE: f32 = 67.02064;

/// Contrast sensitivity as a sum of two Gaussians per opponent channel (achromatic, red–green, blue–yellow):
/// `a₁ √(π/b₁) exp(−π²x²/b₁) + a₂ √(π/b₂) exp(−π²x²/b₂)`, x in degrees; table 1 of the paper.
const SENSITIVITY: [[(f64, f64); 2]; 3] =
    [[(1.0, 0.0047), (0.0, 1e-5)], [(1.0, 0.0053), (0.0, 1e-5)], [(34.1, 0.04), (13.5, 0.025)]];
/// Exponent that compresses the colour difference.
const COLOR_EXPONENT: f32 = 0.7;
/// Colour differences up to this share of the largest one map to `[0, COLOR_KNEE_VALUE]`, the rest to what is left.
const COLOR_KNEE: f32 = 0.4;
const COLOR_KNEE_VALUE: f32 = 0.95;
/// Exponent of the feature difference.
const FEATURE_EXPONENT: f32 = 0.5;
/// Width of the feature detectors in degrees.
const FEATURE_WIDTH: f64 = 0.082;

/// Mean ꟻLIP error in `[0, 1]`, 0 for equal images.
///
/// # Errors
/// [`MetricError`] if the sizes differ or the images are empty.
pub fn flip(reference: &Image, test: &Image, pixels_per_degree: f32) -> Result<f64, MetricError> {
    let map = flip_map(reference, test, pixels_per_degree)?;
    let bands: Vec<f64> = map
        .data()
        .par_chunks(BAND_ROWS * map.width())
        .map(|b| b.iter().map(|v| f64::from(*v)).sum())
        .collect();
    Ok(bands.iter().sum::<f64>() / map.data().len() as f64)
}

/// ꟻLIP error per pixel in `[0, 1]`.
///
/// # Errors
/// [`MetricError`] if the sizes differ or the images are empty.
pub fn flip_map(reference: &Image, test: &Image, pixels_per_degree: f32) -> Result<Planes<1>, MetricError> {
    same_size(reference, "test image", test)?;
    let (width, height) = (reference.width(), reference.height());
    if width == 0 || height == 0 {
        return Err(MetricError::TooSmall { metric: "FLIP", min: 1, actual: reference.size() });
    }
    let ppd = f64::from(pixels_per_degree);
    let (reference, test) = (Perceived::new(reference, ppd), Perceived::new(test, ppd));
    let largest = largest_color_difference();
    let mut map = Planes::new(width, height);
    map.data_mut().par_chunks_mut(width).enumerate().for_each(|(y, out)| {
        for (x, out) in out.iter_mut().enumerate() {
            let i = y * width + x;
            let color =
                compress(color_difference(reference.lab(i), test.lab(i)).powf(COLOR_EXPONENT), largest);
            let edge = (reference.edge(i) - test.edge(i)).abs();
            let point = (reference.point(i) - test.point(i)).abs();
            let feature = (edge.max(point) / std::f32::consts::SQRT_2).powf(FEATURE_EXPONENT);
            *out = color.powf(1.0 - feature);
        }
    });
    Ok(map)
}

/// What of an image reaches the comparison.
struct Perceived {
    /// Contrast-filtered colour in Hunt-adjusted L\*a\*b\*.
    lab: [Planes<1>; 3],
    /// First derivatives of the luminance (edges) along x and y.
    edges: [Planes<1>; 2],
    /// Second derivatives of the luminance (points, lines) along x and y.
    points: [Planes<1>; 2],
}

impl Perceived {
    fn new(image: &Image, ppd: f64) -> Self {
        let opponent = opponent_planes(image);
        let (edges, points) = features(&opponent[0], ppd);
        let reach = SENSITIVITY.iter().flatten().map(|(_, b)| *b).fold(0.0, f64::max);
        let radius = (3.0 * (reach / (2.0 * PI_SQUARED)).sqrt() * ppd).ceil() as i32;
        let [y, cx, cz] =
            std::array::from_fn(|c| contrast_filtered(&opponent[c], SENSITIVITY[c], radius, ppd));
        let mut lab = [y, cx, cz];
        let [l, a, b] = &mut lab;
        (l.data_mut().par_iter_mut(), a.data_mut().par_iter_mut(), b.data_mut().par_iter_mut())
            .into_par_iter()
            .for_each(|(l, a, b)| {
                [*l, *a, *b] = hunt_lab(linear_from_opponent([*l, *a, *b]).map(|v| v.clamp(0.0, 1.0)))
            });
        Self { lab, edges, points }
    }

    fn lab(&self, i: usize) -> [f32; 3] {
        [self.lab[0].data()[i], self.lab[1].data()[i], self.lab[2].data()[i]]
    }

    fn edge(&self, i: usize) -> f32 {
        self.edges[0].data()[i].hypot(self.edges[1].data()[i])
    }

    fn point(&self, i: usize) -> f32 {
        self.points[0].data()[i].hypot(self.points[1].data()[i])
    }
}

const PI_SQUARED: f64 = std::f64::consts::PI * std::f64::consts::PI;

/// The image in the linear opponent space Y C<sub>x</sub> C<sub>z</sub>.
fn opponent_planes(image: &Image) -> [Planes<1>; 3] {
    let mut planes: [Planes<1>; 3] = std::array::from_fn(|_| Planes::new(image.width(), image.height()));
    let [y, cx, cz] = &mut planes;
    let targets = (y.data_mut().par_iter_mut(), cx.data_mut().par_iter_mut(), cz.data_mut().par_iter_mut());
    targets.into_par_iter().zip(image.pixels()).for_each(|((y, cx, cz), pixel)| {
        let linear = [pixel[0], pixel[1], pixel[2]].map(|v| linear_from_srgb(displayed(v)));
        let [x, luminance, z] = white_relative_xyz(linear);
        (*y, *cx, *cz) = (116.0 * luminance - 16.0, 500.0 * (x - luminance), 200.0 * (luminance - z));
    });
    planes
}

/// Filters an opponent channel with its contrast sensitivity. Each 2D Gaussian is separable; their sum is normalised.
fn contrast_filtered(plane: &Planes<1>, sensitivity: [(f64, f64); 2], radius: i32, ppd: f64) -> Planes<1> {
    let kernels = sensitivity.map(|(a, b)| {
        let amplitude = a * (std::f64::consts::PI / b).sqrt();
        let line: Vec<f64> =
            (-radius..=radius).map(|i| (-PI_SQUARED * (f64::from(i) / ppd).powi(2) / b).exp()).collect();
        (amplitude, line)
    });
    let total: f64 = kernels.iter().map(|(a, line)| a * line.iter().sum::<f64>().powi(2)).sum();
    let parts = kernels.iter().filter(|(amplitude, _)| *amplitude > 0.0).map(|(amplitude, line)| {
        let scale = (amplitude / total).sqrt();
        let kernel: Vec<f32> = line.iter().map(|v| (v * scale) as f32).collect();
        filter_columns(&filter_rows(plane, &kernel), &kernel)
    });
    parts
        .reduce(|mut sum, part| {
            sum.data_mut().iter_mut().zip(part.data()).for_each(|(s, p)| *s += p);
            sum
        })
        .unwrap_or_else(|| plane.clone())
}

/// Edge and point detectors: first and second derivatives of a Gaussian, their positive and their negative weights each
/// scaled to sum 1, on luminance in `[0, 1]`.
fn features(luminance: &Planes<1>, ppd: f64) -> ([Planes<1>; 2], [Planes<1>; 2]) {
    let sigma = 0.5 * FEATURE_WIDTH * ppd;
    let radius = (3.0 * sigma).ceil() as i32;
    let gaussian = |x: f64| (-x * x / (2.0 * sigma * sigma)).exp();
    let smooth = normalised(radius, gaussian);
    let edge = normalised(radius, |x| -x * gaussian(x));
    let point = normalised(radius, |x| (x * x / (sigma * sigma) - 1.0) * gaussian(x));
    let mut y = luminance.clone();
    y.data_mut().par_iter_mut().for_each(|v| *v = (*v + 16.0) / 116.0);
    let across = |kernel: &[f32]| filter_columns(&filter_rows(&y, kernel), &smooth);
    let smoothed = filter_rows(&y, &smooth);
    let down = |kernel: &[f32]| filter_columns(&smoothed, kernel);
    ([across(&edge), down(&edge)], [across(&point), down(&point)])
}

/// A sampled kernel. Its positive weights sum to 1, and its negative weights, if any, sum to −1.
fn normalised(radius: i32, weight: impl Fn(f64) -> f64) -> Vec<f32> {
    let weights: Vec<f64> = (-radius..=radius).map(|i| weight(f64::from(i))).collect();
    let positive: f64 = weights.iter().filter(|w| **w > 0.0).sum();
    let negative: f64 = -weights.iter().filter(|w| **w < 0.0).sum::<f64>();
    weights
        .iter()
        .map(|w| {
            (if *w > 0.0 {
                w / positive
            } else if *w < 0.0 {
                w / negative
            } else {
                0.0
            }) as f32
        })
        .collect()
}

/// Maps a compressed colour difference to `[0, 1]`, most of the range going to the smaller differences.
fn compress(difference: f32, largest: f32) -> f32 {
    let knee = COLOR_KNEE * largest;
    if difference < knee {
        difference * (COLOR_KNEE_VALUE / knee)
    } else {
        COLOR_KNEE_VALUE + (difference - knee) / (largest - knee) * (1.0 - COLOR_KNEE_VALUE)
    }
}

/// The compressed difference between pure green and pure blue, the largest one of the sRGB gamut.
fn largest_color_difference() -> f32 {
    color_difference(hunt_lab([0.0, 1.0, 0.0]), hunt_lab([0.0, 0.0, 1.0])).powf(COLOR_EXPONENT)
}

/// HyAB distance: city block in lightness, Euclidean in chroma.
fn color_difference(a: [f32; 3], b: [f32; 3]) -> f32 {
    (a[0] - b[0]).abs() + (a[1] - b[1]).hypot(a[2] - b[2])
}

/// L\*a\*b\* of a linear colour in `[0, 1]`, chroma scaled with lightness (Hunt effect: dark colours look less
/// colourful).
fn hunt_lab(linear: [f32; 3]) -> [f32; 3] {
    const DELTA: f32 = 6.0 / 29.0;
    let [x, y, z] = white_relative_xyz(linear)
        .map(|v| if v > DELTA * DELTA * DELTA { v.cbrt() } else { v / (3.0 * DELTA * DELTA) + 4.0 / 29.0 });
    let lightness = 116.0 * y - 16.0;
    [lightness, 0.01 * lightness * 500.0 * (x - y), 0.01 * lightness * 200.0 * (y - z)]
}

fn linear_from_srgb(v: f32) -> f32 {
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

/// The white point: XYZ of linear (1, 1, 1), D65.
const WHITE: [f32; 3] = [0.950428545, 1.0, 1.088900371];

/// CIE XYZ of a linear sRGB colour, each relative to the white point.
fn white_relative_xyz([r, g, b]: [f32; 3]) -> [f32; 3] {
    // The matrix in the rational form that the method publishes, in f64 before rounding.
    const X: [f32; 3] = [
        (10135552.0 / 24577794.0f64) as f32,
        (8788810.0 / 24577794.0f64) as f32,
        (4435075.0 / 24577794.0f64) as f32,
    ];
    const Y: [f32; 3] = [
        (2613072.0 / 12288897.0f64) as f32,
        (8788810.0 / 12288897.0f64) as f32,
        (887015.0 / 12288897.0f64) as f32,
    ];
    const Z: [f32; 3] = [
        (1425312.0 / 73733382.0f64) as f32,
        (8788810.0 / 73733382.0f64) as f32,
        (70074185.0 / 73733382.0f64) as f32,
    ];
    let dot = |row: [f32; 3]| row[0] * r + row[1] * g + row[2] * b;
    [dot(X) / WHITE[0], dot(Y) / WHITE[1], dot(Z) / WHITE[2]]
}

/// The inverse of the opponent transform.
fn linear_from_opponent([y, cx, cz]: [f32; 3]) -> [f32; 3] {
    let luminance = (y + 16.0) / 116.0;
    let x = WHITE[0] * (luminance + cx / 500.0);
    let z = WHITE[2] * (luminance - cz / 200.0);
    [
        3.241003275 * x - 1.537398934 * luminance - 0.498615861 * z,
        -0.969224334 * x + 1.875930071 * luminance + 0.041554224 * z,
        0.055639423 * x - 0.204011202 * luminance + 1.057148933 * z,
    ]
}
