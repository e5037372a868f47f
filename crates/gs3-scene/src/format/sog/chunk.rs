//! One SOG data set: a whole scene, or a chunk of a streamed one.

use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;

use super::super::BLOCK;
use super::super::archive::Archive;
use super::super::error::LoadError;
use super::super::progress::Work;
use super::super::quaternion::with_largest;
use super::super::source::{Files, Source, inside};
use super::meta::{Meta, ShRest};
use super::plane::Plane;
use crate::gaussians::{Slots, sh_coefficient_count};
use crate::scene::OpacityMode;

/// Palette rows side by side in the image of the palette.
pub(super) const PALETTE_COLUMNS: usize = 64;

/// WebP images are at most 16,384 pixels on a side; more Gaussians cannot be.
const MAX_COUNT: u64 = 1 << 28;

/// The largest degree of spherical harmonics that the format has.
const MAX_BANDS: u8 = 3;

/// Ranges of Gaussians, in order and apart.
pub(super) type Ranges = Vec<Range<usize>>;

/// An opened data set: its description and where its images are.
pub(super) struct Chunk<'a> {
    name: String,
    meta: Meta,
    count: usize,
    images: Images<'a>,
    file_bytes: u64,
}

enum Images<'a> {
    Bundled(Archive<'a>),
    Beside { files: &'a dyn Files, folder: String },
}

impl<'a> Chunk<'a> {
    /// Opens a bundle, or a `meta.json` with its images in `folder` of `files`.
    pub(super) fn open(
        source: &'a Source<'a>,
        files: &'a dyn Files,
        folder: &str,
    ) -> Result<Self, LoadError> {
        let (meta, images) = if source.head(2)?.starts_with(b"PK") {
            let archive = Archive::open(source)?;
            let meta = Meta::parse(&archive.open("meta.json")?)?;
            (meta, Images::Bundled(archive))
        } else {
            (Meta::parse(source)?, Images::Beside { files, folder: folder.to_owned() })
        };
        let name = source.name().to_owned();
        if meta.count > MAX_COUNT {
            let expected = format!("at most {MAX_COUNT}");
            return Err(LoadError::invalid(&name, "count", expected, meta.count.to_string()));
        }
        if let Some(rest) = &meta.sh_rest
            && rest.bands > MAX_BANDS
        {
            let expected = format!("at most {MAX_BANDS}");
            return Err(LoadError::invalid(&name, "shN.bands", expected, rest.bands.to_string()));
        }
        let mut chunk = Self { name, count: meta.count as usize, meta, images, file_bytes: source.len() };
        if matches!(chunk.images, Images::Beside { .. }) {
            // All of them are asked for before one that is missing is told: who fetches files learns of all at once.
            let lengths: Vec<_> = chunk.image_names().map(|file| Ok(chunk.image(file)?.len())).collect();
            for length in lengths {
                chunk.file_bytes = chunk.file_bytes.saturating_add(length?);
            }
        }
        Ok(chunk)
    }

    pub(super) fn name(&self) -> &str {
        &self.name
    }

    /// Number of Gaussians.
    pub(super) const fn count(&self) -> usize {
        self.count
    }

    /// Bytes of all its files.
    pub(super) const fn file_bytes(&self) -> u64 {
        self.file_bytes
    }

    /// The mode that the Gaussians were trained in, and what of the description is not used.
    pub(super) fn mode(&self) -> (OpacityMode, Vec<String>) {
        self.meta.mode()
    }

    pub(super) fn sh_degree(&self) -> u8 {
        self.meta.sh_rest.as_ref().map_or(0, |rest| rest.bands)
    }

    /// Units of work of [`Self::decode`]: one pass over the Gaussians for each image, and one to unpack.
    pub(super) fn work(&self) -> u64 {
        (self.image_names().count() as u64 + 1) * self.count as u64
    }

    fn image_names(&self) -> impl Iterator<Item = &str> {
        let Meta { means, scales, quats, sh0, sh_rest, .. } = &self.meta;
        let rest = sh_rest.iter().filter(|rest| rest.bands > 0).flat_map(|rest| &rest.files);
        (means.files.iter())
            .chain(&scales.files)
            .chain(&quats.files)
            .chain(&sh0.files)
            .chain(rest)
            .map(|f| &**f)
    }

    fn image(&self, name: &str) -> Result<Source<'_>, LoadError> {
        match &self.images {
            Images::Bundled(archive) => archive.open(&inside(&self.name, "files", "", name)?),
            Images::Beside { files, folder } => files.open(&inside(&self.name, "files", folder, name)?),
        }
    }

    /// Least and largest coordinate along `axis`.
    pub(super) fn bounds(&self, axis: usize) -> [f64; 2] {
        [self.meta.means.mins[axis], self.meta.means.maxs[axis]].map(linear)
    }

    /// The range of all Gaussians.
    pub(super) fn all(&self) -> Ranges {
        std::iter::once(0..self.count).collect()
    }

    /// Fills `slots` with the Gaussians of `ranges`, one range after the other. The slots are as many.
    pub(super) fn decode(
        &self,
        ranges: Ranges,
        slots: Slots<'_>,
        origin: DVec3,
        work: &Work<'_>,
    ) -> Result<(), LoadError> {
        let names: Vec<&str> = self.image_names().collect();
        let planes = names
            .par_iter()
            .map(|name| {
                let source = self.image(name)?;
                let plane = Plane::decode(&source, self.file_bytes)?;
                work.add(self.count);
                Ok((source.name().to_owned(), plane))
            })
            .collect::<Result<Vec<_>, LoadError>>()?;
        // The palette is not an image of Gaussians: all others are checked against their number.
        const PALETTE: usize = 5;
        for (i, (name, plane)) in planes.iter().enumerate() {
            if i != PALETTE {
                plane.check_holds(name, self.count)?;
            }
        }
        let palette = match (&self.meta.sh_rest, planes.get(PALETTE)) {
            (Some(rest), Some((name, plane))) => Some(palette(rest, name, plane)?),
            _ => None,
        };
        let decoder = Decoder {
            meta: &self.meta,
            origin,
            scales: self.meta.scales.codebooks.each_ref().map(|codebook| codebook.0.map(f32::exp)),
            planes: planes.iter().map(|(_, plane)| plane).collect(),
            palette,
        };
        let mut rest = slots;
        let mut blocks = Vec::new();
        for range in ranges {
            let (run, others) = rest.split_at(range.len());
            rest = others;
            blocks.extend(run.blocks(BLOCK).into_iter().map(|(first, block)| (range.start + first, block)));
        }
        blocks.into_par_iter().for_each(|(first, mut block)| {
            decoder.unpack(first, &mut block);
            work.add(block.len());
        });
        Ok(())
    }
}

/// The coordinate x with sign(x)·ln(|x| + 1) = `log`.
fn linear(log: f64) -> f64 {
    log.abs().exp_m1() * log.signum()
}

/// The palette of the higher spherical harmonics as f32 rows `[count, coefficients − 1, 3]`.
struct Palette {
    rows: Vec<f32>,
    stride: usize,
}

fn palette(rest: &ShRest, name: &str, plane: &Plane) -> Result<Palette, LoadError> {
    let coefficients = sh_coefficient_count(rest.bands) - 1;
    let all = plane.height * PALETTE_COLUMNS;
    let count = rest.count.map_or(all, |count| count as usize);
    let (width, height) = (PALETTE_COLUMNS * coefficients, count.div_ceil(PALETTE_COLUMNS));
    if plane.width != width || plane.height < height {
        let expected = format!("{width} × {height} pixels for {count} rows of {} bands", rest.bands);
        let actual = format!("{} × {}", plane.width, plane.height);
        return Err(LoadError::invalid(name, "image size", expected, actual));
    }
    let stride = coefficients * 3;
    // `count` is bounded by the image's pixels now.
    let mut rows = vec![0.0; count * stride];
    for (row, values) in rows.chunks_exact_mut(stride).enumerate() {
        for (k, rgb) in values.chunks_exact_mut(3).enumerate() {
            let pixel = plane.pixel(row * coefficients + k);
            for (value, code) in rgb.iter_mut().zip(pixel) {
                *value = rest.codebook.0[usize::from(code)];
            }
        }
    }
    Ok(Palette { rows, stride })
}

/// Everything that the pixels of one Gaussian need to become parameters.
struct Decoder<'a> {
    meta: &'a Meta,
    /// Subtracted from means before they lose precision.
    origin: DVec3,
    /// The codebooks of log scales, activated.
    scales: [[f32; 256]; 3],
    /// In the order of [`Chunk::image_names`]: means low, means high, scales, quaternions, sh0, palette,
    /// labels.
    planes: Vec<&'a Plane>,
    palette: Option<Palette>,
}

impl Decoder<'_> {
    /// Unpacks Gaussians `first` and following into `slots`.
    fn unpack(&self, first: usize, slots: &mut Slots<'_>) {
        for axis in 0..3 {
            self.unpack_means(axis, first, slots.means[axis]);
        }
        let [_, _, scales, quaternions, sh0, ..] = self.planes[..] else { return };
        for i in 0..slots.len() {
            let codes = scales.pixel(first + i);
            for ((plane, code), values) in slots.scales.iter_mut().zip(codes).zip(&self.scales) {
                plane[i] = values[usize::from(code)];
            }
            let rotation = unpack_quaternion(quaternions.pixel(first + i));
            for (plane, value) in slots.rotations.iter_mut().zip(rotation) {
                plane[i] = value;
            }
            let [r, g, b, opacity] = sh0.pixel(first + i);
            slots.opacities[i] = self.meta.opacities.0[usize::from(opacity)];
            let constant = &mut slots.sh[i * slots.sh_stride..i * slots.sh_stride + 3];
            for ((value, code), values) in constant.iter_mut().zip([r, g, b]).zip(&self.meta.sh0.codebooks) {
                *value = values.0[usize::from(code)];
            }
        }
        if let (Some(palette), Some(labels)) = (&self.palette, self.planes.get(6)) {
            for (i, sh) in slots.sh.chunks_exact_mut(slots.sh_stride).enumerate() {
                let [low, high, ..] = labels.pixel(first + i);
                let row = usize::from(u16::from_le_bytes([low, high])) * palette.stride;
                let to = &mut sh[3..3 + palette.stride];
                match palette.rows.get(row..row + palette.stride) {
                    Some(row) => to.copy_from_slice(row),
                    // A label beyond the palette: not a Gaussian that can be shown.
                    None => to.fill(f32::NAN),
                }
            }
        }
    }

    /// A mean is stored as 16 bits between the bounds of sign(x)·ln(|x| + 1).
    fn unpack_means(&self, axis: usize, first: usize, means: &mut [f32]) {
        let (min, max) = (self.meta.means.mins[axis], self.meta.means.maxs[axis]);
        let step = (max - min) / 65_535.0;
        let origin = self.origin[axis];
        for (i, mean) in means.iter_mut().enumerate() {
            let low = self.planes[0].pixel(first + i)[axis];
            let high = self.planes[1].pixel(first + i)[axis];
            let value = min + step * f64::from(u16::from_le_bytes([low, high]));
            *mean = (linear(value) - origin) as f32;
        }
    }
}

/// Three components within ±√½ as bytes, and 252 + the index (w, x, y, z) of the fourth. Other tags are
/// reserved: a zero quaternion, which the check of the scene drops and counts.
fn unpack_quaternion([a, b, c, tag]: [u8; 4]) -> [f32; 4] {
    let Some(largest) = tag.checked_sub(252) else { return [0.0; 4] };
    let component = |byte: u8| (f32::from(byte) / 255.0 * 2.0 - 1.0) * std::f32::consts::FRAC_1_SQRT_2;
    with_largest(usize::from(largest), [component(a), component(b), component(c)])
}
