//! Looking on: where the live page is served, and how people get to see it; the viewer and the collector that are sent to.

use crate::flags::Usage;
use anyhow::Context;
use std::io::IsTerminal;
use std::process::{Command, Stdio};
use tilecast_coordinator::Coordinator;
use tokio::net::TcpListener;
use tokio::task::JoinHandle;

/// What shows the images of a coordinator.
#[derive(Default)]
pub struct Lookers {
    /// The page.
    pub view: Option<View>,
    /// tev's address, HOST:PORT.
    pub tev: Option<String>,
    /// A collector's, `http://HOST:PORT`.
    pub otlp: Option<String>,
}

impl Lookers {
    /// Shows what there is to see of a coordinator.
    ///
    /// # Errors
    /// A collector's address that is none.
    pub fn show(self, coordinator: &Coordinator) -> anyhow::Result<Page> {
        let mut page = Page::default();
        if let Some(View { listener, title, .. }) = self.view {
            let site = coordinator.site(title);
            page.0.push(tokio::spawn(async move { Ok(site.serve(listener).await?) }));
        }
        if let Some(address) = self.tev {
            let tev = coordinator.tev(address);
            page.0.push(tokio::spawn(async move {
                tev.run().await;
                Ok(())
            }));
        }
        if let Some(endpoint) = self.otlp {
            let otlp = coordinator.otlp(endpoint.clone()).with_context(|| format!("--otlp {endpoint}"))?;
            page.0.push(tokio::spawn(async move {
                otlp.run().await;
                Ok(())
            }));
        }
        Ok(page)
    }
}

/// An address that is taken, and what the page says on top.
pub struct View {
    listener: TcpListener,
    title: String,
    /// Where people find it.
    pub url: String,
}

/// What is shown; it ends soon after its coordinator.
#[derive(Default)]
pub struct Page(Vec<JoinHandle<anyhow::Result<()>>>);

impl View {
    /// Takes the address that a flag gave. Beyond loopback only what is `secured` is served.
    ///
    /// # Errors
    /// An address that cannot be had, or that others could reach.
    pub async fn bind(flag: &str, address: &str, secured: bool, title: String) -> anyhow::Result<Self> {
        let listener = TcpListener::bind(address)
            .await
            .with_context(|| format!("{flag} {address}: cannot serve there; is something else there already?"))?;
        let local = listener.local_addr()?;
        if !local.ip().is_loopback() && !secured {
            let what = format!("{flag} {address}: others could reach it, and there is nothing to tell friend from foe");
            let port = local.port();
            let how = format!(
                "serve on 127.0.0.1 and come from elsewhere with `ssh -L {port}:127.0.0.1:{port} HOST`, or run a \
                 `tilecast coordinator` with --certs"
            );
            return Err(Usage(format!("{what}; {how}")).into());
        }
        let scheme = if secured { "https" } else { "http" };
        Ok(Self { listener, title, url: format!("{scheme}://{local}/") })
    }
}

impl Page {
    /// Waits until those who look on have seen the last of it.
    ///
    /// # Errors
    /// If it could not be served.
    pub async fn end(self) -> anyhow::Result<()> {
        for shown in self.0 {
            shown.await.context("showing what there is to see panicked")??;
        }
        Ok(())
    }
}

/// Opens the page, if someone sits before this machine's screen. Whether that succeeds is theirs to see.
pub fn open(url: &str) {
    let screen = ["DISPLAY", "WAYLAND_DISPLAY"].iter().any(|name| std::env::var_os(name).is_some());
    let opener = match std::env::consts::OS {
        "macos" => "open",
        "windows" => "explorer",
        _ if screen => "xdg-open",
        _ => return,
    };
    if std::io::stdout().is_terminal() {
        let _ = Command::new(opener).arg(url).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
    }
}
