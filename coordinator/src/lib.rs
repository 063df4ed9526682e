//! The coordinator of tilecast: hands out units of work, counts each result once, and keeps the exact film.
//!
//! [`plan`] lays a job out, [`ledger`] keeps account of who does what, [`films`] and [`blobs`] hold the bulk, and the service
//! puts them on the wire. Nothing here traces rays, and nothing knows a worker but by what it says of itself.

pub mod blobs;
pub mod films;
pub mod ledger;
pub mod plan;
mod service;

use service::{Jobs, Shared, Work};
use std::sync::Arc;
use std::time::Duration;
use tilecast_proto::limits::{EXPIRY_TICK_MS, MESSAGE_BYTES_MAX};
use tilecast_proto::transport;
use tilecast_proto::wire::jobs_server::JobsServer;
use tilecast_proto::wire::work_server::WorkServer;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio_stream::Stream;
use tonic::transport::server::Connected;

/// How a coordinator is set up.
#[derive(Clone, Debug)]
pub struct Config {
    /// Differs from that of every coordinator before at the same address: the time it started, in seconds, will do.
    pub incarnation: u32,
    /// Memory for films: a pixel takes 208 bytes.
    pub film_bytes_max: u64,
    /// Memory for scenes.
    pub blob_bytes_max: u64,
}

impl Default for Config {
    /// For a machine with 16 GB: half for films (40 megapixels), a quarter for scenes.
    fn default() -> Self {
        Self { incarnation: 0, film_bytes_max: 8 << 30, blob_bytes_max: 4 << 30 }
    }
}

/// After a shutdown, calls under way have this long to end.
const SHUTDOWN_GRACE: Duration = Duration::from_secs(2);

/// Serves until `shutdown` ends. Connections come from a TCP listener ([`transport::tcp_incoming`]) or from memory
/// ([`transport::Memory::listen`]); both see the same service.
///
/// # Errors
/// If the connections cannot be served.
pub async fn run<S, IO, E>(
    incoming: S,
    config: Config,
    shutdown: impl Future<Output = ()>,
) -> Result<(), tonic::transport::Error>
where
    S: Stream<Item = Result<IO, E>>,
    IO: AsyncRead + AsyncWrite + Connected + Unpin + Send + 'static,
    E: Into<Box<dyn std::error::Error + Send + Sync>>,
{
    let shared = Arc::new(Shared::new(&config));
    let work = WorkServer::new(Work(Arc::clone(&shared)))
        .max_decoding_message_size(MESSAGE_BYTES_MAX)
        .max_encoding_message_size(MESSAGE_BYTES_MAX);
    let jobs = JobsServer::new(Jobs(Arc::clone(&shared)))
        .max_decoding_message_size(MESSAGE_BYTES_MAX)
        .max_encoding_message_size(MESSAGE_BYTES_MAX);
    let closing = shared.closing.clone();
    let serving = transport::server()
        .add_service(work)
        .add_service(jobs)
        .serve_with_incoming_shutdown(incoming, closing.clone().cancelled_owned());
    tokio::pin!(serving);
    tokio::select! {
        ended = &mut serving => return ended,
        () = expire(&shared) => {}
        () = shutdown => {}
    }
    closing.cancel();
    // A peer that does not read must not keep the process.
    tokio::time::timeout(SHUTDOWN_GRACE, serving).await.unwrap_or(Ok(()))
}

/// Takes lapsed leases back, for ever.
async fn expire(shared: &Shared) {
    let mut tick = tokio::time::interval(Duration::from_millis(EXPIRY_TICK_MS));
    tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    loop {
        tick.tick().await;
        shared.expire();
    }
}
