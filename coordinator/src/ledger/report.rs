//! What the ledger tells people: jobs and workers as they stand. Nothing changes here.

use super::audit::NEWCOMER_UNITS;
use super::{Held, Ledger, LedgerError, Worker};
use std::time::Duration;
use tilecast_core::film::RelativeError;
use tilecast_proto::types::{Aim, Contribution, Fence, JobId, Progress, Unit, WorkerId, WorkerInfo, WorkerStatus};

/// Something that nobody asked for, and people may want to know.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum News {
    /// A worker was not heard any more and is forgotten.
    Silent {
        /// Its number.
        worker: WorkerId,
        /// What it said of itself.
        info: WorkerInfo,
    },
    /// Leases lapsed: their units are lent again.
    Lapsed {
        /// Whose.
        worker: WorkerId,
        /// As they were.
        leases: Vec<Lent>,
    },
    /// A unit is not given to anyone any more.
    SetAside {
        /// Of this job.
        job: JobId,
        /// For this reason.
        why: String,
    },
}

/// A lease that someone has.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lent {
    /// Who.
    pub worker: WorkerId,
    /// What it is called; may be empty.
    pub name: String,
    /// Which.
    pub fence: Fence,
    /// Of what.
    pub unit: Unit,
    /// Since when.
    pub since: Duration,
}

/// What has happened since the ledger was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Totals {
    /// Samples counted.
    pub samples: u64,
    /// Units counted.
    pub units: u64,
    /// Leases that lapsed.
    pub leases_lost: u64,
    /// Spent checking and adding up results.
    pub merging: Duration,
}

/// Units of all jobs that go on, by what they wait for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OpenUnits {
    /// Someone works on them.
    pub lent: u64,
    /// They came back, and wait for someone.
    pub returned: u64,
    /// Nobody gets them any more.
    pub set_aside: u64,
}

/// The error of an image at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Since the job's first lease, or the first one after the coordinator was started again.
    pub running: Duration,
    /// Counted then, over all pixels.
    pub samples: u64,
    /// Estimated then.
    pub error: RelativeError,
}

/// How far a worker is trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trust {
    /// Results are not compared.
    Unchecked,
    /// All it brings is done again by another.
    Newcomer,
    /// Some of what it brings is.
    Proven,
}

impl Ledger {
    /// What has happened since this was called last.
    pub fn take_news(&mut self) -> Vec<News> {
        std::mem::take(&mut self.news)
    }

    /// See [`Totals`].
    pub fn totals(&self) -> Totals {
        self.totals
    }

    /// See [`OpenUnits`].
    pub fn open_units(&self) -> OpenUnits {
        let mut units = OpenUnits::default();
        for job in self.jobs.values() {
            let (lent, aside) =
                (job.open.values().filter(|open| !open.leases.is_empty()).count(), job.quarantined.len());
            units.lent += lent as u64;
            units.set_aside += aside as u64;
            units.returned += (job.open.len() - lent).saturating_sub(aside) as u64;
        }
        units
    }

    /// Whether a job has not ended.
    pub fn goes_on(&self, id: JobId) -> bool {
        self.jobs.get(&id).is_some_and(|job| !job.state.is_final())
    }

    /// When a job was submitted.
    pub fn queued_at(&self, id: JobId) -> Option<Duration> {
        self.jobs.get(&id).map(|job| job.queued_at)
    }

    /// What a job is a step towards, if it is not the whole.
    pub fn aim(&self, id: JobId) -> Option<Aim> {
        self.jobs.get(&id)?.spec.aim
    }

    /// Samples that are left of a job, and of the image that it is a step towards as far as its end is known.
    pub fn left(&self, id: JobId) -> u64 {
        let Some(job) = self.jobs.get(&id) else { return 0 };
        let aim = job.spec.aim.unwrap_or_default();
        aim.expected.max(aim.before + job.samples_total) - aim.before - job.samples_done
    }

    /// Samples a second that those who work on a job are good for, as last measured.
    fn speed(&self, id: JobId) -> f64 {
        let Some(job) = self.jobs.get(&id).filter(|job| !job.state.is_final()) else { return 0.0 };
        let holders = self.workers.iter().filter(|(_, worker)| worker.leases.values().any(|held| held.job == id));
        holders.filter_map(|(&id, worker)| Some(job.rate(id)? * f64::from(worker.info.threads))).sum()
    }

    /// How the error of a job came down, round by round, since this ledger was made.
    ///
    /// # Errors
    /// An unknown job.
    pub fn history(&self, id: JobId) -> Result<Vec<Point>, LedgerError> {
        self.jobs.get(&id).map(|job| job.history.clone()).ok_or(LedgerError::UnknownJob(id))
    }

    /// How far a worker is trusted, and how many results it brought that make no sense.
    pub fn trust(&self, info: &WorkerInfo) -> (Trust, u32) {
        let standing = self.standings.get(&info.instance);
        let trust = match standing {
            _ if self.policy.verify <= 0.0 => Trust::Unchecked,
            Some(standing) if standing.units > NEWCOMER_UNITS => Trust::Proven,
            _ => Trust::Newcomer,
        };
        (trust, standing.map_or(0, |standing| standing.offences))
    }

    /// Where a job stands.
    ///
    /// # Errors
    /// An unknown job.
    pub fn progress(&self, now: Duration, id: JobId) -> Result<Progress, LedgerError> {
        let job = self.jobs.get(&id).ok_or(LedgerError::UnknownJob(id))?;
        let until = job.ended_at.unwrap_or(now);
        let holds = |worker: &&Worker| worker.leases.values().any(|held| held.job == id);
        Ok(Progress {
            job: id,
            name: job.spec.name.clone(),
            state: job.state.clone(),
            samples_done: job.samples_done,
            samples_found: job.samples_found.min(job.samples_done),
            samples_total: job.samples_total,
            samples_per_second: self.speed(id),
            workers: self.workers.values().filter(holds).count() as u32,
            relative_error: job.relative_error,
            elapsed: until.saturating_sub(job.queued_at),
            running: job.started_at.map_or(Duration::ZERO, |start| until.saturating_sub(start)),
            scene: job.spec.scene,
            settings: job.spec.settings.clone(),
            merging: job.merge_time,
        })
    }

    /// The lease of this number, while the worker has it.
    pub fn lease_of(&self, worker: WorkerId, fence: Fence) -> Option<Lent> {
        let (worker_there, held) =
            self.workers.get(&worker).and_then(|there| Some((there, there.leases.get(&fence)?)))?;
        self.described(worker, worker_there, fence, held)
    }

    /// Those leases of a worker that `which` picks.
    pub(super) fn lent(&self, id: WorkerId, which: impl Fn(&Fence, &Held) -> bool) -> Vec<Lent> {
        let Some(worker) = self.workers.get(&id) else { return Vec::new() };
        let picked = worker.leases.iter().filter(|(fence, held)| which(fence, held));
        picked.filter_map(|(&fence, held)| self.described(id, worker, fence, held)).collect()
    }

    fn described(&self, id: WorkerId, worker: &Worker, fence: Fence, held: &Held) -> Option<Lent> {
        let tile = self.jobs.get(&held.job)?.plan.tile(held.unit.tile);
        let unit = Unit { job: held.job, tile, samples: held.unit.start..held.end };
        Some(Lent { worker: id, name: worker.info.name.clone(), fence, unit, since: held.since })
    }

    /// Whether nothing more happens to a job. Costs nothing, unlike [`Ledger::progress`], however many workers there are.
    pub fn has_ended(&self, id: JobId) -> bool {
        self.jobs.get(&id).is_none_or(|job| job.state.is_final())
    }

    /// Who has brought what of a job since this ledger was made.
    ///
    /// # Errors
    /// An unknown job.
    pub fn contributions(&self, id: JobId) -> Result<Vec<Contribution>, LedgerError> {
        let job = self.jobs.get(&id).ok_or(LedgerError::UnknownJob(id))?;
        Ok(job.contributions.values().cloned().collect())
    }

    /// All jobs it remembers, oldest first.
    pub fn jobs(&self) -> Vec<JobId> {
        self.jobs.keys().copied().collect()
    }

    /// What a worker said of itself.
    pub fn worker(&self, id: WorkerId) -> Option<&WorkerInfo> {
        self.workers.get(&id).map(|worker| &worker.info)
    }

    /// The workers that are there.
    pub fn workers(&self, now: Duration) -> Vec<WorkerStatus> {
        let status = |(&id, worker): (&WorkerId, &Worker)| WorkerStatus {
            worker: id,
            info: worker.info.clone(),
            leases: worker.leases.len() as u32,
            units_done: worker.units_done,
            samples_done: worker.samples_done,
            samples_per_second: worker.rate.unwrap_or(0.0) * f64::from(worker.info.threads),
            silent: now.saturating_sub(worker.heard_at),
        };
        self.workers.iter().map(status).collect()
    }
}
