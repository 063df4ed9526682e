//! One session with the coordinator: from registration until the connection, the registration or the worker ends.
//!
//! A single loop owns all state. It keeps one request for work under way while there are free slots, brings results as they
//! come, and says every second which leases it holds. Calls run beside it and report to it; when the session ends they are
//! dropped, and the bench keeps what they carried.

use crate::bench::Bench;
use crate::pool::{Ticket, Traced};
use crate::scenes::{PrepareError, prepare};
use bytes::Bytes;
use std::collections::{BTreeMap, VecDeque};
use std::pin::Pin;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tilecast_core::scene::Digest;
use tilecast_core::trace::Tracer;
use tilecast_proto::client::{call, chunks};
use tilecast_proto::convert::{WireError, work_key};
use tilecast_proto::limits::{KNOWN_JOBS_MAX, MESSAGE_BYTES_MAX};
use tilecast_proto::transport::{Connector, Line, unheard};
use tilecast_proto::types::{
    Failure, Fence, Heartbeat, HeartbeatReply, JobId, JobWork, LeaseReply, LeaseRequest, Leave, ResultHeader, Verdict,
    Welcome, WorkerId, WorkerInfo,
};
use tilecast_proto::wire;
use tilecast_proto::wire::work_client::WorkClient;
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio::time::MissedTickBehavior;
use tonic::{Code, Request, Status};

/// Jobs remembered without holding a unit of them: each keeps its compiled scene in memory.
const IDLE_JOBS_MAX: usize = 2;
/// Results under way at a time: enough to fill the line, few enough not to hold up each other.
const SUBMITS_MAX: usize = 4;
/// A result may be large and the line slow.
const SUBMIT_TIMEOUT: Duration = Duration::from_secs(60);
/// Saying goodbye must not keep anyone.
const LEAVE_TIMEOUT: Duration = Duration::from_secs(1);

/// Why a session has ended.
#[derive(Debug)]
pub(crate) enum End {
    /// The worker was told to.
    Shutdown,
    /// The coordinator is gone, or does not know this worker any more: try again.
    Lost(String),
    /// The coordinator does not want this worker.
    Refused(String),
}

/// See the module.
pub(crate) struct Session {
    work: WorkClient<Line>,
    worker: WorkerId,
    threads: u32,
    heartbeat: Duration,
    jobs: BTreeMap<JobId, Job>,
    /// Jobs whose scene is to be prepared, one at a time: two may have the same.
    unprepared: VecDeque<JobId>,
    calls: JoinSet<Event>,
    leasing: bool,
    /// It was told to end: no more work is asked for.
    draining: bool,
    preparing: bool,
    submitting: usize,
}

/// A job as this session knows it.
struct Job {
    work: JobWork,
    key: Digest,
    tracer: Option<Arc<Tracer>>,
}

/// A call has ended.
enum Event {
    Leased(Result<LeaseReply, Status>),
    Submitted(Ticket, JobId, Result<Verdict, Status>),
    Beat(Result<HeartbeatReply, Status>),
    Prepared(JobId, Result<Arc<Tracer>, PrepareError>),
    Reported(Result<(), Status>),
}

impl Session {
    /// Connects and registers.
    pub async fn open(connector: &Connector, info: &WorkerInfo) -> Result<Self, End> {
        let channel = connector.connect().await.map_err(|e| End::Lost(e.to_string()))?;
        let mut work = WorkClient::new(channel)
            .max_decoding_message_size(MESSAGE_BYTES_MAX)
            .max_encoding_message_size(MESSAGE_BYTES_MAX);
        let hello = wire::Hello::from(info.clone());
        let lost = |status| unheard(&status).map_or_else(|| end(status), |e| End::Lost(e.to_string()));
        let welcome = work.register(call(hello)).await.map_err(lost)?.into_inner();
        let Welcome { worker, heartbeat } = welcome.try_into().map_err(|e: WireError| End::Refused(e.to_string()))?;
        tracing::info!(worker = worker.number(), "registered");
        Ok(Self {
            work,
            worker,
            threads: info.threads,
            heartbeat,
            jobs: BTreeMap::new(),
            unprepared: VecDeque::new(),
            calls: JoinSet::new(),
            leasing: false,
            draining: false,
            preparing: false,
            submitting: 0,
        })
    }

    /// Works until something ends it.
    pub async fn work(
        mut self,
        bench: &mut Bench,
        traced: &mut mpsc::UnboundedReceiver<Traced>,
        (mut shutdown, drain): (Pin<&mut impl Future<Output = ()>>, Duration),
    ) -> End {
        bench.begin_session();
        let mut beats = tokio::time::interval(self.heartbeat);
        beats.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut patience = std::pin::pin!(tokio::time::sleep(Duration::MAX));
        loop {
            if self.draining && bench.is_empty() {
                self.leave().await;
                return End::Shutdown;
            }
            self.start_calls(bench);
            tokio::select! {
                Some(unit) = traced.recv() => self.traced(bench, unit),
                Some(event) = self.calls.join_next() => {
                    let handled = match event {
                        Ok(event) => self.handle(bench, event),
                        Err(panic) => Err(End::Lost(panic.to_string())),
                    };
                    match handled {
                        // Nobody to bring anything to, and no time to wait for someone.
                        Err(End::Lost(_)) if self.draining => return End::Shutdown,
                        Err(end) => return end,
                        Ok(()) => {}
                    }
                }
                _ = beats.tick() => self.beat(bench),
                () = &mut shutdown, if !self.draining => {
                    self.draining = true;
                    patience.set(tokio::time::sleep(drain));
                    bench.drop_unbegun();
                    self.hand_back(bench);
                }
                () = &mut patience, if self.draining => bench.clear(),
            }
        }
    }

    /// Starts the calls that are due.
    fn start_calls(&mut self, bench: &mut Bench) {
        let slots = bench.free_slots(self.threads);
        if !self.leasing && !self.draining && slots > 0 {
            self.leasing = true;
            let known_jobs = self.jobs.keys().copied().take(KNOWN_JOBS_MAX).collect();
            let request = LeaseRequest { worker: self.worker, slots, known_jobs };
            self.calls.spawn(lease(self.work.clone(), request));
        }
        while self.submitting < SUBMITS_MAX
            && let Some((ticket, header, bytes)) = bench.next_result(Instant::now(), self.worker)
        {
            self.submitting += 1;
            self.calls.spawn(submit(self.work.clone(), ticket, header, bytes));
        }
        if !self.preparing
            && let Some(job) = self.unprepared.pop_front()
            && let Some(Job { work: description, .. }) = self.jobs.get(&job)
        {
            self.preparing = true;
            let (description, work) = (description.clone(), self.work.clone());
            let (scenes, pool, isa) = (Arc::clone(&bench.scenes), Arc::clone(&bench.pool), bench.isa);
            self.calls.spawn(async move { Event::Prepared(job, prepare(scenes, pool, work, description, isa).await) });
        }
    }

    fn handle(&mut self, bench: &mut Bench, event: Event) -> Result<(), End> {
        match event {
            Event::Leased(reply) => {
                self.leasing = false;
                self.leased(bench, reply.map_err(end)?);
            }
            Event::Submitted(ticket, job, verdict) => {
                self.submitting -= 1;
                let verdict = match verdict {
                    // The bytes were not understood; offering them again would not help.
                    Err(status) if status.code() == Code::InvalidArgument => {
                        tracing::error!(%status, "a result was refused");
                        Verdict::Stale
                    }
                    verdict => verdict.map_err(end)?,
                };
                bench.settle(ticket);
                if verdict == Verdict::Ended {
                    bench.drop_job(job);
                    self.jobs.remove(&job);
                }
            }
            Event::Beat(reply) => bench.drop_leases(&reply.map_err(end)?.drop),
            Event::Prepared(job, world) => {
                self.preparing = false;
                self.prepared(bench, job, world)?;
            }
            Event::Reported(reply) => reply.map_err(end)?,
        }
        Ok(())
    }

    fn leased(&mut self, bench: &mut Bench, reply: LeaseReply) {
        if self.draining {
            // They came too late; the next heartbeat does not name them, but sooner is better.
            self.hand_back(bench);
            return;
        }
        if reply.leases.is_empty() {
            return;
        }
        bench.set_unit_samples(reply.unit_samples);
        for work in reply.jobs {
            let key = work_key(&work.scene, &work.settings);
            self.unprepared.push_back(work.job);
            self.jobs.insert(work.job, Job { work, key, tracer: None });
        }
        for lease in reply.leases {
            // The description of a job that was forgotten meanwhile comes with the next lease; this one lapses.
            if let Some(job) = self.jobs.get(&lease.unit.job) {
                bench.take(lease, job.key, job.tracer.as_ref());
            }
        }
        // Oldest first: a job that comes again, because someone else's unit came back, is described again.
        let idle: Vec<JobId> = self.jobs.keys().copied().filter(|&job| !bench.holds(job)).collect();
        for job in &idle[..idle.len().saturating_sub(IDLE_JOBS_MAX)] {
            self.jobs.remove(job);
        }
    }

    fn prepared(&mut self, bench: &mut Bench, id: JobId, tracer: Result<Arc<Tracer>, PrepareError>) -> Result<(), End> {
        match (tracer, self.jobs.get_mut(&id)) {
            (_, None) => {}
            (Ok(tracer), Some(job)) => {
                bench.start_job(id, &tracer);
                job.tracer = Some(tracer);
            }
            // The connection, not the scene.
            (Err(PrepareError::Fetch { status, .. }), _) if status.code() != Code::NotFound => {
                return Err(end(*status));
            }
            (Err(error), Some(_)) => {
                self.jobs.remove(&id);
                for fence in bench.drop_job(id) {
                    self.report(fence, id, Failure::Scene(error.to_string()));
                }
            }
        }
        Ok(())
    }

    fn traced(&mut self, bench: &mut Bench, unit: Traced) {
        if let Some((fence, job, failure)) = bench.traced(unit) {
            tracing::error!(?failure, "a unit failed");
            self.report(fence, job, failure);
        }
    }

    fn report(&mut self, fence: Fence, job: JobId, failure: Failure) {
        let request = wire::FailRequest::from((self.worker, fence, job, failure));
        let mut work = self.work.clone();
        self.calls.spawn(async move { Event::Reported(work.fail(call(request)).await.map(|_| ())) });
    }

    fn beat(&mut self, bench: &Bench) {
        let beat = Heartbeat { worker: self.worker, fences: bench.fences(), samples: bench.samples };
        let mut work = self.work.clone();
        self.calls.spawn(async move {
            let reply = work.heartbeat(call(wire::HeartbeatRequest::from(beat))).await;
            Event::Beat(reply.and_then(|reply| Ok(reply.into_inner().try_into()?)))
        });
    }

    /// Gives back the leases that it does not hold any more.
    fn hand_back(&mut self, bench: &Bench) {
        let keep = bench.fences();
        if keep.is_empty() {
            // That would be the end of the session; results of the one before may be on their way.
            return;
        }
        let request = wire::LeaveRequest::from(Leave { worker: self.worker, keep });
        let mut work = self.work.clone();
        self.calls.spawn(async move { Event::Reported(work.leave(call(request)).await.map(|_| ())) });
    }

    async fn leave(&mut self) {
        let mut request = Request::new(wire::LeaveRequest { worker: self.worker.0, keep: Vec::new() });
        request.set_timeout(LEAVE_TIMEOUT);
        // If it does not arrive, the leases lapse.
        let _ = self.work.leave(request).await;
    }
}

async fn lease(mut work: WorkClient<Line>, request: LeaseRequest) -> Event {
    let reply = work.lease(call(wire::LeaseRequest::from(request))).await;
    Event::Leased(reply.and_then(|reply| Ok(reply.into_inner().try_into()?)))
}

async fn submit(mut work: WorkClient<Line>, ticket: Ticket, header: ResultHeader, bytes: Bytes) -> Event {
    let job = header.unit.job;
    let mut head = Some(wire::ResultHeader::from(header));
    let stream = chunks(bytes).map(move |data| wire::ResultChunk { header: head.take(), data });
    let mut request = Request::new(tokio_stream::iter(stream));
    request.set_timeout(SUBMIT_TIMEOUT);
    let reply = work.submit(request).await;
    Event::Submitted(ticket, job, reply.and_then(|reply| Ok(reply.into_inner().try_into()?)))
}

/// What a failed call means for the session.
fn end(status: Status) -> End {
    match status.code() {
        Code::FailedPrecondition
        | Code::InvalidArgument
        | Code::Unimplemented
        | Code::PermissionDenied
        | Code::Unauthenticated => End::Refused(status.message().to_owned()),
        _ => End::Lost(status.message().to_owned()),
    }
}
