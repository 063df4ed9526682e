//! Renders that end at an error or at a time, not at a number of samples. What to trace next is decided in
//! `tilecast_coordinator::target` and, for times, here; each step is a job of its own.

use crate::follow::{Line, News, Order};
use crate::kept::Kept;
use crate::picture::Ready;
use crate::report::Report;
use anyhow::{Context, bail};
use std::ops::Range;
use std::time::{Duration, Instant};
use tilecast_coordinator::target::{Reached, Search, Step};
use tilecast_core::film::Film;
use tilecast_core::film::file::{Head, Target};
use tilecast_core::film::ranges::Ranges;
use tilecast_core::settings::{SamplerKind, Settings};
use tilecast_proto::types::{Aim, JobSpec};

/// When a render ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Goal {
    /// When every pixel has so many samples.
    Samples,
    /// At an error.
    Error(Target),
    /// After so long.
    Time(Duration),
}

/// The first step of a timed render, in samples a pixel: one for each replicate.
const TIMED_FIRST: u32 = 4;
/// Steps of a timed render grow by so much at the most: the first ones tell little of the pace.
const TIMED_GROWTH: f64 = 8.0;
/// What is left of the time when nothing more is begun, as a part of it.
const TIMED_REST: f64 = 0.01;
/// Steps aim at this part of what is left, so that the last one does not overrun it much.
const TIMED_AIM: f64 = 0.97;

/// Renders to a goal; gives the image's film.
///
/// # Errors
/// Whatever keeps it from being made.
pub async fn seek(
    line: &mut Line<'_, impl AsyncFnMut() -> News>,
    ready: &Ready,
    goal: Goal,
    job: &JobSpec,
    report: &mut Report,
) -> anyhow::Result<Kept> {
    match goal {
        Goal::Samples => {
            let film = line.trace(Order { job: job.clone(), pilot: false }, report).await?;
            let made = Ranges::from_sorted(vec![ready.samples.clone()]).context("there is nothing to render")?;
            Ok(Kept::even(ready.settings.clone(), ready.blobs.digest, film, &made))
        }
        Goal::Error(target) => to_error(line, ready, target, job, report).await,
        Goal::Time(time) => to_time(line, ready, time, job, report).await,
    }
}

async fn to_error(
    line: &mut Line<'_, impl AsyncFnMut() -> News>,
    ready: &Ready,
    target: Target,
    job: &JobSpec,
    report: &mut Report,
) -> anyhow::Result<Kept> {
    if ready.settings.sampler == SamplerKind::SobolZ {
        bail!("the numbers of --sampler sobol-z depend on the number of samples, which an error decides; take sobol");
    }
    let mut search = Search::new(&ready.settings, target)?;
    let (mut before, mut image) = (0, 0);
    while let Some(Step { pilot, settings, tile, samples, expected }) = search.step() {
        report.expect(before as f64, expected);
        let expected = expected.map_or(0, |samples| samples as u64);
        let aim = Some(Aim { target: Some(target), pilot, before, image, expected });
        let job = JobSpec { settings, tile: Some(tile), samples, aim, ..job.clone() };
        let film = line.trace(Order { job, pilot }, report).await?;
        let traced: u64 = film.counts().iter().flatten().map(|&count| u64::from(count)).sum();
        before += traced;
        image += if pilot { 0 } else { traced };
        search.take(film);
    }
    let Reached { film, tiles, settings, .. } = search.reached().context("the search ended without an image")?;
    let head =
        Head { engine: tilecast_core::VERSION.to_owned(), scene: ready.blobs.digest, settings, target: Some(target) };
    Ok(Kept { head, film, tiles })
}

/// Steps that grow; how far each goes is decided by the clock, never by what was seen. The image is an even one.
async fn to_time(
    line: &mut Line<'_, impl AsyncFnMut() -> News>,
    ready: &Ready,
    time: Duration,
    job: &JobSpec,
    report: &mut Report,
) -> anyhow::Result<Kept> {
    if ready.settings.sampler == SamplerKind::SobolZ {
        bail!("the numbers of --sampler sobol-z depend on the number of samples, which a time decides; take sobol");
    }
    let begun = Instant::now();
    let pixels = ready.settings.film.crop.area() as f64;
    let (mut film, mut done, mut next): (Option<Film>, u32, u32) = (None, 0, TIMED_FIRST);
    let mut expected = 0.0;
    loop {
        let settings = Settings { spp: next, ..ready.settings.clone() };
        let range: Range<u32> = done..next;
        let step_begun = Instant::now();
        let before = pixels as u64 * u64::from(done);
        let aim = Some(Aim { target: None, pilot: false, before, image: before, expected: expected as u64 });
        let job = JobSpec { settings: settings.clone(), samples: vec![range], aim, ..job.clone() };
        let more = line.trace(Order { job, pilot: false }, report).await?;
        let seconds_each = step_begun.elapsed().as_secs_f64() / f64::from(next - done);
        let all = match film.take() {
            Some(mut all) => {
                all.join(&more);
                all
            }
            None => more,
        };
        let left = time.saturating_sub(begun.elapsed()).as_secs_f64();
        let fits = (TIMED_AIM * left / seconds_each).min(TIMED_GROWTH * f64::from(next));
        let more = (fits / f64::from(TIMED_FIRST)) as u32 * TIMED_FIRST;
        done = next;
        if more == 0 || left < TIMED_REST * time.as_secs_f64() {
            let mut samples = Ranges::default();
            samples.insert(0..done);
            return Ok(Kept::even(settings, ready.blobs.digest, all, &samples));
        }
        next = done.saturating_add(more);
        expected = pixels * (f64::from(done) + TIMED_AIM * left / seconds_each);
        report.expect(pixels * f64::from(done), Some(expected));
        film = Some(all);
    }
}
