//! What survives the coordinator: its jobs, the scenes they need, and their films, in a folder.
//!
//! ```text
//! lock                 held while a coordinator runs
//! coordinator          how often one was started here
//! blobs/DIGEST         parts of scenes
//! jobs/N/job           what was asked
//! jobs/N/film.G        a snapshot: a film file
//! jobs/N/journal.G     units counted since snapshot G was begun
//! jobs/N/end           how it ended
//! ```
//!
//! A unit is appended to its job's journal when it is merged. A snapshot begins with a new journal, copies the film tile by
//! tile while others go on merging, and replaces the older files when it is whole. Units are applied to a film only where it
//! does not have them: a unit that is both in a snapshot and in the journal beside it counts once.
//!
//! A journal's end may be torn: what is behind the last valid record is dropped and done again. Everything else is written
//! beside, synced and renamed; if that is damaged, so is the disk, and people must decide.

mod journal;
mod recover;

pub use journal::{Entry, JOURNAL_KIND};
pub use recover::{KeptJob, Piece, Recovered};

use crate::disk::Disk;
use crate::ledger::RestoredJob;
use journal::{Command, Writer};
use prost::Message;
use serde::{Deserialize, Serialize};
use std::fs::{File, TryLockError};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;
use tilecast_core::film::file::{FilmWriter, Head, Part};
use tilecast_core::film::records::{Kind, RecordError, RecordWriter};
use tilecast_core::scene::Digest;
use tilecast_proto::types::{JobId, JobSpec, JobState};
use tilecast_proto::wire;
use tokio_util::sync::CancellationToken;

const JOB_KIND: Kind = *b"tilecast job  03";
const END_KIND: Kind = *b"tilecast end  01";
const STARTS_KIND: Kind = *b"tilecast strt 01";
/// Entries on their way to the disk: a slow disk holds up workers rather than filling the memory.
const QUEUE_LEN: usize = 32;

/// State that cannot be kept or had.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The system refuses.
    #[error(
        "the state in {path} cannot be kept: {source}; when there is room and the disk is sound, start the coordinator again with the same --state, and it goes on"
    )]
    Io {
        /// Where.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Another coordinator has it.
    #[error("the state in {0} belongs to a coordinator that runs; end that one, or take another folder")]
    Taken(PathBuf),
    /// Not as it was written.
    #[error("{path} is damaged: {reason}; to go on without that job, move its folder away")]
    Damaged {
        /// Which file.
        path: PathBuf,
        /// What is the matter.
        reason: String,
    },
}

/// See the module.
#[derive(Debug)]
pub struct Store {
    disk: Disk,
    root: PathBuf,
    journal: SyncSender<Command>,
    writer: Mutex<Option<JoinHandle<()>>>,
    broken: Arc<Broken>,
    _lock: File,
}

/// Set when the state cannot be kept any more: then the coordinator must end, since it would promise what it cannot hold.
#[derive(Debug, Default)]
pub struct Broken {
    error: Mutex<Option<StoreError>>,
    /// Cancelled then.
    pub token: CancellationToken,
}

impl Broken {
    fn set(&self, error: StoreError) {
        self.error.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
        self.token.cancel();
    }

    /// Why.
    pub fn take(&self) -> Option<StoreError> {
        self.error.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

#[derive(Serialize, Deserialize)]
struct JobRecord {
    /// As it came over the wire, and checked again as if it did.
    job: Vec<u8>,
    owner: Option<Digest>,
    queued_at: Duration,
    engine: String,
}

#[derive(Serialize, Deserialize)]
enum EndRecord {
    Finished(Duration),
    Failed(Duration, String),
    Cancelled(Duration),
}

impl Store {
    /// Opens a folder, or makes it, and reads what is there.
    ///
    /// # Errors
    /// A folder that is another's, cannot be read or written, or is damaged.
    pub fn open(root: &Path, disk: Disk) -> Result<(Self, Recovered), StoreError> {
        let failed = |source| StoreError::Io { path: root.to_owned(), source };
        disk.create_folder(&root.join("jobs")).map_err(failed)?;
        disk.create_folder(&root.join("blobs")).map_err(failed)?;
        let lock = File::create(root.join("lock")).map_err(failed)?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(StoreError::Taken(root.to_owned())),
            Err(TryLockError::Error(source)) => return Err(failed(source)),
        }
        let starts = recover::record::<u32>(&disk, &root.join("coordinator"), STARTS_KIND)?.unwrap_or(0) + 1;
        put_record(&disk, &root.join("coordinator"), STARTS_KIND, &starts).map_err(failed)?;
        let recovered = recover::recover(&disk, root, starts)?;
        let broken = Arc::new(Broken::default());
        let (journal, commands) = std::sync::mpsc::sync_channel(QUEUE_LEN);
        let writer = Writer::new(disk.clone(), root.join("jobs"), &recovered.jobs);
        let told = Arc::clone(&broken);
        let thread = std::thread::Builder::new()
            .name("journal".into())
            .spawn(move || writer.run(&commands, &told))
            .map_err(failed)?;
        let writer = Mutex::new(Some(thread));
        Ok((Self { disk, root: root.to_owned(), journal, writer, broken, _lock: lock }, recovered))
    }

    /// See [`Broken`].
    pub fn broken(&self) -> Arc<Broken> {
        Arc::clone(&self.broken)
    }

    /// The state cannot be kept any more.
    pub fn fail(&self, error: StoreError) {
        self.broken.set(error);
    }

    /// Keeps a part of a scene. Durable when it returns.
    ///
    /// # Errors
    /// The disk's; nothing is kept then, and the coordinator can go on.
    pub fn put_blob(&self, digest: &Digest, bytes: &[u8]) -> Result<(), StoreError> {
        let path = self.blob(digest);
        self.disk.replace(&path, |file| file.write_all(bytes)).map_err(|source| StoreError::Io { path, source })
    }

    /// Lets a part of a scene go.
    pub fn drop_blob(&self, digest: &Digest) {
        // What stays behind is found at the next start.
        let _ = self.disk.remove(&self.blob(digest));
    }

    /// Keeps a job. Durable when it returns.
    ///
    /// # Errors
    /// The disk's; the job must not be promised then.
    pub fn add_job(&self, job: &RestoredJob) -> Result<(), StoreError> {
        let folder = self.job(job.id);
        let record = JobRecord {
            job: wire::Job::from(job.spec.clone()).encode_to_vec(),
            owner: job.owner,
            queued_at: job.queued_at,
            engine: tilecast_core::VERSION.to_owned(),
        };
        let kept = self
            .disk
            .create_folder(&folder)
            .and_then(|()| put_record(&self.disk, &folder.join("job"), JOB_KIND, &record))
            .and_then(|()| self.disk.sync_folder(&self.root.join("jobs")));
        if kept.is_err() {
            let _ = self.disk.remove_folder(&folder);
        }
        kept.map_err(|source| StoreError::Io { path: folder, source })
    }

    /// Reads what a job's film is made of, in order.
    ///
    /// # Errors
    /// The disk's, or damage.
    pub fn film(&self, id: JobId, spec: &JobSpec, mut take: impl FnMut(Piece)) -> Result<(), StoreError> {
        recover::film(&self.disk, &self.job(id), spec, &mut take)
    }

    /// Appends to a job's journal; on the disk within about a second.
    pub fn append(&self, job: JobId, entry: Entry) {
        self.send(Command::Append(job, entry));
    }

    /// A job has ended. Its film stays.
    pub fn end_job(&self, job: JobId, state: &JobState, at: Duration) {
        let record = match state {
            JobState::Finished => EndRecord::Finished(at),
            JobState::Failed(why) => EndRecord::Failed(at, why.clone()),
            JobState::Cancelled | JobState::Queued | JobState::Running => EndRecord::Cancelled(at),
        };
        // Behind the last unit: whoever finds the end finds the whole film.
        self.send(Command::End(job, record));
    }

    /// A job is forgotten, with all that was kept for it.
    pub fn forget_job(&self, job: JobId) {
        self.send(Command::Forget(job));
    }

    /// Whether a job's journal has grown so much that a snapshot is due; then [`Store::begin_snapshot`] should follow.
    pub fn snapshot_due(&self, job: JobId) -> bool {
        let (reply, answer) = std::sync::mpsc::sync_channel(1);
        self.send(Command::SnapshotDue(job, reply));
        answer.recv().unwrap_or(false)
    }

    /// Begins a snapshot: units that are appended from now on go to the journal beside it. Whoever calls copies the film
    /// after this.
    ///
    /// # Errors
    /// The disk's.
    pub fn begin_snapshot(&self, job: JobId, head: &Head) -> Result<Snapshot<'_>, StoreError> {
        let (reply, answer) = std::sync::mpsc::sync_channel(1);
        self.send(Command::Roll(job, reply));
        let path = self.job(job);
        let gone = || StoreError::Io { path: path.clone(), source: io::Error::other("the journal has ended") };
        let generation = answer.recv().map_err(|_| gone())?;
        let path = path.join(format!("film.{generation}.new"));
        let failed = |source| StoreError::Io { path: path.clone(), source };
        let file = BufWriter::with_capacity(1 << 20, self.disk.create(&path).map_err(failed)?);
        let film = FilmWriter::new(file, head).map_err(failed)?;
        Ok(Snapshot { store: self, job, generation, path, film })
    }

    /// Writes out what is on its way, and ends.
    pub fn close(&self) {
        self.send(Command::Close);
        if let Some(writer) = self.writer.lock().unwrap_or_else(PoisonError::into_inner).take() {
            // A panic there was told as it happened.
            let _ = writer.join();
        }
    }

    fn send(&self, command: Command) {
        // The writer ends with an error, which the coordinator is told by `broken`, or at close.
        let _ = self.journal.send(command);
    }

    fn job(&self, job: JobId) -> PathBuf {
        self.root.join("jobs").join(job.to_string())
    }

    fn blob(&self, digest: &Digest) -> PathBuf {
        self.root.join("blobs").join(digest.to_string())
    }
}

/// A snapshot being written.
#[derive(Debug)]
pub struct Snapshot<'a> {
    store: &'a Store,
    job: JobId,
    generation: u64,
    path: PathBuf,
    film: FilmWriter<BufWriter<crate::disk::Output>>,
}

impl Snapshot<'_> {
    /// Adds a part.
    ///
    /// # Errors
    /// The disk's.
    pub fn part(&mut self, part: &Part) -> Result<(), StoreError> {
        self.film.part(part).map_err(|source| StoreError::Io { path: self.path.clone(), source })
    }

    /// Puts it in the place of what was before.
    ///
    /// # Errors
    /// The disk's; what was before holds.
    pub fn commit(self) -> Result<(), StoreError> {
        let Self { store, job, generation, path, film } = self;
        let failed = |source| StoreError::Io { path: path.clone(), source };
        let file = film.finish().and_then(|buffer| buffer.into_inner().map_err(io::IntoInnerError::into_error));
        file.and_then(|file| file.sync()).map_err(failed)?;
        let folder = store.job(job);
        let target = folder.join(format!("film.{generation}"));
        store.disk.rename(&path, &target).and_then(|()| store.disk.sync_folder(&folder)).map_err(failed)?;
        store.send(Command::Supersede(job, generation));
        Ok(())
    }
}

/// A file of one record.
fn put_record(disk: &Disk, path: &Path, kind: Kind, value: &impl Serialize) -> io::Result<()> {
    let payload = postcard::to_stdvec(value).map_err(io::Error::other)?;
    disk.replace(path, |file| RecordWriter::new(file, kind)?.put(&payload))
}

fn damaged(path: &Path, error: &RecordError) -> StoreError {
    StoreError::Damaged { path: path.to_owned(), reason: error.to_string() }
}

#[cfg(test)]
pub(crate) mod tests;
