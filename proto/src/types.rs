//! What the wire speaks of, checked and typed. [`crate::convert`] makes these from messages; nothing behind it checks again.

use std::fmt;
use std::num::NonZeroU32;
use std::ops::Range;
use std::time::Duration;
use tilecast_core::film::RelativeError;
use tilecast_core::film::file::Target;
use tilecast_core::scene::Digest;
use tilecast_core::settings::{Settings, Window};

/// A job of one coordinator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct JobId(pub u64);

/// A worker, from its registration to its silence. Never reused, not by another coordinator at the same address either.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct WorkerId(pub u64);

impl WorkerId {
    /// The number that people see: what is before it tells coordinators apart.
    pub fn number(self) -> u32 {
        (self.0 & 0xffff_ffff) as u32
    }
}

/// The fencing number of a lease: grows with every lease a coordinator gives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Fence(pub u64);

impl fmt::Display for JobId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// A unit of work: samples of every pixel of a tile, for a job.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Unit {
    /// Whose scene and settings.
    pub job: JobId,
    /// The pixels.
    pub tile: Window,
    /// The sample indices, never empty.
    pub samples: Range<u32>,
}

impl Unit {
    /// Samples in all: pixels times sample indices.
    pub fn len(&self) -> u64 {
        self.tile.area() * u64::from(self.samples.end - self.samples.start)
    }

    /// Never, for a unit that came through [`crate::convert`].
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// A worker about itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WorkerInfo {
    /// Threads that trace, at least 1.
    pub threads: u32,
    /// Instruction set of its kernels.
    pub isa: String,
    /// Its machine.
    pub host: String,
    /// Its process there.
    pub pid: u32,
    /// What people call it; may be empty.
    pub name: String,
    /// Its processor; may be empty.
    pub cpu: String,
    /// Drawn at random when its process began; never 0.
    pub instance: u64,
}

/// The answer to a registration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Welcome {
    /// Its number from now on.
    pub worker: WorkerId,
    /// How often to be heard.
    pub heartbeat: Duration,
}

/// A request for work.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LeaseRequest {
    /// Who asks.
    pub worker: WorkerId,
    /// How many units of [`LeaseReply::unit_samples`] it can take, at least 1.
    pub slots: u32,
    /// Jobs whose description it has.
    pub known_jobs: Vec<JobId>,
}

/// Work.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LeaseReply {
    /// Units to trace, in this order; none if there is nothing to do.
    pub leases: Vec<Lease>,
    /// Descriptions of those of their jobs that the worker does not have.
    pub jobs: Vec<JobWork>,
    /// The size, in samples, that one slot stands for in the next request.
    pub unit_samples: u64,
}

/// A unit lent to a worker until it falls silent.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lease {
    /// Names the lease.
    pub fence: Fence,
    /// What to trace.
    pub unit: Unit,
}

/// What a worker needs to know of a job.
#[derive(Clone, Debug, PartialEq)]
pub struct JobWork {
    /// The job.
    pub job: JobId,
    /// Digest of its scene's manifest.
    pub scene: Digest,
    /// How to render it.
    pub settings: Settings,
}

/// A result is coming.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ResultHeader {
    /// Who brings it.
    pub worker: WorkerId,
    /// Under which lease it was made.
    pub fence: Fence,
    /// What was traced.
    pub unit: Unit,
    /// See [`crate::convert::work_key`].
    pub key: Digest,
    /// Time spent tracing on one thread.
    pub trace: Duration,
    /// Since then, until it was sent.
    pub waited: Duration,
    /// Length of the encoded sums.
    pub bytes: usize,
}

/// What became of a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Counted.
    Accepted,
    /// Counted before, from whomever.
    Duplicate,
    /// No such unit (any more).
    Stale,
    /// The job has ended.
    Ended,
}

/// How the text of [`Failure::Sample`] calls the command that replays the sample. A worker does not know the scene's file; who
/// does puts the whole command in its place.
pub const REPLAY_COMMAND: &str = "tilecast render SCENE";

/// Why a unit could not be done.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Failure {
    /// A sample without a value: the same on every worker.
    Sample(String),
    /// The tracer panicked.
    Panic(String),
    /// The worker cannot prepare the scene.
    Scene(String),
}

/// A sign of life.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Heartbeat {
    /// Whose.
    pub worker: WorkerId,
    /// The leases it holds.
    pub fences: Vec<Fence>,
    /// Samples traced since it registered.
    pub samples: u64,
}

/// The answer to a sign of life.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct HeartbeatReply {
    /// Leases to stop working on.
    pub drop: Vec<Fence>,
}

/// A worker goes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Leave {
    /// Which.
    pub worker: WorkerId,
    /// Leases that it will bring yet; without any, it is gone.
    pub keep: Vec<Fence>,
}

/// A job to be done.
#[derive(Clone, Debug, PartialEq)]
pub struct JobSpec {
    /// Digest of the scene's manifest.
    pub scene: Digest,
    /// How to render it.
    pub settings: Settings,
    /// Side of a tile in pixels, 1 to [`crate::limits::TILE_SIDE_MAX`]; `None` leaves it to the coordinator.
    pub tile: Option<u32>,
    /// The sample indices to trace: one range for all tiles, or one for each, row by row. An empty one wants nothing of its
    /// tile. None goes beyond the settings' `spp`.
    pub samples: Vec<Range<u32>>,
    /// What people call it; may be empty.
    pub name: String,
    /// The workers have the scene already (they live in the client's process): the blobs need not be there.
    pub workers_hold_scene: bool,
    /// What it is a step towards, if it is not the whole.
    pub aim: Option<Aim>,
    /// Made up by the client: the same ticket again is the same job, and not another one like it. 0 is none.
    pub ticket: u64,
    /// So many workers may work on it at a time, if not all. Checking what they bring is left to any.
    pub workers_max: Option<NonZeroU32>,
}

impl JobSpec {
    /// All samples of every pixel, by whoever there is; the rest is as little as can be said.
    pub fn new(scene: Digest, settings: Settings) -> Self {
        Self {
            scene,
            samples: vec![Range { start: 0, end: settings.spp }],
            settings,
            tile: None,
            name: String::new(),
            workers_hold_scene: false,
            aim: None,
            ticket: 0,
            workers_max: None,
        }
    }
}

/// An image that takes several jobs, for whoever looks on. Samples are counted over all pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Aim {
    /// The error at which it is done, if that is how it ends.
    pub target: Option<Target>,
    /// The job's samples are no part of the image.
    pub pilot: bool,
    /// Traced in the jobs before, pilots included.
    pub before: u64,
    /// Those of them that are part of the image.
    pub image: u64,
    /// Traced in the end, pilots included; 0 while nothing can be said.
    pub expected: u64,
}

/// Where a job stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum JobState {
    /// No unit of it was ever given out.
    Queued,
    /// Some were.
    Running,
    /// All samples are counted.
    Finished,
    /// It cannot be finished; the text says why.
    Failed(String),
    /// Someone ended it.
    Cancelled,
}

impl JobState {
    /// Whether it will not change any more.
    pub fn is_final(&self) -> bool {
        matches!(self, JobState::Finished | JobState::Failed(_) | JobState::Cancelled)
    }
}

/// A job, as far as it is.
#[derive(Clone, Debug, PartialEq)]
pub struct Progress {
    /// The job.
    pub job: JobId,
    /// What people call it.
    pub name: String,
    /// Where it stands.
    pub state: JobState,
    /// Samples counted, over all pixels.
    pub samples_done: u64,
    /// Of these, those that were there when the coordinator was started.
    pub samples_found: u64,
    /// Samples asked for, over all pixels.
    pub samples_total: u64,
    /// Workers holding leases of it.
    pub workers: u32,
    /// What these workers trace a second, as last measured; 0 while unknown.
    pub samples_per_second: f64,
    /// Estimated relative RMS error of the mean, once known.
    pub relative_error: Option<RelativeError>,
    /// Since it was queued; to its end, if it has ended.
    pub elapsed: Duration,
    /// Since its first lease, or the first one after the coordinator was started again, likewise.
    pub running: Duration,
    /// Digest of its scene's manifest.
    pub scene: Digest,
    /// How it is rendered.
    pub settings: Settings,
    /// Spent checking and adding up results, by the coordinator's clock.
    pub merging: Duration,
}

/// A worker, as the coordinator sees it.
#[derive(Clone, Debug, PartialEq)]
pub struct WorkerStatus {
    /// Its number.
    pub worker: WorkerId,
    /// What it said of itself.
    pub info: WorkerInfo,
    /// Units it holds.
    pub leases: u32,
    /// Units it has brought.
    pub units_done: u64,
    /// Samples it has brought.
    pub samples_done: u64,
    /// Samples a second on all its threads, as last measured; 0 while unknown.
    pub samples_per_second: f64,
    /// Since it was last heard of.
    pub silent: Duration,
}

/// What a worker has brought of a job.
#[derive(Clone, Debug, PartialEq)]
pub struct Contribution {
    /// Its number.
    pub worker: WorkerId,
    /// What it said of itself.
    pub info: WorkerInfo,
    /// Units that counted.
    pub units: u64,
    /// Samples of them.
    pub samples: u64,
    /// Spent tracing them, over all its threads.
    pub trace: Duration,
    /// Its first lease, since the job was queued.
    pub first: Duration,
    /// Its last result, likewise.
    pub last: Duration,
}

/// A film is coming.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FilmHeader {
    /// Its pixels.
    pub window: Window,
    /// Its fixed point.
    pub scale_exponent: i32,
}
