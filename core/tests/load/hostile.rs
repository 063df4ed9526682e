//! Files that someone spoiled: loading them may fail, but never panics, hangs or takes all memory.

use crate::{TRIANGLE_OBJ, TRIANGLE_PLY, load_with, write_files};
use proptest::prelude::*;
use std::cell::RefCell;

const SCENE: &str = "<scene version='3.0.0'><default name='r' value='2'/>\n<integrator type='path'/><sensor type='perspective'>\
    <film type='hdrfilm'><integer name='width' value='64'/><rfilter type='tent'/></film></sensor>\n\
    <include filename='b.xml'/><shape type='obj'><string name='filename' value='a.obj'/><ref id='m'/>\
    <transform name='to_world'><lookat origin='0 0 $r' target='1 1 1' up='0 1 0'/><matrix value='1 0 0 0 1 0 0 0 1'/>\
    </transform></shape>\n<shape type='ply'><string name='filename' value='a.ply'/><emitter type='area'>\
    <spectrum name='radiance' value='400:1, 700:2'/></emitter></shape><emitter type='constant'/></scene>";
const INCLUDED: &str = "<scene version='0.5.0'><bsdf type='mask' id='m'><float name='opacity' value='0.5'/><bsdf type='diffuse'>\
    <texture name='diffuseReflectance' type='bitmap'><string name='filename' value='a.png'/></texture></bsdf></bsdf></scene>";
const MTL: &str =
    "newmtl m\nKd .1 .2 .3\nKs .4 .4 .4\nNs 60\nd 0.5\nmap_Kd -s 2 2 -clamp on a.png\nillum 4\nTf 1 1 1\nNi 1.5\n";

/// The scene with all its files, and a bare OBJ file.
fn files() -> Vec<(&'static str, Vec<u8>)> {
    let mut png = std::io::Cursor::new(Vec::new());
    image::RgbImage::from_pixel(3, 2, image::Rgb([9, 8, 7])).write_to(&mut png, image::ImageFormat::Png).unwrap();
    let bare = format!(
        "mtllib b.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\nusemtl m\nf 1/1/1 2/1/1 3/1/1\n{TRIANGLE_OBJ}"
    );
    let mut binary = b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
                       element face 1\nproperty list uchar int vertex_indices\nend_header\n"
        .to_vec();
    [0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].iter().for_each(|x| binary.extend(x.to_le_bytes()));
    binary.push(3);
    [0i32, 1, 2].iter().for_each(|i| binary.extend(i.to_le_bytes()));
    vec![
        ("a.xml", SCENE.into()),
        ("b.xml", INCLUDED.into()),
        ("a.obj", TRIANGLE_OBJ.into()),
        ("a.ply", TRIANGLE_PLY.into()),
        ("a.png", png.into_inner()),
        ("b.obj", bare.into_bytes()),
        ("b.mtl", MTL.into()),
        ("c.ply", binary),
        ("c.xml", SCENE.replace("a.ply", "c.ply").into_bytes()),
    ]
}

/// One spoiled place: where (a fraction of the length), how, and with which byte.
#[derive(Clone, Debug)]
struct Spoil {
    at: f64,
    how: u8,
    byte: u8,
}

impl Spoil {
    fn apply(&self, bytes: &mut Vec<u8>) {
        let at = (self.at * bytes.len() as f64) as usize;
        if at >= bytes.len() {
            return;
        }
        match self.how {
            0 => bytes[at] = self.byte,
            1 => bytes[at] ^= 1 << (self.byte % 8),
            2 => bytes.truncate(at),
            3 => drop(bytes.remove(at)),
            4 => bytes.insert(at, self.byte),
            // Digits and what looks like syntax reach deeper than arbitrary bytes.
            5 => bytes[at] = b"0123456789-.e<>/\"'$:# "[usize::from(self.byte) % 22],
            _ => {
                let copy = bytes[at..(at + usize::from(self.byte)).min(bytes.len())].to_vec();
                bytes.splice(at..at, copy);
            }
        }
    }
}

fn spoils() -> impl Strategy<Value = Vec<Spoil>> {
    let one = (0.0..1.0f64, 0..7u8, any::<u8>()).prop_map(|(at, how, byte)| Spoil { at, how, byte });
    prop::collection::vec(one, 1..4)
}

thread_local! {
    static FOLDER: RefCell<Option<tempfile::TempDir>> = const { RefCell::new(None) };
}

/// Loads both scenes of a folder in which one file is spoiled; the folder is reused from case to case.
fn load_spoiled(which: usize, spoils: &[Spoil]) {
    let files = files();
    let (name, mut bytes) = files[which].clone();
    spoils.iter().for_each(|spoil| spoil.apply(&mut bytes));
    FOLDER.with_borrow_mut(|folder| {
        let folder = folder.get_or_insert_with(|| {
            let folder = tempfile::tempdir().unwrap();
            files.iter().for_each(|(name, bytes)| write_files(folder.path(), &[(name, bytes)]));
            folder
        });
        write_files(folder.path(), &[(name, &bytes)]);
        for scene in ["a.xml", "b.obj", "c.xml"] {
            if let Err(error) = load_with(&folder.path().join(scene), &[]) {
                assert!(!error.message().is_empty());
            }
        }
        write_files(folder.path(), &[(name, &files[which].1)]);
    });
}

#[test]
fn the_unspoiled_files_load() {
    let folder = tempfile::tempdir().unwrap();
    files().iter().for_each(|(name, bytes)| write_files(folder.path(), &[(name, bytes)]));
    for scene in ["a.xml", "b.obj", "c.xml"] {
        load_with(&folder.path().join(scene), &[]).unwrap_or_else(|e| panic!("{scene}: {e}"));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(3000) })]

    #[test]
    fn spoiled_files_never_panic(which in 0..9usize, spoils in spoils()) {
        load_spoiled(which, &spoils);
    }
}

#[test]
fn bombs_are_defused() {
    let folder = tempfile::tempdir().unwrap();
    let load = |inside: String| {
        let scene = format!("<scene version='3.0.0'>{inside}</scene>");
        write_files(folder.path(), &[("a.xml", scene.as_bytes())]);
        load_with(&folder.path().join("a.xml"), &[]).unwrap_err().to_string()
    };
    let nested = "<bsdf type='twosided'>".repeat(100_000) + &"</bsdf>".repeat(100_000);
    assert!(load(nested).contains("nested more than 64 deep"));
    let mut laughs = String::from("<default name='a0' value='ha'/>");
    (0..60).for_each(|i| laughs += &format!("<default name='a{}' value='$a{i}$a{i}'/>", i + 1));
    assert!(load(laughs).contains("beyond all measure"));
    let entities = "<!DOCTYPE a [<!ENTITY b 'c'>]>";
    write_files(folder.path(), &[("b.xml", format!("{entities}<scene version='3.0.0'/>").as_bytes())]);
    assert!(load_with(&folder.path().join("b.xml"), &[]).unwrap_err().to_string().contains("not well-formed"));
    let many = "<include filename='c.xml'/>".repeat(2000);
    write_files(folder.path(), &[("c.xml", b"<scene version='3.0.0'/>")]);
    assert!(load(many).contains("1000 in all"));
}
