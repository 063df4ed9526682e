//! The ledger: who works on what, and what is counted. Pure: it is told the time, and knows no threads, sockets or sums.
//!
//! Jobs are served in the order they came: a worker gets units of the first job that has any to give, of the next when that
//! one is wholly lent. Units are cut when they are lent, sized to about [`UNIT_SECONDS`] on the worker that takes them, and
//! shrink towards the end of the job (guided self-scheduling, Polychronopoulos & Kuck 1987), so that all finish together.
//!
//! Each (tile, sample range) is counted once, whoever brings it, however late: since a unit is a pure function, any result of
//! it is the result. A lease only says who should not be disturbed by others meanwhile.

mod job;
mod ranges;
mod report;
#[cfg(test)]
pub(crate) mod tests;

use crate::plan::{Plan, TooManyTiles};
use job::{Job, UnitKey};
use std::collections::BTreeMap;
use std::time::Duration;
use tilecast_core::film::RelativeError;
use tilecast_proto::convert::work_key;
use tilecast_proto::limits::{LEASE_SILENCE_MS, LEASES_HELD_MAX, LEASES_PER_REPLY_MAX};
use tilecast_proto::types::{
    Failure, Fence, Heartbeat, HeartbeatReply, JobId, JobSpec, JobState, JobWork, Lease, LeaseReply, LeaseRequest,
    ResultHeader, Unit, Verdict, WorkerId, WorkerInfo,
};

/// What a unit should take: long against the cost of a message, short against a human's patience and a worker's death.
const UNIT_SECONDS: f64 = 1.0;
/// A unit is at most this part of what is left, divided among all threads: the last ones end within a fraction of a second of
/// each other, at the price of some more messages.
const TAIL_SHARE: u64 = 4;
/// Samples a second on one thread, while nobody has measured: low, since a first unit that is too small costs little.
const RATE_UNKNOWN: f64 = 100_000.0;
/// How much of a new measurement goes into a worker's rate; parts of a picture differ.
const RATE_BLEND: f64 = 0.3;
/// A unit on which the tracer panicked this often, on different workers where there are some, fails its job.
const UNIT_PANICS_MAX: u32 = 3;
/// A unit whose holders fell silent this often fails its job: it seems to kill them. High, because most are innocent.
const UNIT_LOSSES_MAX: u32 = 16;
/// Jobs waiting or running.
pub const JOBS_QUEUED_MAX: usize = 256;
/// Jobs remembered after their end, for whoever asks.
pub const JOBS_ENDED_MAX: usize = 256;
/// Workers registered at a time.
pub const WORKERS_MAX: usize = 16 << 10;

const LEASE_SILENCE: Duration = Duration::from_millis(LEASE_SILENCE_MS);

/// Why the ledger refuses.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LedgerError {
    /// It fell silent and was forgotten, or registered with another coordinator.
    #[error("worker {} is not registered (any more)", .0.0)]
    UnknownWorker(WorkerId),
    /// Never existed, or ended long ago.
    #[error("there is no job {0}")]
    UnknownJob(JobId),
    /// See [`JOBS_QUEUED_MAX`].
    #[error("{JOBS_QUEUED_MAX} jobs are waiting; submit again when some have ended")]
    QueueFull,
    /// See [`WORKERS_MAX`].
    #[error("{WORKERS_MAX} workers are registered; no more can be")]
    WorkersFull,
    /// See [`crate::plan::TILES_MAX`].
    #[error(transparent)]
    Tiles(#[from] TooManyTiles),
}

/// See the module.
#[derive(Debug)]
pub struct Ledger {
    next_worker: u64,
    next_job: u64,
    next_fence: u64,
    workers: BTreeMap<WorkerId, Worker>,
    jobs: BTreeMap<JobId, Job>,
    /// Ended since [`Ledger::take_ended`].
    ended: Vec<JobId>,
}

#[derive(Debug)]
struct Worker {
    info: WorkerInfo,
    heard_at: Duration,
    leases: BTreeMap<Fence, Held>,
    units_done: u64,
    samples_done: u64,
    /// Samples a second on one thread, over all jobs.
    rate: Option<f64>,
}

#[derive(Clone, Copy, Debug)]
struct Held {
    job: JobId,
    unit: UnitKey,
    deadline: Duration,
}

/// What became of a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outcome {
    /// Whether its sums must be merged.
    pub verdict: Verdict,
    /// With it, another round over the whole image is complete: time to look at the error.
    pub round_done: bool,
}

impl Ledger {
    /// An empty ledger. `incarnation` differs from that of every ledger before at the same address, so that the
    /// number of a worker or lease never comes to mean another.
    pub fn new(incarnation: u32) -> Self {
        Self {
            next_worker: u64::from(incarnation) << 32 | 1,
            next_job: 1,
            next_fence: u64::from(incarnation) << 32 | 1,
            workers: BTreeMap::new(),
            jobs: BTreeMap::new(),
            ended: Vec::new(),
        }
    }

    /// A worker has come.
    ///
    /// # Errors
    /// Too many.
    pub fn register(&mut self, now: Duration, info: WorkerInfo) -> Result<WorkerId, LedgerError> {
        if self.workers.len() >= WORKERS_MAX {
            return Err(LedgerError::WorkersFull);
        }
        let id = WorkerId(self.next_worker);
        self.next_worker += 1;
        let worker =
            Worker { info, heard_at: now, leases: BTreeMap::new(), units_done: 0, samples_done: 0, rate: None };
        self.workers.insert(id, worker);
        Ok(id)
    }

    /// A job has come.
    ///
    /// # Errors
    /// A full queue, or tiles too small.
    pub fn add_job(&mut self, now: Duration, spec: JobSpec) -> Result<JobId, LedgerError> {
        let waiting = self.jobs.values().filter(|job| !job.state.is_final()).count();
        if waiting >= JOBS_QUEUED_MAX {
            return Err(LedgerError::QueueFull);
        }
        let ended: Vec<JobId> = self.jobs.iter().filter(|(_, job)| job.state.is_final()).map(|(&id, _)| id).collect();
        let surplus = (ended.len() + 1).saturating_sub(JOBS_ENDED_MAX);
        ended[..surplus].iter().for_each(|id| {
            self.jobs.remove(id);
        });
        let plan = Plan::new(&spec.settings, spec.tile)?;
        let key = work_key(&spec.scene, &spec.settings);
        let id = JobId(self.next_job);
        self.next_job += 1;
        self.jobs.insert(id, Job::new(now, spec, key, plan));
        Ok(id)
    }

    /// Lends units, returned ones first; none if there is nothing to do.
    ///
    /// # Errors
    /// An unknown worker, which must register again.
    pub fn lease(&mut self, now: Duration, request: &LeaseRequest) -> Result<LeaseReply, LedgerError> {
        let id = request.worker;
        let threads: u64 = self.workers.values().map(|w| u64::from(w.info.threads)).sum();
        let workers = self.workers.len();
        let worker = self.workers.get_mut(&id).ok_or(LedgerError::UnknownWorker(id))?;
        worker.heard_at = now;
        let mut reply = LeaseReply { unit_samples: 1, ..LeaseReply::default() };
        let room = LEASES_PER_REPLY_MAX.min(LEASES_HELD_MAX.saturating_sub(worker.leases.len()));
        // In slots: each job measures its own.
        let mut given = 0.0;
        for (&job_id, job) in self.jobs.iter_mut().filter(|(_, job)| !job.state.is_final()) {
            if job.barred.contains(&id) {
                continue;
            }
            let alone = workers - job.barred.len() <= 1;
            let mut described = request.known_jobs.contains(&job_id);
            while given < f64::from(request.slots) && reply.leases.len() < room {
                let size = unit_samples(job, id, threads);
                let Some(key) = job.take_returned(id, alone).or_else(|| job.cut(size)) else { break };
                let fence = Fence(self.next_fence);
                self.next_fence += 1;
                let samples = job.samples(key);
                let unit = Unit { job: job_id, tile: job.plan.tile(key.tile), samples };
                if let Some(open) = job.open.get_mut(&key) {
                    open.lease = Some((id, fence));
                }
                worker.leases.insert(fence, Held { job: job_id, unit: key, deadline: now + LEASE_SILENCE });
                // One that came back may be larger than what would be cut now: it takes a slot none the less.
                given += (unit.len() as f64 / size as f64).min(1.0);
                reply.unit_samples = size;
                reply.leases.push(Lease { fence, unit });
                job.state = JobState::Running;
                job.started_at.get_or_insert(now);
                if !std::mem::replace(&mut described, true) {
                    let (scene, settings) = (job.spec.scene, job.spec.settings.clone());
                    reply.jobs.push(JobWork { job: job_id, scene, settings });
                }
            }
        }
        Ok(reply)
    }

    /// What [`Ledger::accept`] would say now: a result that is not wanted need not be read.
    pub fn verdict(&self, header: &ResultHeader) -> Verdict {
        self.jobs.get(&header.unit.job).map_or(Verdict::Ended, |job| job.verdict(&header.unit, &header.key))
    }

    /// Counts a result whose sums were checked, once. If the verdict is [`Verdict::Accepted`], its sums must be merged, and
    /// [`Ledger::merged`] be called then.
    pub fn accept(&mut self, now: Duration, header: &ResultHeader) -> Outcome {
        let unit = &header.unit;
        let verdict = self.verdict(header);
        if let Some(worker) = self.workers.get_mut(&header.worker) {
            worker.heard_at = now;
        }
        let Some(job) = self.jobs.get_mut(&unit.job).filter(|_| verdict == Verdict::Accepted) else {
            return Outcome { verdict, round_done: false };
        };
        let rounds = job.rounds_done();
        let holder = job.count(unit).and_then(|open| open.lease);
        let rate = unit.len() as f64 / header.trace.as_secs_f64().max(1e-6);
        if let Some(worker) = self.workers.get_mut(&header.worker) {
            worker.units_done += 1;
            worker.samples_done += unit.len();
            worker.rate = Some(blend(worker.rate, rate));
            let known = job.rates.get(&header.worker).copied();
            job.rates.insert(header.worker, blend(known, rate));
        }
        let round_done = job.rounds_done() > rounds;
        if let Some((worker, fence)) = holder
            && let Some(worker) = self.workers.get_mut(&worker)
        {
            worker.leases.remove(&fence);
        }
        Outcome { verdict, round_done }
    }

    /// The sums of an accepted result are in the film.
    pub fn merged(&mut self, now: Duration, id: JobId) {
        if let Some(job) = self.jobs.get_mut(&id) {
            job.merging -= 1;
            if job.merging == 0 && job.samples_done == job.samples_total && !job.state.is_final() {
                self.end_job(now, id, JobState::Finished);
            }
        }
    }

    /// A worker gives a unit back that it could not do. A lease that is not its own any more changes nothing.
    ///
    /// # Errors
    /// An unknown worker.
    pub fn fail(&mut self, now: Duration, id: WorkerId, fence: Fence, failure: Failure) -> Result<(), LedgerError> {
        let all = self.workers.keys().copied().collect::<Vec<_>>();
        let worker = self.workers.get_mut(&id).ok_or(LedgerError::UnknownWorker(id))?;
        worker.heard_at = now;
        let host = format!("worker {} on {}", worker.info.name, worker.info.host);
        let Some(held) = worker.leases.remove(&fence) else { return Ok(()) };
        let Some(job) = self.jobs.get_mut(&held.job) else { return Ok(()) };
        let samples = job.samples(held.unit);
        let tile = job.plan.tile(held.unit.tile);
        let Some(open) = job.open.get_mut(&held.unit) else { return Ok(()) };
        let fatal = match failure {
            Failure::Sample(text) => Some(text),
            Failure::Panic(text) => {
                open.panics += 1;
                let often = open.panics >= UNIT_PANICS_MAX;
                often.then(|| {
                    format!("samples {samples:?} of {tile:?} failed {UNIT_PANICS_MAX} times, last on {host}: {text}")
                })
            }
            Failure::Scene(text) => {
                job.barred.insert(id);
                let nobody = all.iter().all(|worker| job.barred.contains(worker));
                nobody.then(|| format!("no worker can prepare the scene, last {host}: {text}"))
            }
        };
        open.avoid = Some(id);
        open.lease = None;
        job.returned.push_back(held.unit);
        let barred = job.barred.contains(&id);
        if let Some(text) = fatal {
            self.end_job(now, held.job, JobState::Failed(text));
        } else if barred {
            self.take_back(id, |other| other.job == held.job);
        }
        Ok(())
    }

    /// A worker is alive and names its leases: those are renewed, and it is told which are not its own any more.
    ///
    /// # Errors
    /// An unknown worker.
    pub fn heartbeat(&mut self, now: Duration, beat: &Heartbeat) -> Result<HeartbeatReply, LedgerError> {
        let worker = self.workers.get_mut(&beat.worker).ok_or(LedgerError::UnknownWorker(beat.worker))?;
        worker.heard_at = now;
        let mut renew = |fence: &Fence| match worker.leases.get_mut(fence) {
            Some(held) => {
                held.deadline = now + LEASE_SILENCE;
                false
            }
            None => true,
        };
        Ok(HeartbeatReply { drop: beat.fences.iter().copied().filter(|fence| renew(fence)).collect() })
    }

    /// A worker goes: its units wait for others.
    pub fn leave(&mut self, id: WorkerId) {
        self.take_back(id, |_| true);
        self.workers.remove(&id);
        self.jobs.values_mut().for_each(|job| {
            job.rates.remove(&id);
            job.barred.remove(&id);
        });
    }

    /// Takes back leases that lapsed and forgets silent workers; whether there is work to give out again.
    pub fn expire(&mut self, now: Duration) -> bool {
        let mut any = false;
        for id in self.workers.keys().copied().collect::<Vec<_>>() {
            for (job, unit) in self.take_back(id, |held| held.deadline <= now) {
                any = true;
                let Some(open) = self.jobs.get_mut(&job).and_then(|job| job.open.get_mut(&unit)) else { continue };
                open.losses += 1;
                if open.losses >= UNIT_LOSSES_MAX {
                    let text = format!(
                        "{UNIT_LOSSES_MAX} workers fell silent while they held tile {} from sample {}; does it kill them?",
                        unit.tile, unit.start
                    );
                    self.end_job(now, job, JobState::Failed(text));
                }
            }
            if self.workers.get(&id).is_some_and(|worker| worker.heard_at + LEASE_SILENCE <= now) {
                self.leave(id);
                any = true;
            }
        }
        any
    }

    /// Ends a job, unless it has ended.
    ///
    /// # Errors
    /// An unknown job.
    pub fn cancel(&mut self, now: Duration, id: JobId) -> Result<(), LedgerError> {
        let job = self.jobs.get(&id).ok_or(LedgerError::UnknownJob(id))?;
        if !job.state.is_final() {
            self.end_job(now, id, JobState::Cancelled);
        }
        Ok(())
    }

    /// Notes what the film says of its error.
    pub fn set_relative_error(&mut self, id: JobId, error: Option<RelativeError>) {
        if let Some(job) = self.jobs.get_mut(&id) {
            job.relative_error = error;
        }
    }

    /// Jobs that have ended since this was called last: what was kept for them may go.
    pub fn take_ended(&mut self) -> Vec<JobId> {
        std::mem::take(&mut self.ended)
    }

    fn end_job(&mut self, now: Duration, id: JobId, state: JobState) {
        if let Some(job) = self.jobs.get_mut(&id) {
            job.end(now, state);
            self.ended.push(id);
        }
        // Heartbeats will say that these are nobody's any more.
        self.workers.values_mut().for_each(|worker| worker.leases.retain(|_, held| held.job != id));
    }

    /// Ends those leases of a worker that `which` picks; their units wait for someone.
    fn take_back(&mut self, id: WorkerId, which: impl Fn(&Held) -> bool) -> Vec<(JobId, UnitKey)> {
        let Some(worker) = self.workers.get_mut(&id) else { return Vec::new() };
        let taken: Vec<(JobId, UnitKey)> =
            worker.leases.values().filter(|held| which(held)).map(|held| (held.job, held.unit)).collect();
        worker.leases.retain(|_, held| !which(held));
        for (job, unit) in &taken {
            let Some(job) = self.jobs.get_mut(job) else { continue };
            if let Some(open) = job.open.get_mut(unit) {
                open.lease = None;
                job.returned.push_back(*unit);
            }
        }
        taken
    }
}

/// The size of the next unit for a worker, in samples.
fn unit_samples(job: &Job, worker: WorkerId, threads: u64) -> u64 {
    let second = (job.rate(worker).unwrap_or(RATE_UNKNOWN) * UNIT_SECONDS) as u64;
    let left = job.samples_total - job.samples_cut;
    second.min(left / (TAIL_SHARE * threads.max(1))).max(job.smallest_unit())
}

fn blend(old: Option<f64>, new: f64) -> f64 {
    old.map_or(new, |old| old + (new - old) * RATE_BLEND)
}
