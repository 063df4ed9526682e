//! Launchers, with programs in place of ssh and Slurm that do what those would on one machine. With the real Slurm: `just slurm`.

use crate::harness::{Folder, Running, SMALL, coordinator, is_alive, poll, scene, signal};
use serde_json::Value;
use std::os::unix::fs::PermissionsExt;

/// Runs the command here; the host `flaky` is reached at the second try only.
const SSH: &str = r#"#!/bin/sh
while [ "$1" != "--" ]; do shift; done
host=$2; shift 2
if [ "$host" = flaky ] && ! [ -e tried ]; then touch tried; exit 255; fi
exec sh -c "$*"
"#;
const SBATCH: &str = r#"#!/bin/sh
for word in "$@"; do case "$word" in
    --array=1-*) count=${word#--array=1-};;
    --job-name=*) SLURM_JOB_NAME=${word#--job-name=};;
esac; done
SLURM_ARRAY_JOB_ID=$(ls | wc -l)
cat > "script$SLURM_ARRAY_JOB_ID"
export SLURM_JOB_NAME SLURM_ARRAY_JOB_ID
for i in $(seq "$count"); do
    SLURM_ARRAY_TASK_ID=$i sh "script$SLURM_ARRAY_JOB_ID" > /dev/null 2>&1 < /dev/null &
    echo $! > "task.$SLURM_ARRAY_JOB_ID.$i"
done
echo "$SLURM_ARRAY_JOB_ID"
"#;
const SQUEUE: &str = r#"#!/bin/sh
for file in task.*; do
    [ -e "$file" ] && kill -0 "$(cat "$file")" 2> /dev/null && echo "$file R" | tr . ' ' | cut -d ' ' -f 2-
done
exit 0
"#;
const SCANCEL: &str = r#"#!/bin/sh
for id in "$@"; do kill -TERM "$(cat "task.$(echo "$id" | tr _ .)")"; done
"#;

fn with_programs(programs: &[(&str, &str)]) -> Folder {
    let folder = Folder::new();
    for (name, text) in programs {
        let name = format!("bin/{name}");
        folder.write(&name, text);
        std::fs::set_permissions(folder.path(&name), std::fs::Permissions::from_mode(0o755)).expect("a mode");
    }
    folder
}

fn launch(folder: &Folder, args: &[&str]) -> Running {
    let path = format!("{}:{}", folder.path("bin").display(), std::env::var("PATH").expect("a PATH"));
    folder.start_with(["launch"].iter().chain(args), &[("PATH", &path)])
}

fn names(workers: &[Value]) -> Vec<String> {
    let mut names: Vec<String> = workers.iter().map(|w| w["name"].as_str().unwrap_or_default().to_owned()).collect();
    names.sort();
    names
}

fn pid(worker: &Value) -> u32 {
    worker["pid"].as_u64().and_then(|pid| u32::try_from(pid).ok()).expect("a pid")
}

/// Fails without the second start of a host, and if the pipe to a worker stays open when the launcher is gone.
#[test]
fn ssh_workers_come_again_and_go_with_their_launcher() {
    let folder = with_programs(&[("ssh", SSH)]);
    let coordinator = coordinator(&folder);
    let program = env!("CARGO_BIN_EXE_tilecast");
    let args = ["ssh", "a:2", "flaky", "--threads", "1", "--program", program, "--connect", &coordinator.address];
    let launcher = launch(&folder, &args);
    let there = || {
        let workers = coordinator.status(&folder, "worker");
        (names(&workers) == ["a/1", "a/2", "flaky"]).then_some(workers)
    };
    let first = poll("three workers", there);
    signal(pid(&first[0]), "KILL");
    let killed = pid(&first[0]);
    let all = poll("another for the killed one", || there().filter(|all| all.iter().all(|w| pid(w) != killed)));
    let scene = scene("cornell-box/scene.xml");
    let image = coordinator.submit(&folder, &[&[scene.as_str(), "-o", "far.exr"], &SMALL[..]].concat()).end();
    assert_eq!(image.finished()["digest"], folder.render(&scene, SMALL)["digest"]);
    // However it ends.
    launcher.signal("KILL");
    poll("the workers' end", || all.iter().all(|w| !is_alive(pid(w))).then_some(()));
    drop(launcher);

    let launcher = launch(&folder, &args);
    let again = poll("three workers again", || there().filter(|all| all.iter().all(|w| is_alive(pid(w)))));
    launcher.signal("TERM");
    assert_eq!(launcher.end().code, Some(0));
    poll("their end", || again.iter().all(|w| !is_alive(pid(w))).then_some(()));
}

/// Without a job nobody, with a large one as many as may be, after it nobody again. Fails if the script does not hand Slurm's
/// signal on, or if tasks are not found by their name.
#[test]
fn slurm_tasks_follow_the_open_work() {
    let programs = [("sbatch", SBATCH), ("squeue", SQUEUE), ("scancel", SCANCEL)];
    let folder = with_programs(&programs);
    let coordinator = coordinator(&folder);
    let args = ["slurm", "--workers", "2", "--threads", "1", "--walltime", "2m", "--patience", "1s", "--connect"];
    let args = [&args[..], &[&coordinator.address]].concat();
    let mut launcher = launch(&folder, &args);
    let scene = scene("cornell-box/scene.xml");
    let endless = coordinator.submit(&folder, &[&scene, "--spp", "10000000", "-o", "never.exr"]);
    let there = |count: usize| {
        let workers = coordinator.status(&folder, "worker");
        (workers.len() == count).then_some(workers)
    };
    let workers = poll("two workers", || there(2));
    assert!(names(&workers)[0].starts_with("tilecast-") && names(&workers)[1].ends_with("_2"), "{workers:?}");
    launcher.complains("0 workers for 2: submitted 2");
    endless.signal("TERM");
    poll("no worker", || there(0));
    assert!(workers.iter().all(|w| !is_alive(pid(w))));
    launcher.signal("INT");
    assert_eq!(launcher.end().code, Some(0));
}

/// What is missing is said with what to do.
#[test]
fn launchers_say_what_is_missing() {
    let folder = with_programs(&[]);
    let slurm = |more: &[&str]| {
        let args = ["launch", "slurm", "--workers", "2", "--connect", "127.0.0.1:9"];
        folder.start_with(args.iter().chain(more), &[("PATH", "/nowhere")]).end()
    };
    let nobody = slurm(&[]);
    assert_eq!(nobody.code, Some(1));
    assert!(nobody.stderr.contains("no coordinator answers at"), "{}", nobody.stderr);
    let coordinator = coordinator(&folder);
    let no_slurm = slurm(&["--connect", &coordinator.address]);
    assert_eq!(no_slurm.code, Some(2), "given twice: {}", no_slurm.stderr);
    let args = ["launch", "slurm", "--workers", "2", "--connect", &coordinator.address];
    let no_slurm = folder.start_with(args, &[("PATH", "/nowhere")]).end();
    assert!(no_slurm.stderr.contains("such as a login node"), "{}", no_slurm.stderr);
    assert_eq!(slurm(&["--walltime", "30s"]).code, Some(2));
    let dry = slurm(&["--dry-run", "--walltime", "4h", "--", "--partition=long"]);
    assert_eq!(dry.code, Some(0), "{}", dry.stderr);
    for part in
        ["sbatch --parsable --job-name=tilecast --array=1-2 --time=240", "--partition=long", "--lifetime 14340s"]
    {
        assert!(dry.stdout.contains(part), "{part}: {}", dry.stdout);
    }
    let dry = folder.tilecast(["launch", "ssh", "a", "b:2", "--connect", "h:1", "--certs", "c", "--dry-run"]);
    assert_eq!(dry.stdout.lines().count(), 3, "{}", dry.stdout);
    assert!(dry.stdout.contains("worker --exit-with-parent --name b/2 --connect h:1 --certs c"), "{}", dry.stdout);
}
