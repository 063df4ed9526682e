//! Files, flags and peers that are wrong. Each case must end with the right exit code and a message that names what is at
//! fault, without a panic, and leave nothing behind.

mod files;
mod peers;

use crate::harness::{Folder, scene};

const FAILED: i32 = 1;
const USAGE: i32 = 2;

/// Runs `tilecast args` in `folder`: it must exit with `code`, name all of `names` on stderr, and leave the folder as it was.
fn refused(folder: &Folder, args: &[&str], code: i32, names: &[&str]) {
    let before = folder.names();
    let outcome = folder.tilecast(args);
    assert_eq!(outcome.code, Some(code), "{args:?}: {outcome:?}");
    assert_eq!(outcome.stdout, "", "{args:?}");
    assert!(!outcome.stderr.contains("panicked"), "{args:?}: {}", outcome.stderr);
    // A long message is broken into lines at blanks.
    let said = outcome.stderr.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ");
    for name in names {
        assert!(said.contains(name), "{args:?} does not name `{name}`: {}", outcome.stderr);
    }
    assert_eq!(folder.names(), before, "{args:?} left something");
}

#[test]
fn flags_are_refused_with_their_names() {
    let scene = scene("cornell-box/scene.xml");
    let cases: [(&[&str], &str); 19] = [
        (&["--size", "0x10"], "--size"),
        (&["--size", "10"], "--size"),
        (&["--size", "65537x10"], "--size"),
        (&["--size", "99999999999x10"], "--size"),
        (&["--spp", "0"], "--spp"),
        (&["--spp", "4294967296"], "--spp"),
        (&["--crop", "5,5,5,9"], "--crop"),
        (&["--crop", "1,2,3"], "--crop"),
        (&["--crop", "0,0,257,256"], "--crop"),
        (&["--tile", "0"], "--tile"),
        (&["--tile", "257"], "--tile"),
        (&["--threads", "0"], "--threads"),
        (&["--workers", "0"], "--workers"),
        (&["--isa", "mmx"], "--isa"),
        (&["--strategy", "guess"], "--strategy"),
        (&["--max-depth", "0"], "--max-depth"),
        (&["-D", "spp"], "NAME=VALUE"),
        (&["--json", "--quiet"], "--quiet"),
        (&["--no-such-flag"], "--no-such-flag"),
    ];
    let folder = Folder::new();
    for (flags, name) in cases {
        refused(&folder, &[&["render", scene.as_str()], flags].concat(), USAGE, &[name]);
    }
    refused(&folder, &["render"], USAGE, &["SCENE"]);
    refused(&folder, &["submit", &scene], USAGE, &["--connect"]);
    refused(&folder, &["submit", &scene, "--connect", "nowhere"], USAGE, &["--connect", "nowhere", "HOST:PORT"]);
    refused(&folder, &["worker", "--connect", "a b"], USAGE, &["--connect"]);
}

/// Found before rendering: the scene would take hours.
#[test]
fn outputs_that_cannot_be_written_are_found_first() {
    let folder = Folder::new();
    folder.write("file.txt", "here");
    let scene = scene("cornell-box/scene.xml");
    let folder_itself = folder.path("").display().to_string();
    let mut cases = vec![
        ("missing/out.exr", "no folder missing"),
        ("file.txt/out.exr", "no folder file.txt"),
        (folder_itself.as_str(), "no file"),
        ("out.png", "--preview"),
    ];
    if cfg!(target_os = "linux") {
        // Refuses new files even to root, whom permissions do not stop.
        cases.push(("/proc/out.exr", "cannot be written to"));
        cases.push(("/dev/null", "no file"));
    }
    for (output, name) in cases {
        for command in [vec!["render"], vec!["submit", "--connect", "127.0.0.1:1"]] {
            let args = [&command[..], &[&scene, "--spp", "100000000", "--preview", "-o", output]].concat();
            refused(&folder, &args, FAILED, &["-o", output, name]);
        }
    }
    refused(&folder, &["render", &scene, "--preview", "-o", "out.png"], FAILED, &["out.png", "--preview"]);
}
