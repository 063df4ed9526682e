//! The store's promises, with a disk that fails at every operation in turn.

use super::*;
use crate::disk::{Fault, Faults};
use crate::ledger::tests::settings;
use crate::otlp::way::Way;
use crate::{Config, Coordinator};
use std::sync::Arc;
use tilecast_core::film::{PixelSums, TileSums, sums};
use tilecast_core::settings::Window;
use tilecast_proto::convert::work_key;
use tilecast_proto::types::{JobSpec, LeaseRequest, ResultHeader, Unit, Verdict, WorkerInfo};

const SPP: u32 = 16;
/// The first job.
pub(crate) const JOB: JobId = JobId(1);

fn spec() -> JobSpec {
    JobSpec {
        tile: Some(16),
        name: "n".into(),
        workers_hold_scene: true,
        ..JobSpec::new(Digest([1; 32]), settings(32, 16, SPP))
    }
}

/// The sums of a unit: a function of its pixels and samples alone.
pub(crate) fn traced(unit: &Unit) -> TileSums {
    let mut tile = TileSums::new(unit.tile, unit.samples.clone());
    for (i, pixel) in tile.pixels.iter_mut().enumerate() {
        for sample in unit.samples.clone() {
            let mut one = PixelSums::default();
            let (x, y) = (unit.tile.x0 + i as u32 % 16, unit.tile.y0 + i as u32 / 16);
            one.0[sample as usize % 4][0] = i128::from(x * 1000 + y * 31 + sample);
            pixel.merge(&one);
        }
    }
    tile
}

pub(crate) fn expected() -> Digest {
    let mut film = tilecast_core::film::Film::new(&spec().settings);
    for x0 in [0, 16] {
        let tile = Window { x0, y0: 0, x1: x0 + 16, y1: 16 };
        film.merge(&traced(&Unit { job: JobId(1), tile, samples: 0..SPP }));
    }
    film.digest()
}

pub(crate) fn job_key() -> Digest {
    work_key(&spec().scene, &spec().settings)
}

/// A coordinator without a wire, and one worker that does `units` units of each job there is.
pub(crate) struct Session(pub Arc<crate::service::Shared>);

impl Session {
    fn open(root: &Path, disk: Disk) -> Result<Self, StoreError> {
        Self::with(&Config { state: Some(root.to_owned()), disk, ..Config::default() })
    }

    pub fn with(config: &Config) -> Result<Self, StoreError> {
        Ok(Self(Coordinator::open(config)?.shared))
    }

    pub fn state(&self) -> JobState {
        self.0.with_ledger(|ledger, now| ledger.progress(now, JOB)).unwrap().state
    }

    pub fn submit(&self) -> Option<JobId> {
        crate::service::submit(&self.0, spec(), None).ok()
    }

    /// Does up to `units` units; whether nothing is left to do.
    fn work(&self, units: usize) -> bool {
        let info = WorkerInfo {
            threads: 1,
            isa: String::new(),
            host: String::new(),
            pid: 1,
            name: String::new(),
            cpu: String::new(),
            instance: 3,
        };
        let worker = self.0.with_ledger(|ledger, now| ledger.register(now, info)).unwrap();
        let mut done = 0;
        while done < units {
            let request = LeaseRequest { worker, slots: 1, known_jobs: Vec::new() };
            let reply = self.0.with_ledger(|ledger, now| ledger.lease(now, &request)).unwrap();
            if reply.leases.is_empty() {
                return true;
            }
            for lease in reply.leases {
                let encoded: bytes::Bytes = sums::encode(&traced(&lease.unit).pixels).into();
                let header = ResultHeader {
                    worker,
                    fence: lease.fence,
                    key: job_key(),
                    unit: lease.unit,
                    trace: Duration::from_secs(1),
                    waited: Duration::ZERO,
                    bytes: encoded.len(),
                };
                let way = Way::brought(Duration::ZERO, &header, None);
                assert_eq!(self.0.merge(&header, encoded, way).unwrap(), Verdict::Accepted);
                done += 1;
            }
        }
        self.0.with_ledger(|ledger, _| ledger.leave(worker, &[]));
        false
    }

    pub fn film(&self, job: JobId) -> Digest {
        crate::service::whole_film(&self.0, job).unwrap().digest()
    }

    pub fn snapshot(&self, job: JobId) -> Result<(), StoreError> {
        self.0.films.snapshot(job, &spec(), true)
    }

    /// Ends it as a kill would: what the journal's thread has not taken is lost.
    pub fn close(self) {
        if let Some(store) = &self.0.store {
            store.close();
        }
    }
}

/// What a life of a coordinator does; the disk may fail anywhere in it. Gives the job if it was promised.
fn life(root: &Path, disk: Disk) -> Option<JobId> {
    let session = Session::open(root, disk).ok()?;
    let blob = Digest::of(b"blob");
    let _ = session.0.store.as_ref()?.put_blob(&blob, b"blob");
    let job = session.submit();
    if let Some(job) = job {
        session.work(3);
        let _ = session.snapshot(job);
        session.work(2);
    }
    session.close();
    job
}

/// ENOSPC, EIO, a torn write and a crash at every operation: what was promised is there afterwards, every sample counts
/// once, and the film is that of an undisturbed run. Fails if the journal is read without its checks, if a snapshot is not
/// renamed into place, or if entries that a snapshot holds are added again.
#[test]
fn a_disk_that_fails_anywhere_costs_nothing_that_was_promised() {
    let count = {
        let folder = tempfile::tempdir().unwrap();
        let (disk, faults) = Disk::failing(Faults::default());
        assert_eq!(life(folder.path(), disk), Some(JobId(1)));
        let seen = faults.lock().unwrap().seen;
        assert!((30..300).contains(&seen), "{seen} operations");
        seen
    };
    for fault in [Fault::Full, Fault::Io, Fault::Torn, Fault::Crash] {
        for at in 0..count {
            let folder = tempfile::tempdir().unwrap();
            let (disk, _) = Disk::failing(Faults { at, fault: Some(fault), seen: 0 });
            let promised = life(folder.path(), disk);
            let session = match Session::open(folder.path(), Disk::default()) {
                Ok(session) => session,
                Err(error) => panic!("{fault:?} at {at}: {error}"),
            };
            let job = match promised {
                Some(job) => job,
                // Not promised; it may be there all the same.
                None => match lock_jobs(&session).first() {
                    Some(&job) => job,
                    None => continue,
                },
            };
            assert!(session.work(100), "{fault:?} at {at}: no end");
            assert_eq!(session.film(job), expected(), "{fault:?} at {at}");
            session.close();
        }
    }
}

fn lock_jobs(session: &Session) -> Vec<JobId> {
    session.0.with_ledger(|ledger, _| ledger.jobs())
}

#[test]
fn a_second_coordinator_is_told_that_the_state_is_taken() {
    let folder = tempfile::tempdir().unwrap();
    let first = Session::open(folder.path(), Disk::default()).unwrap();
    let refusal = Session::open(folder.path(), Disk::default()).err().unwrap().to_string();
    assert!(refusal.contains("belongs to a coordinator that runs"), "{refusal}");
    first.close();
}

/// A job that ended is there, with its film, after any number of starts; and snapshots make journals superfluous.
#[test]
fn an_ended_job_keeps_its_film() {
    let folder = tempfile::tempdir().unwrap();
    let session = Session::open(folder.path(), Disk::default()).unwrap();
    let job = session.submit().unwrap();
    session.work(3);
    session.snapshot(job).unwrap();
    session.work(100);
    session.close();
    for _ in 0..2 {
        let session = Session::open(folder.path(), Disk::default()).unwrap();
        let progress = session.0.with_ledger(|ledger, now| ledger.progress(now, job)).unwrap();
        assert_eq!(progress.state, JobState::Finished);
        assert_eq!(session.film(job), expected());
        session.close();
    }
    let names = Disk::default().names(&folder.path().join("jobs/1")).unwrap();
    assert_eq!(names, ["end", "film.1", "job", "journal.1"]);
}

#[test]
fn a_damaged_snapshot_is_told_and_not_rendered_over() {
    let folder = tempfile::tempdir().unwrap();
    let session = Session::open(folder.path(), Disk::default()).unwrap();
    let job = session.submit().unwrap();
    session.work(3);
    session.snapshot(job).unwrap();
    session.close();
    let path = folder.path().join("jobs/1/film.1");
    let mut bytes = std::fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&path, bytes).unwrap();
    let error = Session::open(folder.path(), Disk::default()).err().unwrap().to_string();
    assert!(error.contains("film.1 is damaged") && error.contains("move its folder away"), "{error}");
}
