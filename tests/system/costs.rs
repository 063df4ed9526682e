//! What safety costs: a state on disk, and checks of workers, in the processor time of real processes; and what a kill has done
//! again. Small jobs in CI, which say what they saw; long ones by `just soak`, which fail if it is too much.

use crate::harness::{Coordinator, Folder, Running, coordinator_with, cpu_seconds, free_address, is_soak, poll, scene};
use serde_json::Value;
use std::time::{Duration, Instant};

/// Of all processor time, what `--state` may take.
const STATE_SHARE_MAX: f64 = 0.02;
/// Of all tracing, what is done again by `--verify 0.05` when its workers are proven.
const CHECKS_SHARE_MAX: f64 = 0.10;
/// Work that a kill of the coordinator may have done again.
const REPEATED_MAX: Duration = Duration::from_secs(5);
/// Units after which a worker is proven, as docs/cluster.md says.
const NEWCOMER_UNITS: u64 = 48;

/// Half a minute of processor time, or some.
fn job() -> [&'static str; 6] {
    ["--size", "256x256", "--spp", if is_soak() { "1024" } else { "128" }, "--tile", "32"]
}

fn worker(folder: &Folder, cluster: &Coordinator) -> Running {
    folder.start(["worker", "--connect", &cluster.address, "--threads", "1"])
}

fn render(folder: &Folder, cluster: &Coordinator, args: &[&str]) -> Value {
    cluster.submit(folder, &[&[scene("cornell-box/scene.xml").as_str()], args].concat()).end().finished()
}

/// What coordinator and workers take of processors for a job, and its image's digest.
fn costs(more: &[&str]) -> (f64, f64, Value) {
    let folder = Folder::new();
    let cluster = coordinator_with(&folder, &[&["--listen", "127.0.0.1:0"], more].concat());
    let workers = [(); 2].map(|()| worker(&folder, &cluster));
    let image = render(&folder, &cluster, &job());
    let tracing = workers.iter().map(|worker| cpu_seconds(worker.pid())).sum();
    (cpu_seconds(cluster.process.pid()), tracing, image["digest"].clone())
}

/// Fails if every unit is synced by itself, or snapshots come with every one.
#[test]
fn keeping_a_state_costs_little() {
    let ((without, tracing, image), (with, _, kept)) = (costs(&[]), costs(&["--state", "state"]));
    assert_eq!(image, kept);
    let share = (with - without) / (without + tracing);
    eprintln!(
        "a coordinator's {without:.2} s become {with:.2} s beside {tracing:.1} s of tracing: {:.2} %",
        100.0 * share
    );
    assert!(!is_soak() || share <= STATE_SHARE_MAX, "{share}");
}

/// Of a short job a unit more or less is some percent, and `scaling.rs` in the coordinator has the same on simulated time. Fails
/// if the proven are checked like newcomers.
#[test]
#[ignore = "only long jobs show it: just soak"]
fn checking_the_proven_costs_little() {
    let tracing = |verify: &[&str]| {
        let folder = Folder::new();
        let cluster = coordinator_with(&folder, &[&["--listen", "127.0.0.1:0"], verify].concat());
        let workers = [(); 2].map(|()| worker(&folder, &cluster));
        // Many small units.
        let newcomers = || {
            let workers = cluster.status(&folder, "worker");
            workers.len() < 2 || workers.iter().any(|worker| worker["units_done"].as_u64() < Some(NEWCOMER_UNITS))
        };
        while newcomers() {
            render(&folder, &cluster, &["--size", "128x128", "--spp", "4", "--tile", "8"]);
        }
        let all = || workers.iter().map(|worker| cpu_seconds(worker.pid())).sum::<f64>();
        let before = all();
        render(&folder, &cluster, &job());
        all() - before
    };
    let (without, with) = (tracing(&[]), tracing(&["--verify", "0.05"]));
    eprintln!("{without:.2} s of tracing become {with:.2} s: {:.1} %", 100.0 * (with / without - 1.0));
    assert!(with > without * 0.9, "{with} s against {without} s");
    assert!(with <= without * (1.0 + CHECKS_SHARE_MAX), "{with} s instead of {without} s");
}

/// A kill without any warning, in the middle of everything. Fails if results are kept long before they are written.
#[test]
fn a_kill_repeats_little() {
    for _ in 0..if is_soak() { 20 } else { 2 } {
        let (folder, address) = (Folder::new(), free_address());
        let start = || coordinator_with(&folder, &["--listen", &address, "--state", "state"]);
        let cluster = start();
        let workers = [(); 2].map(|()| worker(&folder, &cluster));
        let scene = scene("cornell-box/scene.xml");
        let job = cluster.submit(&folder, &[scene.as_str(), "--size", "256x256", "--spp", "100000", "--tile", "32"]);
        let done = |cluster: &Coordinator| {
            let jobs = cluster.status(&folder, "job");
            jobs.first().map_or(0, |job| job["samples_done"].as_u64().expect("a number"))
        };
        poll("work", || (done(&cluster) > 0).then_some(()));
        let (begun, first) = (Instant::now(), done(&cluster));
        std::thread::sleep(Duration::from_secs(2));
        let before = done(&cluster);
        cluster.process.signal("KILL");
        let rate = (before - first) as f64 / begun.elapsed().as_secs_f64();
        // Nobody brings anything to the next one.
        workers.iter().for_each(|worker| worker.signal("KILL"));
        drop(cluster);
        let repeated = before.saturating_sub(done(&start())) as f64 / rate;
        eprintln!("{repeated:.3} s of work are done again");
        assert!(repeated <= REPEATED_MAX.as_secs_f64(), "{repeated} s");
        drop(job);
    }
}
