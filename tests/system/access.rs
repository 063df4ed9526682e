//! Who is let in: every kind of peer, on every call.

use crate::harness::Folder;
use std::time::Duration;
use tilecast_coordinator::Config;
use tilecast_coordinator::access::{Role, Security};
use tilecast_core::scene::Digest;
use tilecast_proto::transport::{COORDINATOR_NAME, Connector, Credentials, Line, tcp_incoming};
use tilecast_proto::wire;
use tilecast_proto::wire::jobs_client::JobsClient;
use tilecast_proto::wire::work_client::WorkClient;
use tonic::{Code, Status};

/// Every call, with an empty message: what the coordinator says to it.
async fn answers(line: &Line) -> Vec<(&'static str, Option<Code>)> {
    let (mut work, mut jobs) = (WorkClient::new(line.clone()), JobsClient::new(line.clone()));
    let code = |status: Result<(), Status>| status.err().map(|status| status.code());
    vec![
        ("Register", code(work.register(wire::Hello::default()).await.map(|_| ()))),
        ("Lease", code(work.lease(wire::LeaseRequest::default()).await.map(|_| ()))),
        ("Submit", code(work.submit(tokio_stream::iter([wire::ResultChunk::default()])).await.map(|_| ()))),
        ("Fail", code(work.fail(wire::FailRequest::default()).await.map(|_| ()))),
        ("Heartbeat", code(work.heartbeat(wire::HeartbeatRequest::default()).await.map(|_| ()))),
        ("Leave", code(work.leave(wire::LeaveRequest::default()).await.map(|_| ()))),
        ("GetBlob", code(work.get_blob(wire::BlobRequest::default()).await.map(|_| ()))),
        ("Greet", code(jobs.greet(wire::Version::default()).await.map(|_| ()))),
        ("MissingBlobs", code(jobs.missing_blobs(wire::Digests::default()).await.map(|_| ()))),
        ("PutBlob", code(jobs.put_blob(tokio_stream::iter([wire::BlobChunk::default()])).await.map(|_| ()))),
        ("SubmitJob", code(jobs.submit_job(wire::Job::default()).await.map(|_| ()))),
        ("WatchJob", code(jobs.watch_job(wire::JobId::default()).await.map(|_| ()))),
        ("FetchFilm", code(jobs.fetch_film(wire::JobId::default()).await.map(|_| ()))),
        ("CancelJob", code(jobs.cancel_job(wire::JobId::default()).await.map(|_| ()))),
        ("ListJobs", code(jobs.list_jobs(wire::ListJobsRequest {}).await.map(|_| ()))),
        ("ListWorkers", code(jobs.list_workers(wire::ListWorkersRequest {}).await.map(|_| ()))),
    ]
}

/// How many of the calls above are a worker's.
const WORKERS_CALLS: usize = 7;

/// A coordinator behind certificates, and how to come to it.
struct Guarded {
    folder: Folder,
    address: String,
}

impl Guarded {
    async fn start(with_tokens: bool) -> Self {
        let folder = Folder::new();
        assert_eq!(folder.tilecast(["certs", "init", "certs"]).code, Some(0));
        let read = |name: &str| std::fs::read(folder.path("certs").join(name)).expect("it was made");
        let tokens = [(Role::Worker, Digest::of(b"worker's")), (Role::Client, Digest::of(b"client's"))];
        let security = Security {
            certificate: read("coordinator.pem"),
            key: read("coordinator.key"),
            authority: read("ca.pem"),
            tokens: if with_tokens { tokens.to_vec() } else { Vec::new() },
        };
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        let address = listener.local_addr().expect("an address").to_string();
        let config = Config { security: Some(security), ..Config::default() };
        tokio::spawn(tilecast_coordinator::run(tcp_incoming(listener), config, std::future::pending()));
        Self { folder, address }
    }

    fn file(&self, folder: &str, name: &str) -> Vec<u8> {
        std::fs::read(self.folder.path(folder).join(name)).expect("it was made")
    }

    /// Someone with this role's certificate from `folder`, or with this token, or with neither.
    fn peer(&self, certificate: Option<(&str, &str)>, token: Option<&str>) -> Connector {
        let pair = |(folder, role): (&str, &str)| {
            (self.file(folder, &format!("{role}.pem")), self.file(folder, &format!("{role}.key")))
        };
        let credentials = Credentials {
            authority: self.file("certs", "ca.pem"),
            identity: certificate.map(pair),
            token: token.map(str::to_owned),
        };
        Connector::secure(&self.address, &credentials).expect("credentials")
    }
}

/// Refused in the handshake, or on every one of these calls before the message was looked at.
async fn refused(connector: Connector, who: &str, calls: std::ops::Range<usize>) {
    let line = match tokio::time::timeout(Duration::from_secs(20), connector.connect()).await {
        Ok(Ok(line)) => line,
        Ok(Err(_)) => return,
        Err(_) => panic!("{who}: neither in nor out"),
    };
    for (call, code) in &answers(&line).await[calls] {
        // The last is what a broken handshake looks like from here.
        let out = [Code::Unauthenticated, Code::PermissionDenied, Code::Unavailable, Code::Unknown, Code::Internal];
        assert!(code.is_some_and(|code| out.contains(&code)), "{who} on {call}: {code:?}");
    }
}

#[tokio::test]
async fn nobody_gets_in_without_a_right_and_nobody_beyond_it() {
    for with_tokens in [false, true] {
        let guarded = Guarded::start(with_tokens).await;
        assert_eq!(guarded.folder.tilecast(["certs", "init", "other"]).code, Some(0));
        expired(&guarded);
        let all = 0..16;
        let plain = Connector::tcp(&guarded.address).expect("an address");
        refused(plain, "plaintext", all.clone()).await;
        refused(guarded.peer(None, None), "no certificate", all.clone()).await;
        refused(guarded.peer(Some(("other", "admin")), None), "another authority", all.clone()).await;
        refused(guarded.peer(Some(("certs", "expired")), None), "expired", all.clone()).await;
        refused(guarded.peer(Some(("certs", "coordinator")), None), "the coordinator's as a client's", all.clone())
            .await;
        refused(guarded.peer(None, Some("worker")), "bad token", all.clone()).await;
        refused(guarded.peer(Some(("certs", "worker")), None), "worker as client", WORKERS_CALLS..16).await;
        refused(guarded.peer(Some(("certs", "client")), None), "client as worker", 0..WORKERS_CALLS).await;
        if with_tokens {
            refused(guarded.peer(None, Some("worker's")), "worker's token as client", WORKERS_CALLS..16).await;
            refused(guarded.peer(None, Some("client's")), "client's token as worker", 0..WORKERS_CALLS).await;
        }
    }
}

/// Else the test above could not fail: those who may are let in, and their messages looked at.
#[tokio::test]
async fn who_has_a_right_is_let_in() {
    let guarded = Guarded::start(true).await;
    let peers = [
        (guarded.peer(Some(("certs", "worker")), None), 0..WORKERS_CALLS),
        (guarded.peer(Some(("certs", "client")), None), WORKERS_CALLS..16),
        (guarded.peer(Some(("certs", "admin")), None), 0..16),
        (guarded.peer(None, Some("worker's")), 0..WORKERS_CALLS),
        (guarded.peer(None, Some("client's")), WORKERS_CALLS..16),
    ];
    for (connector, calls) in peers {
        let line = connector.connect().await.expect("let in");
        for (call, code) in &answers(&line).await[calls] {
            let fine = [None, Some(Code::InvalidArgument), Some(Code::NotFound), Some(Code::FailedPrecondition)];
            assert!(fine.contains(code), "{call}: {code:?}");
        }
    }
    // Whoever is not the coordinator of this authority is not talked to.
    let other = Guarded::start(false).await;
    let lost = Connector::secure(
        &other.address,
        &Credentials {
            authority: guarded.file("certs", "ca.pem"),
            identity: Some((guarded.file("certs", "worker.pem"), guarded.file("certs", "worker.key"))),
            token: None,
        },
    );
    assert!(lost.expect("credentials").connect().await.is_err(), "{COORDINATOR_NAME} of another authority");
}

/// An admin's certificate of yesterday, signed by the very authority.
fn expired(guarded: &Guarded) {
    let key =
        rcgen::KeyPair::from_pem(&String::from_utf8(guarded.file("certs", "ca.key")).expect("PEM")).expect("a key");
    // The issuer is its name and key; that is all a chain is checked for.
    let mut authority = rcgen::CertificateParams::new(Vec::new()).expect("no names");
    authority.distinguished_name = rcgen::DistinguishedName::new();
    authority.distinguished_name.push(rcgen::DnType::CommonName, "tilecast authority");
    let issuer = rcgen::Issuer::from_params(&authority, &key);
    let mut params = rcgen::CertificateParams::new(vec!["admin.tilecast".to_owned()]).expect("a name");
    params.extended_key_usages = vec![rcgen::ExtendedKeyUsagePurpose::ClientAuth];
    params.not_after = rcgen::date_time_ymd(2020, 1, 1);
    let key = rcgen::KeyPair::generate().expect("a key");
    let certificate = params.signed_by(&key, &issuer).expect("signed");
    guarded.folder.write("certs/expired.pem", certificate.pem());
    guarded.folder.write("certs/expired.key", key.serialize_pem());
}

#[test]
fn beyond_loopback_a_coordinator_wants_certificates() {
    let folder = Folder::new();
    let outcome = folder.tilecast(["coordinator", "--listen", "0.0.0.0:0"]);
    assert_eq!(outcome.code, Some(2), "{outcome:?}");
    assert!(outcome.stderr.contains("tilecast certs init"), "{outcome:?}");
    assert_eq!(folder.tilecast(["certs", "init", "certs"]).code, Some(0));
    let mut process = folder.start(["coordinator", "--listen", "0.0.0.0:0", "--certs", "certs", "--json"]);
    process.event("listening");
    // Made once: an authority that others rely on is never replaced.
    let again = folder.tilecast(["certs", "init", "certs"]);
    assert!(again.code == Some(1) && again.stderr.contains("already"), "{again:?}");
}

#[cfg(unix)]
#[test]
fn keys_are_their_owners_alone() {
    use std::os::unix::fs::PermissionsExt;
    let folder = Folder::new();
    assert_eq!(folder.tilecast(["certs", "init", "certs"]).code, Some(0));
    for name in ["ca.key", "coordinator.key", "worker.key", "client.key", "admin.key", "tokens", "worker.token"] {
        let mode = std::fs::metadata(folder.path("certs").join(name)).expect("it was made").permissions().mode();
        assert_eq!(mode & 0o077, 0, "{name}: {mode:o}");
    }
}
