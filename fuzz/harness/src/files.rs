//! Scene files, and the files that they name.

use std::path::Path;
use tilecast_core::load::{LoadOptions, load};

/// A scene that shows a file.
fn showing(element: &str) -> String {
    format!("<scene version='3.0.0'><sensor type='perspective'/>{element}</scene>")
}

/// Loads `scene` from a folder that holds `bytes` under `name`, and checks it as the tracer wants it.
fn load_with(bytes: &[u8], name: &str, scene: &str) {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join(name), bytes).expect("a file");
    let path = folder.path().join("scene.xml");
    std::fs::write(&path, scene).expect("a file");
    check(&path);
}

fn check(path: &Path) {
    for substitute in [false, true] {
        match load(path, &LoadOptions { substitute, ..LoadOptions::default() }) {
            Ok(loaded) => loaded.scene.validate().expect("what loads is valid"),
            // People read it.
            Err(error) => assert!(!error.to_string().is_empty()),
        }
    }
}

/// A Mitsuba scene.
pub fn xml(bytes: &[u8]) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("scene.xml");
    std::fs::write(&path, bytes).expect("a file");
    check(&path);
}

/// An OBJ file, in a scene and as one, whose materials are in the same file.
pub fn obj(bytes: &[u8]) {
    load_with(bytes, "m.obj", &showing("<shape type='obj'><string name='filename' value='m.obj'/></shape>"));
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("m.obj");
    std::fs::write(folder.path().join("m.mtl"), bytes).expect("a file");
    std::fs::write(&path, bytes).expect("a file");
    check(&path);
}

/// A PLY file, with an attribute that is looked for.
pub fn ply(bytes: &[u8]) {
    let element = "<shape type='ply'><string name='filename' value='m.ply'/></shape>";
    load_with(bytes, "m.ply", &showing(element));
    let element = "<shape type='ply'><string name='filename' value='m.ply'/><bsdf type='diffuse'><texture type='mesh_attribute' \
        name='reflectance'><string name='name' value='vertex_color'/></texture></bsdf></shape>";
    load_with(bytes, "m.ply", &showing(element));
}

/// A file of Mitsuba's own meshes; the first byte says which of them.
pub fn serialized(bytes: &[u8]) {
    let Some((index, bytes)) = bytes.split_first() else { return };
    let element = format!(
        "<shape type='serialized'><string name='filename' value='m.serialized'/><integer name='shape_index' value='{}'/></shape>",
        index % 3
    );
    load_with(bytes, "m.serialized", &showing(&element));
}

/// An image; the first byte says of which format it is.
pub fn texture(bytes: &[u8]) {
    const ENDINGS: [&str; 5] = ["png", "jpg", "exr", "hdr", "tga"];
    let Some((kind, bytes)) = bytes.split_first() else { return };
    let name = format!("t.{}", ENDINGS[usize::from(*kind) % ENDINGS.len()]);
    let element = format!(
        "<shape type='rectangle'><bsdf type='diffuse'><texture type='bitmap' name='reflectance'><string name='filename' \
         value='{name}'/></texture></bsdf></shape>"
    );
    load_with(bytes, &name, &showing(&element));
}
