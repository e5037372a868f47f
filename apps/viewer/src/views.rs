//! What may be looked at besides the picture, and how it is coloured.

use fearless_simd::{Simd, dispatch, f32x16, i32x16, prelude::*};
use gs3::FramePipeline;
use gs3::scene::{BLOCK_SIDE, GBuffer, Image, Size, block_grid};
use rayon::prelude::*;

use crate::paint::Framebuffer;

/// What is shown of the scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum View {
    /// The frame.
    #[default]
    Picture,
    /// Median depth of the low-resolution frame: near is bright.
    Depth,
    /// Normals of the low-resolution frame: x, y and z as red, green and blue.
    Normals,
    /// Lengths of the exact gradients of the low-resolution frame's colour, in the direction x as red and y as green.
    Gradients,
    /// Errors that are expected of reconstruction, in blocks of 4×4 pixels, before exact ones take their place.
    Uncertainty,
    /// The frame, its exact blocks tinted.
    ExactBlocks,
}

impl View {
    /// All of them, in the order in which keys go through them.
    pub const ALL: [Self; 6] =
        [Self::Picture, Self::Depth, Self::Normals, Self::Gradients, Self::Uncertainty, Self::ExactBlocks];

    /// Its name in panels.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Picture => "picture",
            Self::Depth => "depth",
            Self::Normals => "normals",
            Self::Gradients => "gradients",
            Self::Uncertainty => "expected error",
            Self::ExactBlocks => "exact blocks",
        }
    }

    /// The one after it.
    #[must_use]
    pub fn next(self) -> Self {
        let place = Self::ALL.iter().position(|view| *view == self).unwrap_or_default();
        Self::ALL[(place + 1) % Self::ALL.len()]
    }

    /// Whether it is made from the low-resolution frame.
    #[must_use]
    pub const fn reads_gbuffer(self) -> bool {
        matches!(self, Self::Depth | Self::Normals | Self::Gradients)
    }
}

/// Columns `columns` of `image` into `picture`, which has its size.
pub fn show_image(image: &Image, columns: std::ops::Range<usize>, picture: &mut Framebuffer) {
    let width = picture.size[0];
    if image.width() != width || image.height() != picture.size[1] || width == 0 {
        return;
    }
    let level = gs3::simd::level();
    picture.pixels.par_chunks_exact_mut(width).enumerate().for_each(|(y, row)| {
        let (row, pixels) = (&mut row[columns.clone()], &image.row(y)[columns.clone()]);
        dispatch!(level, simd => to_8_bits(simd, pixels, row));
    });
}

/// As [`rgb`] for each of `pixels`.
#[inline(always)]
fn to_8_bits<S: Simd>(simd: S, pixels: &[[f32; 4]], to: &mut [u32]) {
    let (quads, rest) = pixels.as_chunks::<4>();
    let (to, to_rest) = to.split_at_mut(4 * quads.len());
    for (to, quad) in to.as_chunks_mut::<4>().0.iter_mut().zip(quads) {
        let values = f32x16::from_slice(simd, quad.as_flattened());
        // NaN becomes 0, as in `as`.
        let values = (values * 255.0 + 0.5).max_precise(0.0).min(255.0);
        let values = values.to_int::<i32x16<S>>().to_array();
        for (k, to) in to.iter_mut().enumerate() {
            *to = (values[4 * k] << 16 | values[4 * k + 1] << 8 | values[4 * k + 2]) as u32;
        }
    }
    for (to, pixel) in to_rest.iter_mut().zip(rest) {
        *to = rgb([pixel[0], pixel[1], pixel[2]]);
    }
}

/// How far two images are apart, `gain` times, into `picture`.
pub fn show_difference(a: &Image, b: &Image, gain: f32, picture: &mut Framebuffer) {
    let width = picture.size[0];
    let fits = |image: &Image| image.width() == width && image.height() == picture.size[1];
    if !(fits(a) && fits(b)) || width == 0 {
        return;
    }
    picture.pixels.par_chunks_exact_mut(width).enumerate().for_each(|(y, row)| {
        for (to, (a, b)) in row.iter_mut().zip(a.row(y).iter().zip(b.row(y))) {
            *to = rgb([0, 1, 2].map(|k| gain * (a[k] - b[k]).abs()));
        }
    });
}

/// `view` of the last frame of `pipeline` into `picture`, which has the frame's size. Black where the machine that made the
/// frame does not know.
pub fn show_view(view: View, pipeline: &FramePipeline, picture: &mut Framebuffer) {
    let scale = pipeline.scale() as usize;
    let gbuffer = pipeline.gbuffer();
    match view {
        View::Picture => show_image(pipeline.last_image(), 0..picture.size[0], picture),
        View::Depth => show_depth(gbuffer, scale, picture),
        View::Normals => show_normals(gbuffer, scale, picture),
        View::Gradients => show_gradients(gbuffer, scale, picture),
        View::Uncertainty => show_expected_errors(pipeline.expected_errors(), picture),
        View::ExactBlocks => {
            show_image(pipeline.last_image(), 0..picture.size[0], picture);
            tint_blocks(pipeline.exact_places(), picture);
        }
    }
}

/// Each pixel of `picture` as the low-resolution pixel over it.
fn enlarge(
    [width, height]: [usize; 2],
    scale: usize,
    picture: &mut Framebuffer,
    color: impl Fn(usize, usize) -> u32 + Sync,
) {
    let columns = picture.size[0];
    if width == 0 || height == 0 || columns == 0 {
        return picture.pixels.fill(0);
    }
    picture.pixels.par_chunks_exact_mut(columns).enumerate().for_each(|(y, row)| {
        let y = (y / scale).min(height - 1);
        for (x, to) in row.iter_mut().enumerate() {
            *to = color((x / scale).min(width - 1), y);
        }
    });
}

fn show_depth(gbuffer: &GBuffer, scale: usize, picture: &mut Framebuffer) {
    let Some(geometry) = &gbuffer.geometry else { return picture.pixels.fill(0) };
    let depth = &geometry.depth_median;
    let is_hit = |z: &f32| *z > 0.0 && z.is_finite();
    let mut found: Vec<f32> = depth.plane(0).iter().copied().filter(is_hit).collect();
    found.sort_by(f32::total_cmp);
    let (Some(near), Some(far)) = (found.get(found.len() / 100), found.get(found.len() * 99 / 100)) else {
        return picture.pixels.fill(0);
    };
    // In 1/z, as parallax is: what is near has most of the colours.
    let (near, far) = (1.0 / near, 1.0 / far);
    let range = (near - far).max(1e-6 * near);
    enlarge([depth.width(), depth.height()], scale, picture, |x, y| {
        let z = depth.row(0, y)[x];
        if is_hit(&z) { rgb([0.1 + 0.9 * ((1.0 / z - far) / range).clamp(0.0, 1.0); 3]) } else { 0 }
    });
}

fn show_normals(gbuffer: &GBuffer, scale: usize, picture: &mut Framebuffer) {
    let Some(geometry) = &gbuffer.geometry else { return picture.pixels.fill(0) };
    let normal = &geometry.normal;
    enlarge([normal.width(), normal.height()], scale, picture, |x, y| {
        let n = [0, 1, 2].map(|c| normal.row(c, y)[x]);
        let is_hit = n.iter().any(|v| *v != 0.0);
        // Up and towards the camera are bright, as in most tools.
        if is_hit { rgb([0.5 + 0.5 * n[0], 0.5 - 0.5 * n[1], 0.5 - 0.5 * n[2]]) } else { 0 }
    });
}

fn show_gradients(gbuffer: &GBuffer, scale: usize, picture: &mut Framebuffer) {
    /// A step of an eighth of the range from one low-resolution pixel to the next is fully bright.
    const GAIN: f32 = 8.0;
    let Some(gradients) = &gbuffer.gradients else { return picture.pixels.fill(0) };
    let (dx, dy) = (&gradients.color_dx, &gradients.color_dy);
    enlarge([dx.width(), dx.height()], scale, picture, |x, y| {
        let length = |planes: &gs3::scene::Planes<3>| {
            [0, 1, 2].iter().map(|c| planes.row(*c, y)[x].powi(2)).sum::<f32>().sqrt()
        };
        rgb([GAIN * length(dx), GAIN * length(dy), 0.0])
    });
}

fn show_expected_errors(errors: &[f32], picture: &mut Framebuffer) {
    /// Steps of 8 bits that are fully bright.
    const BRIGHT: f32 = 16.0;
    let grid = block_grid(Size::of(picture.size[0], picture.size[1]));
    if errors.len() != grid[0] * grid[1] {
        return picture.pixels.fill(0);
    }
    enlarge(grid, BLOCK_SIDE, picture, |x, y| {
        // The sum over pixels and RGB to a root mean square.
        let steps = (errors[y * grid[0] + x] / (3 * BLOCK_SIDE * BLOCK_SIDE) as f32).sqrt() * 255.0;
        let t = steps / BRIGHT;
        rgb([2.0 * t, 2.0 * t - 1.0, 4.0 * t - 3.0])
    });
}

fn tint_blocks(places: &[[u16; 2]], picture: &mut Framebuffer) {
    let [width, height] = picture.size;
    for [column, row] in places {
        let (left, top) = (usize::from(*column) * BLOCK_SIDE, usize::from(*row) * BLOCK_SIDE);
        for y in top..(top + BLOCK_SIDE).min(height) {
            for x in left..(left + BLOCK_SIDE).min(width) {
                let pixel = &mut picture.pixels[y * width + x];
                *pixel = (*pixel >> 1 & 0x007F_7F7F) + 0x0080_4000;
            }
        }
    }
}

/// A colour in `[0, 1]`, clamped, rounded as [`Image::to_rgb8`] does.
fn rgb(color: [f32; 3]) -> u32 {
    let [r, g, b] = color.map(|v| u32::from((v * 255.0 + 0.5) as u8));
    r << 16 | g << 8 | b
}

#[cfg(test)]
mod tests {
    use gs3::scene::demo;
    use gs3::{Mode, PipelineSettings, Refine};

    use super::*;

    fn rendered() -> (FramePipeline, Framebuffer) {
        let settings =
            PipelineSettings { mode: Mode::SuperSample, refine: Refine::Share(0.1), ..Default::default() };
        let mut pipeline = FramePipeline::new(demo::scene().unwrap(), settings).unwrap();
        let path = demo::path().resized(96, 60).unwrap();
        path.cameras().iter().take(2).for_each(|camera| {
            pipeline.render(camera).unwrap();
        });
        pipeline.fetch_normals().unwrap();
        let mut picture = Framebuffer::default();
        picture.resize([96, 60]);
        (pipeline, picture)
    }

    #[test]
    fn the_picture_is_the_frame() {
        let (pipeline, mut picture) = rendered();
        show_view(View::Picture, &pipeline, &mut picture);
        assert_eq!(picture.to_rgb8(), pipeline.last_image().to_rgb8());
    }

    #[test]
    fn values_that_are_no_colours_are_brought_into_range() {
        let values =
            [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -0.2, 0.0, 0.5, 1.0, 7.0, 0.998_039_25, 1e30, -1e30];
        let mut image = Image::new(11, 1);
        for (k, pixel) in image.pixels_mut().iter_mut().enumerate() {
            *pixel = [values[k], values[(k + 3) % 11], values[(k + 7) % 11], f32::NAN];
        }
        let mut picture = Framebuffer { size: [11, 1], pixels: vec![7; 11] };
        show_image(&image, 1..11, &mut picture);
        assert_eq!((picture.pixels[0], &picture.to_rgb8()[3..]), (7, &image.to_rgb8()[3..]));
    }

    #[test]
    fn every_view_shows_something_of_its_own() {
        let (pipeline, mut picture) = rendered();
        let mut pictures: Vec<Framebuffer> = Vec::new();
        for view in View::ALL {
            picture.pixels.fill(0);
            show_view(view, &pipeline, &mut picture);
            let colours = picture.pixels.iter().collect::<std::collections::BTreeSet<_>>().len();
            assert!(colours > 10, "{}: {colours} colours", view.name());
            assert!(!pictures.contains(&picture), "{}", view.name());
            pictures.push(picture.clone());
        }
        let tinted = pictures[0].pixels.iter().zip(&pictures[5].pixels).filter(|(a, b)| a != b).count();
        let expected = pipeline.exact_places().len() * 16;
        assert!(tinted.abs_diff(expected) <= expected / 20, "{tinted} of {expected}");
        let around = View::ALL.iter().fold(View::Picture, |view, _| view.next());
        assert_eq!(around, View::Picture);
    }

    #[test]
    fn the_difference_of_a_frame_to_itself_is_black() {
        let (pipeline, mut picture) = rendered();
        picture.pixels.fill(9);
        let image = pipeline.last_image();
        show_difference(image, image, 8.0, &mut picture);
        assert!(picture.pixels.iter().all(|pixel| *pixel == 0));
        let mut other = image.clone();
        other.pixels_mut()[7][1] += 0.05;
        show_difference(image, &other, 8.0, &mut picture);
        assert_eq!(picture.pixels[7], 102 << 8);
    }
}
