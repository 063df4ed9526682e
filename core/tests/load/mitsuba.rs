//! What Mitsuba scenes become. Numbers come from Mitsuba 3.9.1 (scalar_rgb) where they are not plain arithmetic.

use crate::{TRIANGLE_OBJ, load_files, load_scene};
use glam::{Affine3, Vec2, Vec3};
use tilecast_core::load::mitsuba::plugins;
use tilecast_core::load::{Loaded, mitsuba::Tag};
use tilecast_core::scene::{
    Bsdf, Emitter, FilterType, FovAxis, Geometry, Mesh, Scene, Sensor, Texels, Texture, TextureId, WrapMode,
};
use tilecast_core::settings::{Filter, IntegratorKind, Strategy, Window};

pub fn scene(inside: &str) -> Loaded {
    load_scene(inside).unwrap_or_else(|e| panic!("{e}"))
}

pub fn colour(scene: &Scene, id: TextureId) -> Vec3 {
    match scene.textures[id.0 as usize] {
        Texture::Constant(rgb) => rgb,
        ref other => panic!("{other:?} is no colour"),
    }
}

pub fn bsdf(loaded: &Loaded) -> &Bsdf {
    &loaded.scene.bsdfs[loaded.scene.shapes[0].bsdf.0 as usize]
}

fn reflectance(bsdf: &str) -> Vec3 {
    let loaded = scene(&format!("<shape type='rectangle'><bsdf type='diffuse'>{bsdf}</bsdf></shape>"));
    let Bsdf::Diffuse { reflectance } = *self::bsdf(&loaded) else { panic!("not diffuse") };
    colour(&loaded.scene, reflectance)
}

fn radiance(emitter: &str) -> Vec3 {
    let loaded = scene(&format!("<shape type='rectangle'><emitter type='area'>{emitter}</emitter></shape>"));
    colour(&loaded.scene, loaded.scene.shapes[0].radiance.unwrap())
}

pub fn assert_near(actual: Vec3, expected: [f32; 3]) {
    let error = (actual - Vec3::from(expected)).abs().max_element();
    assert!(error <= 2e-6 * Vec3::from(expected).abs().max_element().max(1.0), "{actual} is not {expected:?}");
}

#[test]
fn colours_and_spectra_have_mitsubas_values() {
    assert_near(reflectance(""), [0.5; 3]);
    assert_near(reflectance("<rgb name='reflectance' value='0.1, 0.2 0.3'/>"), [0.1, 0.2, 0.3]);
    assert_near(reflectance("<float name='reflectance' value='1.5'/>"), [1.5; 3]);
    assert_near(reflectance("<integer name='reflectance' value='1'/>"), [1.0; 3]);
    assert_near(reflectance("<spectrum name='reflectance' value='0.3'/>"), [0.3; 3]);
    assert_near(
        reflectance("<spectrum name='reflectance' value='400:0.5 700:0.6'/>"),
        [0.57808584, 0.54752374, 0.51105875],
    );
    // Beyond 1 a reflectance is cut.
    assert_near(reflectance("<spectrum name='reflectance' value='400:1.5,700:1.5'/>"), [1.0; 3]);
    assert_near(radiance(""), [1.0; 3]);
    assert_near(radiance("<rgb name='radiance' value='2'/>"), [2.0; 3]);
    assert_near(radiance("<spectrum name='radiance' value='2'/>"), [2.4095879, 1.896582, 1.8178321]);
    assert_near(radiance("<spectrum name='radiance' value='400:2,700:2'/>"), [2.3993871, 1.8990407, 1.8068867]);
}

#[test]
fn a_spectrum_file_is_read() {
    let xml = "<scene version='3.0.0'><shape type='rectangle'><bsdf type='diffuse'>\
               <spectrum name='reflectance' filename='a.spd'/></bsdf></shape></scene>";
    let loaded = load_files(&[("a.xml", xml.as_bytes()), ("a.spd", b"# nm\n400 0.5\n700 0.6\n")], &[]).unwrap();
    let Bsdf::Diffuse { reflectance } = *bsdf(&loaded) else { panic!("not diffuse") };
    assert_near(colour(&loaded.scene, reflectance), [0.57808584, 0.54752374, 0.51105875]);
}

#[test]
fn metals_and_glass_have_their_indices() {
    let conductor = |inside: &str| {
        let loaded = scene(&format!("<shape type='rectangle'><bsdf type='conductor'>{inside}</bsdf></shape>"));
        let Bsdf::Conductor { eta, k, .. } = *bsdf(&loaded) else { panic!("no conductor") };
        (colour(&loaded.scene, eta), colour(&loaded.scene, k))
    };
    let (eta, k) = conductor("<string name='material' value='Au'/>");
    assert_near(eta, [0.14303598, 0.37530708, 1.4420453]);
    assert_near(k, [3.982997, 2.3855565, 1.6033592]);
    let (eta, k) = conductor("");
    assert_near(eta, [0.0; 3]);
    assert_near(k, [1.0; 3]);
    let (eta, _) = conductor("<spectrum name='eta' value='400:2,500:1,700:3'/>");
    assert_near(eta, [2.4693122, 1.3522844, 1.4387721]);
    for (inside, expected) in [
        ("", 1.5041833),
        ("<float name='int_ior' value='1.5'/>", 1.4995846),
        ("<string name='int_ior' value='diamond'/><string name='ext_ior' value='water'/>", 1.8147037),
        ("<string name='int_ior' value='BK7'/>", 1.5041833),
    ] {
        let loaded = scene(&format!("<shape type='sphere'><bsdf type='dielectric'>{inside}</bsdf></shape>"));
        let Bsdf::Dielectric { eta, .. } = *bsdf(&loaded) else { panic!("no dielectric") };
        assert!((eta - expected).abs() < 1e-6, "{eta} is not {expected}");
    }
}

#[test]
fn a_shape_without_bsdf_is_grey_or_black() {
    let albedo = |inside: &str| {
        let loaded = scene(&format!("<shape type='rectangle'>{inside}</shape>"));
        let Bsdf::Diffuse { reflectance } = *bsdf(&loaded) else { panic!("not diffuse") };
        colour(&loaded.scene, reflectance)
    };
    assert_eq!(albedo(""), Vec3::splat(0.5));
    assert_eq!(albedo("<emitter type='area'/>"), Vec3::ZERO);
}

/// The sphere's `to_world` and the sensor's are where transformations come out unchanged.
fn placed(transform: &str) -> (Affine3, [f64; 3]) {
    let loaded = scene(&format!("<shape type='disk'><transform name='to_world'>{transform}</transform></shape>"));
    let Geometry::Disk { to_world, .. } = loaded.scene.shapes[0].geometry else { panic!("no disk") };
    (to_world, loaded.scene.origin)
}

#[test]
fn transformations_compose_as_mitsubas() {
    let rows = |(to_world, origin): (Affine3, [f64; 3])| {
        let m = to_world.matrix3.transpose();
        let t = to_world.translation + Vec3::from(origin.map(|x| x as f32));
        [m.x_axis.extend(t.x), m.y_axis.extend(t.y), m.z_axis.extend(t.z)]
    };
    for (transform, expected) in [
        (
            "<lookat origin='1 2 3' target='4 -5 6' up='0 1 0'/>",
            [
                [0.70710677, 0.6047079, 0.36650833, 1.0],
                [0.0, 0.51832104, -0.8551861, 2.0],
                [-0.70710677, 0.6047079, 0.36650833, 3.0],
            ],
        ),
        (
            "<lookat origin='1, 2, 3' target='4, -5, 6'/>",
            [
                [-0.22936767, 0.90169954, 0.36650833, 1.0],
                [-0.46480876, 0.22936767, -0.8551861, 2.0],
                [-0.8551861, -0.36650833, 0.36650833, 3.0],
            ],
        ),
        (
            "<rotate x='1' y='2' z='3' angle='30'/>",
            [
                [1.0, -1.2320508, 1.4019238, 0.0],
                [1.7679492, 1.4019238, 0.30384758, 0.0],
                [-0.5980762, 1.3038475, 2.0717967, 0.0],
            ],
        ),
        (
            "<translate x='1' y='2'/><rotate z='1' angle='90'/><scale x='2'/><matrix value='1 2 3 4 5 6 7 8 10'/>",
            [[2.0, -2.0, 3.0, -2.0], [5.0, -8.0, 6.0, -11.0], [8.0, -14.0, 10.0, -20.0]],
        ),
        (
            "<matrix value='1 0 0 4  0 2 0 5  0 0 3 6  0 0 0 1'/><scale value='2'/>",
            [[2.0, 0.0, 0.0, 8.0], [0.0, 4.0, 0.0, 10.0], [0.0, 0.0, 6.0, 12.0]],
        ),
    ] {
        for (row, expected) in rows(placed(transform)).iter().zip(expected) {
            assert!(
                (*row - glam::Vec4::from(expected)).abs().max_element() < 4e-6,
                "{transform}: {row} is not {expected:?}"
            );
        }
    }
}

#[test]
fn a_mirrored_sphere_is_turned_inside_out() {
    let sphere = |transform: &str, flip: bool| {
        let loaded = scene(&format!(
            "<shape type='sphere'><point name='center' x='1' y='2' z='3'/><float name='radius' value='2'/>\
             <boolean name='flip_normals' value='{flip}'/><transform name='to_world'>{transform}</transform></shape>"
        ));
        let Geometry::Sphere { to_world, flip_normals } = loaded.scene.shapes[0].geometry else { panic!("no sphere") };
        (to_world, loaded.scene.origin, flip_normals)
    };
    let (to_world, origin, flipped) = sphere("<translate x='1'/><rotate y='1' angle='90'/><scale value='3'/>", false);
    assert!((glam::DVec3::from(origin) - glam::DVec3::new(9.0, 6.0, -6.0)).length() < 1e-12, "{origin:?}");
    assert!((to_world.matrix3.z_axis - 6.0 * Vec3::X).length() < 1e-6 && to_world.translation == Vec3::ZERO);
    assert!(!flipped);
    let mirror = "<scale x='-1' y='-1' z='-1'/>";
    assert!(sphere(mirror, false).2 && !sphere(mirror, true).2);
}

fn mesh(loaded: &Loaded) -> &Mesh {
    &loaded.scene.meshes[0]
}

#[test]
fn meshes_are_centred_in_f64() {
    let xml = "<scene version='3.0.0'><shape type='obj'><string name='filename' value='a.obj'/>\
               <transform name='to_world'><translate x='0.5'/></transform></shape></scene>";
    let obj = "v 1000000000 0 0\nv 1000000000.001 0 0\nv 1000000000 0.001 0\nf 1 2 3\n";
    let loaded = load_files(&[("a.xml", xml.as_bytes()), ("a.obj", obj.as_bytes())], &[]).unwrap();
    assert_eq!(loaded.scene.origin, [1000000000.5005, 0.0005, 0.0]);
    assert!((mesh(&loaded).positions[1].x - 0.0005).abs() < 1e-7, "{:?}", mesh(&loaded).positions);
}

#[test]
fn obj_and_ply_have_their_own_defaults_for_texture_coordinates() {
    let obj = format!("{TRIANGLE_OBJ}vt 0.1 0.2\nf 1/1 2/1 3/1\n");
    let ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nproperty float u\n\
               property float v\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0 .1 .2\n1 0 0 .1 .2\n\
               0 1 0 .1 .2\n3 0 1 2\n";
    for (kind, flip, expected) in [("obj", "", 0.8), ("ply", "", 0.2), ("obj", "false", 0.2), ("ply", "true", 0.8)] {
        let flip = match flip {
            "" => String::new(),
            flip => format!("<boolean name='flip_tex_coords' value='{flip}'/>"),
        };
        let xml = format!(
            "<scene version='3.0.0'><shape type='{kind}'><string name='filename' value='a.{kind}'/>{flip}</shape></scene>"
        );
        let loaded =
            load_files(&[("a.xml", xml.as_bytes()), ("a.obj", obj.as_bytes()), ("a.ply", ply.as_bytes())], &[])
                .unwrap();
        let uv = *mesh(&loaded).uvs.last().unwrap();
        assert!((uv - Vec2::new(0.1, expected)).length() < 1e-6, "{kind} {flip}: {uv}");
    }
}

#[test]
fn normals_follow_face_normals_and_flip_normals() {
    let with = |inside: &str| {
        scene(&format!("<shape type='obj'><string name='filename' value='a.obj'/>{inside}</shape>")).scene.meshes[0]
            .clone()
    };
    assert_eq!(with("").normals, [Vec3::Z; 3]);
    assert!(with("<boolean name='face_normals' value='true'/>").normals.is_empty());
    let flipped = with("<boolean name='flip_normals' value='true'/>");
    assert_eq!((flipped.normals[0], flipped.triangles[0]), (Vec3::NEG_Z, [0, 2, 1]));
}

#[test]
fn the_sensor_with_film_filter_and_sampler() {
    let loaded = scene(
        "<sensor type='perspective'><float name='fov' value='30'/><string name='fov_axis' value='diagonal'/>\
         <film type='hdrfilm'><integer name='width' value='100'/><integer name='height' value='50'/>\
         <integer name='crop_offset_x' value='10'/><integer name='crop_width' value='20'/><rfilter type='tent'/></film>\
         <sampler type='stratified'><integer name='sample_count' value='16'/></sampler></sensor>",
    );
    let Sensor::Perspective { fov_degrees, fov_axis, near_clip, far_clip, .. } = loaded.scene.sensor else {
        panic!("no perspective")
    };
    assert_eq!((fov_degrees, fov_axis, near_clip, far_clip), (30.0, FovAxis::Diagonal, 0.01, 10000.0));
    let film = &loaded.settings.film;
    assert_eq!((film.width, film.height, film.crop), (100, 50, Window { x0: 10, y0: 0, x1: 30, y1: 50 }));
    assert_eq!((film.filter, loaded.settings.spp), (Filter::Tent { radius: 1.0 }, 16));
    let notes: Vec<String> = loaded.notes.iter().map(ToString::to_string).collect();
    assert!(notes.iter().any(|note| note.contains("a.xml:2:") && note.contains("stratified")), "{notes:?}");
}

#[test]
fn a_sensor_without_anything_has_mitsubas_defaults() {
    let loaded = scene("<sensor type='perspective'/>");
    let Sensor::Perspective { fov_degrees, fov_axis, .. } = loaded.scene.sensor else { panic!("no perspective") };
    // 50 mm on the diagonal of 36 × 24 mm; Mitsuba says 38.1848° for the width of 768 × 576.
    assert_eq!(fov_axis, FovAxis::Diagonal);
    let half_width = (fov_degrees.to_radians() / 2.0).tan() * 0.8;
    assert!((2.0 * half_width.atan().to_degrees() - 38.1848).abs() < 1e-4, "{fov_degrees}");
    let film = &loaded.settings.film;
    assert_eq!((film.width, film.height, film.filter), (768, 576, Filter::Gaussian { stddev: 0.5 }));
    assert_eq!((loaded.settings.spp, loaded.settings.integrator.kind), (4, IntegratorKind::Path));
}

#[test]
fn integrators_say_what_is_estimated() {
    let settings = |inside: &str| scene(&format!("<integrator type={inside}</integrator>")).settings;
    let path = settings("'path'><integer name='max_depth' value='6'/><boolean name='hide_emitters' value='true'/>");
    assert_eq!((path.integrator.max_depth, path.integrator.rr_depth), (Some(6), 5));
    assert!(path.integrator.hide_emitters);
    assert_eq!(settings("'path'><integer name='max_depth' value='-1'/>").integrator.max_depth, None);
    assert_eq!(settings("'whitted'>").integrator.kind, IntegratorKind::Whitted);
    assert_eq!(settings("'direct'>").strategy, Strategy::Mis);
    assert_eq!(settings("'direct'><integer name='bsdf_samples' value='0'/>").strategy, Strategy::Light);
    assert_eq!(settings("'direct'><integer name='emitter_samples' value='0'/>").strategy, Strategy::Bsdf);
}

#[test]
fn lights_without_surfaces() {
    let loaded = scene(
        "<emitter type='constant'><rgb name='radiance' value='1 2 3'/></emitter>\
         <emitter type='point'><point name='position' value='1 2 3'/><rgb name='intensity' value='4'/></emitter>\
         <emitter type='point'><transform name='to_world'><translate z='5'/></transform></emitter>\
         <emitter type='directional'><vector name='direction' x='0' y='0' z='-2'/></emitter>\
         <shape type='rectangle'><transform name='to_world'><translate x='1'/></transform></shape>",
    );
    assert_eq!(loaded.scene.origin, [1.0, 0.0, 0.0]);
    assert_eq!(
        loaded.scene.emitters,
        [
            Emitter::Constant { radiance: Vec3::new(1.0, 2.0, 3.0) },
            Emitter::Point { position: Vec3::new(0.0, 2.0, 3.0), intensity: Vec3::splat(4.0) },
            Emitter::Point { position: Vec3::new(-1.0, 0.0, 5.0), intensity: Vec3::ONE },
            Emitter::Directional { direction: Vec3::NEG_Z, irradiance: Vec3::ONE },
        ]
    );
    // A point of intensity 4 a thousandth of the radius (√2) away is brighter than all others.
    let brightest = 4.0 / (1e-3 * 2f32.sqrt()).powi(2);
    assert!((loaded.scene.brightest_radiance() / brightest - 1.0).abs() < 1e-5);
    assert_eq!(loaded.settings.scale_exponent, tilecast_core::film::scale_exponent(brightest));
}

#[test]
fn textures_masks_and_two_sides() {
    let mut png = std::io::Cursor::new(Vec::new());
    image::RgbImage::from_pixel(1, 1, image::Rgb([255, 0, 0])).write_to(&mut png, image::ImageFormat::Png).unwrap();
    let xml = "<scene version='3.0.0'><texture type='bitmap' id='t'><string name='filename' value='textures/a.png'/>\
               <string name='filter_type' value='nearest'/><string name='wrap_mode' value='clamp'/>\
               <transform name='to_uv'><scale x='2'/><translate y='0.5'/></transform></texture>\
               <shape type='rectangle'><bsdf type='mask'><ref name='opacity' id='t'/>\
               <bsdf type='twosided'><bsdf type='diffuse'><ref name='reflectance' id='t'/></bsdf><bsdf type='diffuse'/></bsdf>\
               </bsdf></shape></scene>";
    let loaded = load_files(&[("a.xml", xml.as_bytes()), ("textures/a.png", png.get_ref())], &[]).unwrap();
    let scene = &loaded.scene;
    let Bsdf::Mask { opacity, nested } = *bsdf(&loaded) else { panic!("no mask") };
    let Bsdf::TwoSided { front, back } = scene.bsdfs[nested.0 as usize] else { panic!("not two-sided") };
    assert_ne!(front, back);
    let Texture::Bitmap { image, to_uv, filter, wrap, .. } = scene.textures[opacity.0 as usize] else {
        panic!("no bitmap")
    };
    assert_eq!((filter, wrap), (FilterType::Nearest, WrapMode::Clamp));
    assert_eq!(to_uv.transform_point2(Vec2::new(0.25, 0.25)), Vec2::new(0.5, 0.75));
    // As a number the red pixel is its luminance, as a colour it stays red: two images of one file.
    assert_eq!(scene.images.len(), 2);
    assert!(matches!(&scene.images[image.0 as usize].texels, Texels::Grey32(v) if (v[0] - 0.212671).abs() < 1e-6));
}

#[test]
fn a_checkerboard_as_a_number_has_mitsubas_swapped_colours() {
    let boards = "<texture type='checkerboard' id='t'><float name='color0' value='1'/><float name='color1' value='0'/></texture>";
    let loaded = scene(&format!(
        "{boards}<shape type='rectangle'><bsdf type='mask'><ref name='opacity' id='t'/><bsdf type='diffuse'>\
         <ref name='reflectance' id='t'/></bsdf></bsdf></shape>"
    ));
    let Bsdf::Mask { opacity, .. } = *bsdf(&loaded) else { panic!("no mask") };
    let Texture::Checkerboard { color0, .. } = loaded.scene.textures[opacity.0 as usize] else { panic!("no board") };
    assert_eq!(colour(&loaded.scene, color0), Vec3::ZERO);
}

#[test]
fn old_files_are_upgraded() {
    let xml = "<scene version='0.6.0'><sensor type='perspective'><string name='fovAxis' value='smaller'/>\
               <float name='fov' value='28'/><transform name='toWorld'><translate z='-5'/></transform>\
               <sampler type='independent'><integer name='sampleCount' value='16'/></sampler></sensor>\
               <shape type='rectangle'><bsdf type='diffuse'><texture type='checkerboard' name='diffuseReflectance'>\
               <float name='uscale' value='4'/><float name='voffset' value='0.5'/></texture></bsdf></shape></scene>";
    let loaded = load_files(&[("a.xml", xml.as_bytes())], &[]).unwrap();
    assert_eq!(loaded.settings.spp, 16);
    let Bsdf::Diffuse { reflectance } = *bsdf(&loaded) else { panic!("not diffuse") };
    let Texture::Checkerboard { to_uv, .. } = loaded.scene.textures[reflectance.0 as usize] else { panic!("no board") };
    assert_eq!(to_uv.transform_point2(Vec2::ZERO), Vec2::new(0.0, 0.5));
    assert_eq!(to_uv.transform_point2(Vec2::ONE), Vec2::new(4.0, 1.5));
}

#[test]
fn includes_defaults_aliases_and_paths() {
    let main = "<scene version='3.0.0'><default name='kind' value='obj'/><path value='meshes'/>\
                <include filename='parts/materials.xml'/>\
                <shape type='$kind'><string name='filename' value='a.$kind'/><ref id='dark'/></shape></scene>";
    let materials = "<scene version='3.0.0'><include filename='red.xml'/><alias id='red' as='dark'/></scene>";
    let red = "<bsdf version='3.0.0' type='diffuse' id='red'><rgb name='reflectance' value='$red 0 0'/></bsdf>";
    let files: [(&str, &[u8]); 4] = [
        ("a.xml", main.as_bytes()),
        ("parts/materials.xml", materials.as_bytes()),
        ("parts/red.xml", red.as_bytes()),
        ("meshes/a.obj", TRIANGLE_OBJ.as_bytes()),
    ];
    let loaded = load_files(&files, &[("red", "0.25")]).unwrap_or_else(|e| panic!("{e}"));
    let Bsdf::Diffuse { reflectance } = *bsdf(&loaded) else { panic!("not diffuse") };
    assert_eq!(colour(&loaded.scene, reflectance), Vec3::new(0.25, 0.0, 0.0));
    assert_eq!(mesh(&loaded).triangles.len(), 1);
}

#[test]
fn only_what_is_used_is_loaded_and_the_rest_is_noted() {
    let loaded = scene(
        "<bsdf type='diffuse' id='spare'><texture type='bitmap' name='reflectance'>\
         <string name='filename' value='missing.png'/></texture></bsdf>\
         <bsdf type='hair' id='unsupported'/>\
         <shape type='obj'><string name='filename' value='a.obj'/></shape>\
         <shape type='obj'><string name='filename' value='a.obj'/></shape>",
    );
    let notes: Vec<String> = loaded.notes.iter().map(ToString::to_string).collect();
    assert!(notes.iter().any(|note| note.contains("bsdf 'spare' is not used")), "{notes:?}");
    assert!(notes.iter().any(|note| note.contains("bsdf 'unsupported' is not used")), "{notes:?}");
}

#[test]
fn parameters_without_effect_are_noted_unless_they_say_nothing() {
    let loaded = scene(
        "<sensor type='perspective'>\n<float name='focus_distance' value='6'/><film type='hdrfilm'>\
         <string name='pixel_format' value='rgb'/>\n<string name='component_format' value='float32'/></film></sensor>",
    );
    let notes: Vec<String> = loaded.notes.iter().map(ToString::to_string).collect();
    assert!(notes.iter().any(|note| note.contains("a.xml:3: 'focus_distance' of sensor")), "{notes:?}");
    assert!(notes.iter().any(|note| note.contains("a.xml:4: 'component_format' of film")), "{notes:?}");
    assert!(!notes.iter().any(|note| note.contains("pixel_format")), "{notes:?}");
}

#[test]
fn degenerate_triangles_are_counted_in_a_note() {
    let xml = "<scene version='3.0.0'><shape type='obj'><string name='filename' value='a.obj'/></shape></scene>";
    let obj = format!("{TRIANGLE_OBJ}f 1 1 2\nf 1 2\n");
    let loaded = load_files(&[("a.xml", xml.as_bytes()), ("a.obj", obj.as_bytes())], &[]).unwrap();
    assert_eq!(mesh(&loaded).triangles.len(), 1);
    let notes: Vec<String> = loaded.notes.iter().map(ToString::to_string).collect();
    assert!(notes.iter().any(|note| note.contains("a.obj: 2 degenerate triangles")), "{notes:?}");
    let flat = "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n";
    let loaded = load_files(&[("a.xml", xml.as_bytes()), ("a.obj", flat.as_bytes())], &[]).unwrap();
    assert!(loaded.scene.shapes.is_empty() && loaded.scene.meshes.is_empty());
}

/// A shape with a texture that has parameters.
fn needing(texture: &str, inside: &str) -> String {
    format!(
        "<shape type='disk'><bsdf type='diffuse'><texture name='reflectance' type='{texture}'>{inside}</texture></bsdf>\
         </shape>"
    )
}

#[test]
fn every_plugin_loads_with_its_defaults() {
    for plugin in plugins() {
        let (name, tag) = (plugin.name, plugin.tag());
        let inside = match (tag, name) {
            // Each needs a file, which the tests of their families write.
            (Tag::Shape, "serialized") | (Tag::Emitter, "envmap") => continue,
            (Tag::Shape, "obj" | "ply") => {
                format!("<shape type='{name}'><string name='filename' value='a.{name}'/></shape>")
            }
            (Tag::Texture, "bitmap" | "mesh_attribute") => continue,
            (Tag::Shape, "shapegroup" | "instance") => "<shape type='shapegroup' id='g'><shape type='disk'/></shape>\
                 <shape type='instance'><ref id='g'/></shape>"
                .into(),
            (Tag::Bsdf, "twosided" | "mask") => {
                format!("<shape type='disk'><bsdf type='{name}'><bsdf type='diffuse'/></bsdf></shape>")
            }
            (Tag::Bsdf, "blendbsdf") => "<shape type='disk'><bsdf type='blendbsdf'><float name='weight' value='0.5'/>\
                 <bsdf type='diffuse'/><bsdf type='diffuse'/></bsdf></shape>"
                .into(),
            (Tag::Bsdf, "bumpmap" | "normalmap") => format!(
                "<shape type='disk'><bsdf type='{name}'><texture name='normalmap' type='checkerboard'/>\
                 <bsdf type='diffuse'/></bsdf></shape>"
            ),
            (Tag::Texture, "uniform" | "rawconstant") => needing(name, "<float name='value' value='0.5'/>"),
            (Tag::Texture, "srgb") => needing(name, "<rgb name='color' value='0.5'/>"),
            (Tag::Texture, "blackbody") => needing(name, "<float name='temperature' value='5000'/>"),
            (Tag::Texture, "regular") => needing(
                name,
                "<float name='wavelength_min' value='400'/><float name='wavelength_max' value='700'/>\
                 <string name='values' value='1, 2'/>",
            ),
            (Tag::Texture, "irregular") => {
                needing(name, "<string name='wavelengths' value='400, 500'/><string name='values' value='1, 2'/>")
            }
            (Tag::Sensor, "thinlens") => {
                "<sensor type='thinlens'><float name='aperture_radius' value='1'/></sensor>".into()
            }
            (Tag::Bsdf, _) => format!("<shape type='disk'><bsdf type='{name}'/></shape>"),
            (Tag::Texture, _) => {
                format!(
                    "<shape type='disk'><bsdf type='diffuse'><texture name='reflectance' type='{name}'/></bsdf></shape>"
                )
            }
            (Tag::Emitter, "area") => "<shape type='disk'><emitter type='area'/></shape>".into(),
            (Tag::Emitter, "point") => "<emitter type='point'><point name='position' value='0'/></emitter>".into(),
            (Tag::Emitter, "directional") => {
                "<emitter type='directional'><vector name='direction' x='1' y='0' z='0'/></emitter>".into()
            }
            (Tag::Film, _) => format!("<sensor type='perspective'><film type='{name}'/></sensor>"),
            (Tag::Rfilter, _) => {
                format!("<sensor type='perspective'><film type='hdrfilm'><rfilter type='{name}'/></film></sensor>")
            }
            (Tag::Sampler, _) => format!("<sensor type='perspective'><sampler type='{name}'/></sensor>"),
            (tag, _) => format!("<{0} type='{name}'/>", tag.name()),
        };
        scene(&inside);
    }
}
