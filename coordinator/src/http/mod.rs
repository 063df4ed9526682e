//! The coordinator over HTTP, for people and monitors: a page that shows images as they converge, metrics, and health.
//!
//! Nothing is computed while nobody asks, nothing is kept for anybody who asks, and what is shown is read by the same calls
//! that the gRPC service uses. What may be asked by whom is the same as there, see [`guard`].

mod assets;
mod guard;
mod health;
mod listen;
mod live;
mod metrics;
mod tiles;

use crate::access::Security;
use crate::pace::Pace;
use crate::service::Shared;
use axum::Router;
use axum::routing::{get, post};
use live::Feed;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

pub use listen::TlsError;

/// When the coordinator ends, whoever looks on has this long to fetch what it has not seen.
const LINGER: Duration = Duration::from_secs(1);

/// What HTTP serves of a coordinator: made by [`crate::Coordinator::site`].
#[derive(Clone)]
pub struct Site(Arc<Inner>);

pub(crate) struct Inner {
    pub shared: Arc<Shared>,
    pub security: Option<Arc<Security>>,
    /// Named on top of the page.
    pub title: String,
    pub feed: Feed,
    pub pace: Pace,
    /// Connections end.
    gone: CancellationToken,
}

impl Site {
    pub(crate) fn new(shared: Arc<Shared>, security: Option<Arc<Security>>, title: String) -> Self {
        let (feed, pace, gone) = (Feed::default(), Pace::default(), CancellationToken::new());
        Self(Arc::new(Inner { shared, security, title, feed, pace, gone }))
    }

    /// Serves until the coordinator ends, and a moment longer if someone looks on.
    ///
    /// # Errors
    /// Certificates that cannot be used.
    pub async fn serve(self, listener: TcpListener) -> Result<(), TlsError> {
        let tls = self.0.security.as_deref().map(listen::tls).transpose()?;
        let (closing, gone) = (self.0.shared.closing.clone(), self.0.gone.clone());
        let serving = listen::serve(listener, self.router(), tls, gone.clone());
        let ending = async {
            closing.cancelled().await;
            if self.0.feed.watched() {
                tokio::time::sleep(LINGER).await;
            }
        };
        tokio::select! {
            () = serving => {}
            () = ending => {}
        }
        gone.cancel();
        Ok(())
    }

    fn router(&self) -> Router {
        let guarded = Router::new()
            .route("/api/live", get(live::live))
            .route("/api/jobs/{job}", get(live::job))
            .route("/api/jobs/{job}/tiles/{instance}/{since}", get(tiles::tiles))
            .route("/api/jobs/{job}/cancel", post(guard::cancel))
            .route("/metrics", get(metrics::metrics))
            .layer(axum::middleware::from_fn_with_state(Arc::clone(&self.0), guard::clients_only));
        let open = assets::routes().route("/healthz", get(health::healthz)).route("/readyz", get(health::readyz));
        guarded
            .merge(open)
            .layer(axum::middleware::from_fn_with_state(Arc::clone(&self.0), guard::everyone))
            .with_state(Arc::clone(&self.0))
    }
}
