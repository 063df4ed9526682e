//! What both services share: the ledger, films and blobs behind locks that live only inside short synchronous methods, and
//! the signals that wake who waits.

mod jobs;
mod work;

use crate::Config;
use crate::blobs::Blobs;
use crate::events::{About, Events, Kind};
use crate::films::Films;
use crate::ledger::{Ledger, LedgerError, News, Policy};
use crate::otlp::Told;
use crate::otlp::way::{Outcome, Step, Way};
use crate::store::{Broken, KeptJob, Store, StoreError};
use bytes::Bytes;
use std::collections::HashMap;
use std::hash::{BuildHasher, RandomState};
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;
use tilecast_core::film::sums;
use tilecast_core::scene::Digest;
use tilecast_proto::limits::STREAM_IDLE_MS_MAX;
use tilecast_proto::types::{JobId, JobState, ResultHeader, Verdict, WorkerId, WorkerInfo};
use tokio::sync::{Notify, Semaphore};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use tonic::{Status, Streaming};

pub(crate) use jobs::{Jobs, bring_back};
#[cfg(test)]
pub(crate) use jobs::{submit, whole_film};
pub(crate) use work::Work;

/// Blobs on their way to workers at a time, the others in the order in which they were asked for: the first workers begin
/// soon, where a thousand that shared the line would all begin at its end. Two workers' requests.
const BLOBS_SENT_MAX: usize = 16;

/// See the module.
#[derive(Debug)]
pub(crate) struct Shared {
    ledger: Mutex<Ledger>,
    pub(crate) films: Films,
    blobs: Mutex<Blobs>,
    pub(crate) store: Option<Arc<Store>>,
    /// Blobs kept for jobs that have not ended.
    pinned: Mutex<HashMap<JobId, Vec<Digest>>>,
    /// Turns in sending blobs to workers.
    blobs_sent: Semaphore,
    /// Held while a job is let in, so that two do not take the same room.
    submitting: Mutex<()>,
    epoch: Duration,
    started: Instant,
    /// There may be work to lend.
    work: Notify,
    /// Some job has changed.
    pub(crate) changed: Notify,
    /// The coordinator stops: nobody waits any more.
    pub(crate) closing: CancellationToken,
    pub(crate) events: Events,
    pub(crate) traffic: Traffic,
    /// Where the ways of units are told, if someone wants to know.
    pub(crate) told: OnceLock<Arc<Told>>,
    /// Tells this coordinator from the one before it at the same address.
    pub(crate) instance: u64,
}

/// What went over the wire, for whoever keeps count.
#[derive(Debug, Default)]
pub(crate) struct Traffic {
    /// Bytes of results.
    pub results: AtomicU64,
    /// Results that were there already.
    pub duplicates: AtomicU64,
    /// Bytes of scenes that clients brought.
    pub scenes_in: AtomicU64,
    /// Bytes of scenes that workers fetched.
    pub scenes_out: AtomicU64,
}

impl Shared {
    /// Everything as it was kept, if there is a state.
    pub(crate) fn open(config: &Config) -> Result<Self, StoreError> {
        let opened = config.state.as_ref().map(|root| Store::open(root, config.disk.clone())).transpose()?;
        let (store, recovered) = opened.map_or((None, None), |(store, found)| (Some(Arc::new(store)), Some(found)));
        let starts = recovered.as_ref().map_or(0, |found| found.starts);
        let policy = Policy { verify: config.verify, seed: RandomState::new().hash_one(starts) };
        let apart_bytes_max = if config.verify > 0.0 { config.apart_bytes_max } else { 0 };
        let shared = Self {
            ledger: Mutex::new(Ledger::new(config.incarnation.wrapping_add(starts), policy)),
            films: Films::new(config.film_bytes_max, apart_bytes_max, store.clone()),
            blobs: Mutex::new(Blobs::new(config.blob_bytes_max)),
            store,
            pinned: Mutex::default(),
            blobs_sent: Semaphore::new(BLOBS_SENT_MAX),
            submitting: Mutex::default(),
            epoch: config.epoch,
            started: Instant::now(),
            work: Notify::new(),
            changed: Notify::new(),
            closing: CancellationToken::new(),
            events: Events::default(),
            traffic: Traffic::default(),
            told: OnceLock::new(),
            instance: RandomState::new().hash_one(config.epoch),
        };
        if let Some(found) = recovered {
            for (digest, bytes) in found.blobs {
                shared.keep_in_memory(digest, bytes);
            }
            found.jobs.into_iter().try_for_each(|job| shared.restore(job))?;
        }
        Ok(shared)
    }

    fn keep_in_memory(&self, digest: Digest, bytes: Bytes) {
        let len = bytes.len() as u64;
        let mut blobs = self.blobs();
        match blobs.reserve(len) {
            Ok(dropped) => {
                blobs.insert(digest, bytes);
                blobs.release(len);
                dropped.iter().for_each(|digest| self.drop_blob(digest));
            }
            Err(_) => self.drop_blob(&digest),
        }
    }

    fn drop_blob(&self, digest: &Digest) {
        if let Some(store) = &self.store {
            store.drop_blob(digest);
        }
    }

    /// A job goes on where it was.
    fn restore(&self, KeptJob { job, engine, .. }: KeptJob) -> Result<(), StoreError> {
        let (id, spec, ended) = (job.id, job.spec.clone(), job.end.is_some());
        let unfit = |reason: String| StoreError::Damaged { path: format!("jobs/{id}/job").into(), reason };
        let plan = || crate::plan::Plan::of(&spec).map_err(|e| unfit(e.to_string()));
        if ended {
            // Its film is read when someone asks for it.
            return self.with_ledger(|ledger, _| ledger.restore_job(job, Vec::new())).map_err(|e| unfit(e.to_string()));
        }
        let blobs = if spec.workers_hold_scene { Ok(Vec::new()) } else { jobs::scene_blobs(self, &spec.scene) };
        let pinned = blobs.and_then(|blobs| match self.blobs().pin(&blobs) {
            Ok(()) => Ok(blobs),
            Err(missing) => Err(Status::data_loss(format!("part {missing} of the scene is lost"))),
        });
        let film = self.films.restore(id, &spec, plan()?)?;
        self.films.insert(id, film, false);
        let error = self.films.relative_error(id);
        self.with_ledger(|ledger, now| {
            ledger.restore_job(job, self.films.samples(id)).map_err(|e| unfit(e.to_string()))?;
            ledger.set_relative_error(now, id, error);
            match pinned {
                Err(status) => {
                    let why = format!("the coordinator was started again, and {}; submit it again", status.message());
                    ledger.fail_job(now, id, why);
                }
                Ok(_) if engine != tilecast_core::VERSION => {
                    let ours = tilecast_core::VERSION;
                    ledger.fail_job(
                        now,
                        id,
                        format!("it was begun with engine {engine}, and this one is {ours}; images depend on it"),
                    );
                }
                Ok(blobs) => {
                    lock(&self.pinned).insert(id, blobs);
                    ledger.end_if_complete(now, id);
                }
            }
            Ok(())
        })?;
        self.tell(Kind::JobRestored, id, format!("job {id} goes on where it was"));
        Ok(())
    }

    /// Told when the state cannot be kept any more.
    pub(crate) fn broken(&self) -> Option<Arc<Broken>> {
        self.store.as_ref().map(|store| store.broken())
    }

    /// Takes lapsed leases back; `pause` is for how long nobody could have been heard.
    pub(crate) fn expire(&self, pause: Duration) {
        let any = self.with_ledger(|ledger, now| {
            if !pause.is_zero() {
                ledger.forgive(pause);
            }
            ledger.expire(now)
        });
        if any {
            self.work.notify_waiters();
            self.changed.notify_waiters();
        }
    }

    /// Writes the snapshots that are due. Blocks.
    pub(crate) fn snapshots(&self) {
        for (job, spec) in lock(&self.ledger).running() {
            if let Err(error) = self.films.snapshot(job, &spec, false)
                && let Some(store) = &self.store
            {
                store.fail(error);
            }
        }
    }

    /// Checks, counts and merges a result. Decoding and adding take a few milliseconds: not for an async thread.
    pub(crate) fn merge(&self, header: &ResultHeader, bytes: Bytes, mut way: Way) -> Result<Verdict, Status> {
        let begun = Instant::now();
        let sums = match header.sums(&bytes) {
            Ok(sums) => sums,
            Err(error) => {
                self.offence(header.worker, &error.to_string());
                way.step(Step::Validate, self.now());
                self.follow(way, Outcome::Failed(error.to_string()));
                return Err(error.into());
            }
        };
        let job = header.unit.job;
        let compares = lock(&self.ledger).compares();
        // Of the one encoding a value has, whatever came.
        let digest = compares.then(|| Digest::of(&sums::encode(&sums.pixels)));
        let (outcome, who) =
            self.with_ledger(|ledger, now| (ledger.accept(now, header, digest), ledger.contributor(header.worker)));
        way.step(Step::Validate, self.now());
        for &liar in &outcome.convicted {
            let text = format!(
                "the sums of the worker with instance {liar} are not those of others; its units are done again"
            );
            self.tell(Kind::Convicted, About::default(), text);
        }
        for &job in &outcome.recall {
            let units: Vec<_> = outcome.convicted.iter().flat_map(|&liar| self.films.take_out(job, liar)).collect();
            self.with_ledger(|ledger, now| ledger.recalled(now, job, &units));
        }
        if outcome.merge {
            if self.films.merge(job, &sums, who, bytes) {
                if outcome.round_done {
                    let error = self.films.relative_error(job);
                    self.with_ledger(|ledger, now| ledger.set_relative_error(now, job, error));
                }
                self.with_ledger(|ledger, now| {
                    ledger.merge_took(job, begun.elapsed());
                    ledger.merged(now, job);
                });
                way.step(Step::Merge, self.now());
            } else {
                self.with_ledger(|ledger, now| ledger.unmerged(now, &header.unit));
            }
        }
        if outcome.merge || !outcome.recall.is_empty() || compares {
            self.changed.notify_waiters();
        }
        if compares {
            self.work.notify_waiters();
        }
        let verdict = outcome.verdict.unwrap_or(Verdict::Stale);
        self.follow(way, Outcome::Brought(verdict));
        Ok(verdict)
    }

    /// The way of a lease has ended so.
    fn follow(&self, mut way: Way, outcome: Outcome) {
        if let Some(told) = self.told.get() {
            way.outcome = Some(outcome);
            told.tell(way);
        }
    }

    /// A worker brought what makes no sense.
    fn offence(&self, worker: WorkerId, what: &str) {
        self.tell(Kind::Nonsense, worker, format!("a result of worker {} makes no sense: {what}", worker.number()));
        if self.with_ledger(|ledger, _| ledger.offence(worker, what)) {
            self.tell(Kind::ShutOut, worker, format!("worker {} is shut out", worker.number()));
            self.work.notify_waiters();
        }
    }

    /// Does something with the ledger, and lets go of what was kept for jobs that have ended by it.
    pub(crate) fn with_ledger<T>(&self, act: impl FnOnce(&mut Ledger, Duration) -> T) -> T {
        let now = self.now();
        let (result, news, ended, forgotten) = {
            let mut ledger = lock(&self.ledger);
            let result = act(&mut ledger, now);
            let ended = ledger.take_ended();
            let forgotten = if ended.is_empty() { Vec::new() } else { ledger.forget_old_jobs() };
            (result, ledger.take_news(), ended, forgotten)
        };
        news.into_iter().for_each(|news| self.hear(news));
        for (job, state, at) in ended {
            self.end(job, &state, at);
        }
        for job in forgotten {
            self.films.forget(job);
            if let Some(store) = &self.store {
                store.forget_job(job);
            }
        }
        result
    }

    /// The time, as the ledger has it.
    pub(crate) fn now(&self) -> Duration {
        self.epoch + self.started.elapsed()
    }

    /// Something happened.
    pub(crate) fn tell(&self, kind: Kind, about: impl Into<About>, text: String) {
        self.events.tell(self.now(), kind, about, text);
    }

    fn hear(&self, news: News) {
        match news {
            News::Silent { worker, info } => {
                self.tell(
                    Kind::WorkerSilent,
                    worker,
                    format!("worker {} is not heard any more", called(worker, &info)),
                );
            }
            News::Lapsed { worker, leases } => {
                let text = format!("{} units of worker {} are given to others", leases.len(), worker.number());
                self.tell(Kind::LeasesLapsed, worker, text);
                for lent in leases {
                    self.follow(Way::lost(self.now(), lent), Outcome::Lapsed);
                }
            }
            News::SetAside { job, why } => {
                self.tell(Kind::UnitSetAside, job, format!("a unit of job {job} is set aside: {why}"));
            }
        }
    }

    /// Ends a job; `who` asks, see [`Ledger::cancel`].
    pub(crate) fn cancel(&self, job: JobId, who: Option<Digest>) -> Result<(), LedgerError> {
        self.with_ledger(|ledger, now| ledger.cancel(now, job, who))?;
        self.work.notify_waiters();
        Ok(())
    }

    fn end(&self, job: JobId, state: &JobState, at: Duration) {
        match state {
            JobState::Finished => self.tell(Kind::JobFinished, job, format!("job {job} is finished")),
            JobState::Failed(why) => self.tell(Kind::JobFailed, job, format!("job {job} failed: {why}")),
            _ => self.tell(Kind::JobCancelled, job, format!("job {job} was cancelled")),
        }
        self.films.end(job);
        let pinned = lock(&self.pinned).remove(&job).unwrap_or_default();
        self.blobs().unpin(&pinned);
        if let Some(store) = &self.store {
            store.end_job(job, state, at);
        }
        self.changed.notify_waiters();
    }

    pub(crate) fn blobs(&self) -> MutexGuard<'_, Blobs> {
        lock(&self.blobs)
    }
}

/// How people know a worker.
pub(crate) fn called(worker: WorkerId, info: &WorkerInfo) -> String {
    let name = if info.name.is_empty() { String::new() } else { format!(" {}", info.name) };
    format!("{}{name} on {} ({} threads)", worker.number(), info.host, info.threads)
}

/// The next message of a stream of bulk; one on which nothing comes is broken off.
async fn next<T>(stream: &mut Streaming<T>) -> Result<Option<T>, Status> {
    let patience = Duration::from_millis(STREAM_IDLE_MS_MAX);
    let silent = |_| Status::deadline_exceeded("nothing came for too long");
    tokio::time::timeout(patience, stream.message()).await.map_err(silent)?
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
            LedgerError::Plan(_) => Status::invalid_argument(text),
            LedgerError::ShutOut(_) | LedgerError::NotYours(_) => Status::permission_denied(text),
        }
    }
}

/// What was spawned to keep the CPU work off the async threads has panicked: a bug.
fn panicked(_: tokio::task::JoinError) -> Status {
    Status::internal("the coordinator panicked over this call; see its log")
}
