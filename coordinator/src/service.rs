//! What both services share: the ledger, films and blobs behind locks that live only inside short synchronous methods, and
//! the signals that wake who waits.

mod jobs;
mod work;

use crate::Config;
use crate::blobs::Blobs;
use crate::films::Films;
use crate::ledger::{Ledger, LedgerError};
use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tilecast_core::scene::Digest;
use tilecast_proto::types::{JobId, ResultHeader, Verdict};
use tokio::sync::Notify;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use tonic::Status;

pub(crate) use jobs::Jobs;
pub(crate) use work::Work;

/// See the module.
#[derive(Debug)]
pub(crate) struct Shared {
    ledger: Mutex<Ledger>,
    films: Films,
    blobs: Mutex<Blobs>,
    /// Blobs kept for jobs that have not ended.
    pinned: Mutex<HashMap<JobId, Vec<Digest>>>,
    /// Held while a job is let in, so that two do not take the same room.
    submitting: Mutex<()>,
    started: Instant,
    /// There may be work to lend.
    work: Notify,
    /// Some job has changed.
    changed: Notify,
    /// The coordinator stops: nobody waits any more.
    pub(crate) closing: CancellationToken,
}

impl Shared {
    pub(crate) fn new(config: &Config) -> Self {
        Self {
            ledger: Mutex::new(Ledger::new(config.incarnation)),
            films: Films::new(config.film_bytes_max),
            blobs: Mutex::new(Blobs::new(config.blob_bytes_max)),
            pinned: Mutex::default(),
            submitting: Mutex::default(),
            started: Instant::now(),
            work: Notify::new(),
            changed: Notify::new(),
            closing: CancellationToken::new(),
        }
    }

    /// Takes lapsed leases back.
    pub(crate) fn expire(&self) {
        if self.with_ledger(|ledger, now| ledger.expire(now)) {
            self.work.notify_waiters();
            self.changed.notify_waiters();
        }
    }

    /// Checks, counts and merges a result. Decoding and adding take a few milliseconds: not for an async thread.
    fn merge(&self, header: &ResultHeader, bytes: &[u8]) -> Result<Verdict, Status> {
        let sums = header.sums(bytes)?;
        let job = header.unit.job;
        let outcome = self.with_ledger(|ledger, now| ledger.accept(now, header));
        if outcome.verdict == Verdict::Accepted {
            self.films.merge(job, &sums);
            if outcome.round_done {
                let error = self.films.relative_error(job);
                self.with_ledger(|ledger, _| ledger.set_relative_error(job, error));
            }
            self.with_ledger(|ledger, now| ledger.merged(now, job));
            self.changed.notify_waiters();
        }
        Ok(outcome.verdict)
    }

    /// Does something with the ledger, and lets go of what was kept for jobs that have ended by it.
    fn with_ledger<T>(&self, act: impl FnOnce(&mut Ledger, Duration) -> T) -> T {
        let now = self.started.elapsed();
        let (result, ended) = {
            let mut ledger = lock(&self.ledger);
            let result = act(&mut ledger, now);
            (result, ledger.take_ended())
        };
        for job in ended {
            self.films.end(job);
            let pinned = lock(&self.pinned).remove(&job).unwrap_or_default();
            self.blobs().unpin(&pinned);
            self.changed.notify_waiters();
        }
        result
    }

    fn blobs(&self) -> MutexGuard<'_, Blobs> {
        lock(&self.blobs)
    }
}

/// A panic while a lock is held is a bug that has cost its own call; the ledger's methods leave no half-done account behind
/// that would count a sample twice, so others go on.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl From<LedgerError> for Status {
    fn from(error: LedgerError) -> Self {
        let text = error.to_string();
        match error {
            LedgerError::UnknownWorker(_) | LedgerError::UnknownJob(_) => Status::not_found(text),
            LedgerError::QueueFull | LedgerError::WorkersFull => Status::resource_exhausted(text),
            LedgerError::Tiles(_) => Status::invalid_argument(text),
        }
    }
}

/// What was spawned to keep the CPU work off the async threads has panicked: a bug.
fn panicked(_: tokio::task::JoinError) -> Status {
    Status::internal("the coordinator panicked over this call; see its log")
}
