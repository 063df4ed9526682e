//! The way of one lease, step by step, as the coordinator sees it: what a trace is made from. Knows no OpenTelemetry.
//!
//! All times are the coordinator's own. A worker says how long it traced and how long the result then waited, so its steps are
//! placed by counting back from the moment that the result came: no two clocks need to agree, and no worker needs to be told.

use crate::ledger::Lent;
use std::time::Duration;
use tilecast_proto::types::{Fence, ResultHeader, Unit, Verdict, WorkerId};

/// A stretch of the way. Each begins where the one before ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Step {
    /// The worker has the lease, and something else to do.
    Wait,
    /// It traces.
    Trace,
    /// From the last sample to the last byte here.
    Transfer,
    /// The sums are decoded, checked and counted.
    Validate,
    /// They are added to the film.
    Merge,
}

impl Step {
    /// As traces call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Wait => "wait",
            Self::Trace => "trace",
            Self::Transfer => "transfer",
            Self::Validate => "validate",
            Self::Merge => "merge",
        }
    }
}

/// How it ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Outcome {
    /// With a result, which was worth this.
    Brought(Verdict),
    /// The worker was not heard any more.
    Lapsed,
    /// The worker could not do it, or what it brought makes no sense.
    Failed(String),
}

impl Outcome {
    /// As traces call it.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Brought(Verdict::Accepted) => "accepted",
            Self::Brought(Verdict::Duplicate) => "duplicate",
            Self::Brought(Verdict::Stale) => "stale",
            Self::Brought(Verdict::Ended) => "job_ended",
            Self::Lapsed => "lapsed",
            Self::Failed(_) => "failed",
        }
    }
}

/// See the module.
#[derive(Clone, Debug)]
pub(crate) struct Way {
    pub worker: WorkerId,
    /// May be empty, or not known any more.
    pub name: String,
    pub fence: Fence,
    pub unit: Unit,
    pub begun: Duration,
    /// The steps, and when each ended.
    pub steps: Vec<(Step, Duration)>,
    /// Not known while it goes on.
    pub outcome: Option<Outcome>,
}

impl Way {
    /// A result begins to come. The lease may be over: then the way begins with the tracing.
    pub fn brought(now: Duration, header: &ResultHeader, lent: Option<Lent>) -> Self {
        let since = lent.as_ref().map_or(Duration::ZERO, |lent| lent.since);
        let ended = now.saturating_sub(header.waited).max(since);
        let begun = ended.saturating_sub(header.trace).max(since);
        let wait = lent.as_ref().map(|_| (Step::Wait, begun));
        Self {
            worker: header.worker,
            name: lent.as_ref().map_or(String::new(), |lent| lent.name.clone()),
            fence: header.fence,
            unit: header.unit.clone(),
            begun: lent.map_or(begun, |lent| lent.since),
            steps: wait.into_iter().chain([(Step::Trace, ended)]).collect(),
            outcome: None,
        }
    }

    /// A lease that ended without a result.
    pub fn lost(now: Duration, lent: Lent) -> Self {
        let Lent { worker, name, fence, unit, since } = lent;
        Self { worker, name, fence, unit, begun: since, steps: vec![(Step::Wait, now)], outcome: None }
    }

    /// A step has ended now.
    pub fn step(&mut self, step: Step, now: Duration) {
        self.steps.push((step, now.max(self.end())));
    }

    /// Behind its last step.
    pub fn end(&self) -> Duration {
        self.steps.last().map_or(self.begun, |(_, end)| *end)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use tilecast_core::scene::Digest;
    use tilecast_core::settings::Window;
    use tilecast_proto::types::JobId;

    const fn ms(n: u64) -> Duration {
        Duration::from_millis(n)
    }

    pub fn lent() -> Lent {
        let unit = Unit { job: JobId(3), tile: Window { x0: 0, y0: 32, x1: 32, y1: 64 }, samples: 8..16 };
        Lent { worker: WorkerId(7 << 32 | 2), name: "alpha".into(), fence: Fence(40), unit, since: ms(1000) }
    }

    pub fn header(trace: Duration, waited: Duration) -> ResultHeader {
        let Lent { worker, fence, unit, .. } = lent();
        ResultHeader { worker, fence, unit, key: Digest([1; 32]), trace, waited, bytes: 9 }
    }

    /// Steps join without gaps, and the worker's lie before the result came by what it says.
    #[test]
    fn the_steps_of_a_worker_are_counted_back_from_its_result() {
        let mut way = Way::brought(ms(3000), &header(ms(900), ms(200)), Some(lent()));
        way.step(Step::Transfer, ms(3010));
        assert_eq!(way.begun, ms(1000));
        assert_eq!(way.steps, [(Step::Wait, ms(1900)), (Step::Trace, ms(2800)), (Step::Transfer, ms(3010))]);
        let late = Way::brought(ms(3000), &header(ms(900), ms(200)), None);
        assert_eq!((late.begun, late.steps), (ms(1900), vec![(Step::Trace, ms(2800))]), "its lease was over");
    }

    /// A worker that lies, or whose clock runs fast, makes no step that begins before its lease or ends before it begins.
    #[test]
    fn no_step_is_outside_of_its_lease() {
        for (trace, waited) in [(Duration::MAX, ms(0)), (ms(0), Duration::MAX), (Duration::MAX, Duration::MAX)] {
            for lease in [Some(lent()), None] {
                let way = Way::brought(ms(3000), &header(trace, waited), lease);
                let ends: Vec<Duration> = way.steps.iter().map(|(_, end)| *end).collect();
                assert!(way.begun <= ends[0] && ends.is_sorted() && way.end() <= ms(3000), "{way:?}");
            }
        }
    }
}
