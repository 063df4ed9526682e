//! Coordinators and workers that are absent, taken, or another version.

use super::{FAILED, refused};
use crate::harness::{Folder, coordinator, coordinator_with, poll, scene};
use std::convert::Infallible;
use std::net::TcpListener;
use std::task::{Context, Poll};
use tilecast_proto::wire;
use tilecast_proto::wire::jobs_client::JobsClient;
use tilecast_proto::wire::work_client::WorkClient;
use tonic::codegen::{BoxFuture, Service, http};
use tonic::server::NamedService;
use tonic::{Code, Status};

/// An address on which nobody listens; the system does not give its port away again soon.
fn nobody() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    listener.local_addr().expect("an address").to_string()
}

#[test]
fn a_port_in_use() {
    let folder = Folder::new();
    let first = coordinator(&folder);
    refused(&folder, &["coordinator", "--listen", &first.address], FAILED, &["--listen", &first.address]);
    refused(&folder, &["coordinator", "--listen", "nonsense"], FAILED, &["--listen", "nonsense"]);
}

/// Each way of not fitting is told as what it is. Fails if the words of TLS change, which people would see bare then.
#[test]
fn certificates_that_do_not_fit() {
    let folder = Folder::new();
    for name in ["ours", "theirs"] {
        assert_eq!(folder.tilecast(["certs", "init", name]).code, Some(0));
    }
    let secure = coordinator_with(&folder, &["--listen", "127.0.0.1:0", "--certs", "ours"]);
    let status = ["status", "--connect", &secure.address];
    refused(&folder, &status, FAILED, &["hangs up at the first word", "--certs"]);
    refused(&folder, &[&status[..], &["--certs", "theirs"]].concat(), FAILED, &["of another `tilecast certs init`"]);
    let open = coordinator(&folder);
    let status = ["status", "--connect", &open.address, "--certs", "ours"];
    refused(&folder, &status, FAILED, &["started without --certs"]);
}

#[test]
fn a_coordinator_that_is_not_there() {
    let (folder, address, scene) = (Folder::new(), nobody(), scene("cornell-box/scene.xml"));
    let message = ["no coordinator answers", address.as_str()];
    refused(&folder, &["submit", &scene, "--connect", &address], FAILED, &message);
    refused(&folder, &["status", "--connect", &address], FAILED, &message);
    refused(&folder, &["cancel", "1", "--connect", &address], FAILED, &message);
}

#[test]
fn a_worker_waits_for_its_coordinator() {
    let (folder, address) = (Folder::new(), nobody());
    let mut worker = folder.start(["worker", "--connect", &address, "--threads", "1"]);
    worker.complains("trying again");
    let mut process = folder.start(["coordinator", "--listen", &address, "--json"]);
    process.event("listening");
    poll("the worker at the coordinator", || {
        let outcome = folder.tilecast(["status", "--json", "--connect", &address]);
        outcome.events().iter().find(|line| line["pid"] == worker.pid()).map(|_| ())
    });
    worker.signal("TERM");
    assert_eq!(worker.end().code, Some(0));
}

#[tokio::test]
async fn a_coordinator_refuses_other_versions() {
    let folder = Folder::new();
    let cluster = coordinator(&folder);
    let uri = format!("http://{}", cluster.address);
    let ours = wire::Version::from(tilecast_proto::version::Version::ours());
    for version in [
        wire::Version { engine: "0.0.1-other".into(), ..ours.clone() },
        wire::Version { protocol: ours.protocol + 1, ..ours.clone() },
    ] {
        let hello = wire::Hello {
            version: Some(version.clone()),
            threads: 1,
            isa: "portable".into(),
            instance: 1,
            ..Default::default()
        };
        let mut work = WorkClient::connect(uri.clone()).await.expect("the coordinator answers");
        let refusal = work.register(hello.clone()).await.expect_err("another version");
        assert_eq!(refusal.code(), Code::FailedPrecondition);
        let names = refusal.message().contains(&version.engine) && refusal.message().contains(tilecast_core::VERSION);
        assert!(names, "{}", refusal.message());
        work.register(wire::Hello { version: Some(ours.clone()), ..hello }).await.expect("the same version");
        let mut jobs = JobsClient::connect(uri.clone()).await.expect("the coordinator answers");
        assert_eq!(jobs.greet(version).await.expect_err("another version").code(), Code::FailedPrecondition);
    }
}

/// A coordinator of another version: it refuses every call.
#[derive(Clone)]
struct Stranger<const JOBS: bool>;

impl<const JOBS: bool> NamedService for Stranger<JOBS> {
    const NAME: &'static str = if JOBS { "tilecast.v1.Jobs" } else { "tilecast.v1.Work" };
}

impl<const JOBS: bool> Service<http::Request<tonic::body::Body>> for Stranger<JOBS> {
    type Response = http::Response<tonic::body::Body>;
    type Error = Infallible;
    type Future = BoxFuture<Self::Response, Infallible>;

    fn poll_ready(&mut self, _: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
        Poll::Ready(Ok(()))
    }

    fn call(&mut self, _: http::Request<tonic::body::Body>) -> Self::Future {
        Box::pin(async {
            Ok(Status::failed_precondition("the peer is engine 9.9.9; run the same tilecast").into_http())
        })
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_coordinator_of_another_version_is_an_error() {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let address = listener.local_addr().expect("an address").to_string();
    let server = tonic::transport::Server::builder().add_service(Stranger::<true>).add_service(Stranger::<false>);
    let serving = tokio::spawn(server.serve_with_incoming(tilecast_proto::transport::tcp_incoming(listener)));
    let refusals = tokio::task::spawn_blocking(move || {
        let folder = Folder::new();
        refused(&folder, &["status", "--connect", &address], FAILED, &["engine 9.9.9"]);
        let outcome = folder.tilecast(["worker", "--connect", &address, "--threads", "1"]);
        assert_eq!(outcome.code, Some(FAILED), "a worker does not try for ever: {outcome:?}");
        assert!(
            outcome.stderr.contains("refuses this worker") && outcome.stderr.contains("engine 9.9.9"),
            "{outcome:?}"
        );
    });
    refusals.await.expect("the refusals are as they should be");
    serving.abort();
}
