//! The command line as people write it, and its way into ready values. Nothing below this file sees a flag.

mod cluster;
mod images;
mod launching;
mod manuals;
mod measuring;
mod rendering;
mod replaying;
mod security;
mod values;

use crate::bench::Bench;
use crate::cancel::Cancel;
use crate::certs::Certs;
use crate::compare::Compare;
use crate::coordinator::Coordinator;
use crate::info::Info;
use crate::launch::Launch;
use crate::manual::Manual;
use crate::merge::Merge;
use crate::render::Render;
use crate::replay::Replay;
use crate::report::Style;
use crate::scale::Scale;
use crate::status::Status;
use crate::submit::Submit;
use crate::verify::Verify;
use crate::worker::Worker;
use clap::{Args, Parser, Subcommand};
use cluster::{CancelFlags, CertsFlags, CoordinatorFlags, StatusFlags, SubmitFlags, WorkerFlags};
use images::{InfoFlags, MergeFlags, VerifyFlags};
use launching::LaunchFlags;
use manuals::{CompletionsFlags, ManFlags};
use measuring::{BenchFlags, CompareFlags, ScaleFlags};
use rendering::RenderFlags;
use std::io::IsTerminal;
use tilecast_core::bvh::simd::Isa;
use tilecast_proto::limits::THREADS_MAX;

pub use replaying::quoted;

const EXAMPLES: &str = "\
Examples:
  tilecast render scene.xml --spp 1024 --preview       writes scene.exr and scene.png
  tilecast info scene.xml                              what is in it
  tilecast compare scene.exr reference.exr             how far off it is, and whether chance explains it
`tilecast COMMAND --help` has more, `-h` is short; for shells and `man`: `tilecast completions`, `tilecast man`.";

/// Flags that cannot be meant as they are written, found after clap has read them: the exit code is that of usage errors.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct Usage(pub String);

/// Renders reference images, on one machine or many, the same to the bit.
#[derive(Parser)]
#[command(name = "tilecast", version, max_term_width = 110, after_long_help = EXAMPLES)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

/// What to do, with ready values.
pub enum Task {
    /// `tilecast render`
    Render(Render),
    /// `tilecast render --pixel`
    Replay(Replay),
    /// `tilecast coordinator`
    Coordinator(Coordinator),
    /// `tilecast worker`
    Worker(Worker),
    /// `tilecast submit`
    Submit(Submit),
    /// `tilecast status`
    Status(Status),
    /// `tilecast cancel`
    Cancel(Cancel),
    /// `tilecast launch`
    Launch(Launch),
    /// `tilecast info`
    Info(Info),
    /// `tilecast merge`
    Merge(Merge),
    /// `tilecast scale`
    Scale(Scale),
    /// `tilecast verify`
    Verify(Verify),
    /// `tilecast compare`
    Compare(Compare),
    /// `tilecast bench`
    Bench(Bench),
    /// `tilecast certs init`
    Certs(Certs),
    /// `tilecast completions`, `tilecast man`
    Manual(Manual),
}

#[derive(Subcommand)]
enum Command {
    /// Renders a scene here.
    #[command(after_long_help = rendering::RENDER_EXAMPLES)]
    Render(RenderFlags),
    /// Hands out work to workers, and keeps the images in the making.
    #[command(after_long_help = cluster::CLUSTER_EXAMPLES)]
    Coordinator(CoordinatorFlags),
    /// Traces for a coordinator, for as long as it runs.
    #[command(after_long_help = cluster::CLUSTER_EXAMPLES)]
    Worker(WorkerFlags),
    /// Has a coordinator render a scene, waits, and writes the image.
    #[command(after_long_help = cluster::CLUSTER_EXAMPLES)]
    Submit(SubmitFlags),
    /// Lists a coordinator's jobs and workers.
    #[command(after_long_help = "Example:\n  tilecast status --connect 10.0.0.1:7878")]
    Status(StatusFlags),
    /// Ends a job of a coordinator; what is done of it is dropped.
    #[command(after_long_help = "Example:\n  tilecast cancel --connect 10.0.0.1:7878 4294967297")]
    Cancel(CancelFlags),
    /// Starts workers by what machines already run: Slurm or ssh.
    Launch(LaunchFlags),
    /// Says what is in a scene: shapes, materials, lights, memory, and what was read but has no effect.
    #[command(after_long_help = "Example:\n  tilecast info scenes/cornell-box/scene.xml")]
    Info(InfoFlags),
    /// Says how far an image is from a reference, and whether chance explains it.
    #[command(after_long_help = "Example:\n  tilecast compare image.exr reference.exr --difference difference.png")]
    Compare(CompareFlags),
    /// Measures error against time and samples, and plots it.
    #[command(after_long_help = measuring::BENCH_EXAMPLES)]
    Bench(BenchFlags),
    /// Joins images of the same picture made of different samples, on machines that never met.
    #[command(after_long_help = images::MERGE_EXAMPLES)]
    Merge(MergeFlags),
    /// Measures how much sooner an image is done with more workers, and simulates how it would go on.
    #[command(after_long_help = measuring::SCALE_EXAMPLES)]
    Scale(ScaleFlags),
    /// Renders random parts of an image again, and says whether its bits are what its scene and settings give.
    #[command(after_long_help = "Example:\n  tilecast verify reference.exr scene.xml --share 0.05")]
    Verify(VerifyFlags),
    /// Makes certificates for a cluster beyond loopback.
    #[command(after_long_help = "Example:\n  tilecast certs init certs")]
    Certs(CertsFlags),
    /// Prints what a shell needs to complete tilecast's commands and flags.
    #[command(after_long_help = manuals::COMPLETIONS_EXAMPLES)]
    Completions(CompletionsFlags),
    /// Writes manual pages, one a command.
    #[command(after_long_help = manuals::MAN_EXAMPLES)]
    Man(ManFlags),
}

#[derive(Args)]
pub struct StyleFlags {
    /// Says what happens as JSON on stdout, one object a line
    #[arg(long, conflicts_with = "quiet")]
    json: bool,
    /// Says nothing but errors
    #[arg(long)]
    quiet: bool,
}

#[derive(Args)]
pub struct IsaFlags {
    /// Instruction set to trace with; all give the same bits [default: TILECAST_ISA, or the fastest here]
    #[arg(long, value_name = "NAME", value_parser = values::isa)]
    isa: Option<Isa>,
}

impl Cli {
    /// Ready values for what was asked.
    ///
    /// # Errors
    /// [`Usage`] for flags that do not fit each other or this machine.
    pub fn task(self) -> anyhow::Result<Task> {
        Ok(match self.command {
            Command::Render(flags) => flags.ready()?,
            Command::Coordinator(flags) => Task::Coordinator(flags.ready()?),
            Command::Worker(flags) => Task::Worker(flags.ready()?),
            Command::Submit(flags) => Task::Submit(flags.ready()?),
            Command::Status(flags) => Task::Status(flags.ready()?),
            Command::Cancel(flags) => Task::Cancel(flags.ready()?),
            Command::Launch(flags) => Task::Launch(flags.ready()?),
            Command::Merge(flags) => Task::Merge(flags.ready()?),
            Command::Scale(flags) => Task::Scale(flags.ready()?),
            Command::Verify(flags) => Task::Verify(flags.ready()?),
            Command::Compare(flags) => Task::Compare(flags.ready()),
            Command::Bench(flags) => Task::Bench(flags.ready()?),
            Command::Info(flags) => Task::Info(flags.ready()),
            Command::Certs(flags) => Task::Certs(flags.ready()),
            Command::Completions(flags) => Task::Manual(flags.ready()),
            Command::Man(flags) => Task::Manual(flags.ready()),
        })
    }
}

impl StyleFlags {
    fn ready(&self) -> Style {
        match (self.json, self.quiet) {
            (true, _) => Style::Json,
            (_, true) => Style::Quiet,
            _ if std::io::stderr().is_terminal() => Style::Bar,
            _ => Style::Lines,
        }
    }
}

impl IsaFlags {
    fn ready(self) -> anyhow::Result<Isa> {
        let from_environment = || match std::env::var("TILECAST_ISA") {
            Ok(name) => values::isa(&name).map(Some).map_err(|e| Usage(format!("TILECAST_ISA: {e}"))),
            Err(_) => Ok(None),
        };
        let wanted = self.isa.map_or_else(from_environment, |isa| Ok(Some(isa)))?;
        Ok(wanted.unwrap_or_else(Isa::detect))
    }
}

/// Cores this process may use.
fn cores() -> u32 {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    u32::try_from(cores).unwrap_or(THREADS_MAX).min(THREADS_MAX)
}
