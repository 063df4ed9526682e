//! One image, whatever computed it.

use crate::harness::{Coordinator, Folder, SMALL, coordinator, poll, scene};
use serde_json::Value;

/// The digest of a render.
fn digest(folder: &Folder, scene: &str, args: &[&str]) -> Value {
    folder.render(scene, SMALL.iter().chain(args))["digest"].clone()
}

/// The Cornell box and the strategies' scene, which has every material: the digests of both must not depend on `args`.
fn same_for_all(variants: &[&[&str]]) {
    let folder = Folder::new();
    for name in ["cornell-box/scene.xml", "veach-strategies/scene.xml"] {
        let scene = scene(name);
        let expected = digest(&folder, &scene, &["--threads", "1"]);
        for args in variants {
            assert_eq!(digest(&folder, &scene, args), expected, "{name} with {args:?}");
        }
    }
}

#[test]
fn threads_do_not_matter() {
    same_for_all(&[&["--threads", "2"], &["--threads", "5"]]);
}

#[test]
fn processes_do_not_matter() {
    same_for_all(&[&["--workers", "1"], &["--workers", "2"], &["--workers", "4", "--threads", "1"]]);
}

#[test]
fn tiles_do_not_matter() {
    same_for_all(&[&["--tile", "8"], &["--tile", "32"], &["--tile", "64"], &["--tile", "7", "--workers", "2"]]);
}

#[test]
fn instruction_sets_do_not_matter() {
    let available = tilecast_core::bvh::simd::Isa::available();
    let variants: Vec<Vec<&str>> = available.iter().map(|isa| vec!["--isa", isa.name()]).collect();
    same_for_all(&variants.iter().map(Vec::as_slice).collect::<Vec<_>>());
}

/// Else the tests above could not fail.
#[test]
fn everything_else_matters() {
    let folder = Folder::new();
    let scene = scene("cornell-box/scene.xml");
    let mut digests = vec![digest(&folder, &scene, &[])];
    let changes = [["--seed", "1"], ["--strategy", "bsdf"], ["--sampler", "independent"], ["--max-depth", "2"]];
    digests.extend(changes.iter().map(|change| digest(&folder, &scene, change)));
    digests.push(folder.render(&scene, ["--size", "48x40", "--spp", "7"])["digest"].clone());
    digests.push(folder.render(&scene, ["--size", "40x48", "--spp", "6"])["digest"].clone());
    for (i, digest) in digests.iter().enumerate() {
        assert!(!digests[..i].contains(digest), "{i} of {digests:?}");
    }
}

#[test]
fn three_workers_started_by_hand_render_the_same() {
    let folder = Folder::new();
    let scene = scene("cornell-box/scene.xml");
    let expected = digest(&folder, &scene, &[]);
    let cluster = coordinator(&folder);
    let _workers = [(); 3].map(|()| cluster.worker(&folder));
    let args = [&[scene.as_str()], SMALL.as_slice()].concat();
    let (first, second) =
        (cluster.submit(&folder, &args), cluster.submit(&folder, &[&args[..], &["-o", "b.exr"]].concat()));
    assert_eq!(first.end().finished()["digest"], expected);
    assert_eq!(second.end().finished()["digest"], expected, "two jobs at a time");
}

/// Long enough that a worker can be lost, or come, in the middle: some seconds.
const LONG: [&str; 6] = ["--size", "96x96", "--spp", "128", "--tile", "32"];

/// Renders LONG on `cluster`; `meanwhile` is called once the job runs.
fn long_render(folder: &Folder, cluster: &Coordinator, meanwhile: impl FnOnce()) {
    let scene = scene("cornell-box/scene.xml");
    let job = cluster.submit(folder, &[&[scene.as_str()], LONG.as_slice()].concat());
    meanwhile();
    let together = job.end().finished();
    let alone = folder.render(&scene, LONG);
    assert_eq!(together["digest"], alone["digest"]);
}

#[test]
fn a_worker_killed_in_the_middle_of_a_unit_changes_nothing() {
    let folder = Folder::new();
    let cluster = coordinator(&folder);
    let victim = cluster.worker(&folder);
    let mut rescuer = None;
    long_render(&folder, &cluster, || {
        poll("a worker with units", || {
            let workers = cluster.status(&folder, "worker");
            workers.iter().find(|w| w["pid"] == victim.pid() && w["leases"].as_u64() > Some(0)).map(|_| ())
        });
        victim.signal("KILL");
        let job = &cluster.status(&folder, "job")[0];
        assert_eq!(job["state"], "running", "it must be lost in the middle: {job}");
        rescuer = Some(cluster.worker(&folder));
    });
}

#[test]
fn a_worker_that_joins_late_changes_nothing() {
    let folder = Folder::new();
    let cluster = coordinator(&folder);
    let mut workers = Vec::new();
    long_render(&folder, &cluster, || {
        poll("a job without workers", || {
            cluster.status(&folder, "job").first().filter(|job| job["state"] == "queued").map(|_| ())
        });
        workers.push(cluster.worker(&folder));
        poll("a job that has begun", || {
            cluster.status(&folder, "job").first().filter(|job| job["samples_done"].as_u64() > Some(0)).map(|_| ())
        });
        workers.push(cluster.worker(&folder));
    });
}
