//! Who may call what. Behind [`Gate`] every call has a [`Caller`]; nothing but [`Security::caller`] looks at certificates or
//! tokens, whether a call comes by gRPC or by HTTP.
//!
//! A certificate says its role by a name it is valid for, such as `worker.tilecast`; a token by the list it is in.

use std::str::FromStr;
use std::sync::Arc;
use tilecast_core::scene::Digest;
use tilecast_proto::transport::ROLE_DOMAIN;
use tonic::service::Interceptor;
use tonic::transport::{Certificate, Identity, ServerTlsConfig};
use tonic::{Request, Status};

/// What someone may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Take units and bring their sums.
    Worker,
    /// Submit jobs, watch and fetch all, cancel its own.
    Client,
    /// Everything.
    Admin,
}

impl Role {
    /// Its name, in certificates and lists of tokens.
    pub fn name(self) -> &'static str {
        match self {
            Self::Worker => "worker",
            Self::Client => "client",
            Self::Admin => "admin",
        }
    }

    const ALL: [Self; 3] = [Self::Worker, Self::Client, Self::Admin];
}

impl FromStr for Role {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        Self::ALL
            .into_iter()
            .find(|role| role.name() == name)
            .ok_or_else(|| format!("`{name}` is no role: worker, client or admin"))
    }
}

/// How a coordinator proves who it is, and asks others to.
#[derive(Clone)]
pub struct Security {
    /// Its certificate, PEM.
    pub certificate: Vec<u8>,
    /// And the key to it.
    pub key: Vec<u8>,
    /// Whoever has a certificate of this authority is let in, in the certificate's role.
    pub authority: Vec<u8>,
    /// Digests of tokens, and the roles of whoever has them. With any, a certificate is not needed.
    pub tokens: Vec<(Role, Digest)>,
}

/// Keys stay out of logs.
impl std::fmt::Debug for Security {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Security").field("tokens", &self.tokens.len()).finish_non_exhaustive()
    }
}

/// A handshake that takes longer is broken off.
pub(crate) const HANDSHAKE_MAX: std::time::Duration = std::time::Duration::from_secs(10);

/// Someone who is not let in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum Denied {
    #[error("the certificate names no role")]
    NoRole,
    #[error("show a certificate or a token: --certs, --token-file")]
    Nothing,
    #[error("the token is not known here")]
    UnknownToken,
}

impl Security {
    /// Who shows this certificate, whose chain was verified, or else this `authorization` header.
    pub(crate) fn caller(&self, certificate: Option<&[u8]>, header: Option<&str>) -> Result<Caller, Denied> {
        if let Some(certificate) = certificate {
            let role = role_of(certificate).ok_or(Denied::NoRole)?;
            return Ok(Caller { role, identity: Some(Digest::of(certificate)) });
        }
        let token = header.and_then(|value| value.strip_prefix("Bearer ")).ok_or(Denied::Nothing)?;
        let shown = blake3::hash(token.as_bytes());
        // Compared in constant time.
        let known = self.tokens.iter().find(|(_, digest)| shown == blake3::Hash::from_bytes(digest.0));
        let (role, digest) = known.ok_or(Denied::UnknownToken)?;
        Ok(Caller { role: *role, identity: Some(*digest) })
    }

    pub(crate) fn tls(&self) -> ServerTlsConfig {
        ServerTlsConfig::new()
            .identity(Identity::from_pem(&self.certificate, &self.key))
            .client_ca_root(Certificate::from_pem(&self.authority))
            .client_auth_optional(!self.tokens.is_empty())
            .timeout(HANDSHAKE_MAX)
    }
}

/// Who calls.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Caller {
    /// What it may do.
    pub role: Role,
    /// Its certificate or token; `None` where nobody has to show one.
    pub identity: Option<Digest>,
}

impl Caller {
    /// Whoever it is, where nobody has to show anything.
    pub(crate) const ANYBODY: Self = Self { role: Role::Admin, identity: None };

    /// Whether it may do what is for those of a role. Admins may do everything.
    pub(crate) fn may(self, role: Role) -> bool {
        self.role == role || self.role == Role::Admin
    }

    /// As whom it cancels: someone in particular, or `None` for one who may end any job.
    pub(crate) fn cancels_as(self) -> Option<Digest> {
        self.identity.filter(|_| self.role != Role::Admin)
    }
}

/// Lets those in that a service is for. Admins are let in everywhere.
#[derive(Clone, Debug)]
pub(crate) struct Gate {
    security: Option<Arc<Security>>,
    role: Role,
}

impl Gate {
    pub fn new(security: Option<Arc<Security>>, role: Role) -> Self {
        Self { security, role }
    }

    fn caller(&self, request: &Request<()>) -> Result<Caller, Status> {
        let Some(security) = &self.security else { return Ok(Caller::ANYBODY) };
        let chain = request.peer_certs();
        let certificate = chain.as_deref().and_then(|chain| chain.first());
        let header = request.metadata().get("authorization").and_then(|value| value.to_str().ok());
        let caller = security.caller(certificate.map(|certificate| &**certificate), header);
        caller.map_err(|denied| Status::unauthenticated(denied.to_string()))
    }
}

impl Interceptor for Gate {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        let caller = self.caller(&request)?;
        if !caller.may(self.role) {
            let (has, needs) = (caller.role.name(), self.role.name());
            return Err(Status::permission_denied(format!("this is for a {needs}, and you are a {has}")));
        }
        request.extensions_mut().insert(caller);
        Ok(request)
    }
}

/// The role that a certificate, whose chain was verified, names.
fn role_of(certificate: &[u8]) -> Option<Role> {
    let der = rustls_pki_types::CertificateDer::from(certificate);
    let certificate = webpki::EndEntityCert::try_from(&der).ok()?;
    Role::ALL.into_iter().find(|role| {
        let name = rustls_pki_types::ServerName::try_from(format!("{}.{ROLE_DOMAIN}", role.name()));
        name.is_ok_and(|name| certificate.verify_is_valid_for_subject_name(&name).is_ok())
    })
}

/// Who calls, as the gate found.
pub(crate) fn caller<T>(request: &Request<T>) -> Caller {
    // Without the gate nobody would be let in at all; this is for whoever forgets to put it up.
    request.extensions().get().copied().unwrap_or(Caller { role: Role::Worker, identity: None })
}
