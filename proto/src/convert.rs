//! The only place that validates the wire: every field of every message once, into the types of [`crate::types`].
//!
//! A message that breaks a rule is refused whole, with an error that names the field.

mod job;
mod settings;
mod work;

use crate::limits::{BLOB_BYTES_MAX, DIGESTS_MAX, FAILURE_BYTES_MAX, NAME_BYTES_MAX, TILE_SIDE_MAX};
use crate::sums::SumsError;
use crate::types::JobId;
use crate::version::{Version, VersionMismatch};
use crate::wire;
use prost::Message;
use std::ops::RangeInclusive;
use std::time::Duration;
use tilecast_core::scene::Digest;
use tilecast_core::settings::{FILM_SIDE_MAX, Settings, SettingsError, Window};

pub(crate) use job::FilmParts;
pub use job::film_rows;

/// A message that breaks a rule.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum WireError {
    /// A field that must be there is not.
    #[error("{0} is missing")]
    Missing(&'static str),
    /// A digest that is not 32 bytes.
    #[error("{field} has {len} bytes; a digest has 32")]
    Digest {
        /// Which.
        field: &'static str,
        /// How long it is.
        len: usize,
    },
    /// A number out of its range.
    #[error("{field} is {value}; it must lie between {min} and {max}")]
    Range {
        /// Which.
        field: &'static str,
        /// What it is.
        value: u64,
        /// Least allowed.
        min: u64,
        /// Most allowed.
        max: u64,
    },
    /// A string or list that is too long.
    #[error("{field} has a length of {len}; at most {max} are allowed")]
    Long {
        /// Which.
        field: &'static str,
        /// How long it is.
        len: usize,
        /// How long it may be.
        max: usize,
    },
    /// A number that names nothing.
    #[error("{field} has no meaning {value}")]
    Enum {
        /// Which.
        field: &'static str,
        /// What it is.
        value: i32,
    },
    /// An error that is none.
    #[error("{field} is {value}; an error is a number from 0 on")]
    NotAnError {
        /// Which.
        field: &'static str,
        /// What it is.
        value: f32,
    },
    /// A rectangle that is empty, inside out or too large.
    #[error("{field} is the rectangle {window:?}, which is empty or too large")]
    Window {
        /// Which.
        field: &'static str,
        /// What it is.
        window: Window,
    },
    /// Settings out of range.
    #[error("settings: {0}")]
    Settings(#[from] SettingsError),
    /// Encoded sums that are none.
    #[error("sums: {0}")]
    Sums(#[from] SumsError),
    /// Sums that so many samples cannot make.
    #[error("the sums are larger than their samples can make them")]
    Unbounded,
    /// A stream that ends early, or goes on behind its end.
    #[error("the stream {0}")]
    Stream(&'static str),
    /// Another program version.
    #[error(transparent)]
    Version(#[from] VersionMismatch),
}

impl From<WireError> for tonic::Status {
    fn from(error: WireError) -> Self {
        match error {
            WireError::Version(mismatch) => mismatch.into(),
            other => tonic::Status::invalid_argument(other.to_string()),
        }
    }
}

/// BLAKE3 of all that a unit's sums are a function of, besides the unit: engine, scene and settings. Two jobs with equal keys
/// have the same sums, so a result may count for either.
pub fn work_key(scene: &Digest, settings: &Settings) -> Digest {
    let version = wire::Version::from(Version::ours()).encode_to_vec();
    let settings = wire::Settings::from(settings).encode_to_vec();
    let mut bytes = Vec::with_capacity(version.len() + settings.len() + scene.0.len() + 8);
    // The lengths keep (ab, c) apart from (a, bc).
    bytes.extend((version.len() as u64).to_le_bytes());
    bytes.extend(version);
    bytes.extend(scene.0);
    bytes.extend(settings);
    Digest::of(&bytes)
}

/// The digest in a field.
///
/// # Errors
/// Other than 32 bytes.
pub fn digest(bytes: &[u8], field: &'static str) -> Result<Digest, WireError> {
    bytes.try_into().map(Digest).map_err(|_| WireError::Digest { field, len: bytes.len() })
}

/// A digest for a field.
pub fn digest_bytes(digest: &Digest) -> bytes::Bytes {
    bytes::Bytes::copy_from_slice(&digest.0)
}

/// A blob's length, from the first chunk of its upload.
///
/// # Errors
/// A blob beyond the limit.
pub fn blob_len(bytes: u64) -> Result<u64, WireError> {
    within(bytes, 0..=BLOB_BYTES_MAX, "blob.bytes")
}

/// A list of digests.
///
/// # Errors
/// Too many, or one of other than 32 bytes.
pub fn digests(message: &wire::Digests) -> Result<Vec<Digest>, WireError> {
    at_most(message.digests.len(), DIGESTS_MAX, "digests")?;
    message.digests.iter().map(|bytes| digest(bytes, "digests")).collect()
}

/// The version a peer claims.
///
/// # Errors
/// A missing or overlong one; whether it agrees is [`Version::check`]'s to say.
pub fn version(message: Option<wire::Version>) -> Result<Version, WireError> {
    let wire::Version { protocol, engine } = message.ok_or(WireError::Missing("version"))?;
    Ok(Version { protocol, engine: text(engine, NAME_BYTES_MAX, "version.engine")? })
}

/// Cuts a message to what [`wire::FailRequest`] may carry.
pub fn failure_text(mut message: String) -> String {
    let fits = |len: &usize| message.is_char_boundary(*len);
    if let Some(len) = (0..=message.len().min(FAILURE_BYTES_MAX)).rev().find(fits) {
        message.truncate(len);
    }
    message
}

impl From<wire::JobId> for JobId {
    fn from(message: wire::JobId) -> Self {
        Self(message.job)
    }
}

impl From<JobId> for wire::JobId {
    fn from(job: JobId) -> Self {
        Self { job: job.0 }
    }
}

impl From<Window> for wire::Window {
    fn from(Window { x0, y0, x1, y1 }: Window) -> Self {
        Self { x0, y0, x1, y1 }
    }
}

/// A rectangle that is not empty, with sides of at most `side_max`, somewhere on a film.
fn window(message: Option<wire::Window>, side_max: u32, field: &'static str) -> Result<Window, WireError> {
    let wire::Window { x0, y0, x1, y1 } = message.ok_or(WireError::Missing(field))?;
    let window = Window { x0, y0, x1, y1 };
    let fits = |low: u32, high: u32| low < high && high - low <= side_max && high <= FILM_SIDE_MAX;
    if fits(x0, x1) && fits(y0, y1) { Ok(window) } else { Err(WireError::Window { field, window }) }
}

fn tile(message: Option<wire::Window>, field: &'static str) -> Result<Window, WireError> {
    window(message, TILE_SIDE_MAX, field)
}

fn within<T: Into<u64> + Copy>(value: T, range: RangeInclusive<u64>, field: &'static str) -> Result<T, WireError> {
    if range.contains(&value.into()) {
        Ok(value)
    } else {
        Err(WireError::Range { field, value: value.into(), min: *range.start(), max: *range.end() })
    }
}

fn at_most(len: usize, max: usize, field: &'static str) -> Result<(), WireError> {
    if len <= max { Ok(()) } else { Err(WireError::Long { field, len, max }) }
}

fn text(text: String, max: usize, field: &'static str) -> Result<String, WireError> {
    at_most(text.len(), max, field).map(|()| text)
}

fn micros(duration: Duration) -> u64 {
    u64::try_from(duration.as_micros()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests;
