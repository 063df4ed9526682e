//! How peers reach each other: TCP, or memory within one process. Both carry the same gRPC.

use crate::limits::{
    CONNECT_MS_MAX, CONNECTION_WINDOW_BYTES, FRAME_BYTES_MAX, HEADERS_BYTES_MAX, KEEP_ALIVE_MS, MEMORY_BACKLOG,
    MEMORY_BUFFER_BYTES, STREAM_WINDOW_BYTES, STREAMS_MAX,
};
use hyper_util::rt::TokioIo;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::io::DuplexStream;
use tokio::net::TcpListener;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::metadata::{Ascii, MetadataValue};
use tonic::service::Interceptor;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::server::TcpIncoming;
use tonic::transport::{Certificate, Channel, ClientTlsConfig, Endpoint, Identity, Server};
use tonic::{Request, Status};

/// Certificates say roles by names in this domain, such as `worker.tilecast`.
pub const ROLE_DOMAIN: &str = "tilecast";
/// The name in every coordinator's certificate, whatever its address is.
pub const COORDINATOR_NAME: &str = "coordinator.tilecast";

/// A connection that shows a token with every call, if there is one.
pub type Line = InterceptedService<Channel, Bearer>;

/// A way to a coordinator that can be gone again and again.
#[derive(Clone, Debug)]
pub enum Connector {
    /// Over the network, or loopback.
    Tcp(Box<Endpoint>, Bearer),
    /// To a coordinator in this process.
    Memory(Memory),
}

/// No connection.
#[derive(Debug, thiserror::Error)]
pub enum ConnectError {
    /// An address that is none.
    #[error("`{0}` is no address; write HOST:PORT")]
    Address(String),
    /// Certificates or tokens that are none.
    #[error("the certificates or the token cannot be used: {0}")]
    Credentials(String),
    /// Nobody answers there.
    #[error("no coordinator answers at {address}: {reason}")]
    Unreachable {
        /// Where.
        address: String,
        /// Why.
        reason: String,
    },
    /// Somebody answers there, and hangs up at the first word.
    #[error(
        "what listens there hangs up at the first word ({0}); have both sides --certs of the same `tilecast certs init`, or neither?"
    )]
    Unheard(String),
}

/// What the failure of a first call means, if it is not an answer.
pub fn unheard(status: &Status) -> Option<ConnectError> {
    // An answer has no cause on this side.
    std::error::Error::source(status).map(|cause| ConnectError::Unheard(innermost(cause)))
}

impl Connector {
    /// The way to `address`, HOST:PORT.
    ///
    /// # Errors
    /// An address that cannot be read; nothing is connected yet.
    pub fn tcp(address: &str) -> Result<Self, ConnectError> {
        Ok(Self::Tcp(Box::new(endpoint("http", address)?), Bearer::default()))
    }

    /// The way to `address` over TLS.
    ///
    /// # Errors
    /// An address or credentials that cannot be read; nothing is connected yet.
    pub fn secure(address: &str, credentials: &Credentials) -> Result<Self, ConnectError> {
        let unusable = |e: &dyn std::error::Error| ConnectError::Credentials(innermost(e));
        let mut tls = ClientTlsConfig::new()
            .ca_certificate(Certificate::from_pem(&credentials.authority))
            .domain_name(COORDINATOR_NAME)
            .timeout(Duration::from_millis(CONNECT_MS_MAX));
        if let Some((certificate, key)) = &credentials.identity {
            tls = tls.identity(Identity::from_pem(certificate, key));
        }
        let endpoint = endpoint("https", address)?.tls_config(tls).map_err(|e| unusable(&e))?;
        let mut bearer = Bearer::default();
        if let Some(token) = &credentials.token {
            let mut value: MetadataValue<_> = format!("Bearer {token}").parse().map_err(|e| unusable(&e))?;
            value.set_sensitive(true);
            bearer.0 = Some(value);
        }
        Ok(Self::Tcp(Box::new(endpoint), bearer))
    }

    /// Connects.
    ///
    /// # Errors
    /// If nobody answers within [`CONNECT_MS_MAX`].
    pub async fn connect(&self) -> Result<Line, ConnectError> {
        let (address, bearer, result) = match self {
            Self::Tcp(endpoint, bearer) => (endpoint.uri().to_string(), bearer.clone(), endpoint.connect().await),
            Self::Memory(memory) => ("memory".to_owned(), Bearer::default(), memory.connect().await),
        };
        result
            .map(|channel| InterceptedService::new(channel, bearer))
            .map_err(|e| ConnectError::Unreachable { address, reason: meant(innermost(&e)) })
    }
}

fn endpoint(scheme: &str, address: &str) -> Result<Endpoint, ConnectError> {
    let unreadable = || ConnectError::Address(address.to_owned());
    let uri = if address.contains("://") { address.to_owned() } else { format!("{scheme}://{address}") };
    let endpoint = Endpoint::from_shared(uri).map_err(|_| unreadable())?;
    if endpoint.uri().port().is_none() || endpoint.uri().scheme_str() != Some(scheme) {
        return Err(unreadable());
    }
    Ok(tuned(endpoint))
}

/// What proves who one is.
#[derive(Clone)]
pub struct Credentials {
    /// Certificate of the authority that the coordinator's must be of, PEM.
    pub authority: Vec<u8>,
    /// One's own certificate and key, PEM.
    pub identity: Option<(Vec<u8>, Vec<u8>)>,
    /// A token instead.
    pub token: Option<String>,
}

/// The token to show, if any. Shown over TLS alone, and in no log.
#[derive(Clone, Debug, Default)]
pub struct Bearer(Option<MetadataValue<Ascii>>);

impl Interceptor for Bearer {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        if let Some(token) = &self.0 {
            request.metadata_mut().insert("authorization", token.clone());
        }
        Ok(request)
    }
}

/// A listener within the process: whoever holds a clone can dial, and a new [`Memory::listen`] replaces the old one, as
/// another process would on the same port.
#[derive(Clone, Debug, Default)]
pub struct Memory {
    listener: Arc<Mutex<Option<mpsc::Sender<io::Result<DuplexStream>>>>>,
}

/// Connections to be accepted from a [`Memory`].
pub type MemoryIncoming = ReceiverStream<io::Result<DuplexStream>>;

impl Memory {
    /// Accepts connections from now on.
    pub fn listen(&self) -> MemoryIncoming {
        let (sender, receiver) = mpsc::channel(MEMORY_BACKLOG);
        *self.listener.lock().unwrap_or_else(PoisonError::into_inner) = Some(sender);
        ReceiverStream::new(receiver)
    }

    async fn connect(&self) -> Result<Channel, tonic::transport::Error> {
        let memory = self.clone();
        // The name is never resolved: the connector below ignores it.
        tuned(Endpoint::from_static("http://memory"))
            .connect_with_connector(tower::service_fn(move |_| {
                let memory = memory.clone();
                async move { memory.dial().await.map(TokioIo::new) }
            }))
            .await
    }

    async fn dial(&self) -> io::Result<DuplexStream> {
        let sender = self.listener.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let refused = || io::Error::from(io::ErrorKind::ConnectionRefused);
        let (ours, theirs) = tokio::io::duplex(MEMORY_BUFFER_BYTES);
        sender.ok_or_else(refused)?.send(Ok(theirs)).await.map_err(|_| refused())?;
        Ok(ours)
    }
}

/// Connections to be accepted from a TCP listener.
pub fn tcp_incoming(listener: TcpListener) -> TcpIncoming {
    // Replies are small and awaited: they must not wait for a full packet.
    TcpIncoming::from(listener).with_nodelay(Some(true))
}

/// A server with this crate's limits.
pub fn server() -> Server {
    Server::builder()
        .initial_stream_window_size(STREAM_WINDOW_BYTES)
        .initial_connection_window_size(CONNECTION_WINDOW_BYTES)
        .max_frame_size(FRAME_BYTES_MAX)
        .max_concurrent_streams(STREAMS_MAX)
        .http2_max_header_list_size(HEADERS_BYTES_MAX)
        .http2_keepalive_interval(Some(Duration::from_millis(KEEP_ALIVE_MS)))
}

fn tuned(endpoint: Endpoint) -> Endpoint {
    endpoint
        .initial_stream_window_size(STREAM_WINDOW_BYTES)
        .initial_connection_window_size(CONNECTION_WINDOW_BYTES)
        .tcp_nodelay(true)
        .connect_timeout(Duration::from_millis(CONNECT_MS_MAX))
        .http2_keep_alive_interval(Duration::from_millis(KEEP_ALIVE_MS))
}

/// What rustls says of the certificates, in the words of those who made them.
fn meant(reason: String) -> String {
    match reason.as_str() {
        r if r.contains("InvalidContentType") => format!("{reason}: it was started without --certs"),
        r if r.contains("BadSignature") || r.contains("UnknownIssuer") => {
            format!("{reason}: its --certs are of another `tilecast certs init` than these")
        }
        _ => reason,
    }
}

/// tonic's error says "transport error"; the reason is at the end of the chain.
fn innermost(error: &dyn std::error::Error) -> String {
    let mut error = error;
    while let Some(source) = error.source() {
        error = source;
    }
    error.to_string()
}
