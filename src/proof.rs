//! What is written beside an image for people and programs (`OUT.json`): what it is of, how sure it is, and who made it.

use crate::kept::Kept;
use crate::output::Output;
use crate::report::ErrorFields;
use serde::Serialize;
use std::time::Duration;
use tilecast_core::film::file::Target;
use tilecast_core::settings::Settings;
use tilecast_proto::types::{Contribution, WorkerInfo};

/// See the module.
#[derive(Serialize)]
pub struct Finished<'a> {
    image: String,
    film: Option<String>,
    digest: String,
    scene: String,
    engine: &'a str,
    seed: u64,
    settings: &'a Settings,
    target: Option<Target>,
    samples: String,
    spp: f64,
    #[serde(flatten)]
    error: ErrorFields,
    seconds: f64,
    /// Those who brought something since the coordinator was started last.
    workers: Vec<Worker<'a>>,
}

#[derive(Serialize)]
struct Worker<'a> {
    name: &'a str,
    host: &'a str,
    cpu: &'a str,
    pid: u32,
    isa: &'a str,
    threads: u32,
    units: u64,
    samples: u64,
    /// Spent tracing, over all its threads.
    trace_seconds: f64,
}

impl<'a> Finished<'a> {
    /// An image that took so long.
    pub fn new(kept: &'a Kept, elapsed: Duration, workers: &'a [Contribution], output: &Output) -> Self {
        let head = &kept.head;
        Self {
            image: output.exr.display().to_string(),
            film: output.film.as_ref().map(|path| path.display().to_string()),
            digest: kept.film.digest().to_string(),
            scene: head.scene.to_string(),
            engine: &head.engine,
            seed: head.settings.seed,
            settings: &head.settings,
            target: head.target,
            samples: kept.shown(),
            spp: kept.spp(),
            error: kept.film.relative_error(u64::MAX).into(),
            seconds: elapsed.as_secs_f64(),
            workers: workers.iter().map(worker).collect(),
        }
    }
}

fn worker(contribution: &Contribution) -> Worker<'_> {
    let Contribution { info, units, samples, trace, .. } = contribution;
    let WorkerInfo { threads, isa, host, pid, name, cpu, .. } = info;
    Worker {
        name,
        host,
        cpu,
        pid: *pid,
        isa,
        threads: *threads,
        units: *units,
        samples: *samples,
        trace_seconds: trace.as_secs_f64(),
    }
}
