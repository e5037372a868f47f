//! Writing SOG data sets, version 2, and bundles of them.

use std::io::{self, Seek, Write};

use glam::DVec3;
use image_webp::{ColorType, WebPEncoder};
use rayon::prelude::*;
use serde_json::json;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use super::super::activation::log_scale;
use super::super::quaternion::without_largest;
use super::super::{BLOCK, morton};
use super::chunk::PALETTE_COLUMNS;
use super::codebook::Codebook;
use super::palette::{Palette, Vectors};
use crate::gaussians::Gaussians;
use crate::scene::{OpacityMode, Scene};

/// What the files say that they were written by.
pub(super) const GENERATOR: &str = concat!("gs3 ", env!("CARGO_PKG_VERSION"));

/// Most Gaussians of a data set: the pixels of the largest square WebP image with sides that are multiples of
/// 4. WebP allows 16,384 pixels on a side; image-webp 0.2 reads 16,383.
pub(in super::super) const MOST_GAUSSIANS: usize = 16_380 * 16_380;

/// From so many Gaussians on memory counts more than time: images are made and compressed one after the other, and codebooks are
/// fitted to a histogram. All at once takes about 100 bytes a Gaussian, twice a scene without harmonics.
const MANY: usize = 1 << 22;

/// Writes `scene` as a bundle, its Gaussians in Morton order, which makes neighbouring pixels alike. Precision: 16 bits
/// for the logarithm of positions, 8 bits for the others, the higher harmonics by a palette of at most 65,536
/// rows.
pub(in super::super) fn write(scene: &Scene, writer: impl Write + Seek) -> io::Result<()> {
    let count = scene.gaussians().len();
    let means = Means::new(scene, &(0..count as u32).collect::<Vec<_>>());
    let order = morton::order(count, |i| means.codes(i));
    let mut zip = ZipWriter::new(writer);
    let meta = encode(scene, &Weights::new(scene.gaussians()), &order, &mut |name, image| {
        // Stored: images are compressed already.
        zip.start_file(name, SimpleFileOptions::default().compression_method(CompressionMethod::Stored))?;
        zip.write_all(&image)
    })?;
    zip.start_file("meta.json", SimpleFileOptions::default())?;
    zip.write_all(&meta)?;
    zip.finish()?;
    Ok(())
}

/// Makes a data set of the Gaussians with the indices `order`, in this order: gives each image, compressed, to `sink`, and
/// returns what describes them, `meta.json`.
pub(super) fn encode(
    scene: &Scene,
    weights: &Weights<'_>,
    order: &[u32],
    sink: &mut dyn FnMut(&str, Vec<u8>) -> io::Result<()>,
) -> io::Result<Vec<u8>> {
    let gaussians = scene.gaussians();
    let means = Means::new(scene, order);
    let stride = gaussians.sh_stride();
    let fit = |of: &(dyn Fn(usize) -> [f32; 3] + Sync)| {
        let three = |i: &u32| of(*i as usize).map(|value| (value, weights.of(*i as usize)));
        if order.len() > MANY {
            Codebook::fit_many(order.iter().flat_map(three))
        } else {
            Codebook::fit(order.par_iter().flat_map_iter(three).collect())
        }
    };
    let scales = fit(&|i| gaussians.scale(i).map(log_scale));
    let sh0 = fit(&|i| [0, 1, 2].map(|c| gaussians.sh_of(i)[c]));
    let mut meta = json!({
        "version": 2,
        "asset": { "generator": GENERATOR },
        "count": order.len(),
        "antialias": scene.opacity_mode() == OpacityMode::Antialiased,
        "means": { "mins": means.mins, "maxs": means.maxs, "files": ["means_l.webp", "means_u.webp"] },
        "scales": { "codebook": scales.0.to_vec(), "files": ["scales.webp"] },
        "quats": { "files": ["quats.webp"] },
        "sh0": { "codebook": sh0.0.to_vec(), "files": ["sh0.webp"] },
    });
    let rest = (gaussians.sh_degree > 0).then(|| {
        let weights: Vec<f32> = order.par_iter().map(|i| weights.of(*i as usize)).collect();
        let palette = Palette::fit(Vectors {
            values: &gaussians.sh,
            indices: order,
            weights: &weights,
            stride,
            offset: 3,
        });
        let codebook = Codebook::fit(palette.weighted_values(&weights, stride - 3));
        meta["shN"] = json!({
            "count": palette.rows.len() / (stride - 3),
            "bands": gaussians.sh_degree,
            "codebook": codebook.0.to_vec(),
            "files": ["shN_centroids.webp", "shN_labels.webp"],
        });
        (palette, codebook)
    });

    let per_gaussian = |channels: ColorType, pixel: &(dyn Fn(usize, &mut [u8]) + Sync)| {
        image(order.len(), channels, &|place, bytes| pixel(order[place] as usize, bytes))
    };
    let rgb = ColorType::Rgb8;
    type Maker<'a> = (&'static str, Box<dyn Fn() -> Image + Sync + 'a>);
    let mut images: Vec<Maker<'_>> = vec![
        (
            "means_l.webp",
            Box::new(|| per_gaussian(rgb, &|i, p| set(p, means.codes(i).map(|code| code.to_le_bytes()[0])))),
        ),
        (
            "means_u.webp",
            Box::new(|| per_gaussian(rgb, &|i, p| set(p, means.codes(i).map(|code| code.to_le_bytes()[1])))),
        ),
        (
            "scales.webp",
            Box::new(|| {
                per_gaussian(rgb, &|i, p| set(p, gaussians.scale(i).map(|s| scales.encode(log_scale(s)))))
            }),
        ),
        (
            "quats.webp",
            Box::new(|| per_gaussian(ColorType::Rgba8, &|i, p| set(p, pack_rotation(gaussians.rotation(i))))),
        ),
        (
            "sh0.webp",
            Box::new(|| {
                per_gaussian(ColorType::Rgba8, &|i, p| {
                    let sh = gaussians.sh_of(i);
                    let opacity = (gaussians.opacities[i] * 255.0).round() as u8;
                    set(p, [sh0.encode(sh[0]), sh0.encode(sh[1]), sh0.encode(sh[2]), opacity]);
                })
            }),
        ),
    ];
    if let Some((palette, codebook)) = &rest {
        images.push(("shN_centroids.webp", Box::new(|| palette_image(&palette.rows, stride - 3, codebook))));
        images.push((
            "shN_labels.webp",
            Box::new(|| {
                image(order.len(), rgb, &|place, p| {
                    let [low, high] = palette.labels[place].to_le_bytes();
                    set(p, [low, high, 0]);
                })
            }),
        ));
    }
    let at_once = if order.len() > MANY { 1 } else { images.len() };
    for images in images.chunks(at_once) {
        let encoded: io::Result<Vec<_>> =
            images.par_iter().map(|(name, make)| Ok((*name, make().encode()?))).collect();
        encoded?.into_iter().try_for_each(|(name, bytes)| sink(name, bytes))?;
    }
    Ok(serde_json::to_vec(&meta)?)
}

/// How much an error of each Gaussian's colours and scales counts: the square of what it shows, its opacity times its
/// size on an image from afar. A thousandth of the mean at least, so that none is lost.
pub(super) struct Weights<'a> {
    gaussians: &'a Gaussians,
    least: f32,
}

impl<'a> Weights<'a> {
    pub(super) fn new(gaussians: &'a Gaussians) -> Self {
        let all = Self { gaussians, least: 0.0 };
        // In blocks, so that the sum has the same bits with any number of threads.
        let sums: Vec<f64> = (0..gaussians.len().div_ceil(BLOCK))
            .into_par_iter()
            .map(|block| {
                let members = block * BLOCK..((block + 1) * BLOCK).min(gaussians.len());
                members.map(|i| f64::from(all.of(i))).sum()
            })
            .collect();
        let mean = sums.iter().sum::<f64>() / gaussians.len().max(1) as f64;
        Self { least: (1e-3 * mean).max(f64::from(f32::MIN_POSITIVE)) as f32, ..all }
    }

    fn of(&self, i: usize) -> f32 {
        let [a, b, c] = self.gaussians.scale(i);
        // The largest of the three faces of the box around the ellipsoid.
        let area = (a * b).max(b * c).max(c * a).min(f32::MAX.sqrt());
        (self.gaussians.opacities[i].powi(2) * area).max(self.least)
    }
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

/// An image of `count` pixels, one for each Gaussian; about square, sides multiples of 4.
fn image(count: usize, color: ColorType, pixel: &(dyn Fn(usize, &mut [u8]) + Sync)) -> Image {
    let channels = if matches!(color, ColorType::Rgba8) { 4 } else { 3 };
    let width = ((count as f64).sqrt() / 4.0).ceil() as usize * 4;
    let height = count.div_ceil(width).next_multiple_of(4);
    // Pixels beyond the last Gaussian stay zero; opaque alpha is not needed where nothing is read.
    let mut bytes = vec![0; width * height * channels];
    bytes
        .par_chunks_exact_mut(channels)
        .with_min_len(4096)
        .take(count)
        .enumerate()
        .for_each(|(place, bytes)| pixel(place, bytes));
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

/// Means as 16-bit codes between the bounds of sign(x)·ln(|x| + 1) of some Gaussians.
pub(super) struct Means<'a> {
    gaussians: &'a Gaussians,
    origin: DVec3,
    mins: [f64; 3],
    maxs: [f64; 3],
}

impl<'a> Means<'a> {
    /// With the bounds of the Gaussians with the indices `chosen`.
    pub(super) fn new(scene: &'a Scene, chosen: &[u32]) -> Self {
        let gaussians = scene.gaussians();
        let origin = scene.details().origin;
        let bound = |pick: fn(f32, f32) -> f32| {
            let of = |plane: &[f32]| {
                let values = chosen.par_iter().map(|i| plane[*i as usize]);
                values.reduce_with(pick).unwrap_or_default()
            };
            std::array::from_fn(|axis| log_position(f64::from(of(&gaussians.means[axis])) + origin[axis]))
        };
        Self { gaussians, origin, mins: bound(f32::min), maxs: bound(f32::max) }
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

    /// The indices `chosen` along a space-filling curve.
    #[cfg(feature = "fs")]
    pub(super) fn morton_order(&self, chosen: &[u32]) -> Vec<u32> {
        let mut order = morton::order(chosen.len(), |place| self.codes(chosen[place] as usize));
        order.iter_mut().for_each(|place| *place = chosen[*place as usize]);
        order
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
