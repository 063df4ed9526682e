//! `tilecast merge`: joins films of the same picture, made of different samples on machines that never met.

use crate::kept::{Kept, beside};
use crate::output::Output;
use crate::proof::Finished;
use crate::report::{Report, Style};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// What to join, and where to.
pub struct Merge {
    /// Films, or images with films beside them.
    pub films: Vec<PathBuf>,
    /// Where to.
    pub output: Output,
    /// How it tells of itself.
    pub style: Style,
}

/// Joins and writes. Blocks.
///
/// # Errors
/// A film that cannot be read, is damaged or foreign, or has what another has; or a file that cannot be written.
pub fn run(merge: Merge) -> anyhow::Result<()> {
    let begun = Instant::now();
    let mut joined: Option<(Kept, String)> = None;
    for path in merge.films.iter().map(|path| film_of(path)) {
        let (film, name) = (Kept::read(&path)?, path.display().to_string());
        match &mut joined {
            None => joined = Some((film, name)),
            Some((all, names)) => {
                all.join(film, [names.as_str(), name.as_str()])?;
                *names = format!("{names} + {name}");
            }
        }
    }
    let Some((kept, _)) = joined else { return Ok(()) };
    merge.output.write(&kept)?;
    merge.output.write_proof(&Finished::new(&kept, begun.elapsed(), &[], &merge.output))?;
    Report::new(merge.style).written(&kept, begun.elapsed(), None, &merge.output.exr);
    Ok(())
}

/// The film that a path means: an image's is beside it.
pub fn film_of(path: &Path) -> PathBuf {
    let is_image = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr"));
    if is_image { beside(path) } else { path.to_owned() }
}
