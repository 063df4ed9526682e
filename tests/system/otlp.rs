//! Traces as a collector gets them: OpenTelemetry's own messages, received by a server of its own service. A collector that is
//! absent, or takes nothing, costs a render neither time nor bits.

use crate::harness::{Coordinator, Folder, SMALL, coordinator_with, free_address, poll, scene};
use opentelemetry_proto::tonic::collector::trace::v1::trace_service_server::{TraceService, TraceServiceServer};
use opentelemetry_proto::tonic::collector::trace::v1::{ExportTraceServiceRequest, ExportTraceServiceResponse};
use opentelemetry_proto::tonic::common::v1::any_value::Value;
use opentelemetry_proto::tonic::trace::v1::Span;
use opentelemetry_proto::tonic::trace::v1::status::StatusCode;
use std::collections::BTreeMap;
use std::net::TcpListener;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tilecast_proto::transport::tcp_incoming;
use tonic::{Request, Response, Status};

/// What a collector has received.
#[derive(Clone, Default)]
struct Collector(Arc<Mutex<Vec<ExportTraceServiceRequest>>>);

#[tonic::async_trait]
impl TraceService for Collector {
    async fn export(
        &self,
        request: Request<ExportTraceServiceRequest>,
    ) -> Result<Response<ExportTraceServiceResponse>, Status> {
        self.0.lock().expect("no panic").push(request.into_inner());
        Ok(Response::new(ExportTraceServiceResponse::default()))
    }
}

impl Collector {
    /// One that listens, for as long as the runtime is there.
    fn start(runtime: &tokio::runtime::Runtime) -> (Self, String) {
        let collector = Self::default();
        let service = TraceServiceServer::new(collector.clone());
        let listener = runtime.block_on(tokio::net::TcpListener::bind("127.0.0.1:0")).expect("a free port");
        let address = listener.local_addr().expect("an address").to_string();
        let _in = runtime.enter();
        let incoming = tcp_incoming(listener);
        runtime.spawn(tonic::transport::Server::builder().add_service(service).serve_with_incoming(incoming));
        (collector, address)
    }

    /// All spans, by trace.
    fn traces(&self) -> BTreeMap<Vec<u8>, Vec<Span>> {
        let mut traces = BTreeMap::<_, Vec<_>>::new();
        for resource in self.0.lock().expect("no panic").iter().flat_map(|request| request.resource_spans.clone()) {
            let named = resource.resource.expect("who sends").attributes;
            assert!(named.iter().any(|one| one.key == "service.name"), "{named:?}");
            for span in resource.scope_spans.into_iter().flat_map(|scope| scope.spans) {
                traces.entry(span.trace_id.clone()).or_default().push(span);
            }
        }
        traces
    }
}

/// An attribute as text.
fn attribute(span: &Span, key: &str) -> Option<String> {
    let found = span.attributes.iter().find(|one| one.key == key)?;
    match found.value.as_ref()?.value.as_ref()? {
        Value::StringValue(text) => Some(text.clone()),
        Value::IntValue(number) => Some(number.to_string()),
        other => panic!("{key} is {other:?}"),
    }
}

fn collected(folder: &Folder, collector: &str) -> Coordinator {
    coordinator_with(folder, &["--listen", "127.0.0.1:0", "--otlp", collector])
}

/// Every sample of the image is in the trace of one unit that was accepted, whose steps follow each other from its lease to its
/// merge. Fails if a step's times are not those between its neighbours', or a unit is told twice.
#[test]
fn every_unit_has_a_trace_from_lease_to_merge() {
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    let (collector, address) = Collector::start(&runtime);
    let folder = Folder::new();
    let coordinator = collected(&folder, &address);
    let worker = folder.start(["worker", "--connect", &coordinator.address, "--threads", "1", "--name", "alpha"]);
    let box_ = scene("cornell-box/scene.xml");
    let args: Vec<&str> = [box_.as_str()].into_iter().chain(SMALL).chain(["--tile", "16"]).collect();
    coordinator.submit(&folder, &args).end().finished();
    // The last ones come when the coordinator ends, if not before.
    coordinator.process.signal("TERM");
    coordinator.process.end();
    drop(worker);

    let traces = collector.traces();
    let mut samples = 0;
    for spans in traces.values() {
        let (roots, steps): (Vec<&Span>, Vec<&Span>) = spans.iter().partition(|span| span.parent_span_id.is_empty());
        let [unit] = roots[..] else { panic!("not one root: {spans:?}") };
        assert_eq!(unit.name, "unit");
        let names: Vec<&str> = steps.iter().map(|step| step.name.as_str()).collect();
        assert_eq!(names, ["wait", "trace", "transfer", "validate", "merge"]);
        assert!(steps.iter().all(|step| step.parent_span_id == unit.span_id), "{spans:?}");
        let mut at = unit.start_time_unix_nano;
        for step in &steps {
            assert_eq!(step.start_time_unix_nano, at, "{} begins where the step before ended", step.name);
            at = step.end_time_unix_nano;
        }
        assert_eq!(at, unit.end_time_unix_nano);
        let of = |key| attribute(unit, key).unwrap_or_else(|| panic!("no {key}: {unit:?}"));
        assert_eq!((of("tilecast.job"), of("tilecast.worker.name")), ("1".into(), "alpha".into()));
        assert_eq!((of("tilecast.worker"), of("tilecast.outcome")), ("1".into(), "accepted".into()));
        let tile: Vec<u64> = of("tilecast.tile").split(',').map(|n| n.parse().expect("a pixel")).collect();
        let range = of("tilecast.samples");
        let (start, end) = range.split_once("..").expect("a range");
        let (start, end): (u64, u64) = (start.parse().expect("a sample"), end.parse().expect("a sample"));
        samples += (tile[2] - tile[0]) * (tile[3] - tile[1]) * (end - start);
    }
    assert_eq!(samples, 48 * 40 * 6, "all samples, each in one trace: {} traces", traces.len());
    let traced = |span: &&Span| span.name == "trace" && span.end_time_unix_nano > span.start_time_unix_nano;
    assert!(traces.values().flatten().any(|span| traced(&span)), "tracing takes time");
}

/// A worker that is killed: its lease has a trace that says so.
#[test]
fn a_lease_that_lapses_is_an_error() {
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    let (collector, address) = Collector::start(&runtime);
    let folder = Folder::new();
    let mut coordinator = collected(&folder, &address);
    let worker = coordinator.worker(&folder);
    let box_ = scene("cornell-box/scene.xml");
    let _submit = coordinator.submit(&folder, &[&box_, "--spp", "1000000"]);
    poll("leases", || coordinator.status(&folder, "worker").first()?["leases"].as_u64().filter(|&held| held > 0));
    worker.signal("KILL");
    coordinator.process.complains("are given to others");
    let lapsed = poll("its trace", || {
        let all: Vec<Span> = collector.traces().into_values().flatten().collect();
        all.into_iter().find(|span| attribute(span, "tilecast.outcome").as_deref() == Some("lapsed"))
    });
    assert_eq!(lapsed.status.map(|status| status.code()), Some(StatusCode::Error));
    let took = Duration::from_nanos(lapsed.end_time_unix_nano - lapsed.start_time_unix_nano);
    assert!(took >= Duration::from_secs(4), "it was waited for: {took:?}");
}

/// One that is not there, and one that accepts and never answers.
#[test]
fn a_collector_that_is_absent_or_stalled_changes_nothing() {
    let folder = Folder::new();
    let box_ = scene("cornell-box/scene.xml");
    let alone = folder.render(&box_, SMALL);
    let stalled = TcpListener::bind("127.0.0.1:0").expect("a free port");
    for address in [free_address(), stalled.local_addr().expect("an address").to_string()] {
        let coordinator = collected(&folder, &address);
        let _worker = coordinator.worker(&folder);
        let args: Vec<&str> = [box_.as_str()].into_iter().chain(SMALL).collect();
        assert_eq!(coordinator.submit(&folder, &args).end().finished()["digest"], alone["digest"]);
        let begun = Instant::now();
        coordinator.process.signal("TERM");
        assert_eq!(coordinator.process.end().code, Some(0));
        assert!(begun.elapsed() < Duration::from_secs(30), "its end waits for nobody: {:?}", begun.elapsed());
    }
    let wrong = folder.tilecast(["coordinator", "--listen", "127.0.0.1:0", "--otlp", "https://far:4317"]);
    assert_eq!(wrong.code, Some(2), "{wrong:?}");
}
