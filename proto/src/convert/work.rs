//! What workers and coordinator say to each other, to and from the wire.

use super::{WireError, at_most, digest, digest_bytes, micros, text, tile, version, within};
use crate::limits::{
    FAILURE_BYTES_MAX, KNOWN_JOBS_MAX, LEASES_HELD_MAX, LEASES_PER_REPLY_MAX, NAME_BYTES_MAX, PIXEL_BYTES_MAX,
    SLOTS_MAX, THREADS_MAX,
};
use crate::sums;
use crate::types::{
    Failure, Fence, Heartbeat, HeartbeatReply, JobId, JobWork, Lease, LeaseReply, LeaseRequest, Leave, ResultHeader,
    Unit, Verdict, Welcome, WorkerId, WorkerInfo,
};
use crate::version::Version;
use crate::wire;
use std::time::Duration;
use tilecast_core::film::TileSums;

/// A worker's introduction; refused if its version is another.
impl TryFrom<wire::Hello> for WorkerInfo {
    type Error = WireError;

    fn try_from(message: wire::Hello) -> Result<Self, WireError> {
        version(message.version)?.check()?;
        Ok(Self {
            threads: within(message.threads, 1..=THREADS_MAX.into(), "hello.threads")?,
            isa: text(message.isa, NAME_BYTES_MAX, "hello.isa")?,
            host: text(message.host, NAME_BYTES_MAX, "hello.host")?,
            pid: message.pid,
            name: text(message.name, NAME_BYTES_MAX, "hello.name")?,
            cpu: text(message.cpu, NAME_BYTES_MAX, "hello.cpu")?,
            instance: within(message.instance, 1..=u64::MAX, "hello.instance")?,
        })
    }
}

impl From<WorkerInfo> for wire::Hello {
    fn from(info: WorkerInfo) -> Self {
        let WorkerInfo { threads, isa, host, pid, name, cpu, instance } = info;
        Self { version: Some(Version::ours().into()), threads, isa, host, pid, name, cpu, instance }
    }
}

impl TryFrom<wire::Welcome> for Welcome {
    type Error = WireError;

    fn try_from(message: wire::Welcome) -> Result<Self, WireError> {
        let ms = within(message.heartbeat_ms, 1..=60_000, "welcome.heartbeat_ms")?;
        Ok(Self { worker: WorkerId(message.worker), heartbeat: Duration::from_millis(ms.into()) })
    }
}

impl From<Unit> for wire::Unit {
    fn from(unit: Unit) -> Self {
        Self {
            job: unit.job.0,
            tile: Some(unit.tile.into()),
            sample_start: unit.samples.start,
            sample_end: unit.samples.end,
        }
    }
}

impl TryFrom<wire::Unit> for Unit {
    type Error = WireError;

    fn try_from(message: wire::Unit) -> Result<Self, WireError> {
        let wire::Unit { job, sample_start, sample_end, .. } = message;
        let above = u64::from(sample_start) + 1;
        within(sample_end, above..=u32::MAX.into(), "unit.sample_end")?;
        Ok(Self { job: JobId(job), tile: tile(message.tile, "unit.tile")?, samples: sample_start..sample_end })
    }
}

impl TryFrom<wire::LeaseRequest> for LeaseRequest {
    type Error = WireError;

    fn try_from(message: wire::LeaseRequest) -> Result<Self, WireError> {
        at_most(message.known_jobs.len(), KNOWN_JOBS_MAX, "lease.known_jobs")?;
        Ok(Self {
            worker: WorkerId(message.worker),
            slots: within(message.slots, 1..=SLOTS_MAX.into(), "lease.slots")?,
            known_jobs: message.known_jobs.into_iter().map(JobId).collect(),
        })
    }
}

impl From<LeaseRequest> for wire::LeaseRequest {
    fn from(request: LeaseRequest) -> Self {
        Self {
            worker: request.worker.0,
            slots: request.slots,
            known_jobs: request.known_jobs.into_iter().map(|job| job.0).collect(),
        }
    }
}

impl From<LeaseReply> for wire::LeaseReply {
    fn from(reply: LeaseReply) -> Self {
        let lease = |lease: Lease| wire::Lease { fence: lease.fence.0, unit: Some(lease.unit.into()) };
        let work = |work: JobWork| wire::JobWork {
            job: work.job.0,
            scene: digest_bytes(&work.scene),
            settings: Some((&work.settings).into()),
        };
        Self {
            leases: reply.leases.into_iter().map(lease).collect(),
            jobs: reply.jobs.into_iter().map(work).collect(),
            unit_samples: reply.unit_samples,
        }
    }
}

impl TryFrom<wire::LeaseReply> for LeaseReply {
    type Error = WireError;

    fn try_from(message: wire::LeaseReply) -> Result<Self, WireError> {
        at_most(message.leases.len(), LEASES_PER_REPLY_MAX, "lease.leases")?;
        at_most(message.jobs.len(), LEASES_PER_REPLY_MAX, "lease.jobs")?;
        let lease = |message: wire::Lease| {
            let unit = message.unit.ok_or(WireError::Missing("lease.unit"))?.try_into()?;
            Ok(Lease { fence: Fence(message.fence), unit })
        };
        let work = |message: wire::JobWork| {
            let settings = message.settings.ok_or(WireError::Missing("lease.settings"))?.try_into()?;
            Ok(JobWork { job: JobId(message.job), scene: digest(&message.scene, "lease.scene")?, settings })
        };
        Ok(Self {
            leases: message.leases.into_iter().map(lease).collect::<Result<_, WireError>>()?,
            jobs: message.jobs.into_iter().map(work).collect::<Result<_, WireError>>()?,
            unit_samples: message.unit_samples.max(1),
        })
    }
}

impl From<ResultHeader> for wire::ResultHeader {
    fn from(header: ResultHeader) -> Self {
        Self {
            worker: header.worker.0,
            fence: header.fence.0,
            unit: Some(header.unit.into()),
            key: digest_bytes(&header.key),
            trace_us: micros(header.trace),
            bytes: header.bytes as u64,
            waited_us: micros(header.waited),
        }
    }
}

impl TryFrom<wire::ResultHeader> for ResultHeader {
    type Error = WireError;

    fn try_from(message: wire::ResultHeader) -> Result<Self, WireError> {
        let unit = Unit::try_from(message.unit.ok_or(WireError::Missing("result.unit"))?)?;
        // At most RESULT_BYTES_MAX, since tiles are bounded.
        let longest = unit.tile.area() * PIXEL_BYTES_MAX as u64;
        Ok(Self {
            worker: WorkerId(message.worker),
            fence: Fence(message.fence),
            key: digest(&message.key, "result.key")?,
            trace: Duration::from_micros(message.trace_us),
            waited: Duration::from_micros(message.waited_us),
            bytes: within(message.bytes, 0..=longest, "result.bytes")? as usize,
            unit,
        })
    }
}

impl ResultHeader {
    /// The sums that follow the header, checked.
    ///
    /// # Errors
    /// Bytes that are not the sums of such a unit.
    pub fn sums(&self, bytes: &[u8]) -> Result<TileSums, WireError> {
        let Unit { tile, samples, .. } = self.unit.clone();
        let pixels = sums::decode(bytes, tile.area() as usize)?;
        let sums = TileSums { tile, samples, pixels };
        if sums.check() { Ok(sums) } else { Err(WireError::Unbounded) }
    }
}

impl From<Verdict> for wire::SubmitReply {
    fn from(verdict: Verdict) -> Self {
        let verdict = match verdict {
            Verdict::Accepted => wire::Verdict::Accepted,
            Verdict::Duplicate => wire::Verdict::Duplicate,
            Verdict::Stale => wire::Verdict::Stale,
            Verdict::Ended => wire::Verdict::Ended,
        };
        Self { verdict: verdict.into() }
    }
}

impl TryFrom<wire::SubmitReply> for Verdict {
    type Error = WireError;

    fn try_from(message: wire::SubmitReply) -> Result<Self, WireError> {
        match message.verdict() {
            wire::Verdict::Accepted => Ok(Self::Accepted),
            wire::Verdict::Duplicate => Ok(Self::Duplicate),
            wire::Verdict::Stale => Ok(Self::Stale),
            wire::Verdict::Ended => Ok(Self::Ended),
            wire::Verdict::Unspecified => Err(WireError::Enum { field: "submit.verdict", value: message.verdict }),
        }
    }
}

/// A unit that could not be done: who held it, under which lease, and why.
impl TryFrom<wire::FailRequest> for (WorkerId, Fence, JobId, Failure) {
    type Error = WireError;

    fn try_from(message: wire::FailRequest) -> Result<Self, WireError> {
        let kind = message.kind();
        let (worker, fence, job) = (WorkerId(message.worker), Fence(message.fence), JobId(message.job));
        let reason = text(message.message, FAILURE_BYTES_MAX, "fail.message")?;
        let failure = match kind {
            wire::FailureKind::Sample => Failure::Sample(reason),
            wire::FailureKind::Panic => Failure::Panic(reason),
            wire::FailureKind::Scene => Failure::Scene(reason),
            wire::FailureKind::Unspecified => {
                return Err(WireError::Enum { field: "fail.kind", value: message.kind });
            }
        };
        Ok((worker, fence, job, failure))
    }
}

impl From<(WorkerId, Fence, JobId, Failure)> for wire::FailRequest {
    fn from((worker, fence, job, failure): (WorkerId, Fence, JobId, Failure)) -> Self {
        let (kind, message) = match failure {
            Failure::Sample(text) => (wire::FailureKind::Sample, text),
            Failure::Panic(text) => (wire::FailureKind::Panic, text),
            Failure::Scene(text) => (wire::FailureKind::Scene, text),
        };
        let message = super::failure_text(message);
        Self { worker: worker.0, fence: fence.0, job: job.0, kind: kind.into(), message }
    }
}

impl TryFrom<wire::HeartbeatRequest> for Heartbeat {
    type Error = WireError;

    fn try_from(message: wire::HeartbeatRequest) -> Result<Self, WireError> {
        at_most(message.fences.len(), LEASES_HELD_MAX, "heartbeat.fences")?;
        let fences = message.fences.into_iter().map(Fence).collect();
        Ok(Self { worker: WorkerId(message.worker), fences, samples: message.samples })
    }
}

impl From<Heartbeat> for wire::HeartbeatRequest {
    fn from(heartbeat: Heartbeat) -> Self {
        let Heartbeat { worker, fences, samples } = heartbeat;
        Self { worker: worker.0, fences: fences.into_iter().map(|fence| fence.0).collect(), samples }
    }
}

impl From<HeartbeatReply> for wire::HeartbeatReply {
    fn from(reply: HeartbeatReply) -> Self {
        Self { drop: reply.drop.into_iter().map(|fence| fence.0).collect() }
    }
}

impl TryFrom<wire::LeaveRequest> for Leave {
    type Error = WireError;

    fn try_from(message: wire::LeaveRequest) -> Result<Self, WireError> {
        at_most(message.keep.len(), LEASES_HELD_MAX, "leave.keep")?;
        Ok(Self { worker: WorkerId(message.worker), keep: message.keep.into_iter().map(Fence).collect() })
    }
}

impl From<Leave> for wire::LeaveRequest {
    fn from(leave: Leave) -> Self {
        Self { worker: leave.worker.0, keep: leave.keep.into_iter().map(|fence| fence.0).collect() }
    }
}

impl TryFrom<wire::HeartbeatReply> for HeartbeatReply {
    type Error = WireError;

    fn try_from(message: wire::HeartbeatReply) -> Result<Self, WireError> {
        at_most(message.drop.len(), LEASES_HELD_MAX, "heartbeat.drop")?;
        Ok(Self { drop: message.drop.into_iter().map(Fence).collect() })
    }
}
