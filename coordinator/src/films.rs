//! The films of jobs, in memory, within a budget. What is kept here is derived: a durable store writes beside it what
//! [`Films::merge`] is given, and gives it back after a restart.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tilecast_core::film::{Film, PixelSums, REPLICATES, RelativeError, TileSums};
use tilecast_core::settings::Settings;
use tilecast_proto::convert::film_rows;
use tilecast_proto::types::JobId;
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
    slots: Mutex<BTreeMap<JobId, Slot>>,
}

#[derive(Debug)]
struct Slot {
    film: Arc<Mutex<Film>>,
    bytes: u64,
    /// The job has ended: the film is dropped when its room is needed.
    ended: bool,
    fetched: bool,
}

/// Room for a film, set aside until the job has a number.
#[derive(Debug)]
pub struct Reserved(Film, u64);

impl Films {
    /// No films, and room for `bytes_max`.
    pub fn new(bytes_max: u64) -> Self {
        Self { bytes_max, slots: Mutex::default() }
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
    pub fn reserve(settings: &Settings) -> Reserved {
        Reserved(Film::new(settings), settings.film.crop.area() * PIXEL_BYTES)
    }

    /// Gives a film to a job.
    pub fn insert(&self, job: JobId, Reserved(film, bytes): Reserved) {
        let film = Arc::new(Mutex::new(film));
        self.slots().insert(job, Slot { film, bytes, ended: false, fetched: false });
    }

    /// Adds a unit's sums, which the ledger has accepted.
    pub fn merge(&self, job: JobId, sums: &TileSums) {
        if let Some(film) = self.film(job) {
            lock(&film).merge(sums);
        }
    }

    /// A chunk of a film, see [`film_rows`].
    pub fn rows(&self, job: JobId, first: u64) -> Option<wire::FilmChunk> {
        let film = self.film(job)?;
        film_rows(&lock(&film), first)
    }

    /// See [`Film::relative_error`].
    pub fn relative_error(&self, job: JobId) -> Option<RelativeError> {
        let film = self.film(job)?;
        lock(&film).relative_error(ERROR_PIXELS_MAX)
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

    fn film(&self, job: JobId) -> Option<Arc<Mutex<Film>>> {
        self.slots().get(&job).map(|slot| Arc::clone(&slot.film))
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
        let films = Films::new(100 * PIXEL_BYTES * 3);
        for id in 1..=3 {
            films.make_room(&small).unwrap();
            films.insert(JobId(id), Films::reserve(&small));
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
