//! Blended tiles to image planes: background, depth along z, layout.

use fearless_simd::{Simd, f32x16, prelude::*};
use gs3_scene::{GBuffer, Geometry, Gradients, Image, Planes};

use super::bin::{TILE_HEIGHT, TILE_WIDTH};
use super::blend::{BlendRules, Block, COLOR, GBUFFER, GBUFFER_MIXED, plane};
use super::cover::{BLOCK, BLOCKS, block_first};
use super::grid::Grid;
use crate::settings::{Outputs, RasterSettings};
use crate::view::View;

/// A band of [`TILE_HEIGHT`] rows of the output, owned by one thread at a time.
pub enum Band<'a> {
    /// Rows of an image.
    Image(&'a mut [[f32; 4]]),
    /// Rows of a G-buffer's planes, each with the index of the block plane that is written there.
    GBuffer(Vec<(usize, &'a mut [f32])>),
}

/// Gives `out` the `[width, height]` of a frame with its margin, and the planes of `settings`.
pub fn prepare(out: &mut GBuffer, [w, h]: [usize; 2], settings: &RasterSettings) {
    (out.jitter, out.margin) = (settings.jitter, settings.margin);
    out.color.resize(w, h);
    out.alpha.resize(w, h);
    if settings.outputs == Outputs::Color {
        out.gradients = None;
        out.geometry = None;
        return;
    }
    let gradients = out.gradients.get_or_insert_with(Gradients::default);
    gradients.color_dx.resize(w, h);
    gradients.color_dy.resize(w, h);
    if settings.outputs == Outputs::GBufferMixed {
        gradients.color_dxy.get_or_insert_with(Planes::default).resize(w, h);
    } else {
        gradients.color_dxy = None;
    }
    let geometry = out.geometry.get_or_insert_with(Geometry::default);
    geometry.depth_median.resize(w, h);
    let [w, h] = if settings.outputs == Outputs::Samples { [0, 0] } else { [w, h] };
    geometry.depth_expected.resize(w, h);
    geometry.normal.resize(w, h);
}

/// The bands of an image.
pub fn image_bands(image: &mut Image) -> Vec<Band<'_>> {
    let length = TILE_HEIGHT * image.width();
    image.pixels_mut().chunks_mut(length).map(Band::Image).collect()
}

/// The bands of a prepared G-buffer.
pub fn gbuffer_bands(out: &mut GBuffer) -> Vec<Band<'_>> {
    let (width, height) = (out.color.width(), out.color.height());
    let length = TILE_HEIGHT * width;
    let mut planes = Vec::new();
    split(&mut out.color, plane::COLOR, length, &mut planes);
    split(&mut out.alpha, plane::ALPHA, length, &mut planes);
    if let Some(gradients) = &mut out.gradients {
        split(&mut gradients.color_dx, plane::COLOR_DX, length, &mut planes);
        split(&mut gradients.color_dy, plane::COLOR_DY, length, &mut planes);
        if let Some(mixed) = &mut gradients.color_dxy {
            split(mixed, plane::COLOR_DXY, length, &mut planes);
        }
    }
    if let Some(geometry) = &mut out.geometry {
        split(&mut geometry.depth_median, plane::MEDIAN, length, &mut planes);
        split(&mut geometry.depth_expected, plane::DISTANCE, length, &mut planes);
        split(&mut geometry.normal, plane::NORMAL, length, &mut planes);
    }
    let bands = (0..height.div_ceil(TILE_HEIGHT))
        .map(|_| Band::GBuffer(planes.iter_mut().filter_map(|(p, rows)| Some((*p, rows.next()?))).collect()));
    bands.collect()
}

/// Appends the planes of `from`, cut into bands of `length` values. They get the block planes `first`, `first + 1`,
/// …. Empty planes were not asked for.
fn split<'a, const C: usize>(
    from: &'a mut Planes<C>,
    first: usize,
    length: usize,
    planes: &mut Vec<(usize, std::slice::ChunksMut<'a, f32>)>,
) {
    let size = from.width() * from.height();
    if size == 0 {
        return;
    }
    let rows = from.data_mut().chunks_mut(size).map(|plane| plane.chunks_mut(length));
    planes.extend((first..).zip(rows));
}

/// Constants of one frame's resolve.
pub struct Resolver {
    background: [f32; 3],
    inv_focal: [f32; 2],
    center: [f32; 2],
    /// The rules of blending.
    pub rules: BlendRules,
}

impl Resolver {
    pub fn new(view: &View, settings: &RasterSettings) -> Self {
        Self {
            background: settings.background,
            inv_focal: view.focal.map(|f| 1.0 / f),
            center: view.center,
            rules: settings.rules.into(),
        }
    }

    /// Writes the blocks of tile `(column, row)` of `grid` to its band.
    #[inline(always)]
    pub fn resolve<S: Simd, const OUTPUTS: usize>(
        &self,
        s: S,
        blocks: &mut [Block; BLOCKS],
        [column, row]: [usize; 2],
        grid: &Grid,
        band: &mut Band<'_>,
    ) {
        let [width, height] = grid.size;
        let samples = grid.tile_samples([column, row]);
        for (b, block) in blocks.iter_mut().enumerate() {
            let [in_line, line] = block_first(b);
            let (x, y) = (column * TILE_WIDTH + in_line, row * TILE_HEIGHT + line);
            if x >= width || y >= height {
                continue;
            }
            self.finish::<S, OUTPUTS>(s, block, samples.of_block(s, b), samples.pitch);
            let (columns, rows) = (BLOCK.min(width - x), BLOCK.min(height - y));
            match band {
                Band::Image(out) => {
                    let lines = interleaved(s, block);
                    for (r, pixels) in lines.iter().enumerate().take(rows) {
                        let at = (line + r) * width + x;
                        out[at..at + columns].copy_from_slice(&pixels.as_chunks().0[..columns]);
                    }
                }
                Band::GBuffer(planes) => {
                    for (p, out) in planes {
                        for (r, values) in block.0[*p].chunks_exact(BLOCK).enumerate().take(rows) {
                            let at = (line + r) * width + x;
                            out[at..at + columns].copy_from_slice(&values[..columns]);
                        }
                    }
                }
            }
        }
    }

    /// Converts the state of a block with samples at `samples` to the stored values: the background is added,
    /// derivatives are per `pitch` pixels, distances along the ray become depths along z, and alpha goes to
    /// [`plane::ALPHA`].
    #[inline(always)]
    pub fn finish<S: Simd, const OUTPUTS: usize>(
        &self,
        s: S,
        block: &mut Block,
        samples: [f32x16<S>; 2],
        pitch: f32,
    ) {
        let (zero, one) = (f32x16::splat(s, 0.0), f32x16::splat(s, 1.0));
        let plane = &mut block.0;
        let open = f32x16::from_slice(s, &plane[plane::TRANSMITTANCE]);
        let t = open.simd_gt(zero).select(open, f32x16::from_slice(s, &plane[plane::FINAL]));
        let alpha = one - t;
        alpha.store_slice(&mut plane[plane::ALPHA]);
        for k in 0..3 {
            add_product(s, &mut plane[plane::COLOR + k], t, self.background[k]);
        }
        if OUTPUTS == COLOR {
            return;
        }
        // The background shows through T: its part of a derivative is −∂(1 − T)·background.
        let alpha_dx = zero - f32x16::from_slice(s, &plane[plane::ALPHA_DX]);
        let alpha_dy = zero - f32x16::from_slice(s, &plane[plane::ALPHA_DY]);
        for k in 0..3 {
            add_product(s, &mut plane[plane::COLOR_DX + k], alpha_dx, self.background[k]);
            add_product(s, &mut plane[plane::COLOR_DY + k], alpha_dy, self.background[k]);
        }
        if OUTPUTS == GBUFFER_MIXED {
            let alpha_dxy = zero - f32x16::from_slice(s, &plane[plane::ALPHA_DXY]);
            for k in 0..3 {
                add_product(s, &mut plane[plane::COLOR_DXY + k], alpha_dxy, self.background[k]);
            }
        }
        if pitch != 1.0 {
            for derivative in &mut plane[plane::COLOR_DX..plane::COLOR_DX + 6] {
                (f32x16::from_slice(s, derivative) * pitch).store_slice(derivative);
            }
            if OUTPUTS == GBUFFER_MIXED {
                for derivative in &mut plane[plane::COLOR_DXY..plane::COLOR_DXY + 3] {
                    (f32x16::from_slice(s, derivative) * (pitch * pitch)).store_slice(derivative);
                }
            }
        }
        let ray_x = (samples[0] - self.center[0]) * self.inv_focal[0];
        let ray_y = (samples[1] - self.center[1]) * self.inv_focal[1];
        let inv_length = one / ray_x.mul_add(ray_x, ray_y.mul_add(ray_y, one)).sqrt();
        let median = f32x16::from_slice(s, &plane[plane::MEDIAN]) * inv_length;
        median.store_slice(&mut plane[plane::MEDIAN]);
        if OUTPUTS < GBUFFER {
            return;
        }
        let along_z = if self.rules.has_depths_of_centers { one } else { inv_length };
        let expected = f32x16::from_slice(s, &plane[plane::DISTANCE]) / alpha * along_z;
        let expected = alpha.simd_gt(zero).select(expected, zero);
        expected.store_slice(&mut plane[plane::DISTANCE]);
    }
}

/// `plane += a · b`.
#[inline(always)]
fn add_product<S: Simd>(s: S, plane: &mut [f32; 16], a: f32x16<S>, b: f32) {
    a.mul_add(f32x16::splat(s, b), f32x16::from_slice(s, plane)).store_slice(plane);
}

/// Red, green, blue and alpha of a block's pixels, by row.
#[inline(always)]
fn interleaved<S: Simd>(s: S, block: &Block) -> [[f32; 16]; BLOCK] {
    let plane = |p: usize| f32x16::from_slice(s, &block.0[p]);
    let (red_blue_top, red_blue_bottom) = plane(plane::COLOR).interleave(plane(plane::COLOR + 2));
    let (green_alpha_top, green_alpha_bottom) = plane(plane::COLOR + 1).interleave(plane(plane::ALPHA));
    let (first, second) = red_blue_top.interleave(green_alpha_top);
    let (third, fourth) = red_blue_bottom.interleave(green_alpha_bottom);
    let mut rows = [[0.0; 16]; BLOCK];
    for (row, pixels) in rows.iter_mut().zip([first, second, third, fourth]) {
        pixels.store_slice(row);
    }
    rows
}
