//! Which random numbers, and how many replicates of them? Variance and cost of every sampler on every scene: docs/sampling.md.
//!
//! The mean squared error of an unbiased image is its variance, which a few seeds show without a reference.

use anyhow::Context;
use clap::Parser;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use tilecast_bench::{compile, means, small};
use tilecast_core::bvh::simd::Isa;
use tilecast_core::film::{Film, REPLICATES};
use tilecast_core::settings::{Film as FilmSettings, Filter, SamplerKind, Settings, Window};
use tilecast_core::trace::Tracer;

const SAMPLERS: [(&str, SamplerKind); 4] = [
    ("independent", SamplerKind::Independent),
    ("sobol", SamplerKind::Sobol),
    ("sobol-joint", SamplerKind::SobolJoint),
    ("sobol-z", SamplerKind::SobolZ),
];
/// Part of the mean squared radiance that relative errors add to a pixel's own.
const RELATIVE_FLOOR: f64 = 0.01;

/// Prints CSV: scene,sampler,replicates,spp,mse,relmse,nanoseconds
#[derive(Parser)]
struct Arguments {
    /// Scenes
    scenes: Vec<PathBuf>,
    /// Samples a pixel
    #[arg(long, value_delimiter = ',', default_value = "16,64,256,1024")]
    spp: Vec<u32>,
    /// Only this sampler
    #[arg(long)]
    sampler: Option<String>,
    /// Independent sequences that share the samples of a pixel: 1, 2, 4 or multiples of 4
    #[arg(long, value_delimiter = ',', default_value = "4")]
    replicates: Vec<u32>,
    /// Images of each kind
    #[arg(long, default_value_t = 4)]
    seeds: u64,
    /// Pixels of the image, about
    #[arg(long, default_value_t = 768)]
    pixels: u32,
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    println!("scene,sampler,replicates,spp,mse,relmse,nanoseconds");
    for scene in &arguments.scenes {
        let (world, mut settings) = compile(scene, &[])?;
        // What a sampler does for a pixel's own paths.
        settings.without.path_reuse = true;
        let name = scene.parent().and_then(|p| p.file_name()).context("a scene without a folder")?.to_string_lossy();
        let Window { x1: width, y1: height, .. } = small(&settings, arguments.pixels);
        let film = FilmSettings { width, height, crop: small(&settings, arguments.pixels), filter: Filter::Box };
        for &spp in &arguments.spp {
            for (sampler, kind) in SAMPLERS.iter().filter(|(n, _)| arguments.sampler.as_deref().is_none_or(|s| s == *n))
            {
                for &replicates in &arguments.replicates {
                    // A sequence of n samples is a replicate of an image of four times as many.
                    let asked = spp / replicates * REPLICATES as u32;
                    let job = Settings { spp: asked, sampler: *kind, film: film.clone(), ..settings.clone() };
                    let mut images = Vec::new();
                    let begun = cpu_nanoseconds();
                    for seed in 0..arguments.seeds {
                        images.push(image(&world, &job, seed, replicates)?);
                    }
                    let samples = arguments.seeds * u64::from(spp) * film.crop.area();
                    let cost = (cpu_nanoseconds() - begun) as f64 / samples as f64;
                    let (mse, relmse) = errors(&images);
                    println!("{name},{sampler},{replicates},{spp},{mse:.6e},{relmse:.6e},{cost:.1}");
                }
            }
        }
    }
    Ok(())
}

/// The means of an image whose samples come from that many sequences a pixel. Of the film's replicates only the first ones are
/// traced; more than it has come from other seeds.
fn image(
    world: &std::sync::Arc<tilecast_core::world::World>,
    settings: &Settings,
    seed: u64,
    replicates: u32,
) -> anyhow::Result<Vec<f64>> {
    let used = replicates.min(REPLICATES as u32);
    let films = u64::from(replicates / used);
    let never = AtomicBool::new(false);
    let mut sum = Vec::new();
    for k in 0..films {
        let job = Settings { seed: seed * films + k, ..settings.clone() };
        let tracer = Tracer::new(world.clone(), job.clone(), Isa::detect())?;
        let mut film = Film::new(&job);
        for first in (0..job.spp).step_by(REPLICATES) {
            tracer.trace(job.film.crop, first..first + used, &never)?.iter().for_each(|part| film.merge(part));
        }
        let means = means(&film);
        sum = if sum.is_empty() { means } else { sum.iter().zip(means).map(|(a, b)| a + b).collect() };
    }
    Ok(sum.into_iter().map(|v| v / films as f64).collect())
}

/// The variance of the images' values, and the same relative to their squares.
fn errors(images: &[Vec<f64>]) -> (f64, f64) {
    let n = images.len() as f64;
    let values = images[0].len();
    let mean = |i: usize| images.iter().map(|image| image[i]).sum::<f64>() / n;
    let floor = RELATIVE_FLOOR * ((0..values).map(mean).sum::<f64>() / values as f64).powi(2);
    let (mut mse, mut relmse) = (0.0, 0.0);
    for i in 0..values {
        let m = mean(i);
        let variance = images.iter().map(|image| (image[i] - m).powi(2)).sum::<f64>() / (n - 1.0);
        mse += variance;
        relmse += variance / (m * m + floor);
    }
    (mse / values as f64, relmse / values as f64)
}

/// Time that this thread has spent on a processor, whoever else wants it.
fn cpu_nanoseconds() -> u64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split_whitespace().next().and_then(|word| word.parse().ok()).unwrap_or(0)
}
