//! Blended tiles to image planes: background, depth along z, layout.

use gs3_scene::{Camera, GBuffer, Geometry, Gradients, Image, Planes};

use super::bin::{TILE_HEIGHT, TILE_WIDTH};
use super::blend::{Block, plane};
use super::cover::BLOCK;
use super::view::View;
use crate::settings::{Outputs, RasterSettings};

/// A band of [`TILE_HEIGHT`] rows of the output, owned by one thread at a time.
pub enum Band<'a> {
    /// Rows of an image.
    Image(&'a mut [[f32; 4]]),
    /// Rows of a G-buffer.
    GBuffer(Box<GBufferBand<'a>>),
}

/// Rows of a G-buffer's planes; absent ones are empty.
pub struct GBufferBand<'a> {
    color: [&'a mut [f32]; 3],
    alpha: &'a mut [f32],
    color_dx: [&'a mut [f32]; 3],
    color_dy: [&'a mut [f32]; 3],
    color_dxdy: [&'a mut [f32]; 3],
    depth_median: &'a mut [f32],
    depth_expected: &'a mut [f32],
    normal: [&'a mut [f32]; 3],
}

/// Gives `out` the camera's size and the planes that `settings` asks for.
pub fn prepare(out: &mut GBuffer, camera: &Camera, settings: &RasterSettings) {
    let (w, h) = (camera.width() as usize, camera.height() as usize);
    out.jitter = settings.jitter;
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
        gradients.color_dxdy.get_or_insert_with(Planes::default).resize(w, h);
    } else {
        gradients.color_dxdy = None;
    }
    let geometry = out.geometry.get_or_insert_with(Geometry::default);
    geometry.depth_median.resize(w, h);
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
    let bands = height.div_ceil(TILE_HEIGHT);
    let length = TILE_HEIGHT * width;
    let mut color = bands_of(&mut out.color, length);
    let mut alpha = bands_of(&mut out.alpha, length);
    let (mut dx, mut dy, mut dxdy) = (None, None, None);
    if let Some(gradients) = &mut out.gradients {
        dx = Some(bands_of(&mut gradients.color_dx, length));
        dy = Some(bands_of(&mut gradients.color_dy, length));
        dxdy = gradients.color_dxdy.as_mut().map(|planes| bands_of(planes, length));
    }
    let (mut median, mut expected, mut normal) = (None, None, None);
    if let Some(geometry) = &mut out.geometry {
        median = Some(bands_of(&mut geometry.depth_median, length));
        expected = Some(bands_of(&mut geometry.depth_expected, length));
        normal = Some(bands_of(&mut geometry.normal, length));
    }
    let mut bands_out = Vec::with_capacity(bands);
    for _ in 0..bands {
        let [alpha] = next(Some(&mut alpha));
        let [depth_median] = next(median.as_mut());
        let [depth_expected] = next(expected.as_mut());
        bands_out.push(Band::GBuffer(Box::new(GBufferBand {
            color: next(Some(&mut color)),
            alpha,
            color_dx: next(dx.as_mut()),
            color_dy: next(dy.as_mut()),
            color_dxdy: next(dxdy.as_mut()),
            depth_median,
            depth_expected,
            normal: next(normal.as_mut()),
        })));
    }
    bands_out
}

type PlaneBands<'a, const C: usize> = [std::slice::ChunksMut<'a, f32>; C];

fn bands_of<const C: usize>(planes: &mut Planes<C>, length: usize) -> PlaneBands<'_, C> {
    let size = planes.width() * planes.height();
    let mut rest = planes.data_mut();
    std::array::from_fn(|_| {
        let (plane, after) = std::mem::take(&mut rest).split_at_mut(size);
        rest = after;
        plane.chunks_mut(length)
    })
}

fn next<'a, const C: usize>(bands: Option<&mut PlaneBands<'a, C>>) -> [&'a mut [f32]; C] {
    match bands {
        Some(bands) => bands.each_mut().map(|plane| plane.next().unwrap_or_default()),
        None => std::array::from_fn(|_| <&mut [f32]>::default()),
    }
}

/// Constants of one frame's resolve.
pub struct Resolver {
    background: [f32; 3],
    inv_focal: [f32; 2],
    center: [f32; 2],
}

impl Resolver {
    pub fn new(view: &View, settings: &RasterSettings) -> Self {
        Self { background: settings.background, inv_focal: view.focal.map(|f| 1.0 / f), center: view.center }
    }

    /// Writes the blocks of tile `(column, row)` to its band.
    pub fn resolve(
        &self,
        blocks: &[Block],
        [column, row]: [usize; 2],
        [width, height]: [usize; 2],
        band: &mut Band<'_>,
    ) {
        let (x0, y0) = (column * TILE_WIDTH, row * TILE_HEIGHT);
        for (b, block) in blocks.iter().enumerate() {
            let x = x0 + b % (TILE_WIDTH / BLOCK) * BLOCK;
            let block_y = b / (TILE_WIDTH / BLOCK) * BLOCK;
            for line in 0..BLOCK {
                let y = block_y + line;
                if x >= width || y0 + y >= height {
                    continue;
                }
                let count = BLOCK.min(width - x);
                let pixels = Line { state: &block.0, lane: line * BLOCK, at: y * width + x, count };
                match band {
                    Band::Image(out) => self.resolve_image(&pixels, out),
                    Band::GBuffer(out) => self.resolve_gbuffer(&pixels, [x, y0 + y], out),
                }
            }
        }
    }

    fn resolve_image(&self, line: &Line<'_>, out: &mut [[f32; 4]]) {
        for (i, pixel) in out[line.at..line.at + line.count].iter_mut().enumerate() {
            let t = line.transmittance(i);
            let color: [f32; 3] =
                std::array::from_fn(|k| line.get(plane::COLOR + k, i) + t * self.background[k]);
            *pixel = [color[0], color[1], color[2], 1.0 - t];
        }
    }

    fn resolve_gbuffer(&self, line: &Line<'_>, [x, y]: [usize; 2], out: &mut GBufferBand<'_>) {
        for i in 0..line.count {
            let at = line.at + i;
            let t = line.transmittance(i);
            let alpha = 1.0 - t;
            for k in 0..3 {
                out.color[k][at] = line.get(plane::COLOR + k, i) + t * self.background[k];
            }
            out.alpha[at] = alpha;
            if out.depth_median.is_empty() {
                continue;
            }
            // The background shows through T: its share of the derivative is −∂(1 − T)·background.
            let (ax, ay) = (line.get(plane::ALPHA_DX, i), line.get(plane::ALPHA_DY, i));
            for k in 0..3 {
                let background = self.background[k];
                out.color_dx[k][at] = line.get(plane::COLOR_DX + k, i) - ax * background;
                out.color_dy[k][at] = line.get(plane::COLOR_DY + k, i) - ay * background;
                out.normal[k][at] = line.get(plane::NORMAL + k, i);
            }
            if !out.color_dxdy[0].is_empty() {
                let axy = line.get(plane::ALPHA_DXDY, i);
                for k in 0..3 {
                    out.color_dxdy[k][at] = line.get(plane::COLOR_DXDY + k, i) - axy * self.background[k];
                }
            }
            // Distances along the ray to depths along z.
            let ray_x = ((x + i) as f32 - self.center[0]) * self.inv_focal[0];
            let ray_y = (y as f32 - self.center[1]) * self.inv_focal[1];
            let inv_length = 1.0 / (ray_x * ray_x + ray_y * ray_y + 1.0).sqrt();
            out.depth_median[at] = line.get(plane::MEDIAN, i) * inv_length;
            let distance = line.get(plane::DISTANCE, i);
            out.depth_expected[at] = if alpha > 0.0 { distance / alpha * inv_length } else { 0.0 };
        }
    }
}

/// Up to four neighbouring pixels of a block and their place in the band.
struct Line<'a> {
    state: &'a [[f32; 16]; plane::COUNT],
    lane: usize,
    at: usize,
    count: usize,
}

impl Line<'_> {
    fn get(&self, p: usize, i: usize) -> f32 {
        self.state[p][self.lane + i]
    }

    /// Transmittance after the last contribution.
    fn transmittance(&self, i: usize) -> f32 {
        let open = self.get(plane::TRANSMITTANCE, i);
        if open > 0.0 { open } else { self.get(plane::FINAL, i) }
    }
}
