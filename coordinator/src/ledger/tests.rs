//! The ledger's promises, one by one; time is a number here. Under random workers, deaths, repetitions and delays: `random.rs`.

mod random;

use super::*;
use std::collections::HashMap;
use std::num::NonZeroU32;
use tilecast_core::scene::Digest;
use tilecast_core::settings::{
    Film, Filter, Integrator, IntegratorKind, SamplerKind, Settings, Strategy, Window, Without,
};

pub(crate) fn settings(width: u32, height: u32, spp: u32) -> Settings {
    Settings {
        film: Film { width, height, crop: Window { x0: 0, y0: 0, x1: width, y1: height }, filter: Filter::Box },
        spp,
        seed: 0,
        integrator: Integrator { kind: IntegratorKind::Path, max_depth: None, rr_depth: 5, hide_emitters: false },
        strategy: Strategy::Mis,
        sampler: SamplerKind::Sobol,
        without: Without::default(),
        half: Default::default(),
        offsets: Default::default(),
        scale_exponent: 60,
    }
}

fn spec(width: u32, height: u32, spp: u32) -> JobSpec {
    JobSpec { tile: Some(16), ..JobSpec::new(Digest([1; 32]), settings(width, height, spp)) }
}

fn info(threads: u32) -> WorkerInfo {
    WorkerInfo {
        threads,
        isa: String::new(),
        host: "h".into(),
        pid: 1,
        name: "w".into(),
        cpu: String::new(),
        instance: 7,
    }
}

/// A ledger, the time, and how often each sample of each pixel has been counted.
struct World {
    ledger: Ledger,
    now: Duration,
    counted: HashMap<(JobId, u32, u32, u32), u32>,
}

impl World {
    fn new(jobs: &[JobSpec]) -> Self {
        let mut ledger = Ledger::new(0, Policy::default());
        for job in jobs {
            ledger.add_job(Duration::ZERO, job.clone(), None).unwrap();
        }
        Self { ledger, now: Duration::ZERO, counted: HashMap::new() }
    }

    fn worker(&mut self, threads: u32) -> WorkerId {
        self.ledger.register(self.now, info(threads)).unwrap()
    }

    fn lease(&mut self, worker: WorkerId, slots: u32) -> Option<Vec<Lease>> {
        let request = LeaseRequest { worker, slots, known_jobs: Vec::new() };
        Some(self.ledger.lease(self.now, &request).ok()?.leases)
    }

    fn submit(&mut self, worker: WorkerId, lease: &Lease, trace_ms: u64) -> Verdict {
        let settings = self.ledger.progress(self.now, lease.unit.job).unwrap().settings;
        let header = ResultHeader {
            worker,
            fence: lease.fence,
            unit: lease.unit.clone(),
            key: work_key(&Digest([1; 32]), &settings),
            trace: Duration::from_millis(trace_ms),
            waited: Duration::ZERO,
            bytes: 0,
        };
        let verdict = self.ledger.accept(self.now, &header, None).verdict.unwrap();
        if verdict == Verdict::Accepted {
            let Unit { job, tile, samples } = lease.unit.clone();
            for (y, x) in (tile.y0..tile.y1).flat_map(|y| (tile.x0..tile.x1).map(move |x| (y, x))) {
                samples.clone().for_each(|i| *self.counted.entry((job, x, y, i)).or_default() += 1);
            }
            self.ledger.merged(self.now, job);
        }
        verdict
    }

    fn state(&self, job: u64) -> JobState {
        self.ledger.progress(self.now, JobId(job)).unwrap().state
    }

    /// One worker that always succeeds does what is left, once the others are forgotten; how many leases it took.
    fn finish(&mut self) -> usize {
        let worker = self.worker(2);
        let mut leases = 0;
        loop {
            self.now += Duration::from_millis(600);
            self.ledger.expire(self.now);
            let work = self.lease(worker, 4).unwrap();
            if work.is_empty() && self.ledger.workers.len() == 1 {
                return leases;
            }
            leases += work.len();
            assert!(leases < 100_000, "no end in sight");
            for lease in work {
                self.submit(worker, &lease, 100);
            }
        }
    }

    fn every_sample_counts_once(&self, jobs: &[JobSpec]) {
        let total: u64 = jobs.iter().map(|j| j.settings.film.crop.area() * u64::from(j.settings.spp)).sum();
        assert_eq!(self.counted.len() as u64, total);
        assert!(self.counted.values().all(|&n| n == 1));
    }
}

#[test]
fn a_silent_workers_units_are_given_out_again_in_time() {
    let jobs = [spec(32, 32, 4)];
    let mut world = World::new(&jobs);
    let (dead, alive) = (world.worker(1), world.worker(1));
    let lost = world.lease(dead, 1000).unwrap();
    assert!(!lost.is_empty());
    assert!(world.lease(alive, 1000).unwrap().is_empty());
    world.now += LEASE_SILENCE;
    world.ledger.heartbeat(world.now, &Heartbeat { worker: alive, fences: Vec::new(), samples: 0 }).unwrap();
    assert!(world.ledger.expire(world.now));
    let again = world.lease(alive, 1000).unwrap();
    assert_eq!(again.iter().map(|l| &l.unit).collect::<Vec<_>>(), lost.iter().map(|l| &l.unit).collect::<Vec<_>>());
    // The dead one was only slow: its results count, and the other is told to stop.
    lost.iter().for_each(|lease| assert_eq!(world.submit(dead, lease, 1), Verdict::Accepted));
    let beat = Heartbeat { worker: alive, fences: again.iter().map(|l| l.fence).collect(), samples: 0 };
    assert_eq!(world.ledger.heartbeat(world.now, &beat).unwrap().drop.len(), again.len());
    assert_eq!(world.submit(alive, &again[0], 1), Verdict::Ended);
    world.every_sample_counts_once(&jobs);
    assert_eq!(world.state(1), JobState::Finished);
}

#[test]
fn heartbeats_keep_a_lease() {
    let mut world = World::new(&[spec(32, 32, 4)]);
    let worker = world.worker(1);
    let leases = world.lease(worker, 1).unwrap();
    for _ in 0..60 {
        world.now += Duration::from_secs(1);
        let beat = Heartbeat { worker, fences: leases.iter().map(|l| l.fence).collect(), samples: 0 };
        assert_eq!(world.ledger.heartbeat(world.now, &beat), Ok(HeartbeatReply::default()));
        assert!(!world.ledger.expire(world.now));
    }
    // A heartbeat that does not name them does not: the reply with the leases may never have arrived.
    let beat = Heartbeat { worker, fences: Vec::new(), samples: 0 };
    world.now += LEASE_SILENCE;
    world.ledger.heartbeat(world.now, &beat).unwrap();
    assert!(world.ledger.expire(world.now));
    assert_eq!(world.lease(worker, 1).unwrap()[0].unit, leases[0].unit);
}

#[test]
fn a_result_for_another_job_of_the_same_number_is_stale() {
    let mut world = World::new(&[spec(32, 32, 4)]);
    let worker = world.worker(1);
    let lease = world.lease(worker, 1).unwrap().remove(0);
    let header = ResultHeader {
        worker,
        fence: lease.fence,
        unit: lease.unit,
        key: Digest([9; 32]),
        trace: Duration::from_millis(1),
        waited: Duration::ZERO,
        bytes: 0,
    };
    assert_eq!(world.ledger.accept(world.now, &header, None).verdict, Some(Verdict::Stale));
}

/// A client that sees the end may fetch the film: it must be whole by then.
#[test]
fn a_job_ends_when_the_last_sums_are_merged() {
    let mut world = World::new(&[spec(32, 16, 4)]);
    let worker = world.worker(1);
    let key = work_key(&Digest([1; 32]), &settings(32, 16, 4));
    let leases = world.lease(worker, 9).unwrap();
    assert_eq!(leases.len(), 2);
    for Lease { fence, unit } in leases {
        let header = ResultHeader {
            worker,
            fence,
            unit,
            key,
            trace: Duration::from_millis(1),
            waited: Duration::ZERO,
            bytes: 0,
        };
        assert_eq!(world.ledger.accept(world.now, &header, None).verdict, Some(Verdict::Accepted));
    }
    world.ledger.merged(world.now, JobId(1));
    assert_eq!(world.state(1), JobState::Running);
    world.ledger.merged(world.now, JobId(1));
    assert_eq!(world.state(1), JobState::Finished);
}

#[test]
fn a_sample_without_value_fails_the_job_and_the_next_one_goes_on() {
    let mut world = World::new(&[spec(32, 32, 4), spec(16, 16, 1)]);
    let worker = world.worker(1);
    let lease = world.lease(worker, 1).unwrap().remove(0);
    world.ledger.fail(world.now, worker, lease.fence, Failure::Sample("sample 3 of pixel (1, 2)".into())).unwrap();
    assert_eq!(world.state(1), JobState::Failed("sample 3 of pixel (1, 2)".into()));
    world.finish();
    assert_eq!(world.state(2), JobState::Finished);
    let ended: Vec<JobId> = world.ledger.take_ended().into_iter().map(|(id, ..)| id).collect();
    assert_eq!(ended, [JobId(1), JobId(2)]);
}

/// A night between two runs makes nobody believe that the rest takes weeks.
#[test]
fn a_job_that_was_interrupted_is_timed_from_where_it_goes_on() {
    let night = Duration::from_secs(36_000);
    let mut world = World::new(&[]);
    let id = JobId(3);
    let restored = RestoredJob { id, spec: spec(32, 16, 64), owner: None, queued_at: Duration::ZERO, end: None };
    let half = Ranges::from_sorted(std::iter::once(0..64).collect()).unwrap();
    world.ledger.restore_job(restored, vec![half, Ranges::default()]).unwrap();
    world.now = night;
    let worker = world.worker(1);
    let leases = world.lease(worker, 1).unwrap();
    world.now += Duration::from_secs(2);
    assert_eq!(world.submit(worker, &leases[0], 2000), Verdict::Accepted);
    world.lease(worker, 1).unwrap();
    let progress = world.ledger.progress(world.now, id).unwrap();
    assert_eq!(progress.samples_found, 16 * 16 * 64);
    assert_eq!(progress.samples_done, progress.samples_found + leases[0].unit.len());
    assert_eq!((progress.elapsed, progress.running), (night + Duration::from_secs(2), Duration::from_secs(2)));
    assert!((progress.samples_per_second - leases[0].unit.len() as f64 / 2.0).abs() < 1.0);
}

#[test]
fn a_unit_that_panics_goes_elsewhere_and_not_for_ever() {
    let mut world = World::new(&[spec(16, 16, 4)]);
    let (a, b) = (world.worker(1), world.worker(1));
    let fail = |world: &mut World, worker, lease: &Lease| {
        world.ledger.fail(world.now, worker, lease.fence, Failure::Panic("index out of range".into())).unwrap();
    };
    let first = world.lease(a, 1).unwrap().remove(0);
    fail(&mut world, a, &first);
    fail(&mut world, a, &first); // Repeated: not its lease any more.
    assert!(world.lease(a, 1).unwrap().is_empty(), "the same worker again");
    let second = world.lease(b, 1).unwrap().remove(0);
    fail(&mut world, b, &second);
    let third = world.lease(a, 1).unwrap().remove(0);
    assert_eq!(world.state(1), JobState::Running);
    fail(&mut world, a, &third);
    assert!(matches!(world.state(1), JobState::Failed(why) if why.contains("index out of range")));
}

#[test]
fn a_worker_that_cannot_have_the_scene_gets_none_of_it() {
    let mut world = World::new(&[spec(32, 32, 4)]);
    let (a, b) = (world.worker(1), world.worker(1));
    let leases = world.lease(a, 2).unwrap();
    world.ledger.fail(world.now, a, leases[0].fence, Failure::Scene("too large".into())).unwrap();
    assert!(world.lease(a, 4).unwrap().is_empty());
    assert_eq!(world.state(1), JobState::Running);
    let lease = world.lease(b, 4).unwrap().remove(0);
    world.ledger.fail(world.now, b, lease.fence, Failure::Scene("too large".into())).unwrap();
    assert!(matches!(world.state(1), JobState::Failed(why) if why.contains("too large")));
}

/// A thread that does a million samples a second gets units of about a second, and many small ones at the end.
#[test]
fn units_fit_the_worker_and_shrink_towards_the_end() {
    let jobs = [JobSpec { tile: Some(64), ..spec(256, 256, 512) }];
    let mut world = World::new(&jobs);
    let worker = world.worker(2);
    let mut sizes = Vec::new();
    while let Some(leases) = world.lease(worker, 1).filter(|leases| !leases.is_empty()) {
        for lease in leases {
            sizes.push(lease.unit.len());
            let trace_ms = lease.unit.len() / 1000;
            // Counted for the ledger alone: a map of all samples would be large.
            let header = ResultHeader {
                worker,
                fence: lease.fence,
                key: work_key(&jobs[0].scene, &jobs[0].settings),
                unit: lease.unit,
                trace: Duration::from_millis(trace_ms),
                waited: Duration::ZERO,
                bytes: 0,
            };
            assert_eq!(world.ledger.accept(world.now, &header, None).verdict, Some(Verdict::Accepted));
            world.ledger.merged(world.now, JobId(1));
        }
    }
    assert_eq!(world.state(1), JobState::Finished);
    let largest = sizes.iter().copied().max().unwrap();
    assert!((700_000..=1_500_000).contains(&largest), "{largest}");
    let last = sizes[sizes.len() - 4..].iter().copied().max().unwrap();
    assert!(last <= 64 * 64 * 16, "the last units have {last} samples");
    assert!(sizes.len() < 250, "{} units", sizes.len());
}

/// A unit that takes its workers with it: three times, then it is set aside, and the others are done. What its workers held
/// beside it is not blamed.
#[test]
fn a_unit_that_kills_three_workers_is_set_aside_and_the_others_go_on() {
    let mut world = World::new(&[JobSpec { name: "room.xml".into(), ..spec(64, 64, 8) }, spec(16, 16, 4)]);
    let killer = Window { x0: 16, y0: 16, x1: 32, y1: 32 };
    let deadly =
        |lease: &Lease| lease.unit.job == JobId(1) && lease.unit.tile == killer && lease.unit.samples.start == 0;
    let mut deaths = 0;
    for _ in 0..100 {
        world.now += LEASE_SILENCE;
        world.ledger.expire(world.now);
        let worker = world.worker(2);
        loop {
            let leases = world.lease(worker, 4).unwrap();
            if leases.is_empty() {
                world.ledger.leave(worker, &[]);
                break;
            }
            if leases.iter().any(deadly) {
                deaths += 1;
                break;
            }
            leases.iter().for_each(|lease| _ = world.submit(worker, lease, 10));
        }
    }
    assert_eq!(deaths, 3);
    let JobState::Failed(why) = world.state(1) else { panic!("{:?}", world.state(1)) };
    assert!(
        why.contains("1 units were set aside") && why.contains("render room.xml --crop 16,16,32,32 --spp"),
        "{why}"
    );
    assert_eq!(world.state(2), JobState::Finished);
    let of_first = world.counted.keys().filter(|key| key.0 == JobId(1)).count();
    assert!(of_first >= 64 * 64 * 8 - 16 * 16 * 8, "{of_first} samples of the first job are counted");
}

/// One of two workers is ten times slower: whoever is idle takes over what it still has in the tail.
#[test]
fn what_takes_too_long_in_the_tail_is_done_by_who_is_idle() {
    let jobs = [spec(64, 64, 64)];
    let mut world = World::new(&jobs);
    let (fast, slow) = (world.worker(1), world.worker(1));
    let held = world.lease(slow, 2).unwrap();
    assert!(!held.is_empty());
    let mut beats = 0;
    while world.state(1) == JobState::Running {
        let leases = world.lease(fast, 1).unwrap();
        if leases.is_empty() {
            // Both are alive all the time; only one gets anywhere.
            world.now += Duration::from_millis(500);
            for (worker, fences) in [(fast, vec![]), (slow, held.iter().map(|l| l.fence).collect())] {
                world.ledger.heartbeat(world.now, &Heartbeat { worker, fences, samples: 0 }).unwrap();
            }
            world.ledger.expire(world.now);
            beats += 1;
            assert!(beats < 20, "it waits for the slow one");
        }
        for lease in leases {
            world.now += Duration::from_millis(100);
            let beat = Heartbeat { worker: slow, fences: held.iter().map(|l| l.fence).collect(), samples: 0 };
            world.ledger.heartbeat(world.now, &beat).unwrap();
            world.submit(fast, &lease, 100);
        }
    }
    assert_eq!(world.submit(slow, &held[0], 9000), Verdict::Ended);
    world.every_sample_counts_once(&jobs);
}

/// A lease that is handed back is lent again at once; one that is kept is not.
#[test]
fn a_worker_that_drains_keeps_what_it_has_begun() {
    let mut world = World::new(&[spec(64, 64, 4)]);
    let (goes, stays) = (world.worker(1), world.worker(1));
    let leases = world.lease(goes, 3).unwrap();
    assert!(leases.len() >= 2);
    world.ledger.leave(goes, &[leases[0].fence]);
    let others = world.lease(stays, 1000).unwrap();
    assert!(others.iter().any(|other| other.unit == leases[1].unit), "handed back");
    assert!(!others.iter().any(|other| other.unit == leases[0].unit), "kept");
    assert_eq!(world.submit(goes, &leases[0], 10), Verdict::Accepted);
    world.ledger.leave(goes, &[]);
    assert!(!world.ledger.knows(goes));
}

/// A job may want few workers: the others get nothing of it until a place is free, and a unit that failed comes back to the only one.
#[test]
fn a_job_is_worked_on_by_no_more_than_it_wants() {
    let job = JobSpec { workers_max: NonZeroU32::new(1), ..spec(64, 64, 8) };
    let mut world = World::new(std::slice::from_ref(&job));
    let (first, second) = (world.worker(1), world.worker(1));
    let leases = world.lease(first, 1).unwrap();
    assert!(world.lease(second, 1).unwrap().is_empty());
    world.ledger.fail(world.now, first, leases[0].fence, Failure::Panic("once".into())).unwrap();
    assert_eq!(world.lease(first, 1).unwrap()[0].unit, leases[0].unit, "nobody else is there for it");
    world.ledger.leave(first, &[]);
    assert!(!world.lease(second, 1).unwrap().is_empty(), "its place is free");
    world.ledger.leave(second, &[]);
    world.finish();
    world.every_sample_counts_once(std::slice::from_ref(&job));
}

#[test]
fn three_results_that_make_no_sense_shut_a_worker_out_for_good() {
    let mut world = World::new(&[spec(32, 32, 4)]);
    let worker = world.worker(1);
    world.lease(worker, 1).unwrap();
    assert!(!world.ledger.offence(worker, "bad") && !world.ledger.offence(worker, "bad"));
    assert!(world.ledger.offence(worker, "worse"));
    assert!(world.lease(worker, 1).is_none(), "it is not registered any more");
    let refusal = world.ledger.register(world.now, info(1)).unwrap_err();
    assert!(matches!(&refusal, LedgerError::ShutOut(why) if why.contains("worse")), "{refusal}");
    let other = world.ledger.register(world.now, WorkerInfo { instance: 8, ..info(1) }).unwrap();
    assert!(!world.lease(other, 9).unwrap().is_empty(), "its units are others' now");
}

/// Ten thousand workers, each finishing a unit every five seconds and heard every second: what the ledger does for them in
/// ten seconds takes it a small part of that. The bound is that of a machine busy with other tests; alone it takes half a
/// second. Fails if anything done for a unit looks at all workers or all units.
#[test]
fn ten_thousand_workers_keep_the_ledger_a_small_part_of_a_core_busy() {
    const WORKERS: u64 = 10_000;
    let jobs = [JobSpec { tile: Some(64), ..spec(4096, 4096, 1 << 16) }];
    let key = work_key(&jobs[0].scene, &jobs[0].settings);
    let mut world = World::new(&jobs);
    let workers: Vec<WorkerId> = (0..WORKERS).map(|_| world.worker(1)).collect();
    let mut held: Vec<Vec<Lease>> = workers.iter().map(|&worker| world.lease(worker, 2).unwrap()).collect();
    let begun = std::time::Instant::now();
    let mut units = 0;
    for tenth in 0..100u64 {
        world.now += Duration::from_millis(100);
        for (i, &worker) in workers.iter().enumerate() {
            if (i as u64 + tenth).is_multiple_of(10) {
                let fences = held[i].iter().map(|lease| lease.fence).collect();
                world.ledger.heartbeat(world.now, &Heartbeat { worker, fences, samples: 0 }).unwrap();
            }
            if (i as u64 + tenth).is_multiple_of(50) {
                let Lease { fence, unit } = held[i].remove(0);
                let header = ResultHeader {
                    worker,
                    fence,
                    unit,
                    key,
                    trace: Duration::from_secs(5),
                    waited: Duration::ZERO,
                    bytes: 0,
                };
                assert!(world.ledger.accept(world.now, &header, None).merge);
                world.ledger.merged(world.now, JobId(1));
                held[i].extend(world.lease(worker, 1).unwrap());
                units += 1;
            }
        }
        if tenth % 5 == 0 {
            world.ledger.expire(world.now);
        }
    }
    assert_eq!(units, WORKERS * 2);
    assert_eq!(world.ledger.workers.len() as u64, WORKERS);
    assert!(begun.elapsed() < Duration::from_secs(5), "{:?} for ten seconds", begun.elapsed());
}
