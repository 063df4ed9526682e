//! What saves work changes no expected image: with and without each, pictures differ by chance alone, or not at all.

use crate::build::{loaded, mean_and_error, scene_path};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use tilecast_core::bvh::simd::Isa;
use tilecast_core::film::Film;
use tilecast_core::settings::{IntegratorKind, Window, Without};
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
    let all = Without { splitting: true, early_roulette: true, blind_ends: true, path_reuse: true };
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
