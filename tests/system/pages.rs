//! The pages people read, tried: every command of the README and of docs/ runs, every flag they name exists, and every error
//! message of docs/trouble.md is one that the program has.
//!
//! Commands are the lines of blocks that begin with ```` ```sh ````. Those of one page run in order in one folder, which has the
//! repository's scenes, a `scene.xml` and a `model.obj`. What never ends by itself (`tilecast coordinator`, `worker`, `launch`)
//! runs until its page ends. Sizes, samples and times are cut down, ports and hosts are this test's: see [`small`].
//!
//! A block that cannot run here says what it needs, ```` ```sh needs=slurm ````, and is counted in [`ELSEWHERE`].

use crate::harness::{Folder, Running, free_address, poll};
use std::collections::{BTreeMap, BTreeSet};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Commands that do not run in this test, by page and by what they need.
const ELSEWHERE: [(&str, &str, usize); 11] = [
    ("README.md", "source", 1),
    ("docs/first-render.md", "source", 1),
    ("docs/kubernetes.md", "kubernetes", 4),
    ("docs/kubernetes.md", "podman", 2),
    ("docs/performance.md", "hours", 9),
    ("docs/python.md", "python", 3),
    ("docs/sampling.md", "hours", 2),
    ("docs/services.md", "podman", 2),
    ("docs/services.md", "systemd", 4),
    ("docs/slurm.md", "slurm", 3),
    ("docs/strategies.md", "hours", 2),
];

/// What a block can need that a test has not: `hours` are measurements, `source` is cargo and this repository.
const NEEDS: [&str; 7] = ["hours", "kubernetes", "podman", "python", "slurm", "source", "systemd"];
/// What is not ours: flags of other programs.
const FOREIGN_FLAGS: [&str; 13] = [
    "--build",
    "--exclusive",
    "--from-file",
    "--grpc_python_out",
    "--nocapture",
    "--now",
    "--pixels",
    "--python_out",
    "--replicates",
    "--requeue",
    "--scale",
    "--set",
    "--test",
];
/// Nothing on a page takes longer, cut down.
const SECONDS_MAX: &str = "100";
/// Side of a picture here, in pixels.
const SIDE: &str = "24";
/// Samples are this many times fewer…
const FEWER: u64 = 256;
/// …but enough for an error bar.
const SAMPLES_MIN: u64 = 8;

struct Block {
    line: usize,
    needs: Option<String>,
    commands: Vec<String>,
}

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// The README and docs/, by name.
fn pages() -> Vec<(String, String)> {
    let entries = std::fs::read_dir(root().join("docs")).expect("docs");
    let names = entries.map(|entry| format!("docs/{}", entry.expect("an entry").file_name().to_string_lossy()));
    let mut names: Vec<String> = names.filter(|name| name.ends_with(".md")).chain(["README.md".to_owned()]).collect();
    names.sort();
    let read = |name: String| (std::fs::read_to_string(root().join(&name)).expect("a page"), name);
    names.into_iter().map(read).map(|(text, name)| (name, text)).collect()
}

/// The blocks of commands in a page.
fn blocks(page: &str, text: &str) -> Vec<Block> {
    let mut blocks: Vec<Block> = Vec::new();
    let (mut inside, mut shell) = (false, false);
    for (i, line) in text.lines().enumerate() {
        if let Some(kind) = line.trim_start().strip_prefix("```") {
            inside = !inside;
            shell = inside && (kind == "sh" || kind.starts_with("sh "));
            if shell {
                let needs =
                    kind.strip_prefix("sh ").map(|rest| rest.trim().strip_prefix("needs=").unwrap_or(rest).to_owned());
                let known = needs.as_ref().is_none_or(|needs| NEEDS.contains(&needs.as_str()));
                assert!(known, "{page}, line {}: what is `{kind}`? Write sh, or sh needs= one of {NEEDS:?}", i + 1);
                blocks.push(Block { line: i + 1, needs, commands: Vec::new() });
            }
        } else if shell && let Some(block) = blocks.last_mut() {
            match block.commands.last_mut() {
                Some(last) if last.ends_with('\\') => {
                    last.pop();
                    last.push_str(line.trim());
                }
                _ if line.trim().is_empty() || line.starts_with('#') => {}
                _ => block.commands.push(line.split("  #").next().unwrap_or(line).trim().to_owned()),
            }
        }
    }
    blocks
}

/// A command as it is run here: the same flags with smaller values.
fn small(command: &str, address: &str, http: &str) -> String {
    let port = |address: &str| address.rsplit_once(':').expect("HOST:PORT").1.to_owned();
    let host = address.trim_end_matches(|c| c != ':').trim_end_matches(':');
    let command = command.replace("cargo run --release --", "tilecast");
    let command = command.replace("7878", &port(address)).replace("7880", &port(http));
    let mut words: Vec<String> = command.replace("HOST:", &format!("{host}:")).split(' ').map(str::to_owned).collect();
    let fewer = |n: &str| {
        n.parse::<u64>().map_or(n.to_owned(), |n| if n == 0 { n } else { (n / FEWER).max(SAMPLES_MIN) }.to_string())
    };
    for i in 1..words.len() {
        words[i] = match words[i - 1].as_str() {
            "--spp" => fewer(&words[i]),
            "--samples" => words[i].split("..").map(fewer).collect::<Vec<_>>().join(".."),
            "--size" => format!("{SIDE}x{SIDE}"),
            "--pixel" => "12,12".to_owned(),
            "--time" => "1s".to_owned(),
            "--simulate" => "10".to_owned(),
            _ => continue,
        };
    }
    words.join(" ")
}

/// Runs all that can be run of a page; says how many commands that were.
fn run(page: &str, text: &str) -> usize {
    let folder = Folder::new();
    let scenes = root().join("scenes");
    for path in files(&scenes).iter().filter(|path| path.extension().is_none_or(|end| end != "png")) {
        let mut bytes = std::fs::read(path).expect("a scene's file");
        if path.extension().is_some_and(|end| end == "xml") {
            let text = String::from_utf8(bytes).expect("a scene is text");
            let text = text.replace("\"size\" value=\"256\"", &format!("\"size\" value=\"{SIDE}\""));
            // Fewer than whoever goes on with an image asks for.
            bytes = text.replace("\"spp\" value=\"64\"", "\"spp\" value=\"4\"").into_bytes();
        }
        let inside = path.strip_prefix(&scenes).expect("it lies there");
        folder.write(&format!("scenes/{}", inside.display()), &bytes);
        for (start, copy) in [("cornell-box", ""), ("obj/gem", "model")] {
            if let Some(rest) = inside.to_str().and_then(|path| path.strip_prefix(start)) {
                folder.write(&format!("{copy}{}", rest.trim_start_matches('/')), &bytes);
            }
        }
    }
    folder.write("docs/empty", "");
    let (address, http) = (free_address(), free_address());
    let mut running: Vec<Running> = Vec::new();
    let mut count = 0;
    for block in blocks(page, text).iter().filter(|block| block.needs.is_none()) {
        for command in block.commands.iter().map(|command| small(command, &address, &http)) {
            let at = format!("{page}, line {}: {command}", block.line);
            let words: Vec<&str> = command.split_whitespace().collect();
            if words[0] == "tilecast"
                && ["coordinator", "worker", "launch"].contains(&words[1])
                && !words.contains(&"--dry-run")
            {
                running.push(folder.start(&words[1..]));
                if words[1] == "coordinator" {
                    poll(&at, || TcpStream::connect(&address).ok());
                }
            } else {
                let path = Path::new(env!("CARGO_BIN_EXE_tilecast")).parent().expect("a folder").display().to_string();
                let path = format!("{path}:{}", std::env::var("PATH").expect("a PATH"));
                let mut shell = Command::new("timeout");
                shell.args([SECONDS_MAX, "sh", "-ec", &command]).current_dir(folder.path("")).env("PATH", path);
                let output = shell.env("HOME", folder.path("")).output().expect("a shell");
                let said = [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
                assert!(output.status.success(), "{at} ended with {}: {said:?}", output.status);
            }
            count += 1;
        }
    }
    count
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
    entries.flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect()
}

/// Fails if a page's command is misspelt, or has a flag that does not exist any more.
#[test]
fn every_command_of_the_pages_runs() {
    let pages = pages();
    let counts: Vec<usize> = std::thread::scope(|scope| {
        let threads: Vec<_> = pages.iter().map(|(name, text)| scope.spawn(|| run(name, text))).collect();
        threads.into_iter().map(|thread| thread.join().unwrap_or_else(|e| std::panic::resume_unwind(e))).collect()
    });
    assert!(counts.iter().sum::<usize>() > 30, "hardly any command was found: {counts:?}");
}

/// What is not run is listed, so that no command is left out by accident.
#[test]
fn what_cannot_run_here_is_counted() {
    let mut elsewhere: BTreeMap<(String, String), usize> = BTreeMap::new();
    for (page, text) in pages() {
        for block in blocks(&page, &text) {
            if let Some(needs) = block.needs {
                *elsewhere.entry((page.clone(), needs)).or_default() += block.commands.len();
            }
        }
    }
    let listed: Vec<(String, String, usize)> =
        ELSEWHERE.iter().map(|&(page, needs, count)| (page.to_owned(), needs.to_owned(), count)).collect();
    let found: Vec<(String, String, usize)> =
        elsewhere.into_iter().map(|((page, needs), count)| (page, needs, count)).collect();
    assert_eq!(found, listed, "commands that do not run in tests: change ELSEWHERE if that is right");
}

/// Also in tables and sentences.
#[test]
fn every_flag_that_pages_name_exists() {
    let folder = Folder::new();
    let mut known: BTreeSet<String> = FOREIGN_FLAGS.iter().map(|&flag| flag.to_owned()).collect();
    let mut commands = vec![Vec::new()];
    while let Some(command) = commands.pop() {
        let help = folder.tilecast(command.iter().map(String::as_str).chain(["--help"])).stdout;
        known.extend(flags(&help));
        let below = help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
        let names = below.filter_map(|line| line.strip_prefix("  ")?.split(' ').next().filter(|name| !name.is_empty()));
        commands.extend(names.filter(|name| *name != "help").map(|name| [&command[..], &[name.to_owned()]].concat()));
    }
    for (page, text) in pages() {
        let ours = |line: &&str| !["cargo ", "just ", "pip "].iter().any(|other| line.contains(other));
        for line in text.lines().filter(ours) {
            for flag in flags(line) {
                assert!(known.contains(&flag), "{page} names {flag}, which no command has: {line}");
            }
        }
    }
}

/// Words that begin with two dashes.
fn flags(text: &str) -> Vec<String> {
    let words = text.split(|c: char| !(c.is_ascii_alphanumeric() || "-_".contains(c)));
    let flags = words.filter(|word| word.starts_with("--") && word[2..].starts_with(|c: char| c.is_ascii_lowercase()));
    flags.map(|flag| flag.trim_end_matches('-').to_owned()).collect()
}

/// Headings of docs/trouble.md are messages; `…` stands for what differs. Fails if a message was reworded in the program alone.
#[test]
fn every_message_of_the_trouble_page_is_one_of_the_program() {
    let folders = ["src", "core/src", "proto/src", "coordinator/src", "worker/src"];
    let sources: Vec<String> = folders
        .iter()
        .flat_map(|folder| files(&root().join(folder)))
        .filter(|path| path.extension().is_some_and(|end| end == "rs"))
        .map(|path| std::fs::read_to_string(path).expect("a source"))
        .collect();
    let page = std::fs::read_to_string(root().join("docs/trouble.md")).expect("the page");
    let messages: Vec<&str> = page.lines().filter_map(|line| line.strip_prefix("### `")?.strip_suffix('`')).collect();
    assert!(messages.len() > 10, "hardly any message was found");
    for message in messages {
        for part in message.split('…').map(str::trim).filter(|part| part.len() > 3) {
            assert!(sources.iter().any(|source| source.contains(part)), "no source says `{part}` of `{message}`");
        }
    }
}
