//! What workers bring: results that count, results that are checked, and reports of failure.

use super::audit::{Contributor, Finding, NEWCOMER_UNITS};
use super::job::UnitKey;
use super::{
    Failure, Fence, JobId, JobState, Ledger, LedgerError, News, OFFENCES_MAX, Outcome, RATE_BLEND, ResultHeader,
    UNIT_PANICS_MAX, Verdict, WorkerId,
};
use std::ops::Range;
use std::time::Duration;
use tilecast_core::scene::Digest;
use tilecast_proto::types::Unit;

impl Ledger {
    /// What [`Ledger::accept`] would say now: a result that is not wanted need not be read.
    pub fn verdict(&self, header: &ResultHeader) -> Verdict {
        let Some(job) = self.jobs.get(&header.unit.job) else { return Verdict::Ended };
        match job.verdict(&header.unit, &header.key) {
            Verdict::Duplicate if self.checks(header).is_some() => Verdict::Accepted,
            // Whoever cannot be held to account must register first.
            Verdict::Accepted if self.policy.verify > 0.0 && !self.workers.contains_key(&header.worker) => {
                Verdict::Stale
            }
            verdict => verdict,
        }
    }

    /// The check that this result is for.
    fn checks(&self, header: &ResultHeader) -> Option<UnitKey> {
        let job = self.jobs.get(&header.unit.job).filter(|job| job.key == header.key)?;
        let key = UnitKey { tile: job.plan.index_of(&header.unit.tile)?, start: header.unit.samples.start };
        job.audits.expects(key, header.unit.samples.end, header.worker, header.fence).then_some(key)
    }

    /// Whether results are compared, so that [`Ledger::accept`] needs their digest.
    pub fn compares(&self) -> bool {
        self.policy.verify > 0.0
    }

    /// Who is behind a worker's number; 0 for one that is not registered.
    pub fn contributor(&self, worker: WorkerId) -> Contributor {
        self.workers.get(&worker).map_or(0, |worker| worker.info.instance)
    }

    /// Counts a result whose sums were checked, once. `sums` is their digest, where results are compared.
    pub fn accept(&mut self, now: Duration, header: &ResultHeader, sums: Option<Digest>) -> Outcome {
        let verdict = self.verdict(header);
        if let Some(worker) = self.workers.get_mut(&header.worker) {
            worker.heard_at = now;
        }
        if let (Some(key), Some(sums)) = (self.checks(header), sums) {
            return self.compare(now, header, key, sums);
        }
        let who = self.contributor(header.worker);
        let unit = &header.unit;
        let Some(job) = self.jobs.get_mut(&unit.job).filter(|_| verdict == Verdict::Accepted) else {
            return Outcome { verdict: Some(verdict), ..Outcome::default() };
        };
        let rounds = job.rounds_done();
        let open = job.count(now, unit);
        job.brought(now, header);
        self.totals.units += 1;
        self.totals.samples += unit.len();
        let rate = unit.len() as f64 / header.trace.as_secs_f64().max(1e-6);
        if let Some(worker) = self.workers.get_mut(&header.worker) {
            worker.units_done += 1;
            worker.samples_done += unit.len();
            worker.rate = Some(blend(worker.rate, rate));
            let known = job.rates.get(&header.worker).copied();
            job.rates.insert(header.worker, blend(known, rate));
        }
        let round_done = job.rounds_done() > rounds;
        for (worker, fence) in open.leases {
            if let Some(worker) = self.workers.get_mut(&worker) {
                worker.leases.remove(&fence);
            }
        }
        let standing = self.standings.entry(who).or_default();
        standing.units = standing.units.saturating_add(1);
        let newcomer = standing.units <= NEWCOMER_UNITS;
        if let Some(sums) = sums
            && who != 0
            && (newcomer || self.policy.picks(header.fence))
            && let Some(tile) = job.plan.index_of(&unit.tile)
        {
            job.audits.open(now, UnitKey { tile, start: unit.samples.start }, unit.samples.end, (who, sums));
        }
        Outcome { verdict: Some(verdict), merge: true, round_done, ..Outcome::default() }
    }

    /// A unit was done again: the bits agree, or someone is at fault.
    fn compare(&mut self, now: Duration, header: &ResultHeader, key: UnitKey, sums: Digest) -> Outcome {
        let mut outcome = Outcome { verdict: Some(Verdict::Accepted), ..Outcome::default() };
        let id = header.unit.job;
        let who = self.contributor(header.worker);
        if let Some(worker) = self.workers.get_mut(&header.worker) {
            worker.leases.remove(&header.fence);
        }
        let Some(job) = self.jobs.get_mut(&id) else { return outcome };
        match job.audits.claim(key, (who, sums)) {
            Finding::Agreed => self.end_if_complete(now, id),
            Finding::Undecided => {}
            Finding::Guilty(wrong) => {
                let text = format!(
                    "of {:?}, samples {:?}, it brought other sums than two others",
                    header.unit.tile, header.unit.samples
                );
                for liar in wrong {
                    self.shut_out(liar, text.clone());
                    outcome.convicted.push(liar);
                }
                outcome.recall = self.jobs.iter().filter(|(_, job)| !job.state.is_final()).map(|(&id, _)| id).collect();
                for id in &outcome.recall {
                    if let Some(job) = self.jobs.get_mut(id) {
                        // Until [`Ledger::recalled`].
                        job.merging += 1;
                    }
                }
            }
            Finding::Hopeless => {
                let replay = job.replay(UnitKey { tile: key.tile, start: key.start });
                let why = format!("no two of five workers agree about a unit; replay it with `{replay}` on each");
                self.end_job(now, id, JobState::Failed(why));
            }
        }
        outcome
    }

    /// Units of the convicted were taken out of a job's film: they are to be done again.
    pub fn recalled(&mut self, now: Duration, id: JobId, units: &[(u32, Range<u32>)]) {
        if let Some(job) = self.jobs.get_mut(&id).filter(|job| !job.state.is_final()) {
            units.iter().for_each(|(tile, samples)| job.uncount(*tile, samples.clone()));
        }
        self.merged(now, id);
    }

    /// The sums of an accepted result were not merged, since whoever brought it was convicted meanwhile.
    pub fn unmerged(&mut self, now: Duration, unit: &Unit) {
        let tile = self.jobs.get(&unit.job).and_then(|job| job.plan.index_of(&unit.tile));
        let units: Vec<(u32, Range<u32>)> = tile.map(|tile| (tile, unit.samples.clone())).into_iter().collect();
        self.recalled(now, unit.job, &units);
    }

    /// Notes what checking and adding up a result has taken.
    pub fn merge_took(&mut self, id: JobId, time: Duration) {
        self.totals.merging += time;
        if let Some(job) = self.jobs.get_mut(&id) {
            job.merge_time += time;
        }
    }

    /// The sums of an accepted result are in the film.
    pub fn merged(&mut self, now: Duration, id: JobId) {
        if let Some(job) = self.jobs.get_mut(&id) {
            job.merging = job.merging.saturating_sub(1);
            self.end_if_complete(now, id);
        }
    }

    /// A worker brought what makes no sense; whether it is shut out now.
    pub fn offence(&mut self, worker: WorkerId, what: &str) -> bool {
        let who = self.contributor(worker);
        if who == 0 {
            return false;
        }
        let standing = self.standings.entry(who).or_default();
        standing.offences += 1;
        let often = standing.offences >= OFFENCES_MAX;
        if often {
            self.shut_out(who, format!("it brought {OFFENCES_MAX} results that make no sense, at last: {what}"));
        }
        often
    }

    /// Whether this can be a unit of its job; if not, a worker that brings it makes things up.
    pub fn plausible(&self, header: &ResultHeader) -> bool {
        let job = self.jobs.get(&header.unit.job).filter(|job| job.key == header.key);
        job.is_none_or(|job| job.plausible(&header.unit))
    }

    fn shut_out(&mut self, who: Contributor, why: String) {
        self.standings.entry(who).or_default().shut_out = Some(why);
        let of_it = self.workers.iter().filter(|(_, worker)| worker.info.instance == who);
        for id in of_it.map(|(&id, _)| id).collect::<Vec<_>>() {
            self.leave(id, &[]);
        }
        for job in self.jobs.values_mut() {
            for (worker, fence) in job.audits.drop_claims(who) {
                if let Some(worker) = self.workers.get_mut(&worker) {
                    worker.leases.remove(&fence);
                }
            }
        }
    }

    /// A worker gives a unit back that it could not do. A lease that is not its own any more changes nothing.
    ///
    /// # Errors
    /// An unknown worker.
    pub fn fail(&mut self, now: Duration, id: WorkerId, fence: Fence, failure: Failure) -> Result<(), LedgerError> {
        let worker = self.workers.get_mut(&id).ok_or(LedgerError::UnknownWorker(id))?;
        worker.heard_at = now;
        let host = format!("worker {} on {}", worker.info.name, worker.info.host);
        let Some(held) = worker.leases.get(&fence).copied() else { return Ok(()) };
        self.take_back(id, |other, _| *other == fence);
        let Some(job) = self.jobs.get_mut(&held.job) else { return Ok(()) };
        if let Some(open) = job.open.get_mut(&held.unit) {
            open.avoid = Some(id);
        }
        match failure {
            Failure::Sample(text) if !held.audit => self.end_job(now, held.job, JobState::Failed(text)),
            Failure::Panic(text) if !held.audit => {
                let Some(open) = job.open.get_mut(&held.unit) else { return Ok(()) };
                open.panics += 1;
                if open.panics >= UNIT_PANICS_MAX {
                    let often = format!("it panicked {UNIT_PANICS_MAX} times, last on {host}: {text}");
                    self.quarantine(now, held.job, held.unit, &often);
                }
            }
            Failure::Scene(text) => {
                job.bar(id);
                if self.workers.keys().all(|worker| job.barred.contains(worker)) {
                    let why = format!("no worker can prepare the scene, last {host}: {text}");
                    self.end_job(now, held.job, JobState::Failed(why));
                } else {
                    self.take_back(id, |_, other| other.job == held.job);
                }
            }
            Failure::Sample(_) | Failure::Panic(_) => {}
        }
        Ok(())
    }

    /// Sets a unit aside, so that the others go on.
    pub(super) fn quarantine(&mut self, now: Duration, id: JobId, unit: UnitKey, why: &str) {
        let Some(job) = self.jobs.get_mut(&id) else { return };
        let text = format!("{why}; replay it with: {}", job.replay(unit));
        job.returned.retain(|other| *other != unit);
        self.news.push(News::SetAside { job: id, why: text.clone() });
        job.quarantined.insert(unit, text);
        self.end_if_complete(now, id);
    }
}

impl super::Policy {
    /// Whether the unit of this lease is checked.
    fn picks(&self, fence: Fence) -> bool {
        // SplitMix64's finalizer.
        let mut x = fence.0 ^ self.seed;
        x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        x ^= x >> 31;
        ((x >> 11) as f64) < self.verify * (1u64 << 53) as f64
    }
}

fn blend(old: Option<f64>, new: f64) -> f64 {
    old.map_or(new, |old| old + (new - old) * RATE_BLEND)
}
