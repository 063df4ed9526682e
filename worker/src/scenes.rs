//! Scenes: fetched once, compiled once, kept for the jobs to come.
//!
//! A scene that shares meshes or images with one that is kept, such as the same room from another camera, fetches only what
//! differs. Where workers share a [`Shelf`], they look there first, and again when the coordinator, which serves so many at a
//! time, begins to send.

use crate::pool::Pool;
use crate::shelf::Shelf;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tilecast_core::bvh::simd::Isa;
use tilecast_core::scene::{BlobError, Digest, Scene};
use tilecast_core::settings::SettingsError;
use tilecast_core::trace::Tracer;
use tilecast_core::world::World;
use tilecast_proto::convert::digest_bytes;
use tilecast_proto::limits::BLOB_BYTES_MAX;
use tilecast_proto::transport::Line;
use tilecast_proto::types::JobWork;
use tilecast_proto::wire::BlobRequest;
use tilecast_proto::wire::work_client::WorkClient;
use tokio::task::{JoinSet, spawn_blocking};

/// Scenes kept: the one that is rendered, and a few that may come again.
const SCENES_MAX: usize = 4;
/// Blobs of scenes kept besides the last used; compiled, they take about three times that again.
const SCENES_BYTES_MAX: u64 = 2 << 30;
/// Blobs fetched at a time, so that many small ones do not wait for each other's round trip.
const FETCHES_MAX: usize = 8;

/// Compiled scenes by digest, the least recently used dropped first.
#[derive(Default)]
pub struct SceneCache {
    /// The last used at the end.
    kept: Mutex<Vec<Kept>>,
    shelf: Option<Shelf>,
}

struct Kept {
    digest: Digest,
    world: Arc<World>,
    /// The blobs it came from; scenes share what they have in common.
    blobs: HashMap<Digest, Arc<[u8]>>,
}

/// Why a scene cannot be prepared.
#[derive(Debug, thiserror::Error)]
pub enum PrepareError {
    /// The coordinator does not give a blob, or the connection broke.
    #[error("blob {digest} could not be fetched: {status}")]
    Fetch {
        /// Which.
        digest: Digest,
        /// Why.
        status: Box<tonic::Status>,
    },
    /// What came is not what was asked for.
    #[error("what came for blob {0} is something else, or too long")]
    Damaged(Digest),
    /// The blobs make no scene.
    #[error(transparent)]
    Scene(#[from] BlobError),
    /// Settings that no tracer takes.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// A bug.
    #[error("compiling the scene panicked; the worker's log says where")]
    Panicked,
}

impl SceneCache {
    /// An empty one, with a shelf that it shares with other workers.
    pub fn with_shelf(shelf: Shelf) -> Self {
        Self { shelf: Some(shelf), ..Self::default() }
    }

    /// Keeps a scene that was compiled elsewhere in this process: it will not be fetched.
    pub fn insert(&self, digest: Digest, world: Arc<World>) {
        self.keep(Kept { digest, world, blobs: HashMap::new() });
    }

    /// The compiled scene, if it is kept.
    pub fn get(&self, digest: &Digest) -> Option<Arc<World>> {
        let mut kept = self.kept();
        let at = kept.iter().position(|k| k.digest == *digest)?;
        let found = kept.remove(at);
        let world = Arc::clone(&found.world);
        kept.push(found);
        Some(world)
    }

    fn keep(&self, new: Kept) {
        let mut kept = self.kept();
        kept.retain(|k| k.digest != new.digest);
        kept.push(new);
        let bytes = |k: &Kept| k.blobs.values().map(|blob| blob.len() as u64).sum::<u64>();
        while kept.len() > 1 && (kept.len() > SCENES_MAX || kept.iter().map(bytes).sum::<u64>() > SCENES_BYTES_MAX) {
            kept.remove(0);
        }
    }

    /// A blob of a kept scene.
    fn blob(&self, digest: &Digest) -> Option<Arc<[u8]>> {
        self.kept().iter().find_map(|k| k.blobs.get(digest).cloned())
    }

    fn kept(&self) -> MutexGuard<'_, Vec<Kept>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The tracer of a job.
pub(crate) async fn prepare(
    cache: Arc<SceneCache>,
    pool: Arc<Pool>,
    work: WorkClient<Line>,
    JobWork { scene, settings, .. }: JobWork,
    isa: Isa,
) -> Result<Arc<Tracer>, PrepareError> {
    let world = world(cache, &pool, work, scene).await?;
    let tracer = pool.run(move || Tracer::new(world, settings, isa)).await.ok_or(PrepareError::Panicked)??;
    Ok(Arc::new(tracer))
}

/// The compiled scene: kept, or fetched, checked and compiled.
async fn world(
    cache: Arc<SceneCache>,
    pool: &Pool,
    work: WorkClient<Line>,
    digest: Digest,
) -> Result<Arc<World>, PrepareError> {
    if let Some(world) = cache.get(&digest) {
        return Ok(world);
    }
    let shelf = cache.shelf.as_ref();
    let manifest = fetch(shelf.cloned(), work.clone(), digest).await?;
    let mut blobs = HashMap::new();
    let mut missing = Vec::new();
    for part in Scene::parts_of(&manifest)? {
        match cache.blob(&part) {
            Some(bytes) => _ = blobs.insert(part, bytes),
            None => missing.push(part),
        }
    }
    fetch_all(shelf, &work, missing, &mut blobs).await?;
    pool.run(move || compile(&cache, digest, &manifest, blobs)).await.ok_or(PrepareError::Panicked)?
}

fn compile(
    cache: &SceneCache,
    digest: Digest,
    manifest: &[u8],
    blobs: HashMap<Digest, Arc<[u8]>>,
) -> Result<Arc<World>, PrepareError> {
    let blob = |part: &Digest| blobs.get(part).cloned().ok_or(PrepareError::Damaged(*part));
    let scene = Scene::from_blobs(manifest, blob)?;
    let world = Arc::new(World::consume(scene));
    cache.keep(Kept { digest, world: Arc::clone(&world), blobs });
    Ok(world)
}

async fn fetch_all(
    shelf: Option<&Shelf>,
    work: &WorkClient<Line>,
    digests: Vec<Digest>,
    into: &mut HashMap<Digest, Arc<[u8]>>,
) -> Result<(), PrepareError> {
    let mut digests = digests.into_iter();
    let mut fetches = JoinSet::new();
    loop {
        while fetches.len() < FETCHES_MAX
            && let Some(digest) = digests.next()
        {
            let (shelf, work) = (shelf.cloned(), work.clone());
            fetches.spawn(async move { (digest, fetch(shelf, work, digest).await) });
        }
        match fetches.join_next().await {
            Some(Ok((digest, bytes))) => _ = into.insert(digest, bytes?),
            Some(Err(_)) => return Err(PrepareError::Panicked),
            None => return Ok(()),
        }
    }
}

/// A blob's bytes, checked: from the shelf, or from the coordinator. Memory grows with what comes, up to the limit; a chunk is
/// hashed in well under a millisecond.
async fn fetch(shelf: Option<Shelf>, mut work: WorkClient<Line>, digest: Digest) -> Result<Arc<[u8]>, PrepareError> {
    if let Some(bytes) = look(&shelf, digest).await? {
        return Ok(bytes);
    }
    let failed = |status| PrepareError::Fetch { digest, status: Box::new(status) };
    let request = BlobRequest { digest: digest_bytes(&digest) };
    let mut stream = work.get_blob(request).await.map_err(failed)?.into_inner();
    let mut next = stream.message().await.map_err(failed)?;
    // Others may have had their turn meanwhile.
    if let Some(bytes) = look(&shelf, digest).await? {
        return Ok(bytes);
    }
    let mut hasher = blake3::Hasher::new();
    let mut bytes = Vec::new();
    while let Some(chunk) = next {
        hasher.update(&chunk.data);
        bytes.extend_from_slice(&chunk.data);
        if bytes.len() as u64 > BLOB_BYTES_MAX {
            return Err(PrepareError::Damaged(digest));
        }
        next = stream.message().await.map_err(failed)?;
    }
    if *hasher.finalize().as_bytes() != digest.0 {
        return Err(PrepareError::Damaged(digest));
    }
    tracing::debug!(%digest, bytes = bytes.len(), "a part of a scene was fetched");
    let bytes: Arc<[u8]> = bytes.into();
    if let Some(shelf) = shelf {
        let bytes = Arc::clone(&bytes);
        // Before it is compiled, so that others find it soon.
        spawn_blocking(move || shelf.put(&digest, &bytes)).await.map_err(|_| PrepareError::Panicked)?;
    }
    Ok(bytes)
}

/// A blob on the shelf, if there is one.
async fn look(shelf: &Option<Shelf>, digest: Digest) -> Result<Option<Arc<[u8]>>, PrepareError> {
    let Some(shelf) = shelf.clone() else { return Ok(None) };
    spawn_blocking(move || shelf.get(&digest)).await.map_err(|_| PrepareError::Panicked)
}
