//! Writing SOG data sets, version 2, and bundles of them.

use std::io::{self, Seek, Write};

use glam::DVec3;
use image_webp::{ColorType, WebPEncoder};
use rayon::prelude::*;
use serde_json::json;
use webp_rust::LosslessEncodingConfig;
use webp_rust::encoder::encode_lossless_rgba_to_webp_with_config;
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

/// From so many Gaussians on memory counts more than time and size: images are compressed one after the other, by the encoder that
/// takes less memory, and codebooks are fitted to a histogram. Below, images of as many Gaussians are compressed at once, which
/// takes 0.3 GB.
const MANY: usize = 1 << 22;

/// How hard webp-rust compresses images, from 0 to 9. (`flowers` in eight parts, 56 images: level 2 takes 11 s of a core and makes
/// 16.3 MB, level 9 417 s and 16.0 MB, as much as libwebp by default.)
const LEVEL: u8 = 2;

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

    let per_gaussian =
        |pixel: &(dyn Fn(usize) -> [u8; 4] + Sync)| image(order.len(), &|place| pixel(order[place] as usize));
    type Maker<'a> = (&'static str, Box<dyn Fn() -> Image + Sync + 'a>);
    let mut images: Vec<Maker<'_>> = vec![
        (
            "means_l.webp",
            Box::new(|| per_gaussian(&|i| opaque(means.codes(i).map(|code| code.to_le_bytes()[0])))),
        ),
        (
            "means_u.webp",
            Box::new(|| per_gaussian(&|i| opaque(means.codes(i).map(|code| code.to_le_bytes()[1])))),
        ),
        (
            "scales.webp",
            Box::new(|| per_gaussian(&|i| opaque(gaussians.scale(i).map(|s| scales.encode(log_scale(s)))))),
        ),
        ("quats.webp", Box::new(|| per_gaussian(&|i| pack_rotation(gaussians.rotation(i))))),
        (
            "sh0.webp",
            Box::new(|| {
                per_gaussian(&|i| {
                    let sh = gaussians.sh_of(i);
                    let opacity = (gaussians.opacities[i] * 255.0).round() as u8;
                    [sh0.encode(sh[0]), sh0.encode(sh[1]), sh0.encode(sh[2]), opacity]
                })
            }),
        ),
    ];
    if let Some((palette, codebook)) = &rest {
        images.push(("shN_centroids.webp", Box::new(|| palette_image(&palette.rows, stride - 3, codebook))));
        images.push((
            "shN_labels.webp",
            Box::new(|| {
                image(order.len(), &|place| {
                    let [low, high] = palette.labels[place].to_le_bytes();
                    opaque([low, high, 0])
                })
            }),
        ));
    }
    let is_many = order.len() > MANY;
    let at_once = (MANY / order.len().max(1)).clamp(1, images.len());
    for images in images.chunks(at_once) {
        let encoded: io::Result<Vec<_>> =
            images.par_iter().map(|(name, make)| Ok((*name, make().encode(is_many)?))).collect();
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

/// An image before its compression: RGBA.
struct Image {
    width: usize,
    height: usize,
    rgba: Vec<u8>,
}

impl Image {
    /// As small as possible, or in little memory: image-webp takes 3 bytes a pixel, webp-rust 40 to 70.
    fn encode(&self, in_little_memory: bool) -> io::Result<Vec<u8>> {
        if !in_little_memory {
            let config = LosslessEncodingConfig { z_level: LEVEL };
            return encode_lossless_rgba_to_webp_with_config(self.width, self.height, &self.rgba, &config)
                .map_err(|error| io::Error::other(error.to_string()));
        }
        let mut webp = Vec::new();
        WebPEncoder::new(&mut webp)
            .encode(&self.rgba, self.width as u32, self.height as u32, ColorType::Rgba8)
            .map_err(io::Error::other)?;
        Ok(webp)
    }
}

/// An image of `count` pixels, one for each Gaussian; about square, sides multiples of 4. The last Gaussian
/// fills what is left.
fn image(count: usize, pixel: &(dyn Fn(usize) -> [u8; 4] + Sync)) -> Image {
    let width = ((count as f64).sqrt() / 4.0).ceil() as usize * 4;
    let height = count.div_ceil(width).next_multiple_of(4);
    let mut rgba = vec![0; width * height * 4];
    let pixels = rgba.as_chunks_mut().0;
    let last = count.saturating_sub(1);
    pixels.par_iter_mut().with_min_len(4096).enumerate().for_each(|(k, to)| *to = pixel(k.min(last)));
    Image { width, height, rgba }
}

/// The palette: 64 rows of coefficients side by side.
fn palette_image(rows: &[f32], dimensions: usize, codebook: &Codebook) -> Image {
    let width = PALETTE_COLUMNS * dimensions / 3;
    let height = (rows.len() / dimensions).div_ceil(PALETTE_COLUMNS);
    let mut rgba = vec![0; width * height * 4];
    let pixels = rgba.as_chunks_mut().0;
    let values = rows.as_chunks().0;
    let pairs = pixels.par_iter_mut().with_min_len(4096).zip(values);
    pairs.for_each(|(to, rgb)| *to = opaque(rgb.map(|value| codebook.encode(value))));
    Image { width, height, rgba }
}

const fn opaque([r, g, b]: [u8; 3]) -> [u8; 4] {
    [r, g, b, 255]
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

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use image_webp::WebPDecoder;

    use super::*;

    #[test]
    fn images_are_the_same_in_little_memory() {
        // Transparent pixels keep their colours.
        let image = image(1000, &|k| [(k * 7) as u8, (k / 3) as u8, 200, (k % 4 * 85) as u8]);
        for in_little_memory in [false, true] {
            let webp = image.encode(in_little_memory).unwrap();
            let mut decoder = WebPDecoder::new(Cursor::new(&webp)).unwrap();
            assert_eq!(decoder.dimensions(), (image.width as u32, image.height as u32));
            let mut bytes = vec![0; decoder.output_buffer_size().unwrap()];
            decoder.read_image(&mut bytes).unwrap();
            assert!(bytes == image.rgba, "{in_little_memory}");
        }
    }
}
