//! A frame in numbers: linear colour, and what else of every pixel is asked for. For compositing and for NumPy.

use std::path::Path;

use gs3::scene::Image;
use rayon::prelude::*;

use super::output::write_file;
use super::{exr, npz};
use crate::cli::error::CliError;
use crate::cli::options::AovFormat;

/// A quantity of every pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// Name of the array in NPZ files.
    pub array: &'static str,
    /// Names of the channels in EXR files, as Blender and Nuke expect them.
    pub channels: &'static [&'static str],
    /// A plane for each channel, row by row.
    pub planes: Vec<Vec<f32>>,
}

/// The layers of a frame, and the format of their file.
#[derive(Clone, Debug)]
pub struct Layers {
    /// Width and height in pixels.
    pub size: [usize; 2],
    pub layers: Vec<Layer>,
    pub format: AovFormat,
}

impl Layers {
    /// The colour of `image` in linear light. With its `coverage`, where it is to be transparent where nothing is, also
    /// alpha, by which the colour is multiplied.
    pub fn of_frame(image: &Image, coverage: Option<&Image>, format: AovFormat) -> Self {
        let pixels: Vec<[f32; 4]> = match coverage {
            None => image
                .pixels()
                .par_iter()
                .map(|[r, g, b, _]| [linear(*r), linear(*g), linear(*b), 1.0])
                .collect(),
            Some(coverage) => {
                let pixels = image.pixels().par_iter().zip(coverage.pixels());
                pixels.map(|(color, coverage)| associated(*color, coverage[1])).collect()
            }
        };
        let plane = |c: usize| pixels.par_iter().map(|pixel| pixel[c]).collect();
        let color =
            Layer { array: "color_linear", channels: &["R", "G", "B"], planes: (0..3).map(plane).collect() };
        let alpha = coverage.map(|_| Layer { array: "alpha", channels: &["A"], planes: vec![plane(3)] });
        let layers = [color].into_iter().chain(alpha).collect();
        Self { size: [image.width(), image.height()], layers, format }
    }

    /// Writes them as a file, whole or not at all.
    pub fn write(&self, file: &Path) -> Result<(), CliError> {
        let [width, height] = self.size;
        write_file(file, |writer| match self.format {
            AovFormat::Exr => {
                let named = self.layers.iter().flat_map(|layer| layer.channels.iter().zip(&layer.planes));
                let channels: Vec<_> = named.map(|(name, plane)| (*name, plane.as_slice())).collect();
                exr::write(writer, self.size, &channels)
            }
            AovFormat::Npz => npz::write(writer, |zip| {
                self.layers.iter().try_for_each(|Layer { array, planes, .. }| match &planes[..] {
                    [plane] => npz::add(zip, array, &[height, width], plane.iter().copied()),
                    planes => {
                        let values =
                            (0..width * height).flat_map(|i| planes.iter().map(move |plane| plane[i]));
                        npz::add(zip, array, &[height, width, planes.len()], values)
                    }
                })
            }),
        })
    }
}

/// The light of a display-encoded value, by the transfer function of sRGB (IEC 61966-2-1), continued above 1. Scenes are
/// trained on photos in this encoding. A value below 0, which only a reconstruction has, is no light.
fn linear(encoded: f32) -> f32 {
    // `max` maps NaN to 0.
    let encoded = encoded.max(0.0);
    if encoded <= 0.040_45 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}

/// Linear colour times alpha, and alpha, of a colour over black; as in PNG files, nothing where alpha has not half a step of
/// eight bits.
fn associated(over_black: [f32; 4], coverage: f32) -> [f32; 4] {
    // `clamp` keeps NaN, which is no coverage.
    let alpha = coverage.clamp(0.0, 1.0);
    if alpha.is_nan() || alpha < 0.5 / 255.0 {
        return [0.0; 4];
    }
    let [r, g, b] = [0, 1, 2].map(|c| linear(over_black[c] / alpha) * alpha);
    [r, g, b, alpha]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_are_linear_light() {
        // sRGB: half of the code is 21.4 % of the light, and code 10 of 255 lies on the straight part.
        for (encoded, light) in
            [(0.0, 0.0), (1.0, 1.0), (0.5, 0.214_041), (10.0 / 255.0, 10.0 / 255.0 / 12.92), (-0.2, 0.0)]
        {
            assert!((linear(encoded) - light).abs() < 1e-6, "{encoded}: {}", linear(encoded));
        }
        // Both parts meet, and more than white is more light.
        assert!((linear(0.040_46) - linear(0.040_45)).abs() < 2e-6 && linear(1.5) > 2.0);
        assert_eq!(linear(f32::NAN), 0.0);
    }

    #[test]
    fn colours_are_multiplied_by_alpha_in_linear_light() {
        let image = |pixels: &[[f32; 4]]| Image::from_pixels(pixels.len(), 1, pixels.to_vec()).unwrap();
        let color = image(&[[0.25, 0.5, 0.0, 0.0], [0.001; 4], [0.5; 4]]);
        let coverage = image(&[[0.5; 4], [0.001; 4], [f32::NAN; 4]]);
        let layers = Layers::of_frame(&color, Some(&coverage), AovFormat::Exr);
        let at = |layer: usize, plane: usize| &layers.layers[layer].planes[plane];
        assert_eq!((layers.size, layers.layers.len()), ([3, 1], 2));
        assert_eq!(at(0, 0)[..], [0.5 * linear(0.5), 0.0, 0.0]);
        assert_eq!(at(0, 1)[..], [0.5, 0.0, 0.0]);
        assert_eq!(at(1, 0)[..], [0.5, 0.0, 0.0]);
        assert_eq!(Layers::of_frame(&color, None, AovFormat::Exr).layers.len(), 1);
    }
}
