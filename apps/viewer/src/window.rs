//! The native window: winit's events come in, the CPU's pixels go out, and files are read and written in threads.

mod dialog;
mod files;
mod input;
mod url;
mod video;

use std::collections::VecDeque;
use std::num::NonZeroU32;
use std::path::PathBuf;
use std::rc::Rc;
use std::sync::Arc;
use std::task::{Wake, Waker};
use std::time::{Duration, Instant};

use gs3::scene::{CameraPath, Scene, Size};
use softbuffer::{Context, Surface};
use winit::application::ApplicationHandler;
use winit::dpi::PhysicalSize;
use winit::event::WindowEvent;
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop, EventLoopProxy, OwnedDisplayHandle};
use winit::window::{Window, WindowId};

use crate::input::Input;
use crate::paint::Framebuffer;
use crate::script::{Playing, Script, ScriptFailure};
use crate::viewer::{Effect, Next, Opened, Viewer, ViewerError, ViewerSettings};

/// How often the memory of the process is measured.
const MEMORY_EVERY: Duration = Duration::from_secs(1);

/// Settings of the window.
#[derive(Clone, Debug)]
pub struct WindowSettings {
    /// Name of the scene.
    pub name: String,
    /// The scene.
    pub scene: Arc<Scene>,
    /// Cameras; without them, the whole scene is in view.
    pub cameras: Option<CameraPath>,
    /// Settings of the viewer. The window always renders apart, with a waker of its own.
    pub viewer: ViewerSettings,
    /// Files and URLs to open at the start, one after the other.
    pub open: Vec<PathBuf>,
    /// Gaussians of a streamed scene from a URL at most; none for its finest levels.
    pub budget: Option<u64>,
    /// The script to play at the start.
    pub script: Option<Script>,
}

pub use url::url_of;

/// Why a window cannot open, or ends early.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WindowError {
    /// There is no display, or it refuses.
    #[error("window: expected a display (DISPLAY or WAYLAND_DISPLAY), found {message}")]
    Display {
        /// The system's message.
        message: String,
    },
    /// Pixels do not reach the window.
    #[error("window: pixels cannot be shown: {message}")]
    Surface {
        /// The system's message.
        message: String,
    },
    /// The viewer cannot start.
    #[error(transparent)]
    Viewer(#[from] ViewerError),
    /// Something differs from the script's expectations.
    #[error("script: {0}")]
    Script(#[from] ScriptFailure),
    /// A file that a script asks for could not be written.
    #[error("script: {message}")]
    Save {
        /// The file, and the reason.
        message: String,
    },
}

/// Opens a window and shows the scene until the window is closed or the script ends.
///
/// # Errors
/// [`WindowError`] without a display or a machine that renders, and if something differs from a script's
/// expectations.
pub fn run(settings: WindowSettings) -> Result<(), WindowError> {
    let display = |e: &dyn std::fmt::Display| WindowError::Display { message: e.to_string() };
    let WindowSettings { name, scene, cameras, viewer, open, budget, script } = settings;
    let size = viewer.size;
    let events = EventLoop::<Loaded>::with_user_event().build().map_err(|e| display(&e))?;
    let waker = Waker::from(Arc::new(Awaker(events.create_proxy())));
    let viewer = ViewerSettings { waker: Some(waker), ..viewer };
    let mut viewer = Viewer::new(&name, scene, cameras.as_ref(), viewer)?;
    open.into_iter().for_each(|place| viewer.input(Input::Dropped(place)));
    let context = Context::new(events.owned_display_handle()).map_err(|e| display(&e))?;
    let mut shell = Shell {
        proxy: events.create_proxy(),
        context,
        window: None,
        viewer,
        script,
        script_due: Duration::ZERO,
        size,
        started: Instant::now(),
        next: Next::At(Duration::ZERO),
        memory_due: Duration::ZERO,
        queue: VecDeque::new(),
        budget,
        is_loading: false,
        is_choosing: false,
        video: None,
        failed: None,
    };
    shell.viewer.offer_videos();
    events.run_app(&mut shell).map_err(|e| display(&e))?;
    // The window goes at once; a video under way ends after its frame.
    (shell.window, shell.video) = (None, None);
    shell.failed.map_or(Ok(()), Err)
}

/// Wakes the window when a frame is finished.
struct Awaker(EventLoopProxy<Loaded>);

impl Wake for Awaker {
    fn wake(self: Arc<Self>) {
        // The window may be closed already.
        _ = self.0.send_event(Loaded::Frame);
    }
}

/// Messages of the threads that render, read files, ask for files and render videos.
#[derive(Debug)]
enum Loaded {
    /// A frame is finished.
    Frame,
    Progress(f32),
    /// The coarsest levels of a streamed scene; finer ones follow.
    Coarse(Opened),
    Done(Result<Opened, String>),
    Chosen(Result<Vec<PathBuf>, String>),
    Video(video::Told),
}

struct Shell {
    proxy: EventLoopProxy<Loaded>,
    context: Context<OwnedDisplayHandle>,
    window: Option<Shown>,
    viewer: Viewer,
    script: Option<Script>,
    /// When the script goes on.
    script_due: Duration,
    size: Size,
    started: Instant,
    next: Next,
    memory_due: Duration,
    /// Files and URLs that wait to be read.
    queue: VecDeque<PathBuf>,
    /// See [`WindowSettings::budget`].
    budget: Option<u64>,
    is_loading: bool,
    /// Whether a file dialog is open.
    is_choosing: bool,
    /// The video under way.
    video: Option<video::Rendering>,
    failed: Option<WindowError>,
}

/// A window and its pixels.
struct Shown {
    window: Rc<Window>,
    surface: Surface<OwnedDisplayHandle, Rc<Window>>,
}

impl ApplicationHandler<Loaded> for Shell {
    fn resumed(&mut self, events: &ActiveEventLoop) {
        if self.window.is_some() {
            return;
        }
        match self.open(events) {
            Ok(shown) => {
                let size = shown.window.inner_size();
                self.viewer.input(Input::Resized(Size::new(size.width, size.height)));
                self.viewer.input(Input::Scale(shown.window.scale_factor() as f32));
                self.window = Some(shown);
            }
            Err(error) => self.fail(events, error),
        }
    }

    fn window_event(&mut self, events: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        match &event {
            WindowEvent::CloseRequested => return events.exit(),
            // The window system lost the pixels.
            WindowEvent::RedrawRequested => return self.show(events),
            _ => {}
        }
        for input in input::inputs(&event) {
            self.viewer.input(input);
            // Input wakes the viewer within this round.
            self.next = Next::At(Duration::ZERO);
        }
    }

    fn user_event(&mut self, events: &ActiveEventLoop, loaded: Loaded) {
        match loaded {
            Loaded::Frame => {}
            Loaded::Progress(share) => self.viewer.progress(share),
            Loaded::Coarse(opened) => {
                if self.viewer.opened(Ok(opened), self.started.elapsed()) {
                    let name = self.viewer.name().to_owned();
                    self.viewer.expect(&name);
                }
            }
            Loaded::Done(opened) => {
                self.is_loading = false;
                self.viewer.opened(opened, self.started.elapsed());
                self.load_next();
            }
            Loaded::Chosen(chosen) => {
                self.is_choosing = false;
                match chosen {
                    Ok(files) => {
                        files.into_iter().for_each(|file| self.viewer.input(Input::Dropped(file)));
                    }
                    Err(message) => self.viewer.not_chosen(message),
                }
            }
            Loaded::Video(told) => self.hear_of_video(events, told),
        }
        self.next = Next::At(Duration::ZERO);
    }

    fn about_to_wait(&mut self, events: &ActiveEventLoop) {
        if self.window.is_none() || events.exiting() {
            return;
        }
        if self.is_due() {
            self.round(events);
        }
        events.set_control_flow(match self.next {
            Next::Idle => ControlFlow::Wait,
            Next::At(due) => ControlFlow::WaitUntil(self.started + due),
        });
    }
}

impl Shell {
    fn open(&self, events: &ActiveEventLoop) -> Result<Shown, WindowError> {
        let size = PhysicalSize::new(self.size.width, self.size.height);
        let attributes = Window::default_attributes().with_title("gs3").with_inner_size(size);
        let window =
            events.create_window(attributes).map_err(|e| WindowError::Display { message: e.to_string() })?;
        let window = Rc::new(window);
        let surface = Surface::new(&self.context, Rc::clone(&window))
            .map_err(|e| WindowError::Surface { message: e.to_string() })?;
        Ok(Shown { window, surface })
    }

    fn fail(&mut self, events: &ActiveEventLoop, error: WindowError) {
        self.failed.get_or_insert(error);
        events.exit();
    }

    fn is_due(&self) -> bool {
        matches!(self.next, Next::At(due) if due <= self.started.elapsed())
    }

    /// One round: the script's inputs, a step, the picture, files.
    fn round(&mut self, events: &ActiveEventLoop) {
        let before = self.started.elapsed();
        if let Some(script) = self.script.as_mut().filter(|_| before >= self.script_due) {
            // A script goes on at the pace of pictures, also at rest.
            self.script_due = before + self.viewer.interval();
            match script.tick(&mut self.viewer) {
                Ok(Playing::On) => {}
                Ok(Playing::Over) => self.script = None,
                Ok(Playing::End) => return events.exit(),
                Err(failure) => return self.fail(events, failure.into()),
            }
        }
        if before >= self.memory_due {
            self.memory_due = before + MEMORY_EVERY;
            if let Some(bytes) = files::memory() {
                self.viewer.set_memory(bytes);
            }
        }
        let started = self.started;
        let step = self.viewer.step(&|| started.elapsed());
        self.next = step.next;
        if step.is_new {
            let stepped = started.elapsed();
            self.show(events);
            self.viewer.presented(started.elapsed().saturating_sub(stepped));
        }
        for effect in self.viewer.take_effects() {
            self.carry_out(events, effect);
        }
        if self.script.is_some() {
            self.next = match self.next {
                Next::At(due) => Next::At(due.min(self.script_due)),
                Next::Idle => Next::At(self.script_due),
            };
        }
    }

    fn carry_out(&mut self, events: &ActiveEventLoop, effect: Effect) {
        match effect {
            Effect::Open(file) => {
                self.queue.push_back(file);
                self.load_next();
            }
            Effect::Save(place, bytes) => {
                let saved = files::save(&place, &bytes);
                if let (Some(_), Err(message)) = (&self.script, &saved) {
                    return self.fail(events, WindowError::Save { message: message.clone() });
                }
                self.viewer.saved(saved, self.started.elapsed());
                self.next = Next::At(Duration::ZERO);
            }
            Effect::Choose => self.choose(),
            Effect::Video(place, plan) => {
                let (scene, settings) = (self.viewer.scene(), self.viewer.session_settings().clone());
                let proxy = self.proxy.clone();
                // The window may be closed already.
                let tell = move |told| _ = proxy.send_event(Loaded::Video(told));
                let job = video::Job { scene, session: settings, plan: *plan, place };
                match video::Rendering::start(job, tell) {
                    Ok(rendering) => self.video = Some(rendering),
                    Err(error) => {
                        let message = format!("no thread to render the video: {error}");
                        self.hear_of_video(events, video::Told::Ended(Err(message)));
                    }
                }
            }
            Effect::StopVideo => self.video.iter().for_each(video::Rendering::stop),
        }
    }

    fn hear_of_video(&mut self, events: &ActiveEventLoop, told: video::Told) {
        match told {
            video::Told::Progress(share) => self.viewer.video_progress(share),
            video::Told::Notice(notice) => self.viewer.notify(notice, self.started.elapsed()),
            video::Told::Ended(ended) => {
                self.video = None;
                if let (Some(_), Err(message)) = (&self.script, &ended) {
                    return self.fail(events, WindowError::Save { message: message.clone() });
                }
                self.viewer.video_ended(ended, self.started.elapsed());
            }
        }
    }

    /// Asks for files in a dialog of the system. The thread waits for the user; the window does not.
    fn choose(&mut self) {
        let Some(shown) = self.window.as_ref().filter(|_| !self.is_choosing) else { return };
        let proxy = self.proxy.clone();
        let asked = dialog::ask(&shown.window, move |chosen| _ = proxy.send_event(Loaded::Chosen(chosen)));
        match asked {
            Ok(()) => self.is_choosing = true,
            Err(error) => self.viewer.not_chosen(format!("no thread for the file dialog: {error}")),
        }
    }

    /// Reads the next waiting file in a thread of its own, so that the window stays responsive.
    fn load_next(&mut self) {
        if self.is_loading {
            return;
        }
        let Some(file) = self.queue.pop_front() else { return };
        let (proxy, size, budget) = (self.proxy.clone(), self.viewer.size(), self.budget);
        let load = move || {
            // The window may be closed already.
            let progress = |share| _ = proxy.send_event(Loaded::Progress(share));
            let coarse = |opened| _ = proxy.send_event(Loaded::Coarse(opened));
            let opened = match url_of(&file) {
                Some(url) => url::open(url, size, budget, url::PATIENCE, &progress, &coarse),
                None => files::open(&file, size, &progress),
            };
            _ = proxy.send_event(Loaded::Done(opened));
        };
        match std::thread::Builder::new().name("open".to_owned()).spawn(load) {
            Ok(_) => self.is_loading = true,
            Err(error) => {
                let message = format!("no thread to read the file: {error}");
                self.viewer.opened(Err(message), self.started.elapsed());
            }
        }
    }

    fn show(&mut self, events: &ActiveEventLoop) {
        let Some(shown) = &mut self.window else { return };
        if let Err(message) = shown.show(self.viewer.picture()) {
            self.fail(events, WindowError::Surface { message });
        }
    }
}

impl Shown {
    /// Shows `picture` in the top left corner of the window: while the window is resized, the picture has another
    /// size for a frame.
    fn show(&mut self, picture: &Framebuffer) -> Result<(), String> {
        let size = self.window.inner_size();
        let (Some(width), Some(height)) = (NonZeroU32::new(size.width), NonZeroU32::new(size.height)) else {
            return Ok(());
        };
        self.surface.resize(width, height).map_err(|e| e.to_string())?;
        let mut buffer = self.surface.buffer_mut().map_err(|e| e.to_string())?;
        let (width, columns) = (size.width as usize, picture.size[0].min(size.width as usize));
        for (y, row) in buffer.chunks_exact_mut(width).enumerate() {
            let rest = if y < picture.size[1] {
                let from = y * picture.size[0];
                row[..columns].copy_from_slice(&picture.pixels[from..from + columns]);
                columns
            } else {
                0
            };
            row[rest..].fill(0);
        }
        self.window.pre_present_notify();
        buffer.present().map_err(|e| e.to_string())
    }
}
