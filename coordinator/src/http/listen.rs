//! Connections of HTTP, as they come in: not more than so many, none that says nothing for ever, over TLS where the coordinator
//! has certificates.

use super::guard::Peer;
use crate::access::{HANDSHAKE_MAX, Security};
use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use rustls_pki_types::pem::PemObject;
use rustls_pki_types::{CertificateDer, PrivateKeyDer};
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::server::WebPkiClientVerifier;
use tokio_rustls::rustls::{RootCertStore, ServerConfig, crypto};
use tokio_util::sync::CancellationToken;

/// Connections at a time: some forty open pages. Others wait to be accepted.
const CONNECTIONS_MAX: usize = 256;
/// A request's headers come within this time, or the connection is closed; so is one that is idle for so long.
const HEADERS_MAX: Duration = Duration::from_secs(30);
/// Headers of a request: a browser's, with a token.
const HEADER_BYTES_MAX: usize = 16 << 10;
/// After an error in accepting, such as too many open files, others get a moment to go.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// Certificates that cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("the certificates cannot be used for HTTP: {0}")]
pub struct TlsError(String);

/// Serves until `gone`.
pub async fn serve(listener: TcpListener, router: Router, tls: Option<TlsAcceptor>, gone: CancellationToken) {
    let permits = Arc::new(Semaphore::new(CONNECTIONS_MAX));
    loop {
        let Ok(permit) = Arc::clone(&permits).acquire_owned().await else { return };
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            () = gone.cancelled() => return,
        };
        let stream = match accepted {
            Ok((stream, _)) => stream,
            Err(error) => {
                tracing::warn!(%error, "an HTTP connection could not be accepted");
                tokio::time::sleep(ACCEPT_PAUSE).await;
                continue;
            }
        };
        let (router, tls, gone) = (router.clone(), tls.clone(), gone.clone());
        tokio::spawn(async move {
            tokio::select! {
                () = connection(stream, router, tls) => {}
                () = gone.cancelled() => {}
            }
            drop(permit);
        });
    }
}

async fn connection(stream: TcpStream, router: Router, tls: Option<TlsAcceptor>) {
    // Events are small and wanted at once.
    let _ = stream.set_nodelay(true);
    let Some(tls) = tls else { return requests(stream, Peer(None), router).await };
    // Whoever does not know the authority, or takes too long, is no concern of the log.
    let Ok(Ok(stream)) = tokio::time::timeout(HANDSHAKE_MAX, tls.accept(stream)).await else { return };
    let chain = stream.get_ref().1.peer_certificates();
    let peer = Peer(chain.and_then(|chain| chain.first()).map(|certificate| certificate.as_ref().into()));
    requests(stream, peer, router).await;
}

async fn requests(io: impl AsyncRead + AsyncWrite + Unpin + Send + 'static, peer: Peer, router: Router) {
    let service = TowerToHyperService::new(router.layer(Extension(peer)));
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(HEADERS_MAX).max_buf_size(HEADER_BYTES_MAX);
    // Peers come and go as they like.
    let _ = http.serve_connection(TokioIo::new(io), service).await;
}

/// TLS with the coordinator's own certificate. Peers may show one of the authority's, and show a token otherwise.
pub fn tls(security: &Security) -> Result<TlsAcceptor, TlsError> {
    let failed = |what: &str, error: &dyn std::fmt::Display| TlsError(format!("{what}: {error}"));
    let mut roots = RootCertStore::empty();
    for certificate in CertificateDer::pem_slice_iter(&security.authority) {
        let certificate = certificate.map_err(|e| failed("ca.pem", &e))?;
        roots.add(certificate).map_err(|e| failed("ca.pem", &e))?;
    }
    let chain: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(&security.certificate).collect();
    let chain = chain.map_err(|e| failed("coordinator.pem", &e))?;
    let key = PrivateKeyDer::from_pem_slice(&security.key).map_err(|e| failed("coordinator.key", &e))?;
    let provider = Arc::new(crypto::ring::default_provider());
    let verifier = WebPkiClientVerifier::builder_with_provider(Arc::new(roots), Arc::clone(&provider))
        .allow_unauthenticated()
        .build()
        .map_err(|e| failed("ca.pem", &e))?;
    let mut config = ServerConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .map_err(|e| failed("TLS", &e))?
        .with_client_cert_verifier(verifier)
        .with_single_cert(chain, key)
        .map_err(|e| failed("coordinator.pem", &e))?;
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok(TlsAcceptor::from(Arc::new(config)))
}
