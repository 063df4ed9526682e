//! Messages as they come from the other end of a connection.

use prost::Message;
use tilecast_proto::convert;
use tilecast_proto::types::{
    FilmHeader, Heartbeat, HeartbeatReply, JobSpec, LeaseReply, LeaseRequest, Leave, Progress, ResultHeader, Unit,
    Verdict, Welcome, WorkerInfo, WorkerStatus,
};
use tilecast_proto::wire;

/// Decodes a message and checks what it says; none is worth more than an error.
fn checked<W: Message + Default, T: TryFrom<W>>(bytes: &[u8]) -> Option<T> {
    T::try_from(W::decode(bytes).ok()?).ok()
}

/// One message; the first byte says which.
pub fn message(bytes: &[u8]) {
    let Some((kind, bytes)) = bytes.split_first() else { return };
    match kind % 16 {
        0 => drop(checked::<wire::Hello, WorkerInfo>(bytes)),
        1 => drop(checked::<wire::Welcome, Welcome>(bytes)),
        2 => drop(checked::<wire::Unit, Unit>(bytes)),
        3 => drop(checked::<wire::LeaseRequest, LeaseRequest>(bytes)),
        4 => drop(checked::<wire::LeaseReply, LeaseReply>(bytes)),
        5 => result(bytes),
        6 => drop(checked::<wire::SubmitReply, Verdict>(bytes)),
        7 => drop(checked::<wire::HeartbeatRequest, Heartbeat>(bytes)),
        8 => drop(checked::<wire::LeaveRequest, Leave>(bytes)),
        9 => drop(checked::<wire::HeartbeatReply, HeartbeatReply>(bytes)),
        10 => drop(checked::<wire::Job, JobSpec>(bytes)),
        11 => drop(checked::<wire::Progress, Progress>(bytes)),
        12 => drop(checked::<wire::Worker, WorkerStatus>(bytes)),
        13 => drop(checked::<wire::FilmHeader, FilmHeader>(bytes)),
        14 => drop(wire::Digests::decode(bytes).map(|message| convert::digests(&message))),
        _ => drop(wire::Version::decode(bytes).map(|message| convert::version(Some(message)))),
    }
}

/// A result: the header's length in two bytes, the header, the sums.
fn result(bytes: &[u8]) {
    let Some((len, bytes)) = bytes.split_first_chunk::<2>() else { return };
    let Some((header, sums)) = bytes.split_at_checked(usize::from(u16::from_le_bytes(*len))) else { return };
    if let Some(header) = checked::<wire::ResultHeader, ResultHeader>(header) {
        // Sums that pass can be merged and shown.
        if let Ok(sums) = header.sums(sums) {
            assert_eq!(sums.pixels.len() as u64, sums.tile.area());
        }
    }
}
