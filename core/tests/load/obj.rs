//! Bare OBJ files as scenes.

use crate::{TRIANGLE_OBJ, load_files};
use glam::{Vec2, Vec3};
use tilecast_core::load::Loaded;
use tilecast_core::scene::{Bsdf, BsdfId, Emitter, Scene, Sensor, Texture, TextureId};
use tilecast_core::settings::IntegratorKind;

const FACES: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";

/// A triangle of the material `m`, which `mtl` defines.
fn with_material(mtl: &str) -> Loaded {
    let obj = format!("mtllib a.mtl\nusemtl m\n{FACES}");
    let mtl = format!("newmtl m\n{mtl}\n");
    load_files(&[("a.obj", obj.as_bytes()), ("a.mtl", mtl.as_bytes())], &[]).unwrap_or_else(|e| panic!("{e}"))
}

fn bsdf(scene: &Scene, id: BsdfId) -> &Bsdf {
    &scene.bsdfs[id.0 as usize]
}

fn colour(scene: &Scene, id: TextureId) -> Vec3 {
    match scene.textures[id.0 as usize] {
        Texture::Constant(rgb) => rgb,
        ref other => panic!("{other:?} is no colour"),
    }
}

/// The front of a two-sided material.
fn front(loaded: &Loaded) -> &Bsdf {
    match *bsdf(&loaded.scene, loaded.scene.shapes[0].bsdf) {
        Bsdf::TwoSided { front, back } if front == back => bsdf(&loaded.scene, front),
        ref other => panic!("{other:?} is not two-sided"),
    }
}

#[test]
fn without_materials_it_is_grey_under_the_sky() {
    let loaded = load_files(&[("a.obj", TRIANGLE_OBJ.as_bytes())], &[]).unwrap();
    let Bsdf::Diffuse { reflectance } = *front(&loaded) else { panic!("not diffuse") };
    assert_eq!(colour(&loaded.scene, reflectance), Vec3::splat(0.5));
    assert_eq!(loaded.scene.emitters, [Emitter::Constant { radiance: Vec3::ONE }]);
    let settings = &loaded.settings;
    assert_eq!((settings.film.width, settings.film.height, settings.spp), (768, 512, 64));
    assert_eq!(settings.integrator.kind, IntegratorKind::Path);
    assert!(loaded.scene.meshes[0].normals.is_empty(), "flat");
}

#[test]
fn the_camera_sees_the_whole_box() {
    for obj in
        [TRIANGLE_OBJ, "v -50 0 -9\nv 70 1 0\nv 0 300 5\nf 1 2 3\n", "v 0 0 0\nv 1e-3 0 0\nv 0 0 1e-3\nf 1 2 3\n"]
    {
        let loaded = load_files(&[("a.obj", obj.as_bytes())], &[]).unwrap();
        let Sensor::Perspective { to_world, fov_degrees, near_clip, far_clip, .. } = loaded.scene.sensor else {
            panic!()
        };
        let to_camera = to_world.inverse();
        let tan_y = (fov_degrees.to_radians() / 2.0).tan();
        let mut largest = 0f32;
        for position in &loaded.scene.meshes[0].positions {
            let p = to_camera.transform_point3(*position);
            assert!(p.z > near_clip && p.z < far_clip);
            largest = largest.max(p.y.abs() / (p.z * tan_y)).max(p.x.abs() / (p.z * tan_y * 1.5));
        }
        assert!(largest <= 0.96 && largest > 0.3, "{largest}");
        assert!(to_world.matrix3.y_axis.y > 0.0, "upright");
    }
}

#[test]
fn highlights_keep_energy() {
    let loaded = with_material("Kd 0.8 0.4 0\nKs 0.8 0.8 0.8\nNs 50");
    let Bsdf::Phong { diffuse_reflectance, specular_reflectance, exponent } = *front(&loaded) else {
        panic!("no Phong")
    };
    let (kd, ks) = (colour(&loaded.scene, diffuse_reflectance), colour(&loaded.scene, specular_reflectance));
    assert_eq!((kd, ks, exponent), (Vec3::new(0.5, 0.25, 0.0), Vec3::splat(0.5), 50.0));
    assert!(matches!(front(&with_material("Ks 1 1 1\nNs 9\nillum 1")), Bsdf::Diffuse { .. }));
}

#[test]
fn emission_glass_and_masks() {
    let lamp = with_material("Ke 5 4 3");
    assert_eq!(colour(&lamp.scene, lamp.scene.shapes[0].radiance.unwrap()), Vec3::new(5.0, 4.0, 3.0));
    assert!(lamp.scene.emitters.is_empty(), "no sky where something shines");
    let glass = with_material("Ni 1.7\nillum 6\nTf 0.5 1 1");
    let Bsdf::Dielectric { eta, specular_transmittance, .. } = *bsdf(&glass.scene, glass.scene.shapes[0].bsdf) else {
        panic!("no glass")
    };
    assert_eq!((eta, colour(&glass.scene, specular_transmittance)), (1.7, Vec3::new(0.5, 1.0, 1.0)));
    for text in ["d 0.25", "Tr 0.75", "d 0.25\nillum 2\nNi 1.5"] {
        let mask = with_material(text);
        let Bsdf::Mask { opacity, .. } = *bsdf(&mask.scene, mask.scene.shapes[0].bsdf) else { panic!("no mask") };
        assert_eq!(colour(&mask.scene, opacity), Vec3::splat(0.25), "{text}");
    }
}

#[test]
fn maps_are_placed_from_the_bottom() {
    let mut png = std::io::Cursor::new(Vec::new());
    image::RgbImage::from_pixel(1, 1, image::Rgb([255, 0, 0])).write_to(&mut png, image::ImageFormat::Png).unwrap();
    let obj = format!("mtllib sub/a.mtl\nvt 0.25 0.125\nusemtl m\n{}", FACES.replace("f 1 2 3", "f 1/1 2/1 3/1"));
    let mtl = "newmtl m\nKd 0 0 0\nmap_Kd -s 2 3 -o 0.5 0.25 a b.png\n";
    let files: [(&str, &[u8]); 3] =
        [("a.obj", obj.as_bytes()), ("sub/a.mtl", mtl.as_bytes()), ("sub/a b.png", png.get_ref())];
    let loaded = load_files(&files, &[]).unwrap_or_else(|e| panic!("{e}"));
    let Bsdf::Diffuse { reflectance } = *front(&loaded) else { panic!("not diffuse") };
    let Texture::Bitmap { to_uv, scale, .. } = loaded.scene.textures[reflectance.0 as usize] else {
        panic!("no bitmap")
    };
    assert_eq!(scale, 1.0, "a black Kd beside a map is no factor");
    let uv = loaded.scene.meshes[0].uvs[0];
    assert_eq!(uv, Vec2::new(0.25, 0.875));
    // From the bottom: (0.25 · 2 + 0.5, 0.125 · 3 + 0.25) = (1, 0.625); from the top 1 − 0.625.
    assert!((to_uv.transform_point2(uv) - Vec2::new(1.0, 0.375)).length() < 1e-6);
}

#[test]
fn each_material_is_a_shape_in_the_order_of_use() {
    let obj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nusemtl b\nf 1 2 4\nusemtl a\nf 2 3 4\nusemtl b\nf 1 3 4\n";
    let loaded = load_files(&[("a.obj", obj.as_bytes())], &[]).unwrap();
    let shapes: Vec<(&str, usize)> = loaded
        .scene
        .shapes
        .iter()
        .zip(&loaded.scene.meshes)
        .map(|(shape, mesh)| (shape.name.as_str(), mesh.triangles.len()))
        .collect();
    assert_eq!(shapes, [("unnamed", 1), ("b", 2), ("a", 1)]);
}

#[test]
fn what_is_missing_is_noted_and_what_is_forbidden_refused() {
    let notes = |files: &[(&str, &[u8])]| -> String {
        load_files(files, &[]).unwrap().notes.iter().map(|note| format!("{note}\n")).collect()
    };
    let obj = format!("mtllib a.mtl\nusemtl rde\n{FACES}");
    assert!(notes(&[("a.obj", obj.as_bytes())]).contains("a.obj:1: there is no material file"));
    let with_library = notes(&[("a.obj", obj.as_bytes()), ("a.mtl", b"newmtl red\nPr 0.5\n")]);
    assert!(with_library.contains("a.obj:2: no material is called 'rde'; did you mean 'red'?"), "{with_library}");
    assert!(with_library.contains("a.mtl:2: 'Pr' of materials has no effect"), "{with_library}");
    let error = |files: &[(&str, &[u8])], defines: &[(&str, &str)]| load_files(files, defines).unwrap_err().to_string();
    let outside = format!("mtllib ../a.mtl\n{FACES}");
    assert!(error(&[("a.obj", outside.as_bytes())], &[]).contains("a.obj:1:1: '../a.mtl' lies outside"));
    let image = "newmtl rde\nmap_Kd none.png\n";
    let message = error(&[("a.obj", obj.as_bytes()), ("a.mtl", image.as_bytes())], &[]);
    assert!(message.contains("a.mtl:2:1: there is no file"), "{message}");
    assert!(error(&[("a.obj", FACES.as_bytes())], &[("spp", "4")]).contains("-D spp: an OBJ file has no $spp"));
}
