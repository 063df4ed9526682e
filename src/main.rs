//! The one binary. Reads flags, does what they say, and turns every end into an exit code: 0 done, 1 failed, 2 usage.

mod bench;
mod cancel;
mod certs;
mod children;
mod compare;
mod coordinator;
mod exr;
mod flags;
mod follow;
mod info;
mod kept;
mod launch;
mod manual;
mod memory;
mod merge;
mod output;
mod picture;
mod preview;
mod proof;
mod read;
mod render;
mod replay;
mod report;
mod scale;
mod seek;
mod status;
mod stop;
mod submit;
mod verify;
mod view;
mod worker;

use clap::Parser;
use flags::{Cli, Task, Usage};
use std::io::IsTerminal;
use std::process::ExitCode;
use tilecast_core::load::LoadError;

const FAILED: u8 = 1;
const USAGE: u8 = 2;
/// Serving and watching need little; the tracer has its own threads.
const ASYNC_THREADS: usize = 2;

fn main() -> ExitCode {
    memory::give_back_at_once();
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{}", shown(&error));
            ExitCode::from(if error.is::<Usage>() { USAGE } else { FAILED })
        }
    }
}

fn run() -> anyhow::Result<()> {
    let task = Cli::parse().task()?;
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(ASYNC_THREADS).enable_all().build()?;
    let result = runtime.block_on(perform(task));
    // Whoever still computes works for nobody now.
    runtime.shutdown_background();
    result
}

async fn perform(task: Task) -> anyhow::Result<()> {
    match &task {
        Task::Coordinator(coordinator) => start_log("info", coordinator.log),
        Task::Worker(worker) => start_log("info", worker.log),
        Task::Launch(_) => start_log("info", LogFormat::Text),
        _ => start_log("error", LogFormat::Text),
    }
    match task {
        Task::Render(render) => render::run(render).await,
        Task::Replay(replay) => replay::run(replay).await,
        Task::Coordinator(coordinator) => coordinator::run(coordinator).await,
        Task::Worker(worker) => worker::run(worker).await,
        Task::Submit(submit) => submit::run(submit).await,
        Task::Status(status) => status::run(status).await,
        Task::Cancel(cancel) => cancel::run(cancel).await,
        Task::Launch(launch) => launch::run(launch).await,
        Task::Bench(bench) => bench::run(bench).await,
        Task::Compare(compare) => compare::run(compare).await,
        Task::Merge(merge) => tokio::task::spawn_blocking(move || merge::run(merge)).await?,
        Task::Scale(scale) => scale::run(scale).await,
        Task::Verify(verify) => tokio::task::spawn_blocking(move || verify::run(&verify)).await?,
        Task::Info(info) => info::run(info).await,
        Task::Certs(certs) => certs::run(certs),
        Task::Manual(manual) => manual::run(manual),
    }
}

/// How a log is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum LogFormat {
    /// Lines for people.
    Text,
    /// One object a line.
    Json,
}

/// Logs go to stderr. TILECAST_LOG asks for more or less than a command's usual `level`: `debug`, `tilecast_worker=trace`.
fn start_log(level: &str, format: LogFormat) {
    let filter = tracing_subscriber::EnvFilter::try_from_env("TILECAST_LOG")
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new(level));
    let log = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).with_target(false);
    match format {
        LogFormat::Text => log.with_ansi(std::io::stderr().is_terminal()).init(),
        LogFormat::Json => log.json().flatten_event(true).with_current_span(false).with_span_list(false).init(),
    }
}

/// An error as people read it: one paragraph; with the line at fault where it lies in a scene file.
fn shown(error: &anyhow::Error) -> String {
    match error.downcast_ref::<LoadError>() {
        Some(error) => format!("{:?}", miette::Report::new(error.clone())),
        None => format!("error: {error:#}"),
    }
}
