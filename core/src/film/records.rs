//! Checksummed records, one behind the other: the frame of every file that tilecast trusts after a crash.
//!
//! A file is 16 bytes that name its kind and version, then records: length (u32, little endian), 16 bytes of check, payload.
//! The check is BLAKE3 over kind, place in the file, and payload: a record that was cut, changed, moved or left over from
//! another file is none. A file that only grows at its end can so be read up to the point where a crash tore it.

use std::io::{self, Read, Write};

/// Names a kind of file and the version of what its records hold.
pub type Kind = [u8; 16];
/// Length and check.
pub const HEAD_BYTES: usize = 20;
/// The longest payload: a tile of 2^16 pixels of the longest sums takes 14 MB.
pub const RECORD_BYTES_MAX: usize = 32 << 20;

/// Why a record cannot be had.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// Reading failed.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// It begins with something else.
    #[error("it is no such file, or one of another version of tilecast")]
    Kind,
    /// From this byte on there is no valid record: torn by a crash, if it is the end of a journal; damage otherwise.
    #[error("it is damaged or cut off at byte {0}")]
    Torn(u64),
}

/// What stands before `payload`, which is record number `index` of its file.
pub fn head(kind: &Kind, index: u64, payload: &[u8]) -> [u8; HEAD_BYTES] {
    let mut head = [0; HEAD_BYTES];
    // Longer than the limit is a bug of the writer; a reader refuses it.
    let len = u32::try_from(payload.len()).unwrap_or(u32::MAX);
    head[..4].copy_from_slice(&len.to_le_bytes());
    head[4..].copy_from_slice(&check(kind, index, payload));
    head
}

fn check(kind: &Kind, index: u64, payload: &[u8]) -> [u8; 16] {
    let mut hasher = blake3::Hasher::new();
    hasher.update(kind).update(&index.to_le_bytes()).update(payload);
    let mut check = [0; 16];
    check.copy_from_slice(&hasher.finalize().as_bytes()[..16]);
    check
}

/// Writes a file of records.
#[derive(Debug)]
pub struct RecordWriter<W> {
    out: W,
    kind: Kind,
    next: u64,
}

impl<W: Write> RecordWriter<W> {
    /// Begins a file.
    ///
    /// # Errors
    /// Whatever `out` fails with.
    pub fn new(mut out: W, kind: Kind) -> io::Result<Self> {
        out.write_all(&kind)?;
        Ok(Self { out, kind, next: 0 })
    }

    /// Appends a record.
    ///
    /// # Errors
    /// Whatever `out` fails with; the file may then end in half a record, and nothing may follow it.
    pub fn put(&mut self, payload: &[u8]) -> io::Result<()> {
        self.out.write_all(&head(&self.kind, self.next, payload))?;
        self.out.write_all(payload)?;
        self.next += 1;
        Ok(())
    }

    /// The file so far.
    pub fn get_ref(&self) -> &W {
        &self.out
    }

    /// The file, which is complete.
    pub fn into_inner(self) -> W {
        self.out
    }
}

/// Reads a file of records.
#[derive(Debug)]
pub struct RecordReader<R> {
    input: R,
    kind: Kind,
    next: u64,
    offset: u64,
}

impl<R: Read> RecordReader<R> {
    /// Begins a file.
    ///
    /// # Errors
    /// Another kind of file, or whatever `input` fails with.
    pub fn new(mut input: R, kind: Kind) -> Result<Self, RecordError> {
        let mut found = Kind::default();
        match input.read_exact(&mut found) {
            Ok(()) if found == kind => Ok(Self { input, kind, next: 0, offset: kind.len() as u64 }),
            Err(e) if e.kind() != io::ErrorKind::UnexpectedEof => Err(e.into()),
            _ => Err(RecordError::Kind),
        }
    }

    /// The next payload; `None` at an end that is not within a record. Memory grows with what is there, not with what a
    /// length claims.
    ///
    /// # Errors
    /// [`RecordError::Torn`] if there is something that is no record; what was read before is sound.
    pub fn read(&mut self) -> Result<Option<Vec<u8>>, RecordError> {
        let torn = RecordError::Torn(self.offset);
        let mut head = Vec::new();
        self.input.by_ref().take(HEAD_BYTES as u64).read_to_end(&mut head)?;
        if head.is_empty() {
            return Ok(None);
        }
        let Some((len, claimed)) = head.split_first_chunk::<4>().filter(|_| head.len() == HEAD_BYTES) else {
            return Err(torn);
        };
        let len = u32::from_le_bytes(*len) as usize;
        if len > RECORD_BYTES_MAX {
            return Err(torn);
        }
        let mut payload = Vec::new();
        self.input.by_ref().take(len as u64).read_to_end(&mut payload)?;
        if payload.len() != len || check(&self.kind, self.next, &payload) != *claimed {
            return Err(torn);
        }
        self.next += 1;
        self.offset += (HEAD_BYTES + len) as u64;
        Ok(Some(payload))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KIND: Kind = *b"tilecast test 01";

    fn file(payloads: &[&[u8]]) -> Vec<u8> {
        let mut writer = RecordWriter::new(Vec::new(), KIND).unwrap();
        payloads.iter().for_each(|payload| writer.put(payload).unwrap());
        writer.into_inner()
    }

    /// The payloads before the first thing that is no record.
    fn read(bytes: &[u8]) -> (Vec<Vec<u8>>, Option<RecordError>) {
        let mut found = Vec::new();
        let mut reader = match RecordReader::new(bytes, KIND) {
            Ok(reader) => reader,
            Err(error) => return (found, Some(error)),
        };
        loop {
            match reader.read() {
                Ok(Some(payload)) => found.push(payload),
                Ok(None) => return (found, None),
                Err(error) => return (found, Some(error)),
            }
        }
    }

    #[test]
    fn a_torn_tail_costs_the_last_record_alone() {
        let whole = file(&[b"one", b"", b"three"]);
        let ends = [16, 39, 59, 84];
        assert_eq!(whole.len(), ends[3]);
        for cut in 16..whole.len() {
            let (found, error) = read(&whole[..cut]);
            let complete = ends.iter().filter(|&&end| end <= cut).count() - 1;
            assert_eq!(found.len(), complete, "cut at {cut}");
            assert_eq!(error.is_some(), !ends.contains(&cut), "cut at {cut}");
        }
    }

    #[test]
    fn no_changed_byte_goes_unnoticed() {
        let whole = file(&[b"one", b"two"]);
        for at in 0..whole.len() {
            let mut changed = whole.clone();
            changed[at] ^= 4;
            assert!(read(&changed).1.is_some(), "byte {at}");
        }
        // A record in another's place, and one of another kind of file.
        let swapped = [&whole[..16], &whole[39..], &whole[16..39]].concat();
        assert!(read(&swapped).1.is_some());
        let mut foreign = RecordWriter::new(Vec::new(), *b"tilecast test 02").unwrap();
        foreign.put(b"one").unwrap();
        let mut foreign = foreign.into_inner();
        foreign[..16].copy_from_slice(&KIND);
        assert!(read(&foreign).1.is_some());
    }
}
