//! Who may ask what over HTTP: what it may call by gRPC, shown in the same way, by a certificate or a token.
//!
//! The page itself, which knows nothing, is for everyone. All it shows is asked for with a token in a header, which no other
//! site's page can send. Where nobody has to show anything, the listener is on loopback, and two more things keep pages of
//! other sites from asking through their readers' browsers: the name in the address must be loopback's own, since any other may
//! be made to point there; and what changes something takes a header that no foreign page may send without leave.

use super::Inner;
use crate::access::{Caller, Role};
use axum::extract::{Path, Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::sync::Arc;
use tilecast_proto::types::JobId;
use tonic::{Code, Status};

/// What a connection's certificate was, if it showed one.
#[derive(Clone)]
pub struct Peer(pub Option<Arc<[u8]>>);

/// Sent with whatever changes something.
const OURS: &str = "x-tilecast";

/// Headers of every answer: nothing from elsewhere is loaded, run, or embeds the page.
const HEADERS: [(HeaderName, &str); 4] = [
    (
        header::CONTENT_SECURITY_POLICY,
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; base-uri 'none'; \
         form-action 'none'; frame-ancestors 'none'",
    ),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::REFERRER_POLICY, "no-referrer"),
    (header::CACHE_CONTROL, "no-store"),
];

/// Put before all routes.
pub async fn everyone(State(site): State<Arc<Inner>>, request: Request, next: Next) -> Response {
    let mut response = if site.security.is_none() && !names_loopback(request.headers()) {
        let text = "this listener is for this machine alone: call it 127.0.0.1 or localhost";
        refusal(StatusCode::MISDIRECTED_REQUEST, text)
    } else if request.method() == axum::http::Method::POST && !request.headers().contains_key(OURS) {
        refusal(StatusCode::FORBIDDEN, "whatever changes something comes with the header x-tilecast")
    } else {
        next.run(request).await
    };
    for (name, value) in HEADERS {
        response.headers_mut().entry(name).or_insert(HeaderValue::from_static(value));
    }
    response
}

/// Put before what only clients and admins may ask for.
pub async fn clients_only(State(site): State<Arc<Inner>>, mut request: Request, next: Next) -> Response {
    let caller = match &site.security {
        None => Caller::ANYBODY,
        Some(security) => {
            let peer = request.extensions().get::<Peer>().and_then(|peer| peer.0.clone());
            let token = request.headers().get(header::AUTHORIZATION).and_then(|value| value.to_str().ok());
            match security.caller(peer.as_deref(), token) {
                Ok(caller) => caller,
                Err(denied) => return refusal(StatusCode::UNAUTHORIZED, &denied.to_string()),
            }
        }
    };
    if !caller.may(Role::Client) {
        let text = format!("this is for a client, and you are a {}", caller.role.name());
        return refusal(StatusCode::FORBIDDEN, &text);
    }
    request.extensions_mut().insert(caller);
    next.run(request).await
}

/// Ends a job, if the caller may.
pub async fn cancel(
    State(site): State<Arc<Inner>>,
    axum::Extension(caller): axum::Extension<Caller>,
    Path(job): Path<u64>,
) -> Response {
    match site.shared.cancel(JobId(job), caller.cancels_as()) {
        Ok(()) => StatusCode::NO_CONTENT.into_response(),
        Err(error) => told(&error.into()),
    }
}

/// What the service refuses, in HTTP's terms.
pub fn told(status: &Status) -> Response {
    let code = match status.code() {
        Code::NotFound => StatusCode::NOT_FOUND,
        Code::PermissionDenied => StatusCode::FORBIDDEN,
        Code::ResourceExhausted => StatusCode::SERVICE_UNAVAILABLE,
        _ => StatusCode::INTERNAL_SERVER_ERROR,
    };
    refusal(code, status.message())
}

fn refusal(code: StatusCode, text: &str) -> Response {
    (code, format!("{text}\n")).into_response()
}

/// Whether the address that was asked for names this machine by a name that nobody else can give out.
fn names_loopback(headers: &HeaderMap) -> bool {
    let host = headers.get(header::HOST).and_then(|host| host.to_str().ok()).unwrap_or_default();
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|byte| byte.is_ascii_digit()) => name,
        _ => host,
    };
    let name = name.trim_start_matches('[').trim_end_matches(']');
    name.eq_ignore_ascii_case("localhost") || name.parse::<std::net::IpAddr>().is_ok_and(|ip| ip.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_loopback_is_this_machine() {
        let names = |host: &str| {
            let mut headers = HeaderMap::new();
            headers.insert(header::HOST, HeaderValue::from_str(host).unwrap());
            names_loopback(&headers)
        };
        assert!(
            ["localhost", "LocalHost:80", "127.0.0.1:7880", "127.9.9.9", "[::1]:1", "[::1]"].into_iter().all(names)
        );
        let others =
            ["evil.example", "evil.example:7880", "127.0.0.1.evil.example", "10.0.0.1", "localhost.evil:1", ""];
        assert!(!others.into_iter().any(names));
        assert!(!names_loopback(&HeaderMap::new()));
    }
}
