//! The thread that renders a video, while the window lives on.

use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use gs3::scene::Scene;
use gs3::{PipelineError, Session, SessionSettings};
use gs3_files::AtomicFile;
use gs3_video::{VideoError, VideoWriter};
use rayon::ThreadPoolBuilder;

use super::files;
use crate::video::VideoPlan;
use crate::viewer::Destination;

/// What to render, and where to.
#[derive(Debug)]
pub struct Job {
    /// The scene that the viewer shows.
    pub scene: Arc<Scene>,
    /// How the viewer's session renders: networks and machine are the same for the video.
    pub session: SessionSettings,
    /// The frames.
    pub plan: VideoPlan,
    /// The MP4 file.
    pub place: Destination,
}

/// What the thread tells.
#[derive(Debug)]
pub enum Told {
    /// The share that is done.
    Progress(f32),
    /// A notice for the user: that the CPU took over from a GPU.
    Notice(String),
    /// The end: the file, none if the video was stopped, or why there is none.
    Ended(Result<Option<PathBuf>, String>),
}

/// Why there is no video.
#[derive(Debug, thiserror::Error)]
enum VideoFault {
    #[error(transparent)]
    Frame(#[from] PipelineError),
    #[error(transparent)]
    Video(#[from] VideoError),
    #[error(transparent)]
    Threads(#[from] rayon::ThreadPoolBuildError),
    #[error(transparent)]
    Io(#[from] io::Error),
    /// No numbered name is free.
    #[error("{0}")]
    Name(String),
}

/// A video under way. Dropped, it stops after the frame that is being made, and leaves no file.
#[derive(Debug)]
pub struct Rendering {
    is_stopped: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Rendering {
    /// Begins `job` in a thread of its own, which calls `tell`. [`Told::Ended`] is the last call.
    ///
    /// # Errors
    /// What the system reports if there is no thread.
    pub fn start(job: Job, tell: impl Fn(Told) + Send + Sync + 'static) -> io::Result<Self> {
        let is_stopped = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&is_stopped);
        let work = move || {
            let name = job.place.to_string();
            // A fault of this program must not leave a video that never ends.
            let ended = catch_unwind(AssertUnwindSafe(|| render(&job, &stopped, &tell)));
            let ended = ended
                .unwrap_or_else(|_| Err(VideoFault::Name("internal error; please report it".to_owned())));
            tell(Told::Ended(ended.map_err(|fault| format!("{name}: the video cannot be written: {fault}"))));
        };
        let thread = std::thread::Builder::new().name("video".to_owned()).spawn(work)?;
        Ok(Self { is_stopped, thread: Some(thread) })
    }

    /// Asks the thread to end without a file.
    pub fn stop(&self) {
        self.is_stopped.store(true, Ordering::Relaxed);
    }
}

impl Drop for Rendering {
    fn drop(&mut self) {
        self.stop();
        if let Some(thread) = self.thread.take() {
            // The temporary file goes with the thread. Its panics are caught.
            _ = thread.join();
        }
    }
}

/// Renders all of `job`: the file, or none if it was stopped.
fn render(
    job: &Job,
    is_stopped: &AtomicBool,
    tell: &(dyn Fn(Told) + Sync),
) -> Result<Option<PathBuf>, VideoFault> {
    // First, since it is quick: a place that cannot be written to.
    let file = AtomicFile::create(&beginning(&job.place))?;
    // Threads of its own: in the window's pool, the window's frames would wait for whole stages of the video's.
    let pool = ThreadPoolBuilder::new().num_threads(rayon::current_num_threads()).build()?;
    pool.install(|| frames(job, file, is_stopped, tell))
}

fn frames(
    job: &Job,
    file: AtomicFile,
    is_stopped: &AtomicBool,
    tell: &(dyn Fn(Told) + Sync),
) -> Result<Option<PathBuf>, VideoFault> {
    let VideoPlan { path, settings, rate } = &job.plan;
    let session = SessionSettings { pipeline: *settings, ..job.session.clone() };
    let mut session = Session::new(Arc::clone(&job.scene), session)?;
    let first = path.cameras()[0];
    let count = path.cameras().len();
    let shown_in_all = (count - 1) * settings.displayed_per_rendered() + 1;
    let mut video = VideoWriter::new(file, first.size().to_array(), *rate, shown_in_all)?;
    session.begin_at(0);
    for (k, camera) in path.cameras().iter().enumerate() {
        if is_stopped.load(Ordering::Relaxed) {
            return Ok(None);
        }
        let shown = session.render_with_poses(camera, &settings.poses_between(path, k))?;
        // There is no frame before the first one, and so none between.
        let between = if k == 0 { 0 } else { shown.iter().count() - 1 };
        for image in shown.iter().take(between).chain([shown.current]) {
            video.write(&image.to_rgb8())?;
        }
        session.take_notices().into_iter().for_each(|notice| tell(Told::Notice(notice)));
        tell(Told::Progress((k + 1) as f32 / count as f32));
    }
    let file = video.finish()?;
    let path = match &job.place {
        Destination::File(path) => {
            file.commit()?;
            path.clone()
        }
        Destination::Numbered { stem, extension } => {
            let path = files::claim(stem, extension).map_err(VideoFault::Name)?;
            if let Err(error) = file.commit_as(&path) {
                files::give_up(&path);
                return Err(error.into());
            }
            path
        }
    };
    Ok(Some(path))
}

/// Where the file begins: a numbered one gets its number when it is whole.
fn beginning(place: &Destination) -> PathBuf {
    match place {
        Destination::File(file) => file.clone(),
        Destination::Numbered { stem, extension } => Path::new(stem).with_extension(extension),
    }
}
