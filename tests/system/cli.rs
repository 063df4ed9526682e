//! What the program says and how it ends.

use crate::harness::{Folder, Running, SMALL, children, coordinator, is_alive, poll, scene, signal};

/// Would take hours: only an end from outside ends it.
const ENDLESS: [&str; 4] = ["--spp", "10000000", "-o", "never.exr"];

fn endless(folder: &Folder, more: &[&str]) -> Running {
    let scene = scene("cornell-box/scene.xml");
    folder.start(["render", &scene, "--json"].iter().chain(&ENDLESS).chain(more))
}

#[test]
fn json_is_one_object_a_line_and_ends_with_the_digest() {
    let folder = Folder::new();
    let scene = scene("cornell-box/scene.xml");
    let outcome = folder.tilecast(["render", &scene, "--json"].iter().chain(&SMALL));
    assert_eq!(outcome.stderr, "");
    let events = outcome.events();
    let started = events.iter().find(|event| event["event"] == "started").expect("a started event");
    assert_eq!((started["width"].as_u64(), started["height"].as_u64()), (Some(48), Some(40)));
    let finished = outcome.finished();
    assert_eq!(finished["digest"].as_str().map(str::len), Some(64));
    assert_eq!(finished["spp"], 6);
    assert!(finished["seconds"].as_f64() > Some(0.0));
    assert!(finished["output"].as_str().unwrap().ends_with("scene.exr"));
    assert_eq!(folder.names(), ["scene.exr", "scene.film", "scene.json"]);
}

#[test]
fn people_get_lines_on_stderr_and_quiet_ones_nothing() {
    let folder = Folder::new();
    let scene = scene("cornell-box/scene.xml");
    let loud = folder.tilecast(["render", &scene].iter().chain(&SMALL));
    assert_eq!((loud.code, loud.stdout.as_str()), (Some(0), ""));
    assert!(loud.stderr.contains("wrote scene.exr") && loud.stderr.contains("digest"), "{}", loud.stderr);
    let quiet = folder.tilecast(["render", &scene, "--quiet"].iter().chain(&SMALL));
    assert_eq!((quiet.code, quiet.stdout.as_str(), quiet.stderr.as_str()), (Some(0), "", ""));
}

#[test]
fn help_and_version_are_no_errors() {
    let folder = Folder::new();
    let overview = folder.tilecast(["--help"]).stdout;
    let listed = overview.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
    let mut commands: Vec<Vec<&str>> =
        listed.filter_map(|line| line.strip_prefix("  ")?.split(' ').next()).map(|name| vec![name]).collect();
    commands.retain(|command| !["", "help", "launch"].contains(&command[0]));
    assert!(commands.len() > 14, "{overview}");
    commands.extend([vec![], vec!["launch", "slurm"], vec!["launch", "ssh"]]);
    for command in commands {
        let long = folder.tilecast(command.iter().chain(&["--help"]));
        assert_eq!((long.code, long.stderr.as_str()), (Some(0), ""));
        assert!(long.stdout.contains("Usage: tilecast"), "{}", long.stdout);
        assert!(long.stdout.contains("\n  tilecast "), "no example: {}", long.stdout);
        let short = folder.tilecast(command.iter().chain(&["-h"])).stdout;
        assert!(!short.contains("\n  tilecast ") && short.len() < long.stdout.len(), "{short}");
    }
    assert_eq!(folder.tilecast(["--version"]).code, Some(0));
}

/// Made of the same description as `--help`: fails if a command has no page, or a page no example.
#[test]
fn shells_and_man_know_every_command() {
    let folder = Folder::new();
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = folder.tilecast(["completions", shell]);
        assert_eq!((script.code, script.stderr.as_str()), (Some(0), ""));
        assert!(script.stdout.contains("coordinator") && script.stdout.contains("target-error"), "{shell}");
    }
    assert_eq!(folder.tilecast(["man", "pages"]).code, Some(0));
    for page in ["tilecast", "tilecast-render", "tilecast-certs-init", "tilecast-launch-slurm"] {
        let text = std::fs::read_to_string(folder.path(&format!("pages/{page}.1"))).unwrap();
        assert!(text.contains(".SH SYNOPSIS"), "{page}: {text}");
        assert!(page == "tilecast-certs-init" || text.contains(".SH EXAMPLES"), "{page}: {text}");
    }
}

/// A sample's path, and the same radiance whatever the crop, workers or samples of the render that met it.
#[test]
fn a_sample_is_replayed() {
    let folder = Folder::new();
    let scene = scene("cornell-box/scene.xml");
    let sample = ["render", &scene, "--size", "48x40", "--pixel", "24,3", "--sample", "5"];
    let outcome = folder.tilecast(sample);
    assert_eq!((outcome.code, outcome.stderr.as_str()), (Some(0), ""));
    let (first, last) = (outcome.stdout.lines().next().unwrap(), outcome.stdout.lines().last().unwrap());
    assert_eq!(first, "sample 5 of pixel (24, 3), seed 0");
    assert!(last.starts_with("radiance ("), "{last}");
    for part in ["camera ray from (", "vertex 0: ", "(diffuse)", "light at wi", "pdf", "throughput"] {
        assert!(outcome.stdout.contains(part), "{part}: {}", outcome.stdout);
    }
    let other = folder.tilecast(sample.iter().chain(&["--spp", "9", "--crop", "0,0,4,4", "--workers", "2"]));
    assert_eq!(other.stdout, outcome.stdout);
    assert_eq!(folder.names(), [] as [&str; 0]);
    let outside = folder.tilecast(["render", &scene, "--size", "48x40", "--pixel", "48,3", "--sample", "5"]);
    assert_eq!(outside.code, Some(2), "{}", outside.stderr);
    assert_eq!(folder.tilecast(["render", &scene, "--pixel", "1,1"]).code, Some(2));
}

#[test]
fn info_counts_what_is_there() {
    let folder = Folder::new();
    let outcome = folder.tilecast(["info", &scene("cornell-box/scene.xml"), "--json"]);
    let facts = &outcome.events()[0];
    assert_eq!(facts["triangles"], 32, "walls 10, blocks 20, lamp 2");
    assert_eq!(facts["lights"]["area"], 1);
    assert_eq!(facts["settings"]["spp"], 64);
    let outcome = folder.tilecast(["info", &scene("cornell-box/scene.xml"), "-D", "spp=3"]);
    assert!(outcome.stdout.contains("32 triangles") && outcome.stdout.contains("3 a pixel"), "{}", outcome.stdout);
}

/// Without the flag it is an error that names it; with it there is a picture, and both ways of telling list what is not in it.
#[test]
fn what_is_not_supported_is_an_error_or_listed() {
    let folder = Folder::new();
    let text = "<scene version=\"3.0.0\">\n<emitter type=\"sunsky\"/>\n<shape type=\"sphere\"><bsdf type=\"hair\"/></shape>\n\
                <emitter type=\"constant\"/></scene>";
    folder.write("odd.xml", text);
    let refused = folder.tilecast(["render", "odd.xml"].iter().chain(&SMALL));
    assert_eq!(refused.code, Some(1));
    assert!(refused.stderr.contains("'hair' is not supported yet"), "{}", refused.stderr);
    assert!(refused.stderr.contains("--substitute"), "{}", refused.stderr);
    let lines = folder.tilecast(["render", "odd.xml", "--substitute"].iter().chain(&SMALL));
    assert_eq!(lines.code, Some(0), "{}", lines.stderr);
    assert!(lines.stderr.contains("substituted: ") && lines.stderr.contains("odd.xml:3: "), "{}", lines.stderr);
    let events = folder.tilecast(["render", "odd.xml", "--substitute", "--json"].iter().chain(&SMALL)).events();
    let listed: Vec<&str> =
        events.iter().filter(|e| e["event"] == "substituted").filter_map(|e| e["text"].as_str()).collect();
    assert_eq!(listed.len(), 2, "{listed:?}");
    let facts = folder.tilecast(["info", "odd.xml", "--substitute", "--json"]).events();
    assert_eq!(facts[0]["substitutions"].as_array().map(Vec::len), Some(2));
    assert_eq!(folder.tilecast(["info", "odd.xml"]).code, Some(1));
}

/// What holds for every shape is said once, with how often; `info` has each.
#[test]
fn what_is_said_of_many_shapes_is_said_once() {
    let folder = Folder::new();
    folder.write("flat.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 2 0 0\nf 1 2 3\nf 1 2 4\n");
    let shape = "<shape type=\"obj\"><string name=\"filename\" value=\"flat.obj\"/></shape>\n";
    let text = format!("<scene version=\"3.0.0\">\n<emitter type=\"constant\"/>\n{}</scene>", shape.repeat(300));
    folder.write("many.xml", text);
    let said = folder.tilecast(["render", "many.xml"].iter().chain(&SMALL)).stderr;
    assert_eq!(said.matches("degenerate").count(), 1, "{said}");
    assert!(said.contains("flat.obj: 1 degenerate triangles") && said.contains("299 times more"), "{said}");
    let facts = folder.tilecast(["info", "many.xml", "--json"]).events();
    let each = facts[0]["notes"].as_array().expect("a list");
    assert_eq!(each.iter().filter(|note| note.as_str().is_some_and(|text| text.contains("degenerate"))).count(), 300);
}

#[test]
fn a_signal_ends_a_render_without_a_file() {
    for name in ["INT", "TERM"] {
        let folder = Folder::new();
        let mut render = endless(&folder, &["--threads", "2"]);
        render.event("progress");
        render.signal(name);
        let outcome = render.end();
        assert_eq!(outcome.code, Some(1), "{outcome:?}");
        assert!(outcome.stderr.contains("nothing was written"), "{}", outcome.stderr);
        assert_eq!(folder.names(), [""; 0]);
    }
}

/// The worker processes of a render, once there are `count`.
fn workers(render: &Running, count: usize) -> Vec<u32> {
    poll("worker processes", || Some(children(render.pid())).filter(|pids| pids.len() == count))
}

#[test]
fn a_signal_leaves_no_worker_process() {
    for name in ["INT", "KILL"] {
        let folder = Folder::new();
        let mut render = endless(&folder, &["--workers", "2", "--threads", "1"]);
        render.event("progress");
        let pids = workers(&render, 2);
        render.signal(name);
        let outcome = render.end();
        assert_eq!(outcome.code, if name == "INT" { Some(1) } else { None }, "{outcome:?}");
        if name == "INT" {
            assert!(!pids.iter().any(|&pid| is_alive(pid)), "waited for before the end");
        }
        poll("the end of the workers", || (!pids.iter().any(|&pid| is_alive(pid))).then_some(()));
        assert_eq!(folder.names(), [""; 0]);
    }
}

#[test]
fn a_worker_process_that_dies_is_replaced() {
    let folder = Folder::new();
    let scene = scene("cornell-box/scene.xml");
    let long = ["--size", "64x64", "--spp", "192"];
    let mut render = folder.start(["render", &scene, "--json", "--workers", "1", "--threads", "1"].iter().chain(&long));
    render.event("started");
    let pid = workers(&render, 1)[0];
    signal(pid, "KILL");
    let warning = render.event("warning");
    assert!(warning["text"].as_str().unwrap().contains(&format!("worker process {pid} died")), "{warning}");
    assert_eq!(render.end().finished()["digest"], folder.render(&scene, long)["digest"]);
}

#[test]
fn a_render_whose_workers_all_die_says_so() {
    let folder = Folder::new();
    let mut render = endless(&folder, &["--workers", "1", "--threads", "1"]);
    render.event("started");
    let mut killed = Vec::new();
    // The first and three more.
    for _ in 0..4 {
        let pid = poll("a new worker process", || {
            children(render.pid()).into_iter().find(|pid| !killed.contains(pid) && is_alive(*pid))
        });
        signal(pid, "KILL");
        killed.push(pid);
    }
    let outcome = render.end();
    assert_eq!(outcome.code, Some(1), "{outcome:?}");
    assert!(outcome.stderr.contains("every worker process has died"), "{}", outcome.stderr);
    assert!(outcome.stderr.contains("signal: 9"), "{}", outcome.stderr);
    assert_eq!(folder.names(), [""; 0]);
}

#[test]
fn a_job_can_be_seen_and_cancelled() {
    let folder = Folder::new();
    let cluster = coordinator(&folder);
    let submit = cluster.submit(&folder, &[&[scene("cornell-box/scene.xml").as_str()], ENDLESS.as_slice()].concat());
    let job = poll("the job", || cluster.status(&folder, "job").pop());
    assert_eq!((job["name"].as_str(), job["state"].as_str()), (Some("scene.xml"), Some("queued")), "{job}");
    let number = job["job"].to_string();
    let cancelled = folder.tilecast(["cancel", "--connect", &cluster.address, &number]);
    assert_eq!(cancelled.stdout, format!("job {number} is cancelled\n"));
    let outcome = submit.end();
    assert_eq!(outcome.code, Some(1), "{outcome:?}");
    assert!(outcome.stderr.contains("cancelled"), "{}", outcome.stderr);
    assert_eq!(folder.names(), [""; 0]);
    let unknown = folder.tilecast(["cancel", "--connect", &cluster.address, "12345"]);
    assert_eq!(unknown.code, Some(1), "{unknown:?}");
}

#[test]
fn a_submit_that_is_stopped_cancels_its_job() {
    let folder = Folder::new();
    let cluster = coordinator(&folder);
    let _worker = cluster.worker(&folder);
    let mut submit =
        cluster.submit(&folder, &[&[scene("cornell-box/scene.xml").as_str()], ENDLESS.as_slice()].concat());
    submit.event("progress");
    submit.signal("INT");
    assert_eq!(submit.end().code, Some(1));
    assert_eq!(cluster.status(&folder, "job")[0]["state"], "cancelled");
    cluster.process.signal("INT");
    assert_eq!(cluster.process.end().code, Some(0), "a coordinator is meant to be stopped so");
}
