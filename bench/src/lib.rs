//! Measuring the tracer: whole images on all cores, their errors, and plots of them.
//!
//! It uses `tilecast-core` alone; what the cluster costs is measured from outside, by whole processes.

pub mod rays;

use anyhow::Context;
use rayon::prelude::*;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use tilecast_core::bvh::simd::Isa;
use tilecast_core::film::Film;
use tilecast_core::load::{LoadOptions, load};
use tilecast_core::settings::{Settings, Window};
use tilecast_core::trace::Tracer;
use tilecast_core::world::World;

/// Side of the tiles that threads take.
const TILE: u32 = 16;

/// A scene file, compiled, and its own settings.
///
/// # Errors
/// What the loader refuses.
pub fn compile(scene: &Path, defines: &[(String, String)]) -> anyhow::Result<(Arc<World>, Settings)> {
    let options = LoadOptions { defines: defines.to_vec(), ..LoadOptions::default() };
    let loaded = load(scene, &options).with_context(|| format!("loading {}", scene.display()))?;
    Ok((Arc::new(World::compile(&loaded.scene)), loaded.settings))
}

/// The image of a world under these settings, on the current rayon pool.
///
/// # Errors
/// Settings out of range, or a sample that has no value.
pub fn render(world: &Arc<World>, settings: &Settings) -> anyhow::Result<Film> {
    let tracer = Tracer::new(world.clone(), settings.clone(), Isa::detect())?;
    let never = AtomicBool::new(false);
    let parts: Vec<_> = tiles(settings.film.crop)
        .into_par_iter()
        .map(|tile| tracer.trace(tile, 0..settings.spp, &never))
        .collect::<Result<_, _>>()?;
    let mut film = Film::new(settings);
    parts.iter().flatten().for_each(|part| film.merge(part));
    Ok(film)
}

fn tiles(window: Window) -> Vec<Window> {
    let cut = |from: u32, to: u32| (from..to).step_by(TILE as usize).map(move |a| (a, (a + TILE).min(to)));
    cut(window.y0, window.y1)
        .flat_map(|(y0, y1)| cut(window.x0, window.x1).map(move |(x0, x1)| Window { x0, y0, x1, y1 }))
        .collect()
}

/// The means of all pixels, channel by channel.
pub fn means(film: &Film) -> Vec<f64> {
    let w = film.window;
    (w.y0..w.y1)
        .flat_map(|y| (w.x0..w.x1).map(move |x| (x, y)))
        .flat_map(|(x, y)| film.estimate(x, y).mean.map(f64::from))
        .collect()
}

/// Mean squared difference.
pub fn mse(image: &[f64], reference: &[f64]) -> f64 {
    let sum: f64 = image.iter().zip(reference).map(|(a, b)| (a - b) * (a - b)).sum();
    sum / reference.len() as f64
}

/// The whole picture in about so many pixels, in its own aspect.
pub fn small(settings: &Settings, pixels: u32) -> Window {
    let (width, height) = (f64::from(settings.film.width), f64::from(settings.film.height));
    let scale = (f64::from(pixels) / (width * height)).sqrt();
    let [x1, y1] = [width, height].map(|side| ((side * scale).round() as u32).max(1));
    Window { x0: 0, y0: 0, x1, y1 }
}
