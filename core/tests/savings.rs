//! What saves work changes no expected image: with and without each, pictures differ by chance alone, or not at all.

#![allow(clippy::unwrap_used)]

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use tilecast_core::bvh::simd::Isa;
use tilecast_core::film::Film;
use tilecast_core::load::{LoadOptions, load};
use tilecast_core::settings::{IntegratorKind, Window, Without};
use tilecast_core::trace::Tracer;
use tilecast_core::world::World;

/// Small: each test renders a few of these in a second or two.
const SIDE: u32 = 24;
const SPP: u32 = 256;

/// Renders a scene of the repository; `columns` is the width of its tiles.
fn render(name: &str, kind: IntegratorKind, without: Without, seed: u64, columns: u32) -> Film {
    let path = format!("{}/../scenes/{name}/scene.xml", env!("CARGO_MANIFEST_DIR"));
    let loaded = load(path.as_ref(), &LoadOptions::default()).unwrap();
    let mut settings = loaded.settings;
    settings.integrator.kind = kind;
    (settings.film.width, settings.film.height) = (SIDE, SIDE);
    settings.film.crop = Window { x0: 0, y0: 0, x1: SIDE, y1: SIDE };
    (settings.spp, settings.seed, settings.without) = (SPP, seed, without);
    let tracer = Tracer::new(Arc::new(World::compile(&loaded.scene)), settings.clone(), Isa::detect()).unwrap();
    let mut film = Film::new(&settings);
    for x0 in (0..SIDE).step_by(columns as usize) {
        let tile = Window { x0, y0: 0, x1: (x0 + columns).min(SIDE), y1: SIDE };
        film.merge(&tracer.trace(tile, 0..SPP, &AtomicBool::new(false)).unwrap().unwrap());
    }
    film
}

/// The mean over all pixels and channels, and the variance of that mean.
fn mean(film: &Film) -> (f64, f64) {
    let n = f64::from(3 * SIDE * SIDE);
    let (mut sum, mut variance) = (0.0, 0.0);
    for (x, y) in (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (x, y))) {
        let estimate = film.estimate(x, y);
        sum += estimate.mean.map(f64::from).iter().sum::<f64>();
        // The channels of a pixel err together: three of them count as one.
        variance += 3.0 * estimate.variance.map(f64::from).iter().sum::<f64>();
    }
    (sum / n, variance / (n * n))
}

/// Fails if a branch does not count for its share (by a factor of four), or roulette does not undo itself (the picture darkens).
#[test]
fn splitting_and_roulette_keep_the_mean() {
    let all = Without { splitting: true, early_roulette: true, blind_ends: true };
    for scene in ["cornell-box", "veach-strategies"] {
        for (kind, saving) in [
            (IntegratorKind::Direct, Without { splitting: false, ..all }),
            (IntegratorKind::Path, Without { early_roulette: false, ..all }),
            (IntegratorKind::Path, Without::default()),
        ] {
            let (plain, plain_variance) = mean(&render(scene, kind, all, 1, SIDE));
            let (saved, variance) = mean(&render(scene, kind, saving, 2, SIDE));
            let error = (variance + plain_variance).sqrt();
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
