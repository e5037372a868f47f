//! Opening and writing of files.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

use gs3::scene::camera::MAX_SIDE;
use gs3::scene::orbit::{self, Bulk};
use gs3::scene::{Camera, CameraError, CameraPath, PngChannels, Scene, Size, write_png};
use gs3::{Mode, Stage};

use super::{Destination, Effect, Opened, Shot, Viewer, ViewerError};
use crate::controls::Controls;
use crate::heap::give_back;
use crate::path_file::{PathFile, PathFileError, PathFormat, camera_path_json, moved};
use crate::tour::Tour;

impl Viewer {
    /// Requests a screenshot, which the next step takes.
    pub fn shoot(&mut self, shot: Shot) {
        self.shots.push(shot);
        self.is_idle = false;
    }

    pub(super) async fn take_shots(&mut self, now: Duration) {
        for shot in std::mem::take(&mut self.shots) {
            let (bytes, camera) = match self.take_shot(&shot, now).await {
                Ok(taken) => taken,
                Err(message) => {
                    self.message = Some(message);
                    self.is_woken = true;
                    continue;
                }
            };
            let numbered = Destination::Numbered { stem: "gs3", extension: "png" };
            self.effects.push(Effect::Save(shot.file.map_or(numbered, Destination::File), bytes));
            if let (Some(file), Some(camera)) = (shot.camera, camera)
                && let Ok(path) = CameraPath::new(vec![camera], 30.0, false)
                && let Ok(path) = moved(&path, self.scene().details().origin)
            {
                self.effects.push(Effect::Save(Destination::File(file), camera_path_json(&path, self.size)));
            }
        }
    }

    /// The PNG file, and the camera that the picture shows, at the size of the window's picture.
    async fn take_shot(&mut self, shot: &Shot, now: Duration) -> Result<(Vec<u8>, Option<Camera>), String> {
        let encode = |size: Size, rgb: &[u8]| {
            let mut bytes = Vec::new();
            let written = write_png(&mut bytes, size, PngChannels::Rgb, rgb);
            written.map(|()| bytes).map_err(|e| format!("screenshot: {e}"))
        };
        if shot.scale <= 1 {
            let picture = if shot.panels { &self.picture } else { &self.frame };
            let bytes = encode(Size::of(picture.size[0], picture.size[1]), &picture.to_rgb8())?;
            return Ok((bytes, self.camera));
        }
        let size = self.size.map(|side| side.saturating_mul(shot.scale));
        let [shown, camera] = [self.size, size].map(|size| self.controls.shown().camera(size));
        let camera = camera.map_err(|e| format!("screenshot: {e}"))?;
        self.wait_for_frame(now);
        let reference = self.desk.session().reference_async(Mode::Native, &camera).await;
        let image = reference.map_err(|e| format!("screenshot: {e}"))?;
        let bytes = encode(size, &image.to_rgb8())?;
        // The last native frame is this one now.
        self.rest.is_native = false;
        Ok((bytes, shown.ok()))
    }

    /// Writes the keyframes to `place`, in the format of its name ([`PathFormat::of`]).
    pub fn save_tour(&mut self, destination: Destination) {
        self.is_woken = true;
        let format = match &destination {
            Destination::File(file) => PathFormat::of(file),
            Destination::Numbered { stem, extension } => {
                PathFormat::of(&PathBuf::from(format!("{stem}.{extension}")))
            }
        };
        match self.tour_file(format) {
            Ok(Some(PathFile { bytes, notes })) => {
                self.effects.push(Effect::Save(destination, bytes));
                // Told together with the name of the file.
                self.left_out = notes;
            }
            Ok(None) => self.message = Some("keyframes: expected at least 1 to write, found 0".to_owned()),
            Err(error) => self.message = Some(error.to_string()),
        }
    }

    fn tour_file(&self, format: PathFormat) -> Result<Option<PathFile>, PathFileError> {
        // Files use the coordinates of the scene's file.
        let origin = self.scene().details().origin;
        // A pivot beside the line of sight has its depth; one behind the camera has none that a viewer could orbit at.
        let rig = self.controls.shown();
        let distance = if rig.offset.z > 0.0 { rig.offset.z } else { rig.offset.length() };
        self.tour.to_file(format, self.size, origin, distance)
    }

    /// Writes [`Self::figures_json`] to `file`.
    pub fn save_figures(&mut self, file: PathBuf) {
        let json = self.figures_json();
        self.effects.push(Effect::Save(Destination::File(file), format!("{json:#}\n").into_bytes()));
    }

    /// Figures of the last displayed frames, the scene, the message shown, and whether the viewer rests.
    #[must_use]
    pub fn figures_json(&self) -> serde_json::Value {
        let status = self.desk.status();
        let rates = self.figures.rates();
        let stage = |stage: &Stage| Some((stage.name(), status.times.get(*stage)?.as_secs_f64() * 1e3));
        let stages: BTreeMap<&str, f64> = Stage::ALL.iter().filter_map(stage).collect();
        serde_json::json!({
            "displayed": self.figures.displayed(),
            "rendered": self.figures.rendered(),
            "displayed_per_second": rates.map(|rates| rates.displayed),
            "rendered_per_second": rates.map(|rates| rates.rendered),
            "interval_median_ms": rates.map(|rates| rates.median),
            "interval_95_percent_ms": rates.map(|rates| rates.percentile_95),
            "latency_median_ms": rates.map(|rates| rates.latency),
            "in_between": self.pace.in_between(),
            "frame_ms": self.frame_time().as_secs_f64() * 1e3,
            "stages_ms": stages,
            "overhead_ms": self.overhead * 1e3,
            "exact_share": status.exact_share,
            "width": self.size.width,
            "height": self.size.height,
            "backend": status.backend.name(),
            "scene": self.name,
            "gaussians": status.scene.gaussians().len(),
            "idle": self.is_idle,
            "native": self.rest.is_native,
            "opening": self.opening.is_some(),
            "message": self.message,
        })
    }

    /// Reports the share of the file being opened that has been read, `[0, 1]`.
    pub fn progress(&mut self, share: f32) {
        if let Some((_, done)) = &mut self.opening {
            *done = share;
            self.is_woken = true;
        }
    }

    /// Shows that `name` is still being opened: more of a scene that is shown already, or another file.
    pub fn expect(&mut self, name: &str) {
        self.opening = Some((name.to_owned(), 0.0));
        self.is_woken = true;
    }

    /// Shows an opened file, or reports why it cannot be shown; the old scene stays then. Returns whether it is shown.
    pub fn opened(&mut self, opened: Result<Opened, String>, now: Duration) -> bool {
        self.opening = None;
        (self.is_woken, self.is_idle, self.has_failed) = (true, false, false);
        let shown = opened.and_then(|opened| self.show(opened, now).map_err(|error| error.to_string()));
        // Reading and the scene before leave freed memory behind.
        give_back();
        match shown {
            Ok(()) => true,
            Err(message) => {
                self.message = Some(message);
                false
            }
        }
    }

    pub(super) fn show(&mut self, opened: Opened, now: Duration) -> Result<(), ViewerError> {
        if !matches!(opened, Opened::Cameras { .. }) {
            self.wait_for_frame(now);
        }
        match opened {
            Opened::Scene { name, scene, cameras } => {
                let camera = first_camera(&scene, cameras.as_ref(), self.size)?;
                let bulk = Bulk::of(&scene);
                let told = report(&name, &scene);
                self.desk.session().set_scene(scene)?;
                self.controls = Controls::new(&camera, &bulk);
                self.tour = cameras.as_ref().map(Tour::along).unwrap_or_default();
                (self.bulk, self.camera) = (bulk, None);
                self.forget_frames();
                self.tell(told, now);
                self.name = name;
            }
            Opened::Finer { scene } => {
                // Positions count from the origin of their scene.
                let by = self.scene().details().origin - scene.details().origin;
                let (bulk, told) = (Bulk::of(&scene), report(&self.name, &scene));
                let tour = self.tour.shifted(by)?;
                self.desk.session().set_scene(scene)?;
                self.controls.shift(by, &bulk);
                self.tour = tour;
                self.tell(told, now);
                (self.bulk, self.camera) = (bulk, None);
                self.forget_frames();
            }
            Opened::Cameras { name, path } if path.facts().is_panorama => {
                self.message =
                    Some(format!("{name}: expected perspective cameras, found equirectangular ones"));
            }
            Opened::Cameras { name, path } => {
                let path = moved(&path, -self.scene().details().origin)?;
                self.tour = Tour::along(&path);
                let first = path.cameras()[0].resized(self.size.width, self.size.height)?;
                self.jump(&first);
                let mut told = format!("{name}: {} cameras; Space plays them", self.tour.keys());
                for note in &path.facts().notes {
                    told += &format!("; {note}");
                }
                self.tell(told, now);
            }
        }
        Ok(())
    }

    /// Reports where an [`Effect::Save`] was written, or why it was not.
    pub fn saved(&mut self, saved: Result<PathBuf, String>, now: Duration) {
        match saved {
            Ok(file) => {
                let written = format!("written: {}", file.display());
                let told: Vec<String> =
                    std::iter::once(written).chain(std::mem::take(&mut self.left_out)).collect();
                self.tell(told.join("; "), now);
            }
            Err(message) => {
                self.message = Some(message);
                self.is_woken = true;
            }
        }
    }
}

/// The note that `scene` is open, with the contents of its file that are not shown.
fn report(name: &str, scene: &Scene) -> String {
    let dropped = scene.dropped().total();
    let mut told = format!("opened {name}");
    if dropped > 0 {
        told += &format!("; {dropped} invalid Gaussians are left out");
    }
    for note in &scene.details().notes {
        told += &format!("; {note}");
    }
    told
}

/// The first of `cameras`, or a camera with all of `scene` in view, for a picture of `size`.
pub(super) fn first_camera(
    scene: &Scene,
    cameras: Option<&CameraPath>,
    size: Size,
) -> Result<Camera, CameraError> {
    let Size { width, height } = size.map(|side| side.clamp(1, MAX_SIDE));
    match cameras {
        Some(path) => path.cameras()[0].resized(width, height),
        None => Ok(orbit::around(scene, 1, width, height)?.cameras()[0]),
    }
}
