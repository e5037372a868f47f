//! Waiting for a device: natively within a call, in a browser by its event loop.

use std::pin::pin;
use std::task::{Context, Poll, Waker};

use crate::error::GpuError;

/// The result of a future of this crate, or of a future that awaits nothing else. Natively such a future waits for the
/// device within its first poll. In a browser it may have to wait for the event loop, and a call cannot.
///
/// # Errors
/// Those of `future`; [`GpuError::WouldBlock`] if it is not ready.
pub fn now<T, E: From<GpuError>>(future: impl Future<Output = Result<T, E>>) -> Result<T, E> {
    at_once(future).unwrap_or_else(|| Err(GpuError::WouldBlock.into()))
}

/// The result of `future`, if it is ready at its first poll.
pub fn at_once<T>(future: impl Future<Output = T>) -> Option<T> {
    match pin!(future).poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(result) => Some(result),
        Poll::Pending => None,
    }
}

/// Where an answer of the device goes, and where it is awaited.
#[cfg(not(target_arch = "wasm32"))]
pub fn answer<T>() -> (impl FnOnce(T), impl Future<Output = Option<T>>)
where
    T: Send + 'static,
{
    /// How long the answer to a finished submission may take: far longer than a thread that has it ever sleeps.
    const LONGEST: std::time::Duration = std::time::Duration::from_secs(30);

    let (sender, receiver) = std::sync::mpsc::channel();
    let tell = move |answer| _ = sender.send(answer);
    // The device was polled before: the answer is there, or another thread that polled is about to send it.
    (tell, async move { receiver.recv_timeout(LONGEST).ok() })
}

/// Where an answer of the browser goes, and where it is awaited.
#[cfg(target_arch = "wasm32")]
pub fn answer<T: 'static>() -> (impl FnOnce(T), impl Future<Output = Option<T>>) {
    let (sender, receiver) = futures_channel::oneshot::channel();
    let tell = move |answer| _ = sender.send(answer);
    (tell, async move { receiver.await.ok() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_ready_is_an_error() {
        assert_eq!(now(async { Ok::<_, GpuError>(7) }), Ok(7));
        assert_eq!(now(std::future::pending::<Result<(), GpuError>>()), Err(GpuError::WouldBlock));
    }

    #[test]
    fn answers_come_to_who_waits() {
        let (tell, told) = answer();
        std::thread::spawn(move || tell(7));
        assert_eq!(at_once(told), Some(Some(7)));
        let (tell, told) = answer::<u32>();
        drop(tell);
        assert_eq!(at_once(told), Some(None));
    }
}
