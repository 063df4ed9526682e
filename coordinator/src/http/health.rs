//! Whether the coordinator is well, for whoever restarts or reaches it: asked without a token, and telling nothing else.

use super::Inner;
use axum::extract::State;
use axum::http::StatusCode;
use std::sync::Arc;

/// Alive: it answers, and its ledger can be had.
pub async fn healthz(State(site): State<Arc<Inner>>) -> &'static str {
    site.shared.with_ledger(|_, _| ());
    "ok\n"
}

/// Ready: it takes jobs and lends units, and what it promises is kept.
pub async fn readyz(State(site): State<Arc<Inner>>) -> (StatusCode, &'static str) {
    let shared = &site.shared;
    if shared.closing.is_cancelled() {
        (StatusCode::SERVICE_UNAVAILABLE, "it is stopping\n")
    } else if shared.broken().is_some_and(|broken| broken.token.is_cancelled()) {
        (StatusCode::SERVICE_UNAVAILABLE, "its state cannot be kept\n")
    } else {
        (StatusCode::OK, "ready\n")
    }
}
