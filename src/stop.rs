//! Ctrl-C and SIGTERM: the first asks for an orderly end, the second ends the process at once.

use tokio_util::sync::CancellationToken;

/// An end that was asked for.
#[derive(Debug, thiserror::Error)]
#[error("stopped before the image was complete; nothing was written")]
pub struct Stopped;

/// Listens from now on. The token is cancelled by the first signal.
///
/// # Errors
/// If signals cannot be listened to.
pub fn on_signal() -> anyhow::Result<CancellationToken> {
    let stop = CancellationToken::new();
    let stopping = stop.clone();
    let mut signals = Signals::new()?;
    tokio::spawn(async move {
        signals.next().await;
        stopping.cancel();
        signals.next().await;
        // Worker processes see their standard input end, and do so too.
        std::process::exit(1);
    });
    Ok(stop)
}

/// Waits for what may take long, but not for what nobody wants any more.
pub async fn unless_stopped<T>(stop: &CancellationToken, work: impl Future<Output = T>) -> anyhow::Result<T> {
    tokio::select! {
        done = work => Ok(done),
        () = stop.cancelled() => Err(Stopped.into()),
    }
}

#[cfg(unix)]
struct Signals {
    interrupt: tokio::signal::unix::Signal,
    terminate: tokio::signal::unix::Signal,
}

#[cfg(unix)]
impl Signals {
    fn new() -> anyhow::Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Self { interrupt: signal(SignalKind::interrupt())?, terminate: signal(SignalKind::terminate())? })
    }

    async fn next(&mut self) {
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
        }
    }
}

#[cfg(not(unix))]
struct Signals;

#[cfg(not(unix))]
impl Signals {
    fn new() -> anyhow::Result<Self> {
        Ok(Self)
    }

    async fn next(&mut self) {
        // Without a handler there is nothing to wait for but the end of the process by other means.
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
    }
}
