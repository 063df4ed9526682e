//! A seeded simulation: the real ledger, films, store and the service's merging, with workers, a network, a clock and a disk
//! that misbehave. A failing seed replays exactly: `TILECAST_SEED=N cargo test -p tilecast-coordinator sim`.
//!
//! What is simulated: calls and answers that are lost, late (also past the death of whoever sent them and past restarts of the
//! coordinator) or come twice; workers that die, are cut off for up to 30 s, or are ten times slower; a coordinator that
//! crashes, whose journal is torn anywhere in what was not synced, and that is started again; pauses of the whole process;
//! snapshots at any time; and, with checks, a worker that lies.

use crate::otlp::way::Way;
use crate::store::tests::{JOB, Session, expected, job_key, traced};
use crate::{Config, disk::Disk};
use bytes::Bytes;
use std::path::Path;
use std::time::Duration;
use tilecast_core::film::sums;
use tilecast_core::sampler::mix64;
use tilecast_proto::types::{Heartbeat, JobState, Lease, LeaseRequest, ResultHeader, Verdict, WorkerId, WorkerInfo};

/// Time goes on in steps of this.
const STEP: Duration = Duration::from_millis(250);
/// After so many steps nothing goes wrong any more, so that the job ends.
const TROUBLE_STEPS: u32 = 160;
/// And by then it must have.
const STEPS_MAX: u32 = 2000;

/// Numbers from a seed.
struct Random(u64);

impl Random {
    fn below(&mut self, end: u64) -> u64 {
        self.0 = mix64(self.0);
        self.0 % end
    }

    fn chance(&mut self, percent: u64) -> bool {
        self.below(100) < percent
    }
}

struct Worker {
    instance: u64,
    id: Option<WorkerId>,
    /// With the step at which each is traced.
    held: Vec<(Lease, u32)>,
    /// Steps a unit takes.
    pace: u32,
    /// Nothing goes through until then.
    cut_until: u32,
    lies: bool,
}

/// A result on its way.
struct Parcel {
    arrives: u32,
    header: ResultHeader,
    bytes: Bytes,
}

struct Sim<'a> {
    random: Random,
    root: &'a Path,
    config: Config,
    /// None only while one coordinator follows another.
    session: Option<Session>,
    workers: Vec<Worker>,
    parcels: Vec<Parcel>,
    step: u32,
    next_instance: u64,
    /// Whether a liar is about. Then nobody crashes or is cut off: a coordinator forgets open checks, and a liar that is left
    /// alone is not checked.
    checked: bool,
}

impl<'a> Sim<'a> {
    fn new(seed: u64, root: &'a Path) -> Self {
        let mut random = Random(seed);
        let checked = random.chance(30);
        let verify = if checked { 0.3 } else { 0.0 };
        let config =
            Config { state: Some(root.to_owned()), verify, incarnation: seed as u32 & 0xffff, ..Config::default() };
        let session = Some(Session::with(&config).unwrap());
        session.as_ref().unwrap().submit().unwrap();
        let mut sim = Self {
            random,
            root,
            config,
            session,
            workers: Vec::new(),
            parcels: Vec::new(),
            step: 0,
            next_instance: 1,
            checked,
        };
        (0..4).for_each(|_| sim.join());
        sim
    }

    fn session(&self) -> &Session {
        self.session.as_ref().unwrap()
    }

    fn join(&mut self) {
        let instance = self.next_instance;
        self.next_instance += 1;
        let pace = if self.random.chance(20) { 20 } else { 1 + self.random.below(3) as u32 };
        let lies = self.checked && instance == 1;
        self.workers.push(Worker { instance, id: None, held: Vec::new(), pace, cut_until: 0, lies });
    }

    fn trouble(&mut self, percent: u64) -> bool {
        self.step < TROUBLE_STEPS && self.random.chance(percent)
    }

    /// Whether the job was finished; else a unit was set aside, since three workers died over it by chance.
    async fn run(mut self) -> bool {
        while self.session().state() != JobState::Finished {
            assert!(self.step < STEPS_MAX, "no end in sight: {:?}", self.session().state());
            if let JobState::Failed(why) = self.session().state() {
                assert!(why.contains("3 workers fell silent"), "{why}");
                return false;
            }
            self.step += 1;
            let pause = if self.trouble(1) { Duration::from_secs(30) } else { Duration::ZERO };
            tokio::time::advance(STEP + pause).await;
            self.session().0.expire(pause);
            for i in 0..self.workers.len() {
                self.act(i);
            }
            self.deliver();
            if !self.checked && self.trouble(2) {
                let i = self.random.below(self.workers.len() as u64) as usize;
                self.workers.swap_remove(i);
                self.join();
            }
            if !self.checked && self.trouble(3) {
                let i = self.random.below(self.workers.len() as u64) as usize;
                self.workers[i].cut_until = self.step + self.random.below(120) as u32;
            }
            if self.random.chance(5) {
                self.session().snapshot(JOB).unwrap();
            }
            // The end of a job is synced behind its last unit: there is nothing to tear then.
            if !self.checked && self.trouble(4) && !self.session().state().is_final() {
                self.crash();
            }
        }
        assert_eq!(self.session().film(JOB), expected());
        self.session.take().unwrap().close();
        // What was said to be finished is so for whoever comes next, too.
        let again = Session::with(&self.config).unwrap();
        assert_eq!(again.state(), JobState::Finished);
        assert_eq!(again.film(JOB), expected());
        again.close();
        true
    }

    /// What a worker's session does in a step.
    fn act(&mut self, i: usize) {
        if self.workers[i].cut_until > self.step {
            return;
        }
        let Worker { instance, id, .. } = self.workers[i];
        let Some(id) = id else {
            let info = WorkerInfo {
                threads: 1,
                isa: String::new(),
                host: String::new(),
                pid: 1,
                name: String::new(),
                cpu: String::new(),
                instance,
            };
            let registered = self.session().0.with_ledger(|ledger, now| ledger.register(now, info)).ok();
            // The answer may be lost: then the coordinator knows a worker that does not know itself.
            self.workers[i].id = registered.filter(|_| !self.trouble(10));
            return;
        };
        let fences = self.workers[i].held.iter().map(|(lease, _)| lease.fence).collect();
        let beat = Heartbeat { worker: id, fences, samples: 0 };
        if !self.trouble(10) {
            match self.session().0.with_ledger(|ledger, now| ledger.heartbeat(now, &beat)) {
                Ok(reply) => self.workers[i].held.retain(|(lease, _)| !reply.drop.contains(&lease.fence)),
                // A new session; what is being traced is offered all the same.
                Err(_) => self.workers[i].id = None,
            }
        }
        if self.workers[i].held.len() < 2 {
            let request = LeaseRequest { worker: id, slots: 1, known_jobs: Vec::new() };
            let reply = self.session().0.with_ledger(|ledger, now| ledger.lease(now, &request));
            let done = self.step + self.workers[i].pace;
            if let Ok(reply) = reply
                && !self.trouble(10)
            {
                self.workers[i].held.extend(reply.leases.into_iter().map(|lease| (lease, done)));
            }
        }
        self.bring(i, id);
    }

    /// Sends what is traced by now.
    fn bring(&mut self, i: usize, id: WorkerId) {
        let step = self.step;
        let (ready, rest) = std::mem::take(&mut self.workers[i].held).into_iter().partition(|(_, done)| *done <= step);
        self.workers[i].held = rest;
        let ready: Vec<(Lease, u32)> = ready;
        for (lease, _) in ready {
            let mut tile = traced(&lease.unit);
            if self.workers[i].lies && self.random.chance(30) {
                tile.pixels[0].0[0][0] += 1;
            }
            let bytes: Bytes = sums::encode(&tile.pixels).into();
            let trace = Duration::from_millis(2);
            let header = ResultHeader {
                worker: id,
                fence: lease.fence,
                unit: lease.unit,
                key: job_key(),
                trace,
                waited: Duration::ZERO,
                bytes: bytes.len(),
            };
            let copies = match self.random.below(10) {
                0 if step < TROUBLE_STEPS => 0,
                1 => 2,
                _ => 1,
            };
            for _ in 0..copies {
                let late = if self.trouble(20) { self.random.below(80) as u32 } else { 0 };
                self.parcels.push(Parcel { arrives: step + late, header: header.clone(), bytes: bytes.clone() });
            }
        }
    }

    fn deliver(&mut self) {
        let step = self.step;
        let (due, rest): (Vec<Parcel>, Vec<Parcel>) =
            std::mem::take(&mut self.parcels).into_iter().partition(|parcel| parcel.arrives <= step);
        self.parcels = rest;
        for Parcel { header, bytes, .. } in due {
            // As the service does: what is not wanted is not read.
            let wanted = self.session().0.with_ledger(|ledger, _| ledger.verdict(&header)) == Verdict::Accepted;
            if wanted {
                let way = Way::brought(Duration::ZERO, &header, None);
                self.session().0.merge(&header, bytes, way).unwrap();
            }
        }
    }

    /// The coordinator is gone; the end of its newest journal is torn somewhere. Another is started.
    fn crash(&mut self) {
        let folder = self.root.join("jobs").join(JOB.to_string());
        self.session.take().unwrap().close();
        let mut journals: Vec<(u64, std::path::PathBuf)> = Vec::new();
        for name in Disk::default().names(&folder).unwrap() {
            if let Some(generation) = name.strip_prefix("journal.") {
                journals.push((generation.parse().unwrap(), folder.join(&name)));
            }
        }
        if let Some((_, newest)) = journals.into_iter().max()
            && self.random.chance(70)
        {
            let len = std::fs::metadata(&newest).unwrap().len();
            let file = std::fs::OpenOptions::new().write(true).open(&newest).unwrap();
            file.set_len(len - self.random.below(len.min(20_000) + 1)).unwrap();
        }
        self.session = Some(Session::with(&self.config).unwrap());
    }
}

/// Fails, for instance, if a result is merged that was counted, if a torn journal is appended to, if leases of the dead do
/// not lapse, or if a liar's units stay.
#[tokio::test(start_paused = true)]
async fn whatever_goes_wrong_every_sample_counts_once() {
    let number = |name: &str| std::env::var(name).ok().and_then(|n| n.parse::<u64>().ok());
    let seeds = match number("TILECAST_SEED") {
        Some(seed) => seed..seed + 1,
        None => 0..number("TILECAST_SEEDS").unwrap_or(200),
    };
    let (mut runs, mut finished) = (0, 0);
    for seed in seeds {
        let folder = tempfile::tempdir().unwrap();
        let sim = Sim::new(seed, folder.path());
        let guard = Named(seed);
        runs += 1;
        finished += u32::from(sim.run().await);
        std::mem::forget(guard);
    }
    assert!(finished * 100 >= runs * 95, "{finished} of {runs} were finished");
}

/// Says which seed it was, if it fails.
struct Named(u64);

impl Drop for Named {
    fn drop(&mut self) {
        eprintln!("seed {} failed; replay it with TILECAST_SEED={}", self.0, self.0);
    }
}
