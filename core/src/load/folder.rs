//! The one place that opens files: confined to the scene's folder, limited in size, regular files only.
//!
//! A scene comes from anywhere and names files; it must not read what lies beside it on the machine. Knows no format.

use super::error::{LoadError, Place, Result, did_you_mean};
use cap_std::ambient_authority;
use cap_std::fs::Dir;
use std::io::Read;
use std::path::{Component, Path, PathBuf};

/// Text files: scenes, materials, spectra. The largest scenes known have some 10 MB of XML.
pub(crate) const TEXT_BYTES_MAX: u64 = 256 << 20;
/// Mesh files: 100 million triangles as binary PLY are 2 GB.
pub(crate) const MESH_BYTES_MAX: u64 = 8 << 30;
/// Image files: a float EXR of 16,384 × 16,384 pixels uncompressed is 3 GB.
pub(crate) const IMAGE_BYTES_MAX: u64 = 4 << 30;
/// Names looked at for a likely spelling.
const LISTED_MAX: usize = 10_000;

/// A scene's folder.
pub(crate) struct Folder {
    dir: Dir,
    /// As the user named it; empty for the current one.
    shown: PathBuf,
    /// Where it really lies, so that an absolute path into it can be recognised.
    absolute: Vec<PathBuf>,
}

impl Folder {
    /// The folder of the file `scene`.
    ///
    /// # Errors
    /// If it is not a folder that can be read.
    pub fn of(scene: &Path) -> Result<Self> {
        let shown = scene.parent().map(Path::to_path_buf).unwrap_or_default();
        let path = if shown.as_os_str().is_empty() { Path::new(".") } else { &shown };
        let unreadable = |e: std::io::Error| {
            let message = format!("the folder cannot be opened ({e}); check the path of the scene");
            LoadError::at(Place::file(path.display().to_string()), message)
        };
        let dir = Dir::open_ambient_dir(path, ambient_authority()).map_err(unreadable)?;
        let mut absolute = vec![std::fs::canonicalize(path).map_err(unreadable)?];
        absolute.extend(std::path::absolute(path).ok());
        Ok(Self { dir, shown, absolute })
    }

    /// The path within this folder of the file that a file in `from` (a path within this folder) calls `name`.
    ///
    /// # Errors
    /// A message if it lies outside.
    pub fn locate(&self, from: &Path, name: &str) -> std::result::Result<PathBuf, String> {
        let outside = || {
            format!(
                "'{name}' lies outside the scene's folder '{}'; a scene can use only files in its own folder, so copy the \
                 file there",
                self.display()
            )
        };
        let named = Path::new(name);
        let relative = if named.is_absolute() {
            let inside = self.absolute.iter().find_map(|folder| named.strip_prefix(folder).ok());
            inside.ok_or_else(outside)?.to_path_buf()
        } else {
            from.join(named)
        };
        let mut path = PathBuf::new();
        for part in relative.components() {
            match part {
                Component::Normal(part) => path.push(part),
                Component::CurDir => {}
                Component::ParentDir if path.pop() => {}
                _ => return Err(outside()),
            }
        }
        Ok(path)
    }

    /// Whether there is such a file or folder within this folder.
    pub fn has(&self, path: &Path) -> bool {
        self.dir.metadata(path).is_ok()
    }

    /// The bytes of a file, given by its path within this folder.
    ///
    /// # Errors
    /// A message if it is missing, not a regular file, larger than `limit` bytes or unreadable.
    pub fn read(&self, path: &Path, limit: u64) -> std::result::Result<Vec<u8>, String> {
        let named = self.name_of(path);
        let metadata = self.dir.metadata(path).map_err(|e| self.refusal(path, &e))?;
        if !metadata.is_file() {
            return Err(format!("'{named}' is not a file"));
        }
        let file = self.dir.open(path).map_err(|e| self.refusal(path, &e))?;
        read_limited(file.into_std(), metadata.len(), limit).map_err(|problem| format!("'{named}' {problem}"))
    }

    /// The name under which the user would find a file, given by its path within this folder.
    pub fn name_of(&self, path: &Path) -> String {
        self.shown.join(path).display().to_string()
    }

    fn display(&self) -> String {
        if self.shown.as_os_str().is_empty() { ".".into() } else { self.shown.display().to_string() }
    }

    fn refusal(&self, path: &Path, error: &std::io::Error) -> String {
        let named = self.name_of(path);
        match error.kind() {
            std::io::ErrorKind::NotFound => {
                let wanted = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
                let present = self.list(path.parent().unwrap_or(Path::new("")));
                let hint = did_you_mean(&wanted, present.iter().map(String::as_str));
                format!("there is no file '{named}'{hint}")
            }
            std::io::ErrorKind::PermissionDenied => format!(
                "'{named}' cannot be opened: it is not readable, or a link that leads outside the scene's folder; a scene \
                 can use only files in its own folder"
            ),
            _ => format!("'{named}' cannot be opened ({error})"),
        }
    }

    fn list(&self, path: &Path) -> Vec<String> {
        let path = if path.as_os_str().is_empty() { Path::new(".") } else { path };
        let Ok(entries) = self.dir.read_dir(path) else { return Vec::new() };
        entries.flatten().take(LISTED_MAX).map(|entry| entry.file_name().to_string_lossy().into_owned()).collect()
    }
}

/// The bytes of the scene file itself. The user named it, so it may be a link to anywhere.
///
/// # Errors
/// If it is missing, not a file, too large or unreadable.
pub(crate) fn read_scene_file(path: &Path) -> Result<Vec<u8>> {
    let fail = |problem: String| LoadError::at(Place::file(path.display().to_string()), problem);
    let metadata = std::fs::metadata(path).map_err(|e| match e.kind() {
        std::io::ErrorKind::NotFound => fail("there is no such file; check the path of the scene".into()),
        _ => fail(format!("the file cannot be opened ({e})")),
    })?;
    if !metadata.is_file() {
        return Err(fail("this is not a file; name the scene file itself, such as scene.xml".into()));
    }
    let file = std::fs::File::open(path).map_err(|e| fail(format!("the file cannot be opened ({e})")))?;
    read_limited(file, metadata.len(), TEXT_BYTES_MAX.max(MESH_BYTES_MAX))
        .map_err(|problem| fail(format!("the file {problem}")))
}

fn read_limited(file: std::fs::File, len: u64, limit: u64) -> std::result::Result<Vec<u8>, String> {
    let too_large = || format!("is larger than {} MiB, more than a file of its kind may have", limit >> 20);
    if len > limit {
        return Err(too_large());
    }
    // The file may still grow or shrink: the length only sizes the buffer.
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(usize::try_from(len).unwrap_or(0)).map_err(|_| too_large())?;
    file.take(limit + 1).read_to_end(&mut bytes).map_err(|e| format!("cannot be read ({e})"))?;
    if bytes.len() as u64 > limit { Err(too_large()) } else { Ok(bytes) }
}
