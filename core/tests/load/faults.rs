//! Every kind of bad input, and what is said of it: where, what, and what to do.

use crate::{TRIANGLE_OBJ, error_of, load_files, load_with, write_files};

/// Asserts that a scene of `inside` fails at line:column with a message that has all of `parts`.
pub fn fails(inside: &str, at: &str, parts: &[&str]) {
    let message = error_of(inside);
    assert!(message.starts_with(&format!("a.xml:{at}: ")), "not at {at}: {message}");
    for part in parts {
        assert!(message.contains(part), "no '{part}' in: {message}");
    }
}

fn fails_with_files(files: &[(&str, &[u8])], parts: &[&str]) {
    let message = load_files(files, &[]).expect_err("this should not load").to_string();
    for part in parts {
        assert!(message.contains(part), "no '{part}' in: {message}");
    }
}

const SHAPE: &str = "<shape type='obj'><string name='filename' value='a.obj'/></shape>";

#[test]
fn missing_unreadable_and_other_files() {
    let folder = tempfile::tempdir().unwrap();
    let error = |name: &str| load_with(&folder.path().join(name), &[]).unwrap_err().to_string();
    assert!(error("none.xml").contains("none.xml: there is no such file; check the path"));
    assert!(error("none/none.xml").contains("the folder cannot be opened"));
    assert!(error("scene.blend").contains("neither by its name"));
    std::fs::create_dir(folder.path().join("folder.xml")).unwrap();
    assert!(error("folder.xml").contains("this is not a file"));
    write_files(folder.path(), &[("bytes.xml", b"<scene version='3.0.0'>\n\xff\xfe</scene>")]);
    assert!(error("bytes.xml").contains("line 2 is not UTF-8 text"));
    write_files(folder.path(), &[("truncated.xml", b"<scene version='3.0.0'>\n<shape type='sphere'>")]);
    assert!(error("truncated.xml").contains("not well-formed XML"));
    write_files(folder.path(), &[("empty.xml", b"")]);
    assert!(error("empty.xml").contains("not well-formed XML"));
    write_files(folder.path(), &[("html.xml", b"<html version='1.0.0'></html>")]);
    assert!(error("html.xml").contains("html.xml:1:1: a scene file starts with <scene>, not <html>"));
    write_files(folder.path(), &[("old.xml", b"<scene>\n</scene>")]);
    assert!(error("old.xml").contains("<scene> needs a version"));
    write_files(folder.path(), &[("odd.xml", b"<scene version='3'/>")]);
    assert!(error("odd.xml").contains("'3' is no version; write three numbers"));
}

#[test]
fn xml_errors_have_a_place() {
    fails("<shape type='sphere'></bsdf>", "2:22", &["not well-formed XML", "expected 'shape'"]);
    fails("<shape typ='sphere'/>", "2:13", &["<shape> has no attribute 'typ'", "did you mean 'type'?"]);
    fails("<shape/>", "2:1", &["<shape> needs the attribute 'type'"]);
    fails("<shpe type='sphere'/>", "2:1", &["knows no <shpe>", "did you mean 'shape'?"]);
    fails("<scale value='2'/>", "2:1", &["only inside a <transform>"]);
    fails("<float name='a' value='1'/>", "2:24", &["a float cannot stand directly in <scene>"]);
    fails(
        "<shape type='disk'><string name='a' value='b'><ref id='c'/></string></shape>",
        "2:47",
        &["cannot stand inside"],
    );
}

#[test]
fn unknown_plugins_and_those_not_supported_yet() {
    fails(
        "<shape type='sphre'/>",
        "2:14",
        &["no shape is called 'sphre'", "did you mean 'sphere'?", "there are obj, ply"],
    );
    let hair = "<shape type='disk'>\n<bsdf type='hair'/></shape>";
    fails(hair, "3:13", &["Mitsuba's bsdf 'hair' is not supported yet; there are diffuse"]);
    fails("<integrator type='volpath'/>", "2:19", &["Mitsuba's integrator 'volpath' is not supported yet"]);
    fails("<emitter type='sunsky'/>", "2:16", &["Mitsuba's emitter 'sunsky' is not supported yet"]);
}

#[test]
fn unknown_parameters_and_wrong_types() {
    let in_sphere = |inside: &str| format!("<shape type='sphere'>\n{inside}</shape>");
    fails(&in_sphere("<float name='raduis' value='1'/>"), "3:29", &["no parameter 'raduis'", "did you mean 'radius'?"]);
    fails(
        &in_sphere("<string name='radius' value='1'/>"),
        "3:30",
        &["'radius' of shape of type 'sphere' takes a float, not a string"],
    );
    fails(&in_sphere("<float name='radius' value='big'/>"), "3:29", &["'big' is not a finite number"]);
    fails(&in_sphere("<float name='radius' value='-1'/>"), "3:29", &["'radius' is -1; it must be above 0"]);
    fails(&in_sphere("<boolean name='flip_normals' value='1'/>"), "3:37", &["neither 'true' nor 'false'"]);
    fails(&in_sphere("<integer name='radius' value='1.5'/>"), "3:31", &["'1.5' is not an integer"]);
    fails(&in_sphere("<point name='center' x='1' y='2'/>"), "3:1", &["needs the attribute 'z'"]);
    fails(&in_sphere("<point name='center' value='1 2'/>"), "3:29", &["write one or three"]);
    let twice = "<float name='radius' value='1'/>\n<float name='radius' value='2'/>";
    fails(&in_sphere(twice), "4:29", &["'radius' is given twice"]);
    fails(&in_sphere("<sampler type='independent'/>"), "3:1", &["a sampler cannot stand in shape 'sphere'"]);
    let two = "<bsdf type='diffuse'/>\n<bsdf type='diffuse'/>";
    fails(&in_sphere(two), "4:1", &["can have only one bsdf"]);
    let unnamed = "<bsdf type='diffuse'><texture type='checkerboard'/></bsdf>";
    fails(&in_sphere(unnamed), "3:22", &["this texture needs a name", "name=\"reflectance\""]);
    let bright = "<bsdf type='diffuse'><rgb name='reflectance' value='2'/></bsdf>";
    fails(&in_sphere(bright), "3:53", &["each of its numbers must lie between 0 and 1"]);
    let metal = "<bsdf type='conductor'><string name='material' value='Gold'/></bsdf>";
    fails(&in_sphere(metal), "3:55", &["no conductor is called 'Gold'"]);
    let glass = "<bsdf type='dielectric'><string name='int_ior' value='dimond'/></bsdf>";
    fails(&in_sphere(glass), "3:55", &["did you mean 'diamond'?"]);
    let mirror = "<bsdf type='twosided'><bsdf type='dielectric'/></bsdf>";
    fails(&in_sphere(mirror), "3:23", &["only BSDFs that no light goes through"]);
    let wrap = "<bsdf type='diffuse'><texture name='reflectance' type='bitmap'><string name='filename' value='a'/>\
                <string name='wrap_mode' value='tile'/></texture></bsdf>";
    fails(&in_sphere(wrap), "3:131", &["'wrap_mode' cannot be 'tile'", "repeat, mirror, clamp"]);
    fails("<shape type='obj'/>", "2:1", &["needs the parameter 'filename'"]);
}

#[test]
fn transformations_that_are_none() {
    let with = |inside: &str| format!("<shape type='sphere'><transform name='to_world'>\n{inside}</transform></shape>");
    fails(&with("<rotat angle='1'/>"), "3:1", &["<rotat> is no transformation", "did you mean 'rotate'?"]);
    fails(&with("<rotate angle='90'/>"), "3:1", &["a rotation needs an axis"]);
    fails(&with("<matrix value='1 2 3'/>"), "3:16", &["the matrix has 3 numbers; write 16 or 9"]);
    fails(&with("<lookat origin='0 0 0' target='0 1 0' up='0 1 0'/>"), "3:1", &["must not be parallel"]);
    fails(&with("<translate x='1' value='2'/>"), "3:25", &["not both"]);
    fails(&with("<scale x='0'/>"), "2:22", &["singular"]);
    fails(&with("<scale x='2'/>"), "2:22", &["use a mesh for an ellipsoid"]);
}

#[test]
fn references_to_nothing_or_in_a_circle() {
    fails(
        "<bsdf type='diffuse' id='white'/><shape type='disk'>\n<ref id='whit'/></shape>",
        "3:1",
        &["no object has the id 'whit'", "did you mean 'white'?"],
    );
    let circle = "<bsdf type='twosided' id='a'><ref id='b'/></bsdf>\n<bsdf type='twosided' id='b'><ref id='a'/></bsdf>";
    fails(circle, "2:1", &["bsdf 'a' contains itself"]);
    fails("<bsdf type='mask' id='a'><ref id='a'/></bsdf>", "2:1", &["contains itself"]);
    fails(
        "<bsdf type='diffuse' id='a'/>\n<bsdf type='diffuse' id='a'/>",
        "3:26",
        &["the id 'a' is taken", "a.xml:2:1"],
    );
    fails("<alias id='none' as='b'/>", "2:12", &["no object before this one has the id 'none'"]);
    let shared =
        "<shape type='disk'><ref id='l'/></shape><shape type='disk'><ref id='l'/></shape><emitter type='area' id='l'/>";
    fails(shared, "2:60", &["stands in two shapes"]);
    let mut deep = String::new();
    (0..100).for_each(|i| deep += &format!("<bsdf type='mask' id='b{i}'><ref id='b{}'/></bsdf>", i + 1));
    fails(&format!("{deep}<bsdf type='diffuse' id='b100'/>"), "2:3069", &["more than 64 deep"]);
}

#[test]
fn includes_in_a_circle_or_outside_the_folder() {
    fails("<include filename='a.xml'/>", "2:20", &["'a.xml' includes itself"]);
    fails("<include filename='../b.xml'/>", "2:20", &["'../b.xml' lies outside the scene's folder"]);
    fails("<include filename='/etc/passwd'/>", "2:20", &["'/etc/passwd' lies outside the scene's folder"]);
    fails("<include filename='b.xml'/>", "2:20", &["there is no file"]);
    let scene = |name: &str| format!("<scene version='3.0.0'><include filename='{name}'/></scene>");
    fails_with_files(
        &[("a.xml", scene("b.xml").as_bytes()), ("b.xml", scene("a.xml").as_bytes())],
        &["b.xml:1:43: 'a.xml' includes itself"],
    );
}

#[test]
fn files_outside_the_folder_are_refused() {
    let obj = |name: &str| format!("<shape type='obj'>\n<string name='filename' value='{name}'/></shape>");
    fails(&obj("../a.obj"), "3:32", &["lies outside the scene's folder", "copy the file there"]);
    fails(&obj("/tmp/a.obj"), "3:32", &["lies outside the scene's folder"]);
    fails(&obj("x/../../a.obj"), "3:32", &["lies outside the scene's folder"]);
    fails(&obj("b.obj"), "3:32", &["there is no file", "did you mean 'a.obj'?"]);
    fails(&obj(""), "3:32", &["a file needs a name"]);
}

#[test]
#[cfg(unix)]
fn links_and_special_files_are_refused() {
    let (folder, outside) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let xml = format!("<scene version='3.0.0'>{SHAPE}</scene>");
    write_files(folder.path(), &[("a.xml", xml.as_bytes())]);
    write_files(outside.path(), &[("a.obj", TRIANGLE_OBJ.as_bytes())]);
    let link = folder.path().join("a.obj");
    std::os::unix::fs::symlink(outside.path().join("a.obj"), &link).unwrap();
    let error = || load_with(&folder.path().join("a.xml"), &[]).unwrap_err().to_string();
    assert!(error().contains("leads outside the scene's folder"), "{}", error());
    std::fs::remove_file(&link).unwrap();
    std::fs::create_dir(&link).unwrap();
    assert!(error().contains("is not a file"), "{}", error());
    // A link within the folder, and an absolute path into it, are fine.
    std::fs::remove_dir(&link).unwrap();
    write_files(folder.path(), &[("meshes/b.obj", TRIANGLE_OBJ.as_bytes())]);
    std::os::unix::fs::symlink("meshes/b.obj", &link).unwrap();
    load_with(&folder.path().join("a.xml"), &[]).unwrap();
    let absolute = folder.path().join("meshes/b.obj");
    let xml = format!("<scene version='3.0.0'>{}</scene>", SHAPE.replace("a.obj", &absolute.display().to_string()));
    write_files(folder.path(), &[("b.xml", xml.as_bytes())]);
    load_with(&folder.path().join("b.xml"), &[]).unwrap();
}

#[test]
fn meshes_with_faults() {
    let xml = format!("<scene version='3.0.0'>{SHAPE}</scene>");
    for (obj, expected) in [
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "a.obj:4:1: this face refers to position 9"),
        ("v 0 0 nan\n", "a.obj:1:1: NaN is not a finite number"),
        ("v 0 0 0\n", "a.obj: this OBJ file has vertices but no faces"),
        ("", "a.obj: this OBJ file has no vertices and no faces"),
    ] {
        fails_with_files(&[("a.xml", xml.as_bytes()), ("a.obj", obj.as_bytes())], &[expected]);
    }
    let xml = xml.replace("obj", "ply");
    fails_with_files(&[("a.xml", xml.as_bytes()), ("a.ply", b"\x7fELF")], &["a.ply: this is no PLY file"]);
}

#[test]
fn an_image_that_is_none() {
    let inside = "<shape type='disk'><bsdf type='diffuse'><texture name='reflectance' type='bitmap'>\n\
                  <string name='filename' value='a.obj'/></texture></bsdf></shape>";
    fails(inside, "3:32", &["the image", "a.obj' is no image of a known kind; there are PNG, JPEG"]);
}

#[test]
fn films_and_samples_out_of_range() {
    let film = |inside: &str| format!("<sensor type='perspective'><film type='hdrfilm'>\n{inside}</film></sensor>");
    fails(&film("<integer name='width' value='0'/>"), "3:30", &["'width' is 0 pixels; it must be 1 to 65536"]);
    fails(&film("<integer name='height' value='65537'/>"), "3:31", &["it must be 1 to 65536"]);
    fails(&film("<integer name='height' value='-5'/>"), "3:31", &["it must be 1 to 65536"]);
    fails(&film("<integer name='crop_width' value='1000'/>"), "3:35", &["the film has only 768 here"]);
    fails(&film("<integer name='crop_offset_x' value='4294967295'/>"), "3:38", &["begins at 4294967295"]);
    fails(&film("<rfilter type='tent'><float name='radius' value='99'/></rfilter>"), "3:50", &["at most 16"]);
    let sampler = "<sensor type='perspective'><sampler type='independent'><integer name='sample_count' value='0'/></sampler></sensor>";
    fails(sampler, "2:92", &["0 samples a pixel make no picture"]);
    let scaled = "<sensor type='perspective'><transform name='to_world'><scale value='2'/></transform></sensor>";
    fails(scaled, "2:28", &["a camera cannot be scaled"]);
    fails("<sensor type='perspective'><float name='fov' value='180'/></sensor>", "2:53", &["between 0 and 180"]);
    fails(
        "<sensor type='perspective'><float name='far_clip' value='0.001'/></sensor>",
        "2:58",
        &["must be beyond near_clip"],
    );
    fails("<integrator type='path'><integer name='max_depth' value='0'/></integrator>", "2:58", &["-1 for no limit"]);
    fails("<integrator type='path'/>\n<integrator type='path'/>", "3:1", &["only one integrator"]);
}

#[test]
fn parameters_that_are_not_there() {
    fails(
        "<default name='res' value='1'/>\n<shape type='$rse'/>",
        "3:14",
        &["$rse has no value here; did you mean 'res'?", "-D rse=…"],
    );
    let scene = "<scene version='3.0.0'><default name='spp' value='1'/></scene>";
    let error = load_files(&[("a.xml", scene.as_bytes())], &[("ssp", "4")]).unwrap_err().to_string();
    assert!(error.contains("-D ssp: the scene has no $ssp; did you mean 'spp'?"), "{error}");
}

#[test]
fn the_report_shows_the_line() {
    let error =
        load_files(&[("a.xml", b"<scene version='3.0.0'>\n  <shape type='sphre'/>\n</scene>")], &[]).unwrap_err();
    let mut shown = String::new();
    let handler = miette::GraphicalReportHandler::new_themed(miette::GraphicalTheme::none()).with_width(400);
    handler.render_report(&mut shown, &error).unwrap();
    assert!(shown.contains("  <shape type='sphre'/>") && shown.contains("a.xml:2:16"), "{shown}");
}
