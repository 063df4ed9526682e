//! The whole way in one page: a scene file in, an image out.
//!
//! ```text
//! cargo run --release --example render -- scenes/cornell-box/scene.xml cornell.ppm
//! ```

use std::error::Error;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use tilecast_core::bvh::simd::Isa;
use tilecast_core::film::Film;
use tilecast_core::load::{LoadOptions, load};
use tilecast_core::settings::Window;
use tilecast_core::trace::Tracer;
use tilecast_core::world::World;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args_os().skip(1);
    let (Some(scene), Some(out)) = (arguments.next(), arguments.next()) else {
        return Err("usage: render SCENE OUT.ppm".into());
    };

    // A file becomes plain data, and plain data a world to trace in.
    let loaded = load(scene.as_ref(), &LoadOptions::default())?;
    let world = Arc::new(World::compile(&loaded.scene));
    let tracer = Tracer::new(world, loaded.settings.clone(), Isa::detect())?;

    // The image is the sum of units of work. Any cut into tiles and sample ranges, in any order, gives the same bits:
    // here rows of pixels, and each in two halves of its samples, the second half first.
    let mut film = Film::new(&loaded.settings);
    let (window, half) = (loaded.settings.film.crop, loaded.settings.spp / 2);
    let never = AtomicBool::new(false);
    let halves: [Range<u32>; 2] = [half..loaded.settings.spp, 0..half];
    for samples in halves {
        for y in window.y0..window.y1 {
            let row = Window { y0: y, y1: y + 1, ..window };
            if let Some(part) = tracer.trace(row, samples.clone(), &never)? {
                film.merge(&part);
            }
        }
    }

    // Every pixel knows its mean and the variance of that mean.
    let mut image = format!("P6 {} {} 255\n", window.width(), window.height()).into_bytes();
    let mut variance = 0.0;
    for (x, y) in (window.y0..window.y1).flat_map(|y| (window.x0..window.x1).map(move |x| (x, y))) {
        let estimate = film.estimate(x, y);
        variance += f64::from(estimate.variance[1]) / window.area() as f64;
        image.extend(estimate.mean.map(|c| (c.clamp(0.0, 1.0).powf(1.0 / 2.2) * 255.0) as u8));
    }
    std::fs::write(&out, image)?;
    println!("digest {}, standard error {:.2e} (green)", film.digest(), variance.sqrt());
    Ok(())
}
