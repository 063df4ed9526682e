//! The disk under the state: the few operations that it takes, each of which can be made to fail in a test.

use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// See the module.
#[derive(Clone, Debug, Default)]
pub struct Disk {
    faults: Option<Arc<Mutex<Faults>>>,
}

/// What goes wrong, and when.
#[derive(Clone, Debug, Default)]
pub struct Faults {
    /// The operation that fails first, counted from 0.
    pub at: u64,
    /// How.
    pub fault: Option<Fault>,
    /// Operations so far.
    pub seen: u64,
}

/// A way to fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The disk is full from now on: ENOSPC.
    Full,
    /// One operation fails: EIO.
    Io,
    /// Half of a write arrives, then the process is gone.
    Torn,
    /// The process is gone before the operation.
    Crash,
}

impl Disk {
    /// A disk on which something goes wrong, and what it has seen.
    pub fn failing(faults: Faults) -> (Self, Arc<Mutex<Faults>>) {
        let faults = Arc::new(Mutex::new(faults));
        (Self { faults: Some(Arc::clone(&faults)) }, faults)
    }

    /// Counts an operation; whether a write is to be torn in half.
    fn step(&self) -> io::Result<bool> {
        let Some(faults) = &self.faults else { return Ok(false) };
        let mut faults = faults.lock().unwrap_or_else(PoisonError::into_inner);
        let now = faults.seen;
        faults.seen += 1;
        let Some(fault) = faults.fault.filter(|_| now >= faults.at) else { return Ok(false) };
        match fault {
            Fault::Io if now > faults.at => Ok(false),
            Fault::Io => Err(io::Error::other("input/output error")),
            Fault::Full => Err(io::ErrorKind::StorageFull.into()),
            Fault::Torn if now == faults.at => Ok(true),
            Fault::Torn | Fault::Crash => Err(io::Error::other("the process is gone")),
        }
    }

    /// Makes a folder and those above it.
    ///
    /// # Errors
    /// The system's.
    pub fn create_folder(&self, path: &Path) -> io::Result<()> {
        self.step()?;
        fs::create_dir_all(path)
    }

    /// A new file, to be written.
    ///
    /// # Errors
    /// The system's.
    pub fn create(&self, path: &Path) -> io::Result<Output> {
        self.step()?;
        Ok(Output { file: File::create(path)?, disk: self.clone() })
    }

    /// Writes a whole file: beside it, synced, renamed; what was there before stays until then.
    ///
    /// # Errors
    /// The system's.
    pub fn replace(&self, path: &Path, write: impl FnOnce(&mut Output) -> io::Result<()>) -> io::Result<()> {
        let beside = beside(path);
        let mut file = self.create(&beside)?;
        let written = write(&mut file).and_then(|()| file.sync());
        if let Err(error) = written {
            let _ = fs::remove_file(&beside);
            return Err(error);
        }
        self.rename(&beside, path)?;
        self.sync_folder(path.parent().unwrap_or(Path::new(".")))
    }

    /// Gives a file another name.
    ///
    /// # Errors
    /// The system's.
    pub fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.step()?;
        fs::rename(from, to)
    }

    /// Makes the entries of a folder durable.
    ///
    /// # Errors
    /// The system's.
    pub fn sync_folder(&self, path: &Path) -> io::Result<()> {
        self.step()?;
        File::open(path)?.sync_all()
    }

    /// Deletes a file, if it is there.
    ///
    /// # Errors
    /// The system's.
    pub fn remove(&self, path: &Path) -> io::Result<()> {
        self.step()?;
        match fs::remove_file(path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
            _ => Ok(()),
        }
    }

    /// Deletes a folder with all that is in it, if it is there.
    ///
    /// # Errors
    /// The system's.
    pub fn remove_folder(&self, path: &Path) -> io::Result<()> {
        self.step()?;
        match fs::remove_dir_all(path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
            _ => Ok(()),
        }
    }

    /// A file to be read; `None` if it is not there.
    ///
    /// # Errors
    /// The system's.
    pub fn open(&self, path: &Path) -> io::Result<Option<impl Read + use<>>> {
        self.step()?;
        match File::open(path) {
            Ok(file) => Ok(Some(io::BufReader::new(file))),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// The names in a folder, sorted.
    ///
    /// # Errors
    /// The system's.
    pub fn names(&self, path: &Path) -> io::Result<Vec<String>> {
        self.step()?;
        let mut names = Vec::new();
        for entry in fs::read_dir(path)? {
            names.push(entry?.file_name().to_string_lossy().into_owned());
        }
        names.sort();
        Ok(names)
    }
}

/// Where a file is written before it is renamed.
pub fn beside(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".new");
    name.into()
}

/// A file being written.
#[derive(Debug)]
pub struct Output {
    file: File,
    disk: Disk,
}

impl Output {
    /// Makes what was written durable.
    ///
    /// # Errors
    /// The system's.
    pub fn sync(&self) -> io::Result<()> {
        self.disk.step()?;
        self.file.sync_data()
    }
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.disk.step()? {
            return self.file.write(&bytes[..bytes.len() / 2]);
        }
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
