//! Real processes that are killed, stopped and drained at random: the digest is that of a render alone, and nobody helps.
//!
//! TILECAST_RUNS says how often each is done: few in CI, a hundred by `just soak`.

use crate::harness::{Folder, Running, coordinator_with, free_address, is_soak, poll, scene};
use serde_json::Value;
use std::collections::hash_map::RandomState;
use std::hash::BuildHasher;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::{Duration, Instant};
use tilecast_core::sampler::mix64;

/// Some seconds on one thread: long enough to be hit in the middle several times.
const JOB: [&str; 6] = ["--size", "96x96", "--spp", "96", "--tile", "32"];

/// How often, and seeds that a failure can be told with.
fn seeds(few: u64) -> Vec<u64> {
    let runs = std::env::var("TILECAST_RUNS").ok().and_then(|n| n.parse().ok()).unwrap_or(few);
    (0..runs).map(|i| RandomState::new().hash_one(i)).collect()
}

/// Numbers from a seed.
struct Random(u64);

impl Random {
    fn below(&mut self, end: u64) -> u64 {
        self.0 = mix64(self.0);
        self.0 % end
    }

    /// Waits for up to so long. Kills at random times are what is tested, so nothing could be waited for instead.
    fn pause(&mut self, ms_max: u64) {
        std::thread::sleep(Duration::from_millis(self.below(ms_max)));
    }
}

fn alone(folder: &Folder) -> Value {
    folder.render(&scene("cornell-box/scene.xml"), JOB)["digest"].clone()
}

fn submit(folder: &Folder, address: &str) -> Running {
    let scene = scene("cornell-box/scene.xml");
    folder.start(["submit", &scene, "--json", "--connect", address].into_iter().chain(JOB))
}

fn worker(folder: &Folder, address: &str) -> Running {
    folder.start(["worker", "--connect", address, "--threads", "1"])
}

#[test]
fn a_coordinator_killed_at_random_goes_on_where_it_was() {
    let folder = Folder::new();
    let expected = alone(&folder);
    for seed in seeds(2) {
        let mut random = Random(seed);
        let (folder, address) = (Folder::new(), free_address());
        let start = || coordinator_with(&folder, &["--listen", &address, "--state", "state"]);
        let mut cluster = start();
        let _workers = [(); 2].map(|()| worker(&folder, &address));
        let mut job = submit(&folder, &address);
        job.event("started");
        for _ in 0..=random.below(3) {
            random.pause(1500);
            cluster.process.signal("KILL");
            drop(cluster);
            random.pause(300);
            cluster = start();
        }
        let finished = job.end().finished();
        assert_eq!(finished["digest"], expected, "seed {seed}");
    }
}

/// Everything was counted before the kill: the film is there for whoever asks, and what is asked twice is not done twice.
#[test]
fn what_was_counted_before_a_kill_is_not_done_again() {
    let folder = Folder::new();
    let address = free_address();
    let start = || coordinator_with(&folder, &["--listen", &address, "--state", "state"]);
    let cluster = start();
    let workers = worker(&folder, &address);
    let job = submit(&folder, &address);
    let done = |cluster: &crate::harness::Coordinator| {
        let jobs = cluster.status(&folder, "job");
        jobs.first().map_or(0, |job| job["samples_done"].as_u64().unwrap_or(0))
    };
    let total = 96 * 96 * 96;
    let before = poll("half of the job", || Some(done(&cluster)).filter(|&samples| samples * 2 > total));
    // Nobody counts more meanwhile; and what was counted a moment ago has left the process.
    workers.signal("KILL");
    std::thread::sleep(Duration::from_millis(300));
    cluster.process.signal("KILL");
    drop(cluster);
    let cluster = start();
    assert!(done(&cluster) >= before, "{} of {before} samples are left", done(&cluster));
    let _worker = worker(&folder, &address);
    assert_eq!(job.end().finished()["digest"], alone(&folder));
}

#[test]
fn workers_killed_at_random_change_nothing() {
    let folder = Folder::new();
    let expected = alone(&folder);
    for seed in seeds(2) {
        let mut random = Random(seed);
        let (folder, address) = (Folder::new(), free_address());
        let _cluster = coordinator_with(&folder, &["--listen", &address]);
        let mut workers: Vec<Running> = (0..4).map(|_| worker(&folder, &address)).collect();
        let mut job = submit(&folder, &address);
        job.event("started");
        for _ in 0..2 {
            random.pause(1000);
            let victim = random.below(workers.len() as u64) as usize;
            workers.swap_remove(victim).signal("KILL");
        }
        assert_eq!(job.end().finished()["digest"], expected, "seed {seed}");
    }
}

/// Longer than a lease, so that others have its units by the time it goes on and brings them too.
#[test]
fn a_worker_that_is_stopped_for_a_while_changes_nothing() {
    let folder = Folder::new();
    let address = free_address();
    let cluster = coordinator_with(&folder, &["--listen", &address]);
    let sleeper = worker(&folder, &address);
    let job = submit(&folder, &address);
    poll("units at the worker", || {
        cluster.status(&folder, "worker").first().filter(|w| w["leases"].as_u64() > Some(0)).map(|_| ())
    });
    sleeper.signal("STOP");
    let begun = Instant::now();
    poll("the coordinator to forget it", || cluster.status(&folder, "worker").is_empty().then_some(()));
    assert!(begun.elapsed() < Duration::from_secs(10), "{:?}", begun.elapsed());
    let _helper = worker(&folder, &address);
    if is_soak() {
        std::thread::sleep(Duration::from_secs(30).saturating_sub(begun.elapsed()));
    }
    sleeper.signal("CONT");
    assert_eq!(job.end().finished()["digest"], alone(&folder));
}

/// Stops a process for nine tenths of the time, until it is dropped.
#[cfg(unix)]
struct Slowed(Arc<AtomicBool>);

#[cfg(unix)]
impl Slowed {
    fn new(pid: u32) -> Self {
        use rustix::process::{Pid, Signal, kill_process};
        let pid = Pid::from_raw(pid.cast_signed()).expect("a process");
        let end = Arc::new(AtomicBool::new(false));
        let ends = Arc::clone(&end);
        std::thread::spawn(move || {
            while !ends.load(Relaxed) {
                for (signal, ms) in [(Signal::STOP, 90), (Signal::CONT, 10)] {
                    let _ = kill_process(pid, signal);
                    std::thread::sleep(Duration::from_millis(ms));
                }
            }
        });
        Self(end)
    }
}

#[cfg(unix)]
impl Drop for Slowed {
    fn drop(&mut self) {
        self.0.store(true, Relaxed);
    }
}

/// Beside one that is not slowed down: that one's time alone says what would be ideal. The short form is too short for that,
/// and `scaling.rs` in the coordinator has the same on simulated time.
#[cfg(unix)]
#[test]
fn a_worker_ten_times_slower_holds_nobody_up() {
    let spp = if is_soak() { "2048" } else { "96" };
    let render = |slowed: bool| {
        let (folder, address) = (Folder::new(), free_address());
        let _cluster = coordinator_with(&folder, &["--listen", &address]);
        let _fast = worker(&folder, &address);
        let slow = slowed.then(|| worker(&folder, &address));
        let _slowed = slow.as_ref().map(|slow| Slowed::new(slow.pid()));
        let scene = scene("cornell-box/scene.xml");
        let args = ["submit", &scene, "--json", "--connect", &address, "--size", "96x96", "--spp", spp, "--tile", "32"];
        folder.start(args).end().finished()
    };
    let (alone, both) = (render(false), render(true));
    assert_eq!(alone["digest"], both["digest"]);
    let seconds = |event: &Value| event["seconds"].as_f64().expect("a time");
    let ideal = seconds(&alone) / 1.1;
    eprintln!("{:.2} s, and ideal are {ideal:.2} s", seconds(&both));
    assert!(!is_soak() || seconds(&both) <= 1.25 * ideal, "{both}, and ideal are {ideal} s");
}

#[test]
fn a_worker_told_to_end_brings_what_it_has_begun() {
    let folder = Folder::new();
    let address = free_address();
    let cluster = coordinator_with(&folder, &["--listen", &address]);
    let drained = worker(&folder, &address);
    let job = submit(&folder, &address);
    poll("units at the worker", || {
        cluster.status(&folder, "worker").first().filter(|w| w["leases"].as_u64() > Some(0)).map(|_| ())
    });
    let begun = Instant::now();
    drained.signal("TERM");
    assert_eq!(drained.end().code, Some(0));
    assert!(begun.elapsed() < Duration::from_secs(10), "{:?}", begun.elapsed());
    let jobs = cluster.status(&folder, "job");
    assert_eq!(jobs[0]["workers"], 0, "it gave its leases back: {}", jobs[0]);
    let short_lived = folder.start(["worker", "--connect", &address, "--threads", "1", "--lifetime", "9s"]);
    assert_eq!(short_lived.end().code, Some(0));
    let _rest = worker(&folder, &address);
    assert_eq!(job.end().finished()["digest"], alone(&folder));
}

#[test]
fn a_client_is_told_when_its_job_is_lost_for_good() {
    let folder = Folder::new();
    let address = free_address();
    let cluster = coordinator_with(&folder, &["--listen", &address]);
    let job = submit(&folder, &address);
    poll("the job at the coordinator", || cluster.status(&folder, "job").first().map(|_| ()));
    cluster.process.signal("KILL");
    drop(cluster);
    let _other = coordinator_with(&folder, &["--listen", &address]);
    let outcome = job.end();
    assert_eq!(outcome.code, Some(1));
    assert!(outcome.stderr.contains("--state"), "{outcome:?}");
}
