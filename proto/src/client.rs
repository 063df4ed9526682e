//! A client of the coordinator: uploads scenes, submits jobs, watches them and fetches their films.

use crate::convert::{self, FilmParts, WireError};
use crate::limits::{CALL_MS_MAX, CHUNK_BYTES, DIGESTS_MAX, MESSAGE_BYTES_MAX};
use crate::transport::{ConnectError, Connector, Line, unheard};
use crate::types::{Contribution, JobId, JobSpec, Progress, WorkerStatus};
use crate::version::Version;
use crate::wire;
use crate::wire::jobs_client::JobsClient;
use bytes::Bytes;
use std::collections::HashSet;
use std::sync::Arc;
use std::time::Duration;
use tilecast_core::film::Film;
use tilecast_core::scene::{Digest, Scene, SceneBlobs};
use tonic::{Request, Status, Streaming};

/// Why a call did not succeed.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// Nobody there.
    #[error(transparent)]
    Connect(#[from] ConnectError),
    /// The coordinator refused, or went away during the call: see the status' code.
    #[error("the coordinator says: {}", .0.message())]
    Call(Box<Status>),
    /// The coordinator answered nonsense.
    #[error("the coordinator's answer is invalid: {0}")]
    Answer(#[from] WireError),
    /// Encoding a part of the scene did not end well.
    #[error("encoding part {0} of the scene panicked")]
    Encode(usize),
}

impl From<Status> for ClientError {
    fn from(status: Status) -> Self {
        Self::Call(Box::new(status))
    }
}

/// A connection to a coordinator. Clones share it.
#[derive(Clone, Debug)]
pub struct Client {
    rpc: JobsClient<Line>,
}

/// What an upload has sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Uploaded {
    /// Blobs that were missing.
    pub blobs: usize,
    /// Their bytes.
    pub bytes: u64,
}

impl Client {
    /// Connects and agrees on versions.
    ///
    /// # Errors
    /// Nobody there, or another version there.
    pub async fn connect(connector: &Connector) -> Result<Self, ClientError> {
        let rpc = JobsClient::new(connector.connect().await?)
            .max_decoding_message_size(MESSAGE_BYTES_MAX)
            .max_encoding_message_size(MESSAGE_BYTES_MAX);
        let client = Self { rpc };
        let greeting = client.rpc().greet(call(wire::Version::from(Version::ours()))).await;
        let theirs = greeting.map_err(|status| unheard(&status).map_or_else(|| status.into(), ClientError::Connect))?;
        convert::version(Some(theirs.into_inner()))?.check().map_err(WireError::from)?;
        Ok(client)
    }

    /// Uploads what the coordinator lacks of a scene. `blobs` are `scene.blobs()`.
    ///
    /// # Errors
    /// A refusal (no room), a lost connection, or a panic while encoding.
    pub async fn upload(&self, scene: &Arc<Scene>, blobs: &SceneBlobs) -> Result<Uploaded, ClientError> {
        let mut wanted = blobs.parts.clone();
        wanted.push(blobs.digest);
        let mut missing = HashSet::new();
        for digests in wanted.chunks(DIGESTS_MAX) {
            let message = wire::Digests { digests: digests.iter().map(convert::digest_bytes).collect() };
            let reply = self.rpc().missing_blobs(call(message)).await?.into_inner();
            missing.extend(convert::digests(&reply)?);
        }
        let mut uploaded = Uploaded::default();
        // The manifest last: where it is, the parts are.
        for (i, digest) in wanted.iter().enumerate() {
            if !missing.remove(digest) {
                continue;
            }
            let bytes = if i < blobs.parts.len() {
                let scene = Arc::clone(scene);
                let part = tokio::task::spawn_blocking(move || scene.part(i));
                Bytes::from(part.await.map_err(|_| ClientError::Encode(i))?)
            } else {
                Bytes::copy_from_slice(&blobs.manifest)
            };
            uploaded.blobs += 1;
            uploaded.bytes += bytes.len() as u64;
            self.rpc().put_blob(tokio_stream::iter(blob_chunks(digest, bytes))).await?;
        }
        Ok(uploaded)
    }

    /// Queues a job. Its scene was uploaded before, or `workers_hold_scene` is set.
    ///
    /// # Errors
    /// A refusal (missing blobs, no memory for the film, a full queue), or a lost connection.
    pub async fn submit(&self, job: JobSpec) -> Result<JobId, ClientError> {
        Ok(self.rpc().submit_job(call(wire::Job::from(job))).await?.into_inner().into())
    }

    /// Follows a job: its state now, whenever it changes (at most some ten times a second), and its final state.
    ///
    /// # Errors
    /// An unknown job, or a lost connection.
    pub async fn watch(&self, job: JobId) -> Result<Watch, ClientError> {
        Ok(Watch { stream: self.rpc().watch_job(wire::JobId::from(job)).await?.into_inner() })
    }

    /// The film of a job as it is now: after the end the whole picture, before it a picture in the making.
    ///
    /// # Errors
    /// An unknown job or one whose film was dropped, a lost connection, or bytes that are no film.
    pub async fn film(&self, job: JobId) -> Result<Film, ClientError> {
        let mut stream = self.rpc().fetch_film(wire::JobId::from(job)).await?.into_inner();
        let mut chunk = stream.message().await?.ok_or(WireError::Stream("has no film"))?;
        let mut parts = FilmParts::new(&chunk)?;
        loop {
            parts.push(&chunk)?;
            match stream.message().await? {
                Some(next) => chunk = next,
                None => return Ok(parts.finish()?),
            }
        }
    }

    /// Ends a job. A job that has ended already stays as it is.
    ///
    /// # Errors
    /// An unknown job, or a lost connection.
    pub async fn cancel(&self, job: JobId) -> Result<Progress, ClientError> {
        Ok(self.rpc().cancel_job(call(wire::JobId::from(job))).await?.into_inner().try_into()?)
    }

    /// All jobs the coordinator remembers, oldest first.
    ///
    /// # Errors
    /// A lost connection.
    pub async fn jobs(&self) -> Result<Vec<Progress>, ClientError> {
        collect(self.rpc().list_jobs(call(wire::ListJobsRequest {})).await?.into_inner()).await
    }

    /// Who has brought what of these jobs, each worker once.
    ///
    /// # Errors
    /// An unknown job, or a lost connection.
    pub async fn contributions(&self, jobs: &[JobId]) -> Result<Vec<Contribution>, ClientError> {
        let mut all: Vec<Contribution> = Vec::new();
        for &job in jobs {
            let stream = self.rpc().list_contributions(call(wire::JobId::from(job))).await?.into_inner();
            for one in collect::<_, Contribution>(stream).await? {
                match all.iter_mut().find(|known| known.worker == one.worker) {
                    Some(known) => {
                        known.units += one.units;
                        known.samples += one.samples;
                        known.trace += one.trace;
                        known.last = one.last;
                    }
                    None => all.push(one),
                }
            }
        }
        Ok(all)
    }

    /// The workers that are there.
    ///
    /// # Errors
    /// A lost connection.
    pub async fn workers(&self) -> Result<Vec<WorkerStatus>, ClientError> {
        collect(self.rpc().list_workers(call(wire::ListWorkersRequest {})).await?.into_inner()).await
    }

    fn rpc(&self) -> JobsClient<Line> {
        self.rpc.clone()
    }
}

/// The events of a job.
#[derive(Debug)]
pub struct Watch {
    stream: Streaming<wire::Progress>,
}

impl Watch {
    /// The next event; `None` after the final one. Dropping the future loses nothing.
    ///
    /// # Errors
    /// A lost connection.
    pub async fn next(&mut self) -> Result<Option<Progress>, ClientError> {
        let event = self.stream.message().await?;
        Ok(event.map(Progress::try_from).transpose()?)
    }
}

/// A request that does not wait for ever.
pub fn call<T>(message: T) -> Request<T> {
    let mut request = Request::new(message);
    request.set_timeout(Duration::from_millis(CALL_MS_MAX));
    request
}

/// A blob in chunks, without copying it.
fn blob_chunks(digest: &Digest, bytes: Bytes) -> impl Iterator<Item = wire::BlobChunk> + use<> {
    let (mut head, total) = (Some(convert::digest_bytes(digest)), bytes.len() as u64);
    chunks(bytes).map(move |data| match head.take() {
        Some(digest) => wire::BlobChunk { digest, bytes: total, data },
        None => wire::BlobChunk { digest: Bytes::new(), bytes: 0, data },
    })
}

/// Bytes in pieces of at most [`CHUNK_BYTES`], without copying them; one empty piece for none.
pub fn chunks(mut bytes: Bytes) -> impl Iterator<Item = Bytes> {
    let mut more = true;
    std::iter::from_fn(move || {
        let piece = more.then(|| bytes.split_to(bytes.len().min(CHUNK_BYTES)));
        more = !bytes.is_empty();
        piece
    })
}

async fn collect<M, T: TryFrom<M, Error = WireError>>(mut stream: Streaming<M>) -> Result<Vec<T>, ClientError> {
    let mut items = Vec::new();
    while let Some(message) = stream.message().await? {
        items.push(T::try_from(message)?);
    }
    Ok(items)
}
