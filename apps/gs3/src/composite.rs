//! Frames put together from several: pictures with alpha, of two over black and over white, and panoramas, of six faces
//! of a cube.

use std::sync::Arc;

use gs3::scene::glam::{DAffine3, DMat3, DVec3};
use gs3::scene::{Camera, CameraPath, Image, Intrinsics, Scene};
use gs3::{FramePipeline, Networks, PipelineError, PipelineSettings, StageTimes};

use crate::error::CliError;

/// Pixels of a face beyond its edges on each side, so that pixels between faces are interpolated within one.
const RIM: u32 = 2;

/// What a frame is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parts {
    /// Straight alpha in the fourth channel, nothing behind the scene.
    pub has_alpha: bool,
    /// A whole panorama, equirectangular.
    pub is_panorama: bool,
}

/// Renders the parts of frames, each with a pipeline of its own, and puts them together.
pub struct Composite {
    parts: Parts,
    /// `[backgrounds][faces]`.
    pipelines: Vec<Vec<FramePipeline>>,
    times: Vec<StageTimes>,
}

impl Composite {
    /// Pipelines for `scene`, which `start` prepares each.
    pub fn new(
        scene: &Arc<Scene>,
        parts: Parts,
        settings: &PipelineSettings,
        networks: &Networks,
        start: impl Fn(&mut FramePipeline) -> Result<(), CliError>,
    ) -> Result<Self, CliError> {
        let backgrounds = if parts.has_alpha { vec![[0.0; 3], [1.0; 3]] } else { vec![settings.background] };
        let faces = if parts.is_panorama { FACES.len() } else { 1 };
        let pipeline = |background| {
            let settings = PipelineSettings { background, ..*settings };
            let mut pipeline = FramePipeline::with_networks(Arc::clone(scene), settings, networks)?;
            start(&mut pipeline)?;
            Ok(pipeline)
        };
        let of_background = |background| (0..faces).map(|_| pipeline(background)).collect();
        let pipelines = backgrounds.into_iter().map(of_background).collect::<Result<Vec<_>, CliError>>()?;
        Ok(Self { parts, pipelines, times: Vec::new() })
    }

    /// The frames that frame `camera` of a path gives to show, in order, those at `between` before it.
    pub fn render(&mut self, camera: &Camera, between: &[Camera]) -> Result<Vec<Image>, PipelineError> {
        self.times.clear();
        let size = [camera.width(), camera.height()];
        let mut over: Vec<Vec<Image>> = Vec::with_capacity(self.pipelines.len());
        for faces in &mut self.pipelines {
            let mut shown: Vec<Vec<Image>> = Vec::with_capacity(faces.len());
            for (face, pipeline) in faces.iter_mut().enumerate() {
                let part = |camera: &Camera| match self.parts.is_panorama {
                    true => face_camera(camera, face),
                    false => Some(*camera),
                };
                // A face of a valid camera is one.
                let Some(of_face) = part(camera) else { return Ok(Vec::new()) };
                let between: Vec<Camera> = between.iter().filter_map(part).collect();
                shown.push(pipeline.render(&of_face, &between)?.iter().cloned().collect());
                self.times.push(pipeline.times());
            }
            let count = shown.iter().map(Vec::len).min().unwrap_or(0);
            let frame = |k: usize| match self.parts.is_panorama {
                true => panorama(size, &shown.iter().map(|frames| &frames[k]).collect::<Vec<_>>()),
                false => shown[0][k].clone(),
            };
            over.push((0..count).map(frame).collect());
        }
        Ok(match &over[..] {
            [black, white] => {
                black.iter().zip(white).map(|(black, white)| with_alpha(black, white)).collect()
            }
            _ => over.pop().unwrap_or_default(),
        })
    }

    /// Times of the parts of the last frame.
    pub fn times(&self) -> &[StageTimes] {
        &self.times
    }

    /// Whether the last frame showed no Gaussian, where that is known.
    pub fn is_blank(&self) -> bool {
        self.pipelines.iter().flatten().all(|pipeline| pipeline.visible_count() == Some(0))
    }

    /// Frames that a history reaches back.
    pub fn period(&self) -> usize {
        self.pipelines.iter().flatten().map(FramePipeline::jitter_period).max().unwrap_or(1)
    }
}

/// The picture in front of nothing, from what it is over black and over white: what shows of the white is not covered.
/// Colours are straight, not multiplied by alpha; black where nothing is covered.
fn with_alpha(black: &Image, white: &Image) -> Image {
    let pixel = |(b, w): (&[f32; 4], &[f32; 4])| {
        let shown = (0..3).map(|c| w[c] - b[c]).sum::<f32>() / 3.0;
        let alpha = (1.0 - shown).clamp(0.0, 1.0);
        // Below half a step of 8 bits, colours are noise divided by noise.
        let [r, g, b] =
            [0, 1, 2].map(|c| if alpha > 0.5 / 255.0 { (b[c] / alpha).clamp(0.0, 1.0) } else { 0.0 });
        [r, g, b, alpha]
    };
    let pixels = black.pixels().iter().zip(white.pixels()).map(pixel).collect();
    Image::from_pixels(black.width(), black.height(), pixels).unwrap_or_default()
}

/// Where the faces' cameras look, and what is right of them, in the axes of the panorama's camera (right, down,
/// forward).
const FACES: [[DVec3; 2]; 6] = [
    [DVec3::Z, DVec3::X],
    [DVec3::X, DVec3::NEG_Z],
    [DVec3::NEG_Z, DVec3::NEG_X],
    [DVec3::NEG_X, DVec3::Z],
    [DVec3::Y, DVec3::X],
    [DVec3::NEG_Y, DVec3::X],
];

/// Pixels of a face's side: a quarter turn of the panorama.
fn side(width: u32) -> u32 {
    width.div_ceil(4).max(1)
}

/// The camera of `face` of the panorama at `camera`.
fn face_camera(camera: &Camera, face: usize) -> Option<Camera> {
    let [forward, right] = FACES[face];
    let panorama_from_face = DMat3::from_cols(right, forward.cross(right), forward);
    let pose = camera.view_from_world();
    let turned = DAffine3 {
        matrix3: panorama_from_face.transpose() * pose.matrix3,
        translation: panorama_from_face.transpose() * pose.translation,
    };
    let inner = side(camera.width());
    let size = inner + 2 * RIM;
    let (focal, center) = (0.5 * f64::from(inner), 0.5 * f64::from(size));
    let intrinsics = Intrinsics { width: size, height: size, fx: focal, fy: focal, cx: center, cy: center };
    Camera::new(turned, intrinsics).ok()
}

/// The equirectangular panorama of `size` pixels: columns turn from behind over the left, the front (in the middle) and
/// the right to behind again, rows from straight up to straight down.
fn panorama([width, height]: [u32; 2], faces: &[&Image]) -> Image {
    let direction = |x: u32, y: u32| {
        let turn = (f64::from(x) + 0.5) / f64::from(width) * std::f64::consts::TAU - std::f64::consts::PI;
        let fall = (f64::from(y) + 0.5) / f64::from(height) * std::f64::consts::PI;
        DVec3::new(turn.sin() * fall.sin(), -fall.cos(), turn.cos() * fall.sin())
    };
    let inner = f64::from(side(width));
    let pixel = |(x, y): (u32, u32)| {
        let d = direction(x, y);
        // The face whose axis is nearest.
        let along = |face: &usize| FACES[*face][0].dot(d);
        let face = (0..FACES.len()).max_by(|a, b| along(a).total_cmp(&along(b))).unwrap_or(0);
        let [forward, right] = FACES[face];
        let depth = forward.dot(d);
        let place = |axis: DVec3| 0.5 * inner * axis.dot(d) / depth + 0.5 * inner + f64::from(RIM) - 0.5;
        sample(faces[face], place(right), place(forward.cross(right)))
    };
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(pixel).collect();
    Image::from_pixels(width as usize, height as usize, pixels).unwrap_or_default()
}

/// The image at `(x, y)`, pixel centres at whole numbers, by linear interpolation.
fn sample(image: &Image, x: f64, y: f64) -> [f32; 4] {
    let (left, top) = (x.floor(), y.floor());
    let (u, v) = ((x - left) as f32, (y - top) as f32);
    let pixel = |dx: f64, dy: f64| {
        let clamped = |value: f64, side: usize| (value.max(0.0) as usize).min(side.saturating_sub(1));
        image.row(clamped(top + dy, image.height()))[clamped(left + dx, image.width())]
    };
    let [a, b, c, d] = [pixel(0.0, 0.0), pixel(1.0, 0.0), pixel(0.0, 1.0), pixel(1.0, 1.0)];
    std::array::from_fn(|k| (a[k] * (1.0 - u) + b[k] * u) * (1.0 - v) + (c[k] * (1.0 - u) + d[k] * u) * v)
}

/// The parts that frames along `path` are put together from; none of frames of one camera.
pub fn parts_of(path: &CameraPath, has_alpha: bool) -> Option<Parts> {
    let is_panorama = path.facts().is_panorama;
    (has_alpha || is_panorama).then_some(Parts { has_alpha, is_panorama })
}

#[cfg(test)]
mod tests {
    use gs3::scene::glam::DVec2;

    use super::*;

    #[test]
    fn alpha_and_straight_colours_come_from_black_and_white() {
        let over = |background: f32| {
            let pixel = |alpha: f32, color: [f32; 3]| {
                let [r, g, b] = color.map(|c| c * alpha + background * (1.0 - alpha));
                [r, g, b, 1.0]
            };
            let pixels =
                vec![pixel(0.25, [1.0, 0.5, 0.0]), pixel(0.0, [0.3; 3]), pixel(1.0, [0.0, 0.2, 1.0])];
            Image::from_pixels(3, 1, pixels).unwrap()
        };
        let image = with_alpha(&over(0.0), &over(1.0));
        let expected = [[1.0, 0.5, 0.0, 0.25], [0.0; 4], [0.0, 0.2, 1.0, 1.0]];
        for (pixel, expected) in image.pixels().iter().zip(expected) {
            assert!(pixel.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{pixel:?}");
        }
    }

    /// Faces whose colour is the direction make a panorama whose colour is the direction.
    #[test]
    fn faces_meet_in_a_panorama() {
        let (width, height) = (256, 128);
        let intrinsics = Intrinsics::from_fov_y(width, height, 1.0);
        let camera = Camera::new(DAffine3::IDENTITY, intrinsics).unwrap();
        let faces: Vec<Image> = (0..6)
            .map(|face| {
                let camera = face_camera(&camera, face).unwrap();
                let pixel = |k: u32| {
                    let (x, y) = (k % camera.width(), k / camera.width());
                    let pixel = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
                    let d = camera.unproject(pixel, 1.0).normalize();
                    [d.x as f32, d.y as f32, d.z as f32, 1.0]
                };
                let count = camera.width() * camera.height();
                let side = camera.width() as usize;
                Image::from_pixels(side, side, (0..count).map(pixel).collect()).unwrap()
            })
            .collect();
        let image = panorama([width, height], &faces.iter().collect::<Vec<_>>());
        // The front is in the middle, the right a quarter turn on, up in the first row.
        for ((x, y), expected) in [
            ((128, 64), [0.0, 0.0, 1.0]),
            ((192, 64), [1.0, 0.0, 0.0]),
            ((64, 64), [-1.0, 0.0, 0.0]),
            ((7, 0), [0.0, -1.0, 0.0]),
        ] {
            let pixel = image.row(y)[x];
            assert!((0..3).all(|c| (pixel[c] - expected[c]).abs() < 0.03), "{x}, {y}: {pixel:?}");
        }
        // Directions are of length 1 everywhere, also where faces meet.
        for pixel in image.pixels() {
            let length = pixel[..3].iter().map(|v| v * v).sum::<f32>().sqrt();
            assert!((length - 1.0).abs() < 1e-3, "{pixel:?}");
        }
    }
}
