//! What a worker has on its bench: the units it holds, from lease to verdict. It outlives sessions, so that what was traced
//! while the coordinator was away can be offered again. No calls here, and no clock.

use crate::pool::{Flags, Pool, Ticket, Traced};
use crate::scenes::SceneCache;
use bytes::Bytes;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};
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
    flags: Arc<Flags>,
    traced_at: Option<Instant>,
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
        let flags = Arc::default();
        let held = Held { fence, unit, key, current: true, flags, traced_at: None, stage: Stage::Waiting };
        self.held.insert(ticket, held);
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
            self.pool.trace(ticket, Arc::clone(tracer), held.unit.clone(), Arc::clone(&held.flags));
        }
    }

    /// A unit left the pool. A failure is given back to be reported, if its lease is of the session that goes on.
    pub fn traced(&mut self, Traced { ticket, at, result }: Traced) -> Option<(Fence, JobId, Failure)> {
        match result {
            Ok(Some((bytes, trace))) => {
                if let Some(held) = self.held.get_mut(&ticket) {
                    self.samples += held.unit.len();
                    let (fence, unit, key) = (held.fence, held.unit.clone(), held.key);
                    let (worker, waited) = (WorkerId(0), Duration::ZERO);
                    let header = ResultHeader { worker, fence, unit, key, trace, waited, bytes: bytes.len() };
                    held.traced_at = Some(at);
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
    pub fn next_result(&mut self, now: Instant, worker: WorkerId) -> Option<(Ticket, ResultHeader, Bytes)> {
        let (&ticket, held) = self.held.iter_mut().find(|(_, held)| matches!(held.stage, Stage::Traced(..)))?;
        let stage = std::mem::replace(&mut held.stage, Stage::Tracing);
        let Stage::Traced(header, bytes) = stage else { return None };
        let waited = held.traced_at.map_or(Duration::ZERO, |at| now.saturating_duration_since(at));
        let header = ResultHeader { worker, waited, ..header };
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

    /// Lets go of what no thread has begun.
    pub fn drop_unbegun(&mut self) {
        self.let_go(|held| match held.stage {
            Stage::Waiting => true,
            Stage::Tracing => !held.flags.begun.load(Ordering::Relaxed),
            Stage::Traced(..) | Stage::Sending(..) => false,
        });
    }

    /// Whether there is nothing to bring, now or later.
    pub fn is_empty(&self) -> bool {
        self.held.is_empty()
    }

    /// Stops everything.
    pub fn clear(&mut self) {
        self.let_go(|_| true);
    }

    fn let_go(&mut self, which: impl Fn(&Held) -> bool) {
        self.held.retain(|_, held| {
            let goes = which(held);
            if goes {
                held.flags.stop.store(true, Ordering::Relaxed);
            }
            !goes
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tilecast_core::scene::{Emitter, FovAxis, Scene, Sensor};
    use tilecast_core::settings::{
        Film, Filter, Integrator, IntegratorKind, SamplerKind, Settings, Strategy, Window, Without,
    };
    use tilecast_core::world::World;
    use tokio::sync::mpsc::UnboundedReceiver;

    const TILE: Window = Window { x0: 0, y0: 0, x1: 4, y1: 4 };

    /// An empty world under a grey sky; the scale decides whether its samples have values.
    fn tracer(scale_exponent: i32) -> Arc<Tracer> {
        let scene = Scene {
            sensor: Sensor::Perspective {
                to_world: glam::Affine3::IDENTITY,
                fov_degrees: 50.0,
                fov_axis: FovAxis::X,
                principal_point_offset: [0.0; 2],
                near_clip: 0.01,
                far_clip: 1e4,
                lens: None,
            },
            shapes: Vec::new(),
            bsdfs: Vec::new(),
            textures: Vec::new(),
            groups: Vec::new(),
            instances: Vec::new(),
            emitters: vec![Emitter::Constant { radiance: glam::Vec3::ONE }],
            meshes: Vec::new(),
            images: Vec::new(),
            origin: [0.0; 3],
        };
        let settings = Settings {
            film: Film { width: 4, height: 4, crop: TILE, filter: Filter::Box },
            spp: 64,
            seed: 0,
            integrator: Integrator { kind: IntegratorKind::Path, max_depth: None, rr_depth: 5, hide_emitters: false },
            strategy: Strategy::Mis,
            sampler: SamplerKind::Sobol,
            without: Without::default(),
            half: Default::default(),
            offsets: Default::default(),
            scale_exponent,
        };
        Arc::new(Tracer::new(Arc::new(World::compile(&scene)), settings, Isa::Portable).unwrap())
    }

    fn bench() -> (Bench, UnboundedReceiver<Traced>) {
        let (pool, traced) = Pool::new(1).unwrap();
        (Bench::new(pool, Arc::default(), Isa::Portable), traced)
    }

    fn lease(fence: u64) -> Lease {
        Lease { fence: Fence(fence), unit: Unit { job: JobId(1), tile: TILE, samples: 0..4 } }
    }

    const KEY: Digest = Digest([5; 32]);

    #[tokio::test]
    async fn what_was_traced_is_offered_again_to_the_next_coordinator() {
        let (mut bench, mut traced) = bench();
        let tracer = tracer(60);
        bench.take(lease(1), KEY, Some(&tracer));
        bench.take(lease(2), KEY, None);
        assert_eq!(bench.traced(traced.recv().await.unwrap()), None);
        let (_, sent, bytes) = bench.next_result(Instant::now(), WorkerId(1)).unwrap();
        assert_eq!((sent.worker, sent.fence, sent.key, sent.bytes), (WorkerId(1), Fence(1), KEY, bytes.len()));
        assert!(sent.sums(&bytes).is_ok());
        assert_eq!(bench.next_result(Instant::now(), WorkerId(1)), None, "sent twice");
        bench.begin_session();
        let later = Instant::now() + Duration::from_secs(9);
        let (ticket, again, bytes_again) = bench.next_result(later, WorkerId(9)).unwrap();
        assert_eq!((again.worker, again.unit, bytes_again), (WorkerId(9), sent.unit, bytes));
        assert!(again.waited >= Duration::from_secs(9), "it says how long it waited: {:?}", again.waited);
        // The one that was not begun is another's now, and neither is renewed.
        bench.start_job(JobId(1), &tracer);
        assert_eq!(bench.fences(), []);
        bench.settle(ticket);
        bench.begin_session();
        assert_eq!(bench.next_result(Instant::now(), WorkerId(9)), None);
    }

    #[tokio::test]
    async fn a_lease_that_is_dropped_is_not_traced_on() {
        let (mut bench, mut traced) = bench();
        // The pool's only thread is busy until the lease is dropped.
        let (go, wait) = std::sync::mpsc::channel::<()>();
        let pool = Arc::clone(&bench.pool);
        let busy = tokio::spawn(async move { pool.run(move || wait.recv()).await });
        tokio::task::yield_now().await;
        bench.take(lease(1), KEY, Some(&tracer(60)));
        assert_eq!(bench.fences(), [Fence(1)]);
        bench.drop_leases(&[Fence(1)]);
        assert_eq!(bench.fences(), []);
        go.send(()).unwrap();
        busy.await.unwrap();
        let unit = traced.recv().await.unwrap();
        assert_eq!(unit.result, Ok(None));
        assert_eq!(bench.traced(unit), None);
    }

    #[tokio::test]
    async fn a_sample_without_a_value_is_reported_with_its_replay() {
        let (mut bench, mut traced) = bench();
        bench.take(lease(7), KEY, Some(&tracer(300)));
        let (fence, job, failure) = bench.traced(traced.recv().await.unwrap()).unwrap();
        assert_eq!((fence, job), (Fence(7), JobId(1)));
        assert!(matches!(failure, Failure::Sample(text) if text.contains("--pixel 0,0 --sample 0")));
    }

    #[test]
    fn slots_are_counted_in_samples() {
        let (mut bench, _traced) = bench();
        bench.set_unit_samples(64);
        assert_eq!(bench.free_slots(3), 6);
        bench.take(lease(1), KEY, None);
        bench.take(lease(2), KEY, None);
        assert_eq!(bench.free_slots(3), 4);
        bench.set_unit_samples(1000);
        assert_eq!(bench.free_slots(3), 5);
        bench.set_unit_samples(1);
        assert_eq!(bench.free_slots(3), 0);
    }
}
