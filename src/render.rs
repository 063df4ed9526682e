//! `tilecast render`: a coordinator and workers of its own, and a client that submits to them. Whether the workers are threads
//! here or processes beside, the way of a unit is the same.

use crate::children::{Children, Spec};
use crate::coordinator::{config, open};
use crate::follow::{Line, News, follow};
use crate::output::Output;
use crate::picture::{Picture, Ready};
use crate::report::{Report, Style};
use crate::seek::Goal;
use crate::stop::{on_signal, unless_stopped};
use crate::view::{self, Lookers, Page, View};
use crate::worker::{cpu, host};
use anyhow::{Context, anyhow};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tilecast_core::bvh::simd::Isa;
use tilecast_core::scene::Scene;
use tilecast_core::world::World;
use tilecast_proto::client::Client;
use tilecast_proto::transport::{Connector, Memory, tcp_incoming};
use tilecast_proto::types::{JobId, JobSpec};
use tilecast_worker::WorkerConfig;
use tilecast_worker::scenes::SceneCache;
use tokio::net::TcpListener;
use tokio::task::{JoinHandle, spawn_blocking};
use tokio_util::sync::CancellationToken;

/// What to render, where to, and with whom.
pub struct Render {
    /// What.
    pub picture: Picture,
    /// When it is done.
    pub goal: Goal,
    /// Where to.
    pub output: Output,
    /// Side of a tile in pixels, or the coordinator's choice.
    pub tile: Option<u32>,
    /// With whom.
    pub backend: Backend,
    /// Where what is done is kept meanwhile.
    pub state: Option<PathBuf>,
    /// Where the page is served, HOST:PORT.
    pub view: Option<String>,
    /// Where a tev listens, HOST:PORT.
    pub tev: Option<String>,
    /// Instruction set.
    pub isa: Isa,
    /// How it tells of itself.
    pub style: Style,
}

/// Who traces.
#[derive(Clone, Copy, Debug)]
pub enum Backend {
    /// Threads of this process.
    Here {
        /// How many.
        threads: u32,
    },
    /// Processes beside this one.
    Processes {
        /// How many.
        workers: u32,
        /// Threads of each.
        threads: u32,
    },
}

/// Renders.
///
/// # Errors
/// Whatever keeps the image from being made or written.
pub async fn run(render: Render) -> anyhow::Result<()> {
    let stop = on_signal()?;
    let mut report = Report::new(render.style);
    let picture = render.picture.clone();
    let load = spawn_blocking(move || picture.load());
    let (scene, ready) = unless_stopped(&stop, load).await?.context("loading panicked")??;
    ready.tell(&mut report);
    let view = match &render.view {
        Some(address) => Some(View::bind("--view", address, false, title(&render.picture.scene)).await?),
        None => None,
    };
    if let Some(view) = &view {
        report.viewing(&view.url);
        view::open(&view.url);
    }
    let lookers = Lookers { view, tev: render.tev.clone(), otlp: None };
    let (mut cluster, to_upload) = match render.backend {
        Backend::Here { threads } => {
            let compile = spawn_blocking(move || World::consume(scene));
            let world = unless_stopped(&stop, compile).await?.context("preparing the scene panicked")?;
            (Cluster::here(world, &ready, threads, &render, lookers).await?, None)
        }
        Backend::Processes { workers, threads } => {
            let cluster = Cluster::processes(workers, threads, render.isa, render.state.clone(), lookers).await?;
            (cluster, Some(Arc::new(scene)))
        }
    };
    let result = cluster.render(&ready, to_upload, &render, &mut report, &stop).await;
    cluster.end().await;
    if let (Ok(jobs), Some(state)) = (&result, &render.state) {
        // The image is there: what was kept for it may go. What stays behind is in nobody's way.
        for job in jobs {
            let _ = std::fs::remove_dir_all(state.join("jobs").join(job.to_string()));
        }
    }
    result.map(|_| ())
}

/// A coordinator and its workers, for one render.
pub struct Cluster {
    /// The way to its coordinator.
    pub connector: Connector,
    coordinator: JoinHandle<anyhow::Result<()>>,
    workers: Workers,
    page: Page,
    shutdown: CancellationToken,
}

enum Workers {
    Here(JoinHandle<anyhow::Result<()>>),
    Processes(Children),
}

impl Cluster {
    /// All in this process, joined by memory. The worker has the scene already.
    async fn here(
        world: World,
        ready: &Ready,
        threads: u32,
        render: &Render,
        lookers: Lookers,
    ) -> anyhow::Result<Self> {
        let (memory, shutdown) = (Memory::default(), CancellationToken::new());
        let incoming = memory.listen();
        let opened = open(config(render.state.clone())).await?;
        let page = lookers.show(&opened)?;
        let closing = shutdown.clone();
        let coordinator = tokio::spawn(async move { Ok(opened.serve(incoming, closing.cancelled()).await?) });
        let scenes = Arc::new(SceneCache::default());
        scenes.insert(ready.blobs.digest, Arc::new(world));
        // When the render is done or broken off, nobody waits for what was begun.
        let drain = Duration::ZERO;
        let config = WorkerConfig { threads, isa: render.isa, name: String::new(), host: host(), cpu: cpu(), drain };
        let connector = Connector::Memory(memory);
        let (to_coordinator, closing) = (connector.clone(), shutdown.clone());
        let worker = tokio::spawn(async move {
            Ok(tilecast_worker::run(to_coordinator, config, scenes, closing.cancelled()).await?)
        });
        Ok(Self { connector, coordinator, workers: Workers::Here(worker), page, shutdown })
    }

    /// The coordinator in this process, workers beside it, gRPC over loopback between them.
    ///
    /// # Errors
    /// No port, no processes, or no state.
    pub async fn processes(
        workers: u32,
        threads: u32,
        isa: Isa,
        state: Option<PathBuf>,
        lookers: Lookers,
    ) -> anyhow::Result<Self> {
        let listener = TcpListener::bind("127.0.0.1:0").await.context("no port on loopback can be had")?;
        let address = listener.local_addr()?.to_string();
        let (shutdown, connector) = (CancellationToken::new(), Connector::tcp(&address)?);
        let opened = open(config(state)).await?;
        let page = lookers.show(&opened)?;
        let closing = shutdown.clone();
        let incoming = tcp_incoming(listener);
        let coordinator = tokio::spawn(async move { Ok(opened.serve(incoming, closing.cancelled()).await?) });
        let children = Children::start(workers, &Spec { address, threads, isa })?;
        Ok(Self { connector, coordinator, workers: Workers::Processes(children), page, shutdown })
    }

    async fn render(
        &mut self,
        ready: &Ready,
        to_upload: Option<Arc<Scene>>,
        render: &Render,
        report: &mut Report,
        stop: &CancellationToken,
    ) -> anyhow::Result<Vec<JobId>> {
        let workers_hold_scene = to_upload.is_none();
        let client = Client::connect(&self.connector).await?;
        if let Some(scene) = to_upload {
            unless_stopped(stop, client.upload(&scene, &ready.blobs)).await??;
        }
        let (scene, settings) = (ready.blobs.digest, ready.settings.clone());
        let samples = vec![ready.samples.clone()];
        let job = JobSpec { tile: render.tile, samples, workers_hold_scene, ..JobSpec::new(scene, settings) };
        let mut line = Line::new(&client, ready, &render.output, stop, async || self.news().await);
        line.keep = render.state.is_some();
        follow(line, render.goal, job, report).await
    }

    /// Waits until something is wrong. Asking may be broken off.
    async fn news(&mut self) -> News {
        let workers = async {
            match &mut self.workers {
                Workers::Here(worker) => News::Fatal(early_end("worker", worker.await)),
                Workers::Processes(children) => children.news().await,
            }
        };
        tokio::select! {
            ended = &mut self.coordinator => News::Fatal(early_end("coordinator", ended)),
            news = workers => news,
        }
    }

    /// Workers first: they say goodbye to a coordinator that is still there.
    pub async fn end(self) {
        match self.workers {
            Workers::Here(worker) => {
                self.shutdown.cancel();
                // A panic or an error has been told, or came too late to matter.
                let _ = worker.await;
            }
            Workers::Processes(children) => {
                children.end().await;
                self.shutdown.cancel();
            }
        }
        let _ = self.coordinator.await;
        // The image is there, whether or not someone saw the last of it.
        let _ = self.page.end().await;
    }
}

/// The scene as the page calls it: scenes are often named by their folder.
fn title(scene: &Path) -> String {
    let parts: Vec<_> = scene.components().map(|part| part.as_os_str().to_string_lossy()).collect();
    parts[parts.len().saturating_sub(2)..].join("/")
}

/// Why a part of this process ended that should not have.
fn early_end(what: &str, ended: Result<anyhow::Result<()>, tokio::task::JoinError>) -> anyhow::Error {
    match ended {
        Ok(Ok(())) => anyhow!("the {what} ended early"),
        Ok(Err(error)) => error.context(format!("the {what} ended early")),
        Err(panic) => anyhow!("the {what} panicked: {panic}"),
    }
}
