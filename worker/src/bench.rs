//! What a worker has on its bench: the units it holds, from lease to verdict. It outlives sessions, so that what was traced
//! while the coordinator was away can be offered again. No calls here, and no clock.

use crate::pool::{Pool, Ticket, Traced};
use crate::scenes::SceneCache;
use bytes::Bytes;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use tilecast_core::bvh::simd::Isa;
use tilecast_core::scene::Digest;
use tilecast_core::trace::Tracer;
use tilecast_proto::limits::{SLOTS_MAX, SLOTS_PER_THREAD};
use tilecast_proto::types::{Failure, Fence, JobId, Lease, ResultHeader, Unit, WorkerId};

/// Results that wait for their verdict, in units of what the bench can hold: beyond it the way to the coordinator is too slow,
/// and no more work is asked for.
const RESULTS_SHARE: usize = 2;

pub(crate) struct Bench {
    pub pool: Arc<Pool>,
    pub scenes: Arc<SceneCache>,
    pub isa: Isa,
    held: BTreeMap<Ticket, Held>,
    next_ticket: Ticket,
    /// Samples that one slot stands for, as the coordinator said last.
    unit_samples: u64,
    /// Samples traced since the worker began.
    pub samples: u64,
}

#[derive(Debug)]
struct Held {
    fence: Fence,
    unit: Unit,
    key: Digest,
    /// Leased in the session that goes on.
    current: bool,
    stop: Arc<AtomicBool>,
    stage: Stage,
}

#[derive(Debug)]
enum Stage {
    /// Its scene is not ready.
    Waiting,
    /// In the pool, or queued there.
    Tracing,
    /// The result is to be brought.
    Traced(ResultHeader, Bytes),
    /// It is on its way.
    Sending(ResultHeader, Bytes),
}

impl Bench {
    pub fn new(pool: Pool, scenes: Arc<SceneCache>, isa: Isa) -> Self {
        Self { pool: Arc::new(pool), scenes, isa, held: BTreeMap::new(), next_ticket: 0, unit_samples: 1, samples: 0 }
    }

    /// A session begins: leases of the one before are another's by now. What is being traced may still count; what is not
    /// begun may as well be done by whoever has it now; what is traced is offered again.
    pub fn begin_session(&mut self) {
        self.held.retain(|_, held| !matches!(held.stage, Stage::Waiting));
        for held in self.held.values_mut() {
            held.current = false;
            held.stage = match std::mem::replace(&mut held.stage, Stage::Tracing) {
                Stage::Sending(header, bytes) => Stage::Traced(header, bytes),
                stage => stage,
            };
        }
    }

    /// How many units to ask for; 0 while there is enough to do.
    pub fn free_slots(&self, threads: u32) -> u32 {
        let slots = (threads * SLOTS_PER_THREAD).min(SLOTS_MAX);
        let is_result = |held: &&Held| matches!(held.stage, Stage::Traced(..) | Stage::Sending(..));
        let results = self.held.values().filter(is_result).count();
        if results >= RESULTS_SHARE * slots as usize {
            return 0;
        }
        let untraced: u64 = self.held.values().filter(|h| !is_result(h)).map(|h| h.unit.len()).sum();
        let busy = untraced.div_ceil(self.unit_samples);
        slots - u32::try_from(busy).unwrap_or(slots).min(slots)
    }

    /// Notes the size of a slot.
    pub fn set_unit_samples(&mut self, samples: u64) {
        self.unit_samples = samples.max(1);
    }

    /// Takes a lease; with a tracer it goes to the pool, without one it waits for [`Bench::start_job`].
    pub fn take(&mut self, lease: Lease, key: Digest, tracer: Option<&Arc<Tracer>>) {
        let Lease { fence, unit } = lease;
        let ticket = self.next_ticket;
        self.next_ticket += 1;
        let stop = Arc::new(AtomicBool::new(false));
        self.held.insert(ticket, Held { fence, unit, key, current: true, stop, stage: Stage::Waiting });
        if let Some(tracer) = tracer {
            self.start(ticket, tracer);
        }
    }

    /// A job's tracer is ready: what waited for it goes to the pool.
    pub fn start_job(&mut self, job: JobId, tracer: &Arc<Tracer>) {
        let waiting = |held: &Held| held.current && held.unit.job == job && matches!(held.stage, Stage::Waiting);
        let tickets: Vec<Ticket> = self.held.iter().filter(|(_, held)| waiting(held)).map(|(&t, _)| t).collect();
        tickets.into_iter().for_each(|ticket| self.start(ticket, tracer));
    }

    fn start(&mut self, ticket: Ticket, tracer: &Arc<Tracer>) {
        if let Some(held) = self.held.get_mut(&ticket) {
            held.stage = Stage::Tracing;
            self.pool.trace(ticket, Arc::clone(tracer), held.unit.clone(), Arc::clone(&held.stop));
        }
    }

    /// A unit left the pool. A failure is given back to be reported, if its lease is of the session that goes on.
    pub fn traced(&mut self, Traced { ticket, result }: Traced) -> Option<(Fence, JobId, Failure)> {
        match result {
            Ok(Some((bytes, trace))) => {
                if let Some(held) = self.held.get_mut(&ticket) {
                    self.samples += held.unit.len();
                    let (fence, unit, key) = (held.fence, held.unit.clone(), held.key);
                    let worker = WorkerId(0);
                    let header = ResultHeader { worker, fence, unit, key, trace, bytes: bytes.len() };
                    held.stage = Stage::Traced(header, bytes.into());
                }
                None
            }
            Ok(None) => {
                self.held.remove(&ticket);
                None
            }
            Err(failure) => {
                let held = self.held.remove(&ticket).filter(|held| held.current)?;
                Some((held.fence, held.unit.job, failure))
            }
        }
    }

    /// The next result to bring; it is kept until [`Bench::settle`].
    pub fn next_result(&mut self, worker: WorkerId) -> Option<(Ticket, ResultHeader, Bytes)> {
        let (&ticket, held) = self.held.iter_mut().find(|(_, held)| matches!(held.stage, Stage::Traced(..)))?;
        let stage = std::mem::replace(&mut held.stage, Stage::Tracing);
        let Stage::Traced(header, bytes) = stage else { return None };
        let header = ResultHeader { worker, ..header };
        held.stage = Stage::Sending(header.clone(), bytes.clone());
        Some((ticket, header, bytes))
    }

    /// A result has its verdict.
    pub fn settle(&mut self, ticket: Ticket) {
        self.held.remove(&ticket);
    }

    /// The leases of this session, to be renewed.
    pub fn fences(&self) -> Vec<Fence> {
        self.held.values().filter(|held| held.current).map(|held| held.fence).collect()
    }

    /// Lets go of these leases, and stops tracing them.
    pub fn drop_leases(&mut self, fences: &[Fence]) {
        self.let_go(|held| held.current && fences.contains(&held.fence));
    }

    /// Lets go of all leases of a job; gives them, to be reported.
    pub fn drop_job(&mut self, job: JobId) -> Vec<Fence> {
        let of_job = |held: &Held| held.current && held.unit.job == job;
        let fences = self.held.values().filter(|held| of_job(held)).map(|held| held.fence).collect();
        self.let_go(of_job);
        fences
    }

    /// Whether any unit of a job is held in this session.
    pub fn holds(&self, job: JobId) -> bool {
        self.held.values().any(|held| held.current && held.unit.job == job)
    }

    /// Stops everything.
    pub fn clear(&mut self) {
        self.let_go(|_| true);
    }

    fn let_go(&mut self, which: impl Fn(&Held) -> bool) {
        self.held.retain(|_, held| {
            let goes = which(held);
            if goes {
                held.stop.store(true, Ordering::Relaxed);
            }
            !goes
        });
    }
}
