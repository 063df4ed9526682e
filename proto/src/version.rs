//! What two sides must agree on before they speak of work: the protocol, and the engine that the bits depend on.

use crate::wire;
use std::fmt;

/// Version of the messages in `render.proto`; grows with every change that is not merely an addition.
pub const PROTOCOL: u32 = 6;

/// What one side speaks and traces with.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Version {
    /// See [`PROTOCOL`].
    pub protocol: u32,
    /// See [`tilecast_core::VERSION`].
    pub engine: String,
}

impl Version {
    /// This program's.
    pub fn ours() -> Self {
        Self { protocol: PROTOCOL, engine: tilecast_core::VERSION.to_owned() }
    }

    /// Agrees or refuses; `self` is the peer's.
    ///
    /// # Errors
    /// A mismatch of either number.
    pub fn check(&self) -> Result<(), VersionMismatch> {
        let ours = Self::ours();
        if *self == ours { Ok(()) } else { Err(VersionMismatch { theirs: self.clone(), ours }) }
    }
}

impl fmt::Display for Version {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "engine {} with protocol {}", self.engine, self.protocol)
    }
}

/// Peers that would make different bits, or not understand each other.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the peer is {theirs}, this side is {ours}; images depend on both, so run the same tilecast on all machines")]
pub struct VersionMismatch {
    /// What came.
    pub theirs: Version,
    /// What runs here.
    pub ours: Version,
}

impl From<VersionMismatch> for tonic::Status {
    fn from(mismatch: VersionMismatch) -> Self {
        tonic::Status::failed_precondition(mismatch.to_string())
    }
}

impl From<Version> for wire::Version {
    fn from(version: Version) -> Self {
        Self { protocol: version.protocol, engine: version.engine }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refusal_names_both_versions() {
        let other = Version { protocol: PROTOCOL + 1, engine: "9.8.7".into() };
        let status = tonic::Status::from(other.check().unwrap_err());
        assert_eq!(status.code(), tonic::Code::FailedPrecondition);
        assert!(status.message().contains("9.8.7"), "{}", status.message());
        assert!(status.message().contains(tilecast_core::VERSION), "{}", status.message());
        assert_eq!(Version::ours().check(), Ok(()));
    }
}
