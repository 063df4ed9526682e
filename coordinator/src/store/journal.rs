//! The journals' writer: one thread that appends, syncs once a second, and tidies up behind snapshots.

use super::{Broken, END_KIND, EndRecord, KeptJob, StoreError, put_record};
use crate::disk::{Disk, Output};
use crate::ledger::audit::Contributor;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender};
use std::time::{Duration, Instant};
use tilecast_core::film::records::{Kind, RecordWriter};
use tilecast_core::settings::Window;
use tilecast_proto::types::JobId;

/// What a journal begins with.
pub const JOURNAL_KIND: Kind = *b"tilecast jrnl 01";
/// What was appended is on the disk after this, whatever happens to the power.
const SYNC_INTERVAL: Duration = Duration::from_secs(1);
/// A journal is followed by a snapshot when it is longer than this,
const SNAPSHOT_BYTES_MIN: u64 = 64 << 20;
/// and longer than the film by this factor: snapshots then cost a third of what the journal does.
const SNAPSHOT_FACTOR: u64 = 3;

/// Something that changed a film.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Entry {
    /// A unit was merged.
    Unit {
        /// Its pixels.
        tile: Window,
        /// Its samples.
        samples: Range<u32>,
        /// Who brought it, where that is kept apart; else 0.
        contributor: Contributor,
        /// Its sums, as they travel.
        sums: bytes::Bytes,
    },
    /// All units of a contributor were taken out.
    TakenOut(Contributor),
}

#[derive(Serialize, Deserialize)]
enum Record {
    Unit { tile: Window, samples: Range<u32>, contributor: Contributor },
    TakenOut(Contributor),
}

impl Entry {
    fn encode(&self) -> io::Result<Vec<u8>> {
        let (record, sums) = match self {
            Self::Unit { tile, samples, contributor, sums } => {
                (Record::Unit { tile: *tile, samples: samples.clone(), contributor: *contributor }, &sums[..])
            }
            Self::TakenOut(who) => (Record::TakenOut(*who), &[][..]),
        };
        let mut bytes = postcard::to_stdvec(&record).map_err(io::Error::other)?;
        bytes.extend_from_slice(sums);
        Ok(bytes)
    }

    /// The entry in a record; `None` for one that no writer makes.
    pub(super) fn decode(bytes: Vec<u8>) -> Option<Self> {
        let (record, rest) = postcard::take_from_bytes(&bytes).ok()?;
        let sums = bytes.len() - rest.len();
        Some(match record {
            Record::Unit { tile, samples, .. } if tile.x0 >= tile.x1 || tile.y0 >= tile.y1 || samples.is_empty() => {
                return None;
            }
            Record::Unit { tile, samples, contributor } => {
                Self::Unit { tile, samples, contributor, sums: bytes::Bytes::from(bytes).slice(sums..) }
            }
            Record::TakenOut(who) => Self::TakenOut(who),
        })
    }
}

/// What the writer is told, in this order.
pub(super) enum Command {
    Append(JobId, Entry),
    /// Whether a snapshot is due.
    SnapshotDue(JobId, SyncSender<bool>),
    /// Begins a new journal; says its generation.
    Roll(JobId, SyncSender<u64>),
    /// A snapshot of this generation is durable: what is older may go.
    Supersede(JobId, u64),
    End(JobId, EndRecord),
    Forget(JobId),
    Close,
}

pub(super) struct Writer {
    disk: Disk,
    /// Of all jobs.
    folder: PathBuf,
    jobs: BTreeMap<JobId, Journal>,
}

/// The journal of one job.
#[derive(Default)]
struct Journal {
    generation: u64,
    /// Made with the first entry.
    records: Option<RecordWriter<Output>>,
    /// Since the last snapshot.
    bytes: u64,
    snapshot_bytes: u64,
    dirty: bool,
}

impl Writer {
    /// Goes on behind what was recovered, each job in a journal of its own generation: a torn one is never appended to.
    pub(super) fn new(disk: Disk, folder: PathBuf, jobs: &[KeptJob]) -> Self {
        let journal = |job: &KeptJob| Journal {
            generation: job.generation + 1,
            bytes: job.journal_bytes,
            snapshot_bytes: job.snapshot_bytes,
            ..Journal::default()
        };
        let jobs = jobs.iter().map(|job| (job.job.id, journal(job))).collect();
        Self { disk, folder, jobs }
    }

    /// Works until it is told to close, everyone who could tell is gone, or the disk fails.
    pub(super) fn run(mut self, commands: &Receiver<Command>, broken: &Broken) {
        let mut synced = Instant::now();
        loop {
            let command = commands.recv_timeout(SYNC_INTERVAL.saturating_sub(synced.elapsed()));
            let ends = matches!(command, Ok(Command::Close) | Err(RecvTimeoutError::Disconnected));
            let mut done = match command {
                Ok(command) => self.obey(command),
                Err(_) => Ok(()),
            };
            if done.is_ok() && (ends || synced.elapsed() >= SYNC_INTERVAL) {
                done = self.sync();
                synced = Instant::now();
            }
            if let Err(source) = done {
                return broken.set(StoreError::Io { path: self.folder, source });
            }
            if ends {
                return;
            }
        }
    }

    fn obey(&mut self, command: Command) -> io::Result<()> {
        match command {
            Command::Append(job, entry) => self.append(job, &entry),
            Command::SnapshotDue(job, reply) => {
                let journal = self.jobs.entry(job).or_default();
                let limit = SNAPSHOT_BYTES_MIN.max(SNAPSHOT_FACTOR * journal.snapshot_bytes);
                // Whoever asked may be gone.
                let _ = reply.send(journal.bytes > limit);
                Ok(())
            }
            Command::Roll(job, reply) => {
                let journal = self.jobs.entry(job).or_default();
                if let Some(records) = journal.records.take() {
                    records.into_inner().sync()?;
                }
                *journal = Journal { generation: journal.generation + 1, ..Journal::default() };
                let _ = reply.send(journal.generation);
                Ok(())
            }
            Command::Supersede(job, generation) => self.supersede(job, generation),
            Command::End(job, record) => {
                self.sync()?;
                let folder = self.job(job);
                if let Some(journal) = self.jobs.get_mut(&job) {
                    journal.records = None;
                }
                put_record(&self.disk, &folder.join("end"), END_KIND, &record)
            }
            Command::Forget(job) => {
                self.jobs.remove(&job);
                self.disk.remove_folder(&self.job(job))
            }
            Command::Close => Ok(()),
        }
    }

    fn append(&mut self, job: JobId, entry: &Entry) -> io::Result<()> {
        let folder = self.job(job);
        let journal = self.jobs.entry(job).or_default();
        let payload = entry.encode()?;
        let records = match &mut journal.records {
            Some(records) => records,
            none => {
                let file = self.disk.create(&folder.join(format!("journal.{}", journal.generation)))?;
                let records = none.insert(RecordWriter::new(file, JOURNAL_KIND)?);
                self.disk.sync_folder(&folder)?;
                records
            }
        };
        records.put(&payload)?;
        journal.bytes += payload.len() as u64;
        journal.dirty = true;
        Ok(())
    }

    /// Removes what a snapshot has made superfluous.
    fn supersede(&mut self, job: JobId, generation: u64) -> io::Result<()> {
        let folder = self.job(job);
        for name in self.disk.names(&folder)? {
            if numbered(&name).is_some_and(|(_, older)| older < generation) {
                self.disk.remove(&folder.join(name))?;
            }
        }
        let bytes = std::fs::metadata(folder.join(format!("film.{generation}"))).map_or(0, |m| m.len());
        self.jobs.entry(job).or_default().snapshot_bytes = bytes;
        Ok(())
    }

    fn sync(&mut self) -> io::Result<()> {
        for journal in self.jobs.values_mut() {
            if std::mem::take(&mut journal.dirty)
                && let Some(records) = &journal.records
            {
                records.get_ref().sync()?;
            }
        }
        Ok(())
    }

    fn job(&self, job: JobId) -> PathBuf {
        self.folder.join(job.to_string())
    }
}

/// What a file in a job's folder is, and its generation.
pub(super) fn numbered(name: &str) -> Option<(&str, u64)> {
    let (what, generation) = name.split_once('.')?;
    Some((what, generation.parse().ok()?))
}

/// A folder's path, with a name.
pub(super) fn file(folder: &Path, what: &str, generation: u64) -> PathBuf {
    folder.join(format!("{what}.{generation}"))
}
