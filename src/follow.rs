//! A job, from its submission to its film; the same for every coordinator.

use crate::kept::Kept;
use crate::output::Output;
use crate::picture::Ready;
use crate::proof::Finished;
use crate::report::Report;
use crate::seek::{Goal, seek};
use crate::stop::Stopped;
use anyhow::{Context, anyhow, bail};
use backon::{BackoffBuilder, ExponentialBackoff, ExponentialBuilder};
use std::hash::{BuildHasher, RandomState};
use std::time::{Duration, Instant};
use tilecast_core::film::{Film, RelativeError};
use tilecast_core::scene::Digest;
use tilecast_core::settings::Settings;
use tilecast_proto::client::{Client, ClientError, Watch};
use tilecast_proto::types::{JobId, JobSpec, JobState, Progress, REPLAY_COMMAND};
use tokio_util::sync::CancellationToken;
use tonic::Code;

/// The first wait for a coordinator that is gone; it doubles up to [`RETRY_MAX`].
const RETRY_MIN: Duration = Duration::from_millis(100);
/// The longest.
const RETRY_MAX: Duration = Duration::from_secs(3);

/// What those who work for the job have to say.
pub enum News {
    /// Something went wrong that others make up for.
    Warning(String),
    /// Nobody is left to do the job.
    Fatal(anyhow::Error),
}

/// What to ask of a coordinator.
pub struct Order {
    /// What is wanted.
    pub job: JobSpec,
    /// Whether it is no part of the image.
    pub pilot: bool,
}

/// The line to a coordinator, over which an image is made, in one job or several.
pub struct Line<'a, N> {
    /// The coordinator.
    pub client: &'a Client,
    /// What is rendered.
    pub ready: &'a Ready,
    /// Where to.
    pub output: &'a Output,
    /// Whether jobs outlive whoever waits for them: those that are known already are gone on with.
    pub keep: bool,
    /// Ends the waiting.
    pub stop: &'a CancellationToken,
    /// Asked for news again and again; asking may be broken off.
    pub news: N,
    /// Jobs so far.
    pub jobs: Vec<JobId>,
    /// The last one's.
    pub progress: Option<Progress>,
    /// Whether refreshed pictures are wanted, and the error that the last one had.
    shown: Option<RelativeError>,
}

/// Renders to a goal, and writes the image. Gives the numbers of the jobs that it took.
///
/// # Errors
/// A refusal, a job that fails, a lost coordinator, a file that cannot be written, or the stop that was asked for.
pub async fn follow(
    mut line: Line<'_, impl AsyncFnMut() -> News>,
    goal: Goal,
    job: JobSpec,
    report: &mut Report,
) -> anyhow::Result<Vec<JobId>> {
    let begun = Instant::now();
    report.started(line.ready, goal, &line.output.exr);
    let ready = line.ready;
    let kept = seek(&mut line, ready, goal, &job, report).await?;
    let (base, files) = (line.ready.base.clone(), line.output.clone());
    let written = tokio::task::spawn_blocking(move || {
        let mut kept = kept;
        if let Some(base) = base {
            kept.join(Kept::clone(&base), ["the image", "what is gone on with"])?;
        }
        files.write(&kept)?;
        anyhow::Ok(kept)
    });
    let kept = written.await.context("writing the image panicked")??;
    // A coordinator that was replaced meanwhile does not know; the image is there all the same.
    let workers = line.client.contributions(&line.jobs).await.unwrap_or_default();
    let proof = Finished::new(&kept, begun.elapsed(), &workers, line.output);
    line.output.write_proof(&proof)?;
    report.written(&kept, begun.elapsed(), line.progress.as_ref(), &line.output.exr);
    Ok(line.jobs)
}

impl<'a, N: AsyncFnMut() -> News> Line<'a, N> {
    /// A line on which nothing was asked yet.
    pub fn new(client: &'a Client, ready: &'a Ready, output: &'a Output, stop: &'a CancellationToken, news: N) -> Self {
        Self { client, ready, output, keep: false, stop, news, jobs: Vec::new(), progress: None, shown: None }
    }

    /// Has one job done; gives its film.
    ///
    /// # Errors
    /// See [`follow`].
    pub async fn trace(&mut self, mut order: Order, report: &mut Report) -> anyhow::Result<Film> {
        let known = if self.keep {
            order.job.name = name(&order.job);
            begun(self.client, &order.job).await?
        } else {
            None
        };
        let settings = order.job.settings.clone();
        let id = match known {
            Some(id) => id,
            None => self.hand_over(order.job, report).await?,
        };
        self.jobs.push(id);
        let stop = self.stop.clone();
        let ended = tokio::select! {
            ended = self.until_end(id, (&settings, order.pilot), report) => ended,
            () = stop.cancelled() => Err(Stopped.into()),
        };
        match ended {
            Ok(progress) => self.progress = Some(progress),
            Err(error) if self.keep && error.is::<Stopped>() => {
                return Err(
                    error.context("what is done is kept in the folder of --state; the same command goes on with it")
                );
            }
            Err(error) => {
                // Nobody waits for it any more. If this call is lost too, the job is not the one thing to worry about.
                let _ = self.client.cancel(id).await;
                return Err(error);
            }
        }
        fetch(self.client, id).await.context("the finished image could not be fetched")
    }

    /// Queues a job, at a coordinator that may go away meanwhile, or have taken it without saying so: its ticket tells.
    async fn hand_over(&mut self, job: JobSpec, report: &mut Report) -> anyhow::Result<JobId> {
        let job = JobSpec { ticket: RandomState::new().hash_one(std::process::id()).max(1), ..job };
        let mut delays = backoff();
        loop {
            match self.client.submit(job.clone()).await {
                Ok(id) => return Ok(id),
                Err(ClientError::Call(status)) if is_lost(status.code()) => {}
                Err(ClientError::Connect(_)) => {}
                Err(error) => return Err(error.into()),
            }
            tokio::select! {
                () = tokio::time::sleep(delays.next().unwrap_or(RETRY_MAX)) => {}
                () = self.stop.cancelled() => return Err(Stopped.into()),
                told = (self.news)() => match told {
                    News::Warning(text) => report.warning(&text),
                    News::Fatal(error) => return Err(error),
                },
            }
        }
    }

    /// Follows a job to its good end. A coordinator that goes away is waited for: one with a state goes on when it is started
    /// again.
    async fn until_end(
        &mut self,
        id: JobId,
        (settings, pilot): (&Settings, bool),
        report: &mut Report,
    ) -> anyhow::Result<Progress> {
        let mut following = Following { client: self.client, id, watch: None, delays: None };
        loop {
            let mut progress = tokio::select! {
                progress = following.next() => match progress {
                    Ok(progress) => progress,
                    Err(Lost::ForGood(error)) => return Err(error),
                    Err(Lost::ForNow(why)) => {
                        report.warning(&format!("lost the coordinator ({why}); waiting for it"));
                        continue;
                    }
                },
                told = (self.news)() => {
                    match told {
                        News::Warning(text) => report.warning(&text),
                        News::Fatal(error) => return Err(error),
                    }
                    continue;
                }
            };
            if progress.scene != self.ready.blobs.digest || progress.settings != *settings {
                bail!("job {id} is another one now: the coordinator was replaced; submit again, to one with --state");
            }
            if pilot {
                // It says nothing of the image's error.
                progress.relative_error = None;
            }
            report.progress(&progress);
            self.refresh(id, &progress).await?;
            match &progress.state {
                JobState::Queued | JobState::Running => {}
                JobState::Finished => return Ok(progress),
                JobState::Failed(why) => {
                    bail!("the image cannot be rendered: {}", why.replace(REPLAY_COMMAND, &self.ready.replay))
                }
                JobState::Cancelled => bail!("someone cancelled the job; nothing was written"),
            }
        }
    }

    /// Writes what there is, where that is wanted and another round is done.
    async fn refresh(&mut self, id: JobId, progress: &Progress) -> anyhow::Result<()> {
        let error = progress.relative_error.filter(|_| self.output.refreshed && !progress.state.is_final());
        if error.is_none() || error == self.shown {
            return Ok(());
        }
        self.shown = error;
        let film = fetch(self.client, id).await?;
        let (settings, scene, files) = (progress.settings.clone(), progress.scene, self.output.clone());
        let base = self.ready.base.clone();
        let written = tokio::task::spawn_blocking(move || {
            let mut film = film;
            if let Some(base) = base {
                film.join(&base.film);
            }
            files.refresh(&Kept::in_the_making(settings, scene, film))
        });
        written.await.context("writing the picture panicked")?
    }
}

/// What a job is called where it may be gone on with: its samples are part of what it is.
fn name(job: &JobSpec) -> String {
    let bytes: Vec<u8> =
        job.samples.iter().flat_map(|range| [range.start.to_le_bytes(), range.end.to_le_bytes()]).flatten().collect();
    let start = job.samples.iter().map(|range| range.start).min().unwrap_or(0);
    let end = job.samples.iter().map(|range| range.end).max().unwrap_or(0);
    format!("samples {start}..{end}, {}", Digest::of(&bytes))
}

/// The job in the coordinator's state that is this one, begun before.
async fn begun(client: &Client, job: &JobSpec) -> anyhow::Result<Option<JobId>> {
    let mut known = None;
    for other in client.jobs().await? {
        let same = other.scene == job.scene && other.settings == job.settings && other.name == job.name;
        match other.state {
            JobState::Queued | JobState::Running | JobState::Finished if same => known = Some(other.job),
            JobState::Queued | JobState::Running => bail!(
                "the folder of --state holds another render ({}, seed {}, {} spp) that is not done: finish it with the command \
                 it was begun with, or name another folder",
                other.name,
                other.settings.seed,
                other.settings.spp
            ),
            JobState::Finished | JobState::Failed(_) | JobState::Cancelled => {}
        }
    }
    Ok(known)
}

/// A job's events, over as many connections as it takes.
struct Following<'a> {
    client: &'a Client,
    id: JobId,
    watch: Option<Watch>,
    /// How long to wait for a coordinator that is gone.
    delays: Option<ExponentialBackoff>,
}

/// A watch that has ended.
enum Lost {
    /// The coordinator will not have the job again.
    ForGood(anyhow::Error),
    /// It may come back; told once.
    ForNow(String),
}

impl Following<'_> {
    /// The next event. Asking may be broken off.
    async fn next(&mut self) -> Result<Progress, Lost> {
        loop {
            let event = match &mut self.watch {
                Some(watch) => watch.next().await,
                None => match self.client.watch(self.id).await {
                    Ok(watch) => {
                        self.watch = Some(watch);
                        continue;
                    }
                    Err(error) => Err(error),
                },
            };
            let why = match event {
                Ok(Some(progress)) => {
                    self.delays = None;
                    return Ok(progress);
                }
                Ok(None) => "it stopped".to_owned(),
                Err(ClientError::Call(status)) if status.code() == Code::NotFound => {
                    let lost =
                        anyhow!("{}; a coordinator keeps jobs over restarts if it has --state", status.message());
                    return Err(Lost::ForGood(
                        lost.context("the coordinator was replaced by one that does not know the job"),
                    ));
                }
                Err(ClientError::Call(status)) if is_final(status.code()) => {
                    return Err(Lost::ForGood(anyhow!(ClientError::Call(status))));
                }
                Err(error) => error.to_string(),
            };
            self.watch = None;
            let first = self.delays.is_none();
            if first {
                self.delays = Some(backoff());
                return Err(Lost::ForNow(why));
            }
            let delay = self.delays.as_mut().and_then(Iterator::next).unwrap_or(RETRY_MAX);
            tokio::time::sleep(delay).await;
        }
    }
}

fn backoff() -> ExponentialBackoff {
    let backoff = ExponentialBuilder::default().with_min_delay(RETRY_MIN).with_max_delay(RETRY_MAX);
    backoff.with_jitter().without_max_times().build()
}

/// Whether trying again will not help.
fn is_final(code: Code) -> bool {
    matches!(code, Code::PermissionDenied | Code::Unauthenticated | Code::InvalidArgument | Code::FailedPrecondition)
}

/// Whether a connection broke, as opposed to an answer.
fn is_lost(code: Code) -> bool {
    matches!(code, Code::Unavailable | Code::Unknown | Code::Cancelled | Code::DeadlineExceeded)
}

/// The film, from a coordinator that may go away meanwhile.
async fn fetch(client: &Client, id: JobId) -> anyhow::Result<Film> {
    let mut delays = backoff();
    loop {
        match client.film(id).await {
            Ok(film) => return Ok(film),
            Err(ClientError::Call(status)) if status.code() != Code::NotFound && !is_final(status.code()) => {}
            Err(ClientError::Connect(_)) => {}
            Err(error) => return Err(error.into()),
        }
        tokio::time::sleep(delays.next().unwrap_or(RETRY_MAX)).await;
    }
}
