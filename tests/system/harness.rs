//! Processes and folders that are gone when a test is, however it ends. Knows no flag's meaning.

use serde_json::Value;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

/// No wait in a test is longer. Generous: the machine may be busy with other tests.
pub const DEADLINE: Duration = Duration::from_secs(120);
/// Between two looks at what is waited for.
const LOOK_AGAIN: Duration = Duration::from_millis(10);

/// A scene of this repository.
pub fn scene(name: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes").join(name).display().to_string()
}

/// The Cornell box, small enough for a test: it has meshes, a lamp, colours, and takes a tenth of a second.
pub const SMALL: [&str; 4] = ["--size", "48x40", "--spp", "6"];

/// A folder of its own to work in.
pub struct Folder(tempfile::TempDir);

impl Folder {
    pub fn new() -> Self {
        Self(tempfile::tempdir().expect("a temporary folder"))
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn write(&self, name: &str, bytes: impl AsRef<[u8]>) {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().expect("a file has a folder")).expect("a folder");
        std::fs::write(path, bytes).expect("a file");
    }

    /// Names of all that is in it, sorted.
    pub fn names(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.0.path()).expect("the folder");
        let mut names: Vec<String> =
            entries.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }

    /// Runs tilecast here, to its end.
    pub fn tilecast<S: AsRef<str>>(&self, args: impl IntoIterator<Item = S>) -> Outcome {
        self.start(args).end()
    }

    /// Renders `scene` here and gives the finished event.
    pub fn render<S: AsRef<str>>(&self, scene: &str, args: impl IntoIterator<Item = S>) -> Value {
        let given = args.into_iter().map(|arg| arg.as_ref().to_owned());
        let all = ["render", scene, "--json"].map(str::to_owned).into_iter().chain(given);
        self.tilecast(all).finished()
    }

    /// Starts tilecast here.
    pub fn start<S: AsRef<str>>(&self, args: impl IntoIterator<Item = S>) -> Running {
        self.start_with(args, &[])
    }

    /// Starts tilecast here, in another environment.
    pub fn start_with<S: AsRef<str>>(&self, args: impl IntoIterator<Item = S>, env: &[(&str, &str)]) -> Running {
        let args: Vec<String> = args.into_iter().map(|arg| arg.as_ref().to_owned()).collect();
        let mut child = Command::new(env!("CARGO_BIN_EXE_tilecast"))
            .args(&args)
            .current_dir(self.0.path())
            .env_remove("TILECAST_ISA")
            .env_remove("TILECAST_LOG")
            .envs(env.iter().copied())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("tilecast starts");
        let stdout = lines(child.stdout.take().expect("piped"));
        let stderr = lines(child.stderr.take().expect("piped"));
        Running { child, args, stdout, stderr, said: Outcome::default() }
    }
}

/// Reads on a thread of its own, so that a full pipe never stops the program.
fn lines(pipe: impl Read + Send + 'static) -> Receiver<String> {
    let (sender, receiver) = channel();
    std::thread::spawn(move || {
        for line in BufReader::new(pipe).lines().map_while(Result::ok) {
            if sender.send(line).is_err() {
                return;
            }
        }
    });
    receiver
}

/// A process; dropped, it is killed and waited for.
pub struct Running {
    child: Child,
    args: Vec<String>,
    stdout: Receiver<String>,
    stderr: Receiver<String>,
    said: Outcome,
}

/// What a process left.
#[derive(Debug, Default)]
pub struct Outcome {
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
}

impl Running {
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// The JSON event of that name, as soon as it is printed.
    pub fn event(&mut self, name: &str) -> Value {
        self.wait_for(name, |said| said.events().into_iter().find(|event| event["event"] == name))
    }

    /// Waits until stderr has `text`.
    pub fn complains(&mut self, text: &str) {
        self.wait_for(text, |said| said.stderr.contains(text).then_some(()));
    }

    fn wait_for<T>(&mut self, what: &str, find: impl Fn(&Outcome) -> Option<T>) -> T {
        let begun = Instant::now();
        loop {
            self.listen();
            if let Some(found) = find(&self.said) {
                return found;
            }
            let ended = self.child.try_wait().expect("a child can be waited for");
            let (args, said) = (&self.args, &self.said);
            assert!(
                ended.is_none_or(|_| begun.elapsed() < Duration::from_secs(1)),
                "{args:?} ended without {what}: {said:?}"
            );
            assert!(begun.elapsed() < DEADLINE, "{args:?} did not say {what}: {said:?}");
            std::thread::sleep(LOOK_AGAIN);
        }
    }

    fn listen(&mut self) {
        for (lines, text) in [(&self.stdout, &mut self.said.stdout), (&self.stderr, &mut self.said.stderr)] {
            for line in lines.try_iter() {
                text.push_str(&line);
                text.push('\n');
            }
        }
    }

    /// Sends a signal by name: `INT`, `TERM`, `KILL`.
    pub fn signal(&self, name: &str) {
        signal(self.pid(), name);
    }

    /// Waits for its end.
    pub fn end(mut self) -> Outcome {
        let args = self.args.clone();
        let status: ExitStatus =
            poll(&format!("the end of {args:?}"), || self.child.try_wait().expect("a child can be waited for"));
        // Both pipes are closed now, or will be when the last process that holds them ends.
        let begun = Instant::now();
        for (lines, text) in [(&self.stdout, &mut self.said.stdout), (&self.stderr, &mut self.said.stderr)] {
            while let Ok(line) = lines.recv_timeout(DEADLINE.saturating_sub(begun.elapsed())) {
                text.push_str(&line);
                text.push('\n');
            }
        }
        Outcome { code: status.code(), ..std::mem::take(&mut self.said) }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Outcome {
    /// All of stdout as JSON objects.
    pub fn events(&self) -> Vec<Value> {
        let parse = |line: &str| serde_json::from_str(line).unwrap_or_else(|e| panic!("{e} in {line}"));
        self.stdout.lines().map(parse).collect()
    }

    /// The last event, which says that all went well.
    pub fn finished(&self) -> Value {
        assert_eq!(self.code, Some(0), "{self:?}");
        let last = self.events().pop().unwrap_or_else(|| panic!("no event: {self:?}"));
        assert_eq!(last["event"], "finished", "{self:?}");
        last
    }
}

/// Looks until there is something to see.
pub fn poll<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let begun = Instant::now();
    loop {
        if let Some(seen) = look() {
            return seen;
        }
        assert!(begun.elapsed() < DEADLINE, "waited for {what} in vain");
        std::thread::sleep(LOOK_AGAIN);
    }
}

/// Sends a signal by name.
pub fn signal(pid: u32, name: &str) {
    let status = Command::new("kill").args(["-s", name, &pid.to_string()]).status().expect("kill exists");
    assert!(status.success(), "signal {name} to {pid}");
}

/// A coordinator process.
pub struct Coordinator {
    pub address: String,
    pub process: Running,
}

/// Starts one on a free port.
pub fn coordinator(folder: &Folder) -> Coordinator {
    coordinator_with(folder, &["--listen", "127.0.0.1:0"])
}

/// An address that nobody listens on, for a coordinator that is started there again and again.
pub fn free_address() -> String {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port");
    listener.local_addr().expect("an address").to_string()
}

/// Starts one with these flags.
pub fn coordinator_with(folder: &Folder, flags: &[&str]) -> Coordinator {
    let mut process = folder.start(["coordinator", "--json"].into_iter().chain(flags.iter().copied()));
    let address = process.event("listening")["address"].as_str().expect("an address").to_owned();
    Coordinator { address, process }
}

impl Coordinator {
    /// A worker for it.
    pub fn worker(&self, folder: &Folder) -> Running {
        folder.start(["worker", "--connect", &self.address, "--threads", "1"])
    }

    /// A client of it, rendering with `args`.
    pub fn submit(&self, folder: &Folder, args: &[&str]) -> Running {
        folder.start(["submit", "--json", "--connect", &self.address].into_iter().chain(args.iter().copied()))
    }

    /// Its jobs or workers, as `tilecast status` has them.
    pub fn status(&self, folder: &Folder, kind: &str) -> Vec<Value> {
        let outcome = folder.tilecast(["status", "--json", "--connect", &self.address]);
        assert_eq!(outcome.code, Some(0), "{outcome:?}");
        outcome.events().into_iter().filter(|line| line["kind"] == kind).collect()
    }
}

/// Pids of the children of a process.
#[cfg(target_os = "linux")]
pub fn children(pid: u32) -> Vec<u32> {
    let stat = |pid: u32| std::fs::read_to_string(format!("/proc/{pid}/stat")).ok();
    // pid (name) state parent: the name may contain anything, so it is skipped from behind.
    let parent = |pid: u32| stat(pid)?.rsplit_once(')')?.1.split_whitespace().nth(1)?.parse::<u32>().ok();
    let entries = std::fs::read_dir("/proc").expect("/proc");
    let pids = entries.filter_map(|entry| entry.ok()?.file_name().to_str()?.parse::<u32>().ok());
    pids.filter(|&child| parent(child) == Some(pid)).collect()
}

/// Seconds that a process has had of processors. In the long run they tell more than a clock on a machine that does other
/// things, too.
#[cfg(target_os = "linux")]
pub fn cpu_seconds(pid: u32) -> f64 {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).expect("a process");
    let fields: Vec<&str> = stat.rsplit_once(')').expect("a name").1.split_whitespace().collect();
    let ticks = |field: &str| field.parse::<f64>().expect("ticks");
    // In hundredths, on every Linux.
    (ticks(fields[11]) + ticks(fields[12])) / 100.0
}

/// As many open files as one may have, for tests with many connections.
#[cfg(unix)]
pub fn open_many_files() {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    let limits = getrlimit(Resource::Nofile);
    setrlimit(Resource::Nofile, Rlimit { current: limits.maximum, ..limits }).expect("what one may have");
}

/// Whether tests shall be as long as `just soak` wants them.
pub fn is_soak() -> bool {
    std::env::var("TILECAST_RUNS").is_ok_and(|runs| runs.parse::<u32>().is_ok_and(|runs| runs >= 100))
}

/// Whether a process is there, and more than a zombie.
#[cfg(target_os = "linux")]
pub fn is_alive(pid: u32) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    stat.rsplit_once(')').is_some_and(|(_, rest)| !rest.trim_start().starts_with('Z'))
}
