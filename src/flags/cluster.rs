//! Flags of coordinators, workers, and those who talk to them.

use super::rendering::{GoalFlags, OutputFlags, PictureFlags};
use super::security::{ConnectFlags, GuardFlags};
use super::{IsaFlags, StyleFlags, cores, values};
use crate::LogFormat;
use crate::cancel::Cancel;
use crate::certs::Certs;
use crate::coordinator::Coordinator;
use crate::status::Status;
use crate::submit::Submit;
use crate::worker::Worker;
use clap::{Args, Subcommand};
use std::path::PathBuf;
use std::time::Duration;
use tilecast_coordinator::access::Role;
use tilecast_proto::limits::THREADS_MAX;

pub const CLUSTER_EXAMPLES: &str = "\
A cluster in three commands:
  tilecast coordinator --listen 127.0.0.1:7878           one of these
  tilecast worker --connect 127.0.0.1:7878               as many as you like
  tilecast submit scene.xml --connect 127.0.0.1:7878     writes scene.exr
Beyond this machine, all three with certificates from `tilecast certs init certs`:
  tilecast coordinator --listen 0.0.0.0:7878 --certs certs --state state
  tilecast worker --connect 10.0.0.1:7878 --certs certs
  tilecast submit scene.xml --connect 10.0.0.1:7878 --certs certs";

/// As whom a client comes: what it has the certificate of.
pub const CLIENTS: [Role; 2] = [Role::Client, Role::Admin];
/// Whoever may cancel anybody's job does so as that.
const ADMINS: [Role; 2] = [Role::Admin, Role::Client];

#[derive(Args)]
pub struct CoordinatorFlags {
    /// Address and port to serve on; port 0 takes a free one
    #[arg(long, value_name = "ADDR")]
    listen: String,
    /// Serves a page to look on with, metrics and health on this address; beyond loopback with --certs, to who has a token of
    /// --token-file
    #[arg(long, value_name = "ADDR")]
    http: Option<String>,
    /// Sends images as they converge to the viewer tev there [default port: 14158]
    #[arg(long, value_name = "HOST:PORT", value_parser = values::tev)]
    tev: Option<String>,
    /// Sends traces of every unit, from lease to merge, to the OpenTelemetry collector there, by gRPC [default port: 4317]
    #[arg(long, value_name = "HOST:PORT", value_parser = values::otlp)]
    otlp: Option<String>,
    /// Keeps jobs and images in the making in this folder: whatever ends the coordinator, the next one goes on
    #[arg(long, value_name = "DIR")]
    state: Option<PathBuf>,
    /// Has this share of all units done again by another worker; the bits must agree [default: 0; 0.05 is a good one]
    #[arg(long, value_name = "RATE", value_parser = values::share)]
    verify: Option<f64>,
    #[command(flatten)]
    guard: GuardFlags,
    #[command(flatten)]
    log: LogFlags,
    #[command(flatten)]
    style: StyleFlags,
}

#[derive(Args)]
pub struct LogFlags {
    /// How the log on stderr is written: json has one object a line, for programs
    #[arg(long, value_name = "FORMAT", value_enum, default_value_t = LogFormat::Text)]
    log_format: LogFormat,
}

#[derive(Args)]
pub struct WorkerFlags {
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
    #[command(flatten)]
    cache: CacheFlags,
    #[command(flatten)]
    log: LogFlags,
    /// Ends when standard input does
    #[arg(long, hide = true)]
    exit_with_parent: bool,
}

/// Where scenes are kept beyond a worker's end.
#[derive(Args)]
pub struct CacheFlags {
    /// Keeps scenes in this folder, which workers may share, such as one on a shared file system: each part is sent to one of
    /// them, and the others read it there
    #[arg(long, value_name = "DIR")]
    pub scene_cache: Option<PathBuf>,
}

#[derive(Args)]
pub struct SubmitFlags {
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
pub struct StatusFlags {
    #[command(flatten)]
    connect: ConnectFlags,
    /// One JSON object a line
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
pub struct CancelFlags {
    #[command(flatten)]
    connect: ConnectFlags,
    /// The job's number, as `tilecast status` shows it
    job: u64,
}

#[derive(Args)]
pub struct CertsFlags {
    #[command(subcommand)]
    command: CertsCommand,
}

#[derive(Subcommand)]
pub enum CertsCommand {
    /// Makes a private authority, and certificates, keys and tokens for coordinator, workers, clients and admins
    Init {
        /// Folder to make them in
        folder: PathBuf,
        /// How long they are valid
        #[arg(long, value_name = "N", default_value_t = 365, value_parser = clap::value_parser!(u32).range(1..=3650))]
        days: u32,
    },
}

impl CoordinatorFlags {
    pub fn ready(self) -> anyhow::Result<Coordinator> {
        let Self { listen, http, tev, otlp, state, verify, guard, log, style } = self;
        let (verify, security) = (verify.unwrap_or(0.0), guard.ready()?);
        Ok(Coordinator { listen, http, tev, otlp, state, verify, security, style: style.ready(), log: log.log_format })
    }
}

impl WorkerFlags {
    pub fn ready(self) -> anyhow::Result<Worker> {
        Ok(Worker {
            connector: self.connect.ready(&[Role::Worker, Role::Admin])?,
            threads: self.threads.unwrap_or_else(cores),
            name: self.name,
            isa: self.isa.ready()?,
            lifetime: self.lifetime,
            scene_cache: self.cache.scene_cache,
            exit_with_parent: self.exit_with_parent,
            log: self.log.log_format,
        })
    }
}

impl SubmitFlags {
    pub fn ready(self) -> anyhow::Result<Submit> {
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

impl StatusFlags {
    pub fn ready(self) -> anyhow::Result<Status> {
        Ok(Status { connector: self.connect.ready(&CLIENTS)?, json: self.json })
    }
}

impl CancelFlags {
    pub fn ready(self) -> anyhow::Result<Cancel> {
        Ok(Cancel { connector: self.connect.ready(&ADMINS)?, job: self.job })
    }
}

impl CertsFlags {
    pub fn ready(self) -> Certs {
        let CertsCommand::Init { folder, days } = self.command;
        Certs { folder, lifetime: Duration::from_secs(u64::from(days) * 86_400) }
    }
}
