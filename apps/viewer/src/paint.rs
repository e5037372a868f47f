//! Paints panels into a picture in the processor's memory: egui's textured triangles, without a device.

use std::collections::HashMap;

use egui::epaint::{ImageDelta, Primitive, Vertex};
use egui::{ClippedPrimitive, Color32, ColorImage, ImageData, Rect, TextureId, TexturesDelta};

/// A picture as windows take it: `0x00RRGGBB`, row by row.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Framebuffer {
    /// Width and height in pixels.
    pub size: [usize; 2],
    /// `[height, width]`.
    pub pixels: Vec<u32>,
}

impl Framebuffer {
    /// Makes the picture `size`, reusing its memory. The contents are unspecified afterwards.
    pub fn resize(&mut self, size: [usize; 2]) {
        self.size = size;
        self.pixels.resize(size[0] * size[1], 0);
    }

    /// The picture as 8-bit RGBA, row by row, opaque.
    #[must_use]
    pub fn to_rgba8(&self) -> Vec<u8> {
        self.pixels.iter().flat_map(|p| [(p >> 16) as u8, (p >> 8) as u8, *p as u8, u8::MAX]).collect()
    }

    /// The picture as 8-bit RGB, row by row.
    #[must_use]
    pub fn to_rgb8(&self) -> Vec<u8> {
        self.pixels.iter().flat_map(|p| [(p >> 16) as u8, (p >> 8) as u8, *p as u8]).collect()
    }
}

/// The textures of panels, and how triangles get into a picture.
#[derive(Debug, Default)]
pub struct Painter {
    textures: HashMap<TextureId, ColorImage>,
}

impl Painter {
    /// Takes in new and changed textures.
    pub fn set_textures(&mut self, delta: &mut TexturesDelta) {
        for (id, changes) in delta.set.drain() {
            changes.iter().for_each(|change| self.set_texture(id, change));
        }
    }

    /// Forgets textures that nothing shows any more, after they were painted for the last time.
    pub fn free_textures(&mut self, delta: &mut TexturesDelta) {
        for id in delta.free.drain() {
            self.textures.remove(&id);
        }
    }

    fn set_texture(&mut self, id: TextureId, change: &ImageDelta) {
        let ImageData::Color(image) = &change.image;
        match (change.pos, self.textures.get_mut(&id)) {
            (None, _) => {
                self.textures.insert(id, image.as_ref().clone());
            }
            (Some([left, top]), Some(texture)) => {
                let [width, height] = texture.size;
                let [columns, rows] = image.size;
                for y in 0..rows.min(height.saturating_sub(top)) {
                    let count = columns.min(width.saturating_sub(left));
                    let to = (top + y) * width + left;
                    texture.pixels[to..to + count]
                        .copy_from_slice(&image.pixels[y * columns..y * columns + count]);
                }
            }
            // A part of a texture that was never sent shows nothing.
            (Some(_), None) => {}
        }
    }

    /// Paints `primitives` over `picture`. Positions are points of `scale` pixels.
    pub fn paint(&self, primitives: &[ClippedPrimitive], scale: f32, picture: &mut Framebuffer) {
        for ClippedPrimitive { clip_rect, primitive } in primitives {
            // Callbacks are drawn by devices; no panel of the viewer has any.
            let Primitive::Mesh(mesh) = primitive else { continue };
            let Some(texture) = self.textures.get(&mesh.texture_id) else { continue };
            let clip = pixels_within(*clip_rect, scale, picture.size);
            for indices in mesh.indices.chunks_exact(3) {
                let corner = |k: usize| mesh.vertices.get(indices[k] as usize);
                if let (Some(a), Some(b), Some(c)) = (corner(0), corner(1), corner(2)) {
                    triangle([a, b, c], scale, texture, clip, picture);
                }
            }
        }
    }
}

/// The first column and row within `rect`, and those after the last.
fn pixels_within(rect: Rect, scale: f32, size: [usize; 2]) -> [usize; 4] {
    let at = |v: f32, most: usize| ((v * scale).round().max(0.0) as usize).min(most);
    [at(rect.min.x, size[0]), at(rect.min.y, size[1]), at(rect.max.x, size[0]), at(rect.max.y, size[1])]
}

/// Paints a triangle. A pixel belongs to it if its centre does; of two triangles with a common edge it belongs to one.
fn triangle(
    corners: [&Vertex; 3],
    scale: f32,
    texture: &ColorImage,
    clip: [usize; 4],
    picture: &mut Framebuffer,
) {
    let mut p = corners.map(|v| [f64::from(v.pos.x * scale), f64::from(v.pos.y * scale)]);
    let mut v = corners;
    let mut area = cross(p[0], p[1], p[2]);
    if area < 0.0 {
        p.swap(1, 2);
        v.swap(1, 2);
        area = -area;
    }
    // NaN and flat triangles have no inside.
    if !(area > 0.0 && area.is_finite()) {
        return;
    }
    let [low, high] =
        [f64::min, f64::max].map(|pick| [0, 1].map(|axis| pick(pick(p[0][axis], p[1][axis]), p[2][axis])));
    let first = |bound: f64, clip: usize| clip.max((bound - 0.5).ceil().max(0.0) as usize);
    let end = |bound: f64, clip: usize| clip.min((bound + 0.5).ceil().max(0.0) as usize);
    let is_plain = v.iter().all(|corner| corner.color == v[0].color && corner.uv == v[0].uv);
    let plain = is_plain
        .then(|| modulate(v[0].color.to_array().map(f32::from), texel(texture, [v[0].uv.x, v[0].uv.y])));
    // Edge k lies opposite corner k; its function is positive inside and linear in x.
    let edges = [(1, 2), (2, 0), (0, 1)].map(|(from, to)| {
        let (a, b) = (p[from], p[to]);
        let step = [-(b[1] - a[1]), b[0] - a[0]];
        let owns = step[0] > 0.0 || (step[0] == 0.0 && step[1] > 0.0);
        (a, step, owns)
    });
    for y in first(low[1], clip[1])..end(high[1], clip[3]) {
        let row = &mut picture.pixels[y * picture.size[0]..(y + 1) * picture.size[0]];
        let center_y = y as f64 + 0.5;
        let at = |x: usize| {
            let center_x = x as f64 + 0.5;
            edges.map(|(a, step, owns)| {
                let e = step[0] * (center_x - a[0]) + step[1] * (center_y - a[1]);
                (e, e > 0.0 || (e == 0.0 && owns))
            })
        };
        let is_inside = |x: &usize| at(*x).iter().all(|(_, is_inside)| *is_inside);
        // The pixels inside are next to each other: a triangle is convex. Each edge bounds them on one side, and what rounding
        // leaves open is tried.
        let (mut left, mut right) = (first(low[0], clip[0]), end(high[0], clip[2]));
        for (a, step, _) in edges {
            let bound = a[0] - step[1] * (center_y - a[1]) / step[0];
            if step[0] > 0.0 {
                left = left.max((bound - 1.5).max(0.0) as usize);
            } else if step[0] < 0.0 {
                right = right.min((bound + 1.5).max(0.0) as usize);
            }
        }
        let Some(left) = (left..right).find(is_inside) else { continue };
        let Some(last) = (left..right).rev().find(is_inside) else { continue };
        if let Some(color) = plain {
            row[left..=last].iter_mut().for_each(|pixel| *pixel = over(color, *pixel));
            continue;
        }
        for (x, pixel) in (left..=last).zip(&mut row[left..=last]) {
            let share = at(x).map(|(e, _)| (e / area) as f32);
            let mix = |of: [f32; 3]| of[0] * share[0] + of[1] * share[1] + of[2] * share[2];
            let uv = [mix(v.map(|c| c.uv.x)), mix(v.map(|c| c.uv.y))];
            let tint = [0, 1, 2, 3].map(|k| mix(v.map(|c| f32::from(c.color.to_array()[k]))));
            *pixel = over(modulate(tint, texel(texture, uv)), *pixel);
        }
    }
}

fn cross(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// The texel at `uv`. Letters lie on whole pixels, so that there is nothing to interpolate.
fn texel(texture: &ColorImage, uv: [f32; 2]) -> Color32 {
    let at = |v: f32, size: usize| ((v * size as f32).max(0.0) as usize).min(size.saturating_sub(1));
    let [width, height] = texture.size;
    texture.pixels.get(at(uv[1], height) * width + at(uv[0], width)).copied().unwrap_or(Color32::TRANSPARENT)
}

/// Premultiplied colours in `[0, 255]`, multiplied.
fn modulate(tint: [f32; 4], texel: Color32) -> [f32; 4] {
    let texel = texel.to_array();
    [0, 1, 2, 3].map(|k| tint[k] * f32::from(texel[k]) / 255.0)
}

/// Premultiplied `color` over an opaque pixel.
fn over(color: [f32; 4], pixel: u32) -> u32 {
    let rest = 1.0 - color[3] / 255.0;
    let channel = |k: usize, shift: u32| {
        let below = ((pixel >> shift) & 0xFF) as f32;
        // `as` saturates.
        u32::from((color[k] + rest * below + 0.5) as u8) << shift
    };
    channel(0, 16) | channel(1, 8) | channel(2, 0)
}

#[cfg(test)]
mod tests {
    use egui::epaint::Mesh;
    use egui::{TextureOptions, pos2, vec2};

    use super::*;

    fn painter() -> Painter {
        let mut painter = Painter::default();
        let image = ColorImage::filled([2, 1], Color32::WHITE);
        let delta = ImageDelta::full(image, TextureOptions::NEAREST);
        painter.set_texture(TextureId::default(), &delta);
        painter
    }

    fn mesh(mesh: Mesh) -> ClippedPrimitive {
        ClippedPrimitive { clip_rect: Rect::EVERYTHING, primitive: Primitive::Mesh(mesh) }
    }

    fn picture() -> Framebuffer {
        Framebuffer { size: [8, 6], pixels: vec![0; 48] }
    }

    /// Both triangles of a half transparent rectangle: each pixel once, the diagonal too.
    #[test]
    fn common_edges_are_painted_once() {
        let mut quad = Mesh::default();
        quad.add_colored_rect(
            Rect::from_min_size(pos2(1.0, 1.0), vec2(4.0, 4.0)),
            Color32::from_black_alpha(128),
        );
        let mut picture = picture();
        picture.pixels.fill(0x00FF_FFFF);
        painter().paint(&[mesh(quad)], 1.0, &mut picture);
        for (k, pixel) in picture.pixels.iter().enumerate() {
            let is_inside = (1..5).contains(&(k % 8)) && (1..5).contains(&(k / 8));
            assert_eq!(*pixel, if is_inside { 0x007F_7F7F } else { 0x00FF_FFFF }, "pixel {k}");
        }
    }

    #[test]
    fn points_are_so_many_pixels_and_clips_hold() {
        let mut quad = Mesh::default();
        quad.add_colored_rect(Rect::from_min_size(pos2(0.5, 0.5), vec2(9.0, 9.0)), Color32::RED);
        let mut clipped = mesh(quad);
        clipped.clip_rect = Rect::from_min_size(pos2(0.0, 0.0), vec2(2.0, 1.5));
        let mut picture = picture();
        painter().paint(&[clipped], 2.0, &mut picture);
        for (k, pixel) in picture.pixels.iter().enumerate() {
            let is_inside = (1..4).contains(&(k % 8)) && (1..3).contains(&(k / 8));
            assert_eq!(*pixel, if is_inside { 0x00FF_0000 } else { 0 }, "pixel {k}");
        }
    }

    #[test]
    fn textures_are_read_changed_and_freed() {
        let mut painter = painter();
        let patch = ImageDelta::partial(
            [1, 0],
            ColorImage::filled([1, 1], Color32::from_rgb(0, 0, 255)),
            TextureOptions::NEAREST,
        );
        painter.set_texture(TextureId::default(), &patch);
        let mut quad = Mesh::default();
        let uv = Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0));
        quad.add_rect_with_uv(Rect::from_min_size(pos2(0.0, 0.0), vec2(8.0, 6.0)), uv, Color32::WHITE);
        let quad = mesh(quad);
        let mut picture = picture();
        painter.paint(std::slice::from_ref(&quad), 1.0, &mut picture);
        assert_eq!((picture.pixels[3], picture.pixels[4]), (0x00FF_FFFF, 0x0000_00FF));
        let mut delta = TexturesDelta::default();
        delta.free.insert(TextureId::default());
        painter.free_textures(&mut delta);
        picture.pixels.fill(7);
        painter.paint(&[quad], 1.0, &mut picture);
        assert!(picture.pixels.iter().all(|pixel| *pixel == 7));
    }

    #[test]
    fn hostile_triangles_paint_nothing() {
        let mut broken = Mesh::default();
        for pos in [pos2(f32::NAN, 0.0), pos2(f32::INFINITY, 3.0), pos2(2.0, 2.0)] {
            broken.colored_vertex(pos, Color32::RED);
        }
        broken.add_triangle(0, 1, 2);
        broken.indices.extend([7, 8, 9]);
        let mut picture = picture();
        painter().paint(&[mesh(broken)], 1.0, &mut picture);
        assert!(picture.pixels.iter().all(|pixel| *pixel == 0));
    }
}
