//! What happens, for people: one line of the log each, and the last ones at hand for whoever looks later.

use serde::Serialize;
use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tilecast_proto::types::{JobId, WorkerId};

/// Events at hand: a screen or two of them.
const KEPT: usize = 200;

/// What happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// A worker registered.
    WorkerCame,
    /// It said goodbye.
    WorkerLeft,
    /// It was not heard any more.
    WorkerSilent,
    /// Units are lent again, since whoever had them was not heard.
    LeasesLapsed,
    /// A job was submitted.
    JobQueued,
    /// A job that was there before the coordinator was started again goes on.
    JobRestored,
    /// All of a job is done.
    JobFinished,
    /// It cannot be finished.
    JobFailed,
    /// Someone ended it.
    JobCancelled,
    /// A worker could not do a unit.
    UnitFailed,
    /// Nobody is given the unit any more.
    UnitSetAside,
    /// A worker brought what makes no sense.
    Nonsense,
    /// A worker is not let in any more.
    ShutOut,
    /// A worker's sums were not those of others.
    Convicted,
}

impl Kind {
    /// All of them, in the order of their declaration.
    pub const ALL: [Self; 14] = [
        Self::WorkerCame,
        Self::WorkerLeft,
        Self::WorkerSilent,
        Self::LeasesLapsed,
        Self::JobQueued,
        Self::JobRestored,
        Self::JobFinished,
        Self::JobFailed,
        Self::JobCancelled,
        Self::UnitFailed,
        Self::UnitSetAside,
        Self::Nonsense,
        Self::ShutOut,
        Self::Convicted,
    ];

    /// As logs, page and metrics call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::WorkerCame => "worker_came",
            Self::WorkerLeft => "worker_left",
            Self::WorkerSilent => "worker_silent",
            Self::LeasesLapsed => "leases_lapsed",
            Self::JobQueued => "job_queued",
            Self::JobRestored => "job_restored",
            Self::JobFinished => "job_finished",
            Self::JobFailed => "job_failed",
            Self::JobCancelled => "job_cancelled",
            Self::UnitFailed => "unit_failed",
            Self::UnitSetAside => "unit_set_aside",
            Self::Nonsense => "nonsense",
            Self::ShutOut => "shut_out",
            Self::Convicted => "convicted",
        }
    }
}

/// Whom an event is about, as far as it is about anyone.
#[derive(Clone, Copy, Debug, Default)]
pub struct About {
    /// The job.
    pub job: Option<JobId>,
    /// The worker.
    pub worker: Option<WorkerId>,
}

impl From<JobId> for About {
    fn from(job: JobId) -> Self {
        Self { job: Some(job), worker: None }
    }
}

impl From<WorkerId> for About {
    fn from(worker: WorkerId) -> Self {
        Self { job: None, worker: Some(worker) }
    }
}

/// One that happened.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Event {
    /// Counts all events from 1.
    pub number: u64,
    /// Seconds since the coordinator's epoch.
    pub at: f64,
    /// What.
    pub kind: Kind,
    /// Of which job.
    pub job: Option<u64>,
    /// Of which worker; more than a browser's numbers hold.
    #[serde(skip)]
    pub worker: Option<u64>,
    /// A sentence.
    pub text: String,
}

/// See the module.
#[derive(Debug, Default)]
pub struct Events(Mutex<Kept>);

#[derive(Debug, Default)]
struct Kept {
    last: VecDeque<Event>,
    number: u64,
    counts: [u64; Kind::ALL.len()],
}

impl Events {
    /// Something happened.
    pub fn tell(&self, at: Duration, kind: Kind, about: impl Into<About>, text: String) {
        let About { job, worker } = about.into();
        let (job, worker) = (job.map(|job| job.0), worker.map(|worker| worker.0));
        let event = kind.name();
        match kind {
            Kind::ShutOut | Kind::Convicted => tracing::error!(event, job, worker, "{text}"),
            Kind::WorkerSilent
            | Kind::LeasesLapsed
            | Kind::JobFailed
            | Kind::UnitFailed
            | Kind::UnitSetAside
            | Kind::Nonsense => {
                tracing::warn!(event, job, worker, "{text}");
            }
            _ => tracing::info!(event, job, worker, "{text}"),
        }
        let mut kept = self.kept();
        kept.number += 1;
        kept.counts[kind as usize] += 1;
        if kept.last.len() == KEPT {
            kept.last.pop_front();
        }
        let number = kept.number;
        kept.last.push_back(Event { number, at: at.as_secs_f64(), kind, job, worker, text });
    }

    /// The last ones, oldest first.
    pub fn last(&self) -> Vec<Event> {
        self.kept().last.iter().cloned().collect()
    }

    /// How often each kind happened.
    pub fn counts(&self) -> [(Kind, u64); Kind::ALL.len()] {
        let counts = self.kept().counts;
        Kind::ALL.map(|kind| (kind, counts[kind as usize]))
    }

    /// An event is added whole or not at all: a panic elsewhere has not harmed them.
    fn kept(&self) -> MutexGuard<'_, Kept> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_ones_are_kept_and_all_are_counted() {
        let events = Events::default();
        for i in 0..500 {
            events.tell(Duration::from_secs(i), Kind::JobQueued, JobId(i), format!("job {i}"));
        }
        events.tell(Duration::ZERO, Kind::WorkerCame, WorkerId(7), "worker".into());
        let last = events.last();
        assert_eq!((last.len(), last[0].number, last[KEPT - 1].number), (KEPT, 302, 501));
        assert_eq!(last[KEPT - 1].worker, Some(7));
        let counted: Vec<_> = events.counts().into_iter().filter(|(_, n)| *n > 0).collect();
        assert_eq!(counted, [(Kind::WorkerCame, 1), (Kind::JobQueued, 500)]);
        assert!(Kind::ALL.iter().zip(0..).all(|(kind, i)| *kind as usize == i), "counts are by place");
    }
}
