//! Camera paths: keyframes, the smooth curve through them, and poses at any time.

use glam::{DAffine3, DMat3, DQuat, DVec3};

use crate::camera::{Camera, Intrinsics};
use crate::lens::Lens;
use crate::transform::Similarity;

/// Samples per segment when arc length is measured. Empirical: steps of equal length come out equal within 1 % even
/// where neighbouring segments differ thirtyfold.
const SAMPLES_PER_SEGMENT: usize = 32;

/// What a path travels, of its distance from the origin, or turns, in radians, at most while it rests: rounding of a
/// million poses stays far below.
const ROUNDING: f64 = 1e-9;

/// Cameras in order, one per frame, and the frame rate.
///
/// Time is counted in frames: camera `k` is at time `k`. Between cameras lies a centripetal Catmull–Rom spline through
/// the camera centres and the slerp of the rotations.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraPath {
    cameras: Vec<Camera>,
    names: Vec<String>,
    frames_per_second: f64,
    is_cycle: bool,
    facts: PathFacts,
}

/// What a file says of its cameras beside their poses and intrinsics.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PathFacts {
    /// The lenses of the photos, one per camera where there are any; none of a pinhole. The cameras themselves are
    /// pinholes of the same focal length.
    pub lenses: Vec<Option<Lens>>,
    /// Whether the frames are whole panoramas, equirectangular; then the cameras' poses and sizes count alone.
    pub is_panorama: bool,
    /// Whether the horizontal field of view is all that is known of the cameras, their size assumed: at other sizes they
    /// keep that one.
    pub keeps_width: bool,
    /// What the reader found and did not use, or assumed, and could change the picture: sentences of one line.
    pub notes: Vec<String>,
}

/// Why cameras do not make a path.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CameraPathError {
    /// There is no camera.
    #[error("cameras: expected at least 1, found 0")]
    Empty,
    /// The frame rate is not usable.
    #[error("frames per second: expected a positive finite number, found {actual}")]
    FramesPerSecond {
        /// The rate found.
        actual: f64,
    },
}

/// How the frames of a smoothed path are spread over it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// Equal time between any two keyframes, however far apart they are.
    Keyframes,
    /// Equal distance between frames. Where the camera turns more than it travels, frames are as many as if its turn
    /// were travelled at the path's radius: its length over its turning and one radian. Where it only turns, all angles
    /// are equal. A path that rests keeps the pace of its keyframes.
    Speed,
}

/// Rendered frames per second of generated paths. With two in-between frames each, 60 frames per second are displayed.
const GENERATED_RATE: f64 = 20.0;

impl CameraPath {
    /// A path through `cameras`, shown at `frames_per_second`. In a cycle the first camera follows the last.
    ///
    /// # Errors
    /// [`CameraPathError`] if there is no camera or the rate is not positive.
    pub fn new(
        cameras: Vec<Camera>,
        frames_per_second: f64,
        is_cycle: bool,
    ) -> Result<Self, CameraPathError> {
        if cameras.is_empty() {
            return Err(CameraPathError::Empty);
        }
        if !(frames_per_second.is_finite() && frames_per_second > 0.0) {
            return Err(CameraPathError::FramesPerSecond { actual: frames_per_second });
        }
        Ok(Self { cameras, names: Vec::new(), frames_per_second, is_cycle, facts: PathFacts::default() })
    }

    /// A closed path through generated cameras; there is at least one.
    pub(crate) fn cycle(cameras: Vec<Camera>) -> Self {
        Self {
            cameras,
            names: Vec::new(),
            frames_per_second: GENERATED_RATE,
            is_cycle: true,
            facts: PathFacts::default(),
        }
    }

    /// The same path with the names of the photos taken by its cameras, one per camera; missing ones stay empty.
    #[must_use]
    pub fn with_names(mut self, mut names: Vec<String>) -> Self {
        names.resize(self.cameras.len(), String::new());
        self.names = names;
        self
    }

    /// The same path with what its file says beside.
    #[must_use]
    pub fn with_facts(self, facts: PathFacts) -> Self {
        Self { facts, ..self }
    }

    /// What the path's file says beside its cameras.
    #[must_use]
    pub const fn facts(&self) -> &PathFacts {
        &self.facts
    }

    /// The lens of the photo taken by camera `index`, where it is no pinhole.
    #[must_use]
    pub fn lens(&self, index: usize) -> Option<&Lens> {
        self.facts.lenses.get(index).and_then(Option::as_ref)
    }

    /// The path in a world that has been moved, turned and scaled ([`Camera::in_moved_world`]).
    ///
    /// # Errors
    /// [`crate::CameraError`] if a pose becomes none.
    pub fn in_moved_world(&self, by: &Similarity) -> Result<Self, crate::CameraError> {
        let cameras = self.cameras.iter().map(|c| c.in_moved_world(by)).collect::<Result<_, _>>()?;
        Ok(Self { cameras, ..self.clone() })
    }

    /// The cameras, at least one.
    #[must_use]
    pub fn cameras(&self) -> &[Camera] {
        &self.cameras
    }

    /// The name of the photo taken by camera `index`, where the source names one.
    #[must_use]
    pub fn name(&self, index: usize) -> Option<&str> {
        self.names.get(index).map(String::as_str).filter(|name| !name.is_empty())
    }

    /// Frames per second at which the path is meant to be shown, positive.
    #[must_use]
    pub const fn frames_per_second(&self) -> f64 {
        self.frames_per_second
    }

    /// Whether the first camera follows the last.
    #[must_use]
    pub const fn is_cycle(&self) -> bool {
        self.is_cycle
    }

    /// The camera at `time` in frames. Whole times give the keyframes unchanged. Times outside the path wrap around
    /// in a cycle, and are clamped to its ends otherwise. The image size is the size of the keyframe before `time`.
    #[must_use]
    pub fn at(&self, time: f64) -> Camera {
        let count = self.cameras.len() as f64;
        let time = if !time.is_finite() {
            0.0
        } else if self.is_cycle {
            time.rem_euclid(count)
        } else {
            time.clamp(0.0, count - 1.0)
        };
        let index = time.floor();
        let t = time - index;
        // `rem_euclid` may round up to `count` itself; `keyframe` wraps.
        let from = self.keyframe(index as isize);
        if t == 0.0 {
            return from;
        }
        let points = [-1, 0, 1, 2].map(|k| self.keyframe(index as isize + k).position());
        let to = self.keyframe(index as isize + 1);
        with_center(&pose_between(&from, &to, t), centripetal_catmull_rom(points, t))
    }

    /// The smooth path through these keyframes, `frames` (at least 1) long. An open path keeps both its ends.
    #[must_use]
    pub fn smoothed(&self, frames: usize, pace: Pace) -> Self {
        let frames = frames.max(1);
        let steps = if self.is_cycle { frames } else { (frames - 1).max(1) };
        let times = match pace {
            Pace::Keyframes => None,
            Pace::Speed => self.times_by_length(),
        };
        let segments = self.segments() as f64;
        let camera = |frame: usize| {
            let share = frame as f64 / steps as f64;
            self.at(times.as_ref().map_or(share * segments, |table| table.time_at(share)))
        };
        Self {
            cameras: (0..frames).map(camera).collect(),
            names: Vec::new(),
            frames_per_second: self.frames_per_second,
            is_cycle: self.is_cycle,
            facts: PathFacts { lenses: Vec::new(), ..self.facts.clone() },
        }
    }

    /// The same path with this vertical field of view, radians, and square pixels; principal points stay.
    ///
    /// # Errors
    /// [`crate::CameraError::Intrinsic`] if that is no angle between 0 and π.
    pub fn with_fov_y(&self, fov_y: f64) -> Result<Self, crate::CameraError> {
        let with_fov = |camera: &Camera| {
            let old = camera.intrinsics();
            let focal = Intrinsics::from_fov_y(old.width, old.height, fov_y).fy;
            Camera::new(camera.view_from_world(), Intrinsics { fx: focal, fy: focal, ..old })
        };
        let cameras = self.cameras.iter().map(with_fov).collect::<Result<_, _>>()?;
        Ok(Self { cameras, ..self.clone() })
    }

    /// All cameras at another image size ([`Camera::resized`], or [`Camera::resized_by_width`] where
    /// [`PathFacts::keeps_width`]).
    ///
    /// # Errors
    /// [`crate::CameraError::Size`] if the size is zero or too large.
    pub fn resized(&self, width: u32, height: u32) -> Result<Self, crate::CameraError> {
        let resized = |camera: &Camera| match self.facts.keeps_width {
            true => camera.resized_by_width(width, height),
            false => camera.resized(width, height),
        };
        let cameras = self.cameras.iter().map(resized).collect::<Result<_, _>>()?;
        Ok(Self { cameras, ..self.clone() })
    }

    const fn segments(&self) -> usize {
        if self.is_cycle { self.cameras.len() } else { self.cameras.len() - 1 }
    }

    /// Keyframe `index`, wrapped in a cycle, held at the ends otherwise.
    fn keyframe(&self, index: isize) -> Camera {
        let count = self.cameras.len() as isize;
        let index = if self.is_cycle { index.rem_euclid(count) } else { index.clamp(0, count - 1) };
        self.cameras[index as usize]
    }

    /// The table from length to time; none where the camera rests.
    ///
    /// A step is as long as the camera travels in it, or turns at the path's radius if that is more. Around an object
    /// the path's length over its turning is the distance to the object, at which a turn moves the picture as far as a
    /// step of the same length does: there, equal distances stay equal. The radian that is added to the turning keeps a
    /// path that hardly turns from spending its time on that: no radius is longer than the path.
    fn times_by_length(&self) -> Option<LengthTable> {
        let samples = self.segments() * SAMPLES_PER_SEGMENT;
        let pose = |i: usize| self.at(i as f64 / SAMPLES_PER_SEGMENT as f64).world_from_view();
        let poses: Vec<DAffine3> = (0..=samples).map(pose).collect();
        let step = |pair: &[DAffine3]| {
            (
                pair[0].translation.distance(pair[1].translation),
                angle_between(pair[0].matrix3, pair[1].matrix3),
            )
        };
        let steps: Vec<(f64, f64)> = poses.windows(2).map(step).collect();
        let (travelled, turned) = steps.iter().fold((0.0, 0.0), |(d, a), step| (d + step.0, a + step.1));
        let farthest = poses.iter().map(|pose| pose.translation.length()).fold(0.0, f64::max);
        let is_moving = travelled > ROUNDING * farthest;
        if !is_moving && turned <= ROUNDING {
            return None;
        }
        let radius = if is_moving { travelled / (turned + 1.0) } else { 1.0 };
        let mut lengths = vec![0.0];
        let mut length = 0.0;
        for (distance, angle) in steps {
            length += distance.max(angle * radius);
            lengths.push(length);
        }
        Some(LengthTable { lengths })
    }
}

/// The angle of the rotation from one pose to another, radians, exact for small ones too.
fn angle_between(a: DMat3, b: DMat3) -> f64 {
    let turn = DQuat::from_mat3(&(a.transpose() * b));
    2.0 * turn.xyz().length().atan2(turn.w.abs())
}

/// Length after each sample of the path.
struct LengthTable {
    lengths: Vec<f64>,
}

impl LengthTable {
    /// The time at which `share` of the whole length lies behind.
    fn time_at(&self, share: f64) -> f64 {
        let last = self.lengths.len() - 1;
        let length = share * self.lengths[last];
        let i = self.lengths.partition_point(|l| *l <= length).clamp(1, last);
        let (from, to) = (self.lengths[i - 1], self.lengths[i]);
        let within = if to > from { ((length - from) / (to - from)).clamp(0.0, 1.0) } else { 0.0 };
        ((i - 1) as f64 + within) / SAMPLES_PER_SEGMENT as f64
    }
}

/// The camera at `t` of the way from `from` (0) to `to` (1): slerp of the rotations, linear centres and intrinsics, the
/// image size of `from`. At `t = 0.5` it is the true middle pose of a camera that moves and turns evenly.
#[must_use]
pub fn pose_between(from: &Camera, to: &Camera, t: f64) -> Camera {
    let rotation = |camera: &Camera| DQuat::from_mat3(&camera.world_from_view().matrix3);
    let world_from_view = DMat3::from_quat(rotation(from).slerp(rotation(to), t).normalize());
    let (a, b) = (from.intrinsics(), to.intrinsics());
    let mix = |a: f64, b: f64| a + (b - a) * t;
    let intrinsics = Intrinsics {
        fx: mix(a.fx, b.fx),
        fy: mix(a.fy, b.fy),
        cx: mix(a.cx, b.cx),
        cy: mix(a.cy, b.cy),
        ..a
    };
    let center = from.position().lerp(to.position(), t);
    // Only extrapolation (t outside [0, 1]) can leave the valid range; then the nearer camera stands.
    camera_at(world_from_view, center, intrinsics).unwrap_or(if t < 0.5 { *from } else { *to })
}

fn with_center(camera: &Camera, center: DVec3) -> Camera {
    // The spline of finite centres is finite, short of overflow; then the linear centre stands.
    camera_at(camera.world_from_view().matrix3, center, camera.intrinsics()).unwrap_or(*camera)
}

fn camera_at(world_from_view: DMat3, center: DVec3, intrinsics: Intrinsics) -> Option<Camera> {
    let rotation = world_from_view.transpose();
    let pose = DAffine3 { matrix3: rotation, translation: -(rotation * center) };
    Camera::new(pose, intrinsics).ok()
}

/// The point at `t` in `[0, 1]` between `p[1]` and `p[2]` on the centripetal Catmull–Rom spline (Barry and Goldman's
/// pyramid; knots √distance apart, so the curve neither loops nor overshoots at uneven keyframes).
fn centripetal_catmull_rom(p: [DVec3; 4], t: f64) -> DVec3 {
    let [mut p0, p1, p2, mut p3] = p;
    if p1.distance(p2) == 0.0 {
        return p1;
    }
    // Beyond an end, or where the camera rested, the curve goes on as it came.
    if p0 == p1 {
        p0 = p1 - (p2 - p1);
    }
    if p3 == p2 {
        p3 = p2 + (p2 - p1);
    }
    let knot = |a: DVec3, b: DVec3| a.distance(b).sqrt();
    let t0 = 0.0;
    let t1 = t0 + knot(p0, p1);
    let t2 = t1 + knot(p1, p2);
    let t3 = t2 + knot(p2, p3);
    let t = t1 + t * (t2 - t1);
    let blend =
        |a: DVec3, ta: f64, b: DVec3, tb: f64| a * ((tb - t) / (tb - ta)) + b * ((t - ta) / (tb - ta));
    let (a, b, c) = (blend(p0, t0, p1, t1), blend(p1, t1, p2, t2), blend(p2, t2, p3, t3));
    blend(blend(a, t0, b, t2), t1, blend(b, t1, c, t3), t2)
}

#[cfg(test)]
mod tests;
