//! Keyframes of the camera: recorded, played, written and read.

use gs3::glam::{DMat3, DVec3};
use gs3::scene::camera_path::Pace;
use gs3::scene::transform::Similarity;
use gs3::scene::{Camera, CameraError, CameraPath};
use serde_json::{Value, json};

/// Seconds from one recorded keyframe to the next, on average.
const SECONDS_PER_KEY: f64 = 2.0;

/// Frames per second of written paths.
const WRITTEN_FPS: f64 = 30.0;

/// Keyframes, and the way through them.
#[derive(Clone, Debug, Default)]
pub struct Tour {
    keys: Vec<Camera>,
    /// Whether the keyframes were recorded here, and are no path with a pace of its own.
    is_recorded: bool,
    /// The way through the keyframes, once there are two.
    way: Option<CameraPath>,
    /// Seconds since the beginning, while it plays.
    playing: Option<f64>,
}

impl Tour {
    /// A tour along `path` at its own pace.
    #[must_use]
    pub fn along(path: &CameraPath) -> Self {
        let way = (path.cameras().len() > 1).then(|| path.clone());
        Self { keys: path.cameras().to_vec(), is_recorded: false, way, playing: None }
    }

    /// Adds a keyframe at the end. After a path that was read, a recording begins with it.
    pub fn add(&mut self, camera: Camera) {
        if !std::mem::replace(&mut self.is_recorded, true) {
            self.keys.clear();
        }
        self.keys.push(camera);
        self.smooth();
    }

    /// Takes the last keyframe away; a path that was read stays whole.
    pub fn remove_last(&mut self) {
        if !self.is_recorded {
            return;
        }
        self.keys.pop();
        self.smooth();
    }

    fn smooth(&mut self) {
        self.playing = None;
        let way = CameraPath::new(self.keys.clone(), WRITTEN_FPS, false).ok().filter(|_| self.keys.len() > 1);
        self.way = way.map(|path| {
            let seconds = SECONDS_PER_KEY * (self.keys.len() - 1) as f64;
            path.smoothed((seconds * WRITTEN_FPS) as usize + 1, Pace::Speed)
        });
    }

    /// Number of keyframes.
    #[must_use]
    pub fn keys(&self) -> usize {
        self.keys.len()
    }

    /// Seconds that the tour takes; 0 without two keyframes.
    #[must_use]
    pub fn seconds(&self) -> f64 {
        self.way.as_ref().map_or(0.0, |way| {
            let steps = if way.is_cycle() { way.cameras().len() } else { way.cameras().len() - 1 };
            steps as f64 / way.frames_per_second()
        })
    }

    /// Begins to play, from the beginning; does nothing without two keyframes.
    pub fn play(&mut self) {
        self.playing = self.way.as_ref().map(|_| 0.0);
    }

    /// Stops where it is.
    pub fn stop(&mut self) {
        self.playing = None;
    }

    /// Seconds since the beginning, while it plays.
    #[must_use]
    pub const fn playing(&self) -> Option<f64> {
        self.playing
    }

    /// The camera `seconds` after the beginning.
    #[must_use]
    pub fn at(&self, seconds: f64) -> Option<Camera> {
        self.way.as_ref().map(|way| way.at(seconds * way.frames_per_second()))
    }

    /// Goes on by `seconds`, if it plays: the camera now. It ends at its last keyframe.
    pub fn advance(&mut self, seconds: f64) -> Option<Camera> {
        let time = (self.playing? + seconds).min(self.seconds());
        self.playing = (time < self.seconds()).then_some(time);
        self.at(time)
    }

    /// The tour as nerfstudio's `camera_path.json`, which `gs3 render --path` reads, with pictures of `size`. The
    /// scene's `origin` is measured from the origin of the file's world. `None` without a keyframe.
    #[must_use]
    pub fn to_camera_path(&self, size: [u32; 2], origin: DVec3) -> Option<Vec<u8>> {
        let single;
        let path = match &self.way {
            Some(way) => way,
            None => {
                single = CameraPath::new(self.keys.clone(), WRITTEN_FPS, false).ok()?;
                &single
            }
        };
        Some(camera_path_json(&moved(path, origin).ok()?, size))
    }
}

/// `path` in a world that has been moved by `shift`.
///
/// # Errors
/// [`CameraError`] if a pose becomes none.
pub fn moved(path: &CameraPath, shift: DVec3) -> Result<CameraPath, CameraError> {
    path.in_moved_world(&Similarity { shift, ..Similarity::orthogonal(DMat3::IDENTITY) })
}

/// `path` as nerfstudio's `camera_path.json`, with pictures of `size`. What the format has no place for, principal points
/// beside the centre and pixels that are no squares, is left out.
#[must_use]
pub fn camera_path_json(path: &CameraPath, size: [u32; 2]) -> Vec<u8> {
    let frames: Vec<Value> = path.cameras().iter().map(frame).collect();
    let fps = path.frames_per_second();
    let json = json!({
        "camera_type": "perspective",
        "render_width": size[0],
        "render_height": size[1],
        "fps": fps,
        "seconds": frames.len() as f64 / fps,
        "is_cycle": path.is_cycle(),
        "camera_path": frames,
    });
    let mut bytes = format!("{json:#}").into_bytes();
    bytes.push(b'\n');
    bytes
}

/// One camera in OpenGL's axes: x right, y up, z backward.
fn frame(camera: &Camera) -> Value {
    let world_from_view = camera.world_from_view();
    let turned = world_from_view.matrix3 * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let [x, y, z] = [turned.x_axis, turned.y_axis, turned.z_axis];
    let t = world_from_view.translation;
    let rows = [0, 1, 2].map(|r| [x[r], y[r], z[r], t[r]]);
    let matrix: Vec<f64> = rows.into_iter().flatten().chain([0.0, 0.0, 0.0, 1.0]).collect();
    let i = camera.intrinsics();
    let fov = 2.0 * (0.5 * f64::from(i.height) / i.fy).atan();
    json!({
        "camera_to_world": matrix,
        "fov": fov.to_degrees(),
        "aspect": f64::from(i.width) / f64::from(i.height),
    })
}

#[cfg(test)]
mod tests {
    use gs3::scene::{capture, demo};

    use super::*;

    fn path() -> CameraPath {
        demo::path().resized(64, 40).unwrap()
    }

    fn tour() -> Tour {
        let mut tour = Tour::default();
        path().cameras().iter().take(3).for_each(|camera| tour.add(*camera));
        tour
    }

    #[test]
    fn a_tour_plays_from_its_first_to_its_last_key_and_ends() {
        let mut tour = tour();
        assert_eq!((tour.keys(), tour.seconds()), (3, 4.0));
        assert!(tour.playing().is_none() && tour.advance(0.1).is_none());
        tour.play();
        let near = |a: Camera, b: Camera| a.view_from_world().abs_diff_eq(b.view_from_world(), 1e-9);
        assert!(near(tour.advance(0.0).unwrap(), path().cameras()[0]));
        let middle = tour.advance(2.0).unwrap().position();
        assert!(middle.distance(path().cameras()[1].position()) < 0.05);
        assert!(near(tour.advance(9.0).unwrap(), path().cameras()[2]));
        assert!(tour.playing().is_none());
    }

    #[test]
    fn a_single_key_is_no_way_and_can_be_written() {
        let mut tour = tour();
        tour.remove_last();
        tour.remove_last();
        tour.play();
        assert!(tour.playing().is_none() && tour.keys() == 1 && tour.seconds() == 0.0);
        let read = capture::parse_json(&tour.to_camera_path([64, 40], DVec3::ZERO).unwrap()).unwrap();
        assert_eq!(read.cameras().len(), 1);
        tour.remove_last();
        assert!(tour.to_camera_path([64, 40], DVec3::ZERO).is_none());
    }

    #[test]
    fn what_is_written_is_read() {
        let mut tour = tour();
        let read = capture::parse_json(&tour.to_camera_path([64, 40], DVec3::ZERO).unwrap()).unwrap();
        assert_eq!((read.cameras().len(), read.frames_per_second()), (121, WRITTEN_FPS));
        tour.play();
        for camera in read.cameras().iter().take(120) {
            let shown = tour.at(tour.playing().unwrap()).unwrap();
            assert!(shown.view_from_world().abs_diff_eq(camera.view_from_world(), 1e-9));
            assert_eq!((camera.width(), camera.height()), (64, 40));
            assert!((shown.intrinsics().fy - camera.intrinsics().fy).abs() < 1e-9);
            tour.advance(1.0 / WRITTEN_FPS);
        }
        let mut again = Tour::along(&read);
        again.remove_last();
        assert_eq!(again.keys(), 121);
        assert!((again.seconds() - 4.0).abs() < 1e-9);
        again.add(read.cameras()[0]);
        assert_eq!(again.keys(), 1);
    }
}
