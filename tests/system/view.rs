//! The coordinator over HTTP: what is shown is what is written, and to whom; metrics, health and logs.

use crate::cluster::settings;
use crate::exr::{channel, read};
use crate::harness::{Coordinator, Folder, SMALL, coordinator_with, scene};
use rustls_pki_types::pem::PemObject;
use rustls_pki_types::{CertificateDer, PrivateKeyDer, ServerName};
use serde_json::Value;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tilecast_coordinator::Config;
use tilecast_coordinator::access::{Role, Security};
use tilecast_core::scene::Digest;
use tilecast_proto::client::Client;
use tilecast_proto::transport::{COORDINATOR_NAME, Connector, Credentials, tcp_incoming};
use tilecast_proto::types::JobSpec;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::{ClientConfig, RootCertStore, crypto};
use tonic_health::pb::health_client::HealthClient;
use tonic_health::pb::{HealthCheckRequest, health_check_response::ServingStatus};

/// What came back.
#[derive(Debug, Default)]
struct Answer {
    status: u16,
    head: String,
    body: Vec<u8>,
}

impl Answer {
    fn text(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }

    fn word(&self, at: usize) -> u32 {
        u32::from_le_bytes(self.body[at..at + 4].try_into().expect("four bytes"))
    }
}

/// One request over one connection; `headers` are lines.
async fn ask(mut io: impl AsyncRead + AsyncWrite + Unpin, what: &str, headers: &str) -> std::io::Result<Answer> {
    io.write_all(format!("{what} HTTP/1.1\r\nconnection: close\r\n{headers}\r\n").as_bytes()).await?;
    let mut all = Vec::new();
    io.read_to_end(&mut all).await?;
    let Some(end) = all.windows(4).position(|four| four == b"\r\n\r\n") else { return Ok(Answer::default()) };
    let head = String::from_utf8_lossy(&all[..end]).to_lowercase();
    let status = head.split(' ').nth(1).and_then(|code| code.parse().ok()).unwrap_or(0);
    Ok(Answer { status, head, body: all[end + 4..].to_vec() })
}

/// The same from a listener that anyone on this machine may ask.
async fn get(address: &str, path: &str) -> Answer {
    let io = TcpStream::connect(address).await.expect("someone listens");
    ask(io, &format!("GET {path}"), "host: localhost\r\n").await.expect("an answer")
}

/// The page's feed.
struct Feed(tokio::io::BufReader<TcpStream>);

impl Feed {
    async fn open(address: &str) -> Self {
        let mut io = TcpStream::connect(address).await.expect("someone listens");
        io.write_all(b"GET /api/live HTTP/1.1\r\nhost: localhost\r\n\r\n").await.expect("a request");
        Self(tokio::io::BufReader::new(io))
    }

    /// The next state.
    async fn next(&mut self) -> Value {
        use tokio::io::AsyncBufReadExt;
        let mut line = String::new();
        loop {
            line.clear();
            assert!(self.0.read_line(&mut line).await.expect("it goes on") > 0, "the feed has ended");
            if let Some(data) = line.strip_prefix("data: ") {
                return serde_json::from_str(data).expect("JSON");
            }
        }
    }
}

/// A coordinator process with a page, and where that is.
fn served(folder: &Folder, flags: &[&str]) -> (Coordinator, String) {
    let flags: Vec<&str> = ["--listen", "127.0.0.1:0", "--http", "127.0.0.1:0"].iter().chain(flags).copied().collect();
    let mut coordinator = coordinator_with(folder, &flags);
    let url = coordinator.process.event("viewing")["url"].as_str().expect("a URL").to_owned();
    (coordinator, url.trim_start_matches("http://").trim_end_matches('/').to_owned())
}

/// Planted faults: tiles told once too few, the channels in another order, errors instead of variances.
#[tokio::test]
async fn the_page_has_the_pixels_of_the_image_with_their_errors() {
    let folder = Folder::new();
    let (coordinator, http) = served(&folder, &[]);
    let mut feed = Feed::open(&http).await;
    assert_eq!(feed.next().await["jobs"], Value::Array(Vec::new()));
    let _worker = coordinator.worker(&folder);
    let box_ = scene("cornell-box/scene.xml");
    coordinator.submit(&folder, &[&[box_.as_str(), "--tile", "16"], &SMALL[..]].concat()).end().finished();
    let state = loop {
        let state = feed.next().await;
        if state["jobs"][0]["state"] == "finished" {
            break state;
        }
    };
    let job = &state["jobs"][0];
    assert_eq!((&job["samples_done"], &job["samples_total"]), (&Value::from(48 * 40 * 6), &Value::from(48 * 40 * 6)));
    let kinds: Vec<&str> = state["events"].as_array().unwrap().iter().filter_map(|e| e["kind"].as_str()).collect();
    assert_eq!(kinds, ["worker_came", "job_queued", "job_finished"]);
    assert_eq!((&state["workers"][0]["threads"], &state["workers_total"]), (&Value::from(1), &Value::from(1)));

    let path = format!("/api/jobs/{}/tiles/{}", job["id"], state["instance"].as_str().unwrap());
    let answer = get(&http, &format!("{path}/0")).await;
    assert_eq!((answer.status, answer.word(0), answer.word(4)), (200, 1, 0), "{}", answer.head);
    let tiles = tiles(&answer);
    let image = read(&folder.path("scene.exr"));
    for (c, name) in ["R", "G", "B"].into_iter().enumerate() {
        let (written, shown) = (channel(&image, name), &tiles.means[c]);
        assert_eq!(&written, shown, "{name}");
        for (variance, error) in channel(&image, &format!("Variance.{name}")).into_iter().zip(&tiles.errors[c]) {
            let exact = f32::from_bits(variance).sqrt();
            assert!((error - exact).abs() <= exact / 256.0, "{name}: {error}, and not {exact}");
        }
    }
    // Who has them all gets none.
    let version = u64::from(answer.word(8));
    let again = get(&http, &format!("{path}/{version}")).await;
    assert_eq!((again.status, again.word(36), again.body.len()), (200, 0, 40));
    // Of another coordinator's versions nothing is known; what is not there is not there.
    let others = format!("/api/jobs/{}/tiles/abc/0", job["id"]);
    assert_eq!(get(&http, &others).await.status, 409);
    assert_eq!(get(&http, &format!("{}/0", path.replace("/1/", "/77/"))).await.status, 404);
    assert_eq!(get(&http, "/api/jobs/77").await.status, 404);
    let detail: Value = serde_json::from_slice(&get(&http, &format!("/api/jobs/{}", job["id"])).await.body).unwrap();
    let history = detail["history"].as_array().unwrap();
    assert_eq!(history.last().unwrap()[1], 48 * 40 * 6);
    assert_eq!(history.last().unwrap()[2], job["error"]);
}

/// All tiles of an answer, put together.
struct Tiles {
    means: [Vec<u32>; 3],
    errors: [Vec<f32>; 3],
}

fn tiles(answer: &Answer) -> Tiles {
    let [x0, y0, x1, y1] = [16, 20, 24, 28].map(|at| answer.word(at));
    let (width, len) = ((x1 - x0) as usize, ((x1 - x0) * (y1 - y0)) as usize);
    let mut all =
        Tiles { means: std::array::from_fn(|_| vec![0; len]), errors: std::array::from_fn(|_| vec![0.0; len]) };
    let mut at = 40;
    for _ in 0..answer.word(36) {
        let [x, y, w, h] = [0, 4, 8, 12].map(|offset| answer.word(at + offset) as usize);
        assert_eq!(answer.word(at + 16), 6, "samples a pixel");
        let (means, errors) = (at + 24, at + 24 + 12 * w * h);
        for c in 0..3 {
            for i in 0..w * h {
                let to = (y - y0 as usize + i / w) * width + x - x0 as usize + i % w;
                all.means[c][to] = answer.word(means + 4 * (c * w * h + i));
                let half = errors + 2 * (c * w * h + i);
                let half = u16::from_le_bytes([answer.body[half], answer.body[half + 1]]);
                all.errors[c][to] = f32::from_bits(u32::from(half) << 16);
            }
        }
        at = (errors + 6 * w * h).next_multiple_of(4);
    }
    assert_eq!(at, answer.body.len());
    all
}

/// However much happens, and to each of those who look on.
#[tokio::test]
async fn states_come_twice_a_second_at_most() {
    let folder = Folder::new();
    let (coordinator, http) = served(&folder, &[]);
    let _worker = coordinator.worker(&folder);
    let box_ = scene("cornell-box/scene.xml");
    let _job = coordinator.submit(&folder, &[&box_, "--size", "64x64", "--spp", "100000", "--tile", "8"]);
    let mut feed = Feed::open(&http).await;
    feed.next().await;
    let begun = Instant::now();
    for _ in 0..4 {
        feed.next().await;
    }
    assert!(begun.elapsed() >= Duration::from_millis(4 * 500 - 100), "{:?}", begun.elapsed());
    // One that does not read holds nobody up, least of all the end.
    let _stalled = Feed::open(&http).await;
    coordinator.process.signal("TERM");
    let ended = Instant::now();
    while !feed.next().await["ending"].as_bool().unwrap() {}
    assert_eq!(coordinator.process.end().code, Some(0));
    assert!(ended.elapsed() < Duration::from_secs(20), "{:?}", ended.elapsed());
}

/// A render shows itself, and the page's end does not keep it.
#[tokio::test]
async fn a_render_serves_a_page_on_this_machine_alone() {
    let folder = Folder::new();
    let box_ = scene("cornell-box/scene.xml");
    let mut render = folder.start([&["render", &box_, "--view", "--json", "--spp", "4000"], &SMALL[..2]].concat());
    let url = render.event("viewing")["url"].as_str().unwrap().to_owned();
    let http = url.trim_start_matches("http://").trim_end_matches('/');
    let page = get(http, "/").await;
    assert!(page.status == 200 && page.text().contains("<title>tilecast</title>"), "{page:?}");
    assert!(page.head.contains("content-security-policy: default-src 'none'; script-src 'self';"), "{}", page.head);
    let mut feed = Feed::open(http).await;
    while feed.next().await["title"] != "cornell-box/scene.xml" {}
    render.end().finished();
    let refused = folder.tilecast(["render", &box_, "--view=0.0.0.0:0"]);
    assert_eq!(refused.code, Some(2), "{refused:?}");
    assert!(refused.stderr.contains("ssh -L"), "{}", refused.stderr);
}

/// In this process, behind certificates.
struct Guarded {
    folder: Folder,
    grpc: String,
    http: String,
}

impl Guarded {
    async fn start() -> Self {
        let folder = Folder::new();
        for name in ["certs", "other"] {
            assert_eq!(folder.tilecast(["certs", "init", name]).code, Some(0));
        }
        let read = |name: &str| std::fs::read(folder.path("certs").join(name)).expect("it was made");
        let tokens = [(Role::Worker, "worker's"), (Role::Client, "client's"), (Role::Client, "another's")];
        let security = Security {
            certificate: read("coordinator.pem"),
            key: read("coordinator.key"),
            authority: read("ca.pem"),
            tokens: tokens.map(|(role, token)| (role, Digest::of(token.as_bytes()))).to_vec(),
        };
        let config = Config { security: Some(security), ..Config::default() };
        let (grpc, http) = serve(config).await;
        Self { folder, grpc, http }
    }

    /// A TLS connection that shows this certificate; `Err` if the handshake fails.
    async fn dial(&self, shown: Option<(&str, &str)>) -> std::io::Result<impl AsyncRead + AsyncWrite + Unpin> {
        let file = |folder: &str, name: &str| self.folder.path(folder).join(name);
        let mut roots = RootCertStore::empty();
        roots.add(CertificateDer::from_pem_file(file("certs", "ca.pem")).unwrap()).unwrap();
        let config = ClientConfig::builder_with_provider(Arc::new(crypto::ring::default_provider()))
            .with_safe_default_protocol_versions()
            .unwrap()
            .with_root_certificates(roots);
        let config = match shown {
            None => config.with_no_client_auth(),
            Some((folder, role)) => {
                let chain = CertificateDer::from_pem_file(file(folder, &format!("{role}.pem"))).unwrap();
                let key = PrivateKeyDer::from_pem_file(file(folder, &format!("{role}.key"))).unwrap();
                config.with_client_auth_cert(vec![chain], key).unwrap()
            }
        };
        let name = ServerName::try_from(COORDINATOR_NAME).unwrap();
        let stream = TcpStream::connect(&self.http).await?;
        TlsConnector::from(Arc::new(config)).connect(name, stream).await
    }

    /// The status of an answer; 0 for none.
    async fn status(&self, shown: Option<(&str, &str)>, token: Option<&str>, what: &str) -> u16 {
        let token = token.map_or_else(String::new, |token| format!("authorization: Bearer {token}\r\n"));
        let Ok(io) = self.dial(shown).await else { return 0 };
        let headers = format!("host: coordinator.tilecast\r\nx-tilecast: 1\r\n{token}");
        ask(io, what, &headers).await.map_or(0, |answer| answer.status)
    }
}

/// Serves gRPC and HTTP; says where.
async fn serve(config: Config) -> (String, String) {
    let listen = async || TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let (grpc, http) = (listen().await, listen().await);
    let addresses = (grpc.local_addr().unwrap().to_string(), http.local_addr().unwrap().to_string());
    let coordinator = tilecast_coordinator::Coordinator::open(&config).expect("nothing to read");
    tokio::spawn(coordinator.site("title".into()).serve(http));
    tokio::spawn(coordinator.serve(tcp_incoming(grpc), std::future::pending()));
    addresses
}

/// A job that waits for workers.
fn waiting() -> JobSpec {
    JobSpec { name: "box".into(), workers_hold_scene: true, ..JobSpec::new(Digest([7; 32]), settings()) }
}

/// Every path, for everyone. Planted faults: a route without its layer, a role that is not looked at.
#[tokio::test]
async fn nobody_sees_anything_over_http_without_a_right() {
    let guarded = Guarded::start().await;
    let credentials = Credentials {
        authority: std::fs::read(guarded.folder.path("certs").join("ca.pem")).unwrap(),
        identity: None,
        token: Some("client's".into()),
    };
    let client = Client::connect(&Connector::secure(&guarded.grpc, &credentials).unwrap()).await.unwrap();
    let job = client.submit(waiting()).await.unwrap();

    let cancel = format!("POST /api/jobs/{job}/cancel");
    let closed =
        ["GET /api/jobs/1".to_owned(), "GET /api/jobs/1/tiles/x/0".into(), "GET /metrics".into(), cancel.clone()];
    let open = ["GET /", "GET /main.js", "GET /uplot.js", "GET /icon.svg", "GET /healthz", "GET /readyz"];
    for path in open {
        assert_eq!(guarded.status(None, None, path).await, 200, "{path}");
    }
    for path in closed.iter().map(String::as_str).chain(["GET /api/live"]) {
        assert_eq!(guarded.status(None, None, path).await, 401, "{path}");
        assert_eq!(guarded.status(None, Some("worker"), path).await, 401, "unknown token, {path}");
        assert_eq!(guarded.status(None, Some("worker's"), path).await, 403, "worker's token, {path}");
        assert_eq!(guarded.status(Some(("certs", "worker")), None, path).await, 403, "worker's certificate, {path}");
        assert_eq!(guarded.status(Some(("other", "admin")), None, path).await, 0, "another authority's, {path}");
    }
    assert_eq!(guarded.status(None, Some("client's"), &closed[0]).await, 200);
    assert_eq!(guarded.status(None, Some("client's"), "GET /metrics").await, 200);
    assert_eq!(guarded.status(Some(("certs", "client")), None, "GET /metrics").await, 200);
    assert_eq!(guarded.status(Some(("certs", "admin")), None, &closed[1]).await, 409);
    assert_eq!(guarded.status(None, Some("another's"), &cancel).await, 403, "it is not theirs");
    assert_eq!(guarded.status(None, Some("client's"), &cancel).await, 204);
    let plain = TcpStream::connect(&guarded.http).await.unwrap();
    let answer = ask(plain, "GET /", "host: localhost\r\n").await.unwrap_or_default();
    assert_eq!(answer.status, 0, "TLS alone is spoken: {answer:?}");
}

/// Where everybody on this machine may ask, other sites' pages may not, which readers' browsers run here.
#[tokio::test]
async fn other_sites_cannot_ask_through_a_readers_browser() {
    let (grpc, http) = serve(Config::default()).await;
    let client = Client::connect(&Connector::tcp(&grpc).unwrap()).await.unwrap();
    let job = client.submit(waiting()).await.unwrap();
    let cancel = format!("POST /api/jobs/{job}/cancel");
    let status = async |what: &str, headers: &str| {
        let io = TcpStream::connect(&http).await.unwrap();
        ask(io, what, headers).await.unwrap().status
    };
    assert_eq!(status("GET /metrics", "host: evil.example\r\n").await, 421, "a name that points here");
    assert_eq!(status(&cancel, "host: evil.example\r\nx-tilecast: 1\r\n").await, 421);
    assert_eq!(status(&cancel, "host: localhost\r\norigin: null\r\n").await, 403, "a form");
    let preflight = "host: localhost\r\norigin: null\r\naccess-control-request-headers: x-tilecast\r\n";
    assert_eq!(status(&cancel.replace("POST", "OPTIONS"), preflight).await, 405, "leave is not given");
    assert_eq!(status(&cancel, "host: localhost\r\nx-tilecast: 1\r\n").await, 204);
    assert!(client.jobs().await.unwrap()[0].state.is_final());
}

#[tokio::test]
async fn metrics_and_health_tell_what_is_there() {
    let folder = Folder::new();
    let (coordinator, http) = served(&folder, &["--log-format", "json"]);
    let metric = async |name: &str| {
        let text = get(&http, "/metrics").await.text();
        let line = text.lines().find(|line| line.rsplit_once(' ').is_some_and(|(left, _)| left == name));
        line.and_then(|line| line.rsplit_once(' ')).map(|(_, value)| value.parse::<f64>().expect("a number"))
    };
    assert_eq!(metric("tilecast_workers").await, Some(0.0));
    assert_eq!((get(&http, "/healthz").await.status, get(&http, "/readyz").await.status), (200, 200));
    let channel = tonic::transport::Endpoint::from_shared(format!("http://{}", coordinator.address)).unwrap();
    let mut health = HealthClient::new(channel.connect().await.expect("it listens"));
    for service in ["", "tilecast.v1.Work", "tilecast.v1.Jobs"] {
        let reply = health.check(HealthCheckRequest { service: service.into() }).await.expect("a known service");
        assert_eq!(reply.into_inner().status, ServingStatus::Serving as i32, "{service}");
    }
    let mut worker = folder.start(["worker", "--connect", &coordinator.address, "--log-format", "json", "--name", "w"]);
    let box_ = scene("cornell-box/scene.xml");
    coordinator.submit(&folder, &[&[box_.as_str()], &SMALL[..]].concat()).end().finished();
    assert_eq!(metric("tilecast_samples_total").await, Some(f64::from(48 * 40 * 6)));
    assert_eq!(metric("tilecast_jobs{state=\"finished\"}").await, Some(1.0));
    assert_eq!(metric("tilecast_units{state=\"lent\"}").await, Some(0.0));
    assert_eq!(metric("tilecast_events_total{kind=\"worker_came\"}").await, Some(1.0));
    assert!(metric("tilecast_result_bytes_total").await > Some(1000.0));
    worker.complains("{");
    coordinator.process.signal("TERM");
    let said = coordinator.process.end();
    let log: Vec<Value> =
        said.stderr.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|e| panic!("{e}: {line}"))).collect();
    let queued = log.iter().find(|line| line["event"] == "job_queued").expect("it was submitted");
    assert_eq!((&queued["job"], &queued["level"]), (&Value::from(1), &Value::from("INFO")));
    assert!(queued["message"].as_str().unwrap().contains("48x40 pixels, 6 samples each"), "{queued}");
}
