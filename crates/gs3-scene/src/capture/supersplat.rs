//! Settings of the SuperSplat viewer, versions 1 and 2: a camera, and animations as keyframes of eye, target and field
//! of view. Axes are right-up-back, to which scenes are turned by half a turn about z.

mod write;

use glam::DVec3;

pub use write::{SuperSplatSettings, supersplat_settings};

use super::context::Context;
use super::{CaptureFault, Captured, Field};
use crate::camera::Intrinsics;
use crate::camera_path::{CameraPath, PathFacts};
use crate::orbit::look_at;
use crate::size::Size;

/// The image size of settings, which state none.
const DEFAULT_SIZE: Size = Size::new(1920, 1080);

/// Frames that an animation may have: an hour at 120 frames per second.
const MOST_FRAMES: f64 = 432_000.0;

/// Eye, target and field of view in degrees.
type Key = [f64; 7];

pub(super) fn parse(root: &Field, context: &Context<'_>) -> Result<Captured, CaptureFault> {
    if let Some(version) = root.get("version").filter(|v| v.number().is_ok_and(|v| v != 2.0)) {
        return Err(version.wrong("version 2, or none"));
    }
    let size = context.options.size.unwrap_or(DEFAULT_SIZE);
    if context.options.size.is_none() {
        context.note(format!("settings state no image size: {size} (--size sets it)"));
    }
    let first_camera = first(root.get("cameras"))?.and_then(|camera| camera.get("initial"));
    let initial = first_camera.or_else(|| root.get("camera"));
    let default_fov = initial.as_ref().and_then(|camera| camera.get("fov"));
    let default_fov = default_fov.map_or(Ok(60.0), |fov| fov.number())?;
    if let Some(track) = first(root.get("animTracks"))? {
        return animation(&track, default_fov, size);
    }
    let Some(camera) = initial else {
        return Err(CaptureFault::field("cameras", "a camera or an animation", "neither"));
    };
    let eye = camera.require("position", "3 numbers")?.numbers::<3>()?;
    let target = camera.require("target", "3 numbers")?.numbers::<3>()?;
    let key = [eye[0], eye[1], eye[2], target[0], target[1], target[2], default_fov];
    captured(std::iter::once(key), super::DEFAULT_FRAMES_PER_SECOND, false, size)
}

/// The first element of an array, where there is one.
fn first<'a>(array: Option<Field<'a>>) -> Result<Option<Field<'a>>, CaptureFault> {
    Ok(match array {
        Some(array) => array.elements()?.next(),
        None => None,
    })
}

fn animation(track: &Field, default_fov: f64, size: Size) -> Result<Captured, CaptureFault> {
    let rate = track.get("frameRate").map_or(Ok(super::DEFAULT_FRAMES_PER_SECOND), |rate| rate.number())?;
    let duration = track.require("duration", "the duration in seconds")?;
    let frames = (duration.number()? * rate).round();
    if !(1.0..=MOST_FRAMES).contains(&frames) {
        return Err(duration.wrong("a duration of 1 to 432000 frames"));
    }
    let smoothness = track.get("smoothness").map_or(Ok(1.0), |s| s.number())?;
    let is_stepped = track.get("interpolation").is_some_and(|i| i.text().is_ok_and(|i| i == "step"));
    let is_cycle = track.get("loopMode").is_none_or(|mode| mode.text().is_ok_and(|mode| mode == "repeat"));
    let keyframes = track.require("keyframes", "an object of times and values")?;
    let times = keyframes.require("times", "numbers")?;
    let values = keyframes.require("values", "an object of position and target")?;
    let (eyes, targets) =
        (values.require("position", "numbers")?.list()?, values.require("target", "numbers")?.list()?);
    let fovs = values.get("fov").map(|fov| fov.list()).transpose()?;
    let count = times.list()?.len();
    let key_times = times.list()?;
    if count == 0 || !key_times.is_sorted_by(|a, b| a < b) {
        return Err(times.wrong("ascending times, at least one"));
    }
    let wanted = |name, length: usize, each: usize| match length == count * each {
        true => Ok(()),
        false => Err(CaptureFault::field(name, &format!("{} numbers", count * each), length)),
    };
    wanted("keyframes.values.position", eyes.len(), 3)?;
    wanted("keyframes.values.target", targets.len(), 3)?;
    if let Some(fovs) = &fovs {
        wanted("keyframes.values.fov", fovs.len(), 1)?;
    }
    let key = |i: usize| -> Key {
        let fov = fovs.as_ref().map_or(default_fov, |fovs| fovs[i]);
        [
            eyes[3 * i],
            eyes[3 * i + 1],
            eyes[3 * i + 2],
            targets[3 * i],
            targets[3 * i + 1],
            targets[3 * i + 2],
            fov,
        ]
    };
    let keys: Vec<Key> = (0..count).map(key).collect();
    // The viewer's animations continue into their beginning in every loop mode. If the last key is at the end, the
    // period is one frame longer.
    let period = if key_times[count - 1] >= frames { key_times[count - 1] + 1.0 } else { frames };
    let curve = Curve { times: key_times, keys, period, smoothness, is_stepped };
    captured((0..frames as usize).map(|frame| curve.at(frame as f64)), rate, is_cycle, size)
}

/// A closed curve through keys: cubic between neighbours, with slopes from the neighbours on both sides.
struct Curve {
    times: Vec<f64>,
    keys: Vec<Key>,
    /// Time after which it begins anew; more than any key's.
    period: f64,
    /// Factor on the slopes.
    smoothness: f64,
    is_stepped: bool,
}

impl Curve {
    /// Time and value of key `index`, counted on beyond both ends.
    fn key(&self, index: isize) -> (f64, &Key) {
        let count = self.keys.len() as isize;
        let (turn, within) = (index.div_euclid(count), index.rem_euclid(count) as usize);
        (self.times[within] + turn as f64 * self.period, &self.keys[within])
    }

    fn at(&self, time: f64) -> Key {
        if self.keys.len() == 1 {
            return self.keys[0];
        }
        let before = self.times.partition_point(|t| *t <= time) as isize - 1;
        let points = [-1, 0, 1, 2].map(|k| self.key(before + k));
        let [(t0, p0), (t1, p1), (t2, p2), (t3, p3)] = points;
        let span = t2 - t1;
        let t = if self.is_stepped { 0.0 } else { (time - t1) / span };
        std::array::from_fn(|k| {
            let slope = |a: f64, b: f64, over: f64| self.smoothness * (b - a) / over * span;
            let (m1, m2) = (slope(p0[k], p2[k], t2 - t0), slope(p1[k], p3[k], t3 - t1));
            let (tt, ttt) = (t * t, t * t * t);
            (2.0 * ttt - 3.0 * tt + 1.0) * p1[k]
                + (ttt - 2.0 * tt + t) * m1
                + (3.0 * tt - 2.0 * ttt) * p2[k]
                + (ttt - tt) * m2
        })
    }
}

fn captured(
    keys: impl Iterator<Item = Key>,
    rate: f64,
    is_cycle: bool,
    Size { width, height }: Size,
) -> Result<Captured, CaptureFault> {
    let mut cameras = Vec::new();
    for (i, [ex, ey, ez, tx, ty, tz, fov]) in keys.enumerate() {
        let field = format!("frame {i}");
        if !(fov > 0.0 && fov < 180.0) {
            return Err(CaptureFault::field(&format!("{field} fov"), "degrees between 0 and 180", fov));
        }
        // SuperSplat's field of view spans the longer side.
        let focal = 0.5 * f64::from(width.max(height)) / (0.5 * fov.to_radians()).tan();
        let (cx, cy) = (0.5 * f64::from(width), 0.5 * f64::from(height));
        let intrinsics = Intrinsics { width, height, fx: focal, fy: focal, cx, cy };
        let [eye, target] = [DVec3::new(-ex, -ey, ez), DVec3::new(-tx, -ty, tz)];
        let camera = look_at(eye, target, DVec3::NEG_Y, intrinsics);
        cameras.push(camera.map_err(|source| CaptureFault::camera(&field, source))?);
    }
    Ok(Captured { path: CameraPath::new(cameras, rate, is_cycle)?, facts: PathFacts::default() })
}
