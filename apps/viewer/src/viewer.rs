//! The viewer without a window: inputs and time go in; pictures and requests come out.

mod desk;
mod display;
mod files;
mod frames;
mod inputs;
mod job;
mod pace;
mod shown;
mod step;
mod touch;
mod video;
mod warm_up;

use std::path::PathBuf;
use std::sync::Arc;
use std::task::Waker;
use std::time::Duration;

use gs3::glam::DVec3;
use gs3::scene::orbit::Bulk;
use gs3::scene::{Camera, CameraError, CameraPath, Scene, Size};
use gs3::{Backend, PipelineError, Session, SessionSettings};

use crate::compare::{Compare, Dividers};
use crate::controls::{Controls, Rig};
use crate::figures::Figures;
use crate::input::{Button, Input, Modifiers};
use crate::paint::Framebuffer;
use crate::panels::Panels;
use crate::tour::Tour;
use crate::video::VideoPlan;
use crate::views::View;
use desk::Desk;
use display::Display;
use files::first_camera;
use frames::Track;
use pace::Pace;
use touch::Fingers;
use warm_up::WarmUp;

/// Settings of a viewer at its start.
#[derive(Clone, Debug)]
pub struct ViewerSettings {
    /// How the session renders. The viewer sets [`gs3::PipelineSettings::refine`] if it is a time. In [`gs3::Mode::Full`] the
    /// viewer interpolates as few frames as the target rate allows, at most [`gs3::PipelineSettings::in_between`] before each
    /// rendered one, and none unless it renders apart.
    pub session: SessionSettings,
    /// If there is a waker, frames are rendered in a thread of their own, so that pictures and panels follow each other
    /// meanwhile. The waker is woken when a frame is finished: the viewer is to step then. None in a browser.
    pub waker: Option<Waker>,
    /// Whether frames of a moving camera are native too where the machine makes them in half of the time between frames,
    /// or faster than reconstructed ones. Only if [`gs3::PipelineSettings::refine`] is a time.
    pub native_when_fast: bool,
    /// Target of displayed frames per second.
    pub fps: f64,
    /// The picture's size.
    pub size: Size,
}

/// A scene to show.
#[derive(Clone, Debug)]
pub enum Opened {
    /// A scene, with cameras if it came with some.
    Scene {
        /// Name of the scene.
        name: String,
        /// The scene.
        scene: Arc<Scene>,
        /// Its cameras.
        cameras: Option<CameraPath>,
    },
    /// The scene that is shown, with more Gaussians: the camera stays.
    Finer {
        /// The scene.
        scene: Arc<Scene>,
    },
    /// Cameras for the scene that is shown.
    Cameras {
        /// Name of the cameras.
        name: String,
        /// The cameras.
        path: CameraPath,
    },
}

/// Where a file is written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Destination {
    /// This path.
    File(PathBuf),
    /// The first free name of `stem-0001.extension` and so on.
    Numbered {
        /// The beginning of the name.
        stem: &'static str,
        /// The extension.
        extension: &'static str,
    },
}

impl std::fmt::Display for Destination {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::File(file) => write!(f, "{}", file.display()),
            Self::Numbered { stem, extension } => write!(f, "{stem}-NNNN.{extension}"),
        }
    }
}

/// Requests of the viewer to its surroundings.
#[derive(Clone, Debug, PartialEq)]
pub enum Effect {
    /// Asks the user for files, and answers with [`Input::Dropped`] for each, or with [`Viewer::not_chosen`].
    Choose,
    /// Opens a file or folder, and answers with [`Viewer::opened`].
    Open(PathBuf),
    /// Writes a file, and answers with [`Viewer::saved`].
    Save(Destination, Vec<u8>),
    /// Renders a video of the viewer's scene, tells [`Viewer::video_progress`], and answers with [`Viewer::video_ended`].
    Video(Destination, Box<VideoPlan>),
    /// Ends the video under way without a file.
    StopVideo,
}

/// A requested screenshot.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Shot {
    /// The file to write; none is a numbered file.
    pub file: Option<PathBuf>,
    /// Whether panels are in it.
    pub panels: bool,
    /// Scale relative to the picture. Screenshots larger than the picture are native frames, without panels and
    /// comparisons.
    pub scale: u32,
    /// The file for the camera, as a `camera_path.json`.
    pub camera: Option<PathBuf>,
}

/// When the next step is due.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// At this time, or at once if an input comes.
    At(Duration),
    /// Once an input comes.
    Idle,
}

/// The result of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// Whether [`Viewer::picture`] has changed.
    pub is_new: bool,
    /// When the next step is due.
    pub next: Next,
}

/// Why the viewer cannot start.
#[derive(Debug, thiserror::Error)]
pub enum ViewerError {
    /// There is no session.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// The picture's size is 0.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// There is no thread for rendering apart.
    #[error("viewer: no thread to render frames: {0}")]
    Thread(#[from] std::io::Error),
}

/// Progress of the frames of a resting camera.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Rest {
    /// The camera of the last frame made; none before the first frame and after a failed one.
    camera: Option<Camera>,
    /// Frames since the camera has been there.
    frames: usize,
    /// Whether one of them was the native image.
    is_native: bool,
}

/// The viewer without a window.
///
/// [`Viewer::input`] takes inputs at any time; they take effect in the next [`Viewer::step`]. A step moves the
/// camera, renders at most one frame and paints the panels. While a camera moves, pictures follow each other at the target
/// rate, and a frame has as many exact pixels as this rate leaves time for. Once the camera rests, frames continue until
/// the history holds every pixel. The native image follows. Then no step is due until an input comes. Where native frames
/// are fast ([`ViewerSettings::native_when_fast`]), frames of a moving camera are native as well.
///
/// If frames are rendered apart ([`ViewerSettings::waker`]), a step begins a frame and does not wait for it. A finished
/// frame brings its in-between frames, and all of them are shown one after the other, evenly, while the next frame is
/// rendered.
#[derive(Debug)]
pub struct Viewer {
    desk: Desk,
    warm_up: Option<WarmUp>,
    /// How the session renders.
    settings: SessionSettings,
    controls: Controls,
    bulk: Bulk,
    name: String,
    size: Size,
    scale: f32,
    interval: Duration,
    inputs: Vec<Input>,
    pointer: Option<[f32; 2]>,
    modifiers: Modifiers,
    drag: Option<Button>,
    fingers: Fingers,
    last_click: Option<(Duration, [f32; 2])>,
    /// Where the surface is to become the pivot.
    pivot_at: Option<[f32; 2]>,
    panels: Panels,
    view: View,
    compare: Compare,
    dividers: Dividers,
    tour: Tour,
    rest: Rest,
    native_when_fast: bool,
    pace: Pace,
    display: Display,
    track: Track,
    /// Whether the frame under way, or the last one, is followed by frames that can have others in between.
    is_followed: bool,
    /// Whether panels are to be painted again.
    is_unpainted: bool,
    /// When the picture was painted.
    painted: Duration,
    /// The camera of `frame`.
    camera: Option<Camera>,
    /// Pictures whose memory frames may use.
    spare: Vec<Framebuffer>,
    /// Whether the last frame failed, and nothing has happened since.
    has_failed: bool,
    /// Whether the shown part of the frame has changed, so that the picture must be composed again.
    is_stale: bool,
    /// Whether a step must paint panels in any case.
    is_woken: bool,
    is_idle: bool,
    figures: Figures,
    frame: Framebuffer,
    picture: Framebuffer,
    /// Seconds of a step that are not rendering.
    overhead: f64,
    memory: Option<u64>,
    message: Option<String>,
    note: Option<(String, Duration)>,
    is_hovering: bool,
    opening: Option<(String, f32)>,
    /// What the format of the path being saved has no place for.
    left_out: Vec<String>,
    /// Whether the surroundings make videos.
    has_videos: bool,
    /// The share of the video under way that is done.
    video: Option<f32>,
    shots: Vec<Shot>,
    effects: Vec<Effect>,
    last_step: Option<Duration>,
    due: Duration,
    next: Next,
    has_panels: bool,
}

impl Viewer {
    /// A viewer of `scene` with the name `name`. It starts at the first of `cameras`, or at a view of the whole
    /// scene.
    ///
    /// # Errors
    /// [`ViewerError`] if a setting is not supported, or the requested GPU does not exist; in a browser
    /// [`Self::new_async`] is for GPUs.
    pub fn new(
        name: &str,
        scene: Arc<Scene>,
        cameras: Option<&CameraPath>,
        settings: ViewerSettings,
    ) -> Result<Self, ViewerError> {
        let session = Session::new(scene, settings.session.clone())?;
        Self::of(name, session, None, cameras, &settings)
    }

    /// As [`Self::new`], without blocking a browser. If a GPU is to render, the CPU renders until the GPU has compiled its
    /// kernels.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub async fn new_async(
        name: &str,
        scene: Arc<Scene>,
        cameras: Option<&CameraPath>,
        settings: ViewerSettings,
    ) -> Result<Self, ViewerError> {
        let session = Session::open(scene, settings.session.clone()).await?;
        let (session, warm_up) = warm_up::begin(session, &settings.session, cameras, settings.size).await?;
        Self::of(name, session, warm_up, cameras, &settings)
    }

    fn of(
        name: &str,
        session: Session,
        warm_up: Option<WarmUp>,
        cameras: Option<&CameraPath>,
        settings: &ViewerSettings,
    ) -> Result<Self, ViewerError> {
        let &ViewerSettings { native_when_fast, fps, size, .. } = settings;
        let bulk = Bulk::of(session.scene());
        let controls = Controls::new(&first_camera(session.scene(), cameras, size)?, &bulk);
        Ok(Self {
            desk: Desk::new(session, settings.waker.clone())?,
            warm_up,
            settings: settings.session.clone(),
            controls,
            bulk,
            name: name.to_owned(),
            size,
            scale: 1.0,
            interval: interval(fps),
            inputs: Vec::new(),
            pointer: None,
            modifiers: Modifiers::default(),
            drag: None,
            fingers: Fingers::default(),
            last_click: None,
            pivot_at: None,
            panels: Panels::default(),
            view: View::default(),
            compare: Compare::default(),
            dividers: Dividers::default(),
            tour: cameras.map(Tour::along).unwrap_or_default(),
            rest: Rest::default(),
            native_when_fast,
            pace: Pace::default(),
            display: Display::default(),
            track: Track::default(),
            is_followed: false,
            is_unpainted: false,
            painted: Duration::ZERO,
            camera: None,
            spare: Vec::new(),
            has_failed: false,
            is_stale: true,
            is_woken: true,
            is_idle: false,
            figures: Figures::default(),
            frame: Framebuffer::default(),
            picture: Framebuffer::default(),
            overhead: 0.0,
            memory: None,
            message: None,
            note: None,
            is_hovering: false,
            opening: None,
            left_out: Vec::new(),
            has_videos: false,
            video: None,
            shots: Vec::new(),
            effects: Vec::new(),
            last_step: None,
            due: Duration::ZERO,
            next: Next::At(Duration::ZERO),
            has_panels: true,
        })
    }

    /// Reports the memory of the process, in bytes.
    pub const fn set_memory(&mut self, bytes: u64) {
        self.memory = Some(bytes);
    }

    /// The requests since the last call.
    pub fn take_effects(&mut self) -> Vec<Effect> {
        std::mem::take(&mut self.effects)
    }

    /// The picture of the last step, panels included.
    #[must_use]
    pub const fn picture(&self) -> &Framebuffer {
        &self.picture
    }

    /// The shown part of the frame, without panels.
    #[must_use]
    pub const fn frame(&self) -> &Framebuffer {
        &self.frame
    }

    /// The next picture's size.
    #[must_use]
    pub const fn size(&self) -> Size {
        self.size
    }

    /// Whether no more frames are made until an event comes.
    #[must_use]
    pub const fn is_idle(&self) -> bool {
        self.is_idle
    }

    /// The name of the scene shown.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Whether something is being opened.
    #[must_use]
    pub const fn is_opening(&self) -> bool {
        self.opening.is_some()
    }

    /// The camera of the picture shown.
    #[must_use]
    pub const fn camera(&self) -> Option<Camera> {
        self.camera
    }

    /// The place of the camera, and its pivot.
    #[must_use]
    pub const fn rig(&self) -> &Rig {
        self.controls.shown()
    }

    /// The upward direction, of length 1.
    #[must_use]
    pub const fn up(&self) -> DVec3 {
        self.controls.up()
    }

    /// Moves the camera to `rig` at once.
    pub fn look(&mut self, rig: Rig) {
        self.tour.stop();
        self.controls.jump(rig);
        (self.is_woken, self.has_failed) = (true, false);
    }

    /// Whether panels, notes and messages lie over the picture; they do from the beginning.
    pub const fn set_panels(&mut self, are_shown: bool) {
        (self.has_panels, self.is_woken) = (are_shown, true);
    }

    /// The message that is shown, if there is one.
    #[must_use]
    pub fn message(&self) -> Option<&str> {
        self.message.as_deref()
    }

    /// What has been done, while the note of it is shown.
    #[must_use]
    pub fn note(&self) -> Option<&str> {
        self.note.as_ref().map(|(note, _)| note.as_str())
    }

    /// The keyframes.
    #[must_use]
    pub const fn tour(&self) -> &Tour {
        &self.tour
    }

    /// How fast frames come.
    #[must_use]
    pub const fn figures(&self) -> &Figures {
        &self.figures
    }

    /// Number of Gaussians of the scene shown.
    #[must_use]
    pub fn gaussians(&self) -> usize {
        self.scene().gaussians().len()
    }

    /// The target time from one displayed frame to the next.
    #[must_use]
    pub const fn interval(&self) -> Duration {
        self.interval
    }

    /// The scene shown.
    #[must_use]
    pub fn scene(&self) -> Arc<Scene> {
        self.desk.status().scene
    }

    /// The machine that renders.
    #[must_use]
    pub fn backend(&self) -> Backend {
        self.desk.status().backend
    }

    /// How the viewer was asked to render.
    #[must_use]
    pub const fn session_settings(&self) -> &SessionSettings {
        &self.settings
    }
}

/// The time from one displayed frame to the next. A rate that is not valid counts as 30 a second.
fn interval(fps: f64) -> Duration {
    let fps = if fps.is_finite() { fps.clamp(1.0, 1000.0) } else { 30.0 };
    Duration::from_secs_f64(1.0 / fps)
}
