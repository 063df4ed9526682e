//! Who is let in: every kind of peer, on every call.

use crate::cluster;
use crate::harness::{Folder, free_address};
use std::time::Duration;
use tilecast_coordinator::Config;
use tilecast_coordinator::access::{Role, Security};
use tilecast_core::scene::Digest;
use tilecast_proto::client::{Client, ClientError};
use tilecast_proto::transport::{COORDINATOR_NAME, Connector, Credentials, Line, tcp_incoming};
use tilecast_proto::types::{JobSpec, JobState, Progress};
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
        ("ListContributions", code(jobs.list_contributions(wire::JobId::default()).await.map(|_| ()))),
    ]
}

/// How many of the calls above are a worker's.
const WORKERS_CALLS: usize = 7;
/// And how many there are.
const CALLS: usize = 17;

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
        let all = 0..CALLS;
        let plain = Connector::tcp(&guarded.address).expect("an address");
        refused(plain, "plaintext", all.clone()).await;
        refused(guarded.peer(None, None), "no certificate", all.clone()).await;
        refused(guarded.peer(Some(("other", "admin")), None), "another authority", all.clone()).await;
        refused(guarded.peer(Some(("certs", "expired")), None), "expired", all.clone()).await;
        refused(guarded.peer(Some(("certs", "coordinator")), None), "the coordinator's as a client's", all.clone())
            .await;
        refused(guarded.peer(None, Some("worker")), "bad token", all.clone()).await;
        refused(guarded.peer(Some(("certs", "worker")), None), "worker as client", WORKERS_CALLS..CALLS).await;
        refused(guarded.peer(Some(("certs", "client")), None), "client as worker", 0..WORKERS_CALLS).await;
        if with_tokens {
            refused(guarded.peer(None, Some("worker's")), "worker's token as client", WORKERS_CALLS..CALLS).await;
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
        (guarded.peer(Some(("certs", "client")), None), WORKERS_CALLS..CALLS),
        (guarded.peer(Some(("certs", "admin")), None), 0..CALLS),
        (guarded.peer(None, Some("worker's")), 0..WORKERS_CALLS),
        (guarded.peer(None, Some("client's")), WORKERS_CALLS..CALLS),
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

/// Every call that there is, is in the matrix above. Fails when one is added to the protocol and not there.
#[test]
fn the_matrix_has_every_call() {
    let protocol = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/proto/proto/render.proto"))
        .expect("the protocol");
    assert_eq!(protocol.lines().filter(|line| line.trim_start().starts_with("rpc ")).count(), CALLS);
}

/// Clients are told apart by what they show: nobody but its owner or an admin ends a job. Fails if a coordinator forgets whose
/// a job is, or takes all of a role for one.
#[tokio::test]
async fn a_job_is_cancelled_by_its_owner_or_an_admin_alone() {
    let guarded = Guarded::start(true).await;
    let owner = Client::connect(&guarded.peer(Some(("certs", "client")), None)).await.expect("let in");
    let other = Client::connect(&guarded.peer(None, Some("client's"))).await.expect("let in");
    let admin = Client::connect(&guarded.peer(Some(("certs", "admin")), None)).await.expect("let in");
    for ends in [&owner, &admin] {
        let job = owner.submit(JobSpec { workers_hold_scene: true, ..cluster::job() }).await.expect("accepted");
        let Err(ClientError::Call(refusal)) = other.cancel(job).await else { panic!("another has cancelled it") };
        assert_eq!(refusal.code(), Code::PermissionDenied, "{refusal}");
        let state = |jobs: &[Progress]| jobs.iter().find(|listed| listed.job == job).map(|listed| listed.state.clone());
        assert_eq!(state(&other.jobs().await.expect("a list")), Some(JobState::Queued), "it waits as before");
        assert_eq!(ends.cancel(job).await.expect("cancelled").state, JobState::Cancelled);
    }
}

/// A ticket is a client's own: another's guess of it gives a job of its own, and never someone else's.
#[tokio::test]
async fn a_ticket_is_good_for_who_made_it() {
    let guarded = Guarded::start(true).await;
    let owner = Client::connect(&guarded.peer(Some(("certs", "client")), None)).await.expect("let in");
    let other = Client::connect(&guarded.peer(None, Some("client's"))).await.expect("let in");
    let job = JobSpec { workers_hold_scene: true, ticket: 5, ..cluster::job() };
    let ours = owner.submit(job.clone()).await.expect("accepted");
    assert_ne!(other.submit(job.clone()).await.expect("accepted"), ours);
    assert_eq!(owner.submit(job).await.expect("known"), ours);
}

/// With everything logged that can be, by those who show a token and by who checks it.
#[test]
fn no_secret_is_logged() {
    let folder = Folder::new();
    assert_eq!(folder.tilecast(["certs", "init", "certs"]).code, Some(0));
    let address = free_address();
    let log = [("TILECAST_LOG", "trace")];
    let secure = ["--certs", "certs", "--token-file"];
    let listen = ["coordinator", "--json", "--listen", address.as_str()];
    let mut coordinator = folder.start_with(listen.into_iter().chain(secure).chain(["certs/tokens"]), &log);
    coordinator.event("listening");
    let connect = ["worker", "--threads", "1", "--connect", address.as_str()];
    let mut worker = folder.start_with(connect.into_iter().chain(secure).chain(["certs/worker.token"]), &log);
    worker.complains("registered");
    let mut said = String::new();
    for process in [worker, coordinator] {
        process.signal("TERM");
        let outcome = process.end();
        assert_eq!(outcome.code, Some(0), "{outcome:?}");
        said += &(outcome.stdout + &outcome.stderr);
    }
    assert!(said.contains("TRACE"), "that is not everything");
    let read = |name: &str| std::fs::read_to_string(folder.path("certs").join(name)).expect("it was made");
    let tokens = read("tokens");
    let keys = ["ca.key", "coordinator.key", "worker.key"].map(read).concat();
    let secrets = tokens.split_whitespace().filter(|word| word.len() > 10);
    // Lines of a key between those that say so.
    let secrets: Vec<&str> = secrets.chain(keys.lines().filter(|line| !line.starts_with('-'))).collect();
    assert!(secrets.len() > 3 && secrets.iter().all(|secret| !said.contains(secret)), "a log tells a secret");
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
