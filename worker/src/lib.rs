//! The worker of tilecast: asks a coordinator for units of work, traces them, brings the sums back.
//!
//! [`run`] keeps a session with the coordinator, for as long as it takes to reach it; [`scenes`] fetches and compiles scenes,
//! once each, [`shelf`] shares them among workers; the pool is the one bridge between the async session and the threads that trace. A worker keeps nothing that
//! matters: whatever it loses, another does again.

mod bench;
mod pool;
pub mod scenes;
mod session;
pub mod shelf;

use backon::{BackoffBuilder, ExponentialBuilder};
use bench::Bench;
use pool::Pool;
use scenes::SceneCache;
use session::{End, Session};
use std::hash::{BuildHasher, RandomState};
use std::sync::Arc;
use std::time::Duration;
use tilecast_core::bvh::simd::Isa;
use tilecast_proto::transport::Connector;
use tilecast_proto::types::WorkerInfo;

/// The first wait after a lost session; it doubles up to [`RETRY_MAX`].
const RETRY_MIN: Duration = Duration::from_millis(100);
/// The longest wait: a coordinator that comes back finds its workers within seconds.
const RETRY_MAX: Duration = Duration::from_secs(3);

/// Why a worker cannot work, however often it tries.
#[derive(Debug, thiserror::Error)]
pub enum WorkerError {
    /// The coordinator is another version, or does not want this worker.
    #[error("the coordinator refuses this worker: {0}")]
    Refused(String),
    /// No threads.
    #[error("the tracing threads cannot be started: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
}

/// How a worker is set up.
#[derive(Clone, Debug)]
pub struct WorkerConfig {
    /// Threads that trace, at least 1.
    pub threads: u32,
    /// The instruction set they trace with: [`Isa::detect`], unless someone compares. All give the same bits.
    pub isa: Isa,
    /// What people call the worker; may be empty.
    pub name: String,
    /// Its machine, for people.
    pub host: String,
    /// Its processor, likewise.
    pub cpu: String,
    /// How long it may finish what it has begun, when it is told to end; the rest it hands back at once.
    pub drain: Duration,
}

/// Works until `shutdown` ends, then gives back what it has not begun, and brings what it has. A coordinator that is gone or restarts is tried again,
/// for ever; results computed meanwhile are offered again. `scenes` may hold scenes already: those are not fetched.
///
/// # Errors
/// A refusal that trying again will not change, or no threads.
pub async fn run(
    connector: Connector,
    config: WorkerConfig,
    scenes: Arc<SceneCache>,
    shutdown: impl Future<Output = ()>,
) -> Result<(), WorkerError> {
    let WorkerConfig { threads, isa, name, host, cpu, drain } = config;
    let (pool, mut traced) = Pool::new(threads as usize)?;
    let mut bench = Bench::new(pool, scenes, isa);
    // The number of this worker over all its sessions: random, so that none is another's.
    let instance = RandomState::new().hash_one(std::process::id()).max(1);
    let info = WorkerInfo { threads, isa: isa.name().to_owned(), host, pid: std::process::id(), name, cpu, instance };
    let backoff = || {
        ExponentialBuilder::default()
            .with_min_delay(RETRY_MIN)
            .with_max_delay(RETRY_MAX)
            .with_jitter()
            .without_max_times()
    };
    let mut delays = backoff().build();
    tokio::pin!(shutdown);
    loop {
        let session = tokio::select! {
            session = Session::open(&connector, &info) => session,
            () = &mut shutdown => return Ok(()),
        };
        let end = match session {
            Ok(session) => {
                delays = backoff().build();
                session.work(&mut bench, &mut traced, (shutdown.as_mut(), drain)).await
            }
            Err(end) => end,
        };
        match end {
            End::Shutdown => return Ok(()),
            End::Refused(why) => return Err(WorkerError::Refused(why)),
            End::Lost(why) => {
                tracing::warn!(why, "no session with the coordinator; trying again");
                let delay = delays.next().unwrap_or(RETRY_MAX);
                tokio::select! {
                    () = tokio::time::sleep(delay) => {}
                    () = &mut shutdown => return Ok(()),
                }
            }
        }
    }
}
