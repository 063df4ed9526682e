//! The coordinator of tilecast: hands out units of work, counts each result once, and keeps the exact film.
//!
//! [`plan`] lays a job out, [`ledger`] keeps account of who does what, [`films`] and [`blobs`] hold the bulk, [`store`] keeps
//! all that is promised on a [`disk`], and the service puts it on the wire. Nothing here traces rays, and nothing knows a
//! worker but by what it says of itself.

pub mod access;
pub mod blobs;
pub mod disk;
pub mod events;
pub mod films;
pub mod http;
pub mod incoming;
pub mod ledger;
pub mod otlp;
mod pace;
pub mod plan;
pub mod scaling;
mod service;
#[cfg(test)]
mod sim;
pub mod store;
pub mod target;
pub mod tev;

use access::{Gate, Role, Security};
use disk::Disk;
use service::{Jobs, Shared, Work};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use store::StoreError;
use tilecast_proto::limits::{EXPIRY_TICK_MS, MESSAGE_BYTES_MAX};
use tilecast_proto::transport;
use tilecast_proto::wire::jobs_server::JobsServer;
use tilecast_proto::wire::work_server::WorkServer;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio_stream::Stream;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::server::Connected;

/// How a coordinator is set up.
#[derive(Clone, Debug)]
pub struct Config {
    /// Differs from that of every coordinator before at the same address: the time it started, in seconds, will do.
    pub incarnation: u32,
    /// The time it starts, since some beginning that is the same for all coordinators with one state.
    pub epoch: Duration,
    /// Memory for films: a pixel takes 208 bytes.
    pub film_bytes_max: u64,
    /// Memory for scenes.
    pub blob_bytes_max: u64,
    /// Memory of each film for what is kept apart by worker, where workers are checked.
    pub apart_bytes_max: u64,
    /// The share of a proven worker's units that another does again, from 0 (no checks) to 1.
    pub verify: f64,
    /// Where jobs and films are kept; without it they end with the coordinator.
    pub state: Option<PathBuf>,
    /// Whom it lets in; everyone, if `None`.
    pub security: Option<Security>,
    /// How the state is written.
    pub disk: Disk,
}

impl Default for Config {
    /// For a machine with 16 GB: half for films (40 megapixels), a quarter for scenes.
    fn default() -> Self {
        Self {
            incarnation: 0,
            epoch: Duration::ZERO,
            film_bytes_max: 8 << 30,
            blob_bytes_max: 4 << 30,
            apart_bytes_max: 2 << 30,
            verify: 0.0,
            state: None,
            security: None,
            disk: Disk::default(),
        }
    }
}

/// Why a coordinator ended that was not told to.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// Connections cannot be served.
    #[error(transparent)]
    Serve(#[from] tonic::transport::Error),
    /// What was promised cannot be kept.
    #[error(transparent)]
    State(#[from] StoreError),
    /// A bug.
    #[error("reading the state panicked; the log says where")]
    Panicked,
}

/// After a shutdown, calls under way have this long to end.
const SHUTDOWN_GRACE: Duration = Duration::from_secs(2);
/// How often journals are looked at, whether a snapshot is due.
const SNAPSHOT_TICK: Duration = Duration::from_secs(2);
/// A tick that comes this late means that the whole process stood still, and nobody could be heard.
const PAUSE_MIN: Duration = Duration::from_millis(4 * EXPIRY_TICK_MS);

/// A coordinator that has read its state and can serve.
pub struct Coordinator {
    shared: Arc<Shared>,
    security: Option<Arc<Security>>,
}

impl Coordinator {
    /// Sets it up. Its jobs are as they were when the one before ended, however it ended. Blocks.
    ///
    /// # Errors
    /// State that cannot be had.
    pub fn open(config: &Config) -> Result<Self, StoreError> {
        Ok(Self { shared: Arc::new(Shared::open(config)?), security: config.security.clone().map(Arc::new) })
    }

    /// What HTTP serves of it, to be served beside [`Coordinator::serve`], and called `title` there.
    pub fn site(&self, title: String) -> http::Site {
        http::Site::new(Arc::clone(&self.shared), self.security.clone(), title)
    }

    /// Sends its images to a viewer at `address`, HOST:PORT, beside [`Coordinator::serve`].
    pub fn tev(&self, address: String) -> tev::Tev {
        tev::Tev::new(Arc::clone(&self.shared), address)
    }

    /// Sends traces of its units to a collector at `endpoint`, `http://HOST:PORT`, beside [`Coordinator::serve`].
    ///
    /// # Errors
    /// An endpoint that is none.
    pub fn otlp(&self, endpoint: String) -> Result<otlp::Otlp, otlp::EndpointError> {
        otlp::Otlp::new(Arc::clone(&self.shared), endpoint)
    }

    /// Serves until `shutdown` ends. Connections come from a TCP listener ([`transport::tcp_incoming`]) or from memory
    /// ([`transport::Memory::listen`]); both see the same service.
    ///
    /// # Errors
    /// If the connections cannot be served, or the state cannot be kept.
    pub async fn serve<S, IO, E>(self, incoming: S, shutdown: impl Future<Output = ()>) -> Result<(), RunError>
    where
        S: Stream<Item = Result<IO, E>> + Send + 'static,
        IO: AsyncRead + AsyncWrite + Connected + Unpin + Send + 'static,
        E: Into<Box<dyn std::error::Error + Send + Sync>> + Send,
    {
        let Self { shared, security } = self;
        let work = WorkServer::new(Work(Arc::clone(&shared)))
            .max_decoding_message_size(MESSAGE_BYTES_MAX)
            .max_encoding_message_size(MESSAGE_BYTES_MAX);
        let jobs = JobsServer::new(Jobs(Arc::clone(&shared)))
            .max_decoding_message_size(MESSAGE_BYTES_MAX)
            .max_encoding_message_size(MESSAGE_BYTES_MAX);
        let closing = shared.closing.clone();
        let mut server = transport::server();
        if let Some(security) = &security {
            server = server.tls_config(security.tls())?;
        }
        let (health, health_service) = tonic_health::server::health_reporter();
        health.set_serving::<WorkServer<Work>>().await;
        health.set_serving::<JobsServer<Jobs>>().await;
        let serving = server
            .add_service(health_service)
            .add_service(InterceptedService::new(work, Gate::new(security.clone(), Role::Worker)))
            .add_service(InterceptedService::new(jobs, Gate::new(security, Role::Client)))
            .serve_with_incoming_shutdown(incoming::guarded(incoming), closing.clone().cancelled_owned());
        tokio::pin!(serving);
        let broken = shared.broken();
        let is_broken = async {
            match &broken {
                Some(broken) => broken.token.cancelled().await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            ended = &mut serving => ended?,
            () = expire(&shared) => {}
            () = snapshots(&shared) => {}
            () = is_broken => {}
            () = shutdown => {}
        }
        health.set_not_serving::<WorkServer<Work>>().await;
        health.set_not_serving::<JobsServer<Jobs>>().await;
        closing.cancel();
        // A peer that does not read must not keep the process.
        let _ = tokio::time::timeout(SHUTDOWN_GRACE, serving).await;
        let store = shared.store.clone();
        if let Some(store) = store {
            tokio::task::spawn_blocking(move || store.close()).await.map_err(|_| RunError::Panicked)?;
        }
        match broken.and_then(|broken| broken.take()) {
            Some(error) => Err(error.into()),
            None => Ok(()),
        }
    }
}

/// Opens and serves, see [`Coordinator`].
///
/// # Errors
/// If the connections cannot be served, or the state cannot be had or kept.
pub async fn run<S, IO, E>(incoming: S, config: Config, shutdown: impl Future<Output = ()>) -> Result<(), RunError>
where
    S: Stream<Item = Result<IO, E>> + Send + 'static,
    IO: AsyncRead + AsyncWrite + Connected + Unpin + Send + 'static,
    E: Into<Box<dyn std::error::Error + Send + Sync>> + Send,
{
    let open = tokio::task::spawn_blocking(move || Coordinator::open(&config));
    open.await.map_err(|_| RunError::Panicked)??.serve(incoming, shutdown).await
}

/// Takes lapsed leases back, for ever.
async fn expire(shared: &Shared) {
    let period = Duration::from_millis(EXPIRY_TICK_MS);
    let mut tick = tokio::time::interval(period);
    tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut last = tokio::time::Instant::now();
    loop {
        tick.tick().await;
        let pause = last.elapsed().saturating_sub(period);
        last = tokio::time::Instant::now();
        shared.expire(if pause >= PAUSE_MIN { pause } else { Duration::ZERO });
    }
}

/// Writes snapshots when they are due, for ever. A disk that fails is told through the store.
async fn snapshots(shared: &Arc<Shared>) {
    if shared.store.is_none() {
        return std::future::pending().await;
    }
    let mut tick = tokio::time::interval(SNAPSHOT_TICK);
    tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    loop {
        tick.tick().await;
        let shared = Arc::clone(shared);
        // A panic there was told as it happened; what is in the journals holds.
        let _ = tokio::task::spawn_blocking(move || shared.snapshots()).await;
    }
}
