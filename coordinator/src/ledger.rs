//! The ledger: who works on what, and what is counted. Pure: it is told the time, and knows no threads, sockets or sums.
//!
//! Jobs are served in the order they came: a worker gets units of the first job that has any to give, of the next when that
//! one is wholly lent. Units are cut when they are lent, sized to about [`UNIT_SECONDS`] on the worker that takes them, and
//! shrink towards the end of the job (guided self-scheduling, Polychronopoulos & Kuck 1987), so that all finish together.
//!
//! Each (tile, sample range) is counted once, whoever brings it, however late: since a unit is a pure function, any result of
//! it is the result. A lease only says who should not be disturbed by others meanwhile. In the tail of a job, idle workers get
//! units that others take long over; what comes first counts.
//!
//! A unit that seems to kill its workers is set aside, so that the others go on; [`audit`] sees to workers that lie.

pub mod audit;
mod job;
mod report;
mod results;
#[cfg(test)]
pub(crate) mod tests;
mod watch;

use crate::plan::{Plan, PlanError};
use audit::Contributor;
use job::{Job, UnitKey};
pub use report::{Lent, News, OpenUnits, Point, Totals, Trust};
use std::collections::BTreeMap;
use std::time::Duration;
use tilecast_core::film::RelativeError;
use tilecast_core::film::ranges::Ranges;
use tilecast_core::scene::Digest;
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
/// A unit on which the tracer panicked this often, on different workers where there are some, is set aside.
const UNIT_PANICS_MAX: u32 = 3;
/// A unit whose holders fell silent this often is set aside: it seems to kill them.
const UNIT_LOSSES_MAX: u32 = 3;
/// A unit that takes longer than this many times the median is duplicated, if someone is idle.
const OVERDUE_FACTOR: f64 = 1.5;
/// Results that make no sense, after which a worker is shut out.
pub const OFFENCES_MAX: u32 = 3;
/// How long two workers that disagree wait for a third to decide, when nothing else is left to do.
const DECISION_PATIENCE: Duration = Duration::from_secs(60);
/// Jobs waiting or running.
pub const JOBS_QUEUED_MAX: usize = 256;
/// Jobs remembered after their end, for whoever asks.
pub const JOBS_ENDED_MAX: usize = 256;
/// Workers registered at a time.
pub const WORKERS_MAX: usize = 16 << 10;
/// Worker processes remembered, present or not: what they have brought, and whether they are shut out.
const STANDINGS_MAX: usize = 4 * WORKERS_MAX;

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
    /// It cannot be laid out.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// It brought what makes no sense, or what others did not get.
    #[error("this worker is shut out: {0}; its machine should be looked at, and the worker then started again")]
    ShutOut(String),
    /// The job belongs to another client.
    #[error("job {0} was submitted by someone else; cancelling it takes an admin")]
    NotYours(JobId),
}

/// How results are checked.
#[derive(Clone, Copy, Debug, Default)]
pub struct Policy {
    /// The share of a proven worker's units that another does again, from 0 (no checks at all) to 1.
    pub verify: f64,
    /// Makes it unpredictable which.
    pub seed: u64,
}

/// See the module.
#[derive(Debug)]
pub struct Ledger {
    next_worker: u64,
    next_job: u64,
    next_fence: u64,
    workers: BTreeMap<WorkerId, Worker>,
    /// Of all their threads.
    threads: u64,
    jobs: BTreeMap<JobId, Job>,
    policy: Policy,
    standings: BTreeMap<Contributor, Standing>,
    /// Ended since [`Ledger::take_ended`].
    ended: Vec<JobId>,
    /// Happened since [`Ledger::take_news`].
    news: Vec<News>,
    totals: Totals,
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
    /// Behind its last sample.
    end: u32,
    since: Duration,
    deadline: Duration,
    /// It was done before, and is done again to see whether the bits agree.
    audit: bool,
}

/// What a worker process has to its name.
#[derive(Debug, Default)]
struct Standing {
    /// Units counted.
    units: u32,
    offences: u32,
    shut_out: Option<String>,
}

/// What became of a result.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Outcome {
    /// What the worker is told.
    pub verdict: Option<Verdict>,
    /// Its sums must be merged, and [`Ledger::merged`] be called then.
    pub merge: bool,
    /// With it, another round over the whole image is complete: time to look at the error.
    pub round_done: bool,
    /// These have lied: their units must be taken out of the film of every job in the second list, and
    /// [`Ledger::recalled`] be called for each.
    pub convicted: Vec<Contributor>,
    /// See `convicted`.
    pub recall: Vec<JobId>,
}

impl Ledger {
    /// An empty ledger. `incarnation` differs from that of every ledger before at the same address, so that the
    /// number of a worker or lease never comes to mean another.
    pub fn new(incarnation: u32, policy: Policy) -> Self {
        Self {
            next_worker: u64::from(incarnation) << 32 | 1,
            next_job: 1,
            next_fence: u64::from(incarnation) << 32 | 1,
            workers: BTreeMap::new(),
            threads: 0,
            jobs: BTreeMap::new(),
            policy,
            standings: BTreeMap::new(),
            ended: Vec::new(),
            news: Vec::new(),
            totals: Totals::default(),
        }
    }

    /// A worker has come.
    ///
    /// # Errors
    /// Too many, or one that was shut out.
    pub fn register(&mut self, now: Duration, info: WorkerInfo) -> Result<WorkerId, LedgerError> {
        if let Some(why) = self.standings.get(&info.instance).and_then(|standing| standing.shut_out.clone()) {
            return Err(LedgerError::ShutOut(why));
        }
        if self.workers.len() >= WORKERS_MAX || self.standings.len() >= STANDINGS_MAX {
            return Err(LedgerError::WorkersFull);
        }
        let id = WorkerId(self.next_worker);
        self.next_worker += 1;
        self.threads += u64::from(info.threads);
        self.standings.entry(info.instance).or_default();
        let worker =
            Worker { info, heard_at: now, leases: BTreeMap::new(), units_done: 0, samples_done: 0, rate: None };
        self.workers.insert(id, worker);
        Ok(id)
    }

    /// A job has come.
    ///
    /// # Errors
    /// A full queue, or what cannot be laid out.
    pub fn add_job(&mut self, now: Duration, spec: JobSpec, owner: Option<Digest>) -> Result<JobId, LedgerError> {
        let waiting = self.jobs.values().filter(|job| !job.state.is_final()).count();
        if waiting >= JOBS_QUEUED_MAX {
            return Err(LedgerError::QueueFull);
        }
        let plan = Plan::of(&spec)?;
        let key = work_key(&spec.scene, &spec.settings);
        let id = JobId(self.next_job);
        self.next_job += 1;
        self.jobs.insert(id, Job::new(now, spec, owner, key, plan));
        Ok(id)
    }

    /// The job that a client has queued with this ticket, if it has one.
    pub fn with_ticket(&self, ticket: u64, owner: Option<Digest>) -> Option<JobId> {
        let is_it = |job: &Job| ticket != 0 && job.spec.ticket == ticket && job.owner == owner;
        self.jobs.iter().find(|(_, job)| is_it(job)).map(|(&id, _)| id)
    }

    /// A job that was there before the coordinator was started again, with what was counted of each tile.
    ///
    /// # Errors
    /// What cannot be laid out.
    pub fn restore_job(&mut self, restored: RestoredJob, done: Vec<Ranges>) -> Result<(), LedgerError> {
        let RestoredJob { id, spec, owner, queued_at, end } = restored;
        let plan = Plan::of(&spec)?;
        let key = work_key(&spec.scene, &spec.settings);
        let mut job = Job::new(queued_at, spec, owner, key, plan);
        job.restore(done);
        if let Some((state, ended_at)) = end {
            job.end(ended_at, state);
        }
        self.next_job = self.next_job.max(id.0 + 1);
        self.jobs.insert(id, job);
        Ok(())
    }

    /// Ends a restored job of which nothing is left to do: the crash came between the last unit and the end.
    pub fn end_if_complete(&mut self, now: Duration, id: JobId) {
        if let Some(state) = self.jobs.get(&id).and_then(Job::outcome) {
            self.end_job(now, id, state);
        }
    }

    /// Jobs that ended too long ago to be remembered; they are forgotten with this.
    pub fn forget_old_jobs(&mut self) -> Vec<JobId> {
        let ended: Vec<JobId> = self.jobs.iter().filter(|(_, job)| job.state.is_final()).map(|(&id, _)| id).collect();
        let surplus = ended[..ended.len().saturating_sub(JOBS_ENDED_MAX)].to_vec();
        surplus.iter().for_each(|id| {
            self.jobs.remove(id);
        });
        surplus
    }

    /// Lends units: checks first, then returned ones, then new ones; to whom would be idle, what others take long over.
    /// None if there is nothing to do.
    ///
    /// # Errors
    /// An unknown worker, which must register again.
    pub fn lease(&mut self, now: Duration, request: &LeaseRequest) -> Result<LeaseReply, LedgerError> {
        let id = request.worker;
        let (threads, workers, next_fence) = (self.threads, self.workers.len(), &mut self.next_fence);
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
            let helpers = job.places().unwrap_or(workers).min(workers - job.barred.len());
            let alone = helpers <= 1;
            let mut described = request.known_jobs.contains(&job_id);
            while given < f64::from(request.slots) && reply.leases.len() < room {
                let size = unit_samples(job, id, threads * helpers as u64 / workers as u64);
                let fence = Fence(*next_fence);
                let (key, samples, audit) =
                    if let Some((key, samples)) = job.audits.take(id, worker.info.instance, fence) {
                        (key, samples, true)
                    } else if !job.has_place_for(id) {
                        break;
                    } else if let Some(key) = job.take_returned(id, alone).or_else(|| job.cut(size)) {
                        (key, job.samples(key), false)
                    } else if worker.leases.is_empty()
                        && let Some(key) = job.take_overdue(id)
                    {
                        (key, job.samples(key), false)
                    } else {
                        break;
                    };
                *next_fence += 1;
                let unit = Unit { job: job_id, tile: job.plan.tile(key.tile), samples };
                if let Some(open) = job.open.get_mut(&key).filter(|_| !audit) {
                    if open.leases.is_empty() {
                        open.since = now;
                    }
                    open.leases.push((id, fence));
                }
                if !audit {
                    job.join(id);
                }
                job.lent_to(now, id, &worker.info);
                let (end, deadline) = (unit.samples.end, now + LEASE_SILENCE);
                worker.leases.insert(fence, Held { job: job_id, unit: key, end, since: now, deadline, audit });
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

    /// Ends a job, unless it has ended. `who` asks: its owner, or `None` for someone who may end any.
    ///
    /// # Errors
    /// An unknown job, or another's.
    pub fn cancel(&mut self, now: Duration, id: JobId, who: Option<Digest>) -> Result<(), LedgerError> {
        let job = self.jobs.get(&id).ok_or(LedgerError::UnknownJob(id))?;
        if who.is_some() && job.owner.is_some() && job.owner != who {
            return Err(LedgerError::NotYours(id));
        }
        if !job.state.is_final() {
            self.end_job(now, id, JobState::Cancelled);
        }
        Ok(())
    }

    /// Takes back a job that was added just now and could not be kept.
    pub fn remove_job(&mut self, id: JobId) {
        self.jobs.remove(&id);
    }

    /// What was asked of a job.
    ///
    /// # Errors
    /// An unknown job.
    pub fn spec(&self, id: JobId) -> Result<JobSpec, LedgerError> {
        self.jobs.get(&id).map(|job| job.spec.clone()).ok_or(LedgerError::UnknownJob(id))
    }

    /// Jobs that have not ended.
    pub fn running(&self) -> Vec<(JobId, JobSpec)> {
        let running = self.jobs.iter().filter(|(_, job)| !job.state.is_final());
        running.map(|(&id, job)| (id, job.spec.clone())).collect()
    }

    /// Ends a job that cannot be gone on with.
    pub fn fail_job(&mut self, now: Duration, id: JobId, why: String) {
        if self.jobs.get(&id).is_some_and(|job| !job.state.is_final()) {
            self.end_job(now, id, JobState::Failed(why));
        }
    }

    /// Notes what the film says of its error.
    pub fn set_relative_error(&mut self, now: Duration, id: JobId, error: Option<RelativeError>) {
        if let Some(job) = self.jobs.get_mut(&id) {
            job.set_relative_error(now, error);
        }
    }

    /// Jobs that have ended since this was called last, how, and when: what was kept for them may go.
    pub fn take_ended(&mut self) -> Vec<(JobId, JobState, Duration)> {
        let ended = std::mem::take(&mut self.ended);
        let described = |id: JobId| {
            let job = self.jobs.get(&id)?;
            Some((id, job.state.clone(), job.ended_at.unwrap_or_default()))
        };
        ended.into_iter().filter_map(described).collect()
    }

    fn end_job(&mut self, now: Duration, id: JobId, state: JobState) {
        if let Some(job) = self.jobs.get_mut(&id) {
            job.end(now, state);
            self.ended.push(id);
        }
        // Heartbeats will say that these are nobody's any more.
        self.workers.values_mut().for_each(|worker| worker.leases.retain(|_, held| held.job != id));
    }

    /// Ends those leases of a worker that `which` picks; their units wait for someone, unless another has them too.
    fn take_back(&mut self, id: WorkerId, which: impl Fn(&Fence, &Held) -> bool) -> Vec<Held> {
        let Some(worker) = self.workers.get_mut(&id) else { return Vec::new() };
        let mut taken: Vec<(Fence, Held)> = Vec::new();
        worker.leases.retain(|&fence, held| {
            let goes = which(&fence, held);
            if goes {
                taken.push((fence, *held));
            }
            !goes
        });
        for (fence, held) in &taken {
            let Some(job) = self.jobs.get_mut(&held.job) else { continue };
            if held.audit {
                job.audits.give_back(held.unit, id, *fence);
            } else if let Some(open) = job.open.get_mut(&held.unit) {
                open.leases.retain(|(worker, _)| *worker != id);
                if open.leases.is_empty() {
                    job.returned.push_back(held.unit);
                }
            }
        }
        taken.into_iter().map(|(_, held)| held).collect()
    }
}

/// A job as it was kept.
#[derive(Clone, Debug)]
pub struct RestoredJob {
    /// Its number.
    pub id: JobId,
    /// What was asked.
    pub spec: JobSpec,
    /// By whom.
    pub owner: Option<Digest>,
    /// When.
    pub queued_at: Duration,
    /// How and when it ended, if it has.
    pub end: Option<(JobState, Duration)>,
}

/// The size of the next unit for a worker, in samples.
fn unit_samples(job: &Job, worker: WorkerId, threads: u64) -> u64 {
    let second = (job.rate(worker).unwrap_or(RATE_UNKNOWN) * UNIT_SECONDS) as u64;
    let left = job.samples_total - job.samples_cut;
    second.min(left / (TAIL_SHARE * threads.max(1))).max(job.smallest_unit())
}
