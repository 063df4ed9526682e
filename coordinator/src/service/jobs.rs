//! The service that clients call.

use super::{Shared, lock, next, panicked};
use crate::access::caller;
use crate::events::Kind;
use crate::ledger::RestoredJob;
use crate::plan::Plan;
use crate::store::StoreError;
use bytes::Bytes;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;
use tilecast_core::scene::{Digest, Scene};
use tilecast_proto::convert::{self, WireError, digest_bytes};
use tilecast_proto::limits::PROGRESS_INTERVAL_MS;
use tilecast_proto::types::{JobId, JobSpec, Progress};
use tilecast_proto::version::Version;
use tilecast_proto::wire::{self, jobs_server};
use tokio::sync::mpsc;
use tokio::time::Instant;
use tokio_stream::Stream;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status, Streaming};

/// Chunks of a film, and events of a job, that wait for a slow client: the next one is ready while one is sent.
const QUEUE_LEN: usize = 2;

/// See `Jobs` in `render.proto`.
pub(crate) struct Jobs(pub(crate) Arc<Shared>);

type Items<T> = Pin<Box<dyn Stream<Item = Result<T, Status>> + Send>>;

#[tonic::async_trait]
impl jobs_server::Jobs for Jobs {
    type WatchJobStream = ReceiverStream<Result<wire::Progress, Status>>;
    type FetchFilmStream = ReceiverStream<Result<wire::FilmChunk, Status>>;
    type ListJobsStream = Items<wire::Progress>;
    type ListWorkersStream = Items<wire::Worker>;
    type ListContributionsStream = Items<wire::Contribution>;

    async fn greet(&self, request: Request<wire::Version>) -> Result<Response<wire::Version>, Status> {
        convert::version(Some(request.into_inner()))?.check()?;
        Ok(Response::new(Version::ours().into()))
    }

    async fn missing_blobs(&self, request: Request<wire::Digests>) -> Result<Response<wire::Digests>, Status> {
        let mut digests = convert::digests(&request.into_inner())?;
        let blobs = self.0.blobs();
        digests.retain(|digest| !blobs.has(digest));
        Ok(Response::new(wire::Digests { digests: digests.iter().map(digest_bytes).collect() }))
    }

    async fn put_blob(
        &self,
        request: Request<Streaming<wire::BlobChunk>>,
    ) -> Result<Response<wire::PutBlobReply>, Status> {
        let mut stream = request.into_inner();
        let first = next(&mut stream).await?.ok_or(WireError::Stream("has no blob"))?;
        let digest = convert::digest(&first.digest, "blob.digest")?;
        let len = convert::blob_len(first.bytes)?;
        let room = Room::new(&self.0, len)?;
        let bytes = receive(digest, len, first.data, &mut stream).await?;
        if let Some(store) = &self.0.store {
            let (store, kept) = (Arc::clone(store), bytes.clone());
            let kept = tokio::task::spawn_blocking(move || store.put_blob(&digest, &kept));
            kept.await.map_err(panicked)?.map_err(not_kept)?;
        }
        self.0.traffic.scenes_in.fetch_add(bytes.len() as u64, Relaxed);
        self.0.blobs().insert(digest, bytes);
        drop(room);
        Ok(Response::new(wire::PutBlobReply {}))
    }

    async fn submit_job(&self, request: Request<wire::Job>) -> Result<Response<wire::JobId>, Status> {
        let owner = caller(&request).identity;
        let spec = JobSpec::try_from(request.into_inner())?;
        let shared = Arc::clone(&self.0);
        let submitted = tokio::task::spawn_blocking(move || submit(&shared, spec, owner));
        let job = submitted.await.map_err(panicked)??;
        Ok(Response::new(job.into()))
    }

    async fn watch_job(&self, request: Request<wire::JobId>) -> Result<Response<Self::WatchJobStream>, Status> {
        let job = JobId::from(request.into_inner());
        progress(&self.0, job)?;
        let (sender, receiver) = mpsc::channel(QUEUE_LEN);
        tokio::spawn(watch(Arc::clone(&self.0), job, sender));
        Ok(Response::new(ReceiverStream::new(receiver)))
    }

    async fn fetch_film(&self, request: Request<wire::JobId>) -> Result<Response<Self::FetchFilmStream>, Status> {
        let job = JobId::from(request.into_inner());
        let ended = progress(&self.0, job)?.state.is_final();
        let (sender, receiver) = mpsc::channel(QUEUE_LEN);
        let shared = Arc::clone(&self.0);
        // Encoding is CPU work; the thread waits when the client is slow.
        tokio::task::spawn_blocking(move || send_film(&shared, job, ended, &sender));
        Ok(Response::new(ReceiverStream::new(receiver)))
    }

    async fn cancel_job(&self, request: Request<wire::JobId>) -> Result<Response<wire::Progress>, Status> {
        let who = caller(&request).cancels_as();
        let job = JobId::from(request.into_inner());
        self.0.cancel(job, who)?;
        Ok(Response::new(progress(&self.0, job)?.into()))
    }

    async fn list_jobs(&self, _: Request<wire::ListJobsRequest>) -> Result<Response<Self::ListJobsStream>, Status> {
        let jobs: Vec<Progress> = self.0.with_ledger(|ledger, now| {
            let jobs = ledger.jobs();
            jobs.into_iter().filter_map(|job| ledger.progress(now, job).ok()).collect()
        });
        Ok(Response::new(Box::pin(tokio_stream::iter(jobs.into_iter().map(|job| Ok(job.into()))))))
    }

    async fn list_contributions(
        &self,
        request: Request<wire::JobId>,
    ) -> Result<Response<Self::ListContributionsStream>, Status> {
        let job = JobId::from(request.into_inner());
        let all = self.0.with_ledger(|ledger, _| ledger.contributions(job))?;
        Ok(Response::new(Box::pin(tokio_stream::iter(all.into_iter().map(|one| Ok(one.into()))))))
    }

    async fn list_workers(
        &self,
        _: Request<wire::ListWorkersRequest>,
    ) -> Result<Response<Self::ListWorkersStream>, Status> {
        let workers = self.0.with_ledger(|ledger, now| ledger.workers(now));
        Ok(Response::new(Box::pin(tokio_stream::iter(workers.into_iter().map(|worker| Ok(worker.into()))))))
    }
}

/// Room for an upload, given back however the upload ends.
struct Room<'a> {
    shared: &'a Shared,
    bytes: u64,
}

impl<'a> Room<'a> {
    fn new(shared: &'a Shared, bytes: u64) -> Result<Self, Status> {
        let dropped = shared.blobs().reserve(bytes).map_err(|e| Status::resource_exhausted(e.to_string()))?;
        dropped.iter().for_each(|digest| shared.drop_blob(digest));
        Ok(Self { shared, bytes })
    }
}

impl Drop for Room<'_> {
    fn drop(&mut self) {
        self.shared.blobs().release(self.bytes);
    }
}

/// The bytes of an upload, if they are what they claim. Memory grows with what comes; a chunk is hashed in well under a
/// millisecond.
async fn receive(
    digest: Digest,
    len: u64,
    first: Bytes,
    stream: &mut Streaming<wire::BlobChunk>,
) -> Result<Bytes, Status> {
    let mut hasher = blake3::Hasher::new();
    let mut bytes = Vec::new();
    let mut data = first;
    loop {
        if bytes.len() as u64 + data.len() as u64 > len {
            return Err(WireError::Stream("is longer than announced").into());
        }
        hasher.update(&data);
        bytes.extend_from_slice(&data);
        match next(stream).await? {
            Some(chunk) => data = chunk.data,
            None => break,
        }
    }
    if bytes.len() as u64 != len || *hasher.finalize().as_bytes() != digest.0 {
        return Err(Status::data_loss(format!("the blob that came is not {digest}: damaged on the way?")));
    }
    Ok(bytes.into())
}

/// Queues a job: its blobs must be there, and room for its film. May take a moment for a large scene or film. A job that was
/// queued already, by its ticket, is that one.
pub(crate) fn submit(shared: &Shared, spec: JobSpec, owner: Option<Digest>) -> Result<JobId, Status> {
    let _turn = lock(&shared.submitting);
    if let Some(there) = shared.with_ledger(|ledger, _| ledger.with_ticket(spec.ticket, owner)) {
        return Ok(there);
    }
    let blobs = if spec.workers_hold_scene { Vec::new() } else { scene_blobs(shared, &spec.scene)? };
    shared.films.make_room(&spec.settings).map_err(|e| Status::resource_exhausted(e.to_string()))?;
    let plan = Plan::of(&spec).map_err(|e| Status::invalid_argument(e.to_string()))?;
    let film = shared.films.reserve(&spec.settings, plan);
    let lacks =
        |blob| Status::failed_precondition(format!("the coordinator lacks blob {blob} of the scene; upload it first"));
    shared.blobs().pin(&blobs).map_err(lacks)?;
    let about = described(&spec);
    let job = shared.with_ledger(|ledger, now| {
        let id = ledger.add_job(now, spec.clone(), owner)?;
        // Before anyone can lend a unit of it; and on the disk before it is promised.
        if let Some(store) = &shared.store {
            let kept = store.add_job(&RestoredJob { id, spec, owner, queued_at: now, end: None });
            if let Err(error) = kept {
                ledger.remove_job(id);
                return Err(not_kept(error));
            }
        }
        shared.films.insert(id, film, false);
        lock(&shared.pinned).insert(id, blobs.clone());
        Ok::<JobId, Status>(id)
    });
    match job {
        Ok(id) => shared.tell(Kind::JobQueued, id, format!("job {id} is queued: {about}")),
        Err(_) => shared.blobs().unpin(&blobs),
    }
    shared.work.notify_waiters();
    shared.changed.notify_waiters();
    job
}

/// A job in a few words.
fn described(spec: &JobSpec) -> String {
    let crop = spec.settings.film.crop;
    let name = if spec.name.is_empty() { "no name" } else { &spec.name };
    format!("{name}, {}x{} pixels, {} samples each", crop.width(), crop.height(), spec.settings.spp)
}

/// The manifest of a scene and all parts it names.
pub(super) fn scene_blobs(shared: &Shared, scene: &Digest) -> Result<Vec<Digest>, Status> {
    let lacks = || Status::failed_precondition(format!("the coordinator lacks scene {scene}; upload it first"));
    let manifest = shared.blobs().get(scene).ok_or_else(lacks)?;
    let mut blobs = Scene::parts_of(&manifest).map_err(|e| Status::invalid_argument(e.to_string()))?;
    blobs.push(*scene);
    Ok(blobs)
}

fn progress(shared: &Shared, job: JobId) -> Result<Progress, Status> {
    Ok(shared.with_ledger(|ledger, now| ledger.progress(now, job))?)
}

/// Sends a job's state now, and when it changes, not too often; the final one at once. Ends with it, or with the client.
async fn watch(shared: Arc<Shared>, job: JobId, sender: mpsc::Sender<Result<wire::Progress, Status>>) {
    loop {
        let changed = shared.changed.notified();
        let state = progress(&shared, job);
        let last = state.as_ref().map_or(true, |p| p.state.is_final());
        if sender.send(state.map(wire::Progress::from)).await.is_err() || last {
            return;
        }
        let earliest = Instant::now() + Duration::from_millis(PROGRESS_INTERVAL_MS);
        let next = async {
            changed.await;
            loop {
                let changed = shared.changed.notified();
                // Looked at whenever a result is merged.
                if shared.with_ledger(|ledger, _| ledger.has_ended(job)) {
                    return;
                }
                tokio::select! {
                    () = tokio::time::sleep_until(earliest) => return,
                    () = changed => {}
                }
            }
        };
        tokio::select! {
            () = next => {}
            () = sender.closed() => return,
            () = shared.closing.cancelled() => {
                let _ = sender.send(Err(Status::unavailable("the coordinator is stopping"))).await;
                return;
            }
        }
    }
}

/// Sends a film chunk by chunk; the lock is held for a chunk at a time, so that results go on being merged.
fn send_film(shared: &Shared, job: JobId, ended: bool, sender: &mpsc::Sender<Result<wire::FilmChunk, Status>>) {
    if let Err(status) = bring_back(shared, job) {
        let _ = sender.blocking_send(Err(status));
        return;
    }
    let mut first = 0;
    while let Some(chunk) = shared.films.rows(job, first) {
        first += u64::from(chunk.pixels);
        if sender.blocking_send(Ok(chunk)).is_err() {
            return;
        }
    }
    if first == 0 {
        let _ = sender.blocking_send(Err(Status::not_found(format!("the film of job {job} was dropped to make room"))));
    } else if ended {
        shared.films.fetched(job);
    }
}

/// Reads the film of an ended job from the store again, if it is not in memory.
pub(crate) fn bring_back(shared: &Shared, job: JobId) -> Result<(), Status> {
    if shared.store.is_none() || shared.films.has(job) {
        return Ok(());
    }
    let spec = lock(&shared.ledger).spec(job)?;
    let _turn = lock(&shared.submitting);
    shared.films.make_room(&spec.settings).map_err(|e| Status::resource_exhausted(e.to_string()))?;
    let plan = Plan::of(&spec).map_err(|e| Status::invalid_argument(e.to_string()))?;
    let film = shared.films.restore(job, &spec, plan).map_err(not_kept)?;
    shared.films.insert(job, film, true);
    Ok(())
}

/// A film at once, for tests.
#[cfg(test)]
pub(crate) fn whole_film(shared: &Shared, job: JobId) -> Result<tilecast_core::film::Film, Status> {
    bring_back(shared, job)?;
    shared.films.copy(job).ok_or_else(|| Status::not_found("no film"))
}

fn not_kept(error: StoreError) -> Status {
    tracing::error!(%error, "the state could not be kept");
    Status::resource_exhausted(format!("the coordinator's disk refuses: {error}"))
}
