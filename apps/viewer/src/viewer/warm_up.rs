//! Frames of the CPU until a GPU has compiled its kernels.

use std::fmt;
use std::future::Future;
use std::pin::Pin;
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use gs3::scene::{CameraError, CameraPath};
use gs3::{Backend, Mode, PipelineError, Session, SessionSettings};

use super::files::first_camera;
use super::{Viewer, ViewerError};

/// Width and height of the frames of a warm-up: kernels do not depend on the size.
const SIZE: [u32; 2] = [64, 36];

/// Frames that use all kernels of a moving camera: without history, with one, and with exact pixels.
const FRAMES: usize = 3;

/// A session on a GPU that renders its first frames, unseen. Drivers compile kernels at their first use, and a browser's
/// GPU may take many seconds for all of them.
pub(super) struct WarmUp(Pin<Box<dyn Future<Output = Result<Session, PipelineError>>>>);

impl fmt::Debug for WarmUp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("WarmUp").finish_non_exhaustive()
    }
}

impl WarmUp {
    /// The warm-up of `session`, which shows any scene.
    fn of(mut session: Session, cameras: Option<&CameraPath>) -> Result<Self, CameraError> {
        let camera = first_camera(session.scene(), cameras, SIZE)?;
        let warmed = async move {
            for _ in 0..FRAMES {
                session.render_async(&camera).await?;
            }
            session.reference_async(Mode::Native, &camera).await?;
            Ok(session)
        };
        Ok(Self(Box::pin(warmed)))
    }

    /// The session, once it is ready. Natively the first call waits.
    fn poll(&mut self) -> Option<Result<Session, PipelineError>> {
        // The viewer asks again with its next step.
        match self.0.as_mut().poll(&mut Context::from_waker(Waker::noop())) {
            Poll::Ready(session) => Some(session),
            Poll::Pending => None,
        }
    }
}

/// The session that shows frames first, and the warm-up of `session` if that is on a GPU.
pub(super) async fn begin(
    session: Session,
    settings: &SessionSettings,
    cameras: Option<&CameraPath>,
) -> Result<(Session, Option<WarmUp>), ViewerError> {
    if session.backend() != Backend::Gpu {
        return Ok((session, None));
    }
    let on_cpu = SessionSettings { backend: Backend::Cpu, ..settings.clone() };
    let first = Session::open(session.scene().clone(), on_cpu).await?;
    Ok((first, Some(WarmUp::of(session, cameras)?)))
}

impl Viewer {
    /// Whether the CPU renders until the GPU is ready.
    pub(super) const fn is_warming_up(&self) -> bool {
        self.warm_up.is_some()
    }

    /// Goes on with the GPU if the GPU is ready. If the GPU has failed, the CPU goes on, and a message says so.
    pub(super) fn change_over(&mut self, now: Duration) {
        let Some(warmed) = self.warm_up.as_mut().and_then(WarmUp::poll) else { return };
        self.warm_up = None;
        let scene = self.scene();
        let shows_scene = warmed.and_then(|mut session| session.set_scene(scene).map(|()| session));
        match shows_scene {
            Ok(session) => {
                self.wait_for_frame(now);
                *self.desk.session() = session;
                self.forget_frames();
            }
            Err(error) => self.message = Some(format!("{error}; the CPU renders")),
        }
        self.is_woken = true;
    }
}
