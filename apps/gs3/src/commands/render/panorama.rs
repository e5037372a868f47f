//! Panoramas: frames put together from six faces of a cube.

use std::ops::Range;
use std::sync::Arc;

use gs3::scene::glam::{DAffine3, DMat3, DVec3};
use gs3::scene::{Camera, CameraPath, Image, Intrinsics, Scene, Size};
use gs3::{Networks, PipelineError, Session, StageTimes};
use indicatif::ProgressBar;

use super::args::RenderArgs;
use super::course::Course;
use super::parts::{claim, end, frames_missing, numbers_of, stream_of};
use crate::cli::backend;
use crate::cli::error::CliError;
use crate::cli::exit::Outcome;
use crate::cli::interrupt;
use crate::cli::terminal::note;
use crate::io::alpha::coverage;
use crate::io::inputs;
use crate::io::layers::Layers;
use crate::io::manifest::Manifest;
use crate::io::output::{FrameWriter, Target};
use crate::io::report;

/// Pixels of a face beyond its edges on each side, so that pixels between faces are interpolated within one.
const RIM: u32 = 2;

/// Renders the panoramas `range` of `path`, with alpha where it is asked for.
pub fn run(
    args: &RenderArgs,
    target: &Target,
    scene: &Arc<Scene>,
    path: &CameraPath,
    range: Range<usize>,
    networks: &Networks,
) -> Result<Outcome, CliError> {
    let unmade = [
        ("--compare", args.compare.is_some()),
        ("--json", args.json.is_some()),
        ("--aov", !args.aov.is_empty()),
    ];
    if let Some((option, _)) = unmade.into_iter().find(|(_, is_asked)| *is_asked) {
        return Err(CliError::Option {
            option,
            expected: "a path of perspective cameras".to_owned(),
            actual: "one of panoramas".to_owned(),
        });
    }
    let settings = args.frame_options.settings(args.mode.into());
    let features = args.frame_options.features();
    let first = backend::session(Arc::clone(scene), settings, networks, &args.device, features)?;
    let covering = match args.alpha {
        true => Some(coverage(scene)?),
        false => None,
    };
    let mut shown_faces = Faces::new(first, covering, args.warm_up)?;
    let each = settings.displayed_per_rendered();
    let stream = stream_of(path, &range, each);
    let session = &shown_faces.sessions[0];
    // The frames that are super-sampled are the faces.
    let scale_of = |camera: &Camera| {
        let face = face_camera(camera, 0).unwrap_or(*camera);
        session.pipeline().scale_of(&face)
    };
    let facts = Manifest::new(scene, path, &settings, networks, scale_of, session.machine(), args.alpha)?;
    let missing = frames_missing(args, target, &facts, &range, each)?;
    let mut writer = FrameWriter::new(target.clone(), &stream)?;
    claim(target, &facts, &numbers_of(&range, each))?;
    interrupt::watch()?;
    let bar = ProgressBar::new(missing.len() as u64)
        .with_style(inputs::style("{pos}/{len} rendered {wide_bar} {per_sec}, {eta} left"));
    let (mut done, mut is_blank, mut seconds, mut shown) = (0, true, 0.0, 0);
    let mut numbers: Option<Range<usize>> = None;
    while let Some(&k) = missing.get(done)
        && !interrupt::requested()
    {
        let Shown { mut frames, covered, is_alone } = shown_faces.render(path, k)?;
        seconds += shown_faces.times.iter().map(|times| times.total().as_secs_f64()).sum::<f64>();
        if matches!(target, Target::Single(_)) || is_alone {
            frames.drain(..frames.len().saturating_sub(1));
        }
        let last_number = k * each;
        for (i, image) in frames.iter().enumerate() {
            let number = last_number + i + 1 - frames.len();
            numbers = Some(numbers.map_or(number, |numbers| numbers.start)..number + 1);
            // The last of both is the rendered frame.
            let covered = (covered.len() + i).checked_sub(frames.len()).and_then(|i| covered.get(i));
            let layers = target.is_exr().then(|| Layers::of_frame(image, covered, args.aov_format));
            writer.write(number, image, covered, layers.as_ref())?;
        }
        shown += frames.len();
        is_blank &= shown_faces.is_blank();
        done += 1;
        bar.inc(1);
    }
    bar.finish_and_clear();
    let is_complete = done == missing.len();
    if is_blank && done > 0 {
        inputs::warn_of_nothing_visible(scene.details().near);
    }
    let written = writer.finish(is_complete)?;
    let numbers = numbers.unwrap_or_default();
    note(format_args!(
        "{shown} frames shown, {:.2} per second of rendering ({} in {})",
        report::per_second(shown, seconds),
        settings.mode.name(),
        args.out.display(),
    ));
    end(target, &range, missing.get(done).copied(), &numbers, &stream, written.no_video)
}

/// Renders the faces of panoramas, each with a session of its own, and puts them together.
struct Faces {
    /// Six sessions for the faces in colour. With coverage, six sessions for its faces follow.
    sessions: Vec<Session>,
    course: Course,
    /// Stage times of the six faces in colour of the last frame.
    times: Vec<StageTimes>,
}

/// The panoramas that a frame of a path gives to show, in order, those in between before it.
struct Shown {
    frames: Vec<Image>,
    /// The same of the coverage; empty without one.
    covered: Vec<Image>,
    /// Whether there is no frame before it.
    is_alone: bool,
}

impl Faces {
    /// Faces of the scene of `first`, which renders one of them, and of its `coverage`. At most `warm_up` frames are rendered
    /// and not shown before one.
    fn new(
        first: Session,
        coverage: Option<Arc<Scene>>,
        warm_up: Option<usize>,
    ) -> Result<Self, PipelineError> {
        let settings = first.settings();
        let beside =
            |scene: &Arc<Scene>| first.beside(Arc::clone(scene), settings.pipeline, &settings.networks);
        let others = (1..FACES.len()).map(|_| beside(first.scene()));
        let covering = coverage.iter().flat_map(|scene| FACES.iter().map(|_| beside(scene)));
        let others = others.chain(covering).collect::<Result<Vec<_>, _>>()?;
        let sessions = [first].into_iter().chain(others).collect();
        Ok(Self { sessions, course: Course::new(warm_up), times: Vec::new() })
    }

    /// The panoramas of frame `k` of `path`.
    fn render(&mut self, path: &CameraPath, k: usize) -> Result<Shown, PipelineError> {
        let Self { sessions, course, times } = self;
        let (of_faces, is_alone) = course.travel(sessions, k, |sessions, k| {
            times.clear();
            let mut of_faces = Vec::with_capacity(sessions.len());
            for (i, session) in sessions.iter_mut().enumerate() {
                let of_face = |camera: &Camera| face_camera(camera, i % FACES.len());
                // A face of a valid camera is one.
                let Some(camera) = of_face(&path.cameras()[k]) else { return Ok(Vec::new()) };
                let poses = session.settings().pipeline.poses_between(path, k);
                let poses: Vec<Camera> = poses.iter().filter_map(of_face).collect();
                let shown = session.render_with_poses(&camera, &poses)?;
                of_faces.push(shown.iter().cloned().collect::<Vec<_>>());
                if i < FACES.len() {
                    times.push(session.pipeline().times());
                }
            }
            Ok(of_faces)
        })?;
        let size = path.cameras()[k].size();
        let panoramas = |faces: &[Vec<Image>]| {
            let count = faces.iter().map(Vec::len).min().unwrap_or(0);
            let frame = |i: usize| panorama(size, &faces.iter().map(|frames| &frames[i]).collect::<Vec<_>>());
            (0..count).map(frame).collect::<Vec<_>>()
        };
        let (color, coverage) = of_faces.split_at(FACES.len().min(of_faces.len()));
        Ok(Shown { frames: panoramas(color), covered: panoramas(coverage), is_alone })
    }

    /// Whether the last frame showed no Gaussian, where that is known.
    fn is_blank(&self) -> bool {
        self.sessions.iter().all(|session| session.pipeline().visible_count() == Some(0))
    }
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
fn panorama(size: Size, faces: &[&Image]) -> Image {
    let Size { width, height } = size;
    let direction = |x: u32, y: u32| {
        let turn = (f64::from(x) + 0.5) / f64::from(width) * std::f64::consts::TAU - std::f64::consts::PI;
        let fall = (f64::from(y) + 0.5) / f64::from(height) * std::f64::consts::PI;
        DVec3::new(turn.sin() * fall.sin(), -fall.cos(), turn.cos() * fall.sin())
    };
    let inner = f64::from(side(width));
    let pixel = |(x, y): (u32, u32)| {
        let d = direction(x, y);
        // The face with the nearest axis.
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

#[cfg(test)]
mod tests {
    use gs3::scene::glam::DVec2;

    use super::*;

    /// Faces coloured by direction make a panorama coloured by direction.
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
        let image = panorama(Size::new(width, height), &faces.iter().collect::<Vec<_>>());
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
