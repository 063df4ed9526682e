//! How many samples each tile gets for an image of a given error, decided so that the image stays unbiased.
//!
//! A *pilot* of its own seed, which is not part of the image, says where the noise is. The image's replicates form two halves,
//! independent of each other. Each half is traced to a count that only the pilot knows of; then the noise of each decides the
//! final counts of the *other*. So the number of samples that a mean is over never depends on those samples. docs/adaptive.md
//! has the argument.
//!
//! Pure: it is given films, which are exact, and says what to trace next. So the counts are a function of scene, settings
//! and target, whoever traces.

mod noise;
#[cfg(test)]
mod tests;

use crate::plan::{Plan, PlanError, TILES_MAX};
use noise::{Model, Noise};
use std::ops::Range;
use tilecast_core::film::Film;
use tilecast_core::film::file::Target;
use tilecast_core::film::ranges::Ranges;
use tilecast_core::settings::{Half, Settings, Window};
use tilecast_proto::limits::RANGES_MAX;

/// Side of the tiles that get counts of their own, in pixels: enough pixels that two replicates tell their noise well, and
/// few enough that noise differs between tiles. Doubled for pictures that would have too many.
const SIDE: u32 = 8;
/// The pilot begins with so many samples a pixel: fewer would take light that is found by one sample in ten for none.
const PILOT_FIRST: u32 = 16;
/// It goes on to so many where few pixels carry the noise, as by a lamp smaller than a pixel: they say little of it, and what that
/// costs is little to what they need.
const PILOT_OF_FEW: f64 = 128.0;
/// How far all must grow is said by pilot and half together, if the half has not seen so many times as many samples.
const PILOT_WEIGHS: f64 = 2.0;
/// The pilot grows until it is this part of what it predicts…
const PILOT_SHARE: f64 = 1.0 / 32.0;
/// … and no further than this.
const PILOT_MAX: u32 = 1 << 12;
/// Both halves are traced to this part of what the pilot predicts before they decide for each other: late enough that the
/// end is near, early enough that the prediction may be too high.
const FIRST_SHARE: f64 = 0.55;
/// Aimed at, relative to the target: estimates of the error err a little, too, and more often to the low side.
const AIM: f64 = 0.965;
/// The final counts are at most so many times the first ones: noise that a first look missed must not run away with the time.
const GROWTH_MAX: f64 = 32.0;
/// A pixel has at most so many samples.
const SPP_MAX: f64 = (1u32 << 30) as f64;
/// Samples come in sets of one for each replicate.
const SET: u32 = 4;

/// What to trace next.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// Whether what it makes is of the pilot, and not of the image.
    pub pilot: bool,
    /// How; `spp` covers the ranges.
    pub settings: Settings,
    /// Side of the tiles.
    pub tile: u32,
    /// One range for all tiles, or one for each.
    pub samples: Vec<Range<u32>>,
    /// Samples that will have been traced in the end, over all pixels, as far as can be said now.
    pub expected: Option<f64>,
}

/// An image that has reached its target.
#[derive(Clone, Debug)]
pub struct Reached {
    /// The image, weighted by halves.
    pub film: Film,
    /// Which samples of each half each tile has.
    pub tiles: Vec<(Window, Half, Ranges)>,
    /// The job's settings, with `spp` the most that a pixel has.
    pub settings: Settings,
    /// Samples traced in all, over all pixels, the pilot's included.
    pub traced: u64,
}

/// See the module.
#[derive(Debug)]
pub struct Search {
    settings: Settings,
    target: Target,
    side: u32,
    tiles: Vec<Window>,
    traced: u64,
    state: State,
}

/// What a pilot has found.
#[derive(Debug)]
struct Pilot {
    /// Its samples a pixel.
    count: u32,
    noise: Noise,
    /// γ over its last doublings.
    rate: f64,
}

#[derive(Debug)]
enum State {
    /// The pilot so far, its count, and the image's noise at each count before.
    Pilot {
        film: Option<Film>,
        count: u32,
        history: Vec<(u32, Noise)>,
    },
    /// Counts that the pilot chose.
    First {
        pilot: Pilot,
        counts: Vec<u32>,
    },
    /// One half after the other to the counts that the other one chose.
    Last {
        film: Film,
        half: Half,
        from: Vec<u32>,
        halves: [Vec<u32>; 2],
    },
    Done(Box<Reached>),
}

impl Search {
    /// Begins. `settings.spp` does not matter.
    ///
    /// # Errors
    /// A picture of too many tiles.
    pub fn new(settings: &Settings, target: Target) -> Result<Self, PlanError> {
        let mut side = SIDE;
        let plan = loop {
            let plan = Plan::new(settings, Some(side), std::slice::from_ref(&(0..1)))?;
            if plan.order.len() <= RANGES_MAX || side >= tilecast_proto::limits::TILE_SIDE_MAX {
                break plan;
            }
            side *= 2;
        };
        let count = u32::try_from(plan.order.len()).unwrap_or(u32::MAX);
        let tiles = (0..count).map(|index| plan.tile(index)).collect();
        let state = State::Pilot { film: None, count: 0, history: Vec::new() };
        Ok(Self { settings: settings.clone(), target, side, tiles, traced: 0, state })
    }

    /// What to trace next; `None` at the end.
    pub fn step(&self) -> Option<Step> {
        let step = |samples: Vec<Range<u32>>, half: Half| {
            let spp = samples.iter().map(|range| range.end).max().unwrap_or(1).max(1);
            Step {
                pilot: false,
                settings: Settings { spp, half, ..self.settings.clone() },
                tile: self.side,
                samples,
                expected: self.expected(),
            }
        };
        match &self.state {
            State::Pilot { count, .. } => {
                let next = (2 * count).max(PILOT_FIRST);
                let mut step = step(std::iter::once(*count..next).collect(), Half::Both);
                step.pilot = true;
                step.settings.seed = pilot_seed(self.settings.seed);
                Some(step)
            }
            State::First { counts, .. } => Some(step(counts.iter().map(|&n| 0..n).collect(), Half::Both)),
            State::Last { half, from, halves, .. } => {
                // A half's own indices: it has two of four replicates.
                let to = of_half(halves, *half);
                Some(step(from.iter().zip(to).map(|(&from, &to)| from / 2..to / 2).collect(), *half))
            }
            State::Done(_) => None,
        }
    }

    /// Goes on with the film of the step. Steps that have nothing to trace are not given out.
    pub fn take(&mut self, film: Film) {
        let pixels = film.counts().iter().flatten().map(|&count| u64::from(count)).sum::<u64>();
        self.traced += pixels;
        let placeholder = State::Pilot { film: None, count: 0, history: Vec::new() };
        self.state = match std::mem::replace(&mut self.state, placeholder) {
            State::Pilot { film: so_far, count, history } => self.pilot(so_far, count, history, film),
            State::First { pilot, counts } => self.exchange(pilot, counts, film),
            State::Last { film: mut all, half, from, halves } => {
                all.join(&film);
                let left: &[Half] = if half == Half::First { &[Half::Second] } else { &[] };
                self.last(all, left, from, halves)
            }
            State::Done(reached) => State::Done(reached),
        };
    }

    /// The image, if it is there.
    pub fn reached(self) -> Option<Reached> {
        match self.state {
            State::Done(reached) => Some(*reached),
            _ => None,
        }
    }

    fn pilot(&self, so_far: Option<Film>, count: u32, mut history: Vec<(u32, Noise)>, film: Film) -> State {
        let film = match so_far {
            Some(mut all) => {
                all.join(&film);
                all
            }
            None => film,
        };
        let count = (2 * count).max(PILOT_FIRST);
        history.push((count, Noise::of(&film, Half::Both, &self.tiles)));
        let Some((model, counts)) = self.predict(&history) else {
            return State::Pilot { film: Some(film), count, history };
        };
        let expected = model.mean(&counts);
        let few = history.last().is_some_and(|(_, noise)| noise.is_on_few());
        let least = if few { PILOT_OF_FEW.min(0.5 * expected) } else { 0.0 };
        if f64::from(count) < least.max(PILOT_SHARE * expected) && count < PILOT_MAX {
            return State::Pilot { film: Some(film), count, history };
        }
        let counts = counts.iter().map(|n| in_sets(FIRST_SHARE * n)).collect();
        let noise = history.pop().map_or_else(|| Noise::of(&film, Half::Both, &self.tiles), |(_, noise)| noise);
        State::First { pilot: Pilot { count, noise, rate: model.rate() }, counts }
    }

    /// What a pilot predicts, and the counts; `None` while it says too little.
    fn predict(&self, history: &[(u32, Noise)]) -> Option<(Model, Vec<f64>)> {
        let (count, noise) = history.last()?;
        // Two doublings tell more than one, and more would tell of counts that are far away.
        let (earlier, before) = history.iter().rev().take(3).skip(1).last()?;
        let factor = f64::from(*count) / f64::from(*earlier);
        let rate = noise.rate(before, factor, self.target);
        let at_one = noise.at_one(&vec![*count; self.tiles.len()], rate);
        let model = Model::new(&at_one, self.target, rate);
        let counts = model.counts(&at_one, &vec![0; self.tiles.len()], AIM);
        Some((model, counts))
    }

    /// Each half's noise decides the other's counts; where samples go, pilot and half decide together.
    fn exchange(&self, pilot: Pilot, counts: Vec<u32>, film: Film) -> State {
        let mean = counts.iter().map(|&count| f64::from(count)).sum::<f64>() / counts.len() as f64;
        // Two replicates of few pixels may agree by chance; and a half that has not seen many more samples tells no more.
        let pilot_tells = pilot.noise.is_on_few() || PILOT_WEIGHS * f64::from(pilot.count) > mean;
        let decided_by = |half: Half| -> Vec<u32> {
            let noise = Noise::of(&film, half, &self.tiles);
            let since = || noise.rate_since(&pilot.noise, pilot.count, &counts, self.target);
            let rate = if pilot_tells { pilot.rate } else { since() };
            let seen = noise.at_one(&counts, rate);
            let both = seen.with(&pilot.noise.at_one(&vec![pilot.count; counts.len()], rate));
            let model = Model::new(&both, self.target, rate);
            let wanted = model.counts(if pilot_tells { &both } else { &seen }, &counts, AIM);
            wanted.iter().zip(&counts).map(|(&n, &first)| in_sets(n.min(GROWTH_MAX * f64::from(first)))).collect()
        };
        let halves = [decided_by(Half::Second), decided_by(Half::First)];
        self.last(film, &[Half::First, Half::Second], counts, halves)
    }

    /// Goes on with the first of these halves that has something to trace.
    fn last(&self, film: Film, left: &[Half], from: Vec<u32>, halves: [Vec<u32>; 2]) -> State {
        match left.iter().find(|&&half| *of_half(&halves, half) != from) {
            Some(&half) => State::Last { film, half, from, halves },
            None => self.done(film, halves),
        }
    }

    fn done(&self, mut film: Film, halves: [Vec<u32>; 2]) -> State {
        film.half = Half::Both;
        film.halves = true;
        let mut tiles = Vec::with_capacity(2 * self.tiles.len());
        for (half, counts) in [Half::First, Half::Second].into_iter().zip(&halves) {
            for (&tile, &count) in self.tiles.iter().zip(counts) {
                let mut samples = Ranges::default();
                samples.insert(0..count / 2);
                tiles.push((tile, half, samples));
            }
        }
        let most = halves[0].iter().zip(&halves[1]).map(|(a, b)| a / 2 + b / 2).max().unwrap_or(1);
        let settings = Settings { spp: most, ..self.settings.clone() };
        State::Done(Box::new(Reached { film, tiles, settings, traced: self.traced }))
    }

    fn expected(&self) -> Option<f64> {
        let area = |i: usize| self.tiles[i].area() as f64;
        let total = |counts: &[u32]| counts.iter().enumerate().map(|(i, &n)| area(i) * f64::from(n)).sum::<f64>();
        let traced = self.traced as f64;
        match &self.state {
            State::Pilot { history, .. } => {
                let pixels: f64 = (0..self.tiles.len()).map(area).sum();
                self.predict(history).map(|(model, counts)| pixels * model.mean(&counts) * (1.0 + PILOT_SHARE))
            }
            State::First { counts, .. } => Some(traced + total(counts) / FIRST_SHARE),
            State::Last { half, from, halves, .. } => {
                let left = |to: &Vec<u32>| 0.5 * (total(to) - total(from));
                let first = if *half == Half::First { left(&halves[0]) } else { 0.0 };
                Some(traced + first + left(&halves[1]))
            }
            State::Done(_) => Some(traced),
        }
    }
}

/// The counts of the first or the second half.
fn of_half(halves: &[Vec<u32>; 2], half: Half) -> &Vec<u32> {
    &halves[usize::from(half == Half::Second)]
}

/// At least so many samples, in whole sets.
fn in_sets(count: f64) -> u32 {
    let sets = (count.clamp(1.0, SPP_MAX) / f64::from(SET)).ceil();
    sets as u32 * SET
}

/// The pilot's random numbers are none of the image's.
fn pilot_seed(seed: u64) -> u64 {
    seed ^ 0x7069_6c6f_7400_0000
}

const _: () = assert!(RANGES_MAX as u64 <= TILES_MAX);
