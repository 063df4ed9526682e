//! What saves work changes no expected image: with and without each, pictures differ by chance alone, or not at all.

use crate::build::{camera, loaded, long, mean_and_error, scene, scene_path, settings, shape};
use crate::means;
use crate::robust::{Dice, material};
use glam::{Affine3, Mat3, Vec3};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use tilecast_core::bvh::simd::Isa;
use tilecast_core::film::Film;
use tilecast_core::scene::{
    Bsdf, BsdfId, Distribution, Emitter, Geometry, Image, ImageId, Scene, Shape, Texels, Texture, TextureId,
};
use tilecast_core::settings::{IntegratorKind, Settings, Strategy, Window, Without};
use tilecast_core::trace::Tracer;
use tilecast_core::world::World;

/// Small: each test renders a few of these in a second or two.
const SIDE: u32 = 24;
const SPP: u32 = 512;

/// Renders a scene of the repository; `columns` is the width of its tiles. Paths are reused if they may be.
fn render(name: &str, kind: IntegratorKind, without: Without, seed: u64, columns: u32) -> Film {
    let (scene, mut settings) = loaded(&scene_path(&format!("{name}/scene.xml")), [SIDE, SIDE], SPP);
    (settings.seed, settings.without) = (seed, without);
    settings.integrator.kind = kind;
    let world = Arc::new(World::compile(&scene));
    let tracer = Tracer::with_reuse(world, settings.clone(), Isa::detect(), true).unwrap();
    let mut film = Film::new(&settings);
    for x0 in (0..SIDE).step_by(columns as usize) {
        let tile = Window { x0, y0: 0, x1: (x0 + columns).min(SIDE), y1: SIDE };
        film.merge(&tracer.trace(tile, 0..SPP, &AtomicBool::new(false)).unwrap().unwrap());
    }
    film
}

/// Fails if a branch does not count for its share (by a factor of four), or roulette does not undo itself (the picture darkens).
#[test]
fn splitting_and_roulette_keep_the_mean() {
    let all =
        Without { splitting: true, early_roulette: true, blind_ends: true, path_reuse: true, environment_cosine: true };
    for scene in ["cornell-box", "veach-strategies"] {
        for (kind, saving) in [
            (IntegratorKind::Direct, Without { splitting: false, ..all }),
            (IntegratorKind::Path, Without { early_roulette: false, ..all }),
            (IntegratorKind::Path, Without::default()),
        ] {
            let (plain, plain_error) = mean_and_error(&render(scene, kind, all, 1, SIDE));
            let (saved, error) = mean_and_error(&render(scene, kind, saving, 2, SIDE));
            let error = error.hypot(plain_error);
            assert!((saved - plain).abs() < 4.0 * error, "{scene} with {saving:?}: {saved}, without {plain} ± {error}");
            assert!(error < 0.07 * plain, "{scene}: an error of {error} in {plain} tells little");
        }
    }
}

/// Not tracing what finds no light changes no bit; nor do branches depend on tiles. Fails if a box does not hold its light.
#[test]
fn blind_ends_change_no_bit() {
    for scene in ["cornell-box", "veach-strategies"] {
        let with = render(scene, IntegratorKind::Path, Without::default(), 3, SIDE);
        let without = render(scene, IntegratorKind::Path, Without { blind_ends: true, ..Without::default() }, 3, 7);
        assert_eq!(with.digest(), without.digest(), "{scene}");
    }
}

/// What is reused does not depend on tiles, nor on which samples are traced at a time.
#[test]
fn reuse_does_not_show_the_tiles() {
    for scene in ["cornell-box", "plates"] {
        let whole = render(scene, IntegratorKind::Path, Without::default(), 3, SIDE);
        for columns in [1, 5, 7, 9] {
            let cut = render(scene, IntegratorKind::Path, Without::default(), 3, columns);
            assert_eq!(whole.digest(), cut.digest(), "{scene} in columns of {columns}");
        }
    }
}

/// A ball on a plate, of two materials, under a sky. Opaque ones are black from behind, and are seen from there, too.
fn outdoors(dice: &mut Dice) -> Scene {
    let mut any = scene(camera(Vec3::Z * 3.0, Vec3::X, -Vec3::Y, -Vec3::Z), 0.5, Vec::new());
    any.textures.extend([0.9, 0.3, 0.0].map(|x| Texture::Constant(Vec3::splat(x))));
    any.bsdfs.extend([material(dice), material(dice)]);
    if dice.of(4) == 0 {
        // Light from behind it matters.
        let (alpha_u, alpha_v, distribution, eta) = (TextureId(0), TextureId(0), Distribution::Ggx, 1.5);
        let (specular_reflectance, specular_transmittance) = (TextureId(1), TextureId(1));
        any.bsdfs[2] =
            Bsdf::RoughDielectric { distribution, alpha_u, alpha_v, eta, specular_reflectance, specular_transmittance };
    }
    let ball = Geometry::Sphere { to_world: Affine3::from_scale(Vec3::splat(0.8)), flip_normals: dice.of(8) == 0 };
    let tilt = Mat3::from_axis_angle(Vec3::new(0.6, 0.8, 0.0), 0.3 * dice.of(9) as f32);
    let plate = Affine3 { matrix3: tilt * 2.0, translation: Vec3::NEG_Z };
    let plate = Geometry::Disk { to_world: plate, flip_normals: dice.of(8) == 0 };
    any.shapes.push(Shape { bsdf: BsdfId(1), ..shape(ball, false) });
    any.shapes.push(Shape { bsdf: BsdfId(2), ..shape(plate, false) });
    // Suns, which BSDFs hardly find; or a bright half, which they find as often as light sampling does.
    let suns = dice.of(2) == 0;
    let is_bright = |i: u32| if suns { i % 149 == 3 } else { i < 12 * 13 };
    let texel = |i: u32| if is_bright(i) { if suns { 30.0 } else { 2.0 } } else { 0.1 * (i % 5) as f32 };
    let texels = Texels::Rgb32((0..24 * 13).flat_map(|i| [texel(i), 0.8 * texel(i), 1.0]).collect());
    any.images.push(Arc::new(Image { width: 24, height: 13, texels }));
    let to_world = Mat3::from_axis_angle(Vec3::new(0.6, 0.0, 0.8), dice.of(6) as f32);
    any.emitters.push(Emitter::Envmap { image: ImageId(0), scale: 0.5, to_world });
    any
}

/// Choosing the sky's light by the cosine leaves every pixel its mean, whatever the material. Seen to fail when light behind glass counts as
/// behind a wall, when the density of a ray that escapes is that of another surface's cosine, and when it is that without.
#[test]
fn the_cosine_keeps_the_mean() {
    let scenes = if long() { 2000 } else { 60 };
    means::all_look_alike((0..scenes).map(|seed| {
        let scene = outdoors(&mut Dice(seed));
        let strategy = [Strategy::Mis, Strategy::Light][seed as usize % 2];
        let mut with = settings(means::SIDE, 64, strategy);
        with.integrator.max_depth = Some(5);
        let without = Settings { without: Without { environment_cosine: true, ..with.without }, ..with.clone() };
        let what = format!("seed {seed}, {strategy:?}, {:?}", &scene.bsdfs[1..]);
        means::Case { what, scene, ways: [(with, false), (without, false)] }
    }));
}
