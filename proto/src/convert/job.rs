//! What clients and coordinator say to each other, to and from the wire.

use super::{WireError, at_most, digest, digest_bytes, micros, text, window, within};
use crate::limits::{
    FAILURE_BYTES_MAX, FILM_CHUNK_PIXELS, FILM_PIXELS_MAX, NAME_BYTES_MAX, RANGES_MAX, THREADS_MAX, TILE_SIDE_MAX,
};
use crate::sums;
use crate::types::{
    Aim, Contribution, FilmHeader, JobId, JobSpec, JobState, Progress, WorkerId, WorkerInfo, WorkerStatus,
};
use crate::wire;
use std::num::NonZeroU32;
use std::ops::Range;
use std::time::Duration;
use tilecast_core::film::file::Target;
use tilecast_core::film::{Film, PixelSums, REPLICATES, RelativeError};
use tilecast_core::settings::{FILM_SIDE_MAX, Settings};

/// Samples of an image, over all pixels: more than a thousand years of a thousand cores make.
const SAMPLES_MAX: u64 = 1 << 60;

impl TryFrom<wire::Job> for JobSpec {
    type Error = WireError;

    fn try_from(message: wire::Job) -> Result<Self, WireError> {
        let settings = Settings::try_from(message.settings.ok_or(WireError::Missing("job.settings"))?)?;
        within(settings.film.crop.area(), 1..=FILM_PIXELS_MAX, "pixels of job.settings.crop")?;
        let tile = within(message.tile, 0..=TILE_SIDE_MAX.into(), "job.tile")?;
        let samples = ranges(&message.sample_starts, &message.sample_ends, settings.spp)?;
        Ok(Self {
            scene: digest(&message.scene, "job.scene")?,
            settings,
            samples,
            tile: (tile > 0).then_some(tile),
            name: text(message.name, NAME_BYTES_MAX, "job.name")?,
            workers_hold_scene: message.workers_hold_scene,
            aim: message.aim.map(Aim::try_from).transpose()?,
            ticket: message.ticket,
            workers_max: NonZeroU32::new(message.workers_max),
        })
    }
}

impl TryFrom<wire::Aim> for Aim {
    type Error = WireError;

    fn try_from(message: wire::Aim) -> Result<Self, WireError> {
        let wire::Aim { error, pixels, pilot, before, image, expected } = message;
        if !(error.is_finite() && error >= 0.0) {
            return Err(WireError::NotAnError { field: "job.aim.error", value: error });
        }
        within(image, 0..=before, "job.aim.image")?;
        within(before, 0..=SAMPLES_MAX, "job.aim.before")?;
        within(expected, 0..=SAMPLES_MAX, "job.aim.expected")?;
        let target = (error > 0.0).then_some(if pixels { Target::Pixels(error) } else { Target::Image(error) });
        Ok(Self { target, pilot, before, image, expected })
    }
}

impl From<Aim> for wire::Aim {
    fn from(Aim { target, pilot, before, image, expected }: Aim) -> Self {
        let (error, pixels) = match target {
            None => (0.0, false),
            Some(Target::Image(error)) => (error, false),
            Some(Target::Pixels(error)) => (error, true),
        };
        Self { error, pixels, pilot, before, image, expected }
    }
}

/// The ranges of samples of a job; whether there are as many as tiles is the plan's to say.
fn ranges(starts: &[u32], ends: &[u32], spp: u32) -> Result<Vec<Range<u32>>, WireError> {
    at_most(starts.len(), RANGES_MAX, "job.sample_starts")?;
    let expected = starts.len() as u64;
    within(ends.len() as u64, expected.max(1)..=expected.max(1), "the length of job.sample_ends")?;
    let range = |(&start, &end): (&u32, &u32)| {
        within(end, start.into()..=spp.into(), "job.sample_ends")?;
        Ok(start..end)
    };
    let ranges: Vec<Range<u32>> = starts.iter().zip(ends).map(range).collect::<Result<_, WireError>>()?;
    if ranges.iter().all(Range::is_empty) { Err(WireError::Missing("job.samples")) } else { Ok(ranges) }
}

impl From<JobSpec> for wire::Job {
    fn from(job: JobSpec) -> Self {
        Self {
            sample_starts: job.samples.iter().map(|range| range.start).collect(),
            sample_ends: job.samples.iter().map(|range| range.end).collect(),
            scene: digest_bytes(&job.scene),
            settings: Some((&job.settings).into()),
            tile: job.tile.unwrap_or(0),
            name: job.name,
            workers_hold_scene: job.workers_hold_scene,
            aim: job.aim.map(Into::into),
            ticket: job.ticket,
            workers_max: job.workers_max.map_or(0, NonZeroU32::get),
        }
    }
}

impl From<Progress> for wire::Progress {
    fn from(progress: Progress) -> Self {
        let (state, message) = match progress.state {
            JobState::Queued => (wire::JobState::Queued, String::new()),
            JobState::Running => (wire::JobState::Running, String::new()),
            JobState::Finished => (wire::JobState::Finished, String::new()),
            JobState::Failed(message) => (wire::JobState::Failed, super::failure_text(message)),
            JobState::Cancelled => (wire::JobState::Cancelled, String::new()),
        };
        Self {
            job: progress.job.0,
            name: progress.name,
            state: state.into(),
            message,
            samples_done: progress.samples_done,
            samples_total: progress.samples_total,
            workers: progress.workers,
            relative_error: progress.relative_error.map(|e| wire::RelativeError {
                value: e.value,
                low: e.low,
                high: e.high,
            }),
            elapsed_ms: millis(progress.elapsed),
            running_ms: millis(progress.running),
            scene: digest_bytes(&progress.scene),
            settings: Some((&progress.settings).into()),
            merge_us: micros(progress.merging),
            samples_found: progress.samples_found,
            samples_per_second: progress.samples_per_second,
        }
    }
}

impl TryFrom<wire::Progress> for Progress {
    type Error = WireError;

    fn try_from(message: wire::Progress) -> Result<Self, WireError> {
        let state = match message.state() {
            wire::JobState::Queued => JobState::Queued,
            wire::JobState::Running => JobState::Running,
            wire::JobState::Finished => JobState::Finished,
            wire::JobState::Failed => {
                JobState::Failed(text(message.message.clone(), FAILURE_BYTES_MAX, "progress.message")?)
            }
            wire::JobState::Cancelled => JobState::Cancelled,
            wire::JobState::Unspecified => {
                return Err(WireError::Enum { field: "progress.state", value: message.state });
            }
        };
        Ok(Self {
            job: JobId(message.job),
            name: text(message.name, NAME_BYTES_MAX, "progress.name")?,
            state,
            samples_done: within(message.samples_done, 0..=message.samples_total, "progress.samples_done")?,
            samples_found: within(message.samples_found, 0..=message.samples_done, "progress.samples_found")?,
            samples_total: message.samples_total,
            workers: message.workers,
            samples_per_second: message.samples_per_second,
            relative_error: message.relative_error.map(|e| RelativeError { value: e.value, low: e.low, high: e.high }),
            elapsed: Duration::from_millis(message.elapsed_ms),
            running: Duration::from_millis(message.running_ms),
            scene: digest(&message.scene, "progress.scene")?,
            settings: message.settings.ok_or(WireError::Missing("progress.settings"))?.try_into()?,
            merging: Duration::from_micros(message.merge_us),
        })
    }
}

impl From<WorkerStatus> for wire::Worker {
    fn from(status: WorkerStatus) -> Self {
        let WorkerInfo { threads, isa, host, pid, name, cpu, .. } = status.info;
        Self {
            worker: status.worker.0,
            name,
            host,
            cpu,
            pid,
            isa,
            threads,
            leases: status.leases,
            units_done: status.units_done,
            samples_done: status.samples_done,
            samples_per_second: status.samples_per_second,
            silent_ms: millis(status.silent),
        }
    }
}

impl TryFrom<wire::Worker> for WorkerStatus {
    type Error = WireError;

    fn try_from(message: wire::Worker) -> Result<Self, WireError> {
        Ok(Self {
            worker: WorkerId(message.worker),
            info: WorkerInfo {
                threads: within(message.threads, 1..=THREADS_MAX.into(), "worker.threads")?,
                isa: text(message.isa, NAME_BYTES_MAX, "worker.isa")?,
                host: text(message.host, NAME_BYTES_MAX, "worker.host")?,
                pid: message.pid,
                name: text(message.name, NAME_BYTES_MAX, "worker.name")?,
                cpu: text(message.cpu, NAME_BYTES_MAX, "worker.cpu")?,
                // The coordinator's own affair.
                instance: 0,
            },
            leases: message.leases,
            units_done: message.units_done,
            samples_done: message.samples_done,
            samples_per_second: message.samples_per_second,
            silent: Duration::from_millis(message.silent_ms),
        })
    }
}

impl From<Contribution> for wire::Contribution {
    fn from(contribution: Contribution) -> Self {
        let Contribution { worker, info, units, samples, trace, first, last } = contribution;
        let status = WorkerStatus {
            worker,
            info,
            leases: 0,
            units_done: units,
            samples_done: samples,
            samples_per_second: 0.0,
            silent: Duration::ZERO,
        };
        Self { worker: Some(status.into()), trace_us: micros(trace), first_us: micros(first), last_us: micros(last) }
    }
}

impl TryFrom<wire::Contribution> for Contribution {
    type Error = WireError;

    fn try_from(message: wire::Contribution) -> Result<Self, WireError> {
        let status = WorkerStatus::try_from(message.worker.ok_or(WireError::Missing("contribution.worker"))?)?;
        Ok(Self {
            worker: status.worker,
            info: status.info,
            units: status.units_done,
            samples: status.samples_done,
            trace: Duration::from_micros(message.trace_us),
            first: Duration::from_micros(message.first_us),
            last: Duration::from_micros(message.last_us),
        })
    }
}

impl TryFrom<wire::FilmHeader> for FilmHeader {
    type Error = WireError;

    fn try_from(message: wire::FilmHeader) -> Result<Self, WireError> {
        let window = window(message.window, FILM_SIDE_MAX, "film.window")?;
        within(window.area(), 1..=FILM_PIXELS_MAX, "pixels of film.window")?;
        Ok(Self { window, scale_exponent: message.scale_exponent })
    }
}

impl From<FilmHeader> for wire::FilmHeader {
    fn from(header: FilmHeader) -> Self {
        Self { window: Some(header.window.into()), scale_exponent: header.scale_exponent }
    }
}

/// The chunk of a film that begins at pixel `first` (row by row through its window); `None` behind the end.
pub fn film_rows(film: &Film, first: u64) -> Option<wire::FilmChunk> {
    let start = usize::try_from(first).ok()?;
    let end = film.sums().len().min(start.checked_add(FILM_CHUNK_PIXELS as usize)?);
    let sums = film.sums().get(start..end).filter(|sums| !sums.is_empty())?;
    let runs = film.counts()[start..end].chunk_by(|a, b| a == b);
    let header = FilmHeader { window: film.window, scale_exponent: film.scale_exponent };
    Some(wire::FilmChunk {
        first_pixel: first,
        pixels: sums.len() as u32,
        counts: runs.map(|run| wire::CountRun { pixels: run.len() as u32, counts: run[0].to_vec() }).collect(),
        sums: sums::encode(sums).into(),
        header: (first == 0).then(|| header.into()),
    })
}

/// A film put together from its chunks, which come in order.
#[derive(Debug)]
pub(crate) struct FilmParts {
    header: FilmHeader,
    sums: Vec<PixelSums>,
    counts: Vec<[u32; REPLICATES]>,
}

impl FilmParts {
    /// The film that the first chunk announces.
    pub(crate) fn new(first: &wire::FilmChunk) -> Result<Self, WireError> {
        let header = first.header.ok_or(WireError::Missing("film.header"))?.try_into()?;
        Ok(Self { header, sums: Vec::new(), counts: Vec::new() })
    }

    /// Adds a chunk. Memory grows with what has come, not with what was announced.
    pub(crate) fn push(&mut self, chunk: &wire::FilmChunk) -> Result<(), WireError> {
        let have = self.sums.len() as u64;
        within(chunk.first_pixel, have..=have, "film.first_pixel")?;
        let room = (self.header.window.area() - have).min(FILM_CHUNK_PIXELS.into());
        within(chunk.pixels, 1..=room, "film.pixels")?;
        self.sums.append(&mut sums::decode(&chunk.sums, chunk.pixels as usize)?);
        for run in &chunk.counts {
            within(run.pixels, 1..=self.sums.len() as u64 - self.counts.len() as u64, "film.counts.pixels")?;
            let counts: [u32; REPLICATES] = run.counts.as_slice().try_into().map_err(|_| WireError::Long {
                field: "film.counts.counts",
                len: run.counts.len(),
                max: REPLICATES,
            })?;
            self.counts.extend(std::iter::repeat_n(counts, run.pixels as usize));
        }
        if self.counts.len() == self.sums.len() { Ok(()) } else { Err(WireError::Missing("film.counts")) }
    }

    /// The whole film.
    pub(crate) fn finish(self) -> Result<Film, WireError> {
        if self.sums.len() as u64 != self.header.window.area() {
            return Err(WireError::Stream("ends before the film does"));
        }
        let FilmHeader { window, scale_exponent } = self.header;
        Film::from_parts(window, scale_exponent, self.sums, self.counts).ok_or(WireError::Unbounded)
    }
}

fn millis(duration: Duration) -> u64 {
    u64::try_from(duration.as_millis()).unwrap_or(u64::MAX)
}
