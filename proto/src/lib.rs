//! The wire of tilecast: messages, limits, and the one place that validates them.
//!
//! `render.proto` says what travels; [`convert`] turns it into [`types`] or refuses it; [`sums`] packs a unit's result;
//! [`transport`] connects peers over TCP or memory; [`client`] is the client's side of the conversation. Who schedules and
//! who traces is unknown here.

pub mod client;
pub mod convert;
pub mod limits;
pub mod transport;
pub mod types;
pub mod version;

pub use tilecast_core::film::sums;

/// What tonic and prost made of `render.proto`. Its documentation is there.
#[allow(missing_docs, clippy::all, clippy::unwrap_used)]
pub mod wire {
    tonic::include_proto!("tilecast.v1");
}
