//! `tilecast status`: a coordinator's jobs and workers.

use crate::report::{ErrorFields, percent, print};
use serde::Serialize;
use tilecast_proto::client::Client;
use tilecast_proto::transport::Connector;
use tilecast_proto::types::{JobState, Progress, WorkerStatus};

/// Whose.
pub struct Status {
    /// The coordinator.
    pub connector: Connector,
    /// As JSON.
    pub json: bool,
}

#[derive(Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
enum Line<'a> {
    Job {
        job: u64,
        name: &'a str,
        state: &'a str,
        message: Option<&'a str>,
        samples_done: u64,
        samples_total: u64,
        workers: u32,
        #[serde(flatten)]
        error: ErrorFields,
        seconds: f64,
        scene: String,
    },
    Worker {
        worker: u64,
        name: &'a str,
        host: &'a str,
        pid: u32,
        isa: &'a str,
        threads: u32,
        leases: u32,
        units_done: u64,
        samples_done: u64,
        samples_per_second: f64,
        silent_seconds: f64,
    },
}

/// Lists them.
///
/// # Errors
/// Nobody there.
pub async fn run(Status { connector, json }: Status) -> anyhow::Result<()> {
    let client = Client::connect(&connector).await?;
    let (jobs, workers) = (client.jobs().await?, client.workers().await?);
    if json {
        jobs.iter().for_each(|job| print(&job_line(job)));
        workers.iter().for_each(|worker| print(&worker_line(worker)));
    } else {
        println!("{}", table(&jobs, &workers));
    }
    Ok(())
}

fn job_line(job: &Progress) -> Line<'_> {
    let (state, message) = state(&job.state);
    Line::Job {
        job: job.job.0,
        name: &job.name,
        state,
        message,
        samples_done: job.samples_done,
        samples_total: job.samples_total,
        workers: job.workers,
        error: job.relative_error.into(),
        seconds: job.elapsed.as_secs_f64(),
        scene: job.scene.to_string(),
    }
}

fn worker_line(worker: &WorkerStatus) -> Line<'_> {
    Line::Worker {
        worker: worker.worker.0,
        name: &worker.info.name,
        host: &worker.info.host,
        pid: worker.info.pid,
        isa: &worker.info.isa,
        threads: worker.info.threads,
        leases: worker.leases,
        units_done: worker.units_done,
        samples_done: worker.samples_done,
        samples_per_second: worker.samples_per_second,
        silent_seconds: worker.silent.as_secs_f64(),
    }
}

/// A job's state in a word, and why if it failed.
pub fn state(state: &JobState) -> (&str, Option<&str>) {
    match state {
        JobState::Queued => ("queued", None),
        JobState::Running => ("running", None),
        JobState::Finished => ("finished", None),
        JobState::Failed(why) => ("failed", Some(why)),
        JobState::Cancelled => ("cancelled", None),
    }
}

fn table(jobs: &[Progress], workers: &[WorkerStatus]) -> String {
    let mut lines = vec![format!(
        "{:<8} {:<10} {:>6} {:>8} {:>9}  {:<22} name",
        "job", "state", "done", "workers", "seconds", "error"
    )];
    for job in jobs {
        let (word, why) = state(&job.state);
        let done = 100.0 * job.samples_done as f64 / job.samples_total as f64;
        let seconds = job.elapsed.as_secs_f64();
        let error = job.relative_error.map_or_else(String::new, |error| percent(&error));
        lines.push(format!(
            "{:<8} {word:<10} {done:>4.0} % {:>8} {seconds:>9.1}  {error:<22} {}",
            job.job, job.workers, job.name
        ));
        lines.extend(why.map(|why| format!("    {why}")));
    }
    let columns = ("worker", "threads", "isa", "units", "Msamples/s");
    lines.push(format!(
        "\n{:<8} {:>7} {:<8} {:>7} {:>10}  machine",
        columns.0, columns.1, columns.2, columns.3, columns.4
    ));
    for WorkerStatus { worker, info, units_done, samples_per_second, .. } in workers {
        let rate = samples_per_second / 1e6;
        lines.push(format!(
            "{:<8} {:>7} {:<8} {units_done:>7} {rate:>10.2}  {}:{} {}",
            worker.number(),
            info.threads,
            info.isa,
            info.host,
            info.pid,
            info.name
        ));
    }
    lines.join("\n")
}
