//! What the ledger tells people: jobs and workers as they stand. Nothing changes here.

use super::{Ledger, LedgerError, Worker};
use std::time::Duration;
use tilecast_proto::types::{Contribution, JobId, Progress, WorkerId, WorkerStatus};

impl Ledger {
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
            samples_total: job.samples_total,
            workers: self.workers.values().filter(holds).count() as u32,
            relative_error: job.relative_error,
            elapsed: until.saturating_sub(job.queued_at),
            running: job.started_at.map_or(Duration::ZERO, |start| until.saturating_sub(start)),
            scene: job.spec.scene,
            settings: job.spec.settings.clone(),
            merging: job.merge_time,
        })
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
