//! Emitters, sensors, filters and mesh files of Mitsuba scenes: parameters, defaults, errors. Numbers come from Mitsuba 3.9.1.

use crate::faults::fails;
use crate::load_files;
use crate::mitsuba::{colour, scene};
use glam::{Mat3, Vec3};
use tilecast_core::load::Loaded;
use tilecast_core::scene::{Emitter, Lens, Sensor};
use tilecast_core::settings::Filter;

/// A PNG of one colour, twice as wide as high.
fn png() -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::RgbImage::from_pixel(8, 4, image::Rgb([255, 0, 0])).write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

fn with_image(inside: &str) -> Loaded {
    let xml = format!("<scene version='3.0.0'>{inside}</scene>");
    load_files(&[("a.xml", xml.as_bytes()), ("a.png", &png())], &[]).unwrap_or_else(|e| panic!("{e}"))
}

#[test]
fn environment_maps() {
    let map =
        |inside: &str| format!("<emitter type='envmap'><string name='filename' value='a.png'/>{inside}</emitter>");
    let loaded = with_image(&map(""));
    assert_eq!(loaded.scene.emitters.len(), 1);
    let Emitter::Envmap { image, scale, to_world } = loaded.scene.emitters[0] else { panic!("no envmap") };
    assert_eq!((image.0, scale, to_world), (0, 1.0, Mat3::IDENTITY));
    assert_eq!(loaded.scene.brightest_radiance(), 1.0);
    let loaded = with_image(&map("<float name='scale' value='3'/>\
         <transform name='to_world'><rotate y='1' angle='90'/><scale value='2'/><translate x='5'/></transform>"));
    let Emitter::Envmap { scale, to_world, .. } = loaded.scene.emitters[0] else { panic!("no envmap") };
    assert!(scale == 3.0 && (to_world * Vec3::Z - Vec3::X).length() < 1e-6, "{to_world}");
    assert_eq!(loaded.scene.brightest_radiance(), 3.0);
    fails("<emitter type='envmap'/>", "2:1", &["needs the parameter 'filename'"]);
    fails(&map(""), "2:55", &["there is no file", "a.png"]);
    let stretched = "<transform name='to_world'><scale x='2'/></transform>";
    fails(&map(stretched), "2:63", &["cannot be sheared, nor scaled along one axis"]);
    fails(&format!("<emitter type='constant'/>\n{}", map("")), "3:1", &["only one light from beyond"]);
}

#[test]
fn spots() {
    let spot = |inside: &str| format!("<emitter type='spot'>{inside}</emitter>");
    let angles = |inside: &str| match scene(&spot(inside)).scene.emitters[0] {
        Emitter::Spot { cutoff_degrees, beam_width_degrees, intensity, texture: None, .. } => {
            assert_eq!(intensity, Vec3::ONE);
            [cutoff_degrees, beam_width_degrees]
        }
        ref other => panic!("{other:?}"),
    };
    assert_eq!(angles(""), [20.0, 15.0]);
    assert_eq!(angles("<float name='cutoff_angle' value='30'/>"), [30.0, 22.5]);
    assert_eq!(angles("<float name='beam_width' value='5'/>"), [20.0, 5.0]);
    let turned = "<transform name='to_world'><scale value='2'/><lookat origin='1 2 3' target='1 2 9' up='0 1 0'/></transform>\
                  <texture name='texture' type='checkerboard'/>";
    let loaded = scene(&spot(turned));
    let Emitter::Spot { to_world, texture, .. } = loaded.scene.emitters[0] else { panic!("no spot") };
    assert!(texture.is_some() && (to_world.matrix3 - Mat3::IDENTITY).abs_diff_eq(Mat3::ZERO, 1e-6));
    assert_eq!(to_world.translation, Vec3::new(1.0, 2.0, 3.0));
    fails(&spot("<float name='cutoff_angle' value='90'/>"), "2:56", &["below 90"]);
    fails(&spot("<float name='beam_width' value='21'/>"), "2:54", &["0 to cutoff_angle, 20"]);
    fails(&spot("<texture name='intensity' type='checkerboard'/>"), "2:22", &["the same everywhere"]);
}

#[test]
fn projectors_are_as_high_as_their_image() {
    let extent = |inside: &str| {
        let loaded = with_image(&format!("<emitter type='projector'>{inside}</emitter>"));
        let Emitter::Projector { half_extent, irradiance, .. } = loaded.scene.emitters[0] else {
            panic!("no projector")
        };
        (half_extent, loaded.scene.textures[irradiance.0 as usize].clone())
    };
    // Mitsuba: x_fov 34.0221° for a square, 56.3736° for 8×4 pixels of 30° up and down.
    let ([x, y], _) = extent("");
    assert!((x - 17.01105f32.to_radians().tan()).abs() < 1e-5 && x == y, "{x} {y}");
    let image = "<texture name='irradiance' type='bitmap'><string name='filename' value='a.png'/></texture>\
                 <float name='fov' value='30'/><string name='fov_axis' value='y'/>";
    let ([x, y], _) = extent(image);
    assert!((x - 28.1868f32.to_radians().tan()).abs() < 1e-5 && (x - 2.0 * y).abs() < 1e-6, "{x} {y}");
    let both =
        "<emitter type='projector'><float name='fov' value='30'/><string name='focal_length' value='50mm'/></emitter>";
    fails(both, "2:92", &["not both"]);
}

#[test]
fn lenses_and_parallel_rays() {
    let sensor = |kind: &str, inside: &str| format!("<sensor type='{kind}'>{inside}</sensor>");
    let lens = |inside: &str| match scene(&sensor("thinlens", inside)).scene.sensor {
        Sensor::Perspective { lens, .. } => lens,
        other => panic!("{other:?}"),
    };
    let radius = "<float name='aperture_radius' value='0.25'/>";
    assert_eq!(lens(radius), Some(Lens { aperture_radius: 0.25, focus_distance: 10000.0 }));
    let focused = format!("{radius}<float name='focus_distance' value='6'/>");
    assert_eq!(lens(&focused), Some(Lens { aperture_radius: 0.25, focus_distance: 6.0 }));
    fails(&sensor("thinlens", ""), "2:1", &["needs the parameter 'aperture_radius'"]);
    fails(&sensor("thinlens", "<float name='aperture_radius' value='0'/>"), "2:62", &["above 0"]);
    let scaled = "<transform name='to_world'><scale value='2'/></transform><float name='far_clip' value='7'/>";
    let Sensor::Orthographic { to_world, near_clip, far_clip } = scene(&sensor("orthographic", scaled)).scene.sensor
    else {
        panic!("not orthographic")
    };
    assert_eq!((to_world.matrix3, near_clip, far_clip), (Mat3::from_diagonal(Vec3::splat(2.0)), 0.01, 7.0));
    fails(&sensor("orthographic", "<float name='fov' value='2'/>"), "2:54", &["has no parameter 'fov'"]);
    fails(
        &sensor("thinlens", &format!("{radius}<transform name='to_world'><scale value='2'/></transform>")),
        "2:69",
        &["cannot be scaled"],
    );
}

#[test]
fn filters() {
    let film = |filter: &str| {
        format!("<sensor type='perspective'><film type='hdrfilm'>\n<rfilter type={filter}</rfilter></film></sensor>")
    };
    let filter = |filter: &str| scene(&film(filter)).settings.film.filter;
    assert_eq!(filter("'mitchell'>"), Filter::Mitchell { b: 1.0 / 3.0, c: 1.0 / 3.0 });
    let other = "'mitchell'><float name='B' value='0.25'/><float name='C' value='0.5'/>";
    assert_eq!(filter(other), Filter::Mitchell { b: 0.25, c: 0.5 });
    assert_eq!(filter("'catmullrom'>"), Filter::CatmullRom);
    assert_eq!(filter("'lanczos'>"), Filter::Lanczos { lobes: 3.0 });
    assert_eq!(filter("'lanczos'><integer name='lobes' value='2'/>"), Filter::Lanczos { lobes: 2.0 });
    fails(&film("'lanczos'><integer name='lobes' value='99'/>"), "3:54", &["at most 16"]);
    fails(&film("'lanczos'><float name='lobes' value='2'/>"), "3:52", &["takes an integer"]);
    fails(&film("'mitchell'><float name='B' value='2'/>"), "3:49", &["between 0 and 1"]);
}

#[test]
fn a_light_of_one_colour_may_be_a_spectrum_object() {
    let loaded =
        scene("<shape type='disk'><emitter type='area'><spectrum name='radiance' type='d65'/></emitter></shape>");
    assert_eq!(colour(&loaded.scene, loaded.scene.shapes[0].radiance.unwrap()), Vec3::ONE);
}

#[test]
fn serialized_meshes_that_are_none() {
    let shape = "<shape type='serialized'><string name='filename' value='a.ply'/></shape>";
    fails(shape, "2:57", &["a.ply", "no serialized mesh of Mitsuba's"]);
    fails("<shape type='serialized'/>", "2:1", &["needs the parameter 'filename'"]);
}
