//! Workers as Slurm's batch jobs: looks at the coordinator's open work and at Slurm's queue, and submits or cancels tasks until they
//! fit. It keeps nothing itself: which tasks there are is what `squeue` says of their name, so a launcher that was killed is
//! replaced by another.

mod queue;
mod scale;

use crate::flags::quoted;
use crate::stop::on_signal;
use anyhow::Context;
use queue::{Queue, Task};
use scale::Load;
use std::time::Duration;
use tilecast_proto::client::Client;
use tilecast_proto::transport::Connector;
use tilecast_proto::types::JobState;
use tokio::time::Instant;

pub use scale::Scale;

/// Between two looks. Slurm's controller serves the whole site: often enough for people, rarely enough for it.
const LOOK: Duration = Duration::from_secs(5);
/// Of its walltime, a worker leaves so much unused: Slurm counts from before the worker starts, and ends it without asking.
const SPARE_MAX: Duration = Duration::from_secs(60);

/// What to start, and for whom.
pub struct Slurm {
    /// The coordinator whose work is looked at.
    pub connector: Connector,
    /// What follows `worker` on the nodes.
    pub flags: Vec<String>,
    /// This program's own path, the same on the nodes.
    pub program: String,
    /// How many workers.
    pub scale: Scale,
    /// How long a task may run.
    pub walltime: Duration,
    /// Threads of each; or a whole node.
    pub threads: Option<u32>,
    /// The tasks' name in Slurm, by which they are found again.
    pub name: String,
    /// More flags of `sbatch`.
    pub sbatch: Vec<String>,
    /// Print the command instead of running it.
    pub dry_run: bool,
}

impl Slurm {
    /// The command that submits `count` tasks.
    fn command(&self, count: u32) -> Vec<String> {
        // Slurm counts minutes.
        let minutes = self.walltime.as_secs().div_ceil(60);
        let room = self.threads.map_or_else(|| "--exclusive".to_owned(), |n| format!("--cpus-per-task={n}"));
        let words = [
            "sbatch".to_owned(),
            "--parsable".to_owned(),
            format!("--job-name={}", self.name),
            format!("--array=1-{count}"),
            format!("--time={minutes}"),
            "--ntasks=1".to_owned(),
            room,
            // A node that dies takes its task with it: Slurm starts it on another.
            "--requeue".to_owned(),
        ];
        words.into_iter().chain(self.sbatch.iter().cloned()).collect()
    }

    /// What a task runs.
    fn script(&self) -> String {
        let spare = SPARE_MAX.min(self.walltime / 4);
        let lifetime = format!("{}s", (self.walltime - spare).as_secs());
        let words = [self.program.clone(), "worker".into()].into_iter().chain(self.flags.iter().cloned());
        let words: Vec<String> = words.chain(["--lifetime".into(), lifetime]).map(|word| quoted(&word)).collect();
        // In place of the shell, so that Slurm's signals reach the worker.
        format!(
            "#!/bin/sh\nexec {} --name \"$SLURM_JOB_NAME-${{SLURM_ARRAY_JOB_ID}}_$SLURM_ARRAY_TASK_ID\"\n",
            words.join(" ")
        )
    }
}

/// Keeps as many tasks as there is work for, until told to stop; then cancels them.
///
/// # Errors
/// A coordinator that cannot be reached to begin with, or a Slurm that refuses.
pub async fn run(slurm: Slurm) -> anyhow::Result<()> {
    if slurm.dry_run {
        let command = slurm.command(slurm.scale.max);
        let command: Vec<String> = command.iter().map(|word| quoted(word)).collect();
        print!("{} <<'END'\n{}END\n", command.join(" "), slurm.script());
        return Ok(());
    }
    let stop = on_signal()?;
    let queue = Queue::new(slurm.name.clone());
    let mut client = Some(Client::connect(&slurm.connector).await?);
    let found = queue.tasks().await?;
    if !found.is_empty() {
        tracing::info!("{} tasks named {} are there already", found.len(), slurm.name);
    }
    let mut surplus_since = None;
    while !stop.is_cancelled() {
        // A coordinator that is started again, and a controller that is busy, are no reason to give workers up.
        match look(&slurm, &mut client).await {
            Ok(load) => {
                if let Err(error) = adjust(&slurm, &queue, load, &mut surplus_since).await {
                    tracing::warn!("{error:#}; trying again");
                }
            }
            Err(error) => tracing::warn!("{error:#}; trying again"),
        }
        tokio::select! {
            () = tokio::time::sleep(LOOK) => {}
            () = stop.cancelled() => {}
        }
    }
    let left = queue.tasks().await?;
    tracing::info!("cancelling {} tasks", left.len());
    queue.cancel(&left).await
}

/// What the coordinator has to do.
async fn look(slurm: &Slurm, client: &mut Option<Client>) -> anyhow::Result<Load> {
    let open = match client.take() {
        Some(client) => client,
        None => Client::connect(&slurm.connector).await?,
    };
    let (jobs, workers) = (open.jobs().await?, open.workers().await?);
    *client = Some(open);
    let unfinished = jobs.iter().filter(|job| matches!(job.state, JobState::Queued | JobState::Running));
    let rates: Vec<f64> = workers.iter().map(|worker| worker.samples_per_second).filter(|&rate| rate > 0.0).collect();
    Ok(Load {
        samples: unfinished.map(|job| job.samples_total.saturating_sub(job.samples_done)).sum(),
        samples_per_second: (!rates.is_empty()).then(|| rates.iter().sum::<f64>() / rates.len() as f64),
    })
}

/// Submits what is lacking at once; cancels what has been too much for a while.
async fn adjust(slurm: &Slurm, queue: &Queue, load: Load, surplus_since: &mut Option<Instant>) -> anyhow::Result<()> {
    let tasks = queue.tasks().await?;
    let there = u32::try_from(tasks.len()).context("too many tasks")?;
    let wanted = slurm.scale.wanted(&load);
    if wanted > there {
        *surplus_since = None;
        let job = queue.submit(&slurm.command(wanted - there), &slurm.script()).await?;
        tracing::info!("{there} workers for {wanted}: submitted {} as job {job}", wanted - there);
    } else if wanted < there {
        let since = *surplus_since.get_or_insert_with(Instant::now);
        // Those that wait cost nothing to call off.
        let patience_over = since.elapsed() >= slurm.scale.patience;
        let surplus: Vec<Task> = queue::newest(tasks, (there - wanted) as usize)
            .into_iter()
            .filter(|task| patience_over || task.pending)
            .collect();
        if !surplus.is_empty() {
            tracing::info!("{there} workers for {wanted}: cancelling {}", surplus.len());
            queue.cancel(&surplus).await?;
        }
    } else {
        *surplus_since = None;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_worker_ends_before_slurm_ends_it() {
        let slurm = |walltime, threads| Slurm {
            connector: Connector::tcp("head:7878").unwrap(),
            flags: ["--connect", "head:7878", "--certs", "/home/me/my certs"].map(str::to_owned).to_vec(),
            program: "/opt/tilecast".into(),
            scale: Scale { min: 0, max: 3, work_each: Duration::from_secs(60), patience: Duration::from_secs(30) },
            walltime: Duration::from_secs(walltime),
            threads,
            name: "tilecast".into(),
            sbatch: vec!["--partition=long".into()],
            dry_run: true,
        };
        let hours = slurm(4 * 3600, Some(8));
        assert!(hours.script().contains("--lifetime 14340s"), "{}", hours.script());
        assert!(hours.script().contains("exec /opt/tilecast worker --connect head:7878 --certs '/home/me/my certs'"));
        let command = hours.command(3).join(" ");
        assert_eq!(
            command,
            "sbatch --parsable --job-name=tilecast --array=1-3 --time=240 --ntasks=1 --cpus-per-task=8 --requeue --partition=long"
        );
        let minute = slurm(60, None);
        assert!(minute.script().contains("--lifetime 45s"));
        assert!(minute.command(1).contains(&"--exclusive".to_owned()));
    }
}
