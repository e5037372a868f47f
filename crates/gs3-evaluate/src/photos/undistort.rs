//! Photos taken through a lens, as a pinhole of the same focal length would have taken them.

use glam::DVec2;
use gs3_scene::{Camera, CameraError, Image, Intrinsics, Lens};

/// Where the pixels of an undistorted image lie in its photo.
#[derive(Clone, Debug)]
pub(super) struct Undistortion {
    /// Intrinsics of the photo, before undistortion.
    intrinsics: Intrinsics,
    lens: Lens,
    /// The part of the undistorted image that the photo shows: left, top, width, height.
    part: [u32; 4],
}

/// Pixels along each side of a part that are looked at to see whether the photo shows the side.
const LOOKS: u32 = 64;

/// Places are rounded by less than this, pixels.
const ROUNDING: f64 = 1e-6;

impl Undistortion {
    /// The undistortion of a photo with the size and intrinsics of `camera`; `None` if the photo shows not even the middle
    /// of the undistorted image.
    pub(super) fn new(camera: &Camera, lens: &Lens) -> Option<Self> {
        let intrinsics = camera.intrinsics();
        let whole = Self { intrinsics, lens: *lens, part: [0, 0, intrinsics.width, intrinsics.height] };
        // The largest part in the middle with a rim that is shown, by bisection of its share of both sides.
        let part = |share: f64| {
            let side = |side: u32| {
                let kept = ((f64::from(side) * share) as u32).max(1);
                ((side - kept) / 2, kept)
            };
            let ((left, width), (top, height)) = (side(intrinsics.width), side(intrinsics.height));
            [left, top, width, height]
        };
        if whole.shows(part(1.0)) {
            return Some(whole);
        }
        let (mut shown, mut not_shown) = (0.0, 1.0);
        for _ in 0..20 {
            let middle = 0.5 * (shown + not_shown);
            if whole.shows(part(middle)) { shown = middle } else { not_shown = middle }
        }
        whole.shows(part(shown)).then(|| Self { part: part(shown), ..whole })
    }

    /// The camera of the undistorted image.
    pub(super) fn camera(&self, camera: &Camera) -> Result<Camera, CameraError> {
        let [left, top, width, height] = self.part;
        let old = self.intrinsics;
        let (cx, cy) = (old.cx - f64::from(left), old.cy - f64::from(top));
        Camera::new(camera.view_from_world(), Intrinsics { width, height, cx, cy, ..old })
    }

    /// The place in the photo, pixels, of `pixel` of the undistorted image.
    fn place(&self, pixel: DVec2) -> DVec2 {
        let Intrinsics { fx, fy, cx, cy, .. } = self.intrinsics;
        let shown = self.lens.distort(DVec2::new((pixel.x - cx) / fx, (pixel.y - cy) / fy));
        DVec2::new(shown.x * fx + cx, shown.y * fy + cy)
    }

    /// Whether the rim of `part` is in the photo.
    fn shows(&self, [left, top, width, height]: [u32; 4]) -> bool {
        let size = DVec2::new(self.intrinsics.width.into(), self.intrinsics.height.into());
        (0..=LOOKS).all(|k| {
            let at = |from: u32, side: u32| {
                // Centres of the first and the last pixel.
                f64::from(from) + 0.5 + (f64::from(side) - 1.0) * f64::from(k) / f64::from(LOOKS)
            };
            let (x, y) = (at(left, width), at(top, height));
            let ends = |from: u32, side: u32| [f64::from(from) + 0.5, f64::from(from + side) - 0.5];
            let rims = ends(top, height).map(|y| (x, y)).into_iter().chain(ends(left, width).map(|x| (x, y)));
            rims.into_iter().all(|(x, y)| {
                let place = self.place(DVec2::new(x, y));
                // Between centres of the photo's pixels, so that there are values to interpolate.
                let first = 0.5 - ROUNDING;
                place.is_finite() && place.min_element() >= first && place.cmple(size - first).all()
            })
        })
    }

    /// The undistorted image of `photo`, by linear interpolation.
    pub(super) fn apply(&self, photo: &Image) -> Image {
        let [left, top, width, height] = self.part;
        let (columns, rows) = (photo.width(), photo.height());
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| {
            let place = self.place(DVec2::new(f64::from(left + x) + 0.5, f64::from(top + y) + 0.5)) - 0.5;
            let corner = place.floor();
            let [u, v] = (place - corner).as_vec2().to_array();
            let pixel = |dx: f64, dy: f64| {
                let clamped = |value: f64, side: usize| (value.max(0.0) as usize).min(side - 1);
                photo.row(clamped(corner.y + dy, rows))[clamped(corner.x + dx, columns)]
            };
            let [a, b, c, d] = [pixel(0.0, 0.0), pixel(1.0, 0.0), pixel(0.0, 1.0), pixel(1.0, 1.0)];
            std::array::from_fn(|k| {
                (a[k] * (1.0 - u) + b[k] * u) * (1.0 - v) + (c[k] * (1.0 - u) + d[k] * u) * v
            })
        });
        Image::from_pixels(width as usize, height as usize, pixels.collect()).unwrap_or_default()
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use glam::DAffine3;

    use super::*;

    fn camera() -> Camera {
        let intrinsics = Intrinsics { width: 96, height: 64, fx: 80.0, fy: 80.0, cx: 48.0, cy: 32.0 };
        Camera::new(DAffine3::IDENTITY, intrinsics).unwrap()
    }

    /// A photo of a scene with the ray's slope as its colour becomes the image of a pinhole camera.
    #[test]
    fn photos_become_what_a_pinhole_sees() {
        let camera = camera();
        for lens in [Lens::brown(-0.2, 0.05, 0.01, -0.01, 0.0), Lens::brown(0.1, 0.0, 0.0, 0.0, 0.0)] {
            let undistortion = Undistortion::new(&camera, &lens).unwrap();
            // Each pixel of the photo shows the ray that the lens brings there, found by iteration.
            let ray = |pixel: DVec2| {
                let shown = DVec2::new((pixel.x - 48.0) / 80.0, (pixel.y - 32.0) / 80.0);
                (0..50).fold(shown, |ray, _| ray + shown - lens.distort(ray))
            };
            let pixel = |k: usize| {
                let slope = ray(DVec2::new((k % 96) as f64 + 0.5, (k / 96) as f64 + 0.5));
                [slope.x as f32, slope.y as f32, 0.0, 1.0]
            };
            let photo = Image::from_pixels(96, 64, (0..96 * 64).map(pixel).collect()).unwrap();
            let image = undistortion.apply(&photo);
            let seen = undistortion.camera(&camera).unwrap().intrinsics();
            assert_eq!((image.width(), image.height()), (seen.width as usize, seen.height as usize));
            assert!(seen.width > 60 && seen.height > 40, "{seen:?}");
            for (y, x) in [(0, 0), (0, image.width() - 1), (image.height() / 2, 7)] {
                let [r, g, ..] = image.row(y)[x];
                let expected = [(x as f64 + 0.5 - seen.cx) / 80.0, (y as f64 + 0.5 - seen.cy) / 80.0];
                let off = (f64::from(r) - expected[0]).abs().max((f64::from(g) - expected[1]).abs());
                // A tenth of a pixel: slopes are interpolated linearly between pixels.
                assert!(off < 0.1 / 80.0, "{lens:?} at {x}, {y}: {r} {g} is not {expected:?}");
            }
        }
    }
}
