//! Shapegroups, instances, cylinders and mesh attributes of Mitsuba scenes.

use crate::faults::fails;
use crate::mitsuba::{bsdf, scene};
use crate::{load_files, load_scene};
use glam::Vec3;
use tilecast_core::scene::{AttributeValues, Bsdf, Geometry, Texture};

const GROUP: &str = "<shape type='shapegroup' id='g'><shape type='sphere'/>\
                     <shape type='obj'><string name='filename' value='a.obj'/></shape></shape>";

#[test]
fn groups_are_kept_once_and_placed_often() {
    let loaded = scene(&format!(
        "{GROUP}<shape type='instance'><ref id='g'/></shape><shape type='instance'><ref id='g'/>\
         <transform name='to_world'><translate x='5'/></transform></shape>"
    ));
    let scene = &loaded.scene;
    assert_eq!((scene.shapes.len(), scene.groups.len(), scene.groups[0].shapes.len()), (0, 1, 2));
    assert_eq!((scene.meshes.len(), scene.instances.len()), (1, 2));
    let apart = scene.instances[1].to_world.translation - scene.instances[0].to_world.translation;
    assert_eq!(apart, Vec3::new(5.0, 0.0, 0.0));
    let (min, max) = scene.bounds().unwrap();
    assert_eq!(max - min, Vec3::new(7.0, 2.0, 2.0));
    // A group that no instance places is nowhere, and said to be.
    let loaded = load_scene(&format!("{GROUP}<shape type='sphere'/>")).unwrap();
    assert_eq!((loaded.scene.groups.len(), loaded.scene.shapes.len()), (0, 1));
    assert!(loaded.notes.iter().any(|note| note.text.contains("'g'") && note.text.contains("not used")));
}

#[test]
fn what_cannot_be_instanced() {
    let placed = |inside: &str| {
        format!("<shape type='shapegroup' id='g'>\n{inside}\n</shape><shape type='instance'><ref id='g'/></shape>")
    };
    fails(&placed("<shape type='sphere'><emitter type='area'/></shape>"), "3:22", &["lights cannot be instanced"]);
    let nested = "<shape type='shapegroup'><shape type='sphere'/></shape>";
    fails(&placed(nested), "3:1", &["neither instances nor other groups"]);
    fails(&placed(""), "2:1", &["this shapegroup is empty"]);
    fails("<shape type='instance'/>", "2:1", &["an instance needs a shapegroup"]);
    fails("<shape type='instance'><shape type='sphere'/></shape>", "2:1", &["an instance needs a shapegroup"]);
}

#[test]
fn cylinders_by_their_axis() {
    let loaded = scene(
        "<shape type='cylinder'><point name='p0' value='1, 2, 3'/><point name='p1' value='1, 6, 3'/>\
         <float name='radius' value='0.5'/></shape>",
    );
    let Geometry::Cylinder { to_world, flip_normals: false } = loaded.scene.shapes[0].geometry else {
        panic!("no cylinder")
    };
    assert_eq!(to_world.matrix3.z_axis, Vec3::new(0.0, 4.0, 0.0));
    assert!((to_world.matrix3.x_axis.length() - 0.5).abs() < 1e-6);
    let (min, max) = loaded.scene.bounds().unwrap();
    assert!((max - min - Vec3::new(1.0, 4.0, 1.0)).length() < 1e-5);
    let same = "<shape type='cylinder'>\n<point name='p1' value='0, 0, 0'/></shape>";
    fails(same, "3:25", &["'p0' and 'p1' are the same point"]);
}

const COLOURED: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
    property float r\nproperty float g\nproperty float b\nproperty float heat_x\nelement face 2\n\
    property list uchar int vertex_indices\nproperty float id_1\nproperty float id_2\nproperty float id_3\nend_header\n\
    0 0 0 .1 .2 .3 7\n1 0 0 .4 .5 .6 8\n1 1 0 1 1 1 9\n0 1 0 0 0 0 10\n4 0 1 2 3 .5 .25 0\n3 0 1 0 1 1 1\n";

fn attribute(texture: &str, parameter: &str, kind: &str) -> Result<tilecast_core::load::Loaded, String> {
    let scene = format!(
        "<scene version='3.0.0'>\n<shape type='ply'><string name='filename' value='c.ply'/><bsdf type='{kind}'>\
         <texture type='mesh_attribute' name='{parameter}'>\n{texture}</texture></bsdf></shape></scene>"
    );
    load_files(&[("a.xml", scene.as_bytes()), ("c.ply", COLOURED.as_bytes())], &[]).map_err(|e| e.to_string())
}

/// Values of vertices and faces; a face's go to each of its triangles that is left.
#[test]
fn attributes_of_meshes() {
    let loaded = attribute(
        "<string name='name' value='vertex_color'/><float name='scale' value='0.5'/>",
        "reflectance",
        "diffuse",
    );
    let loaded = loaded.unwrap();
    let Bsdf::Diffuse { reflectance } = *bsdf(&loaded) else { panic!("not diffuse") };
    let texture = &loaded.scene.textures[reflectance.0 as usize];
    assert_eq!(*texture, Texture::MeshAttribute { name: "vertex_color".into(), scale: 0.5 });
    let attributes = &loaded.scene.meshes[0].attributes;
    let AttributeValues::Colours(colours) = &attributes[0].values else { panic!("no colours") };
    assert_eq!((attributes.len(), colours.len(), colours[1]), (1, 4, Vec3::new(0.4, 0.5, 0.6)));

    let loaded = attribute("<string name='name' value='face_id'/>", "reflectance", "diffuse").unwrap();
    let attribute_of_faces = &loaded.scene.meshes[0].attributes[0];
    let AttributeValues::Colours(colours) = &attribute_of_faces.values else { panic!("no colours") };
    assert_eq!(colours[..], [Vec3::new(0.5, 0.25, 0.0); 2], "the third triangle has no area");

    let loaded = attribute("<string name='name' value='vertex_heat'/>", "alpha", "roughconductor").unwrap();
    let scalars = AttributeValues::Scalars(vec![7.0, 8.0, 9.0, 10.0]);
    assert_eq!(loaded.scene.meshes[0].attributes[0].values, scalars);
}

#[test]
fn attributes_that_are_not_there() {
    let fault = |name: &str, parameter, kind| {
        attribute(&format!("<string name='name' value='{name}'/>"), parameter, kind).unwrap_err()
    };
    let message = fault("vertex_colour", "reflectance", "diffuse");
    assert!(message.contains("a.xml:3:") && message.contains("did you mean 'vertex_color'?"), "{message}");
    let message = fault("color", "reflectance", "diffuse");
    assert!(message.contains("must begin with vertex_ or face_"), "{message}");
    let message = fault("vertex_color", "alpha", "roughconductor");
    assert!(message.contains("has three numbers; here one is wanted"), "{message}");
    let on_sphere = "<shape type='sphere' id='ball'><bsdf type='diffuse'><texture type='mesh_attribute' name='reflectance'>\
                     <string name='name' value='vertex_color'/></texture></bsdf></shape>";
    let scene = format!(
        "<scene version='3.0.0'>{on_sphere}<shape type='ply'><string name='filename' value='c.ply'/></shape></scene>"
    );
    let error =
        load_files(&[("a.xml", scene.as_bytes()), ("c.ply", COLOURED.as_bytes())], &[]).unwrap_err().to_string();
    assert!(error.contains("shape 'ball': a texture on it shows the attribute 'vertex_color'"), "{error}");
}
