//! The account of one job: which samples are counted, which are lent, which are yet to be cut into units.
//!
//! A unit, once cut, stays as it is until it is counted, whoever works on it, so that two results of it are two results of
//! the same thing. What is counted is remembered as ranges, which grow together: the account stays small however many units
//! there were.

use super::ranges::Ranges;
use crate::plan::Plan;
use std::collections::{HashMap, HashSet, VecDeque};
use std::ops::Range;
use std::time::Duration;
use tilecast_core::film::REPLICATES;
use tilecast_core::film::RelativeError;
use tilecast_core::scene::Digest;
use tilecast_proto::types::{Fence, JobSpec, JobState, Unit, Verdict, WorkerId};

/// A unit within its job: tile number and first sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct UnitKey {
    pub tile: u32,
    pub start: u32,
}

/// A unit that is cut and not counted yet.
#[derive(Clone, Debug, Default)]
pub(super) struct Open {
    pub end: u32,
    /// Who works on it; `None` while it waits in `returned`.
    pub lease: Option<(WorkerId, Fence)>,
    /// How often the tracer panicked on it.
    pub panics: u32,
    /// How often whoever held it fell silent.
    pub losses: u32,
    /// Who failed last: someone else should try.
    pub avoid: Option<WorkerId>,
}

/// Where the next unit is cut: rounds one after another, in each the tiles in their order.
#[derive(Clone, Copy, Debug, Default)]
struct Cursor {
    round: usize,
    /// Into `Plan::order`.
    place: usize,
    /// Samples of that tile and round that are cut already.
    cut: u32,
}

#[derive(Debug)]
pub(super) struct Job {
    pub spec: JobSpec,
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
    pub samples_done: u64,
    pub samples_cut: u64,
    pub samples_total: u64,
    /// Units counted here whose sums are not in the film yet.
    pub merging: u32,
    /// Samples a second on one thread, by worker.
    pub rates: HashMap<WorkerId, f64>,
    /// Workers that cannot prepare its scene.
    pub barred: HashSet<WorkerId>,
    pub relative_error: Option<RelativeError>,
    pub queued_at: Duration,
    pub started_at: Option<Duration>,
    pub ended_at: Option<Duration>,
}

impl Job {
    pub fn new(now: Duration, spec: JobSpec, key: Digest, plan: Plan) -> Self {
        let samples_total = spec.settings.film.crop.area() * u64::from(spec.settings.spp);
        Self {
            key,
            state: JobState::Queued,
            cursor: Cursor::default(),
            done: vec![Ranges::default(); plan.order.len()],
            plan,
            open: HashMap::new(),
            returned: VecDeque::new(),
            samples_done: 0,
            samples_cut: 0,
            samples_total,
            merging: 0,
            rates: HashMap::new(),
            barred: HashSet::new(),
            relative_error: None,
            queued_at: now,
            started_at: None,
            ended_at: None,
            spec,
        }
    }

    /// A unit that was given back, for this worker; `alone` if no other worker could take it.
    pub fn take_returned(&mut self, worker: WorkerId, alone: bool) -> Option<UnitKey> {
        for _ in 0..self.returned.len() {
            let key = self.returned.pop_front()?;
            match self.open.get(&key) {
                Some(open) if open.avoid == Some(worker) && !alone => self.returned.push_back(key),
                Some(_) => return Some(key),
                None => {}
            }
        }
        None
    }

    /// Cuts the next unit, of about `samples` samples; `None` when everything is cut.
    pub fn cut(&mut self, samples: u64) -> Option<UnitKey> {
        let round = self.plan.rounds.get(self.cursor.round)?.clone();
        let tile = self.plan.order[self.cursor.place];
        let area = self.plan.tile(tile).area();
        let start = round.start + self.cursor.cut;
        let left = round.end - start;
        // Whole sets of replicates, and no small remainder that would be a unit of its own.
        let replicates = REPLICATES as u64;
        let wanted = (samples / area / replicates).max(1) * replicates;
        let count = if u64::from(left) * 2 < wanted * 3 { left } else { wanted as u32 };
        if count < left {
            self.cursor.cut += count;
        } else {
            self.cursor.cut = 0;
            self.cursor.place += 1;
            if self.cursor.place == self.plan.order.len() {
                self.cursor.place = 0;
                self.cursor.round += 1;
            }
        }
        self.samples_cut += area * u64::from(count);
        let key = UnitKey { tile, start };
        self.open.insert(key, Open { end: start + count, ..Open::default() });
        Some(key)
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
        } else {
            Verdict::Stale
        }
    }

    /// Counts a unit whose verdict is [`Verdict::Accepted`], and says who else had it.
    pub fn count(&mut self, unit: &Unit) -> Option<Open> {
        let tile = self.plan.index_of(&unit.tile)?;
        let open = self.open.remove(&UnitKey { tile, start: unit.samples.start })?;
        self.done[tile as usize].insert(unit.samples.clone());
        self.samples_done += unit.len();
        self.merging += 1;
        Some(open)
    }

    /// The samples of a unit of this job.
    pub fn samples(&self, key: UnitKey) -> Range<u32> {
        key.start..self.open.get(&key).map_or(key.start, |open| open.end)
    }

    /// How many whole rounds are counted, as far as the number of samples tells.
    pub fn rounds_done(&self) -> usize {
        let area = self.spec.settings.film.crop.area();
        self.plan.rounds.iter().take_while(|round| area * u64::from(round.end) <= self.samples_done).count()
    }

    /// Samples a second on one thread of `worker`, or of the others while it has not brought anything.
    pub fn rate(&self, worker: WorkerId) -> Option<f64> {
        let mean = || self.rates.values().sum::<f64>() / self.rates.len() as f64;
        self.rates.get(&worker).copied().or_else(|| (!self.rates.is_empty()).then(mean))
    }

    /// Ends the job; its account is not needed any more.
    pub fn end(&mut self, now: Duration, state: JobState) {
        self.state = state;
        self.ended_at = Some(now);
        self.open = HashMap::new();
        self.returned = VecDeque::new();
        self.done = Vec::new();
        self.plan.order = Vec::new();
        self.rates = HashMap::new();
    }
}
