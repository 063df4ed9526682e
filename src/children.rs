//! Worker processes of a render on this machine: started, watched, started again a few times, and ended on every way out.

use crate::follow::News;
use anyhow::{Context, anyhow};
use std::collections::VecDeque;
use std::process::{ExitStatus, Stdio};
use std::time::Duration;
use tilecast_core::bvh::simd::Isa;
use tokio::io::{AsyncBufReadExt, AsyncRead, BufReader};
use tokio::process::{Child, Command};
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

/// How often one worker process is started again. One that dies for a reason of its own (memory, an operator) deserves
/// another start; one that cannot work at all should not be tried for ever.
const RESTARTS_MAX: u32 = 3;
/// A worker that has lost its parent's pipe has this long to go by itself.
const END_GRACE: Duration = Duration::from_secs(2);
/// Lines of a worker's stderr that are kept to say why it died.
const TAIL_LINES_MAX: usize = 12;
/// And how much of each line.
const TAIL_LINE_CHARS_MAX: usize = 400;

/// See the module.
pub struct Children {
    /// Each ends when its worker process is gone for good, and says why.
    watchers: JoinSet<anyhow::Error>,
    deaths: mpsc::UnboundedReceiver<String>,
    ending: CancellationToken,
}

/// How to start a worker process.
#[derive(Clone, Debug)]
pub struct Spec {
    /// The coordinator.
    pub address: String,
    /// Threads of each.
    pub threads: u32,
    /// Instruction set.
    pub isa: Isa,
}

impl Children {
    /// Starts `count` processes.
    ///
    /// # Errors
    /// If a process cannot be started; those that were end with the result.
    pub fn start(count: u32, spec: &Spec) -> anyhow::Result<Self> {
        let (told, deaths) = mpsc::unbounded_channel();
        let ending = CancellationToken::new();
        let mut watchers = JoinSet::new();
        for _ in 0..count {
            let child = start(spec)?;
            watchers.spawn(watch(child, spec.clone(), told.clone(), ending.clone()));
        }
        Ok(Self { watchers, deaths, ending })
    }

    /// Waits for a death. Asking may be broken off.
    pub async fn news(&mut self) -> News {
        loop {
            tokio::select! {
                biased;
                Some(text) = self.deaths.recv() => return News::Warning(text),
                ended = self.watchers.join_next() => match ended {
                    Some(Ok(why)) if self.watchers.is_empty() => {
                        return News::Fatal(why.context("every worker process has died"));
                    }
                    Some(Ok(_)) => {}
                    Some(Err(panic)) => return News::Fatal(anyhow!("watching a worker process failed: {panic}")),
                    None => std::future::pending().await,
                },
            }
        }
    }

    /// Ends all processes and waits until they are gone.
    pub async fn end(mut self) {
        self.ending.cancel();
        while self.watchers.join_next().await.is_some() {}
    }
}

fn start(spec: &Spec) -> anyhow::Result<Child> {
    let program = std::env::current_exe().context("this program's own file cannot be found")?;
    let mut command = Command::new(program);
    command.args(["worker", "--exit-with-parent", "--connect", &spec.address]);
    command.args(["--threads", &spec.threads.to_string(), "--isa", spec.isa.name()]);
    command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped()).kill_on_drop(true);
    // Ctrl-C in a terminal goes to a whole process group: only the parent is to hear it, and decides.
    #[cfg(unix)]
    command.process_group(0);
    command.spawn().context("a worker process cannot be started")
}

/// Keeps one worker process alive until `ending`, or until it has died too often: then says why.
async fn watch(
    mut child: Child,
    spec: Spec,
    told: mpsc::UnboundedSender<String>,
    ending: CancellationToken,
) -> anyhow::Error {
    for restarts_left in (0..=RESTARTS_MAX).rev() {
        let pid = child.id().unwrap_or_default();
        let mut tail = VecDeque::new();
        let stderr = child.stderr.take();
        // Kept apart, since waiting for a child would close it.
        let stdin = child.stdin.take();
        let died = tokio::select! {
            (status, ()) = async { tokio::join!(child.wait(), keep_tail(stderr, &mut tail)) } => Some(status),
            () = ending.cancelled() => None,
        };
        let Some(status) = died else {
            drop(stdin);
            end(child).await;
            return anyhow!("ended");
        };
        let why = death(pid, status, &tail);
        if restarts_left == 0 {
            return anyhow!(why);
        }
        // Nobody listens once the render ends; then there is nobody to tell.
        let _ = told.send(format!("{why}; starting another"));
        child = match start(&spec) {
            Ok(child) => child,
            Err(error) => return error,
        };
    }
    anyhow!("a worker process was never started")
}

/// Its pipe is closed, so the worker goes; or it is made to.
async fn end(mut child: Child) {
    if tokio::time::timeout(END_GRACE, child.wait()).await.is_err() {
        let _ = child.kill().await;
    }
}

/// Reads to the end, keeping the last lines.
async fn keep_tail(stderr: Option<impl AsyncRead + Unpin>, tail: &mut VecDeque<String>) {
    let Some(stderr) = stderr else { return };
    let mut lines = BufReader::new(stderr).lines();
    while let Ok(Some(line)) = lines.next_line().await {
        if tail.len() == TAIL_LINES_MAX {
            tail.pop_front();
        }
        tail.push_back(line.chars().take(TAIL_LINE_CHARS_MAX).collect());
    }
}

fn death(pid: u32, status: std::io::Result<ExitStatus>, tail: &VecDeque<String>) -> String {
    let how = status.map_or_else(|e| e.to_string(), |status| status.to_string());
    if tail.is_empty() {
        format!("worker process {pid} died ({how}) and said nothing")
    } else {
        let said: Vec<&str> = tail.iter().map(String::as_str).collect();
        format!("worker process {pid} died ({how}), having said:\n  {}", said.join("\n  "))
    }
}
