//! Scenes with what tilecast does not have: an error, or on request a picture without it and a list of what is missing.

use crate::{load_scene, write_files};
use tilecast_core::load::{LoadOptions, Loaded, load};
use tilecast_core::scene::{Bsdf, Texture};
use tilecast_core::settings::IntegratorKind;

fn substituted(inside: &str) -> Result<Loaded, String> {
    let folder = tempfile::tempdir().unwrap();
    let scene = format!("<scene version=\"3.0.0\">\n{inside}\n</scene>\n");
    write_files(folder.path(), &[("a.xml", scene.as_bytes())]);
    let options = LoadOptions { substitute: true, ..LoadOptions::default() };
    load(&folder.path().join("a.xml"), &options).map_err(|e| e.to_string())
}

/// One of each kind of what is missing; each is on the list with its line, and nothing else is.
#[test]
fn everything_missing_is_replaced_and_listed() {
    let inside = "<integrator type='volpath'><integer name='max_depth' value='7'/></integrator>\n\
        <emitter type='sunsky'/>\n\
        <medium type='homogeneous' id='fog'/>\n\
        <bsdf type='measured' id='unused'/>\n\
        <shape type='sdfgrid'/>\n\
        <shape type='sphere'><bsdf type='hair'><float name='beta_m' value='0.3'/></bsdf><ref name='interior' id='fog'/></shape>\n\
        <shape type='sphere'><bsdf type='mask'><texture name='opacity' type='volume'/><bsdf type='diffuse'>\
        <texture name='reflectance' type='volume'/></bsdf></bsdf></shape>\n\
        <shape type='sphere'>\n<float name='wobble' value='1'/></shape>\n\
        <sensor type='perspective'><sampler type='halton'/><film type='specfilm'><integer name='width' value='99'/>\
        <rfilter type='blackman'/></film></sensor>";
    assert!(load_scene(inside).is_err());
    let loaded = substituted(inside).unwrap();
    let scene = &loaded.scene;
    assert_eq!((scene.shapes.len(), scene.emitters.len()), (3, 0));
    assert!(matches!(scene.bsdfs[scene.shapes[0].bsdf.0 as usize], Bsdf::Diffuse { .. }));
    let Bsdf::Mask { opacity, nested } = scene.bsdfs[scene.shapes[1].bsdf.0 as usize] else { panic!("no mask") };
    assert_eq!(scene.textures[opacity.0 as usize], Texture::Constant(glam::Vec3::splat(0.5)));
    let Bsdf::Diffuse { reflectance } = scene.bsdfs[nested.0 as usize] else { panic!("not diffuse") };
    assert_eq!(scene.textures[reflectance.0 as usize], Texture::Constant(glam::Vec3::splat(0.5)));
    assert_eq!(
        (loaded.settings.integrator.kind, loaded.settings.integrator.max_depth),
        (IntegratorKind::Path, Some(7))
    );
    assert_eq!(loaded.settings.film.width, 99);
    let list: Vec<String> = loaded.substitutions.iter().map(ToString::to_string).collect();
    let lines = |name: &str| -> Vec<&String> { list.iter().filter(|line| line.contains(name)).collect() };
    for (name, line, count) in [
        ("integrator 'volpath': replaced by 'path'", 2, 1),
        ("emitter 'sunsky': left out", 3, 1),
        ("shape 'sdfgrid': left out", 6, 1),
        ("bsdf 'hair': replaced by a grey 'diffuse'", 7, 1),
        ("medium 'homogeneous': left out", 4, 1),
        ("texture 'volume'", 8, 2),
        ("'wobble'", 10, 1),
        ("sampler 'halton'", 11, 1),
        ("film 'specfilm'", 11, 1),
        ("rfilter 'blackman'", 11, 1),
    ] {
        let found = lines(name);
        assert_eq!(found.len(), count, "{name}: {list:#?}");
        assert!(found.iter().all(|text| text.contains(&format!("a.xml:{line}: "))), "{found:?}");
    }
    assert_eq!(list.len(), 11, "{list:#?}");
    assert!(load_scene("<shape type='sphere'/>").unwrap().substitutions.is_empty());
}

/// A camera from elsewhere would be another picture; and what is wrong stays wrong.
#[test]
fn not_everything_has_a_stand_in() {
    let error = substituted("<sensor type='radiancemeter'/>").unwrap_err();
    assert!(error.contains("sensor 'radiancemeter' is not supported yet"), "{error}");
    let error = substituted("<shape type='sphere'><float name='radius' value='-1'/></shape>").unwrap_err();
    assert!(error.contains("must be above 0"), "{error}");
}
