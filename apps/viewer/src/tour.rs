//! Keyframes of the camera: recorded, played and written.

use gs3::glam::{DAffine3, DVec3};
use gs3::scene::camera_path::Pace;
use gs3::scene::{Camera, CameraError, CameraPath, Size};

use crate::path_file::{PathFile, PathFileError, PathFormat, moved};

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
    /// Seconds from the beginning to where the tour was shown last.
    time: f64,
    is_playing: bool,
}

impl Tour {
    /// A tour along `path` at its own pace.
    #[must_use]
    pub fn along(path: &CameraPath) -> Self {
        let way = (path.cameras().len() > 1).then(|| path.clone());
        Self { keys: path.cameras().to_vec(), way, ..Self::default() }
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
        (self.time, self.is_playing) = (0.0, false);
        let way = CameraPath::new(self.keys.clone(), WRITTEN_FPS, false).ok().filter(|_| self.keys.len() > 1);
        self.way = way.map(|path| {
            let seconds = SECONDS_PER_KEY * (self.keys.len() - 1) as f64;
            path.smoothed((seconds * WRITTEN_FPS) as usize + 1, Pace::Speed)
        });
    }

    /// The same tour with `by`, world units, added to every position.
    ///
    /// # Errors
    /// [`CameraError`] if a pose becomes none.
    pub fn shifted(&self, by: DVec3) -> Result<Self, CameraError> {
        let back = DAffine3::from_translation(-by);
        let key = |key: &Camera| Camera::new(key.view_from_world() * back, key.intrinsics());
        let keys = self.keys.iter().map(key).collect::<Result<_, _>>()?;
        let way = self.way.as_ref().map(|way| moved(way, by)).transpose()?;
        Ok(Self { keys, way, ..*self })
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

    /// Plays on from where the tour was shown last, or from the beginning after its end. Does nothing without two
    /// keyframes.
    pub fn play(&mut self) {
        if self.time >= self.seconds() {
            self.time = 0.0;
        }
        self.is_playing = self.way.is_some();
    }

    /// Stops where it is.
    pub const fn stop(&mut self) {
        self.is_playing = false;
    }

    /// Seconds since the beginning, while it plays.
    #[must_use]
    pub fn playing(&self) -> Option<f64> {
        self.is_playing.then_some(self.time)
    }

    /// Seconds from the beginning to where the tour was shown last.
    #[must_use]
    pub const fn time(&self) -> f64 {
        self.time
    }

    /// The camera `seconds` after the beginning.
    #[must_use]
    pub fn at(&self, seconds: f64) -> Option<Camera> {
        self.way.as_ref().map(|way| way.at(seconds * way.frames_per_second()))
    }

    /// Goes to `seconds` after the beginning, or to the nearer end, and stops there: the camera then. `None` without two
    /// keyframes.
    pub fn scrub(&mut self, seconds: f64) -> Option<Camera> {
        self.is_playing = false;
        self.time = if seconds.is_finite() { seconds.clamp(0.0, self.seconds()) } else { 0.0 };
        self.at(self.time)
    }

    /// Goes on by `seconds`, if it plays: the camera now. It ends at its last keyframe.
    pub fn advance(&mut self, seconds: f64) -> Option<Camera> {
        let time = (self.playing()? + seconds).min(self.seconds());
        (self.time, self.is_playing) = (time, time < self.seconds());
        self.at(time)
    }

    /// The way through the keyframes; `None` without two keyframes.
    #[must_use]
    pub const fn way(&self) -> Option<&CameraPath> {
        self.way.as_ref()
    }

    /// The tour as a file of `format`, which `gs3 render --path` reads, with pictures of `size`. The scene's `origin` is
    /// measured from the origin of the file's world. A viewer that orbits does so `distance` (positive) before the first
    /// camera. `None` without a keyframe.
    ///
    /// # Errors
    /// [`PathFileError`] if the format has no place for one of the cameras.
    pub fn to_file(
        &self,
        format: PathFormat,
        size: Size,
        origin: DVec3,
        distance: f64,
    ) -> Result<Option<PathFile>, PathFileError> {
        let single;
        let path = match (&self.way, self.keys.first()) {
            (Some(way), _) => way,
            (None, Some(key)) => {
                single = CameraPath::new(vec![*key], WRITTEN_FPS, false)?;
                &single
            }
            (None, None) => return Ok(None),
        };
        PathFile::new(format, &moved(path, origin)?, size, distance).map(Some)
    }
}

#[cfg(test)]
mod tests {
    use gs3::scene::{capture, demo};

    use super::*;

    fn path() -> CameraPath {
        demo::path().resized(64, 40).unwrap()
    }

    /// The tour as a `camera_path.json`.
    fn json(tour: &Tour) -> Option<Vec<u8>> {
        let file = tour.to_file(PathFormat::CameraPath, Size::new(64, 40), DVec3::ZERO, 1.0).unwrap();
        file.map(|file| file.bytes)
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
    fn playing_goes_on_where_the_tour_was_scrubbed_to() {
        let mut tour = tour();
        let near = |a: Camera, b: Camera| a.view_from_world().abs_diff_eq(b.view_from_world(), 1e-9);
        assert!(near(tour.scrub(3.0).unwrap(), tour.at(3.0).unwrap()));
        assert_eq!((tour.time(), tour.playing()), (3.0, None));
        tour.play();
        assert!(near(tour.advance(0.5).unwrap(), tour.at(3.5).unwrap()));
        tour.stop();
        assert_eq!((tour.time(), tour.playing()), (3.5, None));
        for (beyond, end) in [(-1.0, 0.0), (9.0, 4.0), (f64::NAN, 0.0)] {
            assert!(near(tour.scrub(beyond).unwrap(), tour.at(end).unwrap()), "{beyond}");
        }
        // After its end it plays from the beginning.
        tour.scrub(4.0);
        tour.play();
        assert_eq!(tour.playing(), Some(0.0));
        assert!(Tour::default().scrub(1.0).is_none());
    }

    #[test]
    fn a_single_key_is_no_way_and_can_be_written() {
        let mut tour = tour();
        tour.remove_last();
        tour.remove_last();
        tour.play();
        assert!(tour.playing().is_none() && tour.keys() == 1 && tour.seconds() == 0.0);
        let read = capture::parse_json(&json(&tour).unwrap()).unwrap();
        assert_eq!(read.cameras().len(), 1);
        tour.remove_last();
        assert!(json(&tour).is_none());
    }

    #[test]
    fn what_is_written_is_read() {
        let mut tour = tour();
        let read = capture::parse_json(&json(&tour).unwrap()).unwrap();
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
