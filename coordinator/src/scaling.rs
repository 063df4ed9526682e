//! The real ledger on simulated time: how a job would go with more workers than there are, and what would be saturated first.
//!
//! A worker here holds as many units as a real one and traces them at the pace that was measured, tile by tile; messages take
//! the time and the coordinator the work that was measured. Nothing fails.

use crate::ledger::{Ledger, Policy};
use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};
use std::time::Duration;
use tilecast_core::settings::Window;
use tilecast_proto::convert::work_key;
use tilecast_proto::limits::SLOTS_PER_THREAD;
use tilecast_proto::types::{
    Fence, Heartbeat, JobSpec, JobState, Lease, LeaseRequest, ResultHeader, WorkerId, WorkerInfo,
};

/// What was measured.
#[derive(Clone, Debug)]
pub struct Costs {
    /// Pieces of the picture, and the seconds that a sample of one of their pixels takes.
    pub tiles: Vec<(Window, f64)>,
    /// Seconds of any other piece.
    pub sample: f64,
    /// A call to the coordinator and back, in seconds.
    pub call: f64,
    /// The coordinator's work for a result, in seconds a pixel.
    pub merge_pixel: f64,
    /// Threads on which it does that.
    pub merge_threads: u32,
    /// Bytes of a result, a pixel.
    pub bytes_pixel: f64,
    /// The coordinator's line, in bytes a second.
    pub line: f64,
}

/// How it went. Seconds are of threads, summed over all workers; shares are of the whole time.
#[derive(Clone, Copy, Debug)]
pub struct Simulated {
    /// From the first request to the end.
    pub seconds: f64,
    /// Tracing.
    pub tracing: f64,
    /// From a worker's last result to the end.
    pub tail: f64,
    /// All the rest: for work, and for messages.
    pub waiting: f64,
    /// The part of the time that the coordinator's threads were adding up.
    pub merge_share: f64,
    /// The part of the time that its line was full.
    pub line_share: f64,
    /// Units.
    pub units: u64,
}

/// What happens to a worker.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Event {
    /// It asks for work.
    Ask(usize),
    /// A unit of it is traced.
    Traced(usize),
    /// A result of it is added up.
    Merged(usize, u64),
    /// All say that they live.
    Beat,
}

struct Worker {
    id: WorkerId,
    pace: f64,
    queue: VecDeque<Lease>,
    tracing: Option<Lease>,
    asking: bool,
    waits: bool,
    /// Results on their way.
    bringing: Vec<Fence>,
    unit_samples: u64,
    last: f64,
    traced: f64,
}

/// Those who found no work ask again after so many seconds; a coordinator wakes them when a unit comes back.
const ASK_AGAIN: f64 = 0.1;
/// Heartbeats, in seconds.
const BEAT: f64 = 1.0;

/// A simulation that takes so many times the work of one worker, and some, does not end.
const PATIENCE: f64 = 10.0;

/// Simulates `workers` workers of one thread each; `None` if that cannot be, or does not end.
pub fn simulate(spec: &JobSpec, workers: u32, costs: &Costs) -> Option<Simulated> {
    simulate_crew(spec, &vec![1.0; workers as usize], 0.0, costs)
}

/// The same for one worker for each of `paces`, that many times as slow as was measured; `verify` is the share of units that are
/// checked.
fn simulate_crew(spec: &JobSpec, paces: &[f64], verify: f64, costs: &Costs) -> Option<Simulated> {
    let mut ledger = Ledger::new(1, Policy { verify, seed: 0 });
    let now = |seconds: f64| Duration::from_secs_f64(seconds.max(0.0));
    let job = ledger.add_job(Duration::ZERO, spec.clone(), None).ok()?;
    let key = work_key(&spec.scene, &spec.settings);
    let mut all = Vec::new();
    for (instance, &pace) in (1..).zip(paces) {
        let id = ledger.register(Duration::ZERO, info(instance)).ok()?;
        all.push(Worker {
            id,
            pace,
            queue: VecDeque::new(),
            tracing: None,
            asking: true,
            waits: false,
            bringing: Vec::new(),
            unit_samples: 1,
            last: 0.0,
            traced: 0.0,
        });
    }
    let mut sim = Sim {
        events: BinaryHeap::new(),
        next: 0,
        results: Vec::new(),
        mergers: vec![0.0; costs.merge_threads.max(1) as usize],
        merge_busy: 0.0,
        line_free: 0.0,
        line_busy: 0.0,
    };
    for (i, _) in all.iter().enumerate() {
        sim.at(costs.call, Event::Ask(i));
    }
    sim.at(BEAT, Event::Beat);
    let mut units = 0;
    let work = spec.settings.film.crop.area() as f64 * f64::from(spec.settings.spp) * costs.sample;
    while let Some(Reverse((Time(time), _, event))) = sim.events.pop() {
        if time > PATIENCE * (work + 100.0) {
            return None;
        }
        match event {
            Event::Ask(i) => {
                let worker = &mut all[i];
                let slots = SLOTS_PER_THREAD - busy(worker).min(SLOTS_PER_THREAD);
                let request = LeaseRequest { worker: worker.id, slots: slots.max(1), known_jobs: vec![job] };
                let reply = ledger.lease(now(time), &request).ok()?;
                worker.waits = reply.leases.is_empty();
                worker.asking = worker.waits;
                worker.unit_samples = reply.unit_samples.max(1);
                worker.queue.extend(reply.leases);
                if worker.waits {
                    sim.at(time + ASK_AGAIN, Event::Ask(i));
                }
                // The answer is on its way for half a call.
                begin(&mut all[i], i, time + 0.5 * costs.call, costs, &mut sim);
            }
            Event::Traced(i) => {
                let worker = &mut all[i];
                let Some(lease) = worker.tracing.take() else { continue };
                let pixels = lease.unit.tile.area() as f64;
                let trace = worker.pace * seconds(&lease, costs);
                worker.traced += trace;
                sim.send(time, i, pixels, costs);
                let header = ResultHeader {
                    worker: worker.id,
                    fence: lease.fence,
                    unit: lease.unit,
                    key,
                    trace: now(trace),
                    waited: Duration::ZERO,
                    bytes: 0,
                };
                worker.bringing.push(header.fence);
                sim.results.push(Some(header));
                begin(worker, i, time, costs, &mut sim);
                if !worker.asking && busy(worker) < SLOTS_PER_THREAD {
                    worker.asking = true;
                    sim.at(time + 0.5 * costs.call, Event::Ask(i));
                }
            }
            Event::Merged(i, result) => {
                let Some(header) = sim.results.get_mut(result as usize).and_then(Option::take) else { continue };
                all[i].bringing.retain(|fence| *fence != header.fence);
                // All are honest.
                let outcome = ledger.accept(now(time), &header, (verify > 0.0).then_some(key));
                if outcome.merge {
                    units += 1;
                    ledger.merged(now(time), job);
                    all[i].last = time;
                }
                if ledger.progress(now(time), job).ok()?.state == JobState::Finished {
                    return Some(sim.told(time, &all, units, costs));
                }
            }
            Event::Beat => {
                for worker in &all {
                    let held = worker.queue.iter().chain(&worker.tracing).map(|lease| lease.fence);
                    let fences = held.chain(worker.bringing.iter().copied()).collect();
                    let beat = Heartbeat { worker: worker.id, fences, samples: 0 };
                    ledger.heartbeat(now(time), &beat).ok()?;
                }
                ledger.expire(now(time));
                sim.at(time + BEAT, Event::Beat);
            }
        }
    }
    None
}

/// Slots that a worker's untraced units take.
fn busy(worker: &Worker) -> u32 {
    let held = worker.queue.iter().chain(&worker.tracing);
    let samples: u64 = held.map(|lease| lease.unit.len()).sum();
    u32::try_from(samples.div_ceil(worker.unit_samples)).unwrap_or(u32::MAX)
}

fn begin(worker: &mut Worker, i: usize, time: f64, costs: &Costs, sim: &mut Sim) {
    if worker.tracing.is_none()
        && let Some(lease) = worker.queue.pop_front()
    {
        sim.at(time + worker.pace * seconds(&lease, costs), Event::Traced(i));
        worker.tracing = Some(lease);
    }
}

/// What tracing a unit takes.
fn seconds(lease: &Lease, costs: &Costs) -> f64 {
    let unit = &lease.unit;
    let (mut known, mut area) = (0.0, 0.0);
    for (tile, sample) in &costs.tiles {
        if let Some(part) = tile.intersection(&unit.tile) {
            known += part.area() as f64 * sample;
            area += part.area() as f64;
        }
    }
    let rest = unit.tile.area() as f64 - area;
    (known + rest * costs.sample) * f64::from(unit.samples.end - unit.samples.start)
}

fn info(instance: u64) -> WorkerInfo {
    WorkerInfo {
        threads: 1,
        isa: String::new(),
        host: String::new(),
        pid: 0,
        name: String::new(),
        cpu: String::new(),
        instance,
    }
}

/// Seconds that can be ordered.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Time(f64);

impl Eq for Time {}

impl Ord for Time {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.0.total_cmp(&other.0)
    }
}

impl PartialOrd for Time {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

struct Sim {
    events: BinaryHeap<Reverse<(Time, u64, Event)>>,
    next: u64,
    results: Vec<Option<ResultHeader>>,
    /// When each of the coordinator's threads is free, and how long they have worked.
    mergers: Vec<f64>,
    merge_busy: f64,
    line_free: f64,
    line_busy: f64,
}

impl Sim {
    fn at(&mut self, time: f64, event: Event) {
        self.events.push(Reverse((Time(time), self.next, event)));
        self.next += 1;
    }

    /// A result goes over the coordinator's line, one after another, and is added up by the next thread that is free.
    fn send(&mut self, time: f64, worker: usize, pixels: f64, costs: &Costs) {
        let on_line = pixels * costs.bytes_pixel / costs.line;
        self.line_free = self.line_free.max(time) + on_line;
        self.line_busy += on_line;
        let merge = pixels * costs.merge_pixel;
        let arrives = self.line_free + 0.5 * costs.call;
        let done = match self.mergers.iter_mut().min_by(|a, b| a.total_cmp(b)) {
            Some(free) => {
                *free = free.max(arrives) + merge;
                *free
            }
            None => arrives,
        };
        self.merge_busy += merge;
        let result = self.results.len() as u64;
        self.at(done, Event::Merged(worker, result));
    }

    fn told(&self, end: f64, workers: &[Worker], units: u64, costs: &Costs) -> Simulated {
        let tracing: f64 = workers.iter().map(|worker| worker.traced).sum();
        let tail: f64 = workers.iter().map(|worker| end - worker.last).sum();
        let threads = f64::from(costs.merge_threads.max(1));
        Simulated {
            seconds: end,
            tracing,
            tail,
            waiting: (end * workers.len() as f64 - tracing - tail).max(0.0),
            merge_share: self.merge_busy / (threads * end),
            line_share: self.line_busy / end,
            units,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ledger::tests::settings;
    use tilecast_core::scene::Digest;

    fn spec(spp: u32) -> JobSpec {
        JobSpec::new(Digest([1; 32]), settings(256, 256, spp))
    }

    fn costs() -> Costs {
        Costs {
            tiles: Vec::new(),
            sample: 1e-6,
            call: 1e-3,
            merge_pixel: 1e-7,
            merge_threads: 1,
            bytes_pixel: 100.0,
            line: 1e8,
        }
    }

    /// Few workers share the work without loss; many are held up by what there is one of, and that is named.
    #[test]
    fn it_scales_until_something_is_full() {
        let of = |workers: u32, costs: &Costs| simulate(&spec(4096), workers, costs).unwrap();
        let (one, four) = (of(1, &costs()), of(4, &costs()));
        let work = 256.0 * 256.0 * 4096.0 * 1e-6;
        assert!((one.tracing - work).abs() < 0.01 * work && one.seconds < 1.02 * work, "{one:?}");
        assert!(4.0 * four.seconds < 1.05 * one.seconds, "{four:?}");
        let slow_line = Costs { line: 1e6, ..costs() };
        let many = of(64, &slow_line);
        assert!(many.line_share > 0.9 && 64.0 * many.seconds > 2.0 * one.seconds, "{many:?}");
        let slow_merge = Costs { merge_pixel: 1e-4, ..costs() };
        assert!(of(64, &slow_merge).merge_share > 0.9);
    }

    /// Units fit the pace of whoever takes them, and in the tail others take over. Fails if all get units of one size.
    #[test]
    fn a_worker_ten_times_slower_holds_nobody_up() {
        for paces in [vec![1.0, 10.0], vec![1.0, 1.0, 1.0, 10.0]] {
            let work = 256.0 * 256.0 * 4096.0 * 1e-6;
            let ideal = work / paces.iter().map(|pace| 1.0 / pace).sum::<f64>();
            let uneven = simulate_crew(&spec(4096), &paces, 0.0, &costs()).unwrap();
            assert!(uneven.seconds <= 1.25 * ideal, "{paces:?}: {uneven:?}, and ideal are {ideal} s");
        }
    }

    /// Of a job and one twice as long, the difference is what is done when nobody is a newcomer any more. Fails if the proven are
    /// checked like newcomers.
    #[test]
    fn checks_of_the_proven_cost_a_tenth_at_most() {
        let tracing = |spp| simulate_crew(&spec(spp), &[1.0; 4], 0.05, &costs()).unwrap().tracing;
        let work = 256.0 * 256.0 * f64::from(1 << 14) * 1e-6;
        let again = (tracing(1 << 15) - tracing(1 << 14)) / work - 1.0;
        assert!((0.03..0.1).contains(&again), "{again}");
    }

    #[test]
    fn hundreds_of_workers_end() {
        let crowd = simulate(&spec(1 << 16), 600, &costs()).unwrap();
        assert!(crowd.seconds > 0.0 && crowd.units >= 600, "{crowd:?}");
    }
}
