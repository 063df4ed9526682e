//! Traces of units, from lease to merge, for a collector that speaks OTLP (OpenTelemetry's protocol) over gRPC.
//!
//! The collector never holds a render up: what is to be told goes into a queue of bounded length that nobody waits for, and
//! what does not fit is dropped and counted, as is what a collector does not take in time.

mod spans;
pub(crate) mod way;

use crate::pace::until_closed;
use crate::service::Shared;
use opentelemetry::KeyValue;
pub use opentelemetry_otlp::ExporterBuildError as EndpointError;
use opentelemetry_otlp::{SpanExporter, WithExportConfig};
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::trace::SpanExporter as _;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;
use way::Way;

/// The port that collectors listen on, unless they are told otherwise.
pub const PORT: u16 = 4317;
/// Ways that wait. A worker's thread makes about one a second: of more than a thousand threads, some are told.
const QUEUE_LEN: usize = 1024;
/// Ways that go together, some six spans each.
const BATCH_LEN: usize = 128;
/// Others are waited for so long, so that a batch is worth a call.
const GATHER: Duration = Duration::from_millis(500);
/// A collector has this long to take a batch,
const EXPORT_MAX: Duration = Duration::from_secs(5);
/// and this long for all that is left when the coordinator ends.
const LINGER: Duration = Duration::from_secs(2);

/// Where ways are told, by whoever sees them end.
#[derive(Debug)]
pub(crate) struct Told {
    ways: mpsc::Sender<Way>,
    /// Those that a collector has taken.
    pub sent: AtomicU64,
    /// Those that are lost.
    pub dropped: AtomicU64,
}

impl Told {
    /// Never waits.
    pub fn tell(&self, way: Way) {
        if self.ways.try_send(way).is_err() {
            self.dropped.fetch_add(1, Relaxed);
        }
    }
}

/// Sends traces to a collector: made by [`crate::Coordinator::otlp`].
pub struct Otlp {
    shared: Arc<Shared>,
    told: Arc<Told>,
    ways: mpsc::Receiver<Way>,
    exporter: SpanExporter,
    endpoint: String,
    /// It has been said that the collector does not answer.
    complained: bool,
}

impl Otlp {
    /// For a collector at `endpoint`, `http://HOST:PORT`. Nothing connects yet.
    pub(crate) fn new(shared: Arc<Shared>, endpoint: String) -> Result<Self, EndpointError> {
        let builder = SpanExporter::builder().with_tonic().with_endpoint(&endpoint).with_timeout(EXPORT_MAX);
        let mut exporter = builder.build()?;
        let named = [
            KeyValue::new("service.name", "tilecast-coordinator"),
            KeyValue::new("service.version", env!("CARGO_PKG_VERSION")),
            KeyValue::new("service.instance.id", format!("{:x}", shared.instance)),
        ];
        exporter.set_resource(&Resource::builder_empty().with_attributes(named).build());
        let (sender, ways) = mpsc::channel(QUEUE_LEN);
        let told = Arc::new(Told { ways: sender, sent: AtomicU64::new(0), dropped: AtomicU64::new(0) });
        let told = Arc::clone(shared.told.get_or_init(|| told));
        Ok(Self { shared, told, ways, exporter, endpoint, complained: false })
    }

    /// Sends until the coordinator ends, and the last ones then.
    pub async fn run(mut self) {
        let closing = self.shared.closing.clone();
        until_closed(&closing, LINGER, self.follow(&closing)).await;
    }

    async fn follow(&mut self, closing: &CancellationToken) {
        let mut batch = Vec::with_capacity(BATCH_LEN);
        while !closing.is_cancelled() {
            tokio::select! {
                () = self.gather(&mut batch) => {}
                () = closing.cancelled() => {}
            }
            self.send(&mut batch).await;
        }
        while let Ok(way) = self.ways.try_recv() {
            batch.push(way);
            if batch.len() == BATCH_LEN || self.ways.is_empty() {
                self.send(&mut batch).await;
            }
        }
    }

    /// Waits for a way, and then a moment for others.
    async fn gather(&mut self, batch: &mut Vec<Way>) {
        self.ways.recv_many(batch, BATCH_LEN).await;
        let moment = tokio::time::sleep(GATHER);
        tokio::pin!(moment);
        while batch.len() < BATCH_LEN {
            let room = BATCH_LEN - batch.len();
            tokio::select! {
                _ = self.ways.recv_many(batch, room) => {}
                () = &mut moment => return,
            }
        }
    }

    async fn send(&mut self, batch: &mut Vec<Way>) {
        if batch.is_empty() {
            return;
        }
        let ways = batch.len() as u64;
        let spans = batch.drain(..).flat_map(|way| spans::of(self.shared.instance, &way)).collect();
        let why = match tokio::time::timeout(EXPORT_MAX, self.exporter.export(spans)).await {
            Ok(Ok(())) => {
                self.told.sent.fetch_add(ways, Relaxed);
                self.complained = false;
                return;
            }
            Ok(Err(error)) => error.to_string(),
            Err(_) => format!("no answer within {} s", EXPORT_MAX.as_secs()),
        };
        self.told.dropped.fetch_add(ways, Relaxed);
        if !std::mem::replace(&mut self.complained, true) {
            let endpoint = &self.endpoint;
            tracing::warn!(endpoint, why, "the collector does not take traces; they are dropped until it does");
        }
    }
}
