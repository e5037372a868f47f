//! Frames of the CPU until a GPU has compiled its kernels.

use std::fmt;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use gs3::scene::{Camera, CameraPath, Size};
use gs3::{Backend, Mode, PipelineError, ResetReason, Session, SessionSettings};

use super::files::first_camera;
use super::{Viewer, ViewerError};

/// Unseen frames: without history, and with one.
const FRAMES: usize = 2;

/// Most Gaussians of a scene that the CPU renders meanwhile. A visible one takes about 100 bytes, so a frame takes 400 MB of the
/// 4 GB that a browser's page has at most. Larger scenes wait for the GPU.
const MOST_GAUSSIANS: usize = 4_000_000;

/// The future of a session that is ready. Natively a viewer may be sent to another thread, so the future must be `Send`.
#[cfg(not(target_arch = "wasm32"))]
type Ready = dyn Future<Output = Result<Session, PipelineError>> + Send;
#[cfg(target_arch = "wasm32")]
type Ready = dyn Future<Output = Result<Session, PipelineError>>;

/// A session on a GPU that renders its first frames, unseen. Drivers compile kernels at their first use, and a browser's
/// GPU may take many seconds for all of them. (The kernels that sort depend on the size. They are compiled anew for another
/// size.)
pub(super) struct WarmUp(Pin<Box<Ready>>);

impl fmt::Debug for WarmUp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("WarmUp").finish_non_exhaustive()
    }
}

impl WarmUp {
    /// The warm-up of `session` with frames of `camera`.
    fn of(mut session: Session, camera: Camera) -> Self {
        Self(Box::pin(async move {
            for _ in 0..FRAMES {
                session.render_async(&camera).await?;
            }
            session.reference_async(Mode::Native, &camera).await?;
            session.reset(ResetReason::CameraCut);
            Ok(session)
        }))
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

/// The session that shows frames first. A `session` on a GPU gets a warm-up.
pub(super) async fn begin(
    session: Session,
    settings: &SessionSettings,
    cameras: Option<&CameraPath>,
    size: Size,
) -> Result<(Session, Option<WarmUp>), ViewerError> {
    if session.backend() != Backend::Gpu {
        return Ok((session, None));
    }
    let on_cpu = SessionSettings { backend: Backend::Cpu, ..settings.clone() };
    let first = Session::open(Arc::clone(session.scene()), on_cpu).await?;
    let camera = first_camera(session.scene(), cameras, size)?;
    Ok((first, Some(WarmUp::of(session, camera))))
}

impl Viewer {
    /// Whether the CPU renders until the GPU is ready.
    pub(super) const fn is_warming_up(&self) -> bool {
        self.warm_up.is_some()
    }

    /// Whether the scene is too large for the CPU, and a GPU is soon ready.
    pub(super) fn waits_for_gpu(&self) -> bool {
        self.is_warming_up() && self.gaussians() > MOST_GAUSSIANS
    }

    /// Goes on with the GPU if the GPU is ready. If the GPU has failed, the CPU goes on, and a message says so.
    pub(super) fn change_over(&mut self, now: Duration) {
        let Some(warmed) = self.warm_up.as_mut().and_then(WarmUp::poll) else { return };
        self.warm_up = None;
        if let Err(error) = warmed.and_then(|session| self.go_on_with(session, now)) {
            self.message = Some(format!("{error}; the CPU renders"));
        }
        self.is_woken = true;
    }

    /// Renders with `session` from now on. A session of another scene is first made ready for the scene that is shown.
    fn go_on_with(&mut self, mut session: Session, now: Duration) -> Result<(), PipelineError> {
        let scene = self.scene();
        if !Arc::ptr_eq(session.scene(), &scene)
            && let Ok(camera) = self.controls.shown().camera(self.size)
        {
            session.set_scene(scene)?;
            self.warm_up = Some(WarmUp::of(session, camera));
            return Ok(());
        }
        self.wait_for_frame(now);
        *self.desk.session() = session;
        self.forget_frames();
        Ok(())
    }
}
