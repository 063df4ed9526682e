//! Loading scenes through the public API: each test writes the files it needs into a folder of its own.

#![allow(clippy::unwrap_used)] // in helpers too: a test that cannot write its files has failed

mod bsdfs;
mod faults;
mod groups;
mod hostile;
mod lights_and_cameras;
mod mitsuba;
mod obj;
mod substitutes;

use std::path::Path;
use tilecast_core::load::{LoadError, LoadOptions, Loaded, load};

/// A triangle.
const TRIANGLE_OBJ: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
/// The same as PLY.
const TRIANGLE_PLY: &str = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
                            element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";

/// Writes `files` into a new folder (names may have folders in them) and loads the first.
fn load_files(files: &[(&str, &[u8])], defines: &[(&str, &str)]) -> Result<Loaded, LoadError> {
    let folder = tempfile::tempdir().unwrap();
    write_files(folder.path(), files);
    load_with(&folder.path().join(files[0].0), defines)
}

fn write_files(folder: &Path, files: &[(&str, &[u8])]) {
    for (name, bytes) in files {
        let path = folder.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
}

fn load_with(path: &Path, defines: &[(&str, &str)]) -> Result<Loaded, LoadError> {
    let defines = defines.iter().map(|(name, value)| (name.to_string(), value.to_string())).collect();
    load(path, &LoadOptions { defines, ..LoadOptions::default() })
}

/// A scene of what stands inside `<scene>`, with a triangle `a.obj` and `a.ply` beside it.
fn load_scene(inside: &str) -> Result<Loaded, LoadError> {
    let scene = format!("<scene version=\"3.0.0\">\n{inside}\n</scene>\n");
    let files: [(&str, &[u8]); 3] =
        [("a.xml", scene.as_bytes()), ("a.obj", TRIANGLE_OBJ.as_bytes()), ("a.ply", TRIANGLE_PLY.as_bytes())];
    load_files(&files, &[])
}

/// The error of a scene that must not load, less the folder's name.
fn error_of(inside: &str) -> String {
    let error = load_scene(inside).expect_err("this scene should not load");
    let message = error.to_string();
    message.find("a.xml").map_or(message.clone(), |i| message[i..].to_owned())
}
