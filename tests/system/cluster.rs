//! Coordinator and workers in one process, over the same gRPC as everywhere: whatever joins, leaves, dies or restarts, the
//! film has the bits that tracing it directly has. Time is virtual, so waits cost nothing.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;
use tilecast_coordinator::{Config, RunError};
use tilecast_core::bvh::simd::Isa;
use tilecast_core::film::{Film, scale_exponent};
use tilecast_core::scene::{
    Bsdf, BsdfId, Digest, Emitter, FovAxis, Geometry, Mesh, MeshId, Scene, Sensor, Shape, Texture, TextureId,
};
use tilecast_core::settings::{
    Film as FilmSettings, Filter, Integrator, IntegratorKind, SamplerKind, Settings, Strategy, Window, Without,
};
use tilecast_core::trace::Tracer;
use tilecast_core::world::World;
use tilecast_proto::client::{Client, ClientError};
use tilecast_proto::limits::{LEASE_SILENCE_MS, REASSIGN_MS_MAX};
use tilecast_proto::transport::{Connector, Memory, tcp_incoming};
use tilecast_proto::types::{JobId, JobSpec, JobState, Progress};
use tilecast_proto::wire;
use tilecast_proto::wire::work_client::WorkClient;
use tilecast_worker::scenes::SceneCache;
use tilecast_worker::{WorkerConfig, WorkerError};
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tokio::time::Instant;
use tonic::Code;

/// A triangle under a grey sky.
fn scene() -> Scene {
    let mesh = Mesh {
        positions: vec![[-1.0, -1.0, 4.0].into(), [1.0, -1.0, 4.0].into(), [0.0, 1.0, 4.0].into()],
        triangles: vec![[0, 2, 1]],
        ..Mesh::default()
    };
    let scene = Scene {
        sensor: Sensor::Perspective {
            to_world: glam::Affine3::IDENTITY,
            fov_degrees: 50.0,
            fov_axis: FovAxis::X,
            principal_point_offset: [0.0; 2],
            near_clip: 0.01,
            far_clip: 1e4,
            lens: None,
        },
        shapes: vec![Shape {
            name: "triangle".into(),
            geometry: Geometry::Mesh(MeshId(0)),
            bsdf: BsdfId(0),
            radiance: None,
        }],
        bsdfs: vec![Bsdf::Diffuse { reflectance: TextureId(0) }],
        textures: vec![Texture::Constant(glam::Vec3::new(0.8, 0.5, 0.2))],
        groups: Vec::new(),
        instances: Vec::new(),
        emitters: vec![Emitter::Constant { radiance: glam::Vec3::splat(0.7) }],
        meshes: vec![Arc::new(mesh)],
        images: Vec::new(),
        origin: [0.0; 3],
    };
    scene.validate().unwrap();
    scene
}

pub fn settings() -> Settings {
    let (width, height) = (70, 50);
    Settings {
        film: FilmSettings {
            width,
            height,
            crop: Window { x0: 3, y0: 0, x1: width, y1: height },
            filter: Filter::Gaussian { stddev: 0.5 },
        },
        spp: 96,
        seed: 7,
        integrator: Integrator { kind: IntegratorKind::Path, max_depth: None, rr_depth: 5, hide_emitters: false },
        strategy: Strategy::Mis,
        sampler: SamplerKind::Sobol,
        without: Without::default(),
        half: Default::default(),
        offsets: Default::default(),
        scale_exponent: scale_exponent(0.7),
    }
}

pub fn job() -> JobSpec {
    JobSpec { tile: Some(16), name: "triangle".into(), ..JobSpec::new(scene().blobs().digest, settings()) }
}

pub fn tracer() -> Arc<Tracer> {
    Arc::new(Tracer::new(Arc::new(World::compile(&scene())), settings(), Isa::Portable).unwrap())
}

/// A coordinator in memory, and a client of it.
pub struct Fixture {
    pub memory: Memory,
    pub client: Client,
    pub _coordinator: Running<RunError>,
}

impl Fixture {
    /// One that checks this share of its workers' units.
    pub async fn verifying(verify: f64) -> Self {
        let memory = Memory::default();
        let _coordinator = coordinator_with(&memory, Config { verify, ..Config::default() });
        let client = connect(&memory).await;
        Self { memory, client, _coordinator }
    }
}

/// The film without any cluster.
pub fn direct() -> Digest {
    let settings = settings();
    let sums = tracer().trace(settings.film.crop, 0..settings.spp, &AtomicBool::new(false)).unwrap().unwrap();
    let mut film = Film::new(&settings);
    film.merge(&sums);
    film.digest()
}

/// Something that runs until it is told to stop.
pub struct Running<E> {
    stop: oneshot::Sender<()>,
    task: JoinHandle<Result<(), E>>,
}

impl<E: std::fmt::Debug> Running<E> {
    async fn end(self) {
        self.stop.send(()).unwrap();
        self.task.await.unwrap().unwrap();
    }
}

fn coordinator(memory: &Memory, incarnation: u32) -> Running<RunError> {
    coordinator_with(memory, Config { incarnation, ..Config::default() })
}

fn coordinator_with(memory: &Memory, config: Config) -> Running<RunError> {
    let incoming = memory.listen();
    let (stop, stopped) = oneshot::channel::<()>();
    let shutdown = async { _ = stopped.await };
    let task = tokio::spawn(tilecast_coordinator::run(incoming, config, shutdown));
    Running { stop, task }
}

fn worker(connector: Connector, scenes: SceneCache) -> Running<WorkerError> {
    let (stop, stopped) = oneshot::channel::<()>();
    let config = WorkerConfig {
        threads: 1,
        isa: Isa::detect(),
        name: "w".into(),
        host: "here".into(),
        cpu: String::new(),
        drain: Duration::ZERO,
    };
    let shutdown = async { _ = stopped.await };
    Running { stop, task: tokio::spawn(tilecast_worker::run(connector, config, Arc::new(scenes), shutdown)) }
}

fn new_worker(memory: &Memory) -> Running<WorkerError> {
    worker(Connector::Memory(memory.clone()), SceneCache::default())
}

async fn connect(memory: &Memory) -> Client {
    Client::connect(&Connector::Memory(memory.clone())).await.unwrap()
}

pub async fn submit(client: &Client) -> JobId {
    let scene = Arc::new(scene());
    client.upload(&scene, &scene.blobs()).await.unwrap();
    client.submit(job()).await.unwrap()
}

/// Watches a job to its end.
async fn last(client: &Client, job: JobId) -> Progress {
    let mut watch = client.watch(job).await.unwrap();
    let mut last = None;
    while let Some(progress) = watch.next().await.unwrap() {
        last = Some(progress);
    }
    last.unwrap()
}

pub async fn finish(client: &Client, job: JobId) -> Digest {
    let progress = last(client, job).await;
    assert_eq!(progress.state, JobState::Finished);
    assert_eq!(progress.samples_done, 67 * 50 * 96);
    assert!(
        progress.relative_error.is_some_and(|e| 0.0 < e.low && e.low < e.value && e.value < e.high && e.high < 0.1),
        "{progress:?}"
    );
    client.film(job).await.unwrap().digest()
}

#[tokio::test(start_paused = true)]
async fn one_worker_and_three_make_the_bits_of_none() {
    for count in [1, 3] {
        let memory = Memory::default();
        let coordinator = coordinator(&memory, 0);
        let workers: Vec<_> = (0..count).map(|_| new_worker(&memory)).collect();
        let client = connect(&memory).await;
        let job = submit(&client).await;
        assert_eq!(finish(&client, job).await, direct(), "{count} workers");
        for worker in workers {
            worker.end().await;
        }
        assert_eq!(client.workers().await.unwrap(), []);
        coordinator.end().await;
    }
}

#[tokio::test]
async fn over_tcp_it_is_the_same() {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let server = tilecast_coordinator::run(tcp_incoming(listener), Config::default(), std::future::pending());
    tokio::spawn(server);
    let connector = Connector::tcp(&address).unwrap();
    let worker = worker(connector.clone(), SceneCache::default());
    let client = Client::connect(&connector).await.unwrap();
    let job = submit(&client).await;
    assert_eq!(finish(&client, job).await, direct());
    worker.end().await;
}

#[tokio::test(start_paused = true)]
async fn a_seeded_worker_fetches_nothing() {
    let memory = Memory::default();
    let _coordinator = coordinator(&memory, 0);
    let scenes = SceneCache::default();
    scenes.insert(job().scene, Arc::new(World::compile(&scene())));
    let _worker = worker(Connector::Memory(memory.clone()), scenes);
    let client = connect(&memory).await;
    let job = client.submit(JobSpec { workers_hold_scene: true, ..job() }).await.unwrap();
    assert_eq!(finish(&client, job).await, direct());
}

#[tokio::test(start_paused = true)]
async fn a_second_job_of_the_scene_uploads_nothing() {
    let memory = Memory::default();
    let _coordinator = coordinator(&memory, 0);
    let _worker = new_worker(&memory);
    let client = connect(&memory).await;
    let scene = Arc::new(scene());
    assert_eq!(client.upload(&scene, &scene.blobs()).await.unwrap().blobs, 2);
    assert_eq!(client.upload(&scene, &scene.blobs()).await.unwrap().blobs, 0);
    let jobs = [client.submit(job()).await.unwrap(), client.submit(job()).await.unwrap()];
    for job in jobs {
        assert_eq!(finish(&client, job).await, direct());
    }
    // A call whose answer was lost is repeated, with the ticket it had.
    let ticketed = JobSpec { ticket: 3, ..job() };
    let third = client.submit(ticketed.clone()).await.unwrap();
    assert_eq!(client.submit(ticketed.clone()).await.unwrap(), third);
    assert_eq!(finish(&client, third).await, direct());
    assert_eq!(client.submit(ticketed).await.unwrap(), third);
    let jobs = [jobs[0], jobs[1], third];
    let listed: Vec<JobId> = client.jobs().await.unwrap().iter().map(|progress| progress.job).collect();
    assert_eq!(listed, jobs);
}

async fn raw(memory: &Memory) -> WorkClient<tilecast_proto::transport::Line> {
    WorkClient::new(Connector::Memory(memory.clone()).connect().await.unwrap())
}

fn hello() -> wire::Hello {
    tilecast_proto::types::WorkerInfo {
        threads: 1,
        isa: String::new(),
        host: String::new(),
        pid: 0,
        name: String::new(),
        cpu: String::new(),
        instance: 5,
    }
    .into()
}

#[tokio::test(start_paused = true)]
async fn a_worker_that_vanishes_costs_seconds_and_no_sample() {
    let memory = Memory::default();
    let _coordinator = coordinator(&memory, 0);
    let client = connect(&memory).await;
    let job = submit(&client).await;
    // Says hello, takes everything, and is never heard again.
    let mut work = raw(&memory).await;
    let worker = work.register(hello()).await.unwrap().into_inner().worker;
    let request = wire::LeaseRequest { worker, slots: 1000, known_jobs: Vec::new() };
    let lost = work.lease(request).await.unwrap().into_inner().leases;
    let (lost_at, mut waiting) = (Instant::now(), Vec::new());
    let worker = work.register(hello()).await.unwrap().into_inner().worker;
    while waiting.is_empty() {
        let request = wire::LeaseRequest { worker, slots: 1000, known_jobs: Vec::new() };
        waiting = work.lease(request).await.unwrap().into_inner().leases;
    }
    let silence = lost_at.elapsed().as_millis() as u64;
    assert!((LEASE_SILENCE_MS..REASSIGN_MS_MAX).contains(&silence), "given out again after {silence} ms");
    assert_eq!(waiting.len(), lost.len());
    // And again, to one that does the work.
    let _worker = new_worker(&memory);
    assert_eq!(finish(&client, job).await, direct());
}

#[tokio::test(start_paused = true)]
async fn workers_may_be_cut_off_in_the_middle_and_join_late() {
    let memory = Memory::default();
    let _coordinator = coordinator(&memory, 0);
    let first = new_worker(&memory);
    let client = connect(&memory).await;
    let job = submit(&client).await;
    let mut watch = client.watch(job).await.unwrap();
    while let Some(progress) = watch.next().await.unwrap()
        && progress.samples_done == 0
    {}
    let _late = new_worker(&memory);
    // Not told to stop: gone, with whatever it held.
    first.task.abort();
    assert_eq!(finish(&client, job).await, direct());
}

#[tokio::test(start_paused = true)]
async fn workers_outlive_their_coordinator() {
    let memory = Memory::default();
    let first = coordinator(&memory, 1);
    let worker = new_worker(&memory);
    let client = connect(&memory).await;
    let job = submit(&client).await;
    let mut watch = client.watch(job).await.unwrap();
    while let Some(progress) = watch.next().await.unwrap()
        && progress.samples_done == 0
    {}
    first.end().await;
    let _second = coordinator(&memory, 2);
    let client = connect(&memory).await;
    let job = submit(&client).await;
    assert_eq!(finish(&client, job).await, direct());
    worker.end().await;
}

#[tokio::test(start_paused = true)]
async fn a_cancelled_job_makes_way() {
    let memory = Memory::default();
    let _coordinator = coordinator(&memory, 0);
    let client = connect(&memory).await;
    let scene = Arc::new(scene());
    client.upload(&scene, &scene.blobs()).await.unwrap();
    let mut endless = job();
    endless.settings.spp = 1 << 30;
    let endless = client.submit(endless).await.unwrap();
    let job = client.submit(job()).await.unwrap();
    let _worker = new_worker(&memory);
    let mut watch = client.watch(endless).await.unwrap();
    while let Some(progress) = watch.next().await.unwrap()
        && progress.samples_done == 0
    {}
    assert_eq!(client.cancel(endless).await.unwrap().state, JobState::Cancelled);
    assert_eq!(finish(&client, job).await, direct());
    assert_eq!(last(&client, endless).await.state, JobState::Cancelled);
}

#[tokio::test(start_paused = true)]
async fn a_sample_without_a_value_names_itself() {
    let memory = Memory::default();
    let _coordinator = coordinator(&memory, 0);
    let _worker = new_worker(&memory);
    let client = connect(&memory).await;
    submit(&client).await;
    let mut bad = job();
    bad.settings.scale_exponent = 300;
    let id = client.submit(bad).await.unwrap();
    let JobState::Failed(why) = last(&client, id).await.state else { panic!("it did not fail") };
    assert!(why.contains("sample 0 of pixel (") && why.contains("render SCENE --pixel "), "{why}");
}

#[tokio::test(start_paused = true)]
async fn a_scene_that_is_not_there_is_asked_for() {
    let memory = Memory::default();
    let _coordinator = coordinator(&memory, 0);
    let client = connect(&memory).await;
    let Err(ClientError::Call(status)) = client.submit(job()).await else { panic!("accepted") };
    assert_eq!(status.code(), Code::FailedPrecondition);
    assert!(status.message().contains("upload"), "{}", status.message());
    // Promised, and not held after all.
    let _worker = new_worker(&memory);
    let id = client.submit(JobSpec { workers_hold_scene: true, ..job() }).await.unwrap();
    let JobState::Failed(why) = last(&client, id).await.state else { panic!("it did not fail") };
    assert!(why.contains("does not have blob"), "{why}");
}

#[tokio::test(start_paused = true)]
async fn another_version_is_refused_by_name() {
    let memory = Memory::default();
    let _coordinator = coordinator(&memory, 0);
    let mut work = raw(&memory).await;
    let version = wire::Version { protocol: 1, engine: "0.0.1-other".into() };
    let refusal = work.register(wire::Hello { version: Some(version), ..hello() }).await.unwrap_err();
    assert_eq!(refusal.code(), Code::FailedPrecondition);
    assert!(refusal.message().contains("0.0.1-other") && refusal.message().contains(tilecast_core::VERSION));
}

#[tokio::test(start_paused = true)]
async fn a_result_that_is_none_is_refused_and_the_unit_done_again() {
    let memory = Memory::default();
    let _coordinator = coordinator(&memory, 0);
    let client = connect(&memory).await;
    let job_id = submit(&client).await;
    let mut work = raw(&memory).await;
    let worker = work.register(hello()).await.unwrap().into_inner().worker;
    let request = wire::LeaseRequest { worker, slots: 1, known_jobs: Vec::new() };
    let lease = work.lease(request).await.unwrap().into_inner().leases.remove(0);
    let key = tilecast_proto::convert::work_key(&job().scene, &settings());
    let send = |bytes: u64, data: Vec<u8>, key: Vec<u8>| {
        let header = wire::ResultHeader {
            worker,
            fence: lease.fence,
            unit: lease.unit,
            key: key.into(),
            trace_us: 1,
            bytes,
            waited_us: 0,
        };
        let mut work = work.clone();
        async move {
            let chunk = wire::ResultChunk { header: Some(header), data: data.into() };
            work.submit(tokio_stream::iter([chunk])).await.map(|reply| reply.into_inner().verdict())
        }
    };
    for (bytes, data) in [(5, vec![1; 5]), (9, vec![1; 5]), (5, vec![1; 9]), (u64::MAX, vec![]), (0, vec![])] {
        let refusal = send(bytes, data, key.0.to_vec()).await.unwrap_err();
        assert_eq!(refusal.code(), Code::InvalidArgument, "{refusal}");
    }
    assert_eq!(send(5, vec![1; 5], vec![0; 32]).await.unwrap(), wire::Verdict::Stale);
    let _worker = new_worker(&memory);
    assert_eq!(finish(&client, job_id).await, direct());
}
