//! What a disk that fails leaves of an image: all of the new one, or all of what was there before.

use super::replace;
use crate::exr;
use crate::kept::Kept;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;
use tilecast_core::film::Film;
use tilecast_core::film::ranges::Ranges;
use tilecast_core::load::{LoadOptions, load};
use tilecast_core::scene::Digest;
use tilecast_core::settings::Window;

/// A way in which one operation on a file fails, and all after it.
#[derive(Clone, Copy, Debug)]
enum Fault {
    /// ENOSPC.
    Full,
    /// EIO.
    Io,
    /// Half of what is written arrives, then the disk is full.
    Short,
    /// The process is gone: nothing after it is run, not even what tidies up.
    Crash,
}

/// A file on which operations fail, counted from 0.
struct Failing<'a, F> {
    file: &'a mut F,
    fault: Fault,
    at: u64,
    seen: u64,
}

impl<F> Failing<'_, F> {
    /// Whether this operation is the first to fail; an error for all after it.
    fn step(&mut self) -> io::Result<bool> {
        self.seen += 1;
        match self.fault {
            _ if self.seen <= self.at => Ok(false),
            Fault::Short if self.seen == self.at + 1 => Ok(true),
            Fault::Full | Fault::Short => Err(io::ErrorKind::StorageFull.into()),
            Fault::Io => Err(io::Error::other("input/output error")),
            Fault::Crash => Err(io::Error::other("the process is gone")),
        }
    }
}

impl<F: Write> Write for Failing<'_, F> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let half = self.step()?;
        self.file.write(if half { &bytes[..bytes.len().div_ceil(2)] } else { bytes })
    }

    fn flush(&mut self) -> io::Result<()> {
        self.step()?;
        self.file.flush()
    }
}

impl<F: Read> Read for Failing<'_, F> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        self.step()?;
        self.file.read(bytes)
    }
}

impl<F: Seek> Seek for Failing<'_, F> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.step()?;
        self.file.seek(to)
    }
}

fn small() -> Kept {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell-box/scene.xml");
    let mut settings = load(&path, &LoadOptions::default()).unwrap().settings;
    (settings.film.width, settings.film.height) = (8, 6);
    settings.film.crop = Window { x0: 0, y0: 0, x1: 8, y1: 6 };
    let film = Film::new(&settings);
    Kept::even(settings, Digest([1; 32]), film, &Ranges::default())
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect()
}

/// Writes over what is there with a disk that fails at operation `at`; whether it got that far.
fn write(path: &Path, kept: &Kept, fault: Fault, at: u64) -> bool {
    replace(path, |file| {
        let written = exr::write(&mut Failing { file, fault, at, seen: 0 }, kept);
        if written.is_err() && matches!(fault, Fault::Crash) {
            // Whoever is gone drops nothing: the unfinished file stays whatever the system makes of it.
            std::mem::forget(std::mem::replace(file, atomic_write_file::AtomicWriteFile::open(path)?));
        }
        written
    })
    .is_err()
}

/// Fails, for instance, if the image is written where it is to be, or an error of its writer is passed over.
#[test]
fn wherever_the_disk_fails_the_image_is_the_old_one_or_the_new_one() {
    let kept = small();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("image.exr");
    replace(&path, |file| exr::write(file, &kept)).unwrap();
    let whole = std::fs::read(&path).unwrap();
    for fault in [Fault::Full, Fault::Io, Fault::Short, Fault::Crash] {
        std::fs::write(&path, "what was there before").unwrap();
        let mut at = 0;
        while write(&path, &kept, fault, at) {
            assert_eq!(std::fs::read(&path).unwrap(), b"what was there before", "{fault:?} at operation {at}");
            if !matches!(fault, Fault::Crash) {
                assert_eq!(names(folder.path()), ["image.exr"], "{fault:?} at operation {at}");
            }
            at += 1;
        }
        assert!(at > 10, "only {at} operations could fail");
        assert_eq!(std::fs::read(&path).unwrap(), whole, "{fault:?} behind the last operation");
    }
}
