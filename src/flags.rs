//! The command line as people write it, and its way into ready values. Nothing below this file sees a flag.

mod measuring;
mod replaying;
mod security;
mod values;

use crate::bench::Bench;
use crate::cancel::Cancel;
use crate::certs::Certs;
use crate::compare::Compare;
use crate::coordinator::Coordinator;
use crate::info::Info;
use crate::merge::Merge;
use crate::output::Output;
use crate::picture::{Overrides, Picture};
use crate::render::{Backend, Render};
use crate::replay::Replay;
use crate::report::Style;
use crate::scale::Scale;
use crate::seek::Goal;
use crate::status::Status;
use crate::submit::Submit;
use crate::verify::Verify;
use crate::worker::Worker;
use anyhow::Context;
use clap::{Args, Parser, Subcommand};
use measuring::{BenchFlags, CompareFlags, ScaleFlags};
use security::{ConnectFlags, GuardFlags};
use std::io::IsTerminal;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tilecast_coordinator::access::Role;
use tilecast_core::bvh::simd::Isa;
use tilecast_core::film::file::Target;
use tilecast_core::settings::Window;
use tilecast_proto::limits::{THREADS_MAX, TILE_SIDE_MAX};
use values::{IntegratorName, SamplerName, SavingName, StrategyName};

/// Flags that cannot be meant as they are written, found after clap has read them: the exit code is that of usage errors.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct Usage(pub String);

/// Renders reference images, on one machine or many, the same to the bit.
#[derive(Parser)]
#[command(name = "tilecast", version, max_term_width = 110)]
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
}

#[derive(Subcommand)]
enum Command {
    /// Renders a scene here.
    #[command(after_help = RENDER_EXAMPLES)]
    Render(RenderFlags),
    /// Hands out work to workers, and keeps the images in the making.
    #[command(after_help = CLUSTER_EXAMPLES)]
    Coordinator(CoordinatorFlags),
    /// Traces for a coordinator, for as long as it runs.
    #[command(after_help = CLUSTER_EXAMPLES)]
    Worker(WorkerFlags),
    /// Has a coordinator render a scene, waits, and writes the image.
    #[command(after_help = CLUSTER_EXAMPLES)]
    Submit(SubmitFlags),
    /// Lists a coordinator's jobs and workers.
    #[command(after_help = "Example:\n  tilecast status --connect 10.0.0.1:7878")]
    Status(StatusFlags),
    /// Ends a job of a coordinator; what is done of it is dropped.
    #[command(after_help = "Example:\n  tilecast cancel --connect 10.0.0.1:7878 4294967297")]
    Cancel(CancelFlags),
    /// Says what is in a scene: shapes, materials, lights, memory, and what was read but has no effect.
    #[command(after_help = "Example:\n  tilecast info scenes/cornell-box/scene.xml")]
    Info(InfoFlags),
    /// Says how far an image is from a reference, and whether chance explains it.
    #[command(after_help = "Example:\n  tilecast compare image.exr reference.exr --difference difference.png")]
    Compare(CompareFlags),
    /// Measures error against time and samples, and plots it.
    #[command(after_help = measuring::BENCH_EXAMPLES)]
    Bench(BenchFlags),
    /// Joins images of the same picture made of different samples, on machines that never met.
    #[command(after_help = MERGE_EXAMPLES)]
    Merge(MergeFlags),
    /// Measures how much sooner an image is done with more workers, and simulates how it would go on.
    #[command(after_help = measuring::SCALE_EXAMPLES)]
    Scale(ScaleFlags),
    /// Renders random parts of an image again, and says whether its bits are what its scene and settings give.
    #[command(after_help = "Example:\n  tilecast verify reference.exr scene.xml --share 0.05")]
    Verify(VerifyFlags),
    /// Makes certificates for a cluster beyond loopback.
    #[command(after_help = "Example:\n  tilecast certs init certs")]
    Certs(CertsFlags),
}

const RENDER_EXAMPLES: &str = "\
Examples:
  tilecast render scene.xml                              writes scene.exr
  tilecast render scene.xml --spp 4096 -o reference.exr  a quieter one
  tilecast render scene.xml --resume reference.exr --spp 65536   goes on with it: the bits of a fresh one
  tilecast render scene.xml -D albedo=0.8 --preview      sets a <default>; also writes scene.png
  tilecast render scene.xml --strategy cosine --spp 16   where directions come from
  tilecast render model.obj --size 640x480               a bare model, under an even sky
  tilecast render scene.xml --crop 100,100,164,164       a part: the same bits as in the whole
  tilecast render scene.xml --workers 4                  four worker processes: the same bits
  tilecast render scene.xml --pixel 12,34 --sample 5     the path of one sample, vertex by vertex";

const MERGE_EXAMPLES: &str = "\
Example: half of the samples on each of two machines
  tilecast render scene.xml --samples 0..2048 -o a.exr
  tilecast render scene.xml --samples 2048..4096 -o b.exr
  tilecast merge a.film b.film -o image.exr              the bits of --spp 4096";

const CLUSTER_EXAMPLES: &str = "\
A cluster in three commands:
  tilecast coordinator --listen 127.0.0.1:7878           one of these
  tilecast worker --connect 127.0.0.1:7878               as many as you like
  tilecast submit scene.xml --connect 127.0.0.1:7878     writes scene.exr
Beyond this machine, all three with certificates from `tilecast certs init certs`:
  tilecast coordinator --listen 0.0.0.0:7878 --certs certs --state state
  tilecast worker --connect 10.0.0.1:7878 --certs certs
  tilecast submit scene.xml --connect 10.0.0.1:7878 --certs certs";

/// The scene, and how it is rendered.
#[derive(Args)]
pub struct PictureFlags {
    /// Mitsuba 3 XML, or a bare Wavefront OBJ
    scene: PathBuf,
    /// Sets a value that the scene names $NAME, above its own default
    #[arg(short = 'D', value_name = "NAME=VALUE", value_parser = values::define)]
    defines: Vec<(String, String)>,
    /// Replaces or leaves out what tilecast does not have, and lists it, instead of failing
    #[arg(long)]
    substitute: bool,
    /// Samples a pixel [default: the scene's]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    spp: Option<u32>,
    /// Chooses among equally good sets of random numbers [default: the scene's]
    #[arg(long, value_name = "S")]
    seed: Option<u64>,
    /// Pixels of the whole picture; undoes the scene's crop [default: the scene's]
    #[arg(long, value_name = "WxH", value_parser = values::size)]
    size: Option<[u32; 2]>,
    /// The part to render, in pixels of the whole picture; X1 and Y1 are behind its end
    #[arg(long, value_name = "X0,Y0,X1,Y1", value_parser = values::crop)]
    crop: Option<Window>,
    /// Which light transport is counted [default: the scene's]
    #[arg(long, value_name = "NAME")]
    integrator: Option<IntegratorName>,
    /// Where random directions come from [default: mis]
    #[arg(long, value_name = "NAME")]
    strategy: Option<StrategyName>,
    /// Where random numbers come from [default: the scene's]
    #[arg(long, value_name = "NAME")]
    sampler: Option<SamplerName>,
    /// Switches off what saves work without changing the expected image, to measure what it gains; may be repeated
    #[arg(long, value_name = "NAME")]
    without: Vec<SavingName>,
    /// Goes on with an image, by the film beside it, up to --spp; the result has the bits of a fresh render. Settings are the
    /// image's [writes to it, unless -o says otherwise]
    #[arg(long, value_name = "IMAGE.exr", requires = "spp", conflicts_with = "samples")]
    resume: Option<PathBuf>,
    /// Renders samples A to B-1 of each pixel alone, for `tilecast merge`; --spp says of how many in all [default: B]
    #[arg(long, value_name = "A..B", value_parser = values::samples)]
    samples: Option<Range<u32>>,
    /// Longest path: 1 emitters alone, 2 direct light, -1 no limit [default: the scene's]
    #[arg(long, value_name = "N", value_parser = values::max_depth, allow_negative_numbers = true)]
    max_depth: Option<values::MaxDepth>,
}

/// Where the image goes.
#[derive(Args)]
struct OutputFlags {
    /// The image [default: the scene's name with .exr, in this folder]
    #[arg(short, long, value_name = "OUT.exr")]
    output: Option<PathBuf>,
    /// Also writes OUT.png: sRGB, no exposure
    #[arg(long)]
    preview: bool,
    /// Refreshes OUT.exr, OUT.png and OUT.error.png, a picture of the errors, after every round
    #[arg(long)]
    previews: bool,
    /// Does not keep OUT.film, the exact sums (some 110 bytes a pixel, however many samples), without which --resume and
    /// `tilecast merge` cannot go on with the image, nor OUT.json, which says who rendered what
    #[arg(long)]
    no_film: bool,
    /// Side of a tile in pixels; the image is the same for all
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(TILE_SIDE_MAX)))]
    tile: Option<u32>,
    #[command(flatten)]
    style: StyleFlags,
}

/// When an image is done, if not at a number of samples.
#[derive(Args)]
struct GoalFlags {
    /// Renders until the relative error of the image is E (0.02: 2 %), with more samples where it is noisier; unbiased, and
    /// the same bits for any number of workers
    #[arg(long, value_name = "E", value_parser = values::error, conflicts_with_all = ["spp", "samples", "resume"])]
    target_error: Option<f32>,
    /// Likewise, until 95 % of the picture are known to E, relative to the pixels around
    #[arg(long, value_name = "E", value_parser = values::error, conflicts_with_all = ["target_error", "spp", "samples", "resume"])]
    target_pixel_error: Option<f32>,
    /// Renders for so long, such as 90s, 30m or 4h
    #[arg(long, value_name = "TIME", value_parser = values::time, conflicts_with_all = ["target_error", "target_pixel_error", "spp", "samples", "resume", "tile"])]
    time: Option<Duration>,
}

impl GoalFlags {
    fn ready(&self) -> Goal {
        match (self.target_error, self.target_pixel_error, self.time) {
            (Some(error), _, _) => Goal::Error(Target::Image(error)),
            (_, Some(error), _) => Goal::Error(Target::Pixels(error)),
            (_, _, Some(time)) => Goal::Time(time),
            (None, None, None) => Goal::Samples,
        }
    }
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
struct RenderFlags {
    #[command(flatten)]
    picture: PictureFlags,
    #[command(flatten)]
    goal: GoalFlags,
    #[command(flatten)]
    output: OutputFlags,
    /// Threads that trace; with --workers, of each of them [default: all cores, divided among the workers]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(THREADS_MAX)))]
    threads: Option<u32>,
    /// Traces in N worker processes instead of this one
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(CHILDREN_MAX)))]
    workers: Option<u32>,
    /// Keeps what is done in this folder: when the render ends before the image is there (kill -9, power), the same command
    /// goes on with it [costs writes of some 110 bytes a pixel and unit of work]
    #[arg(long, value_name = "DIR")]
    state: Option<PathBuf>,
    #[command(flatten)]
    isa: IsaFlags,
    /// Traces one sample of this pixel again and prints its path; writes no image
    #[arg(long, value_name = "X,Y", value_parser = values::pixel, requires = "sample", conflicts_with_all = ["output", "preview", "json"])]
    pixel: Option<[u32; 2]>,
    /// Which sample of --pixel
    #[arg(long, value_name = "I", requires = "pixel")]
    sample: Option<u32>,
}

/// As whom a client comes: what it has the certificate of.
const CLIENTS: [Role; 2] = [Role::Client, Role::Admin];
/// Whoever may cancel anybody's job does so as that.
const ADMINS: [Role; 2] = [Role::Admin, Role::Client];
/// Worker processes on one machine; more have no cores to run on.
const CHILDREN_MAX: u32 = 1024;

#[derive(Args)]
pub struct IsaFlags {
    /// Instruction set to trace with; all give the same bits [default: TILECAST_ISA, or the fastest here]
    #[arg(long, value_name = "NAME", value_parser = values::isa)]
    isa: Option<Isa>,
}

#[derive(Args)]
struct CoordinatorFlags {
    /// Address and port to serve on; port 0 takes a free one
    #[arg(long, value_name = "ADDR")]
    listen: String,
    /// Keeps jobs and images in the making in this folder: whatever ends the coordinator, the next one goes on
    #[arg(long, value_name = "DIR")]
    state: Option<PathBuf>,
    /// Has this share of all units done again by another worker; the bits must agree [default: 0; 0.05 is a good one]
    #[arg(long, value_name = "RATE", value_parser = values::share)]
    verify: Option<f64>,
    #[command(flatten)]
    guard: GuardFlags,
    #[command(flatten)]
    style: StyleFlags,
}

#[derive(Args)]
struct WorkerFlags {
    #[command(flatten)]
    connect: ConnectFlags,
    /// Threads that trace [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(THREADS_MAX)))]
    threads: Option<u32>,
    /// What to call it in `tilecast status`
    #[arg(long, value_name = "NAME", default_value = "")]
    name: String,
    #[command(flatten)]
    isa: IsaFlags,
    /// Ends after so long, such as 90s, 30m or 4h: give a scheduler's walltime
    #[arg(long, value_name = "TIME", value_parser = values::time)]
    lifetime: Option<Duration>,
    /// Ends when standard input does
    #[arg(long, hide = true)]
    exit_with_parent: bool,
}

#[derive(Args)]
struct SubmitFlags {
    #[command(flatten)]
    picture: PictureFlags,
    #[command(flatten)]
    goal: GoalFlags,
    #[command(flatten)]
    connect: ConnectFlags,
    #[command(flatten)]
    output: OutputFlags,
}

#[derive(Args)]
struct StatusFlags {
    #[command(flatten)]
    connect: ConnectFlags,
    /// One JSON object a line
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
struct CancelFlags {
    #[command(flatten)]
    connect: ConnectFlags,
    /// The job's number, as `tilecast status` shows it
    job: u64,
}

#[derive(Args)]
struct CertsFlags {
    #[command(subcommand)]
    command: CertsCommand,
}

#[derive(Subcommand)]
enum CertsCommand {
    /// Makes a private authority, and certificates, keys and tokens for coordinator, workers, clients and admins
    Init {
        /// Folder to make them in
        folder: PathBuf,
        /// How long they are valid
        #[arg(long, value_name = "N", default_value_t = 365, value_parser = clap::value_parser!(u32).range(1..=3650))]
        days: u32,
    },
}

#[derive(Args)]
struct MergeFlags {
    /// Films, or images with their films beside them
    #[arg(required = true, value_name = "FILM")]
    films: Vec<PathBuf>,
    /// The image
    #[arg(short, long, value_name = "OUT.exr")]
    output: PathBuf,
    /// Also writes OUT.png: sRGB, no exposure
    #[arg(long)]
    preview: bool,
    /// Does not keep OUT.film, the exact sums (some 110 bytes a pixel)
    #[arg(long)]
    no_film: bool,
    #[command(flatten)]
    style: StyleFlags,
}

#[derive(Args)]
struct VerifyFlags {
    /// The image; the film beside it is looked at, too, if it is there
    image: PathBuf,
    /// The scene it claims to be of
    scene: PathBuf,
    /// Sets a value that the scene names $NAME, above its own default
    #[arg(short = 'D', value_name = "NAME=VALUE", value_parser = values::define)]
    defines: Vec<(String, String)>,
    /// Replaces or leaves out what tilecast does not have, as when the image was rendered
    #[arg(long)]
    substitute: bool,
    /// The share of the image that is rendered again
    #[arg(long, value_name = "SHARE", default_value_t = 0.01, value_parser = values::share)]
    share: f64,
    /// Chooses which; without it nobody can know before
    #[arg(long, value_name = "S")]
    seed: Option<u64>,
    /// Threads that trace [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(THREADS_MAX)))]
    threads: Option<u32>,
    #[command(flatten)]
    isa: IsaFlags,
    /// One JSON object
    #[arg(long)]
    json: bool,
}

impl VerifyFlags {
    fn ready(self) -> anyhow::Result<Verify> {
        let Self { image, scene, defines, substitute, share, seed, threads, isa, json } = self;
        let threads = threads.unwrap_or_else(cores);
        Ok(Verify { image, scene, defines, substitute, share, seed, threads, isa: isa.ready()?, json })
    }
}

#[derive(Args)]
struct InfoFlags {
    /// Mitsuba 3 XML, or a bare Wavefront OBJ
    scene: PathBuf,
    /// Sets a value that the scene names $NAME, above its own default
    #[arg(short = 'D', value_name = "NAME=VALUE", value_parser = values::define)]
    defines: Vec<(String, String)>,
    /// Replaces or leaves out what tilecast does not have, and lists it, instead of failing
    #[arg(long)]
    substitute: bool,
    /// One JSON object
    #[arg(long)]
    json: bool,
}

impl Cli {
    /// Ready values for what was asked.
    ///
    /// # Errors
    /// [`Usage`] for flags that do not fit each other or this machine.
    pub fn task(self) -> anyhow::Result<Task> {
        Ok(match self.command {
            Command::Render(flags) => flags.ready()?,
            Command::Coordinator(CoordinatorFlags { listen, state, verify, guard, style }) => {
                let (verify, security) = (verify.unwrap_or(0.0), guard.ready()?);
                Task::Coordinator(Coordinator { listen, state, verify, security, style: style.ready() })
            }
            Command::Worker(flags) => Task::Worker(flags.ready()?),
            Command::Submit(flags) => Task::Submit(flags.ready()?),
            Command::Status(StatusFlags { connect, json }) => {
                Task::Status(Status { connector: connect.ready(&CLIENTS)?, json })
            }
            Command::Cancel(CancelFlags { connect, job }) => {
                Task::Cancel(Cancel { connector: connect.ready(&ADMINS)?, job })
            }
            Command::Merge(MergeFlags { films, output, preview, no_film, style }) => {
                let output = Output::check(output, preview, !no_film)?;
                Task::Merge(Merge { films, output, style: style.ready() })
            }
            Command::Scale(flags) => Task::Scale(flags.ready()?),
            Command::Verify(flags) => Task::Verify(flags.ready()?),
            Command::Compare(flags) => Task::Compare(flags.ready()),
            Command::Bench(flags) => Task::Bench(flags.ready()?),
            Command::Info(InfoFlags { scene, defines, substitute, json }) => {
                Task::Info(Info { scene, defines, substitute, json })
            }
            Command::Certs(CertsFlags { command: CertsCommand::Init { folder, days } }) => {
                Task::Certs(Certs { folder, lifetime: Duration::from_secs(u64::from(days) * 86_400) })
            }
        })
    }
}

impl RenderFlags {
    fn ready(self) -> anyhow::Result<Task> {
        if let (Some(pixel), Some(sample)) = (self.pixel, self.sample) {
            return Ok(Task::Replay(Replay { picture: self.picture.ready(), pixel, sample }));
        }
        let backend = match self.workers {
            None => Backend::Here { threads: self.threads.unwrap_or_else(cores) },
            Some(workers) => {
                let threads = self.threads.unwrap_or_else(|| (cores() / workers).max(1));
                Backend::Processes { workers, threads }
            }
        };
        let (tile, style) = (self.output.tile, self.output.style.ready());
        let output = self.output.ready(&self.picture.scene, self.picture.resume.as_deref())?;
        let (picture, goal, isa) = (self.picture.ready(), self.goal.ready(), self.isa.ready()?);
        Ok(Task::Render(Render { picture, goal, output, tile, backend, state: self.state, isa, style }))
    }
}

impl WorkerFlags {
    fn ready(self) -> anyhow::Result<Worker> {
        Ok(Worker {
            connector: self.connect.ready(&[Role::Worker, Role::Admin])?,
            threads: self.threads.unwrap_or_else(cores),
            name: self.name,
            isa: self.isa.ready()?,
            lifetime: self.lifetime,
            exit_with_parent: self.exit_with_parent,
        })
    }
}

impl SubmitFlags {
    fn ready(self) -> anyhow::Result<Submit> {
        let (tile, style) = (self.output.tile, self.output.style.ready());
        let output = self.output.ready(&self.picture.scene, self.picture.resume.as_deref())?;
        let goal = self.goal.ready();
        Ok(Submit {
            picture: self.picture.ready(),
            goal,
            connector: self.connect.ready(&CLIENTS)?,
            output,
            tile,
            style,
        })
    }
}

impl PictureFlags {
    fn ready(self) -> Picture {
        let overrides = Overrides {
            spp: self.spp,
            seed: self.seed,
            size: self.size,
            crop: self.crop,
            integrator: self.integrator.map(Into::into),
            strategy: self.strategy.map(Into::into),
            sampler: self.sampler.map(Into::into),
            without: (!self.without.is_empty()).then(|| values::without(&self.without)),
            max_depth: self.max_depth.map(|depth| depth.0),
        };
        let replay = replaying::command(std::env::args_os().map(|arg| arg.to_string_lossy().into_owned()));
        let Self { scene, defines, substitute, resume, samples, .. } = self;
        Picture { scene, defines, substitute, overrides, resume, samples, replay }
    }
}

impl OutputFlags {
    /// The checked way to the image: that it can be written is known before anything is rendered.
    fn ready(self, scene: &Path, resume: Option<&Path>) -> anyhow::Result<Output> {
        let path = match (self.output, resume) {
            (Some(path), _) => path,
            (None, Some(image)) => image.to_owned(),
            (None, None) => {
                let stem = scene.file_stem().context("the scene's path has no file name; name the image with -o")?;
                let mut name = stem.to_owned();
                name.push(".exr");
                PathBuf::from(name)
            }
        };
        let output = Output::check(path, self.preview, !self.no_film)?;
        if self.previews { output.refreshed() } else { Ok(output) }
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
