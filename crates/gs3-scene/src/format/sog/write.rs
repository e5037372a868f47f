//! Writing a SOG bundle, version 2.

use std::io::{self, Cursor, Write};

use glam::DVec3;
use image_webp::{ColorType, WebPEncoder};
use rayon::prelude::*;
use serde_json::json;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use super::super::activation::log_scale;
use super::super::morton;
use super::super::quaternion::without_largest;
use super::chunk::PALETTE_COLUMNS;
use super::codebook::Codebook;
use super::palette::{Palette, Vectors};
use crate::gaussians::Gaussians;
use crate::scene::{OpacityMode, Scene};

/// Most Gaussians of a data set: the pixels of the largest square WebP image with sides that are multiples of
/// 4. WebP allows 16,384 pixels on a side; image-webp 0.2 reads 16,383.
pub(in super::super) const MOST_GAUSSIANS: usize = 16_380 * 16_380;

/// Writes `scene`, its Gaussians in Morton order, which makes neighbouring pixels alike. Precision: 16 bits
/// for the logarithm of positions, 8 bits for the others, the higher harmonics by a palette of at most 65,536
/// rows.
pub(in super::super) fn write(scene: &Scene, writer: &mut impl Write) -> io::Result<()> {
    let gaussians = scene.gaussians();
    let means = Means::new(scene);
    let order = means.morton_order();
    let weights = weights(gaussians);
    let stride = gaussians.sh_stride();
    let weighted = |of: &(dyn Fn(usize) -> [f32; 3] + Sync)| {
        let three = |i: usize| of(i).map(|value| (value, weights[i]));
        (0..gaussians.len()).into_par_iter().flat_map_iter(three).collect()
    };
    let scales = Codebook::fit(weighted(&|i| gaussians.scale(i).map(log_scale)));
    let sh0 = Codebook::fit(weighted(&|i| [0, 1, 2].map(|c| gaussians.sh_of(i)[c])));
    let per_gaussian =
        |channels: ColorType, pixel: &(dyn Fn(usize, &mut [u8]) + Sync)| image(&order, channels, pixel);

    let rgb = ColorType::Rgb8;
    let mut images: Vec<(&str, Image)> = vec![
        ("means_l.webp", per_gaussian(rgb, &|i, p| set(p, means.codes(i).map(|code| code.to_le_bytes()[0])))),
        ("means_u.webp", per_gaussian(rgb, &|i, p| set(p, means.codes(i).map(|code| code.to_le_bytes()[1])))),
        (
            "scales.webp",
            per_gaussian(rgb, &|i, p| set(p, gaussians.scale(i).map(|s| scales.encode(log_scale(s))))),
        ),
        ("quats.webp", per_gaussian(ColorType::Rgba8, &|i, p| set(p, pack_rotation(gaussians.rotation(i))))),
        (
            "sh0.webp",
            per_gaussian(ColorType::Rgba8, &|i, p| {
                let sh = gaussians.sh_of(i);
                let opacity = (gaussians.opacities[i] * 255.0).round() as u8;
                set(p, [sh0.encode(sh[0]), sh0.encode(sh[1]), sh0.encode(sh[2]), opacity]);
            }),
        ),
    ];
    let mut meta = json!({
        "version": 2,
        "asset": { "generator": concat!("gs3 ", env!("CARGO_PKG_VERSION")) },
        "count": gaussians.len(),
        "antialias": scene.opacity_mode() == OpacityMode::Antialiased,
        "means": { "mins": means.mins, "maxs": means.maxs, "files": ["means_l.webp", "means_u.webp"] },
        "scales": { "codebook": scales.0.to_vec(), "files": ["scales.webp"] },
        "quats": { "files": ["quats.webp"] },
        "sh0": { "codebook": sh0.0.to_vec(), "files": ["sh0.webp"] },
    });
    if gaussians.sh_degree > 0 {
        let palette = Palette::fit(
            Vectors { values: &gaussians.sh, weights: &weights, stride, offset: 3 },
            gaussians.len(),
        );
        let codebook = Codebook::fit(palette.weighted_values(&weights, stride - 3));
        let rows = palette.rows.len() / (stride - 3);
        images.push(("shN_centroids.webp", palette_image(&palette.rows, stride - 3, &codebook)));
        let labels = per_gaussian(rgb, &|i, p| {
            let [low, high] = palette.labels[i].to_le_bytes();
            set(p, [low, high, 0]);
        });
        images.push(("shN_labels.webp", labels));
        meta["shN"] = json!({
            "count": rows,
            "bands": gaussians.sh_degree,
            "codebook": codebook.0.to_vec(),
            "files": ["shN_centroids.webp", "shN_labels.webp"],
        });
    }
    let encoded: io::Result<Vec<(&str, Vec<u8>)>> =
        images.into_par_iter().map(|(name, image)| Ok((name, image.encode()?))).collect();
    let bundle = bundle(&encoded?, &serde_json::to_vec(&meta)?)?;
    writer.write_all(&bundle)
}

/// How much an error of each Gaussian's colours and scales counts: the square of what it shows, its opacity times its
/// size on an image from afar. A thousandth of the mean at least, so that none is lost.
fn weights(gaussians: &Gaussians) -> Vec<f32> {
    let shown = |i: usize| {
        let [a, b, c] = gaussians.scale(i);
        // The largest of the three faces of the box around the ellipsoid.
        let area = (a * b).max(b * c).max(c * a).min(f32::MAX.sqrt());
        gaussians.opacities[i].powi(2) * area
    };
    let mut weights: Vec<f32> = (0..gaussians.len()).into_par_iter().map(shown).collect();
    let mean = weights.iter().map(|w| f64::from(*w)).sum::<f64>() / weights.len().max(1) as f64;
    let least = (1e-3 * mean).max(f64::from(f32::MIN_POSITIVE)) as f32;
    weights.par_iter_mut().for_each(|weight| *weight = weight.max(least));
    weights
}

/// The archive: images stored, for they are compressed already.
fn bundle(images: &[(&str, Vec<u8>)], meta: &[u8]) -> io::Result<Vec<u8>> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in images {
        zip.start_file(*name, SimpleFileOptions::default().compression_method(CompressionMethod::Stored))?;
        zip.write_all(bytes)?;
    }
    zip.start_file("meta.json", SimpleFileOptions::default())?;
    zip.write_all(meta)?;
    Ok(zip.finish()?.into_inner())
}

/// An image before its compression.
struct Image {
    width: usize,
    height: usize,
    color: ColorType,
    bytes: Vec<u8>,
}

impl Image {
    fn encode(&self) -> io::Result<Vec<u8>> {
        let mut webp = Vec::new();
        WebPEncoder::new(&mut webp)
            .encode(&self.bytes, self.width as u32, self.height as u32, self.color)
            .map_err(io::Error::other)?;
        Ok(webp)
    }
}

/// An image with a pixel per Gaussian in the given order; about square, sides multiples of 4.
fn image(order: &[u32], color: ColorType, pixel: &(dyn Fn(usize, &mut [u8]) + Sync)) -> Image {
    let channels = if matches!(color, ColorType::Rgba8) { 4 } else { 3 };
    let width = ((order.len() as f64).sqrt() / 4.0).ceil() as usize * 4;
    let height = order.len().div_ceil(width).next_multiple_of(4);
    // Pixels beyond the last Gaussian stay zero; opaque alpha is not needed where nothing is read.
    let mut bytes = vec![0; width * height * channels];
    bytes
        .par_chunks_exact_mut(channels)
        .with_min_len(4096)
        .zip(order.par_iter().with_min_len(4096))
        .for_each(|(bytes, i)| pixel(*i as usize, bytes));
    Image { width, height, color, bytes }
}

/// The palette: 64 rows of coefficients side by side.
fn palette_image(rows: &[f32], dimensions: usize, codebook: &Codebook) -> Image {
    let coefficients = dimensions / 3;
    let width = PALETTE_COLUMNS * coefficients;
    let height = (rows.len() / dimensions).div_ceil(PALETTE_COLUMNS);
    let mut bytes = vec![0; width * height * 3];
    bytes
        .par_iter_mut()
        .with_min_len(4096)
        .zip(rows.par_iter().with_min_len(4096))
        .for_each(|(byte, value)| *byte = codebook.encode(*value));
    Image { width, height, color: ColorType::Rgb8, bytes }
}

fn set<const CHANNELS: usize>(pixel: &mut [u8], values: [u8; CHANNELS]) {
    pixel.copy_from_slice(&values);
}

/// Means as 16-bit codes between the bounds of sign(x)·ln(|x| + 1).
struct Means<'a> {
    gaussians: &'a Gaussians,
    origin: DVec3,
    mins: [f64; 3],
    maxs: [f64; 3],
}

impl<'a> Means<'a> {
    fn new(scene: &'a Scene) -> Self {
        let gaussians = scene.gaussians();
        let bound = |pick: fn(f32, f32) -> f32| {
            let of = |plane: &Vec<f32>| plane.iter().copied().reduce(pick).unwrap_or_default();
            let (means, origin) = (gaussians.means.each_ref(), scene.details().origin);
            std::array::from_fn(|axis| log_position(f64::from(of(means[axis])) + origin[axis]))
        };
        Self { gaussians, origin: scene.details().origin, mins: bound(f32::min), maxs: bound(f32::max) }
    }

    fn codes(&self, i: usize) -> [u16; 3] {
        let mean = self.gaussians.mean(i);
        std::array::from_fn(|axis| {
            let extent = self.maxs[axis] - self.mins[axis];
            let share = (log_position(f64::from(mean[axis]) + self.origin[axis]) - self.mins[axis])
                / extent.max(f64::MIN_POSITIVE);
            (share * 65_535.0).round() as u16
        })
    }

    /// Indices of the Gaussians along a space-filling curve.
    fn morton_order(&self) -> Vec<u32> {
        morton::order(self.gaussians.len(), |i| self.codes(i))
    }
}

fn log_position(value: f64) -> f64 {
    value.abs().ln_1p() * value.signum()
}

/// Three components within ±√½ as bytes, and 252 + the index (w, x, y, z) of the fourth.
fn pack_rotation(rotation: [f32; 4]) -> [u8; 4] {
    let (largest, others) = without_largest(rotation);
    let [a, b, c] = others.map(|v| ((v * std::f32::consts::SQRT_2 * 0.5 + 0.5) * 255.0).round() as u8);
    [a, b, c, 252 + largest as u8]
}
