//! The strategies of the Monte Carlo estimator against each other: error over samples a pixel, with the fitted slope.
//!
//! Independent samples, so that the theory's O(1/N) for the mean squared error is what must be seen. Lights are hidden from the
//! camera: the jagged edge of a bright lamp is the same noise for every strategy, and would drown their differences.

use anyhow::Context;
use clap::Parser;
use std::path::PathBuf;
use tilecast_bench::{compile, means, mse, render, small};
use tilecast_core::settings::{Film, Filter, Integrator, SamplerKind, Settings, Strategy, Without};
use tilecast_measure::plot::{Curve, Labels, log_log};

const STRATEGIES: [(&str, Strategy); 5] = [
    ("uniform", Strategy::Uniform),
    ("cosine", Strategy::Cosine),
    ("bsdf", Strategy::Bsdf),
    ("light", Strategy::Light),
    ("mis", Strategy::Mis),
];

/// Render a scene by every strategy at doubling sample counts; write strategies.csv and strategies.svg
#[derive(Parser)]
struct Arguments {
    /// The scene
    scene: PathBuf,
    /// Where the table and the plot go
    #[arg(long, default_value = "docs")]
    out: PathBuf,
    /// The most samples a pixel; counts double from 4 on
    #[arg(long, default_value_t = 1024)]
    spp: u32,
    /// Samples a pixel of the reference, by `mis` with Sobol' points
    #[arg(long, default_value_t = 32768)]
    reference_spp: u32,
    /// Images averaged for each error
    #[arg(long, default_value_t = 4)]
    seeds: u64,
    /// Pixels of the image, about, in the scene's own aspect
    #[arg(long, default_value_t = 1024)]
    pixels: u32,
}

/// The same picture with another number of pixels, each the plain mean over its square, without visible lamps, and of its own paths
/// alone, since not all strategies let them be reused.
fn prepared(settings: Settings, pixels: u32) -> Settings {
    let crop = small(&settings, pixels);
    let (width, height) = (crop.x1, crop.y1);
    let integrator = Integrator { hide_emitters: true, ..settings.integrator };
    let without = Without { path_reuse: true, ..settings.without };
    Settings { film: Film { width, height, crop, filter: Filter::Box }, integrator, without, ..settings }
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    std::fs::create_dir_all(&arguments.out).with_context(|| format!("making {}", arguments.out.display()))?;
    let (world, settings) = compile(&arguments.scene, &[])?;
    let settings = prepared(settings, arguments.pixels);
    let best = Settings { spp: arguments.reference_spp, strategy: Strategy::Mis, seed: 1 << 32, ..settings.clone() };
    let reference = means(&render(&world, &Settings { sampler: SamplerKind::Sobol, ..best })?);

    let mut table = String::from("strategy,spp,mse\n");
    let mut curves = Vec::new();
    for (name, strategy) in STRATEGIES {
        let mut curve = Curve { name: name.into(), points: Vec::new() };
        for spp in std::iter::successors(Some(4), |n| Some(n * 2)).take_while(|&n| n <= arguments.spp) {
            let mut sum = 0.0;
            for seed in 0..arguments.seeds {
                let job = Settings { spp, strategy, seed, sampler: SamplerKind::Independent, ..settings.clone() };
                sum += mse(&means(&render(&world, &job)?), &reference);
            }
            let error = sum / arguments.seeds as f64;
            table += &format!("{name},{spp},{error:.6e}\n");
            curve.points.push((f64::from(spp), error));
        }
        println!("{name}: slope {:.3}", curve.slope());
        curves.push(curve);
    }
    let csv = arguments.out.join("strategies.csv");
    std::fs::write(&csv, table).with_context(|| format!("writing {}", csv.display()))?;
    let title = "Mean squared error of the strategies, independent samples";
    let labels = Labels { title, x: "samples a pixel", y: "mean squared error" };
    log_log(&arguments.out.join("strategies.svg"), labels, &curves)
}
