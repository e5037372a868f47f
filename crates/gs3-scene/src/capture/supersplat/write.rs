//! Writes the settings that the reader reads back: version 2, with every field that the SuperSplat viewer demands.

use glam::DVec3;
use serde_json::{Value, json};

use crate::camera::Camera;
use crate::camera_path::CameraPath;
use crate::capture::CaptureFault;

/// A camera closer than this to straight up or down, radians, has no level horizon. Where a target is a thousandth of the
/// coordinates away, rounding moves the direction to the target by 1e-12. The horizon turns by that over this angle: by half
/// a pixel of a picture 8192 pixels wide at most.
const UPRIGHT: f64 = 1e-12 * 2.0 * 8192.0;

/// A smaller turn, radians, moves no pixel of a picture 1000 pixels wide by half a pixel.
const INVISIBLE_ROLL: f64 = 1e-3;

/// Pixels by which a principal point may lie beside the centre without a note.
const INVISIBLE_SHIFT: f64 = 0.5;

/// Settings of the SuperSplat viewer as bytes, and what the format has no place for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SuperSplatSettings {
    /// The JSON file.
    pub json: Vec<u8>,
    /// What the settings leave out and could change the picture: sentences of one line.
    pub notes: Vec<String>,
}

/// `path` as settings of the SuperSplat viewer, version 2: an animation with one keyframe per camera, or a single camera.
///
/// `path` has the coordinates of the scene's file. The field of view written is along the longer side of each camera's
/// picture. Targets lie `distance` (positive) before their cameras, and the viewer orbits around the first of them.
/// [`super::super::parse_json`] reads the same cameras back, but for what the notes name: a roll around the line of sight,
/// principal points beside the centre, and pixels that are no squares.
///
/// # Errors
/// [`CaptureFault::Field`] if a camera looks straight up or down, or `distance` is not positive.
pub fn supersplat_settings(path: &CameraPath, distance: f64) -> Result<SuperSplatSettings, CaptureFault> {
    if !(distance > 0.0 && distance.is_finite()) {
        return Err(CaptureFault::field("distance", "a positive number", distance));
    }
    let cameras = path.cameras();
    let mut poses = Vec::with_capacity(cameras.len());
    for (index, camera) in cameras.iter().enumerate() {
        let pose = Pose::of(camera, distance).ok_or_else(|| {
            let expected = "a camera that does not look straight up or down (along y)";
            CaptureFault::field(&format!("frame {index}"), expected, "one that does")
        })?;
        poses.push(pose);
    }
    let json = json!({
        "version": 2,
        "tonemapping": "none",
        "highPrecisionRendering": false,
        "background": { "color": [0, 0, 0] },
        "postEffectSettings": effects_off(),
        "animTracks": tracks(path, &poses),
        "cameras": [{ "initial": {
            "position": poses[0].position,
            "target": poses[0].target,
            "fov": poses[0].fov,
        }}],
        "annotations": [],
        "startMode": if poses.len() > 1 { "animTrack" } else { "default" },
    });
    let mut bytes = format!("{json:#}").into_bytes();
    bytes.push(b'\n');
    Ok(SuperSplatSettings { json: bytes, notes: notes(cameras, &poses) })
}

/// A camera in the coordinates of the SuperSplat viewer.
struct Pose {
    position: [f64; 3],
    target: [f64; 3],
    /// Degrees of the longer side.
    fov: f64,
    /// Radians by which the camera is turned around its line of sight, away from the level horizon that it gets.
    roll: f64,
}

impl Pose {
    /// None of a camera that looks straight up or down.
    fn of(camera: &Camera, distance: f64) -> Option<Self> {
        let axes = camera.world_from_view().matrix3;
        let (right, forward) = (axes.x_axis, axes.z_axis);
        let level = forward.cross(DVec3::NEG_Y);
        if level.length() < UPRIGHT {
            return None;
        }
        // Scenes are turned by half a turn about z.
        let turned = |point: DVec3| [-point.x, -point.y, point.z];
        let position = camera.position();
        let i = camera.intrinsics();
        let (side, focal) = if i.width >= i.height { (i.width, i.fx) } else { (i.height, i.fy) };
        Some(Self {
            position: turned(position),
            target: turned(position + distance * forward),
            fov: (2.0 * (0.5 * f64::from(side) / focal).atan()).to_degrees(),
            roll: right.angle_between(level),
        })
    }
}

/// One animation with a keyframe per frame: other curves between keyframes change nothing at the frames.
fn tracks(path: &CameraPath, poses: &[Pose]) -> Vec<Value> {
    if poses.len() < 2 {
        return Vec::new();
    }
    let rate = path.frames_per_second();
    let flat = |part: fn(&Pose) -> [f64; 3]| poses.iter().flat_map(part).collect::<Vec<f64>>();
    vec![json!({
        "name": "camera path",
        "duration": poses.len() as f64 / rate,
        "frameRate": rate,
        "loopMode": if path.is_cycle() { "repeat" } else { "none" },
        "interpolation": "spline",
        "smoothness": 1,
        "keyframes": {
            "times": (0..poses.len()).collect::<Vec<usize>>(),
            "values": {
                "position": flat(|pose| pose.position),
                "target": flat(|pose| pose.target),
                "fov": poses.iter().map(|pose| pose.fov).collect::<Vec<f64>>(),
            },
        },
    })]
}

/// Effects that the viewer demands to be named, all without effect.
fn effects_off() -> Value {
    json!({
        "sharpness": { "enabled": false, "amount": 0 },
        "bloom": { "enabled": false, "intensity": 0, "blurLevel": 0 },
        "grading": { "enabled": false, "brightness": 1, "contrast": 1, "saturation": 1, "tint": [1, 1, 1] },
        "vignette": { "enabled": false, "intensity": 0, "inner": 0, "outer": 0, "curvature": 0 },
        "fringing": { "enabled": false, "intensity": 0 },
    })
}

fn notes(cameras: &[Camera], poses: &[Pose]) -> Vec<String> {
    let mut notes = Vec::new();
    let roll = poses.iter().map(|pose| pose.roll).fold(0.0, f64::max);
    if roll > INVISIBLE_ROLL {
        notes.push(format!(
            "settings of SuperSplat have no roll: cameras are turned around their line of sight by up to {:.1}°, to a \
             horizon that is level where −y is up",
            roll.to_degrees()
        ));
    }
    let is_beside = |camera: &&Camera| {
        let i = camera.intrinsics();
        let shift = [i.cx - 0.5 * f64::from(i.width), i.cy - 0.5 * f64::from(i.height)];
        // Across the picture, the other side's focal length moves its edge by this much.
        let stretch = (i.fx / i.fy - 1.0) * f64::from(i.width.max(i.height));
        shift.into_iter().chain([stretch]).any(|pixels| pixels.abs() > INVISIBLE_SHIFT)
    };
    let beside = cameras.iter().filter(is_beside).count();
    if beside > 0 {
        notes.push(format!(
            "settings of SuperSplat have a centred principal point and square pixels: {beside} of {} cameras have others",
            cameras.len()
        ));
    }
    notes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Intrinsics;
    use crate::capture::{CaptureOptions, parse_json_with};
    use crate::orbit::look_at;
    use crate::size::Size;

    /// A way around the origin with −y up, a field of view that changes, and a picture of `size`.
    fn path(size: Size, count: usize) -> CameraPath {
        let camera = |k: usize| {
            let angle = 0.37 * k as f64;
            let eye = DVec3::new(3.0 * angle.cos(), -0.8 - 0.1 * k as f64, 3.0 * angle.sin());
            let intrinsics = Intrinsics::from_fov_y(size.width, size.height, 0.7 + 0.05 * k as f64);
            look_at(eye, DVec3::new(0.1, 0.2, 0.3), DVec3::NEG_Y, intrinsics).unwrap()
        };
        CameraPath::new((0..count).map(camera).collect(), 24.0, count.is_multiple_of(2)).unwrap()
    }

    #[test]
    fn what_is_written_is_read() {
        // Both sides may be the longer one, paths open or closed, or a single camera.
        for (size, count) in [([1280, 720], 9), ([300, 500], 8), ([64, 64], 2), ([320, 200], 1)] {
            let size = Size::from(size);
            let path = path(size, count);
            let written = supersplat_settings(&path, 2.5).unwrap();
            assert!(written.notes.is_empty(), "{:?}", written.notes);
            let options = CaptureOptions { size: Some(size), ..CaptureOptions::default() };
            let read = parse_json_with(&written.json, &options).unwrap();
            assert_eq!(read.cameras().len(), count);
            if count > 1 {
                assert_eq!((read.frames_per_second(), read.is_cycle()), (24.0, path.is_cycle()));
            }
            for (read, given) in read.cameras().iter().zip(path.cameras()) {
                // Double precision, less some digits of a target that lies near.
                let (a, b) = (read.view_from_world(), given.view_from_world());
                assert!(a.abs_diff_eq(b, 1e-12), "{a:?} {b:?}");
                let (a, b) = (read.intrinsics(), given.intrinsics());
                assert_eq!((a.width, a.height), (b.width, b.height));
                assert!(
                    (a.fx / b.fx - 1.0).abs() < 1e-12 && (a.fy / b.fy - 1.0).abs() < 1e-12,
                    "{a:?} {b:?}"
                );
            }
        }
    }

    #[test]
    fn what_the_settings_have_no_place_for_is_told() {
        let given = path(Size::new(320, 200), 1).cameras()[0];
        let Intrinsics { fx, fy, .. } = given.intrinsics();
        let with = |intrinsics| {
            let camera = Camera::new(given.view_from_world(), intrinsics).unwrap();
            supersplat_settings(&CameraPath::new(vec![camera], 24.0, false).unwrap(), 1.0).unwrap().notes
        };
        let shifted = with(Intrinsics { cx: 150.0, ..given.intrinsics() });
        assert!(shifted[0].contains("1 of 1 cameras have others"), "{shifted:?}");
        assert_eq!(with(Intrinsics { fx: 1.1 * fx, fy, ..given.intrinsics() }).len(), 1);
        let rolled = glam::DAffine3::from_rotation_z(0.1) * given.view_from_world();
        let rolled = Camera::new(rolled, given.intrinsics()).unwrap();
        let notes =
            supersplat_settings(&CameraPath::new(vec![rolled], 24.0, false).unwrap(), 1.0).unwrap().notes;
        assert!(notes[0].contains("by up to 5.7°"), "{notes:?}");
    }

    #[test]
    fn what_has_no_horizon_is_refused() {
        let intrinsics = Intrinsics::from_fov_y(64, 64, 1.0);
        let down = look_at(DVec3::ZERO, DVec3::Y, DVec3::Z, intrinsics).unwrap();
        let path = CameraPath::new(vec![down], 24.0, false).unwrap();
        let fault = supersplat_settings(&path, 1.0).unwrap_err().to_string();
        assert!(fault.starts_with("frame 0: expected a camera that does not look straight"), "{fault}");
        let fault = supersplat_settings(&path, 0.0).unwrap_err().to_string();
        assert_eq!(fault, "distance: expected a positive number, found 0");
    }
}
