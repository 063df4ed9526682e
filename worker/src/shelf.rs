//! A folder of scenes' blobs that workers share, on one machine or on a shared file system: what one has fetched, the others
//! read.
//!
//! Nothing in it is trusted: a blob is what its digest says, or it is fetched. Nor is it needed: a folder that is full or gone
//! is told of, and costs time alone. Blobs appear whole, so that workers need not know of each other; nobody
//! deletes them but people.

use std::fs::{self, File};
use std::hash::{BuildHasher, RandomState};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tilecast_core::scene::Digest;
use tilecast_proto::limits::BLOB_BYTES_MAX;

/// See the module.
#[derive(Clone, Debug)]
pub struct Shelf {
    folder: PathBuf,
}

impl Shelf {
    /// The shelf in this folder, which is made if it is not there.
    ///
    /// # Errors
    /// The system's.
    pub fn open(folder: &Path) -> io::Result<Self> {
        fs::create_dir_all(folder)?;
        Ok(Self { folder: folder.to_owned() })
    }

    /// A blob, if it is there and what it should be. Blocks.
    pub fn get(&self, digest: &Digest) -> Option<Arc<[u8]>> {
        match read(&self.path(digest)) {
            Ok(bytes) if Digest::of(&bytes) == *digest => Some(bytes.into()),
            Ok(_) => {
                tracing::warn!(%digest, "what lies in the scene cache is damaged; it is fetched anew");
                None
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => None,
            Err(error) => {
                tracing::warn!(%digest, %error, "the scene cache cannot be read");
                None
            }
        }
    }

    /// Puts a blob there, whose digest was checked. Blocks.
    pub fn put(&self, digest: &Digest, bytes: &[u8]) {
        // Of its own: others may be putting the same.
        let beside = self.folder.join(format!("{digest}.{:016x}.new", RandomState::new().hash_one(std::process::id())));
        let put = File::create_new(&beside)
            .and_then(|mut file| file.write_all(bytes))
            .and_then(|()| fs::rename(&beside, self.path(digest)));
        if let Err(error) = put {
            let _ = fs::remove_file(&beside);
            tracing::warn!(%digest, %error, "the scene cache cannot be written");
        }
    }

    fn path(&self, digest: &Digest) -> PathBuf {
        self.folder.join(digest.to_string())
    }
}

fn read(path: &Path) -> io::Result<Vec<u8>> {
    let metadata = fs::metadata(path)?;
    // A pipe would be waited for, and what is too long is no blob.
    if !metadata.is_file() || metadata.len() > BLOB_BYTES_MAX {
        return Err(io::ErrorKind::InvalidData.into());
    }
    let mut bytes = Vec::new();
    File::open(path)?.take(BLOB_BYTES_MAX).read_to_end(&mut bytes)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails if the digest is not looked at, or a blob is written where it is to be.
    #[test]
    fn what_is_there_is_right_or_is_not_there() {
        let folder = tempfile::tempdir().unwrap();
        let shelf = Shelf::open(&folder.path().join("a/b")).unwrap();
        let digest = Digest::of(b"blob");
        assert_eq!(shelf.get(&digest), None);
        shelf.put(&digest, b"blob");
        shelf.put(&digest, b"blob");
        assert_eq!(shelf.get(&digest).as_deref(), Some(&b"blob"[..]));
        let there = || fs::read_dir(folder.path().join("a/b")).unwrap().count();
        assert_eq!(there(), 1, "nothing is left beside it");
        fs::write(shelf.path(&digest), b"blot").unwrap();
        assert_eq!(shelf.get(&digest), None, "damaged");
        shelf.put(&digest, b"blob");
        assert!(shelf.get(&digest).is_some(), "repaired");
        fs::remove_file(shelf.path(&digest)).unwrap();
        fs::create_dir(shelf.path(&digest)).unwrap();
        assert_eq!(shelf.get(&digest), None, "a folder");
        shelf.put(&digest, b"blob");
        assert_eq!(there(), 1, "what cannot be put leaves nothing");
    }
}
