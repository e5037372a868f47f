//! The session, here or in the thread that renders with it.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, TryRecvError};
use std::task::Waker;
use std::thread::JoinHandle;
use std::time::Duration;

use gs3::scene::Scene;
use gs3::{Backend, Session, StageTimes};

use super::job::{Finished, Job};

/// What a session says about itself and its last frame.
#[derive(Clone, Debug)]
pub(super) struct Status {
    pub scene: Arc<Scene>,
    pub backend: Backend,
    /// The GPU, if one renders.
    pub adapter: Option<String>,
    /// Frames that a resting camera takes until the history holds every pixel.
    pub period: usize,
    /// HR size over LR size of the last frame.
    pub scale: u32,
    /// The stages of the last frame.
    pub times: StageTimes,
    /// The share of its pixels that are exact.
    pub exact_share: f32,
    /// The Gaussians that it shows, if a CPU made it.
    pub visible: Option<usize>,
}

impl Status {
    fn of(session: &Session) -> Self {
        let pipeline = session.pipeline();
        Self {
            scene: Arc::clone(session.scene()),
            backend: session.backend(),
            adapter: session.adapter(),
            period: pipeline.jitter_period(),
            scale: pipeline.scale(),
            times: pipeline.times(),
            exact_share: pipeline.refined_share(),
            visible: pipeline.visible_count(),
        }
    }
}

/// A thread that does jobs with the session that comes with each, and gives the session back.
#[derive(Debug)]
struct Worker {
    /// None once the thread is to end.
    jobs: Option<Sender<(Box<Session>, Job)>>,
    ended: Receiver<(Box<Session>, Finished)>,
    thread: Option<JoinHandle<()>>,
}

impl Worker {
    /// No worker: a page steps the viewer in a worker of its own, and waits for nothing there but promises.
    #[cfg(target_arch = "wasm32")]
    fn start(_: Waker) -> std::io::Result<Self> {
        Err(std::io::ErrorKind::Unsupported.into())
    }

    /// A worker that wakes `waker` after each job.
    #[cfg(not(target_arch = "wasm32"))]
    fn start(waker: Waker) -> std::io::Result<Self> {
        let (jobs, waiting) = std::sync::mpsc::channel::<(Box<Session>, Job)>();
        let (done, ended) = std::sync::mpsc::channel();
        let work = move || {
            let started = std::time::Instant::now();
            for (mut session, job) in waiting {
                let finished = pollster::block_on(job.run(&mut session, &|| started.elapsed()));
                if done.send((session, finished)).is_err() {
                    // The viewer is gone.
                    return;
                }
                waker.wake_by_ref();
            }
        };
        let thread = std::thread::Builder::new().name("render".to_owned()).spawn(work)?;
        Ok(Self { jobs: Some(jobs), ended, thread: Some(thread) })
    }

    /// Goes on with the panic that ended the thread: the thread ends in no other way while the viewer lives.
    fn fail(&mut self) -> ! {
        let panic = self.thread.take().and_then(|thread| thread.join().err());
        std::panic::resume_unwind(panic.unwrap_or_else(|| Box::new("the thread that renders has ended")))
    }
}

/// Waits for the job under way: a driver is not left alone with it.
impl Drop for Worker {
    fn drop(&mut self) {
        self.jobs = None;
        if let Some(thread) = self.thread.take() {
            // A panic has been told by the thread.
            _ = thread.join();
        }
    }
}

/// Renders with a session, one job after the other: here, or in a thread of its own, so that the viewer goes on meanwhile.
/// Whatever else needs the session waits for the end of the job under way.
#[derive(Debug)]
pub(super) struct Desk {
    /// None while the worker renders with the session.
    session: Option<Box<Session>>,
    worker: Option<Worker>,
    /// The job that has ended, until the viewer asks for it.
    finished: Option<Finished>,
    /// What the session said when it left.
    status: Status,
}

impl Desk {
    /// A desk for `session`, with a thread of its own if there is a waker, which is woken after each job.
    ///
    /// # Errors
    /// If there is no thread.
    pub fn new(session: Session, waker: Option<Waker>) -> std::io::Result<Self> {
        let worker = waker.map(Worker::start).transpose()?;
        let status = Status::of(&session);
        Ok(Self { session: Some(Box::new(session)), worker, finished: None, status })
    }

    /// Whether jobs are done in a thread of their own.
    pub const fn is_apart(&self) -> bool {
        self.worker.is_some()
    }

    /// Whether a job is under way, or has ended and was not asked for.
    pub const fn is_busy(&self) -> bool {
        self.session.is_none() || self.finished.is_some()
    }

    /// Begins `job`; without a thread, also ends it. No other job may be under way.
    pub async fn begin(&mut self, job: Job, clock: &dyn Fn() -> Duration) {
        if let Some(worker) = &mut self.worker {
            let Some(session) = self.session.take() else { return };
            self.status = Status::of(&session);
            let is_sent = worker.jobs.as_ref().is_some_and(|jobs| jobs.send((session, job)).is_ok());
            if !is_sent {
                worker.fail();
            }
            return;
        }
        let finished = job.run(self.session(), clock).await;
        self.finished = Some(finished);
    }

    /// The job that has ended since the last call.
    pub fn finished(&mut self) -> Option<Finished> {
        if let (None, Some(worker)) = (&self.session, &mut self.worker) {
            match worker.ended.try_recv() {
                Ok((session, finished)) => {
                    (self.session, self.finished) = (Some(session), Some(finished));
                }
                Err(TryRecvError::Empty) => {}
                Err(TryRecvError::Disconnected) => worker.fail(),
            }
        }
        self.finished.take()
    }

    /// The session, after the job under way.
    pub fn session(&mut self) -> &mut Session {
        let Self { session, worker, finished, .. } = self;
        session.get_or_insert_with(|| {
            // Only a worker takes the session.
            let Some(worker) = worker else { std::panic::resume_unwind(Box::new("no session")) };
            match worker.ended.recv() {
                Ok((session, ended)) => {
                    *finished = Some(ended);
                    session
                }
                Err(_) => worker.fail(),
            }
        })
    }

    /// What the session says, or said before the job under way.
    pub fn status(&self) -> Status {
        self.session.as_deref().map_or_else(|| self.status.clone(), Status::of)
    }
}
