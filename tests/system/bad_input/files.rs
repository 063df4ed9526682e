//! Scene files, and files that they name.

use super::{FAILED, refused};
use crate::harness::Folder;

/// A scene with a camera and a light, and `body` from line 7 on.
fn scene(body: &str) -> String {
    format!(
        "<scene version=\"3.0.0\">\n<default name=\"size\" value=\"16\"/>\n<integrator type=\"path\"/>\n\
         <sensor type=\"perspective\"><film type=\"hdrfilm\"><integer name=\"width\" value=\"$size\"/>\
         <integer name=\"height\" value=\"$size\"/></film></sensor>\n<emitter type=\"constant\"/>\n\n{body}\n</scene>\n"
    )
}

/// The scene as such is fine, else every case below would pass for the wrong reason.
#[test]
fn the_scene_of_these_tests_renders() {
    let folder = Folder::new();
    folder.write("good.obj", TRIANGLE);
    folder.write(
        "s.xml",
        scene("<shape type=\"sphere\"/><shape type=\"obj\"><string name=\"filename\" value=\"good.obj\"/></shape>"),
    );
    folder.render("s.xml", ["--spp", "1"]);
}

const TRIANGLE: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";

#[test]
fn files_that_are_no_scenes() {
    let folder = Folder::new();
    folder.write("words.xml", "This is a shopping list.");
    folder.write("page.xml", "<html>\n<body/></html>");
    folder.write("empty.xml", "");
    folder.write("bytes.xml", [0xff, 0xfe, 0x00, 0x80, 0x3c]);
    folder.write("cut.xml", &scene("<shape type=\"sphere\"/>")[..150]);
    folder.write("cut-tag.xml", scene("<shape type=\"sphere\">\n<boolean name="));
    folder.write("picture.png", "not a scene");
    folder.write("folder.xml/inside", "");
    let cases = [
        "missing.xml",
        "words.xml",
        "page.xml",
        "empty.xml",
        "bytes.xml",
        "cut.xml",
        "cut-tag.xml",
        "picture.png",
        "folder.xml",
    ];
    for file in cases {
        refused(&folder, &["render", file], FAILED, &[file]);
        refused(&folder, &["info", file], FAILED, &[file]);
    }
    refused(&folder, &["render", "cut-tag.xml"], FAILED, &["cut-tag.xml:9"]);
}

/// What is wrong stands on line 8; the message names it there.
#[test]
fn xml_that_is_wrong_is_shown_with_its_line() {
    let cases: [(&str, &[&str]); 22] = [
        ("<shape type=\"spere\"/>", &["spere", "sphere"]),
        ("<shape type=\"sphere\"><float name=\"radios\" value=\"1\"/></shape>", &["radios", "radius"]),
        ("<shape type=\"sphere\"><float name=\"radius\" value=\"wide\"/></shape>", &["wide"]),
        ("<shape type=\"sphere\"><float name=\"radius\" value=\"nan\"/></shape>", &[]),
        ("<shape type=\"sphere\"><string name=\"radius\" value=\"1\"/></shape>", &["radius"]),
        ("<shape type=\"sphere\"><float name=\"radius\" value=\"$nowhere\"/></shape>", &["nowhere"]),
        ("<shape type=\"sphere\"><ref id=\"nothing\"/></shape>", &["nothing"]),
        ("<shapes type=\"sphere\"/>", &["shapes", "shape"]),
        ("<shape/>", &["type"]),
        ("<include filename=\"missing.xml\"/>", &["missing.xml"]),
        ("<include filename=\"../outside.xml\"/>", &["outside.xml"]),
        ("<include filename=\"circle.xml\"/>", &["circle"]),
        ("<shape type=\"obj\"><string name=\"filename\" value=\"missing.obj\"/></shape>", &["missing.obj"]),
        ("<shape type=\"obj\"><string name=\"filename\" value=\"../outside.obj\"/></shape>", &["outside.obj"]),
        ("<shape type=\"obj\"><string name=\"filename\" value=\"/etc/passwd\"/></shape>", &["/etc/passwd"]),
        (
            "<shape type=\"obj\"><string name=\"filename\" value=\"file:///etc/passwd\"/></shape>",
            &["file:///etc/passwd"],
        ),
        ("<shape type=\"obj\"/>", &["filename"]),
        (IMAGE_TEXT, &["words.png"]),
        (IMAGE_CUT, &["cut.png"]),
        (
            "<bsdf type=\"twosided\" id=\"a\"><ref id=\"a\"/></bsdf><shape type=\"sphere\"><ref id=\"a\"/></shape>",
            &["a"],
        ),
        ("<shape type=\"sphere\"></shap>", &["shap"]),
        ("<shape type=\"sphere\"><rgb name=\"to_world\" value=\"1,2\"/></shape>", &[]),
    ];
    for (body, names) in cases {
        let folder = Folder::new();
        folder.write("s/scene.xml", scene(&format!("\n{body}")));
        folder.write("s/circle.xml", "<scene version=\"3.0.0\"><include filename=\"circle.xml\"/></scene>");
        folder.write("s/words.png", "no picture");
        folder.write("s/cut.png", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\0\x10\0\0\0\x10\x08\x02\0\0\0");
        folder.write("outside.xml", scene(""));
        folder.write("outside.obj", TRIANGLE);
        let place = if body.contains("circle") { "circle.xml:1" } else { "scene.xml:8" };
        refused(&folder, &["render", "s/scene.xml"], FAILED, &[&[place], names].concat());
    }
}

const IMAGE_TEXT: &str = "<shape type=\"sphere\"><bsdf type=\"diffuse\"><texture type=\"bitmap\" name=\"reflectance\">\
    <string name=\"filename\" value=\"words.png\"/></texture></bsdf></shape>";
const IMAGE_CUT: &str = "<shape type=\"sphere\"><bsdf type=\"diffuse\"><texture type=\"bitmap\" name=\"reflectance\">\
    <string name=\"filename\" value=\"cut.png\"/></texture></bsdf></shape>";

#[test]
fn settings_in_the_file_are_checked() {
    for (size, names) in [("0", ["0"]), ("65537", ["65537"]), ("-3", ["-3"]), ("1e9", ["1e9"])] {
        let folder = Folder::new();
        folder.write("s.xml", scene("<shape type=\"sphere\"/>"));
        refused(&folder, &["render", "s.xml", "-D", &format!("size={size}")], FAILED, &names);
    }
    let folder = Folder::new();
    folder.write(
        "s.xml",
        scene("").replace(
            "</film>",
            "</film><sampler type=\"independent\"><integer name=\"sample_count\" value=\"0\"/></sampler>",
        ),
    );
    refused(&folder, &["render", "s.xml"], FAILED, &["sample"]);
    folder.write("s.xml", scene(""));
    refused(&folder, &["render", "s.xml", "-D", "sise=3"], FAILED, &["sise", "size"]);
}

#[test]
fn meshes_that_are_wrong() {
    let ply = |vertices: &str, faces: &str| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
             element face 1\nproperty list uchar int vertex_indices\nend_header\n{vertices}{faces}"
        )
    };
    let corners = "0 0 0\n1 0 0\n0 1 0\n";
    let cases = [
        ("index.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n".to_owned()),
        ("zero.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n".to_owned()),
        ("nan.obj", "v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n".to_owned()),
        ("infinite.obj", "v 0 0 0\nv 1e39 0 0\nv 0 1 0\nf 1 2 3\n".to_owned()),
        ("words.obj", "v 0 0 zero\nv 1 0 0\nv 0 1 0\nf 1 2 3\n".to_owned()),
        ("no-faces.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n".to_owned()),
        ("empty.obj", String::new()),
        ("index.ply", ply(corners, "3 0 1 3\n")),
        ("negative.ply", ply(corners, "3 0 1 -1\n")),
        ("nan.ply", ply("0 0 0\nnan 0 0\n0 1 0\n", "3 0 1 2\n")),
        ("cut.ply", ply("0 0 0\n1 0 0\n", "")),
        ("words.ply", "no mesh".to_owned()),
    ];
    for (name, text) in cases {
        let folder = Folder::new();
        let kind = &name[name.len() - 3..];
        folder.write(name, text);
        folder.write(
            "s.xml",
            scene(&format!("<shape type=\"{kind}\"><string name=\"filename\" value=\"{name}\"/></shape>")),
        );
        refused(&folder, &["render", "s.xml"], FAILED, &[name]);
        if kind == "obj" {
            refused(&folder, &["render", name, "--spp", "1"], FAILED, &[name]);
        }
    }
}
