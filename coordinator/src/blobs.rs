//! Scenes' blobs, in memory, within a budget: those of jobs that have not ended stay, others go when room is needed, the
//! least recently used first.

use bytes::Bytes;
use std::collections::HashMap;
use tilecast_core::scene::Digest;

/// No room for another blob.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the coordinator has no room for {need} bytes of the scene: {pinned} of {limit} bytes belong to jobs that run")]
pub struct NoRoom {
    need: u64,
    pinned: u64,
    limit: u64,
}

/// See the module.
#[derive(Debug)]
pub struct Blobs {
    bytes_max: u64,
    /// Stored, and set aside for uploads under way.
    bytes_used: u64,
    bytes_reserved: u64,
    blobs: HashMap<Digest, Blob>,
    /// Counts uses; orders blobs by their last one.
    clock: u64,
}

#[derive(Debug)]
struct Blob {
    bytes: Bytes,
    used: u64,
    /// Jobs that need it.
    pins: u32,
}

impl Blobs {
    /// No blobs, and room for `bytes_max`.
    pub fn new(bytes_max: u64) -> Self {
        Self { bytes_max, bytes_used: 0, bytes_reserved: 0, blobs: HashMap::new(), clock: 0 }
    }

    /// Whether the blob is there.
    pub fn has(&self, digest: &Digest) -> bool {
        self.blobs.contains_key(digest)
    }

    /// The blob's bytes.
    pub fn get(&mut self, digest: &Digest) -> Option<Bytes> {
        self.clock += 1;
        let blob = self.blobs.get_mut(digest)?;
        blob.used = self.clock;
        Some(blob.bytes.clone())
    }

    /// Sets room aside for an upload, dropping what nobody needs and saying what; [`Blobs::release`] gives it back.
    ///
    /// # Errors
    /// No room.
    pub fn reserve(&mut self, need: u64) -> Result<Vec<Digest>, NoRoom> {
        let fixed = self.blobs.values().filter(|b| b.pins > 0).map(|b| b.bytes.len() as u64).sum::<u64>();
        let pinned = fixed + self.bytes_reserved;
        if pinned + need > self.bytes_max {
            return Err(NoRoom { need, pinned, limit: self.bytes_max });
        }
        let mut dropped = Vec::new();
        while self.bytes_used + self.bytes_reserved + need > self.bytes_max {
            let oldest = self.blobs.iter().filter(|(_, b)| b.pins == 0).min_by_key(|(_, b)| b.used);
            let Some((&digest, _)) = oldest else { break };
            self.bytes_used -= self.blobs.remove(&digest).map_or(0, |b| b.bytes.len() as u64);
            dropped.push(digest);
        }
        self.bytes_reserved += need;
        Ok(dropped)
    }

    /// The upload that set this aside has ended, well or not.
    pub fn release(&mut self, need: u64) {
        self.bytes_reserved -= need;
    }

    /// Stores bytes whose digest was checked, within what was reserved for them.
    pub fn insert(&mut self, digest: Digest, bytes: Bytes) {
        self.clock += 1;
        let used = self.clock;
        self.blobs.entry(digest).or_insert_with(|| {
            self.bytes_used += bytes.len() as u64;
            Blob { bytes, used, pins: 0 }
        });
    }

    /// Keeps these blobs until [`Blobs::unpin`]; or says which are not there, and keeps none.
    ///
    /// # Errors
    /// The first that is missing.
    pub fn pin(&mut self, digests: &[Digest]) -> Result<(), Digest> {
        if let Some(missing) = digests.iter().find(|digest| !self.has(digest)) {
            return Err(*missing);
        }
        for digest in digests {
            if let Some(blob) = self.blobs.get_mut(digest) {
                blob.pins += 1;
            }
        }
        Ok(())
    }

    /// Ends what [`Blobs::pin`] began.
    pub fn unpin(&mut self, digests: &[Digest]) {
        for digest in digests {
            if let Some(blob) = self.blobs.get_mut(digest) {
                blob.pins -= 1;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn put(blobs: &mut Blobs, name: u8, len: usize) -> Result<(), NoRoom> {
        blobs.reserve(len as u64)?;
        blobs.insert(Digest([name; 32]), vec![name; len].into());
        blobs.release(len as u64);
        Ok(())
    }

    #[test]
    fn what_a_job_needs_stays_and_the_rest_makes_room() {
        let mut blobs = Blobs::new(100);
        let [a, b, c] = [1, 2, 3].map(|n| Digest([n; 32]));
        put(&mut blobs, 1, 40).unwrap();
        put(&mut blobs, 2, 40).unwrap();
        blobs.pin(&[a]).unwrap();
        blobs.get(&a);
        put(&mut blobs, 3, 60).unwrap();
        assert!(blobs.has(&a) && !blobs.has(&b) && blobs.has(&c));
        assert_eq!(blobs.pin(&[c, b]), Err(b));
        assert!(put(&mut blobs, 4, 61).is_err());
        assert!(blobs.has(&c), "dropped for nothing");
        blobs.unpin(&[a]);
        put(&mut blobs, 4, 100).unwrap();
        assert!(!blobs.has(&a) && !blobs.has(&c));
    }

    #[test]
    fn uploads_under_way_count() {
        let mut blobs = Blobs::new(100);
        blobs.reserve(70).unwrap();
        assert!(blobs.reserve(31).is_err());
        blobs.release(70);
        assert!(blobs.reserve(31).is_ok());
    }
}
