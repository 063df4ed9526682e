//! Who is still there: heartbeats, departures, silence, and units that others wait for.

use super::{
    DECISION_PATIENCE, Fence, Heartbeat, HeartbeatReply, Held, JobId, LEASE_SILENCE, Ledger, LedgerError, News,
    OVERDUE_FACTOR, UNIT_LOSSES_MAX, WorkerId,
};
use std::collections::HashSet;
use std::time::Duration;
use tilecast_proto::limits::{HEARTBEAT_MS, HEARTBEAT_MS_MAX, LEASE_SILENCE_MS};

/// Whoever was not heard for so long when its leases lapse has probably died.
const SILENCE_OF_THE_DEAD: Duration = Duration::from_millis(LEASE_SILENCE_MS * 3 / 5);
/// So many workers more let all say a millisecond less often that they live: that is most of what a crowd says.
const HEARTBEAT_CROWD: u64 = 10;

impl Ledger {
    /// How often a worker is to be heard.
    pub fn heartbeat_ms(&self) -> u64 {
        (HEARTBEAT_MS + self.workers.len() as u64 / HEARTBEAT_CROWD).min(HEARTBEAT_MS_MAX)
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

    /// A worker goes: its units wait for others. It stays, with those that it is to bring yet, until it says so again.
    pub fn leave(&mut self, id: WorkerId, keep: &[Fence]) {
        self.take_back(id, |fence, _| !keep.contains(fence));
        if !keep.is_empty() {
            return;
        }
        if let Some(worker) = self.workers.remove(&id) {
            self.threads -= u64::from(worker.info.threads);
        }
        self.jobs.values_mut().for_each(|job| job.forget(id));
    }

    /// Takes back leases that lapsed, forgets silent workers, and looks for units that take too long; whether there is work
    /// to give out again.
    pub fn expire(&mut self, now: Duration) -> bool {
        let mut any = false;
        for id in self.workers.keys().copied().collect::<Vec<_>>() {
            let leases = self.lent(id, |_, held| held.deadline <= now);
            let lost = self.take_back(id, |_, held| held.deadline <= now);
            any |= !lost.is_empty();
            if !lost.is_empty() {
                self.totals.leases_lost += lost.len() as u64;
                self.news.push(News::Lapsed { worker: id, leases });
            }
            // A lease that lapses while its worker is heard was never received: nobody died of it.
            if self.workers.get(&id).is_some_and(|worker| worker.heard_at + SILENCE_OF_THE_DEAD <= now) {
                self.blame(now, &lost);
            }
            if let Some(worker) = self.workers.get(&id).filter(|worker| worker.heard_at + LEASE_SILENCE <= now) {
                self.news.push(News::Silent { worker: id, info: worker.info.clone() });
                self.leave(id, &[]);
                any = true;
            }
        }
        for job in self.jobs.values_mut().filter(|job| !job.state.is_final()) {
            any |= job.find_overdue(now, OVERDUE_FACTOR);
        }
        self.give_up_checks(now);
        any
    }

    /// The coordinator itself stood still for so long: nobody is to blame for not having been heard.
    pub fn forgive(&mut self, pause: Duration) {
        for worker in self.workers.values_mut() {
            worker.heard_at += pause;
            worker.leases.values_mut().for_each(|held| held.deadline += pause);
        }
    }

    /// Units whose holder fell silent: one of them may be why. If one did the same before, it is that one.
    fn blame(&mut self, now: Duration, lost: &[Held]) {
        let suspect = |held: &&Held| {
            self.jobs.get(&held.job).and_then(|job| job.open.get(&held.unit)).is_some_and(|o| o.suspect())
        };
        let suspects: Vec<Held> = lost.iter().filter(suspect).copied().collect();
        let blamed = if suspects.is_empty() { lost } else { &suspects };
        for held in blamed.iter().filter(|held| !held.audit) {
            let Some(open) = self.jobs.get_mut(&held.job).and_then(|job| job.open.get_mut(&held.unit)) else {
                continue;
            };
            open.losses += 1;
            if open.losses >= UNIT_LOSSES_MAX {
                let why = format!("{UNIT_LOSSES_MAX} workers fell silent while they traced it");
                self.quarantine(now, held.job, held.unit, &why);
            }
        }
    }

    /// Ends checks that nobody present can do, when nothing else is left to do.
    fn give_up_checks(&mut self, now: Duration) {
        let present: HashSet<u64> = self.workers.values().map(|worker| worker.info.instance).collect();
        let mut complete: Vec<JobId> = Vec::new();
        let mut stuck = Vec::new();
        for (&id, job) in &mut self.jobs {
            if job.state.is_final() || job.audits.is_empty() || job.samples_done < job.samples_total {
                continue;
            }
            let undecided =
                job.audits.drop_hopeless(now, |who| present.contains(&who), present.len(), DECISION_PATIENCE);
            match undecided {
                Some(key) => stuck.push((id, job.replay(key))),
                None => complete.push(id),
            }
        }
        for (id, replay) in stuck {
            let why = format!(
                "two workers disagree about the bits of a unit, and no third came to decide; start another worker and submit \
                 again, or replay it on both with: {replay}"
            );
            self.fail_job(now, id, why);
        }
        complete.into_iter().for_each(|id| self.end_if_complete(now, id));
    }

    /// Whether a worker is registered.
    pub fn knows(&self, id: WorkerId) -> bool {
        self.workers.contains_key(&id)
    }
}
