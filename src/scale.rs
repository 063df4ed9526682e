//! `tilecast scale`: the same job with more and more workers; how much sooner it is done, where the time went, and how it would go
//! on with more workers than there are.

mod table;

use crate::picture::{Picture, Ready};
use crate::render::Cluster;
use crate::report::{Report, Style};
use crate::stop::{on_signal, unless_stopped};
use crate::view::Lookers;
use anyhow::{Context, bail};
use std::num::NonZeroU32;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};
use table::{Beyond, Row, Sheet};
use tilecast_coordinator::scaling::{Costs, simulate};
use tilecast_core::bvh::simd::Isa;
use tilecast_core::film::sums;
use tilecast_core::scene::{Digest, Scene};
use tilecast_core::settings::Window;
use tilecast_core::trace::Tracer;
use tilecast_core::world::World;
use tilecast_proto::client::Client;
use tilecast_proto::limits::TILE_SIDE_DEFAULT;
use tilecast_proto::transport::Connector;
use tilecast_proto::types::{JobId, JobSpec, JobState, Progress};
use tokio_util::sync::CancellationToken;

/// Samples a pixel of the job that makes every worker compile the scene before anything is measured.
const WARM_UP_SPP: u32 = 4;
/// Its tiles are small, so that there is something for everyone.
const WARM_UP_TILE: u32 = 8;
/// So often it is tried that all workers get something of it; then the rest is taken as it is.
const WARM_UPS_MAX: usize = 20;
/// Pieces whose pace is measured, along a side in pixels, and samples a pixel for that.
const PROBE_SIDE: u32 = 32;
const PROBE_SPP: u32 = 2;
/// Calls of which the median time is taken.
const CALLS: usize = 21;
/// Bytes a second between processes of one machine: far more than a job needs.
const LOOPBACK: f64 = 2e9;

/// What to measure.
pub struct Scale {
    /// What is rendered.
    pub picture: Picture,
    /// Numbers of workers; none is all of those elsewhere.
    pub workers: Vec<Option<NonZeroU32>>,
    /// Threads of each.
    pub threads: u32,
    /// Renders with each number.
    pub repeats: u32,
    /// The most workers to simulate, if any.
    pub simulate: Option<u32>,
    /// Megabytes a second of the coordinator's line in the simulation.
    pub line: f64,
    /// Workers elsewhere instead of processes here.
    pub connector: Option<Connector>,
    /// Instruction set.
    pub isa: Isa,
    /// Beginning of the names of what is written.
    pub out: PathBuf,
    /// How it tells of itself.
    pub style: Style,
}

/// One render.
struct Run {
    workers: u32,
    digest: Digest,
    seconds: f64,
    /// Seconds of threads.
    tracing: f64,
    start: f64,
    tail: f64,
    /// Of the coordinator.
    merging: f64,
    units: u64,
    call: f64,
    bytes_pixel: f64,
}

/// Measures, and writes what was measured.
///
/// # Errors
/// A render that fails, digests that differ, or a file that cannot be written.
pub async fn run(scale: Scale) -> anyhow::Result<()> {
    let stop = on_signal()?;
    let mut report = Report::new(scale.style);
    let picture = scale.picture.clone();
    let load = tokio::task::spawn_blocking(move || picture.load());
    let (scene, ready) = unless_stopped(&stop, load).await?.context("loading panicked")??;
    ready.tell(&mut report);
    let scene = Arc::new(scene);
    let mut runs: Vec<Run> = Vec::new();
    for repeat in 0..scale.repeats {
        for &workers in &scale.workers {
            let run = unless_stopped(&stop, once(&scale, &scene, &ready, workers, &stop)).await??;
            report.note(&format!(
                "repeat {} of {}: {} workers, {:.2} s",
                repeat + 1,
                scale.repeats,
                run.workers,
                run.seconds
            ));
            if let Some(first) = runs.first().filter(|first| first.digest != run.digest) {
                bail!("the image with {} workers has another digest than with {}", run.workers, first.workers);
            }
            runs.push(run);
        }
    }
    let probe = tokio::task::spawn_blocking(move || probe(&scene, &ready, scale.isa).map(|tiles| (tiles, ready)));
    let (tiles, ready) = unless_stopped(&stop, probe).await?.context("probing the picture panicked")??;
    let sheet = sheet(&scale, &ready, &runs, &tiles);
    sheet.write(&scale.out)?;
    println!("{}", sheet.markdown());
    Ok(())
}

/// Starts workers, or takes those that there are, and renders once.
async fn once(
    scale: &Scale,
    scene: &Arc<Scene>,
    ready: &Ready,
    workers: Option<NonZeroU32>,
    stop: &CancellationToken,
) -> anyhow::Result<Run> {
    if let Some(connector) = &scale.connector {
        let client = Client::connect(connector).await?;
        let there = client.workers().await?.len();
        if let Some(workers) = workers.filter(|workers| workers.get() as usize > there) {
            bail!("--workers {workers}: the coordinator has {there}; start more, or give a smaller number");
        }
        return measure(&client, scene, ready, workers).await;
    }
    let workers = workers.map_or(1, NonZeroU32::get);
    let cluster = Cluster::processes(workers, scale.threads, scale.isa, None, Lookers::default()).await?;
    let result = async {
        let client = Client::connect(&cluster.connector).await?;
        while client.workers().await?.len() < workers as usize {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        measure(&client, scene, ready, None).await
    };
    let result = unless_stopped(stop, result).await;
    cluster.end().await;
    result?
}

/// Renders once by so many workers, or by all that there are, warmed up.
async fn measure(
    client: &Client,
    scene: &Arc<Scene>,
    ready: &Ready,
    workers: Option<NonZeroU32>,
) -> anyhow::Result<Run> {
    client.upload(scene, &ready.blobs).await?;
    let job = |spp: u32, tile: Option<u32>, workers_max: Option<NonZeroU32>| {
        let mut settings = ready.settings.clone();
        settings.spp = spp;
        JobSpec { tile, name: "scale".to_owned(), workers_max, ..JobSpec::new(ready.blobs.digest, settings) }
    };
    // All must have worked before: who comes late has its scene compiled in the time that is measured.
    for _ in 0..WARM_UPS_MAX {
        let (id, _) = done(client, job(WARM_UP_SPP, Some(WARM_UP_TILE), None)).await?;
        let worked = client.contributions(&[id]).await?.into_iter().filter(|one| one.units > 0).count();
        if worked >= client.workers().await?.len() {
            break;
        }
    }
    let mut calls = Vec::new();
    for _ in 0..CALLS {
        let begun = Instant::now();
        client.workers().await?;
        calls.push(begun.elapsed().as_secs_f64());
    }
    let (id, progress) = done(client, job(ready.settings.spp, None, workers)).await?;
    let film = client.film(id).await?;
    let contributions = client.contributions(&[id]).await?;
    let seconds = progress.elapsed.as_secs_f64();
    let of = |each: &dyn Fn(&tilecast_proto::types::Contribution) -> f64| contributions.iter().map(each).sum::<f64>();
    Ok(Run {
        workers: contributions.iter().map(|one| one.info.threads).sum(),
        digest: film.digest(),
        seconds,
        tracing: of(&|one| one.trace.as_secs_f64()),
        start: of(&|one| f64::from(one.info.threads) * one.first.as_secs_f64()),
        tail: of(&|one| f64::from(one.info.threads) * (seconds - one.last.as_secs_f64()).max(0.0)),
        merging: progress.merging.as_secs_f64(),
        units: contributions.iter().map(|one| one.units).sum(),
        call: median(calls),
        bytes_pixel: sums::encode(film.sums()).len() as f64 / film.window.area() as f64,
    })
}

/// Has a job done.
async fn done(client: &Client, job: JobSpec) -> anyhow::Result<(JobId, Progress)> {
    let id = client.submit(job).await?;
    let mut watch = client.watch(id).await?;
    while let Some(progress) = watch.next().await? {
        match progress.state {
            JobState::Queued | JobState::Running => {}
            JobState::Finished => return Ok((id, progress)),
            JobState::Failed(why) => bail!("the image cannot be rendered: {why}"),
            JobState::Cancelled => bail!("someone cancelled the job"),
        }
    }
    bail!("the coordinator has ended");
}

/// The pace of pieces of the picture, in seconds a sample, up to a factor.
fn probe(scene: &Scene, ready: &Ready, isa: Isa) -> anyhow::Result<Vec<(Window, f64)>> {
    let tracer = Tracer::new(Arc::new(World::compile(scene)), ready.settings.clone(), isa)?;
    let crop = ready.settings.film.crop;
    let steps = |from: u32, to: u32| (from..to).step_by(PROBE_SIDE as usize);
    let mut tiles = Vec::new();
    for (y0, x0) in steps(crop.y0, crop.y1).flat_map(|y| steps(crop.x0, crop.x1).map(move |x| (y, x))) {
        let tile = Window { x0, y0, x1: crop.x1.min(x0 + PROBE_SIDE), y1: crop.y1.min(y0 + PROBE_SIDE) };
        let begun = Instant::now();
        tracer.trace(tile, 0..PROBE_SPP, &AtomicBool::new(false))?;
        let samples = tile.area() as f64 * f64::from(PROBE_SPP);
        tiles.push((tile, begun.elapsed().as_secs_f64() / samples));
    }
    Ok(tiles)
}

/// What was measured, row by row, and what is simulated from it.
fn sheet(scale: &Scale, ready: &Ready, runs: &[Run], tiles: &[(Window, f64)]) -> Sheet {
    let mut counts: Vec<u32> = runs.iter().map(|run| run.workers).collect();
    counts.sort_unstable();
    counts.dedup();
    let crop = ready.settings.film.crop;
    let pixels = crop.area() as f64;
    let rows: Vec<(Row, Costs)> = counts
        .iter()
        .map(|&workers| {
            let of = |value: &dyn Fn(&Run) -> f64| {
                median(runs.iter().filter(|run| run.workers == workers).map(value).collect())
            };
            let tracing = of(&|run| run.tracing);
            let probed: f64 = tiles.iter().map(|(tile, sample)| tile.area() as f64 * sample).sum();
            let factor = tracing / (probed * f64::from(ready.settings.spp));
            let unit_pixels = f64::from(TILE_SIDE_DEFAULT).powi(2).min(pixels);
            let costs = Costs {
                tiles: tiles.iter().map(|(tile, sample)| (*tile, sample * factor)).collect(),
                sample: tracing / (pixels * f64::from(ready.settings.spp)),
                call: of(&|run| run.call),
                merge_pixel: of(&|run| run.merging / (run.units as f64 * unit_pixels)),
                merge_threads: 1,
                bytes_pixel: of(&|run| run.bytes_pixel),
                line: LOOPBACK,
            };
            let simulated = simulate(&spec(ready), workers, &costs).map(|simulated| simulated.seconds);
            let total = f64::from(workers) * of(&|run| run.seconds);
            let row = Row {
                workers,
                seconds: of(&|run| run.seconds),
                tracing: tracing / total,
                start: of(&|run| run.start) / total,
                tail: of(&|run| run.tail) / total,
                merging: of(&|run| run.merging),
                units: of(&|run| run.units as f64),
                simulated,
            };
            (row, costs)
        })
        .collect();
    let beyond = rows.last().map_or_else(Vec::new, |(_, costs)| beyond(scale, ready, &counts, costs));
    let digest = runs.first().map_or_else(String::new, |run| run.digest.to_string());
    let title = format!(
        "{}, {}x{} pixels, {} samples each",
        scale.picture.scene.display(),
        crop.width(),
        crop.height(),
        ready.settings.spp
    );
    Sheet {
        title,
        digest,
        repeats: scale.repeats,
        line: scale.line,
        rows: rows.into_iter().map(|r| r.0).collect(),
        beyond,
    }
}

/// More workers than there are, in powers of two.
fn beyond(scale: &Scale, ready: &Ready, counts: &[u32], costs: &Costs) -> Vec<Beyond> {
    let (Some(limit), Some(&most)) = (scale.simulate, counts.last()) else { return Vec::new() };
    let costs = Costs { line: scale.line * 1e6, ..costs.clone() };
    let doubled = std::iter::successors(most.checked_mul(2), |n| n.checked_mul(2)).take_while(|&n| n < limit);
    doubled
        .chain((limit > most).then_some(limit))
        .filter_map(|workers| simulate(&spec(ready), workers, &costs).map(|simulated| Beyond { workers, simulated }))
        .collect()
}

fn spec(ready: &Ready) -> JobSpec {
    JobSpec::new(ready.blobs.digest, ready.settings.clone())
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}
