//! Work to equal error on one thread: `work SCENE [SPP] [SEED]` prints processor seconds, relmse by the film's own variance and their product.

use std::error::Error;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;
use tilecast_core::bvh::simd::Isa;
use tilecast_core::film::Film;
use tilecast_core::load::{LoadOptions, load};
use tilecast_core::settings::Window;
use tilecast_core::trace::Tracer;
use tilecast_core::world::World;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let scene = arguments.next().ok_or("usage: work SCENE [SPP] [SEED]")?;
    let spp: u32 = arguments.next().map_or(Ok(64), |s| s.parse())?;
    let without: Vec<String> = std::env::args().skip(4).collect();
    let seed: u64 = arguments.next().map_or(Ok(0), |s| s.parse())?;
    let loaded = load(scene.as_ref(), &LoadOptions::default())?;
    let world = Arc::new(World::compile(&loaded.scene));
    let mut settings = loaded.settings.clone();
    settings.spp = spp;
    settings.seed = seed;
    let off = |name: &str| without.iter().any(|w| w == name);
    settings.without.splitting |= off("splitting");
    settings.without.early_roulette |= off("early-roulette");
    settings.without.blind_ends |= off("blind-ends");
    settings.without.path_reuse |= off("path-reuse");
    settings.without.environment_cosine |= off("environment-cosine");
    let isa =
        std::env::var("ISA").map_or(Some(Isa::detect()), |name| Isa::from_name(&name).filter(|isa| isa.is_available()));
    let isa = isa.ok_or("this machine has no path of the name in ISA")?;
    let tracer = Tracer::new(world, settings.clone(), isa)?;
    let mut film = Film::new(&settings);
    let window = settings.film.crop;
    let never = AtomicBool::new(false);
    let start = Instant::now();
    let cpu0 = cpu();
    let mut y = window.y0;
    while y < window.y1 {
        let mut x = window.x0;
        while x < window.x1 {
            let tile = Window { x0: x, x1: (x + 32).min(window.x1), y0: y, y1: (y + 32).min(window.y1) };
            if let Some(part) = tracer.trace(tile, 0..spp, &never)? {
                film.merge(&part);
            }
            x += 32;
        }
        y += 32;
    }
    let seconds = cpu() - cpu0;
    let wall = start.elapsed().as_secs_f64();
    let mut estimates = Vec::new();
    for (x, y) in (window.y0..window.y1).flat_map(|y| (window.x0..window.x1).map(move |x| (x, y))) {
        estimates.push(film.estimate(x, y));
    }
    let n = estimates.len() as f64 * 3.0;
    let mean = estimates.iter().flat_map(|e| e.mean).map(f64::from).sum::<f64>() / n;
    let rel = estimates
        .iter()
        .flat_map(|e| e.mean.into_iter().zip(e.variance))
        .map(|(m, v)| f64::from(v) / (f64::from(m).powi(2) + 0.01 * mean * mean))
        .sum::<f64>()
        / n;
    println!(
        "{} cpu {seconds:.3} wall {wall:.3} us/path {:.3} relmse {rel:.4e} work {:.4e} mean {mean:.6} digest {}",
        scene,
        seconds * 1e6 / (window.area() as f64 * f64::from(spp)),
        rel * seconds,
        &film.digest().to_string()[..12]
    );
    Ok(())
}

fn cpu() -> f64 {
    let stat = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    stat.split_whitespace().next().and_then(|s| s.parse::<f64>().ok()).unwrap_or(0.0) * 1e-9
}
