//! Connections as they come in: not more than so many, and none that says nothing for ever.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use tokio::time::{Instant, Sleep};
use tokio_stream::wrappers::ReceiverStream;
use tokio_stream::{Stream, StreamExt};
use tonic::transport::server::Connected;

/// Connections at a time: one for each worker, and some for clients. Others wait to be accepted.
pub const CONNECTIONS_MAX: usize = 18 << 10;
/// Whoever connects has said so much (an HTTP/2 preface with its settings, or more than that of TLS)
const GREETING_BYTES: u64 = 33;
/// within this time, or is cut off.
const GREETING_MAX: Duration = Duration::from_secs(10);
/// After an error in accepting, such as too many open files, others get a moment to go.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);
/// Connections between accepting and serving.
const BACKLOG: usize = 16;

/// Lets connections in one by one. An error of one, or in accepting, is nobody else's.
pub fn guarded<S, IO, E>(incoming: S) -> impl Stream<Item = io::Result<Guarded<IO>>>
where
    S: Stream<Item = Result<IO, E>> + Send + 'static,
    IO: Send + 'static,
    E: Into<Box<dyn std::error::Error + Send + Sync>> + Send,
{
    let (sender, receiver) = mpsc::channel(BACKLOG);
    let permits = Arc::new(Semaphore::new(CONNECTIONS_MAX));
    tokio::spawn(async move {
        tokio::pin!(incoming);
        loop {
            let Ok(permit) = Arc::clone(&permits).acquire_owned().await else { return };
            let io = loop {
                match incoming.next().await {
                    Some(Ok(io)) => break io,
                    Some(Err(error)) => {
                        let error: Box<dyn std::error::Error + Send + Sync> = error.into();
                        tracing::warn!(%error, "a connection could not be accepted");
                        tokio::time::sleep(ACCEPT_PAUSE).await;
                    }
                    None => return,
                }
            };
            let deadline = Box::pin(tokio::time::sleep_until(Instant::now() + GREETING_MAX));
            if sender.send(Ok(Guarded { io, greeted: 0, deadline, _permit: permit })).await.is_err() {
                return;
            }
        }
    });
    ReceiverStream::new(receiver)
}

/// A connection that must greet in time.
#[derive(Debug)]
pub struct Guarded<IO> {
    io: IO,
    greeted: u64,
    deadline: Pin<Box<Sleep>>,
    _permit: OwnedSemaphorePermit,
}

impl<IO: Connected> Connected for Guarded<IO> {
    type ConnectInfo = IO::ConnectInfo;

    fn connect_info(&self) -> Self::ConnectInfo {
        self.io.connect_info()
    }
}

impl<IO: AsyncRead + Unpin> AsyncRead for Guarded<IO> {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let before = buf.filled().len();
        let read = Pin::new(&mut self.io).poll_read(cx, buf);
        if self.greeted < GREETING_BYTES {
            self.greeted += (buf.filled().len() - before) as u64;
            if read.is_pending() && self.deadline.as_mut().poll(cx).is_ready() {
                return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
            }
        }
        read
    }
}

impl<IO: AsyncWrite + Unpin> AsyncWrite for Guarded<IO> {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.io).poll_write(cx, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.io).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.io).poll_shutdown(cx)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bufs: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.io).poll_write_vectored(cx, bufs)
    }

    fn is_write_vectored(&self) -> bool {
        self.io.is_write_vectored()
    }
}
