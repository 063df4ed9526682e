//! Do error bars hold? For each scene and number of samples: how often the 95 % interval of a value holds the truth, and whether the
//! picture's own error estimate is the true one, over seeds. docs/accuracy.md has what it printed and drew.

use anyhow::Context;
use clap::Parser;
use std::path::{Path, PathBuf};
use tilecast_bench::{compile, render, small};
use tilecast_core::film::{Film, REPLICATES};
use tilecast_core::settings::{Film as FilmSettings, Filter, Settings};
use tilecast_measure::plot::{Curve, Labels, log_log};
use tilecast_measure::stats::two_sided_quantile;

/// A value whose interval holds in fewer of the seeds than this is called skewed.
const SKEWED: f64 = 0.8;
/// How often intervals of these levels should miss; the table has the second.
const MISSES: [f64; 6] = [0.01, 0.05, 0.1, 0.2, 0.35, 0.5];
const OF_TABLE: usize = 1;

/// Prints CSV: scene,width,height,spp,seeds,coverage,claimed_error,true_error,claimed_over_true,intervals_held,skewed_values,values; and
/// to stderr, for the most samples, which pixels have skewed values
#[derive(Parser)]
struct Arguments {
    /// Scenes
    scenes: Vec<PathBuf>,
    /// Samples a pixel
    #[arg(long, value_delimiter = ',', default_value = "256")]
    spp: Vec<u32>,
    /// The reference has so many times as many as the most of them
    #[arg(long, default_value_t = 100)]
    factor: u32,
    /// Renders
    #[arg(long, default_value_t = 20)]
    seeds: u64,
    /// Pixels of the image, about
    #[arg(long, default_value_t = 300)]
    pixels: u32,
    /// Draws three plots into this folder
    #[arg(long)]
    plots: Option<PathBuf>,
}

/// What the renders of a scene at one number of samples say.
struct Row {
    spp: u32,
    /// In what share of the cases an interval missed the truth, for each level.
    missed: [f64; MISSES.len()],
    claimed: f64,
    actual: f64,
    intervals: u32,
    /// Value by value.
    skewed: Vec<bool>,
}

impl Row {
    fn show_skewed(&self, width: usize) {
        for row in self.skewed.chunks(3 * width) {
            let dot = |values: &[bool]| if values.contains(&true) { '#' } else { '.' };
            eprintln!("{}", row.chunks(3).map(dot).collect::<String>());
        }
    }
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    println!(
        "scene,width,height,spp,seeds,coverage,claimed_error,true_error,claimed_over_true,intervals_held,skewed_values,values"
    );
    let mut scenes = Vec::new();
    for scene in &arguments.scenes {
        let name = scene.parent().and_then(|p| p.file_name()).context("a scene without a folder")?.to_string_lossy();
        scenes.push((name.to_string(), measured(scene, &name, &arguments)?));
    }
    arguments.plots.map_or(Ok(()), |folder| draw(&folder, &scenes))
}

/// Renders a scene and prints its rows.
fn measured(scene: &Path, name: &str, arguments: &Arguments) -> anyhow::Result<Vec<Row>> {
    let (world, settings) = compile(scene, &[])?;
    let crop = small(&settings, arguments.pixels);
    let film = FilmSettings { width: crop.x1, height: crop.y1, crop, filter: Filter::Box };
    let most = arguments.spp.iter().max().context("no number of samples")?;
    let job = Settings { film, spp: most * arguments.factor, seed: 1 << 32, ..settings };
    let truth = values(&render(&world, &job)?);
    let mut rows = Vec::new();
    for &spp in &arguments.spp {
        let films = (0..arguments.seeds).map(|seed| render(&world, &Settings { spp, seed, ..job.clone() }));
        let row = row(spp, &films.collect::<Result<Vec<_>, _>>()?, &truth)?;
        println!(
            "{name},{},{},{spp},{},{:.4},{:.4e},{:.4e},{:.4},{},{},{}",
            crop.x1,
            crop.y1,
            arguments.seeds,
            1.0 - row.missed[OF_TABLE],
            row.claimed,
            row.actual,
            row.claimed / row.actual,
            row.intervals,
            row.skewed.iter().filter(|&&skewed| skewed).count(),
            truth.len()
        );
        if spp == *most {
            row.show_skewed(crop.x1 as usize);
        }
        rows.push(row);
    }
    Ok(rows)
}

fn row(spp: u32, films: &[Film], truth: &[[f64; 2]]) -> anyhow::Result<Row> {
    let t = MISSES.map(|miss| two_sided_quantile(miss, (REPLICATES - 1) as f64));
    let mut missed = vec![[0u64; MISSES.len()]; truth.len()];
    let (mut claimed, mut squares, mut intervals) = (0.0, 0.0, 0);
    for film in films {
        let error = film.relative_error(u64::MAX).context("a black picture")?;
        let (mut this, mut bright) = (0.0, 0.0);
        for (missed, ([mean, variance], [truth, _])) in missed.iter_mut().zip(values(film).into_iter().zip(truth)) {
            for (missed, t) in missed.iter_mut().zip(t) {
                *missed += u64::from((mean - truth).abs() > t * variance.sqrt());
            }
            this += (mean - truth).powi(2);
            bright += mean * mean;
        }
        claimed += f64::from(error.value).powi(2);
        squares += this / bright;
        let actual = (this / bright).sqrt();
        intervals += u32::from((f64::from(error.low)..f64::from(error.high)).contains(&actual));
    }
    let seeds = films.len() as f64;
    let share = |level: usize| missed.iter().map(|m| m[level]).sum::<u64>() as f64 / (seeds * truth.len() as f64);
    Ok(Row {
        spp,
        missed: std::array::from_fn(share),
        claimed: (claimed / seeds).sqrt(),
        actual: (squares / seeds).sqrt(),
        intervals,
        skewed: missed.iter().map(|m| (m[OF_TABLE] as f64) > (1.0 - SKEWED) * seeds).collect(),
    })
}

/// Mean and variance of every value.
fn values(film: &Film) -> Vec<[f64; 2]> {
    let w = film.window;
    (w.y0..w.y1)
        .flat_map(|y| (w.x0..w.x1).map(move |x| film.estimate(x, y)))
        .flat_map(|e| [0, 1, 2].map(|c| [f64::from(e.mean[c]), f64::from(e.variance[c])]))
        .collect()
}

/// What is drawn of a scene's rows.
type Points<'a> = &'a dyn Fn(&[Row]) -> Vec<(f64, f64)>;

fn draw(folder: &Path, scenes: &[(String, Vec<Row>)]) -> anyhow::Result<()> {
    let curves = |ideal: Option<Curve>, of: Points| -> Vec<Curve> {
        scenes.iter().map(|(name, rows)| Curve { name: name.clone(), points: of(rows) }).chain(ideal).collect()
    };
    let most = |rows: &[Row]| rows.iter().max_by_key(|row| row.spp).map_or([0.0; MISSES.len()], |row| row.missed);
    let ideal = |points: Vec<(f64, f64)>| Some(Curve { name: "as it should be".into(), points });
    let coverage = curves(ideal(MISSES.map(|m| (m, m)).to_vec()), &|rows| MISSES.into_iter().zip(most(rows)).collect());
    let labels = Labels {
        title: "How often intervals miss the truth (most samples)",
        x: "one minus the interval's level",
        y: "share of values outside",
    };
    log_log(&folder.join("accuracy-coverage.svg"), labels, &coverage)?;

    let all = || scenes.iter().flat_map(|(_, rows)| rows).map(|row| row.actual);
    let ends = [all().fold(f64::INFINITY, f64::min), all().fold(0.0, f64::max)];
    let claims =
        curves(ideal(ends.map(|x| (x, x)).to_vec()), &|rows| rows.iter().map(|r| (r.actual, r.claimed)).collect());
    let labels =
        Labels { title: "The error that pictures claim", x: "true relative error", y: "claimed relative error" };
    log_log(&folder.join("accuracy-claims.svg"), labels, &claims)?;

    let convergence = curves(None, &|rows| rows.iter().map(|r| (f64::from(r.spp), r.actual)).collect());
    let labels = Labels { title: "Error over samples", x: "samples a pixel", y: "true relative error" };
    log_log(&folder.join("accuracy-convergence.svg"), labels, &convergence)
}
