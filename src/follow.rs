//! A job, from its submission to its film; the same for every coordinator.

use crate::kept::Kept;
use crate::output::Output;
use crate::picture::Ready;
use crate::report::Report;
use crate::stop::Stopped;
use anyhow::{Context, anyhow, bail};
use backon::{BackoffBuilder, ExponentialBackoff, ExponentialBuilder};
use std::time::{Duration, Instant};
use tilecast_core::film::Film;
use tilecast_core::film::ranges::Ranges;
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
    /// Its number, if it was submitted before.
    pub known: Option<JobId>,
    /// Whether the job is to stay when nobody waits for it any more.
    pub keep: bool,
}

/// Submits, or goes on with a job that was submitted before, follows, fetches and writes. `news` is asked for news again and again; asking may be broken off.
///
/// # Errors
/// A refusal, a job that fails, a lost coordinator, a file that cannot be written, or the stop that was asked for.
pub async fn follow(
    client: &Client,
    ready: &Ready,
    order: Order,
    output: &Output,
    report: &mut Report,
    stop: &CancellationToken,
    news: impl AsyncFnMut() -> News,
) -> anyhow::Result<JobId> {
    let id = match order.known {
        Some(id) => id,
        None => client.submit(order.job).await?,
    };
    report.started(ready, &output.exr);
    let ended = tokio::select! {
        ended = to_end(client, id, ready, report, news) => ended,
        () = stop.cancelled() => Err(Stopped.into()),
    };
    let progress = match ended {
        Ok(progress) => progress,
        Err(error) if order.keep && error.is::<Stopped>() => {
            return Err(
                error.context("what is done is kept in the folder of --state; the same command goes on with it")
            );
        }
        Err(error) => {
            // Nobody waits for it any more. If this call is lost too, the job is not the one thing to worry about.
            let _ = client.cancel(id).await;
            return Err(error);
        }
    };
    write(client, id, ready, progress, output, report).await?;
    Ok(id)
}

/// Follows a job to its good end. A coordinator that goes away is waited for: one with a state goes on when it is started
/// again.
async fn to_end(
    client: &Client,
    id: JobId,
    ready: &Ready,
    report: &mut Report,
    mut news: impl AsyncFnMut() -> News,
) -> anyhow::Result<Progress> {
    let mut following = Following { client, id, watch: None, delays: None };
    loop {
        let progress = tokio::select! {
            progress = following.next() => match progress {
                Ok(progress) => progress,
                Err(Lost::ForGood(error)) => return Err(error),
                Err(Lost::ForNow(why)) => {
                    report.warning(&format!("lost the coordinator ({why}); waiting for it"));
                    continue;
                }
            },
            told = news() => {
                match told {
                    News::Warning(text) => report.warning(&text),
                    News::Fatal(error) => return Err(error),
                }
                continue;
            }
        };
        if progress.scene != ready.blobs.digest || progress.settings != ready.settings {
            bail!("job {id} is another one now: the coordinator was replaced; submit again, to one with --state");
        }
        report.progress(&progress);
        match &progress.state {
            JobState::Queued | JobState::Running => {}
            JobState::Finished => return Ok(progress),
            JobState::Failed(why) => {
                bail!("the image cannot be rendered: {}", why.replace(REPLAY_COMMAND, &ready.replay))
            }
            JobState::Cancelled => bail!("someone cancelled the job; nothing was written"),
        }
    }
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

async fn write(
    client: &Client,
    id: JobId,
    ready: &Ready,
    mut progress: Progress,
    output: &Output,
    report: &mut Report,
) -> anyhow::Result<()> {
    let begun = Instant::now();
    let film = fetch(client, id).await.context("the finished image could not be fetched")?;
    let (settings, scene, files) = (ready.settings.clone(), ready.blobs.digest, output.clone());
    let (samples, base) = (ready.samples.clone(), ready.base.clone());
    let written = tokio::task::spawn_blocking(move || {
        let made = Ranges::from_sorted(vec![samples]).context("there is nothing to render")?;
        let mut kept = Kept::even(settings, scene, film, &made);
        if let Some(base) = base {
            kept.join(Kept::clone(&base), ["the image", "what is gone on with"])?;
        }
        files.write(&kept)?;
        anyhow::Ok(kept)
    });
    let kept = written.await.context("writing the image panicked")??;
    progress.elapsed += begun.elapsed();
    report.written(&kept, progress.elapsed, Some(&progress), &output.exr);
    Ok(())
}
