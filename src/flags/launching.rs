//! The flags of `launch`.

use super::cluster::{CLIENTS, CacheFlags};
use super::security::ConnectFlags;
use super::values;
use crate::launch::{Host, Launch, Scale, Slurm, Ssh};
use anyhow::Context;
use clap::{Args, Subcommand};
use std::path::PathBuf;
use std::time::Duration;
use tilecast_proto::limits::THREADS_MAX;

const SLURM_EXAMPLES: &str = "\
Examples, on a login node:
  tilecast launch slurm --workers 20 --connect head:7878 --certs certs
  tilecast launch slurm --workers 20 --connect head:7878 --certs certs --walltime 4h --threads 16 -- --partition=long
  tilecast launch slurm --workers 20 --connect head:7878 --dry-run      what would be submitted
Tasks are found by --name: a launcher that was killed can be started again, and goes on with them.";

const SSH_EXAMPLES: &str = "\
Examples:
  tilecast launch ssh node1 node2 me@node3 --connect head:7878 --certs certs
  tilecast launch ssh node1:2 --threads 32 --connect head:7878 --certs certs      two workers there
  tilecast launch ssh node1 --connect head:7878 --dry-run                         what would be run
--certs, --token-file and --scene-cache are paths on the hosts. Users, ports and keys are those of ssh's configuration.";

/// More on one host have no cores to run on.
const HOST_WORKERS_MAX: u32 = 1024;
/// Slurm's own default bound of an array.
const TASKS_MAX: i64 = 1000;
/// Slurm counts minutes; less than one is none.
const WALLTIME_MIN: Duration = Duration::from_secs(60);

#[derive(Args)]
pub struct LaunchFlags {
    #[command(subcommand)]
    by: LaunchCommand,
}

#[derive(Subcommand)]
enum LaunchCommand {
    /// Keeps as many workers in Slurm's queue as there is work for
    #[command(after_long_help = SLURM_EXAMPLES)]
    Slurm(SlurmFlags),
    /// Keeps workers running on hosts that ssh reaches without a password
    #[command(after_long_help = SSH_EXAMPLES)]
    Ssh(SshFlags),
}

#[derive(Args)]
struct SlurmFlags {
    /// The most workers there may be
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=TASKS_MAX))]
    workers: u32,
    /// The fewest, also when there is nothing to do
    #[arg(long, value_name = "N", default_value_t = 0)]
    min: u32,
    #[command(flatten)]
    connect: ConnectFlags,
    /// How long one task may run; it hands its work back shortly before, and another is submitted
    #[arg(long, value_name = "TIME", default_value = "1h", value_parser = values::time)]
    walltime: Duration,
    /// Threads of each worker, which are its CPUs for Slurm [default: a whole node]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(THREADS_MAX)))]
    threads: Option<u32>,
    #[command(flatten)]
    cache: CacheFlags,
    /// A worker more is worth it for so much work for each of them
    #[arg(long, value_name = "TIME", default_value = "1m", value_parser = values::time)]
    work_each: Duration,
    /// Workers that are too many stay for so long
    #[arg(long, value_name = "TIME", default_value = "30s", value_parser = values::time)]
    patience: Duration,
    /// The tasks' name in Slurm, by which they are found
    #[arg(long, value_name = "NAME", default_value = "tilecast")]
    name: String,
    /// Path of tilecast on the nodes [default: this program's]
    #[arg(long, value_name = "PATH")]
    program: Option<String>,
    /// Prints the command and the script instead
    #[arg(long)]
    dry_run: bool,
    /// More flags for each sbatch: --partition, --account, --output…
    #[arg(last = true, value_name = "SBATCH FLAGS")]
    sbatch: Vec<String>,
}

#[derive(Args)]
struct SshFlags {
    /// Hosts as ssh knows them, with :N for N workers on one
    #[arg(required = true, value_name = "HOST[:N]", value_parser = host)]
    hosts: Vec<Host>,
    /// Where the coordinator listens, as the hosts reach it: HOST:PORT
    #[arg(long, value_name = "ADDR")]
    connect: String,
    /// Folder of certificates on the hosts
    #[arg(long, value_name = "DIR")]
    certs: Option<PathBuf>,
    /// File with a worker's token on the hosts
    #[arg(long, value_name = "FILE", requires = "certs")]
    token_file: Option<PathBuf>,
    /// Threads of each worker [default: all cores of its host]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(THREADS_MAX)))]
    threads: Option<u32>,
    #[command(flatten)]
    cache: CacheFlags,
    /// tilecast on the hosts
    #[arg(long, value_name = "PATH", default_value = "tilecast")]
    program: String,
    /// Prints the commands instead
    #[arg(long)]
    dry_run: bool,
}

impl LaunchFlags {
    pub fn ready(self) -> anyhow::Result<Launch> {
        match self.by {
            LaunchCommand::Slurm(flags) => flags.ready(),
            LaunchCommand::Ssh(flags) => flags.ready(),
        }
    }
}

impl SlurmFlags {
    fn ready(self) -> anyhow::Result<Launch> {
        let Self {
            workers,
            min,
            connect,
            walltime,
            threads,
            cache,
            work_each,
            patience,
            name,
            program,
            dry_run,
            sbatch,
        } = self;
        let usage = |text: String| Err(super::Usage(text).into());
        if walltime < WALLTIME_MIN {
            return usage("--walltime: Slurm counts minutes; give at least 1m".into());
        }
        if min > workers {
            return usage(format!("--min {min} is more than --workers {workers}"));
        }
        let own =
            || Ok(std::env::current_exe().context("this program's own file cannot be found")?.display().to_string());
        let mut flags = connect.words()?;
        flags.extend(threads.map(|n| ["--threads".to_owned(), n.to_string()]).into_iter().flatten());
        if let Some(folder) = cache.scene_cache {
            let absolute = std::path::absolute(&folder).context("--scene-cache has no place")?;
            flags.extend(["--scene-cache".to_owned(), absolute.display().to_string()]);
        }
        Ok(Launch::Slurm(Slurm {
            connector: connect.ready(&CLIENTS)?,
            flags,
            program: program.map_or_else(own, anyhow::Ok)?,
            scale: Scale { min, max: workers, work_each, patience },
            walltime,
            threads,
            name,
            sbatch,
            dry_run,
        }))
    }
}

impl SshFlags {
    fn ready(self) -> anyhow::Result<Launch> {
        let Self { hosts, connect, certs, token_file, threads, cache, program, dry_run } = self;
        let path = |path: PathBuf| path.display().to_string();
        let flags = [
            ("--connect", Some(connect)),
            ("--certs", certs.map(path)),
            ("--token-file", token_file.map(path)),
            ("--threads", threads.map(|n| n.to_string())),
            ("--scene-cache", cache.scene_cache.map(path)),
        ];
        let given = flags.into_iter().filter_map(|(flag, value)| Some([flag.to_owned(), value?]));
        Ok(Launch::Ssh(Ssh { hosts, program, flags: given.flatten().collect(), dry_run }))
    }
}

/// `HOST` or `HOST:N`.
fn host(text: &str) -> Result<Host, String> {
    let (name, workers) = match text.rsplit_once(':') {
        Some((name, count)) => (name, count.parse().ok().filter(|n| (1..=HOST_WORKERS_MAX).contains(n))),
        None => (text, Some(1)),
    };
    match workers {
        // What begins with a dash would be a flag of ssh.
        Some(workers) if !name.is_empty() && !name.starts_with('-') => Ok(Host { name: name.to_owned(), workers }),
        _ => Err(format!("write HOST or HOST:N, N from 1 to {HOST_WORKERS_MAX}; ports are for ssh's configuration")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_host_may_have_a_count_and_never_is_a_flag() {
        assert_eq!(host("me@node:3"), Ok(Host { name: "me@node".into(), workers: 3 }));
        assert_eq!(host("node"), Ok(Host { name: "node".into(), workers: 1 }));
        for wrong in ["", ":2", "node:0", "node:x", "-oProxyCommand=touch owned", "node:9999"] {
            assert!(host(wrong).is_err(), "{wrong}");
        }
    }
}
