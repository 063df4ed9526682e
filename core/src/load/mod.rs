//! Files into a [`Scene`] and the [`Settings`] it comes with.
//!
//! Each format is a file or folder of its own ([`mitsuba`], [`wavefront`]) that fills an assembly in f64 world space; what
//! they share stands here: opening files only within the scene's folder, meshes, images, errors that point into the file.
//! Everything from outside is checked here, and nothing behind it checks again.

mod assembly;
mod error;
mod folder;
mod image;
mod mesh;
pub mod mitsuba;
mod placed;
mod wavefront;

pub use error::LoadError;

use crate::scene::Scene;
use crate::settings::Settings;
use error::{Place, Result};
use std::fmt;
use std::path::Path;

/// How to load a scene.
#[derive(Clone, Debug, Default)]
pub struct LoadOptions {
    /// Values for the scene's `$names`, as `-D name=value` gives them; they win over its defaults.
    pub defines: Vec<(String, String)>,
    /// Whether plugins and parameters that tilecast does not have are replaced or left out; else they are errors.
    pub substitute: bool,
}

/// A scene that is ready to render.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// What there is.
    pub scene: Scene,
    /// How the file wants it rendered.
    pub settings: Settings,
    /// What its author should know: what was read and has no effect, what was left out.
    pub notes: Vec<Note>,
    /// What was replaced or left out because [`LoadOptions::substitute`] asked for it.
    pub substitutions: Vec<Note>,
}

/// Something about a file that is no error. `Display` gives `file:line: text`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Note {
    pub(crate) place: Option<Place>,
    /// What there is to know.
    pub text: String,
}

impl fmt::Display for Note {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.place.as_ref().map(Place::file_and_line) {
            Some((file, Some(line))) => write!(f, "{file}:{line}: {}", self.text),
            Some((file, None)) => write!(f, "{file}: {}", self.text),
            None => f.write_str(&self.text),
        }
    }
}

/// Loads a scene file; its ending says what it is.
///
/// # Errors
/// Whatever is wrong with the file or those it names, with the place.
pub fn load(path: &Path, options: &LoadOptions) -> Result<Loaded> {
    let ending = path.extension().and_then(|ending| ending.to_str()).map(str::to_ascii_lowercase);
    match ending.as_deref() {
        Some("xml") => mitsuba::load(path, options),
        Some("obj") => wavefront::load(path, options),
        _ => {
            let message =
                "scenes are Mitsuba 3 files (.xml) and Wavefront OBJ files (.obj); this is neither by its name";
            Err(LoadError::at(Place::file(path.display().to_string()), message))
        }
    }
}
