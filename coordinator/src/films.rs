//! The films of jobs, in memory, within a budget. With a store, every change is appended to the job's journal, and films that
//! had to go come back when someone asks for them.

mod canvas;
pub mod look;

use crate::ledger::audit::Contributor;
use crate::plan::Plan;
use crate::store::{Entry, Store, StoreError};
use bytes::Bytes;
use canvas::Canvas;
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tilecast_core::film::file::Head;
use tilecast_core::film::ranges::Ranges;
use tilecast_core::film::{PixelSums, REPLICATES, RelativeError, TileSums};
use tilecast_core::settings::Settings;
use tilecast_proto::convert::film_rows;
use tilecast_proto::types::{JobId, JobSpec};
use tilecast_proto::wire;

/// Memory of one pixel: its sums and counts.
const PIXEL_BYTES: u64 = (size_of::<PixelSums>() + REPLICATES * size_of::<u32>()) as u64;
/// Pixels looked at to estimate the error: enough for two digits, few enough for a few milliseconds.
const ERROR_PIXELS_MAX: u64 = 16 << 10;

/// No room for another film.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the film needs {need_mb} MB; this coordinator has {free_mb} of {limit_mb} MB free: render a crop, wait for other jobs to \
     end, or start it with more"
)]
pub struct NoRoom {
    need_mb: u64,
    free_mb: u64,
    limit_mb: u64,
}

/// See the module.
#[derive(Debug)]
pub struct Films {
    bytes_max: u64,
    /// Memory for what is kept apart by contributor, of each film; 0 if nothing is.
    apart_bytes_max: u64,
    store: Option<Arc<Store>>,
    slots: Mutex<BTreeMap<JobId, Slot>>,
}

#[derive(Debug)]
struct Slot {
    canvas: Arc<Mutex<Canvas>>,
    bytes: u64,
    /// The job has ended: the film is dropped when its room is needed.
    ended: bool,
    fetched: bool,
}

/// Room for a film, set aside until the job has a number.
#[derive(Debug)]
pub struct Reserved(Canvas, u64);

impl Films {
    /// No films, and room for `bytes_max`.
    pub fn new(bytes_max: u64, apart_bytes_max: u64, store: Option<Arc<Store>>) -> Self {
        Self { bytes_max, apart_bytes_max, store, slots: Mutex::default() }
    }

    /// Makes room for a film: films of ended jobs are dropped, fetched ones first, then the oldest. Callers take turns.
    ///
    /// # Errors
    /// No room even then; nothing is dropped.
    pub fn make_room(&self, settings: &Settings) -> Result<(), NoRoom> {
        let need = settings.film.crop.area() * PIXEL_BYTES;
        let mut slots = self.slots();
        let live: u64 = slots.values().filter(|slot| !slot.ended).map(|slot| slot.bytes).sum();
        if live + need > self.bytes_max {
            let mb = |bytes: u64| bytes >> 20;
            let free_mb = mb(self.bytes_max.saturating_sub(live));
            return Err(NoRoom { need_mb: mb(need), free_mb, limit_mb: mb(self.bytes_max) });
        }
        let mut used: u64 = slots.values().map(|slot| slot.bytes).sum();
        let mut ended: Vec<(bool, JobId)> =
            slots.iter().filter(|(_, slot)| slot.ended).map(|(&id, slot)| (!slot.fetched, id)).collect();
        ended.sort_unstable();
        for (_, id) in ended {
            if used + need <= self.bytes_max {
                break;
            }
            used -= slots.remove(&id).map_or(0, |slot| slot.bytes);
        }
        Ok(())
    }

    /// An empty film; call it where blocking is allowed, it may be large.
    pub fn reserve(&self, settings: &Settings, plan: Plan) -> Reserved {
        let canvas = Canvas::new(settings, plan, self.apart_bytes_max);
        Reserved(canvas, settings.film.crop.area() * PIXEL_BYTES)
    }

    /// A film as the store has it.
    ///
    /// # Errors
    /// The store's.
    pub fn restore(&self, id: JobId, spec: &JobSpec, plan: Plan) -> Result<Reserved, StoreError> {
        let mut film = self.reserve(&spec.settings, plan);
        if let Some(store) = &self.store {
            store.film(id, spec, |piece| film.0.restore(piece))?;
        }
        Ok(film)
    }

    /// Memory taken by all films.
    pub fn bytes(&self) -> u64 {
        self.slots().values().map(|slot| slot.bytes).sum()
    }

    /// Gives a film to a job.
    pub fn insert(&self, job: JobId, Reserved(canvas, bytes): Reserved, ended: bool) {
        let canvas = Arc::new(Mutex::new(canvas));
        self.slots().insert(job, Slot { canvas, bytes, ended, fetched: false });
    }

    /// Whether the film is in memory.
    pub fn has(&self, job: JobId) -> bool {
        self.slots().contains_key(&job)
    }

    /// Adds a unit's sums, which the ledger has accepted; `encoded` are the same as they came. `false` if whoever brought it
    /// was banned meanwhile, and nothing was added.
    pub fn merge(&self, job: JobId, sums: &TileSums, who: Contributor, encoded: Bytes) -> bool {
        let Some(canvas) = self.canvas(job) else { return true };
        let mut canvas = lock(&canvas);
        if !canvas.merge(sums, who) {
            return false;
        }
        if let Some(store) = &self.store {
            let (tile, samples) = (sums.tile, sums.samples.clone());
            // Within the lock, so that a snapshot that begins in between has the unit.
            store.append(job, Entry::Unit { tile, samples, contributor: who, sums: encoded });
        }
        true
    }

    /// Takes out all that a contributor brought; says which samples of which tiles.
    pub fn take_out(&self, job: JobId, who: Contributor) -> Vec<(u32, Range<u32>)> {
        let Some(canvas) = self.canvas(job) else { return Vec::new() };
        let mut canvas = lock(&canvas);
        let gone = canvas.take_out(who);
        if let Some(store) = &self.store {
            store.append(job, Entry::TakenOut(who));
        }
        gone
    }

    /// Writes a snapshot, if the journal has grown enough or `at_once`. Others go on merging meanwhile. Without a store there is none.
    ///
    /// # Errors
    /// The disk's.
    pub fn snapshot(&self, job: JobId, spec: &JobSpec, at_once: bool) -> Result<(), StoreError> {
        let (Some(store), Some(canvas)) = (&self.store, self.canvas(job)) else { return Ok(()) };
        if !at_once && !store.snapshot_due(job) {
            return Ok(());
        }
        let engine = tilecast_core::VERSION.to_owned();
        let head = Head { engine, scene: spec.scene, settings: spec.settings.clone(), target: None };
        let mut snapshot = store.begin_snapshot(job, &head)?;
        let tiles = lock(&canvas).tiles();
        for tile in 0..tiles {
            let parts = lock(&canvas).parts(tile);
            parts.iter().try_for_each(|part| snapshot.part(part))?;
        }
        snapshot.commit()
    }

    /// The samples of every tile that a film has.
    pub fn samples(&self, job: JobId) -> Vec<Ranges> {
        self.canvas(job).map_or_else(Vec::new, |canvas| lock(&canvas).samples())
    }

    /// A chunk of a film, see [`film_rows`].
    pub fn rows(&self, job: JobId, first: u64) -> Option<wire::FilmChunk> {
        let canvas = self.canvas(job)?;
        film_rows(lock(&canvas).film(), first)
    }

    /// See [`tilecast_core::film::Film::relative_error`].
    pub fn relative_error(&self, job: JobId) -> Option<RelativeError> {
        let canvas = self.canvas(job)?;
        lock(&canvas).film().relative_error(ERROR_PIXELS_MAX)
    }

    /// The job has ended; its film stays until the room is needed.
    pub fn end(&self, job: JobId) {
        if let Some(slot) = self.slots().get_mut(&job) {
            slot.ended = true;
        }
    }

    /// Someone has the film: it may be the first to go.
    pub fn fetched(&self, job: JobId) {
        if let Some(slot) = self.slots().get_mut(&job) {
            slot.fetched = true;
        }
    }

    /// A whole film.
    #[cfg(test)]
    pub fn copy(&self, job: JobId) -> Option<tilecast_core::film::Film> {
        Some(lock(&*self.canvas(job)?).film().clone())
    }

    /// The job is forgotten.
    pub fn forget(&self, job: JobId) {
        self.slots().remove(&job);
    }

    fn canvas(&self, job: JobId) -> Option<Arc<Mutex<Canvas>>> {
        self.slots().get(&job).map(|slot| Arc::clone(&slot.canvas))
    }

    fn slots(&self) -> MutexGuard<'_, BTreeMap<JobId, Slot>> {
        lock(&self.slots)
    }
}

/// Sums are added one by one: a film whose lock was poisoned by a panic elsewhere is as good as before.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ledger::tests::settings;

    #[test]
    fn ended_films_make_room_fetched_ones_first() {
        let small = settings(10, 10, 1);
        let films = Films::new(100 * PIXEL_BYTES * 3, 0, None);
        for id in 1..=3 {
            films.make_room(&small).unwrap();
            films.insert(
                JobId(id),
                films.reserve(&small, Plan::new(&small, None, std::slice::from_ref(&(0..1))).unwrap()),
                false,
            );
        }
        assert!(films.make_room(&small).is_err());
        films.end(JobId(1));
        films.end(JobId(2));
        films.fetched(JobId(2));
        films.make_room(&small).unwrap();
        assert!(films.rows(JobId(2), 0).is_none());
        assert!(films.rows(JobId(1), 0).is_some());
        let refusal = films.make_room(&settings(5000, 5000, 1)).unwrap_err();
        assert!(films.rows(JobId(1), 0).is_some(), "dropped for nothing");
        assert!(refusal.to_string().contains("4959 MB"), "{refusal}");
    }
}
