//! Where the image goes: found to be writable before rendering, and never there half written.

use crate::kept::{Kept, beside};
use crate::proof::Finished;
use crate::{exr, preview};
use anyhow::{Context, bail};
use atomic_write_file::AtomicWriteFile;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Files that can be written, as far as one can know.
#[derive(Clone, Debug)]
pub struct Output {
    /// The image.
    pub exr: PathBuf,
    /// The picture for people, if wanted.
    pub png: Option<PathBuf>,
    /// The film, if wanted.
    pub film: Option<PathBuf>,
    /// What there is to say of the image, likewise.
    pub json: Option<PathBuf>,
    /// The picture of its errors, if wanted.
    pub errors: Option<PathBuf>,
    /// Whether image and pictures are written after every round.
    pub refreshed: bool,
}

impl Output {
    /// Checks that the files can be written, by beginning to.
    ///
    /// # Errors
    /// A folder that is missing or refuses, or something else that bears the name.
    pub fn check(path: PathBuf, preview: bool, film: bool) -> anyhow::Result<Self> {
        let film = film.then(|| beside(&path));
        if film.as_ref() == Some(&path) {
            bail!("-o {}: the image and its film would be one file; end it in .exr", path.display());
        }
        let png = preview.then(|| path.with_extension("png"));
        if png.as_ref() == Some(&path) {
            bail!("-o {}: with --preview the image and its preview would be one file; end it in .exr", path.display());
        }
        let exr = writable(path)?;
        let png = png.map(writable).transpose()?;
        let film = film.map(writable).transpose()?;
        let json = film.is_some().then(|| exr.with_extension("json")).map(writable).transpose()?;
        Ok(Self { exr, png, film, json, errors: None, refreshed: false })
    }

    /// The same, with pictures that are refreshed after every round, one of them of the errors.
    ///
    /// # Errors
    /// See [`Output::check`].
    pub fn refreshed(self) -> anyhow::Result<Self> {
        let png = writable(self.exr.with_extension("png"))?;
        let errors = writable(self.exr.with_extension("error.png"))?;
        Ok(Self { png: Some(png), errors: Some(errors), refreshed: true, ..self })
    }

    /// Writes what there is of the image. Blocks.
    ///
    /// # Errors
    /// See [`Output::write`].
    pub fn refresh(&self, kept: &Kept) -> anyhow::Result<()> {
        Self { film: None, ..self.clone() }.write(kept)
    }

    /// Writes what there is to say of the image. Blocks, but not for long.
    ///
    /// # Errors
    /// See [`Output::write`].
    pub fn write_proof(&self, proof: &Finished) -> anyhow::Result<()> {
        let Some(path) = &self.json else { return Ok(()) };
        let text = serde_json::to_string_pretty(proof)? + "\n";
        replace(path, |file| Ok(file.write_all(text.as_bytes())?))
            .with_context(|| format!("cannot write {}", path.display()))
    }

    /// Writes the image. Blocks.
    ///
    /// # Errors
    /// A full disk, or whatever else befalls files; what was there before is there still.
    pub fn write(&self, kept: &Kept) -> anyhow::Result<()> {
        let failed = |path: &Path| format!("cannot write {}", path.display());
        // The film first: an image without the film that it is of could not be gone on with.
        if let Some(film) = &self.film {
            kept.write(film).with_context(|| failed(film))?;
        }
        replace(&self.exr, |file| exr::write(file, kept)).with_context(|| failed(&self.exr))?;
        if let Some(png) = &self.png {
            replace(png, |file| preview::write(file, &kept.film)).with_context(|| failed(png))?;
        }
        if let Some(errors) = &self.errors {
            replace(errors, |file| preview::write_errors(file, &kept.film)).with_context(|| failed(errors))?;
        }
        Ok(())
    }
}

/// The path, with links followed, so that what a link points to is replaced and not the link.
///
/// # Errors
/// A folder that is missing or refuses, or something else that bears the name.
pub fn writable(path: PathBuf) -> anyhow::Result<PathBuf> {
    let shown = path.display().to_string();
    let path = if path.is_symlink() { path.canonicalize().with_context(|| format!("-o {shown}"))? } else { path };
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if !folder.is_dir() {
        bail!("-o {shown}: there is no folder {}; make it first", folder.display());
    }
    if path.exists() && !path.is_file() {
        bail!("-o {shown}: that is no file, so an image cannot replace it; name another");
    }
    AtomicWriteFile::open(&path)
        .and_then(AtomicWriteFile::discard)
        .with_context(|| format!("-o {shown}: the folder {} cannot be written to", folder.display()))?;
    Ok(path)
}

/// Writes beside the file, and renames when all is there.
///
/// # Errors
/// What `write` fails with, or the file.
pub fn replace(path: &Path, write: impl FnOnce(&mut AtomicWriteFile) -> anyhow::Result<()>) -> anyhow::Result<()> {
    let mut file = AtomicWriteFile::options().read(true).open(path)?;
    write(&mut file)?;
    Ok(file.commit()?)
}

#[cfg(test)]
mod tests;
