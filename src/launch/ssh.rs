//! Workers on hosts that `ssh` reaches: started, started again after growing pauses, and gone when this process is. What keys, users
//! and ports there are is for ssh's own configuration.

use crate::flags::quoted;
use crate::stop::on_signal;
use anyhow::{Context, bail};
use std::process::{ExitStatus, Stdio};
use std::time::Duration;
use tokio::process::{Child, Command};
use tokio::task::JoinSet;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// Pauses between two starts double from the first to the last of these: a host that restarts takes minutes.
const PAUSE_MIN: Duration = Duration::from_secs(1);
const PAUSE_MAX: Duration = Duration::from_secs(60);
/// A worker that ran for so long has worked: what ended it is no fault of the command.
const WORKED: Duration = Duration::from_secs(30);
/// Starts in a row without a worker that worked, after which a host is given up: wrong names and missing programs do not heal.
const STARTS_MAX: u32 = 8;
/// A worker whose standard input has ended goes at once; its ssh has this long to notice.
const END_GRACE: Duration = Duration::from_secs(5);
/// ssh's own errors end with this.
const SSH_FAILED: i32 = 255;
/// A shell that lacks the program ends with this.
const NOT_FOUND: i32 = 127;

/// A host, and how many workers on it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Host {
    /// As ssh knows it.
    pub name: String,
    /// Workers.
    pub workers: u32,
}

/// What to start, and where.
pub struct Ssh {
    /// Where.
    pub hosts: Vec<Host>,
    /// The program on the hosts.
    pub program: String,
    /// What follows `worker` there.
    pub flags: Vec<String>,
    /// Print the commands instead of running them.
    pub dry_run: bool,
}

/// Keeps the workers running.
///
/// # Errors
/// When every host was given up.
pub async fn run(ssh: Ssh) -> anyhow::Result<()> {
    let places = ssh.hosts.iter().flat_map(|host| (1..=host.workers).map(move |i| (host, i)));
    let commands: Vec<(String, Vec<String>)> = places.map(|(host, i)| command(&ssh, host, i)).collect();
    if ssh.dry_run {
        for (_, words) in &commands {
            println!("{}", words.iter().map(|word| quoted(word)).collect::<Vec<_>>().join(" "));
        }
        return Ok(());
    }
    let stop = on_signal()?;
    let mut keepers = JoinSet::new();
    for (name, words) in commands {
        keepers.spawn(keep(name, words, stop.clone()));
    }
    let mut given_up = Vec::new();
    while let Some(ended) = keepers.join_next().await {
        if let Err(error) = ended.context("watching ssh failed")? {
            tracing::error!("{error:#}");
            given_up.push(error);
        }
    }
    match given_up.pop() {
        Some(error) if !stop.is_cancelled() => Err(error.context("no host is left")),
        _ => Ok(()),
    }
}

/// What a worker is called, and the command that starts it.
fn command(ssh: &Ssh, host: &Host, i: u32) -> (String, Vec<String>) {
    let name = if host.workers == 1 { host.name.clone() } else { format!("{}/{i}", host.name) };
    // Standard input is the line by which the worker learns that this process has gone, whatever ended it.
    let words = ["worker", "--exit-with-parent", "--name", &name].map(str::to_owned);
    let remote: Vec<String> =
        [ssh.program.clone()].iter().chain(&words).chain(&ssh.flags).map(|word| quoted(word)).collect();
    // Nobody is there to type a password, and a host that has gone is to be noticed.
    let options = ["ssh", "-T", "-o", "BatchMode=yes", "-o", "ServerAliveInterval=15", "-o", "ServerAliveCountMax=2"];
    let local = options.map(str::to_owned).into_iter().chain(["--".to_owned(), host.name.clone(), remote.join(" ")]);
    (name, local.collect())
}

/// Starts one worker again and again until `stop`.
async fn keep(name: String, words: Vec<String>, stop: CancellationToken) -> anyhow::Result<()> {
    let (mut pause, mut starts) = (PAUSE_MIN, 0);
    loop {
        let begun = Instant::now();
        let mut child = start(&words)?;
        tracing::info!("{name}: started");
        // Kept apart, since waiting for a child would close it.
        let stdin = child.stdin.take();
        let ended = tokio::select! {
            status = child.wait() => status.context("ssh cannot be waited for")?,
            () = stop.cancelled() => {
                drop(stdin);
                end(child, &name).await;
                return Ok(());
            }
        };
        if begun.elapsed() >= WORKED {
            (pause, starts) = (PAUSE_MIN, 0);
        }
        starts += 1;
        if starts == STARTS_MAX {
            bail!("{name}: given up after {STARTS_MAX} starts; {}", reason(ended));
        }
        tracing::warn!("{name}: {}; starting again in {} s", reason(ended), pause.as_secs());
        tokio::select! {
            () = tokio::time::sleep(pause) => {}
            () = stop.cancelled() => return Ok(()),
        }
        pause = (2 * pause).min(PAUSE_MAX);
    }
}

fn start(words: &[String]) -> anyhow::Result<Child> {
    let mut command = Command::new(&words[0]);
    command.args(&words[1..]).stdin(Stdio::piped()).stdout(Stdio::null()).kill_on_drop(true);
    // Ctrl-C in a terminal goes to a whole process group: only this process is to hear it, and ends the others in order.
    #[cfg(unix)]
    command.process_group(0);
    command.spawn().context("`ssh` cannot be started; is it installed and on PATH?")
}

async fn end(mut child: Child, name: &str) {
    if tokio::time::timeout(END_GRACE, child.wait()).await.is_err() {
        let _ = child.kill().await;
    }
    tracing::info!("{name}: ended");
}

/// What an end means, and what to do about it.
fn reason(status: ExitStatus) -> String {
    match status.code() {
        Some(SSH_FAILED) => {
            "ssh failed (above); can you log in there with `ssh -o BatchMode=yes HOST true`, without a password?".into()
        }
        Some(NOT_FOUND) => "there is no such program there; install tilecast, or say where it is with --program".into(),
        _ => format!("the worker ended ({status})"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_remote_shell_would_tear_apart_is_quoted_once() {
        let flags = ["--connect", "head:7878", "--certs", "my certs"].map(str::to_owned).to_vec();
        let ssh = Ssh { hosts: Vec::new(), program: "/opt/tile cast".into(), flags, dry_run: false };
        let (name, words) = command(&ssh, &Host { name: "a".into(), workers: 2 }, 2);
        assert_eq!(name, "a/2");
        assert_eq!(words[words.len() - 2], "a");
        let remote = "'/opt/tile cast' worker --exit-with-parent --name a/2 --connect head:7878 --certs 'my certs'";
        assert_eq!(words.last().map(String::as_str), Some(remote));
    }
}
