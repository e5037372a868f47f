//! The view of a clip, and the window of it that the clip shows.

use glam::DAffine3;
use gs3::scene::{Camera, CameraError, Intrinsics, Size};

use super::draw::Draw;
use crate::clip::ClipWindow;

/// Sizes of views, and how often they come.
const SIZES: [(f64, Size); 5] = [
    (6.0, Size::new(1920, 1080)),
    (2.0, Size::new(1280, 720)),
    (1.0, Size::new(2560, 1440)),
    (1.0, Size::new(3840, 2160)),
    (1.0, Size::new(4096, 2160)),
];

/// Vertical fields of view, in degrees.
const FOV_Y: [f64; 2] = [40.0, 75.0];

/// Around the window, as many pixels are rendered on each side as the frame has there, so that what comes into the
/// window within a few frames has a history.
const MARGIN: u32 = 64;

/// A view, and which part of it is rendered and kept. Splats are as large as in the whole view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Framing {
    /// Of the whole view.
    view: Intrinsics,
    /// What is kept: left, top, width and height in pixels of the view, multiples of the scale.
    window: [u32; 4],
    scale: u32,
}

impl Framing {
    /// Largest window.
    pub const LARGEST: Size = SIZES[SIZES.len() - 1].1;

    /// A random view that a window of `size`, multiples of `scale` within [`Self::LARGEST`], fits in; the window lies
    /// in its corner.
    pub fn draw(draw: &mut Draw, size: Size, scale: u32) -> Self {
        let fits = |s: &Size| s.width >= size.width && s.height >= size.height;
        let sizes: Vec<_> = SIZES.into_iter().filter(|(_, s)| fits(s)).collect();
        let Size { width, height } = draw.weighted(&sizes, Self::LARGEST);
        let fov_y = draw.uniform(FOV_Y[0], FOV_Y[1]).to_radians();
        let view = Intrinsics::from_fov_y(width, height, fov_y);
        Self { view, window: [0, 0, size.width, size.height], scale }
    }

    /// The window moved to a random place of the view.
    pub fn moved(&self, draw: &mut Draw) -> Self {
        let [_, _, width, height] = self.window;
        let mut place = |side: u32, window: u32| {
            draw.below(((side - window) / self.scale + 1) as usize) as u32 * self.scale
        };
        let window = [place(self.view.width, width), place(self.view.height, height), width, height];
        Self { window, ..*self }
    }

    /// Width of the whole view in pixels.
    pub const fn view_width(&self) -> u32 {
        self.view.width
    }

    /// The camera of the whole view.
    pub fn view(&self, view_from_world: DAffine3) -> Result<Camera, CameraError> {
        Camera::new(view_from_world, self.view)
    }

    /// The camera of what is rendered.
    pub fn camera(&self, view_from_world: DAffine3) -> Result<Camera, CameraError> {
        let [left, top, width, height] = self.rendered();
        let Intrinsics { cx, cy, .. } = self.view;
        let (cx, cy) = (cx - f64::from(left), cy - f64::from(top));
        Camera::new(view_from_world, Intrinsics { width, height, cx, cy, ..self.view })
    }

    /// The window on the LR grid of what is rendered, in `frames` frames.
    pub fn window(&self, frames: usize) -> ClipWindow {
        let [left, top, width, height] = self.window;
        let [first_column, first_row, ..] = self.rendered();
        let lr = |pixels: u32| (pixels / self.scale) as usize;
        let (column, row) = (lr(left - first_column), lr(top - first_row));
        ClipWindow { frames: 0..frames, rows: row..row + lr(height), columns: column..column + lr(width) }
    }

    /// Left, top, right and bottom of the window as shares of the view.
    pub fn shares(&self) -> [f64; 4] {
        let [left, top, width, height] = self.window;
        let share = |pixels: u32, side: u32| f64::from(pixels) / f64::from(side);
        let (view_width, view_height) = (self.view.width, self.view.height);
        [
            share(left, view_width),
            share(top, view_height),
            share(left + width, view_width),
            share(top + height, view_height),
        ]
    }

    /// The window with its margin: left, top, width and height.
    fn rendered(&self) -> [u32; 4] {
        let [left, top, width, height] = self.window;
        let margin = MARGIN.next_multiple_of(self.scale);
        let span = |start: u32, length: u32, side: u32| {
            let first = start.saturating_sub(margin);
            // Whole LR pixels, also where the scale does not divide the view.
            let end = (start + length + margin).min(side / self.scale * self.scale);
            (first, end - first)
        };
        let (left, width) = span(left, width, self.view.width);
        let (top, height) = span(top, height, self.view.height);
        [left, top, width, height]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn windows_see_what_their_view_sees_there() {
        let mut draw = Draw::new(3);
        for scale in [2, 3, 4] {
            let size = Size::new(96, 72);
            for _ in 0..200 {
                let framing = Framing::draw(&mut draw, size, scale).moved(&mut draw);
                let pose = DAffine3::IDENTITY;
                let (view, camera) = (framing.view(pose).unwrap(), framing.camera(pose).unwrap());
                let window = framing.window(5);
                assert_eq!(window.lr(), [72 / scale as usize, 96 / scale as usize]);
                assert_eq!((camera.width() % scale, camera.height() % scale), (0, 0));
                assert!(window.rows.end <= (camera.height() / scale) as usize);
                assert!(window.columns.end <= (camera.width() / scale) as usize);
                // A point at the window's corner.
                let [left, top, right, bottom] = framing.shares();
                assert!(left >= 0.0 && top >= 0.0 && right <= 1.0 && bottom <= 1.0);
                let corner = glam::DVec2::new(left * f64::from(view.width()), top * f64::from(view.height()));
                let (seen, _) = camera.project(view.unproject(corner, 2.0));
                let first = [window.columns.start, window.rows.start].map(|v| (v * scale as usize) as f64);
                assert!(seen.distance(first.into()) < 1e-6, "{seen} {first:?}");
                assert!(camera.project(DVec3::Z).1 > 0.0);
            }
        }
    }

    #[test]
    fn views_hold_large_windows() {
        let mut draw = Draw::new(1);
        for size in [Size::new(2560, 1440), Framing::LARGEST] {
            for _ in 0..50 {
                let framing = Framing::draw(&mut draw, size, 4).moved(&mut draw);
                let window = framing.window(1);
                assert_eq!(window.lr(), [size.height as usize / 4, size.width as usize / 4]);
            }
        }
    }
}
