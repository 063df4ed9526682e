//! `tilecast coordinator`: serves until it is told to stop.

use crate::report::{Report, Style};
use crate::stop::on_signal;
use anyhow::Context;
use std::time::{SystemTime, UNIX_EPOCH};
use tilecast_coordinator::Config;
use tilecast_proto::transport::tcp_incoming;
use tokio::net::TcpListener;

/// Where to serve.
pub struct Coordinator {
    /// HOST:PORT.
    pub listen: String,
    /// How it tells of itself.
    pub style: Style,
}

/// Serves.
///
/// # Errors
/// An address that cannot be had.
pub async fn run(Coordinator { listen, style }: Coordinator) -> anyhow::Result<()> {
    let stop = on_signal()?;
    let listener = TcpListener::bind(&listen)
        .await
        .with_context(|| format!("--listen {listen}: cannot serve there; is another coordinator running?"))?;
    Report::new(style).listening(&listener.local_addr()?.to_string());
    // Seconds since 1970 fit 32 bits until 2106; the number need only differ from those before.
    let incarnation = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| (d.as_secs() & 0xffff_ffff) as u32);
    let config = Config { incarnation, ..Config::default() };
    tilecast_coordinator::run(tcp_incoming(listener), config, stop.cancelled()).await?;
    Ok(())
}
