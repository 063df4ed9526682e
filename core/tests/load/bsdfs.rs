//! BSDFs and spectra of Mitsuba scenes: parameters, defaults, errors. Numbers come from Mitsuba 3.9.1.

use crate::faults::fails;
use crate::mitsuba::{assert_near, bsdf, colour, scene};
use glam::Vec3;
use tilecast_core::load::Loaded;
use tilecast_core::scene::{Bend, Bsdf, Distribution, Texture, TextureId};

fn made_of(bsdf: &str) -> Loaded {
    scene(&shape(bsdf))
}

fn shape(bsdf: &str) -> String {
    format!("<shape type='rectangle'>\n{bsdf}</shape>")
}

fn value(loaded: &Loaded, id: TextureId) -> f32 {
    let rgb = colour(&loaded.scene, id);
    assert_eq!(rgb, Vec3::splat(rgb.x));
    rgb.x
}

#[test]
fn rough_metals() {
    let loaded = made_of("<bsdf type='roughconductor'/>");
    let Bsdf::RoughConductor { distribution, alpha_u, alpha_v, eta, k, specular_reflectance } = *bsdf(&loaded) else {
        panic!("no rough conductor")
    };
    assert_eq!((distribution, alpha_u), (Distribution::Beckmann, alpha_v));
    let values = [alpha_u, eta, k, specular_reflectance].map(|id| value(&loaded, id));
    assert_eq!(values, [0.1, 0.0, 1.0, 1.0]);
    let loaded = made_of(
        "<bsdf type='roughconductor'><string name='material' value='Au'/><string name='distribution' value='ggx'/>\
         <float name='alpha_u' value='0.2'/><float name='alpha_v' value='0.3'/></bsdf>",
    );
    let Bsdf::RoughConductor { distribution, alpha_u, alpha_v, eta, .. } = *bsdf(&loaded) else {
        panic!("no rough conductor")
    };
    assert_eq!((distribution, value(&loaded, alpha_u), value(&loaded, alpha_v)), (Distribution::Ggx, 0.2, 0.3));
    assert_near(colour(&loaded.scene, eta), [0.14303598, 0.37530708, 1.4420453]);
    let rough = |inside: &str| shape(&format!("<bsdf type='roughconductor'>{inside}</bsdf>"));
    fails(&rough("<float name='alpha_u' value='1'/>"), "3:58", &["'alpha_u' needs 'alpha_v'"]);
    let all = "<float name='alpha' value='1'/><float name='alpha_u' value='1'/><float name='alpha_v' value='1'/>";
    fails(&rough(all), "3:56", &["not both"]);
    let phong = "<string name='distribution' value='phong'/>";
    fails(&rough(phong), "3:64", &["cannot be 'phong'", "beckmann, ggx"]);
}

#[test]
fn rough_and_thin_glass() {
    let loaded = made_of("<bsdf type='roughdielectric'><texture name='alpha' type='checkerboard'/></bsdf>");
    let Bsdf::RoughDielectric { distribution, alpha_u, alpha_v, eta, .. } = *bsdf(&loaded) else { panic!("no glass") };
    assert_eq!((distribution, alpha_u), (Distribution::Beckmann, alpha_v));
    assert!((eta - 1.5041833).abs() < 1e-6);
    assert!(matches!(loaded.scene.textures[alpha_u.0 as usize], Texture::Checkerboard { .. }));
    let loaded = made_of("<bsdf type='thindielectric'><string name='int_ior' value='diamond'/></bsdf>");
    let Bsdf::ThinDielectric { eta, .. } = *bsdf(&loaded) else { panic!("no pane") };
    assert!((eta - 2.4183301).abs() < 1e-6, "{eta}");
}

#[test]
fn plastics() {
    let loaded = made_of("<bsdf type='plastic'/>");
    let Bsdf::Plastic { eta, nonlinear, diffuse_reflectance, specular_reflectance } = *bsdf(&loaded) else {
        panic!("no plastic")
    };
    assert!((eta - 1.48959).abs() < 1e-5 && !nonlinear);
    assert_eq!((value(&loaded, diffuse_reflectance), value(&loaded, specular_reflectance)), (0.5, 1.0));
    let loaded = made_of(
        "<bsdf type='roughplastic'><float name='int_ior' value='1.5'/><float name='ext_ior' value='1'/>\
         <boolean name='nonlinear' value='true'/><float name='alpha_u' value='0.3'/><float name='alpha_v' value='0.3'/></bsdf>",
    );
    let Bsdf::RoughPlastic { distribution, alpha, eta, nonlinear, .. } = *bsdf(&loaded) else { panic!("no plastic") };
    assert_eq!((distribution, alpha, eta, nonlinear), (Distribution::Beckmann, 0.3, 1.5, true));
    let rough = |inside: &str| shape(&format!("<bsdf type='roughplastic'>{inside}</bsdf>"));
    fails(&rough("<texture name='alpha' type='checkerboard'/>"), "3:27", &["takes a float, not a texture"]);
    let unequal = "<float name='alpha_u' value='0.1'/><float name='alpha_v' value='0.2'/>";
    fails(&rough(unequal), "3:91", &["must be equal"]);
    fails(&rough("<float name='alpha' value='-1'/>"), "3:54", &["at least 0"]);
}

#[test]
fn burleys_models() {
    let eta = |inside: &str| {
        let loaded = made_of(&format!("<bsdf type='principled'>{inside}</bsdf>"));
        let Bsdf::Principled { eta, base_color, roughness, metallic, clearcoat, .. } = *bsdf(&loaded) else {
            panic!("not principled")
        };
        let values = [base_color, roughness, metallic, clearcoat].map(|id| value(&loaded, id));
        assert_eq!(values, [0.5, 0.5, 0.0, 0.0]);
        eta
    };
    assert_eq!(eta(""), 1.5);
    assert_eq!(eta("<float name='eta' value='1.3'/>"), 1.3);
    assert!((eta("<float name='specular' value='0.8'/>") - 1.6773124).abs() < 1e-6);
    let both = "<bsdf type='principled'><float name='eta' value='2'/><float name='specular' value='0.8'/></bsdf>";
    fails(&shape(both), "3:84", &["not both"]);
    let loaded = made_of("<bsdf type='principledthin'><float name='diff_trans' value='1.5'/></bsdf>");
    let Bsdf::PrincipledThin { eta, diff_trans, .. } = *bsdf(&loaded) else { panic!("not thin") };
    assert_eq!((value(&loaded, eta), value(&loaded, diff_trans)), (1.5, 1.5));
}

#[test]
fn what_is_clear_has_no_second_side() {
    let twosided = |inside: &str| shape(&format!("<bsdf type='twosided'>\n<bsdf type={inside}</bsdf></bsdf>"));
    for clear in [
        "'principled'><float name='spec_trans' value='0.5'/>",
        "'null'>",
        "'roughdielectric'>",
        "'bumpmap'><texture type='checkerboard'/><bsdf type='thindielectric'/>",
    ] {
        fails(&twosided(clear), "4:1", &["no light goes through"]);
    }
    scene(&twosided("'principled'><float name='spec_trans' value='0'/>"));
}

#[test]
fn blends_hold_two() {
    let blend = |inside: &str| format!("<bsdf type='blendbsdf'>{inside}</bsdf>");
    let two = "<bsdf type='diffuse'/><bsdf type='null'/>";
    let loaded = made_of(&blend(&format!("<float name='weight' value='0.25'/>{two}")));
    let Bsdf::BlendBsdf { weight, nested } = *bsdf(&loaded) else { panic!("no blend") };
    assert_eq!(value(&loaded, weight), 0.25);
    assert!(matches!(loaded.scene.bsdfs[nested[0].0 as usize], Bsdf::Diffuse { .. }));
    assert!(matches!(loaded.scene.bsdfs[nested[1].0 as usize], Bsdf::Null));
    fails(&shape(&blend(two)), "3:1", &["needs the parameter 'weight'"]);
    let one = "<float name='weight' value='0.25'/><bsdf type='diffuse'/>";
    fails(&shape(&blend(one)), "3:1", &["holds two BSDFs, not 1"]);
}

#[test]
fn maps_bend_what_they_nest() {
    let loaded = made_of(
        "<bsdf type='bumpmap'><texture type='checkerboard' name='any'/><float name='scale' value='2'/>\
         <boolean name='use_shadowing_function' value='false'/><bsdf type='diffuse'/></bsdf>",
    );
    let Bsdf::BumpMap { texture, scale, bend, .. } = *bsdf(&loaded) else { panic!("no bump map") };
    assert_eq!((scale, bend), (2.0, Bend { flip_invalid_normals: true, use_shadowing_function: false }));
    assert!(matches!(loaded.scene.textures[texture.0 as usize], Texture::Checkerboard { .. }));
    let loaded =
        made_of("<bsdf type='normalmap'><rgb name='normalmap' value='0.5 0.6 1'/><bsdf type='diffuse'/></bsdf>");
    let Bsdf::NormalMap { normalmap, bend, .. } = *bsdf(&loaded) else { panic!("no normal map") };
    assert_eq!(colour(&loaded.scene, normalmap), Vec3::new(0.5, 0.6, 1.0));
    assert_eq!(bend, Bend { flip_invalid_normals: true, use_shadowing_function: true });
    let bump = |inside: &str| format!("<bsdf type='bumpmap'><texture type='checkerboard'/>{inside}</bsdf>");
    fails(&shape("<bsdf type='bumpmap'><bsdf type='diffuse'/></bsdf>"), "3:1", &["needs a texture in it"]);
    fails(&shape(&bump("")), "3:1", &["'bumpmap' needs a BSDF in it"]);
    fails(&shape(&bump(&bump("<bsdf type='diffuse'/>"))), "3:52", &["cannot stand in another"]);
    fails(&shape("<bsdf type='normalmap'><bsdf type='diffuse'/></bsdf>"), "3:1", &["needs the parameter 'normalmap'"]);
}

#[test]
fn spectra_as_objects() {
    let radiance = |spectrum: &str| {
        let loaded = scene(&format!(
            "<shape type='rectangle'><emitter type='area'><spectrum name='radiance' type={spectrum}</spectrum></emitter>\
             </shape>"
        ));
        colour(&loaded.scene, loaded.scene.shapes[0].radiance.unwrap())
    };
    assert_near(radiance("'uniform'><float name='value' value='3'/>"), [3.0; 3]);
    assert_near(radiance("'d65'>"), [1.0; 3]);
    let tinted = "'d65'><rgb name='color' value='.5,.6,.7'/><float name='scale' value='2'/>";
    assert_near(radiance(tinted), [1.0, 1.2, 1.4]);
    assert_near(radiance("'srgb'><rgb name='color' value='.5,.6,.7'/>"), [0.5, 0.6, 0.7]);
    let list = [0.7993351, 0.5923942, 0.4895369];
    let irregular = "<string name='wavelengths' value='400,500,700'/><string name='values' value='.5 .6 .7'/>";
    assert_near(radiance(&format!("'irregular'>{irregular}")), list);
    let regular = "<float name='wavelength_min' value='400'/><float name='wavelength_max' value='700'/>\
                   <string name='values' value='.5, .55, .6, .65'/>";
    let same = "<string name='wavelengths' value='400,700'/><string name='values' value='.5 .65'/>";
    let expected = radiance(&format!("'irregular'>{same}"));
    assert_near(radiance(&format!("'regular'>{regular}")), expected.to_array());
    let warm = radiance("'blackbody'><float name='temperature' value='3000'/>");
    assert!(warm.x > warm.y && warm.y > warm.z, "{warm}");
    let missing = "<emitter type='point'>\n<spectrum name='intensity' type='uniform'/></emitter>";
    fails(missing, "3:1", &["needs the parameter 'value'"]);
    let unequal = "<emitter type='constant'><spectrum name='radiance' type='irregular'>\
                   <string name='wavelengths' value='1 2'/>\n<string name='values' value='1'/></spectrum></emitter>";
    fails(unequal, "3:30", &["1 values for 2 wavelengths"]);
    let varying = "<emitter type='constant'>\n<texture name='radiance' type='checkerboard'/></emitter>";
    fails(varying, "3:1", &["must be the same everywhere"]);
}
