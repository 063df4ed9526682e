//! `tilecast coordinator`: serves until it is told to stop.

use crate::LogFormat;
use crate::flags::Usage;
use crate::report::{Report, Style};
use crate::stop::on_signal;
use crate::view::{Lookers, View};
use anyhow::Context;
use std::path::PathBuf;
use std::time::{SystemTime, UNIX_EPOCH};
use tilecast_coordinator::Config;
use tilecast_coordinator::access::Security;
use tilecast_proto::transport::tcp_incoming;
use tokio::net::TcpListener;
use tokio::task::spawn_blocking;

/// Where to serve.
pub struct Coordinator {
    /// HOST:PORT.
    pub listen: String,
    /// Where the page is served, HOST:PORT.
    pub http: Option<String>,
    /// Where a tev listens, HOST:PORT.
    pub tev: Option<String>,
    /// Where a collector of traces listens, `http://HOST:PORT`.
    pub otlp: Option<String>,
    /// Where jobs and films are kept.
    pub state: Option<PathBuf>,
    /// The share of units that is done twice.
    pub verify: f64,
    /// Whom it lets in.
    pub security: Option<Security>,
    /// How it tells of itself.
    pub style: Style,
    /// How its log is written.
    pub log: LogFormat,
}

/// Serves.
///
/// # Errors
/// An address that cannot be had.
pub async fn run(
    Coordinator { listen, http, tev, otlp, state, verify, security, style, .. }: Coordinator,
) -> anyhow::Result<()> {
    let stop = on_signal()?;
    #[cfg(unix)]
    open_many_files();
    let listener = TcpListener::bind(&listen)
        .await
        .with_context(|| format!("--listen {listen}: cannot serve there; is another coordinator running?"))?;
    let address = listener.local_addr()?;
    if !address.ip().is_loopback() && security.is_none() {
        let what = format!("--listen {listen}: others could reach it, and there is nothing to tell friend from foe");
        return Err(
            Usage(format!("{what}; make certificates with `tilecast certs init certs` and add --certs certs")).into()
        );
    }
    let address = address.to_string();
    let view = match &http {
        Some(http) => Some(View::bind("--http", http, security.is_some(), String::new()).await?),
        None => None,
    };
    let coordinator = open(Config { verify, security, ..config(state) }).await?;
    let mut report = Report::new(style);
    report.listening(&address);
    view.iter().for_each(|view| report.viewing(&view.url));
    let page = Lookers { view, tev, otlp }.show(&coordinator)?;
    coordinator.serve(tcp_incoming(listener), stop.cancelled()).await?;
    page.end().await
}

/// Every connection is an open file, and systems are used to allowing 1024 unless one asks for what one may have.
#[cfg(unix)]
fn open_many_files() {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    let limits = getrlimit(Resource::Nofile);
    let _ = setrlimit(Resource::Nofile, Rlimit { current: limits.maximum, ..limits });
    tracing::debug!(files = ?getrlimit(Resource::Nofile).current, "as many connections can be served");
}

/// How a coordinator is set up that starts now.
pub fn config(state: Option<PathBuf>) -> Config {
    let epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    // Seconds since 1970 fit 32 bits until 2106; the number need only differ from those before.
    let incarnation = (epoch.as_secs() & 0xffff_ffff) as u32;
    Config { incarnation, epoch, state, ..Config::default() }
}

/// A coordinator that has read its state.
///
/// # Errors
/// State that cannot be had.
pub async fn open(config: Config) -> anyhow::Result<tilecast_coordinator::Coordinator> {
    let opened = spawn_blocking(move || tilecast_coordinator::Coordinator::open(&config));
    Ok(opened.await.context("reading the state panicked")??)
}
