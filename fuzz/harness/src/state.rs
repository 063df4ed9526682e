//! Films on disk, and the journal of a coordinator that was killed.

use std::path::Path;
use std::time::Duration;
use tilecast_coordinator::disk::Disk;
use tilecast_coordinator::ledger::RestoredJob;
use tilecast_coordinator::store::{Entry, JOURNAL_KIND, Piece, Store};
use tilecast_core::film::file::{KIND, assemble, read};
use tilecast_core::film::records::{Kind, RecordWriter};
use tilecast_core::film::sums;
use tilecast_core::load::{LoadOptions, load};
use tilecast_core::scene::Digest;
use tilecast_core::settings::Settings;
use tilecast_proto::types::{JobId, JobSpec};

/// A film that a file promises and nobody has memory for is refused by its settings' limits; the fuzzer need not wait for it.
const FILM_PIXELS_MAX: u64 = 1 << 16;

/// Bytes as they are or, since no fuzzer guesses checksums, as the payloads of records that are whole: each has its length in two
/// bytes before it.
fn framed(bytes: &[u8], kind: Kind) -> Vec<u8> {
    let Some((&first, mut rest)) = bytes.split_first() else { return Vec::new() };
    if first % 2 == 0 {
        return rest.to_vec();
    }
    let mut records = RecordWriter::new(Vec::new(), kind).expect("a list takes all");
    while let Some((len, behind)) = rest.split_first_chunk::<2>() {
        let len = usize::from(u16::from_le_bytes(*len)).min(behind.len());
        records.put(&behind[..len]).expect("a list takes all");
        rest = &behind[len..];
    }
    records.into_inner()
}

/// A film file.
pub fn film(bytes: &[u8]) {
    let bytes = framed(bytes, KIND);
    if let Ok((head, parts)) = read(&bytes[..])
        && head.settings.validate().is_ok()
        && u64::from(head.settings.film.width) * u64::from(head.settings.film.height) <= FILM_PIXELS_MAX
        && let Ok(film) = assemble(&head.settings, &parts)
    {
        film.digest();
    }
}

/// The journal of a job, found at a start.
pub fn journal(bytes: &[u8]) {
    let folder = tempfile::tempdir().expect("a folder");
    let id = JobId(1);
    let spec = job(folder.path(), id);
    let path = folder.path().join("jobs").join(id.0.to_string()).join("journal.1");
    std::fs::write(path, framed(bytes, JOURNAL_KIND)).expect("a file");
    // A torn journal is no reason not to start.
    let (store, recovered) = Store::open(folder.path(), Disk::default()).expect("a state with a torn journal");
    assert_eq!(recovered.jobs.len(), 1);
    let taken = store.film(id, &spec, |piece| {
        if let Piece::Entry(Entry::Unit { tile, sums: bytes, .. }) = piece
            && tile.area() <= FILM_PIXELS_MAX
        {
            drop(sums::decode(&bytes, tile.area() as usize));
        }
    });
    taken.expect("a torn journal is read as far as it is whole");
    store.close();
}

/// As a scene asks for them that says nothing.
fn settings() -> Settings {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("scene.xml");
    std::fs::write(&path, "<scene version='3.0.0'><sensor type='perspective'/></scene>").expect("a file");
    load(&path, &LoadOptions::default()).expect("an empty scene").settings
}

/// A state of one job.
fn job(root: &Path, id: JobId) -> JobSpec {
    let spec = JobSpec::new(Digest::of(b"scene"), settings());
    let (store, _) = Store::open(root, Disk::default()).expect("a new state");
    let job = RestoredJob { id, spec: spec.clone(), owner: None, queued_at: Duration::ZERO, end: None };
    store.add_job(&job).expect("a job");
    store.close();
    spec
}
