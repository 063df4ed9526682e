//! The account of one job: which samples are counted, which are lent, which are yet to be cut into units.
//!
//! A unit, once cut, stays as it is until it is counted, whoever works on it, so that two results of it are two results of
//! the same thing. What is counted is remembered as ranges, which grow together: the account stays small however many units
//! there were.

use super::audit::Audits;
use super::report::Point;
use crate::plan::Plan;
use std::collections::{BTreeMap, HashMap, HashSet, VecDeque};
use std::ops::Range;
use std::time::Duration;
use tilecast_core::film::REPLICATES;
use tilecast_core::film::RelativeError;
use tilecast_core::film::ranges::Ranges;
use tilecast_core::scene::Digest;
use tilecast_proto::types::{
    Contribution, Fence, JobSpec, JobState, ResultHeader, Unit, Verdict, WorkerId, WorkerInfo,
};

/// Points of an error's way that are kept: rounds double, so that there are some thirty.
const HISTORY_LEN_MAX: usize = 64;
/// Times of so many units say what is usual.
const TIMES_KEPT: usize = 64;

/// A unit within its job: tile number and first sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(super) struct UnitKey {
    pub tile: u32,
    pub start: u32,
}

/// A unit that is cut and not counted yet.
#[derive(Clone, Debug, Default)]
pub(super) struct Open {
    pub end: u32,
    /// Who works on it: nobody while it waits in `returned` or is set aside, two while it is duplicated.
    pub leases: Vec<(WorkerId, Fence)>,
    /// Since when the first of them has it.
    pub since: Duration,
    /// How often the tracer panicked on it.
    pub panics: u32,
    /// How often whoever held it fell silent, as far as it is to blame.
    pub losses: u32,
    /// Who failed last: someone else should try.
    pub avoid: Option<WorkerId>,
}

impl Open {
    /// It may have killed workers: whoever takes it takes no other such unit beside it.
    pub fn suspect(&self) -> bool {
        self.losses > 1
    }
}

/// Where the next unit is cut: rounds one after another, in each the tiles in their order.
#[derive(Clone, Copy, Debug, Default)]
struct Cursor {
    round: usize,
    /// Into `Plan::order`.
    place: usize,
    /// Samples of that tile and round that are behind the cursor already.
    passed: u32,
}

#[derive(Debug)]
pub(super) struct Job {
    pub spec: JobSpec,
    /// Who may cancel it; anybody if `None`.
    pub owner: Option<Digest>,
    /// What results must name, see [`tilecast_proto::convert::work_key`].
    pub key: Digest,
    pub state: JobState,
    pub plan: Plan,
    cursor: Cursor,
    /// By tile number.
    done: Vec<Ranges>,
    pub open: HashMap<UnitKey, Open>,
    /// Units given back and not lent again; entries whose unit is counted meanwhile are skipped.
    pub returned: VecDeque<UnitKey>,
    /// Units that nobody gets any more, and why.
    pub quarantined: HashMap<UnitKey, String>,
    /// Units that take unusually long: an idle worker may have them too.
    pub overdue: VecDeque<UnitKey>,
    pub audits: Audits,
    pub samples_done: u64,
    /// Of these, those of before the coordinator was started again.
    pub samples_found: u64,
    pub samples_cut: u64,
    pub samples_total: u64,
    /// See [`Plan::totals`].
    totals: Vec<u64>,
    /// Units counted here whose sums are not in the film yet.
    pub merging: u32,
    /// Spent checking and adding up results.
    pub merge_time: Duration,
    /// By whoever was lent something of it.
    pub contributions: BTreeMap<WorkerId, Contribution>,
    /// Samples a second on one thread, by worker.
    pub rates: HashMap<WorkerId, f64>,
    /// From lease to result, of the last units.
    times: VecDeque<Duration>,
    /// Workers that cannot prepare its scene.
    pub barred: HashSet<WorkerId>,
    /// Who has a place among those that work on it, where there are not places for all.
    crew: HashSet<WorkerId>,
    pub relative_error: Option<RelativeError>,
    /// How the error came down.
    pub history: Vec<Point>,
    pub queued_at: Duration,
    pub started_at: Option<Duration>,
    pub ended_at: Option<Duration>,
}

impl Job {
    pub fn new(now: Duration, spec: JobSpec, owner: Option<Digest>, key: Digest, plan: Plan) -> Self {
        let totals = plan.totals();
        Self {
            owner,
            key,
            state: JobState::Queued,
            cursor: Cursor::default(),
            done: vec![Ranges::default(); plan.order.len()],
            plan,
            open: HashMap::new(),
            returned: VecDeque::new(),
            quarantined: HashMap::new(),
            overdue: VecDeque::new(),
            audits: Audits::default(),
            samples_done: 0,
            samples_found: 0,
            samples_cut: 0,
            samples_total: totals.last().copied().unwrap_or(0),
            totals,
            merging: 0,
            merge_time: Duration::ZERO,
            contributions: BTreeMap::new(),
            rates: HashMap::new(),
            times: VecDeque::new(),
            barred: HashSet::new(),
            crew: HashSet::new(),
            relative_error: None,
            history: Vec::new(),
            queued_at: now,
            started_at: None,
            ended_at: None,
            spec,
        }
    }

    /// Counts what was counted before the coordinator was started again, by tile number.
    pub fn restore(&mut self, done: Vec<Ranges>) {
        let counted = |(tile, ranges): (usize, &Ranges)| self.plan.tile(tile as u32).area() * ranges.count();
        self.samples_done = done.iter().enumerate().map(counted).sum();
        self.samples_cut = self.samples_done;
        self.samples_found = self.samples_done;
        self.done = done;
        if self.samples_done > 0 {
            self.state = JobState::Running;
        }
    }

    /// A unit that was given back, for this worker; `alone` if no other worker could take it.
    pub fn take_returned(&mut self, worker: WorkerId, alone: bool) -> Option<UnitKey> {
        let holds_one = |open: &HashMap<UnitKey, Open>| {
            open.values().any(|o| o.suspect() && o.leases.iter().any(|(holder, _)| *holder == worker))
        };
        for _ in 0..self.returned.len() {
            let key = self.returned.pop_front()?;
            match self.open.get(&key) {
                Some(open) if open.avoid == Some(worker) && !alone => self.returned.push_back(key),
                Some(open) if open.suspect() && holds_one(&self.open) => self.returned.push_back(key),
                Some(_) => return Some(key),
                None => {}
            }
        }
        None
    }

    /// Cuts the next unit, of about `samples` samples; `None` when everything is cut.
    pub fn cut(&mut self, samples: u64) -> Option<UnitKey> {
        loop {
            let round = self.plan.rounds.get(self.cursor.round)?.clone();
            let tile = self.plan.order[self.cursor.place];
            // Results that came uncut, or before a restart, are gaps in what is left.
            let wanted = self.plan.wanted(tile);
            let start = (round.start + self.cursor.passed).max(wanted.start);
            let end = round.end.min(wanted.end);
            let gap = if start < end { self.done[tile as usize].gap(start, end) } else { start..start };
            if gap.is_empty() {
                self.next_tile();
                continue;
            }
            let area = self.plan.tile(tile).area();
            let left = gap.end - gap.start;
            // Whole sets of replicates, and no small remainder that would be a unit of its own.
            let replicates = REPLICATES as u64;
            let wanted = (samples / area / replicates).max(1) * replicates;
            let count = if u64::from(left) * 2 < wanted * 3 { left } else { wanted as u32 };
            self.cursor.passed = gap.start + count - round.start;
            if gap.start + count == end {
                self.next_tile();
            }
            self.samples_cut += area * u64::from(count);
            let key = UnitKey { tile, start: gap.start };
            self.open.insert(key, Open { end: gap.start + count, ..Open::default() });
            return Some(key);
        }
    }

    fn next_tile(&mut self) {
        self.cursor.passed = 0;
        self.cursor.place += 1;
        if self.cursor.place == self.plan.order.len() {
            self.cursor.place = 0;
            self.cursor.round += 1;
        }
    }

    /// A unit that takes unusually long, for an idle worker that does not have it.
    pub fn take_overdue(&mut self, worker: WorkerId) -> Option<UnitKey> {
        for _ in 0..self.overdue.len() {
            let key = self.overdue.pop_front()?;
            match self.open.get(&key) {
                Some(open) if open.leases.len() != 1 => {}
                Some(open) if open.leases[0].0 == worker || open.avoid == Some(worker) => self.overdue.push_back(key),
                Some(_) => return Some(key),
                None => {}
            }
        }
        None
    }

    /// Looks for units that take more than `factor` times what is usual, once all are cut; whether there are any.
    pub fn find_overdue(&mut self, now: Duration, factor: f64) -> bool {
        self.overdue.clear();
        if self.samples_cut < self.samples_total || !self.returned.is_empty() || self.times.is_empty() {
            return false;
        }
        let mut times: Vec<Duration> = self.times.iter().copied().collect();
        times.sort_unstable();
        let limit = times[times.len() / 2].mul_f64(factor);
        let late = |open: &Open| open.leases.len() == 1 && open.since + limit < now && !open.suspect();
        let mut found: Vec<(Duration, UnitKey)> =
            self.open.iter().filter(|(_, open)| late(open)).map(|(&key, open)| (open.since, key)).collect();
        found.sort_unstable();
        self.overdue.extend(found.into_iter().map(|(_, key)| key));
        !self.overdue.is_empty()
    }

    /// Samples of a full tile with one index for each replicate: nothing smaller is worth a message.
    pub fn smallest_unit(&self) -> u64 {
        self.plan.tile(0).area() * REPLICATES as u64
    }

    /// What a result is worth. One whose key is another's belongs to another job of the same number.
    pub fn verdict(&self, unit: &Unit, key: &Digest) -> Verdict {
        if self.state.is_final() {
            return Verdict::Ended;
        }
        let Some(tile) = self.plan.index_of(&unit.tile).filter(|_| *key == self.key) else {
            return Verdict::Stale;
        };
        let open = self.open.get(&UnitKey { tile, start: unit.samples.start });
        if open.is_some_and(|open| open.end == unit.samples.end) {
            Verdict::Accepted
        } else if self.done[tile as usize].contains(&unit.samples) {
            Verdict::Duplicate
        } else if self.wants(tile, &unit.samples) && self.is_uncut(tile, &unit.samples) {
            // Cut by this coordinator before it was started again.
            Verdict::Accepted
        } else {
            Verdict::Stale
        }
    }

    fn wants(&self, tile: u32, samples: &Range<u32>) -> bool {
        let wanted = self.plan.wanted(tile);
        wanted.start <= samples.start && samples.end <= wanted.end
    }

    /// Whether no unit that is counted or open has any of these samples.
    fn is_uncut(&self, tile: u32, samples: &Range<u32>) -> bool {
        let meets =
            |(key, open): (&UnitKey, &Open)| key.tile == tile && key.start < samples.end && samples.start < open.end;
        !self.done[tile as usize].overlaps(samples) && !self.open.iter().any(meets)
    }

    /// Whether this can be a unit of this job at all, however it was cut.
    pub fn plausible(&self, unit: &Unit) -> bool {
        // The tiles of an ended job are not known any more.
        self.state.is_final() || self.plan.index_of(&unit.tile).is_some_and(|tile| self.wants(tile, &unit.samples))
    }

    /// Counts a unit whose verdict is [`Verdict::Accepted`], and says who had it.
    pub fn count(&mut self, now: Duration, unit: &Unit) -> Open {
        let Some(tile) = self.plan.index_of(&unit.tile) else { return Open::default() };
        let key = UnitKey { tile, start: unit.samples.start };
        let open = self.open.remove(&key).unwrap_or_else(|| {
            self.samples_cut += unit.len();
            Open::default()
        });
        self.quarantined.remove(&key);
        if !open.leases.is_empty() {
            if self.times.len() == TIMES_KEPT {
                self.times.pop_front();
            }
            self.times.push_back(now.saturating_sub(open.since));
        }
        self.done[tile as usize].insert(unit.samples.clone());
        self.samples_done += unit.len();
        self.merging += 1;
        open
    }

    /// Whether a worker may have something of this job, other than to check it.
    pub fn has_place_for(&self, worker: WorkerId) -> bool {
        let places = self.places();
        places.is_none_or(|places| self.crew.contains(&worker) || self.crew.len() < places)
    }

    /// How many workers may work on it at a time, if not all.
    pub fn places(&self) -> Option<usize> {
        self.spec.workers_max.map(|most| most.get() as usize)
    }

    /// A worker takes its place, if it has none yet.
    pub fn join(&mut self, worker: WorkerId) {
        if self.spec.workers_max.is_some() {
            self.crew.insert(worker);
        }
    }

    /// A worker cannot prepare the scene: another may have its place.
    pub fn bar(&mut self, worker: WorkerId) {
        self.barred.insert(worker);
        self.crew.remove(&worker);
    }

    /// A worker is gone.
    pub fn forget(&mut self, worker: WorkerId) {
        self.rates.remove(&worker);
        self.barred.remove(&worker);
        self.crew.remove(&worker);
    }

    /// Notes that a worker gets something of the job.
    pub fn lent_to(&mut self, now: Duration, worker: WorkerId, info: &WorkerInfo) {
        let since = now.saturating_sub(self.queued_at);
        self.contributions.entry(worker).or_insert_with(|| Contribution {
            worker,
            info: info.clone(),
            units: 0,
            samples: 0,
            trace: Duration::ZERO,
            first: since,
            last: since,
        });
    }

    /// Notes that a worker has brought what counts.
    pub fn brought(&mut self, now: Duration, header: &ResultHeader) {
        if let Some(contribution) = self.contributions.get_mut(&header.worker) {
            contribution.units += 1;
            contribution.samples += header.unit.len();
            contribution.trace += header.trace;
            contribution.last = now.saturating_sub(self.queued_at);
        }
    }

    /// Notes what the film says of its error now.
    pub fn set_relative_error(&mut self, now: Duration, error: Option<RelativeError>) {
        self.relative_error = error;
        if let Some(error) = error {
            if self.history.len() == HISTORY_LEN_MAX {
                self.history.remove(1);
            }
            let running = now.saturating_sub(self.started_at.unwrap_or(now));
            self.history.push(Point { running, samples: self.samples_done, error });
        }
    }

    /// Takes counted samples out again: they wait to be done anew.
    pub fn uncount(&mut self, tile: u32, samples: Range<u32>) {
        self.done[tile as usize].remove(&samples);
        self.samples_done -= self.plan.tile(tile).area() * u64::from(samples.end - samples.start);
        let key = UnitKey { tile, start: samples.start };
        self.open.insert(key, Open { end: samples.end, ..Open::default() });
        self.returned.push_back(key);
    }

    /// The samples of a unit of this job.
    pub fn samples(&self, key: UnitKey) -> Range<u32> {
        key.start..self.open.get(&key).map_or(key.start, |open| open.end)
    }

    /// How many whole rounds are counted, as far as the number of samples tells.
    pub fn rounds_done(&self) -> usize {
        self.totals.iter().take_while(|&&total| total <= self.samples_done).count()
    }

    /// Samples a second on one thread of `worker`, or of the others while it has not brought anything.
    pub fn rate(&self, worker: WorkerId) -> Option<f64> {
        let mean = || self.rates.values().sum::<f64>() / self.rates.len() as f64;
        self.rates.get(&worker).copied().or_else(|| (!self.rates.is_empty()).then(mean))
    }

    /// How to trace a unit alone.
    pub fn replay(&self, key: UnitKey) -> String {
        let (tile, end) = (self.plan.tile(key.tile), self.samples(key).end);
        let name = if self.spec.name.is_empty() { "SCENE" } else { &self.spec.name };
        let seed = self.spec.settings.seed;
        format!(
            "tilecast render {name} --crop {},{},{},{} --spp {end} --seed {seed} --threads 1",
            tile.x0, tile.y0, tile.x1, tile.y1
        )
    }

    /// What the job comes to when nothing more can be done of it; `None` while something can.
    pub fn outcome(&self) -> Option<JobState> {
        if self.state.is_final() || self.merging > 0 || !self.audits.is_empty() {
            return None;
        }
        let aside = |key: &UnitKey| self.plan.tile(key.tile).area() * self.samples(*key).len() as u64;
        let set_aside: u64 = self.quarantined.keys().map(aside).sum();
        if self.samples_done + set_aside < self.samples_total {
            return None;
        }
        let mut why: Vec<&str> = self.quarantined.values().map(String::as_str).collect();
        why.sort_unstable();
        Some(match why.first() {
            None => JobState::Finished,
            Some(first) => JobState::Failed(format!("{} units were set aside; {first}", why.len())),
        })
    }

    /// Ends the job; its account is not needed any more.
    pub fn end(&mut self, now: Duration, state: JobState) {
        self.state = state;
        self.ended_at = Some(now);
        self.open = HashMap::new();
        self.returned = VecDeque::new();
        self.overdue = VecDeque::new();
        self.quarantined = HashMap::new();
        self.audits = Audits::default();
        self.done = Vec::new();
        self.plan.order = Vec::new();
        self.rates = HashMap::new();
    }
}
