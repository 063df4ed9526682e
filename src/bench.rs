//! `tilecast bench`: error against time and samples, with a peer's beside it if wanted.
//!
//! Every render is a process of this very program, so what is timed is what people run: from the submission of the job to the
//! finished film, on one process or many. Peers render in turn with it, so that both meet the same machine.

mod curves;
mod peer;

use crate::output::writable;
use crate::read;
use anyhow::{Context, bail};
use curves::{Row, Table};
use peer::Mitsuba;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use tilecast_measure::image::{Image, comparable};
use tilecast_measure::metrics::metrics;

/// What to measure.
pub struct Bench {
    /// Scene files.
    pub scenes: Vec<PathBuf>,
    /// Their references, in the same order.
    pub references: Vec<PathBuf>,
    /// The fewest samples a pixel; counts double from there.
    pub spp_min: u32,
    /// The most.
    pub spp_max: u32,
    /// Renders of each count.
    pub seeds: u32,
    /// Beginning of the names of what is written.
    pub out: PathBuf,
    /// Whether Mitsuba renders in turn.
    pub peer: bool,
    /// The Python that has Mitsuba.
    pub python: String,
    /// Flags for each of our renders.
    pub flags: Vec<String>,
}

/// Name of our own curve.
const OURS: &str = "tilecast";

/// Measures, prints and writes.
///
/// # Errors
/// References that do not fit, renders that fail, files that cannot be written.
pub async fn run(bench: Bench) -> anyhow::Result<()> {
    tokio::task::spawn_blocking(move || measure(&bench)).await.context("measuring panicked")?
}

fn measure(bench: &Bench) -> anyhow::Result<()> {
    let out = |extension: &str| {
        let mut name = bench.out.clone().into_os_string();
        name.push(extension);
        writable(PathBuf::from(name))
    };
    let (csv, json) = (out(".csv")?, out(".json")?);
    let mut table = Table::default();
    for (scene, reference) in bench.scenes.iter().zip(&bench.references) {
        let name = scene_name(scene);
        rows(bench, scene, &name, &read::image(reference)?, &mut table)?;
        for (extension, x) in [("time", curves::X::Seconds), ("spp", curves::X::Samples)] {
            for format in ["svg", "png"] {
                table.plot(&name, x, &out(&format!("-{name}-{extension}.{format}"))?)?;
            }
        }
    }
    std::fs::write(&csv, table.csv()).with_context(|| format!("cannot write {}", csv.display()))?;
    std::fs::write(&json, table.json()?).with_context(|| format!("cannot write {}", json.display()))?;
    print!("{}", table.summary());
    Ok(())
}

/// Renders a scene at all sample counts and adds what it took.
fn rows(bench: &Bench, scene: &Path, name: &str, reference: &Image, table: &mut Table) -> anyhow::Result<()> {
    let folder = tempfile::tempdir().context("no temporary folder can be had")?;
    let image = folder.path().join("image.exr");
    let mut mitsuba = bench.peer.then(|| Mitsuba::start(&bench.python, scene)).transpose()?;
    for spp in std::iter::successors(Some(bench.spp_min), |n| n.checked_mul(2)).take_while(|&n| n <= bench.spp_max) {
        let (mut ours, mut theirs) = (Vec::new(), Vec::new());
        if let Some(mitsuba) = &mut mitsuba {
            // Kernels are compiled at the first render of each size.
            mitsuba.render(spp, 0, &image)?;
        }
        for seed in 1..=bench.seeds {
            ours.push((render(scene, spp, seed, &image, &bench.flags)?, read::image(&image)?));
            if let Some(mitsuba) = &mut mitsuba {
                theirs.push((mitsuba.render(spp, seed, &image)?, read::image(&image)?));
            }
        }
        for (renderer, renders) in [(OURS, ours), (peer::NAME, theirs)] {
            if !renders.is_empty() {
                let row = row(name, renderer, spp, &renders, reference)?;
                eprintln!("{}", row.line());
                table.rows.push(row);
            }
        }
    }
    Ok(())
}

/// Median time and mean errors of renders that differ by their seeds.
fn row(scene: &str, renderer: &str, spp: u32, renders: &[(f64, Image)], reference: &Image) -> anyhow::Result<Row> {
    let mut seconds: Vec<f64> = renders.iter().map(|(seconds, _)| *seconds).collect();
    seconds.sort_by(f64::total_cmp);
    let (mut mse, mut relmse) = (0.0, 0.0);
    for (_, image) in renders {
        comparable(image, reference).with_context(|| format!("{renderer}'s image does not fit the reference"))?;
        let found = metrics(image, reference);
        mse += found.mse / renders.len() as f64;
        relmse += found.relmse / renders.len() as f64;
    }
    let seconds = seconds[seconds.len() / 2];
    Ok(Row { scene: scene.to_owned(), renderer: renderer.to_owned(), spp, seconds, mse, relmse })
}

/// One render of ours; the seconds from submission to film.
fn render(scene: &Path, spp: u32, seed: u32, image: &Path, flags: &[String]) -> anyhow::Result<f64> {
    let program = std::env::current_exe().context("this program's own file cannot be found")?;
    let mut command = Command::new(program);
    command.arg("render").arg(scene).args(flags).args(["--no-film", "--json"]).arg("-o").arg(image);
    command.args(["--spp", &spp.to_string(), "--seed", &seed.to_string()]);
    let output = command.stdin(Stdio::null()).output().context("rendering could not be started")?;
    if !output.status.success() {
        bail!("a render failed: {}", String::from_utf8_lossy(&output.stderr).trim());
    }
    let said = String::from_utf8_lossy(&output.stdout);
    let finished = said.lines().last().and_then(|line| serde_json::from_str::<serde_json::Value>(line).ok());
    finished.and_then(|event| event["seconds"].as_f64()).context("a render did not say how long it took")
}

/// What to call a scene: its folder if its file is called `scene`.
fn scene_name(scene: &Path) -> String {
    let folder = scene.parent().and_then(Path::file_name);
    let stem = scene.file_stem().filter(|stem| *stem != "scene").or(folder).or(scene.file_stem());
    stem.map_or_else(|| "scene".to_owned(), |name| name.to_string_lossy().into_owned())
}
