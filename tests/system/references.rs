//! Images that are gone on with, joined, and interrupted: whatever way the samples came together, the bits are those of one
//! fresh render.

use crate::harness::{Folder, coordinator, poll, scene};
use serde_json::Value;

const SIZE: [&str; 2] = ["--size", "40x32"];

fn same(folder: &Folder, a: &str, b: &str) {
    for extension in ["exr", "film"] {
        let read = |name: &str| std::fs::read(folder.path(&format!("{name}.{extension}"))).expect("a file");
        assert!(read(a) == read(b), "{a}.{extension} and {b}.{extension} differ");
    }
}

fn refused(folder: &Folder, args: &[&str], text: &str) {
    let outcome = folder.tilecast(args.iter());
    assert_ne!(outcome.code, Some(0), "{args:?}");
    assert!(outcome.stderr.contains(text), "{args:?}: {}", outcome.stderr);
}

/// Two scenes; in one step and in two; without the flags that the image was first rendered with.
#[test]
fn a_top_up_is_a_fresh_render() {
    let folder = Folder::new();
    for name in ["cornell-box/scene.xml", "veach-strategies/scene.xml"] {
        let scene = scene(name);
        let with = |more: &[&str]| -> Vec<String> {
            SIZE.iter().chain(&["--seed", "5"]).chain(more).map(|flag| (*flag).to_owned()).collect()
        };
        let fresh = folder.render(&scene, with(&["--spp", "90", "-o", "fresh.exr"]));
        folder.render(&scene, with(&["--spp", "13", "-o", "a.exr"]));
        folder.render(&scene, ["--resume", "a.exr", "--spp", "40", "--workers", "2"]);
        let topped = folder.render(&scene, ["--resume", "a.exr", "--spp", "90", "--tile", "8"]);
        assert_eq!((&topped["digest"], &topped["samples"]), (&fresh["digest"], &Value::from("0..90")));
        same(&folder, "a", "fresh");
    }
}

#[test]
fn parts_join_in_any_order() {
    let folder = Folder::new();
    let scene = scene("cornell-box/scene.xml");
    for sampler in ["sobol", "sobol-joint", "sobol-z", "independent"] {
        let with = |more: &[&'static str]| [&SIZE[..], &["--sampler", sampler, "--spp", "64"], more].concat();
        let fresh = folder.render(&scene, with(&["-o", "fresh.exr"]));
        for (samples, out) in [("0..16", "a.exr"), ("16..32", "b.exr"), ("32..50", "c.exr"), ("50..64", "d.exr")] {
            folder.render(&scene, with(&["--samples", samples, "-o", out]));
        }
        for order in [["a.film", "b.film", "c.exr", "d.film"], ["d.film", "b.film", "a.film", "c.film"]] {
            let merge = ["merge"].iter().chain(&order).chain(&["-o", "joined.exr", "--json"]);
            assert_eq!(folder.tilecast(merge).finished()["digest"], fresh["digest"], "{sampler}");
            same(&folder, "joined", "fresh");
        }
    }
}

/// Each with what is the matter and where. Seen to fail where a check is left out of `kept.rs`.
#[test]
fn what_does_not_belong_together_is_refused() {
    let folder = Folder::new();
    let scene = scene("cornell-box/scene.xml");
    let render = |more: &[&str]| _ = folder.render(&scene, SIZE.iter().chain(more));
    render(&["--samples", "0..16", "-o", "a.exr"]);
    render(&["--samples", "12..20", "-o", "overlaps.exr"]);
    render(&["--samples", "16..20", "--seed", "1", "-o", "seed.exr"]);
    render(&["--samples", "16..20", "--max-depth", "3", "-o", "depth.exr"]);
    render(&["--samples", "20..24", "-o", "gap.exr"]);
    render(&["--sampler", "sobol-z", "--spp", "16", "-o", "z.exr"]);
    let other = crate::harness::scene("veach-strategies/scene.xml");
    folder.render(&other, SIZE.iter().chain(&["--samples", "16..20", "-o", "scene.exr"]));
    let merge = |film: &'static str| ["merge", "a.film", film, "-o", "joined.exr"];
    refused(
        &folder,
        &merge("overlaps.film"),
        "overlaps.film and a.film both have samples 12..16 of the pixels from (0, 0)",
    );
    refused(&folder, &merge("a.film"), "samples 0..16");
    refused(&folder, &merge("seed.film"), "seed 0 and 1");
    refused(&folder, &merge("depth.film"), "integrator.max_depth");
    refused(&folder, &merge("scene.film"), "different scenes");
    refused(&folder, &merge("nobody.film"), "nobody.film");
    let mut bytes = std::fs::read(folder.path("gap.film")).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    folder.write("damaged.film", &bytes);
    refused(&folder, &merge("damaged.film"), "cannot read the film damaged.film: it is damaged or cut off at byte");
    assert!(!folder.path("joined.exr").exists());
    let gap = folder.tilecast(["merge", "a.film", "gap.film", "-o", "joined.exr", "--json"]).finished();
    assert_eq!(gap["samples"], "0..16,20..24");
    let resume = |image: &'static str| ["render", &scene, "--resume", image, "--spp", "64"].map(str::to_owned);
    let refused_resume = |image, more: &[&str], text| {
        let args = resume(image);
        refused(&folder, &args.iter().map(String::as_str).chain(more.iter().copied()).collect::<Vec<_>>(), text);
    };
    refused_resume("joined.exr", &[], "samples 0..16,20..24");
    refused_resume("a.exr", &["--seed", "2"], "seed 0 and 2");
    refused_resume("scene.exr", &[], "different scenes");
    refused_resume("z.exr", &[], "sobol-z depend on the samples");
    refused(&folder, &["render", &scene, "--resume", "a.exr", "--spp", "16"], "has 16 samples a pixel already");
    refused(&folder, &["render", &scene, "--resume", "a.exr"], "--spp");
}

/// Killed in the middle, twice, once while an image is gone on with.
#[test]
fn a_killed_render_goes_on() {
    let folder = Folder::new();
    let scene = scene("cornell-box/scene.xml");
    let size = ["--size", "64x64"];
    let fresh = folder.render(&scene, size.iter().chain(&["--spp", "1200", "-o", "fresh.exr"]));
    folder.render(&scene, size.iter().chain(&["--spp", "24", "-o", "a.exr"]));
    let command =
        ["render", &scene, "--resume", "a.exr", "--spp", "1200", "--state", "state", "--json", "--threads", "1"];
    for _ in 0..2 {
        let mut render = folder.start(command);
        render.event("progress");
        // The journal is synced within a second; what is younger is traced again.
        std::thread::sleep(std::time::Duration::from_millis(400));
        render.signal("KILL");
        assert_eq!(render.end().code, None, "it must be killed in the middle");
    }
    let outcome = folder.tilecast(command);
    let first = outcome.events().into_iter().find(|event| event["event"] == "progress").expect("progress");
    assert!(first["samples_done"].as_u64() > Some(0), "what was done is not done again: {first}");
    assert_eq!(outcome.finished()["digest"], fresh["digest"]);
    same(&folder, "a", "fresh");
    let other = ["render", &scene, "--size", "64x64", "--spp", "100000", "--state", "state", "-o", "b.exr"];
    let mut begun = folder.start(other.iter().chain(&["--json"]));
    begun.event("progress");
    begun.signal("INT");
    assert!(begun.end().stderr.contains("the same command goes on"));
    refused(&folder, &["render", &scene, "--spp", "4", "--state", "state", "-o", "c.exr"], "holds another render");
}

/// Verified as a whole and by parts, topped up or adaptive; what was tampered with is not.
#[test]
fn honest_images_are_verified_and_others_are_not() {
    let folder = Folder::new();
    let scene = scene("cornell-box/scene.xml");
    folder.render(&scene, SIZE.iter().chain(&["--spp", "6", "-o", "a.exr"]));
    folder.render(&scene, ["--resume", "a.exr", "--spp", "11"]);
    folder.render(&scene, SIZE.iter().chain(&["--target-error", "0.15", "--seed", "8", "-o", "t.exr"]));
    for image in ["a.exr", "t.exr"] {
        for share in ["1", "0.2"] {
            let outcome = folder.tilecast(["verify", image, &scene, "--share", share, "--json"]);
            assert_eq!(outcome.code, Some(0), "{outcome:?}");
            let told = &outcome.events()[0];
            assert_eq!((told["agrees"].as_bool(), told["film"].as_bool()), (Some(true), Some(true)), "{told}");
            assert_eq!(told["units_total"], 20);
        }
    }
    let other = crate::harness::scene("veach-strategies/scene.xml");
    refused(&folder, &["verify", "a.exr", &other], "the image is of a scene with digest");
    // Another seed than the one that it was rendered with, in an image without and with its film.
    let mut bytes = std::fs::read(folder.path("t.exr")).unwrap();
    for text in ["\"seed\":8", "tilecast:seed"] {
        let at = bytes.windows(text.len()).position(|window| window == text.as_bytes()).expect(text);
        if text.starts_with('"') {
            bytes[at + text.len() - 1] = b'7';
        }
    }
    folder.write("t.exr", &bytes);
    refused(&folder, &["verify", "t.exr", &scene], "is not the image of the film beside it");
    let mut bytes = std::fs::read(folder.path("a.exr")).unwrap();
    let text = b"\"spp\":11,\"seed\":0";
    let at = bytes.windows(text.len()).position(|window| window == text).expect("settings");
    bytes[at + text.len() - 1] = b'1';
    folder.write("forged.exr", &bytes);
    let outcome = folder.tilecast(["verify", "forged.exr", &scene, "--json"]);
    assert_eq!((outcome.code, outcome.events()[0]["agrees"].as_bool()), (Some(1), Some(false)), "{outcome:?}");
}

/// An error decides how many samples each tile gets: the same for any number of workers and threads, also after a kill.
#[test]
fn a_target_gives_the_same_bits_whoever_renders() {
    let folder = Folder::new();
    let scene = scene("cornell-box/scene.xml");
    let with = |more: &[&'static str]| [&["--size", "48x40", "--target-error", "0.03"], more].concat();
    let alone = folder.render(&scene, with(&["--threads", "1", "-o", "a.exr"]));
    let together = folder.render(&scene, with(&["--workers", "3", "-o", "b.exr", "--state", "state"]));
    assert_eq!(alone["digest"], together["digest"]);
    same(&folder, "a", "b");
    assert!(alone["relative_error"].as_f64().unwrap() < 0.036, "{alone}");
    let pixels = folder.render(&scene, ["--size", "48x40", "--target-pixel-error", "0.2", "-o", "c.exr"]);
    assert_ne!(pixels["digest"], alone["digest"]);
    let refused_sampler = ["render", &scene, "--target-error", "0.1", "--sampler", "sobol-z", "-o", "d.exr"];
    refused(&folder, &refused_sampler, "sobol-z");
    let resumed = ["render", &scene, "--resume", "a.exr", "--spp", "5000"];
    refused(&folder, &resumed, "not the first ones of every pixel");
}

#[test]
fn a_time_is_kept() {
    let folder = Folder::new();
    let scene = scene("cornell-box/scene.xml");
    let timed = folder.render(&scene, ["--size", "48x40", "--time", "2s", "-o", "a.exr"]);
    let seconds = timed["seconds"].as_f64().unwrap();
    // The machine may be busy with other tests.
    assert!((1.0..8.0).contains(&seconds), "{timed}");
    let spp = timed["spp"].as_u64().unwrap().to_string();
    let again = folder.render(&scene, ["--size", "48x40", "--spp", &spp, "-o", "b.exr"]);
    assert_eq!(again["digest"], timed["digest"], "an even image, that --spp gives again");
}

/// Written while the render goes on, each whole; and at the end who made it.
#[test]
fn pictures_are_refreshed_and_makers_named() {
    let folder = Folder::new();
    let scene = scene("cornell-box/scene.xml");
    let args =
        ["render", &scene, "--size", "64x64", "--spp", "1000", "--previews", "-o", "a.exr", "--json", "--workers", "2"];
    let mut render = folder.start(args);
    let early = crate::harness::poll("pictures", || {
        let whole = folder.path("a.error.png").exists() && folder.path("a.png").exists();
        whole.then(|| std::fs::read(folder.path("a.exr")).expect("an image"))
    });
    assert!(!folder.path("a.film").exists(), "in the middle");
    render.event("finished");
    let finished = render.end().finished();
    assert_ne!(std::fs::read(folder.path("a.exr")).unwrap(), early);
    for name in ["a.png", "a.error.png"] {
        assert_eq!(image::open(folder.path(name)).unwrap().into_rgb8().dimensions(), (64, 64));
    }
    let told: Value = serde_json::from_slice(&std::fs::read(folder.path("a.json")).unwrap()).unwrap();
    assert_eq!((&told["digest"], &told["samples"]), (&finished["digest"], &Value::from("0..1000")));
    let workers = told["workers"].as_array().unwrap();
    let total: u64 = workers.iter().map(|worker| worker["samples"].as_u64().unwrap()).sum();
    assert_eq!((workers.len(), total), (2, 64 * 64 * 1000));
    for worker in workers {
        assert!(worker["units"].as_u64() > Some(0) && worker["trace_seconds"].as_f64() > Some(0.0), "{worker}");
        assert!(worker["cpu"].as_str().is_some_and(|cpu| !cpu.is_empty()), "{worker}");
    }
}

/// Tables and a plot; all digests are equal, or it would have failed.
#[test]
fn scaling_is_measured_and_simulated() {
    let folder = Folder::new();
    let scene = scene("cornell-box/scene.xml");
    let flags = ["--size", "64x64", "--spp", "16", "--workers", "1,2", "--repeats", "1", "--simulate", "64", "--quiet"];
    let outcome = folder.tilecast(["scale", &scene].iter().chain(&flags));
    assert_eq!(outcome.code, Some(0), "{outcome:?}");
    assert_eq!(folder.names(), ["scale.csv", "scale.json", "scale.md", "scale.svg"]);
    let told: Value = serde_json::from_slice(&std::fs::read(folder.path("scale.json")).unwrap()).unwrap();
    let rows = told["rows"].as_array().unwrap();
    let counts: Vec<u64> = rows.iter().map(|row| row["workers"].as_u64().unwrap()).collect();
    assert_eq!(counts, [1, 2, 4, 8, 16, 32, 64]);
    for row in rows {
        let parts = ["tracing", "start", "waiting", "tail"].map(|part| row[part].as_f64().unwrap());
        assert!((parts.iter().sum::<f64>() - 1.0).abs() < 0.05, "{row}");
    }
}

/// As many workers as a coordinator has, where and whatever they are.
#[test]
fn scaling_is_measured_with_workers_that_are_there() {
    let folder = Folder::new();
    let scene = scene("cornell-box/scene.xml");
    let coordinator = coordinator(&folder);
    let workers = [coordinator.worker(&folder), coordinator.worker(&folder)];
    poll("two workers", || (coordinator.status(&folder, "worker").len() == 2).then_some(()));
    let flags = ["--connect", &coordinator.address, "--size", "64x64", "--spp", "16", "--repeats", "2", "--quiet"];
    let outcome = folder.tilecast(["scale", &scene].iter().chain(&flags));
    assert_eq!(outcome.code, Some(0), "{outcome:?}");
    let told: Value = serde_json::from_slice(&std::fs::read(folder.path("scale.json")).unwrap()).unwrap();
    let counts: Vec<u64> =
        told["rows"].as_array().unwrap().iter().map(|row| row["workers"].as_u64().unwrap()).collect();
    assert_eq!(counts, [2]);
    // Some of them, by turns: the others are idle meanwhile.
    let outcome = folder.tilecast(["scale", &scene, "--workers", "1,2"].iter().chain(&flags));
    assert_eq!(outcome.code, Some(0), "{outcome:?}");
    let told: Value = serde_json::from_slice(&std::fs::read(folder.path("scale.json")).unwrap()).unwrap();
    let counts: Vec<u64> =
        told["rows"].as_array().unwrap().iter().map(|row| row["workers"].as_u64().unwrap()).collect();
    assert_eq!(counts, [1, 2]);
    let outcome = folder.tilecast(["scale", &scene, "--workers", "3"].iter().chain(&flags));
    assert_eq!(outcome.code, Some(1), "{outcome:?}");
    assert!(outcome.stderr.contains("--workers 3: the coordinator has 2"), "{outcome:?}");
    drop(workers);
}
