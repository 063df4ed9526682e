//! The service that workers call.

use super::{Shared, called, lock, next, panicked};
use crate::events::{About, Kind};
use crate::ledger::LedgerError;
use crate::otlp::way::{Outcome, Step, Way};
use bytes::{Bytes, BytesMut};
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;
use tilecast_proto::client::chunks;
use tilecast_proto::convert::{self, WireError};
use tilecast_proto::limits::{LEASE_WAIT_MS, STREAM_IDLE_MS_MAX};
use tilecast_proto::types::{
    Failure, Fence, Heartbeat, JobId, LeaseRequest, Leave, ResultHeader, Verdict, WorkerId, WorkerInfo,
};
use tilecast_proto::wire::work_server;
use tilecast_proto::wire::{
    BlobRequest, Chunk, FailReply, FailRequest, HeartbeatReply, HeartbeatRequest, Hello, LeaveReply, LeaveRequest,
    ResultChunk, SubmitReply, Welcome,
};
use tilecast_proto::{types, wire};
use tokio::sync::mpsc;
use tokio::time::Instant;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status, Streaming};

/// See `Work` in `render.proto`.
pub(crate) struct Work(pub(crate) Arc<Shared>);

/// Chunks of a blob that wait for a slow worker: the next one is ready while one is sent.
const QUEUE_LEN: usize = 2;
/// Who reads nothing of a blob for so long is probably gone; others wait.
const BLOB_PATIENCE: Duration = Duration::from_millis(STREAM_IDLE_MS_MAX);

#[tonic::async_trait]
impl work_server::Work for Work {
    type GetBlobStream = ReceiverStream<Result<Chunk, Status>>;

    async fn register(&self, request: Request<Hello>) -> Result<Response<Welcome>, Status> {
        let info = WorkerInfo::try_from(request.into_inner())?;
        let (worker, heartbeat_ms) = self.0.with_ledger(|ledger, now| {
            let worker = ledger.register(now, info.clone())?;
            Ok::<_, LedgerError>((worker, ledger.heartbeat_ms()))
        })?;
        let text = format!("worker {} has come, process {}, {}", called(worker, &info), info.pid, info.isa);
        self.0.tell(Kind::WorkerCame, worker, text);
        self.0.changed.notify_waiters();
        Ok(Response::new(Welcome { worker: worker.0, heartbeat_ms: heartbeat_ms as u32 }))
    }

    async fn lease(&self, request: Request<wire::LeaseRequest>) -> Result<Response<wire::LeaseReply>, Status> {
        let request = LeaseRequest::try_from(request.into_inner())?;
        let deadline = Instant::now() + Duration::from_millis(LEASE_WAIT_MS);
        loop {
            // Made before looking, so that no signal between looking and waiting is lost.
            let more = self.0.work.notified();
            let reply = self.0.with_ledger(|ledger, now| ledger.lease(now, &request))?;
            if !reply.leases.is_empty() {
                self.0.changed.notify_waiters();
                return Ok(Response::new(reply.into()));
            }
            tokio::select! {
                () = more => {}
                () = tokio::time::sleep_until(deadline) => return Ok(Response::new(types::LeaseReply::default().into())),
                () = self.0.closing.cancelled() => return Err(Status::unavailable("the coordinator is stopping")),
            }
        }
    }

    async fn submit(&self, request: Request<Streaming<ResultChunk>>) -> Result<Response<SubmitReply>, Status> {
        let mut stream = request.into_inner();
        let first = next(&mut stream).await?.ok_or(WireError::Stream("has no result"))?;
        let header = first.header.ok_or(WireError::Missing("result.header"))?;
        let worker = WorkerId(header.worker);
        let header = ResultHeader::try_from(header).inspect_err(|error| self.0.offence(worker, &error.to_string()))?;
        let (verdict, plausible, lent) = {
            let ledger = lock(&self.0.ledger);
            (ledger.verdict(&header), ledger.plausible(&header), ledger.lease_of(worker, header.fence))
        };
        let mut way = Way::brought(self.0.now(), &header, lent);
        if !plausible {
            self.0.offence(worker, "a unit that its job does not have");
            return Err(Status::invalid_argument("the job has no such unit"));
        }
        if verdict == Verdict::Duplicate {
            self.0.traffic.duplicates.fetch_add(1, Relaxed);
        }
        if verdict != Verdict::Accepted {
            // Told before the bulk has come.
            self.0.follow(way, Outcome::Brought(verdict));
            return Ok(Response::new(verdict.into()));
        }
        let bytes = result_bytes(&header, first.data, &mut stream).await;
        let bytes = bytes.inspect_err(|status| {
            if status.code() == tonic::Code::InvalidArgument {
                self.0.offence(worker, status.message());
            }
        })?;
        self.0.traffic.results.fetch_add(bytes.len() as u64, Relaxed);
        way.step(Step::Transfer, self.0.now());
        let shared = Arc::clone(&self.0);
        let merged = tokio::task::spawn_blocking(move || shared.merge(&header, bytes, way));
        Ok(Response::new(merged.await.map_err(panicked)??.into()))
    }

    async fn fail(&self, request: Request<FailRequest>) -> Result<Response<FailReply>, Status> {
        let (worker, fence, job, failure) = <(WorkerId, Fence, JobId, Failure)>::try_from(request.into_inner())?;
        let about = About { job: Some(job), worker: Some(worker) };
        self.0.tell(Kind::UnitFailed, about, format!("worker {} could not do a unit: {failure:?}", worker.number()));
        let why = Outcome::Failed(format!("{failure:?}"));
        let lent = self.0.with_ledger(|ledger, now| {
            let lent = ledger.lease_of(worker, fence);
            ledger.fail(now, worker, fence, failure).map(|()| lent)
        })?;
        if let Some(lent) = lent {
            self.0.follow(Way::lost(self.0.now(), lent), why);
        }
        self.0.work.notify_waiters();
        self.0.changed.notify_waiters();
        Ok(Response::new(FailReply {}))
    }

    async fn heartbeat(&self, request: Request<HeartbeatRequest>) -> Result<Response<HeartbeatReply>, Status> {
        let beat = Heartbeat::try_from(request.into_inner())?;
        let reply = self.0.with_ledger(|ledger, now| ledger.heartbeat(now, &beat))?;
        Ok(Response::new(reply.into()))
    }

    async fn leave(&self, request: Request<LeaveRequest>) -> Result<Response<LeaveReply>, Status> {
        let Leave { worker, keep } = request.into_inner().try_into()?;
        let gone = self.0.with_ledger(|ledger, _| {
            let info = ledger.worker(worker).filter(|_| keep.is_empty()).cloned();
            ledger.leave(worker, &keep);
            info
        });
        if let Some(info) = gone {
            self.0.tell(Kind::WorkerLeft, worker, format!("worker {} has left", called(worker, &info)));
        }
        self.0.work.notify_waiters();
        self.0.changed.notify_waiters();
        Ok(Response::new(LeaveReply {}))
    }

    async fn get_blob(&self, request: Request<BlobRequest>) -> Result<Response<Self::GetBlobStream>, Status> {
        let digest = convert::digest(&request.into_inner().digest, "digest")?;
        let missing = || Status::not_found(format!("the coordinator does not have blob {digest}"));
        let bytes = self.0.blobs().get(&digest).ok_or_else(missing)?;
        let (sender, receiver) = mpsc::channel(QUEUE_LEN + 1);
        tokio::spawn(send_blob(Arc::clone(&self.0), bytes, sender));
        Ok(Response::new(ReceiverStream::new(receiver)))
    }
}

/// Sends a blob when its turn comes. Whoever does not read loses its turn, and is told why.
async fn send_blob(shared: Arc<Shared>, bytes: Bytes, sender: mpsc::Sender<Result<Chunk, Status>>) {
    // Room for that, however full the queue is.
    let Ok(farewell) = sender.clone().reserve_owned().await else { return };
    let _turn = tokio::select! {
        Ok(turn) = shared.blobs_sent.acquire() => turn,
        () = sender.closed() => return,
    };
    for data in chunks(bytes) {
        let len = data.len();
        match tokio::time::timeout(BLOB_PATIENCE, sender.send(Ok(Chunk { data }))).await {
            Ok(Ok(())) => _ = shared.traffic.scenes_out.fetch_add(len as u64, Relaxed),
            Ok(Err(_)) => return,
            Err(_) => {
                farewell.send(Err(Status::deadline_exceeded("the blob was not read for too long")));
                return;
            }
        }
    }
}

/// All data of a result: as it came if it is one chunk, else put together.
async fn result_bytes(
    header: &ResultHeader,
    first: Bytes,
    stream: &mut Streaming<ResultChunk>,
) -> Result<Bytes, Status> {
    if first.len() == header.bytes {
        return Ok(first);
    }
    // Grows with what comes, up to what the header announced, which is bounded by its tile.
    let mut all = BytesMut::from(first);
    while all.len() < header.bytes {
        let chunk = next(stream).await?.ok_or(WireError::Stream("ends before the result does"))?;
        if chunk.data.is_empty() {
            return Err(WireError::Stream("has an empty chunk").into());
        }
        all.extend_from_slice(&chunk.data);
    }
    if all.len() > header.bytes {
        return Err(WireError::Stream("is longer than announced").into());
    }
    Ok(all.freeze())
}
