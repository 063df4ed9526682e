//! The state of all as the page shows it: sent when something changes, not more than twice a second, to whoever looks on; made
//! once for all of them.

use super::Inner;
use super::guard::told;
use crate::events::Event;
use crate::ledger::{Ledger, Trust};
use crate::service::Shared;
use axum::body::{Body, Bytes};
use axum::extract::{Path, State};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tilecast_core::film::RelativeError;
use tilecast_core::film::file::Target;
use tilecast_proto::types::{Aim, JobId, JobState, Progress, WorkerStatus};
use tokio::sync::mpsc;
use tokio::time::Instant;
use tokio_stream::wrappers::ReceiverStream;

/// States are at least this far apart: two a second are enough for eyes.
const INTERVAL: Duration = Duration::from_millis(500);
/// And at most this, since heartbeats and times go on.
const INTERVAL_MAX: Duration = Duration::from_secs(1);
/// One state on its way, one being written: who is slow gets later ones, not more.
const QUEUE_LEN: usize = 1;
/// Jobs in the list: those that go on, then the last that ended.
const JOBS_SHOWN_MAX: usize = 40;
/// Workers in the list; of more, those that have brought most.
const WORKERS_SHOWN_MAX: usize = 200;

/// What those who look on have in common.
#[derive(Default)]
pub struct Feed {
    watchers: AtomicUsize,
    last: Mutex<Option<(Instant, Bytes)>>,
}

#[derive(Serialize)]
struct Live<'a> {
    /// Tells this coordinator from one before it.
    instance: String,
    version: &'static str,
    title: &'a str,
    /// Seconds since 1970.
    now: f64,
    /// It ends: nothing more will come.
    ending: bool,
    jobs: Vec<Job>,
    jobs_total: usize,
    workers: Vec<Worker>,
    workers_total: usize,
    threads_total: u64,
    events: Vec<Event>,
}

#[derive(Serialize)]
struct Job {
    id: u64,
    name: String,
    state: &'static str,
    why: Option<String>,
    samples_done: u64,
    samples_total: u64,
    samples_per_second: f64,
    seconds_left: Option<f64>,
    /// Seconds since 1970.
    submitted: f64,
    running: f64,
    workers: u32,
    error: Option<[f32; 3]>,
    /// Of the film; `None` if it is not in memory.
    version: Option<u64>,
    x0: u32,
    y0: u32,
    width: u32,
    height: u32,
    spp: u32,
    seed: u64,
    aim: Option<Towards>,
}

/// See [`Aim`].
#[derive(Serialize)]
struct Towards {
    target: Option<f32>,
    /// What the target is of: `image` or `pixels`.
    of: &'static str,
    pilot: bool,
    before: u64,
    image: u64,
    expected: u64,
}

impl From<Aim> for Towards {
    fn from(Aim { target, pilot, before, image, expected }: Aim) -> Self {
        let (target, of) = match target {
            None => (None, "image"),
            Some(Target::Image(error)) => (Some(error), "image"),
            Some(Target::Pixels(error)) => (Some(error), "pixels"),
        };
        Self { target, of, pilot, before, image, expected }
    }
}

#[derive(Serialize)]
struct Worker {
    /// The number that people see.
    id: u32,
    name: String,
    host: String,
    cpu: String,
    isa: String,
    threads: u32,
    leases: u32,
    units: u64,
    samples: u64,
    samples_per_second: f64,
    /// Seconds since it was heard.
    silent: f64,
    checked: &'static str,
    offences: u32,
}

impl Feed {
    /// Whether anyone looks on.
    pub fn watched(&self) -> bool {
        self.watchers() > 0
    }

    /// How many look on.
    pub fn watchers(&self) -> usize {
        self.watchers.load(Ordering::Relaxed)
    }

    /// The state as it is, or was a moment ago.
    fn state(&self, site: &Inner) -> Bytes {
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        let ending = site.shared.closing.is_cancelled();
        match &*last {
            Some((at, state)) if at.elapsed() < INTERVAL / 2 && !ending => state.clone(),
            _ => {
                let state = event(&state(site));
                *last = Some((Instant::now(), state.clone()));
                state
            }
        }
    }
}

/// Sends states for as long as someone reads them.
pub async fn live(State(site): State<Arc<Inner>>) -> Response {
    let (sender, receiver) = mpsc::channel(QUEUE_LEN);
    tokio::spawn(async move {
        site.feed.watchers.fetch_add(1, Ordering::Relaxed);
        feed(&site, sender).await;
        site.feed.watchers.fetch_sub(1, Ordering::Relaxed);
    });
    let body = Body::from_stream(ReceiverStream::new(receiver));
    ([(header::CONTENT_TYPE, "text/event-stream")], body).into_response()
}

async fn feed(site: &Inner, sender: mpsc::Sender<Result<Bytes, std::convert::Infallible>>) {
    loop {
        let ending = site.shared.closing.is_cancelled();
        if sender.send(Ok(site.feed.state(site))).await.is_err() {
            return;
        }
        if ending {
            // The connection stays, so that the page can fetch the last tiles before it takes the silence for a failure.
            return sender.closed().await;
        }
        let next = async {
            tokio::time::sleep(INTERVAL).await;
            let _ = tokio::time::timeout(INTERVAL_MAX - INTERVAL, site.shared.changed.notified()).await;
        };
        tokio::select! {
            () = next => {}
            () = site.shared.closing.cancelled() => {}
            () = sender.closed() => return,
        }
    }
}

fn event(data: &str) -> Bytes {
    format!("event: state\ndata: {data}\n\n").into()
}

/// What only the page of one job shows.
#[derive(Serialize)]
struct Detail {
    id: u64,
    settings: tilecast_core::settings::Settings,
    /// Seconds, samples, and the error with its interval, round by round.
    history: Vec<(f64, u64, [f32; 3])>,
}

/// The way of a job's error, and its settings.
pub async fn job(State(site): State<Arc<Inner>>, Path(id): Path<u64>) -> Response {
    let found = site.shared.with_ledger(|ledger, _| {
        let (spec, history) = (ledger.spec(JobId(id))?, ledger.history(JobId(id))?);
        let history = history.iter().map(|point| (point.running.as_secs_f64(), point.samples, interval(point.error)));
        Ok::<Detail, crate::ledger::LedgerError>(Detail { id, settings: spec.settings, history: history.collect() })
    });
    match found {
        Ok(detail) => ([(header::CONTENT_TYPE, "application/json")], json(&detail)).into_response(),
        Err(error) => told(&error.into()),
    }
}

fn state(site: &Inner) -> String {
    let shared = &site.shared;
    let (jobs, jobs_total, workers, workers_total, threads_total) = shared.with_ledger(|ledger, now| {
        let all = ledger.workers(now);
        let (workers_total, threads_total) = (all.len(), all.iter().map(|one| u64::from(one.info.threads)).sum());
        let (jobs, jobs_total) = jobs(ledger, now);
        (jobs, jobs_total, workers(ledger, all), workers_total, threads_total)
    });
    json(&Live {
        instance: format!("{:x}", shared.instance),
        version: env!("CARGO_PKG_VERSION"),
        title: &site.title,
        now: shared.now().as_secs_f64(),
        ending: shared.closing.is_cancelled(),
        jobs: jobs.into_iter().map(|job| row(shared, job)).collect(),
        jobs_total,
        workers,
        workers_total,
        threads_total,
        events: shared.events.last(),
    })
}

/// A job, and what its progress does not say.
struct Shown {
    progress: Progress,
    submitted: Duration,
    left: u64,
    aim: Option<Aim>,
}

/// The jobs that are shown, newest first.
fn jobs(ledger: &Ledger, now: Duration) -> (Vec<Shown>, usize) {
    let all = ledger.jobs();
    let (going, ended): (Vec<JobId>, Vec<JobId>) = all.iter().partition(|&&id| ledger.goes_on(id));
    let shown = going.iter().chain(ended.iter().rev()).take(JOBS_SHOWN_MAX);
    let describe = |&id: &JobId| {
        let (progress, submitted) = (ledger.progress(now, id).ok()?, ledger.queued_at(id)?);
        Some(Shown { progress, submitted, left: ledger.left(id), aim: ledger.aim(id) })
    };
    let mut jobs: Vec<Shown> = shown.filter_map(describe).collect();
    jobs.sort_by_key(|job| std::cmp::Reverse(job.progress.job));
    (jobs, all.len())
}

fn row(shared: &Shared, Shown { progress, submitted, left, aim }: Shown) -> Job {
    let speed = progress.samples_per_second;
    let state = state_name(&progress.state);
    let why = if let JobState::Failed(why) = progress.state { Some(why) } else { None };
    let crop = progress.settings.film.crop;
    Job {
        id: progress.job.0,
        name: progress.name,
        state,
        why,
        samples_done: progress.samples_done,
        samples_total: progress.samples_total,
        samples_per_second: speed,
        seconds_left: (speed > 0.0).then(|| left as f64 / speed),
        submitted: submitted.as_secs_f64(),
        running: progress.running.as_secs_f64(),
        workers: progress.workers,
        error: progress.relative_error.map(interval),
        version: shared.films.version(progress.job),
        x0: crop.x0,
        y0: crop.y0,
        width: crop.width(),
        height: crop.height(),
        spp: progress.settings.spp,
        seed: progress.settings.seed,
        aim: aim.map(Into::into),
    }
}

/// As page and metrics call it.
pub fn state_name(state: &JobState) -> &'static str {
    match state {
        JobState::Queued => "queued",
        JobState::Running => "running",
        JobState::Finished => "finished",
        JobState::Failed(_) => "failed",
        JobState::Cancelled => "cancelled",
    }
}

fn workers(ledger: &Ledger, mut all: Vec<WorkerStatus>) -> Vec<Worker> {
    if all.len() > WORKERS_SHOWN_MAX {
        all.sort_by_key(|worker| std::cmp::Reverse(worker.samples_done));
        all.truncate(WORKERS_SHOWN_MAX);
        all.sort_by_key(|worker| worker.worker);
    }
    let row = |worker: WorkerStatus| {
        let (trust, offences) = ledger.trust(&worker.info);
        Worker {
            id: worker.worker.number(),
            threads: worker.info.threads,
            leases: worker.leases,
            units: worker.units_done,
            samples: worker.samples_done,
            samples_per_second: worker.samples_per_second,
            silent: worker.silent.as_secs_f64(),
            checked: match trust {
                Trust::Unchecked => "no",
                Trust::Newcomer => "all",
                Trust::Proven => "some",
            },
            offences,
            name: worker.info.name,
            host: worker.info.host,
            cpu: worker.info.cpu,
            isa: worker.info.isa,
        }
    };
    all.into_iter().map(row).collect()
}

fn interval(error: RelativeError) -> [f32; 3] {
    [error.value, error.low, error.high]
}

/// Plain data with text for keys always has a JSON.
fn json(value: &impl Serialize) -> String {
    serde_json::to_string(value).unwrap_or_default()
}
