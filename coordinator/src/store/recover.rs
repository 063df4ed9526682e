//! What is found at the start: the jobs, and their films as far as they were kept.

use super::journal::{Entry, JOURNAL_KIND, file, numbered};
use super::{END_KIND, EndRecord, JOB_KIND, JobRecord, StoreError, damaged};
use crate::disk::Disk;
use crate::ledger::RestoredJob;
use prost::Message;
use serde::de::DeserializeOwned;
use std::io::Read;
use std::path::Path;
use tilecast_core::film::file::{FilmFileError, Head, Part, read};
use tilecast_core::film::records::{Kind, RecordError, RecordReader};
use tilecast_core::scene::Digest;
use tilecast_proto::types::{JobId, JobSpec, JobState};
use tilecast_proto::wire;

/// What a folder of state holds.
#[derive(Debug)]
pub struct Recovered {
    /// How often a coordinator was started with it, this time included.
    pub starts: u32,
    /// In the order of their numbers.
    pub jobs: Vec<KeptJob>,
    /// Parts of scenes, and their bytes; damaged ones are gone.
    pub blobs: Vec<(Digest, bytes::Bytes)>,
}

/// A job as it was kept. [`film`] reads what its film is made of.
#[derive(Clone, Debug)]
pub struct KeptJob {
    /// The job.
    pub job: RestoredJob,
    /// The engine it was begun with.
    pub engine: String,
    /// Of the newest file.
    pub(super) generation: u64,
    pub(super) journal_bytes: u64,
    pub(super) snapshot_bytes: u64,
}

pub(super) fn recover(disk: &Disk, root: &Path, starts: u32) -> Result<Recovered, StoreError> {
    let failed = |source| StoreError::Io { path: root.to_owned(), source };
    let folder = root.join("jobs");
    let mut jobs = Vec::new();
    for name in disk.names(&folder).map_err(failed)? {
        if let Ok(id) = name.parse() {
            jobs.extend(job(disk, &folder.join(name), JobId(id))?);
        }
    }
    jobs.sort_by_key(|job| job.job.id);
    let folder = root.join("blobs");
    let mut blobs = Vec::new();
    for name in disk.names(&folder).map_err(failed)? {
        let path = folder.join(&name);
        let mut bytes = Vec::new();
        if let Some(mut file) = disk.open(&path).map_err(failed)? {
            file.read_to_end(&mut bytes).map_err(failed)?;
        }
        let digest = Digest::of(&bytes);
        if digest.to_string() == name {
            blobs.push((digest, bytes.into()));
        } else {
            // Half written, or damaged: a job that needs it says so.
            disk.remove(&path).map_err(failed)?;
        }
    }
    Ok(Recovered { starts, jobs, blobs })
}

/// A job; `None` if the crash came before it was promised.
fn job(disk: &Disk, folder: &Path, id: JobId) -> Result<Option<KeptJob>, StoreError> {
    let failed = |source| StoreError::Io { path: folder.to_owned(), source };
    let path = folder.join("job");
    let Some(JobRecord { job, owner, queued_at, engine }) = record(disk, &path, JOB_KIND)? else {
        disk.remove_folder(folder).map_err(failed)?;
        return Ok(None);
    };
    let nonsense = |reason: String| StoreError::Damaged { path: path.clone(), reason };
    let job = wire::Job::decode(job.as_slice()).map_err(|e| nonsense(e.to_string()))?;
    let spec = JobSpec::try_from(job).map_err(|e| nonsense(e.to_string()))?;
    let end = record(disk, &folder.join("end"), END_KIND)?.map(|end| match end {
        EndRecord::Finished(at) => (JobState::Finished, at),
        EndRecord::Failed(at, why) => (JobState::Failed(why), at),
        EndRecord::Cancelled(at) => (JobState::Cancelled, at),
    });
    let names = disk.names(folder).map_err(failed)?;
    for name in names.iter().filter(|name| name.ends_with(".new")) {
        disk.remove(&folder.join(name)).map_err(failed)?;
    }
    let size = |path: &Path| std::fs::metadata(path).map_or(0, |m| m.len());
    let (snapshot, journals) = generations(&names);
    let journal_bytes = journals.iter().map(|&g| size(&file(folder, "journal", g))).sum();
    Ok(Some(KeptJob {
        job: RestoredJob { id, spec, owner, queued_at, end },
        engine,
        generation: names.iter().filter_map(|name| numbered(name)).map(|(_, g)| g).max().unwrap_or(0),
        journal_bytes,
        snapshot_bytes: snapshot.map_or(0, |g| size(&file(folder, "film", g))),
    }))
}

/// The newest snapshot, and the journals that are not older.
fn generations(names: &[String]) -> (Option<u64>, Vec<u64>) {
    let of = |wanted: &'static str| {
        names.iter().filter_map(|name| numbered(name)).filter(move |(what, _)| *what == wanted).map(|(_, g)| g)
    };
    let snapshot = of("film").max();
    let mut journals: Vec<u64> = of("journal").filter(|&g| g >= snapshot.unwrap_or(0)).collect();
    journals.sort_unstable();
    (snapshot, journals)
}

/// What a film is made of: the parts of a snapshot, then what came after it was begun; some of that may be in it already.
#[derive(Debug)]
pub enum Piece {
    /// Of the snapshot.
    Part(Part),
    /// Of a journal.
    Entry(Entry),
}

/// Reads the pieces of a job's film, in their order.
///
/// # Errors
/// A snapshot that is damaged or another job's, or whatever reading fails with.
pub(super) fn film(disk: &Disk, folder: &Path, spec: &JobSpec, take: &mut dyn FnMut(Piece)) -> Result<(), StoreError> {
    let failed = |source| StoreError::Io { path: folder.to_owned(), source };
    let (snapshot, journals) = generations(&disk.names(folder).map_err(failed)?);
    if let Some(generation) = snapshot {
        parts(disk, &file(folder, "film", generation), spec)?.into_iter().for_each(|part| take(Piece::Part(part)));
    }
    for generation in journals {
        entries(disk, &file(folder, "journal", generation), take)?;
    }
    Ok(())
}

/// The one record of a file; `None` if there is no file.
pub(super) fn record<T: DeserializeOwned>(disk: &Disk, path: &Path, kind: Kind) -> Result<Option<T>, StoreError> {
    let failed = |source| StoreError::Io { path: path.to_owned(), source };
    let Some(input) = disk.open(path).map_err(failed)? else { return Ok(None) };
    let payload = RecordReader::new(input, kind).and_then(|mut records| records.read());
    let payload = payload.map_err(|e| damaged(path, &e))?.ok_or_else(|| damaged(path, &RecordError::Torn(0)))?;
    let nonsense = |e: postcard::Error| StoreError::Damaged { path: path.to_owned(), reason: e.to_string() };
    postcard::from_bytes(&payload).map(Some).map_err(nonsense)
}

fn parts(disk: &Disk, path: &Path, spec: &JobSpec) -> Result<Vec<Part>, StoreError> {
    let failed = |source| StoreError::Io { path: path.to_owned(), source };
    let Some(input) = disk.open(path).map_err(failed)? else { return Ok(Vec::new()) };
    let of_another = || StoreError::Damaged { path: path.to_owned(), reason: "it is another job's film".into() };
    match read(input) {
        Ok((Head { scene, settings, .. }, parts)) if scene == spec.scene && settings == spec.settings => Ok(parts),
        Ok(_) => Err(of_another()),
        Err(FilmFileError::Record(RecordError::Io(source))) => Err(failed(source)),
        Err(error) => Err(StoreError::Damaged { path: path.to_owned(), reason: error.to_string() }),
    }
}

/// The entries of a journal, up to where a crash has torn it.
fn entries(disk: &Disk, path: &Path, take: &mut dyn FnMut(Piece)) -> Result<(), StoreError> {
    let failed = |source| StoreError::Io { path: path.to_owned(), source };
    let Some(input) = disk.open(path).map_err(failed)? else { return Ok(()) };
    let mut records = match RecordReader::new(input, JOURNAL_KIND) {
        Ok(records) => records,
        Err(RecordError::Io(source)) => return Err(failed(source)),
        // Torn within its first bytes.
        Err(_) => return Ok(()),
    };
    loop {
        match records.read() {
            Ok(Some(payload)) => match Entry::decode(payload) {
                Some(entry) => take(Piece::Entry(entry)),
                None => return Ok(()),
            },
            Ok(None) => return Ok(()),
            Err(RecordError::Io(source)) => return Err(failed(source)),
            Err(torn) => {
                tracing::warn!(journal = %path.display(), %torn, "the journal's end is dropped; those units are done again");
                return Ok(());
            }
        }
    }
}
