//! Images as they converge, in the viewer tev (Müller; its protocol, version 2): tiles are sent as they change.
//!
//! The viewer never holds a render up. What is not sent yet is a number, the version of the film that it has: a viewer that is
//! slow gets fewer, later states of the same tiles, one that is absent costs an attempt to connect now and then, one that was
//! started again gets everything anew. No work is done before the last frame is on its way.

mod frame;

use crate::pace::{Pace, until_closed};
use crate::service::Shared;
use frame::{Channels, Frame};
use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;
use std::time::Duration;
use tilecast_core::settings::Window;
use tilecast_proto::types::JobId;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio_util::sync::CancellationToken;

/// The port that tev listens on, unless it is told otherwise.
pub const PORT: u16 = 14158;
/// Changes are looked for this often: what happens to a tile in between is sent once.
const INTERVAL: Duration = Duration::from_millis(250);
/// A viewer that is not there is looked for this often,
const RETRY: Duration = Duration::from_millis(500);
/// and has this long to answer.
const CONNECT_MAX: Duration = Duration::from_secs(3);
/// When the coordinator ends, the last tiles have this long to be taken.
const LINGER: Duration = Duration::from_secs(1);
/// Pixels sent between two looks: their frames are all the memory that a viewer costs.
const PIXELS_MAX: u64 = 256 << 10;
/// Images that are kept up to date: those of the last jobs.
const IMAGES_MAX: usize = 4;

/// Sends images to a viewer: made by [`crate::Coordinator::tev`].
pub struct Tev {
    shared: Arc<Shared>,
    address: String,
    pace: Pace,
    /// The images, with the version that the viewer has; `None` if it does not know them.
    images: BTreeMap<JobId, Option<u64>>,
}

impl Tev {
    pub(crate) fn new(shared: Arc<Shared>, address: String) -> Self {
        Self { shared, address, pace: Pace::default(), images: BTreeMap::new() }
    }

    /// Sends until the coordinator ends, and the last tiles then. A viewer that does not take them has shown what it could.
    pub async fn run(mut self) {
        let closing = self.shared.closing.clone();
        until_closed(&closing, LINGER, self.follow(&closing)).await;
    }

    async fn follow(&mut self, closing: &CancellationToken) {
        let mut told = false;
        loop {
            let connect = tokio::time::timeout(CONNECT_MAX, TcpStream::connect(&self.address));
            let connected = tokio::select! {
                connected = connect => connected,
                () = closing.cancelled() => return,
            };
            if let Ok(Ok(viewer)) = connected {
                told = false;
                self.images.values_mut().for_each(|version| *version = None);
                // A viewer that has gone is looked for again.
                let _ = self.show(viewer, closing).await;
            } else if !std::mem::replace(&mut told, true) {
                tracing::warn!(address = self.address, "no tev there yet; images are sent when there is one");
            }
            tokio::select! {
                () = tokio::time::sleep(RETRY) => {}
                () = closing.cancelled() => return,
            }
        }
    }

    /// Sends what changes, until the viewer goes or the coordinator ends.
    async fn show(&mut self, mut viewer: TcpStream, closing: &CancellationToken) -> io::Result<()> {
        loop {
            let ending = closing.is_cancelled();
            while self.send(&mut viewer).await? {}
            if ending {
                return viewer.shutdown().await;
            }
            let mut said = [0; 64];
            tokio::select! {
                said = viewer.read(&mut said) => if said? == 0 { return Ok(()) },
                () = tokio::time::sleep(INTERVAL) => {}
                () = closing.cancelled() => {}
            }
        }
    }

    /// Sends what changed, up to [`PIXELS_MAX`] of each image; whether there is more.
    async fn send(&mut self, viewer: &mut TcpStream) -> io::Result<bool> {
        self.choose();
        let mut more = false;
        for (job, known) in self.images.clone() {
            let shared = Arc::clone(&self.shared);
            let work = async || tokio::task::spawn_blocking(move || frames(&shared, job, known)).await;
            let Ok(Some(news)) = self.pace.work(work).await else { continue };
            viewer.write_all(&news.bytes).await?;
            self.images.insert(job, Some(news.version));
            more |= news.more;
        }
        Ok(more)
    }

    /// Jobs that go on are shown; those that ended stay for a while.
    fn choose(&mut self) {
        let going = self.shared.with_ledger(|ledger, _| {
            let all = ledger.jobs();
            all.into_iter().filter(|&id| ledger.goes_on(id)).take(IMAGES_MAX).collect::<Vec<_>>()
        });
        going.iter().for_each(|&job| _ = self.images.entry(job).or_insert(None));
        while self.images.len() > IMAGES_MAX {
            let old = self.images.keys().copied().find(|job| !going.contains(job));
            old.or_else(|| self.images.keys().next().copied()).map(|job| self.images.remove(&job));
        }
    }
}

/// Frames on their way.
struct News {
    bytes: Vec<u8>,
    version: u64,
    more: bool,
}

/// What a viewer needs to have the film of a job, of which it knows a version. Blocks.
fn frames(shared: &Shared, job: JobId, known: Option<u64>) -> Option<News> {
    let spec = shared.with_ledger(|ledger, _| ledger.spec(job)).ok()?;
    let film: Window = spec.settings.film.crop;
    let changes = shared.films.changes(job, known.unwrap_or(0), PIXELS_MAX)?;
    let name = format!("tilecast {job} {}", spec.name.replace('\0', "")).trim_end().to_owned();
    let mut bytes = Vec::new();
    if known.is_none() {
        Frame::create(&name, film.width(), film.height()).put(&mut bytes);
    }
    for tile in &changes.tiles {
        Frame::update(&name, film, tile.window, &Channels::of(&tile.pixels)).put(&mut bytes);
    }
    Some(News { bytes, version: changes.version, more: changes.more })
}
