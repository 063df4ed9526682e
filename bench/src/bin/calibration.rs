//! Do error bars hold? For each scene: how often the 95 % interval of a pixel holds the truth, and whether the picture's own error
//! estimate is the true one, over seeds. docs/accuracy.md has what it printed.

use anyhow::Context;
use clap::Parser;
use std::path::PathBuf;
use tilecast_bench::{compile, render, small};
use tilecast_core::film::{Film, REPLICATES};
use tilecast_core::settings::{Film as FilmSettings, Filter, Settings};
use tilecast_measure::stats::two_sided_quantile;

/// A value whose interval holds in fewer of the seeds than this is called skewed.
const SKEWED: f64 = 0.8;

/// Prints CSV: scene,width,height,spp,seeds,coverage,claimed_over_true,intervals_held,skewed_values,values
#[derive(Parser)]
struct Arguments {
    /// Scenes
    scenes: Vec<PathBuf>,
    /// Samples a pixel
    #[arg(long, default_value_t = 256)]
    spp: u32,
    /// The reference has so many times as many
    #[arg(long, default_value_t = 100)]
    factor: u32,
    /// Renders
    #[arg(long, default_value_t = 20)]
    seeds: u64,
    /// Pixels of the image, about
    #[arg(long, default_value_t = 300)]
    pixels: u32,
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    println!("scene,width,height,spp,seeds,coverage,claimed_over_true,intervals_held,skewed_values,values");
    for scene in &arguments.scenes {
        let (world, settings) = compile(scene, &[])?;
        let name = scene.parent().and_then(|p| p.file_name()).context("a scene without a folder")?.to_string_lossy();
        let crop = small(&settings, arguments.pixels);
        let film = FilmSettings { width: crop.x1, height: crop.y1, crop, filter: Filter::Box };
        let job = Settings { film, spp: arguments.spp, ..settings };
        let best = Settings { spp: arguments.spp * arguments.factor, seed: 1 << 32, ..job.clone() };
        let truth: Vec<[f64; 2]> = values(&render(&world, &best)?);
        let t = two_sided_quantile(0.05, (REPLICATES - 1) as f64);
        let mut held = vec![0u64; truth.len()];
        let (mut claimed, mut squares, mut intervals) = (0.0, 0.0, 0);
        for seed in 0..arguments.seeds {
            let film = render(&world, &Settings { seed, ..job.clone() })?;
            let error = film.relative_error(u64::MAX).context("a black picture")?;
            let (mut this, mut bright) = (0.0, 0.0);
            for (i, ([mean, variance], [truth, _])) in values(&film).into_iter().zip(&truth).enumerate() {
                held[i] += u64::from((mean - truth).abs() <= t * variance.sqrt());
                this += (mean - truth).powi(2);
                bright += mean * mean;
            }
            claimed += f64::from(error.value).powi(2);
            squares += this / bright;
            let actual = (this / bright).sqrt();
            intervals += u32::from((f64::from(error.low)..f64::from(error.high)).contains(&actual));
        }
        let seeds = arguments.seeds;
        let coverage = held.iter().sum::<u64>() as f64 / (seeds * truth.len() as u64) as f64;
        let skewed = held.iter().filter(|&&n| (n as f64) < SKEWED * seeds as f64).count();
        let ratio = (claimed / squares).sqrt();
        println!(
            "{name},{},{},{},{seeds},{coverage:.4},{ratio:.4},{intervals},{skewed},{}",
            crop.x1,
            crop.y1,
            job.spp,
            truth.len()
        );
    }
    Ok(())
}

/// Mean and variance of every value.
fn values(film: &Film) -> Vec<[f64; 2]> {
    let w = film.window;
    (w.y0..w.y1)
        .flat_map(|y| (w.x0..w.x1).map(move |x| film.estimate(x, y)))
        .flat_map(|e| [0, 1, 2].map(|c| [f64::from(e.mean[c]), f64::from(e.variance[c])]))
        .collect()
}
