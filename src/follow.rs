//! A job, from its submission to its film; the same for every coordinator.

use crate::output::Output;
use crate::picture::Ready;
use crate::report::Report;
use crate::stop::Stopped;
use anyhow::{Context, bail};
use std::time::Instant;
use tilecast_proto::client::{Client, Watch};
use tilecast_proto::types::{JobId, JobSpec, JobState, Progress, REPLAY_COMMAND};
use tokio_util::sync::CancellationToken;

/// What those who work for the job have to say.
pub enum News {
    /// Something went wrong that others make up for.
    Warning(String),
    /// Nobody is left to do the job.
    Fatal(anyhow::Error),
}

/// Submits, follows, fetches and writes. `news` is asked for news again and again; asking may be broken off.
///
/// # Errors
/// A refusal, a job that fails, a lost coordinator, a file that cannot be written, or the stop that was asked for.
pub async fn follow(
    client: &Client,
    (ready, job): (&Ready, JobSpec),
    output: &Output,
    report: &mut Report,
    stop: &CancellationToken,
    news: impl AsyncFnMut() -> News,
) -> anyhow::Result<()> {
    let id = client.submit(job).await?;
    let mut watch = client.watch(id).await?;
    report.started(&ready.blobs.digest, &ready.settings, &output.exr);
    let ended = tokio::select! {
        ended = to_end(&mut watch, &ready.replay, report, news) => ended,
        () = stop.cancelled() => Err(Stopped.into()),
    };
    let progress = match ended {
        Ok(progress) => progress,
        Err(error) => {
            // Nobody waits for it any more. If this call is lost too, the job is not the one thing to worry about.
            let _ = client.cancel(id).await;
            return Err(error);
        }
    };
    write(client, id, ready, progress, output, report).await
}

/// Follows a job to its good end.
async fn to_end(
    watch: &mut Watch,
    replay: &str,
    report: &mut Report,
    mut news: impl AsyncFnMut() -> News,
) -> anyhow::Result<Progress> {
    loop {
        let progress = tokio::select! {
            progress = watch.next() => progress.context("lost the coordinator")?,
            told = news() => {
                match told {
                    News::Warning(text) => report.warning(&text),
                    News::Fatal(error) => return Err(error),
                }
                continue;
            }
        };
        let progress = progress.context("the coordinator stopped before the image was complete")?;
        report.progress(&progress);
        match &progress.state {
            JobState::Queued | JobState::Running => {}
            JobState::Finished => return Ok(progress),
            JobState::Failed(why) => {
                bail!("the image cannot be rendered: {}", why.replace(REPLAY_COMMAND, replay))
            }
            JobState::Cancelled => bail!("someone cancelled the job; nothing was written"),
        }
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
    let film = client.film(id).await.context("the finished image could not be fetched")?;
    let (settings, scene, files) = (ready.settings.clone(), ready.blobs.digest, output.clone());
    let digest = tokio::task::spawn_blocking(move || {
        files.write(&film, &settings, &scene)?;
        anyhow::Ok(film.digest())
    });
    let digest = digest.await.context("writing the image panicked")??;
    progress.elapsed += begun.elapsed();
    report.finished(&progress, &digest, &output.exr);
    Ok(())
}
