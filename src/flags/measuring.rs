//! The flags of `compare` and `bench`.

use super::cluster::CLIENTS;
use super::rendering::{CHILDREN_MAX, PictureFlags};
use super::security::ConnectFlags;
use super::{IsaFlags, StyleFlags, Usage};
use crate::bench::Bench;
use crate::compare::Compare;
use crate::scale::Scale;
use clap::{Args, ValueEnum};
use std::num::NonZeroU32;
use std::path::PathBuf;

pub const BENCH_EXAMPLES: &str = "\
Examples:
  tilecast render scene.xml --spp 65536 --seed 99 -o reference.exr
  tilecast bench scene.xml --reference reference.exr                   writes bench.csv, .json and plots
  tilecast bench scene.xml --reference reference.exr --peer mitsuba    Mitsuba renders in turn
  tilecast bench a.xml b.xml --reference a.exr --reference b.exr -- --workers 4 --sampler independent";

#[derive(Args)]
pub struct CompareFlags {
    /// An image: OpenEXR with channels R, G, B, or PNG, HDR, JPEG, TGA
    image: PathBuf,
    /// What it should be
    reference: PathBuf,
    /// Draws the signed difference: red where the image is brighter, blue where it is darker
    #[arg(long, value_name = "OUT.png")]
    difference: Option<PathBuf>,
    /// One JSON object
    #[arg(long)]
    json: bool,
}

impl CompareFlags {
    pub fn ready(self) -> Compare {
        let Self { image, reference, difference, json } = self;
        Compare { image, reference, difference, json }
    }
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Peer {
    /// Mitsuba 3, by Python
    Mitsuba,
}

#[derive(Args)]
pub struct BenchFlags {
    /// Mitsuba 3 XML, or bare Wavefront OBJ
    #[arg(required = true)]
    scenes: Vec<PathBuf>,
    /// A scene's reference, of far more samples; one for each scene, in their order
    #[arg(long, value_name = "REF.exr", required = true)]
    reference: Vec<PathBuf>,
    /// The fewest samples a pixel; counts double from there
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..))]
    spp_min: u32,
    /// The most samples a pixel
    #[arg(long, value_name = "N", default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..))]
    spp_max: u32,
    /// Renders of each count, whose errors are averaged
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    seeds: u32,
    /// Beginning of the names of the table and the plots
    #[arg(long, value_name = "PREFIX", default_value = "bench")]
    out: PathBuf,
    /// Another renderer, in turn with this one on the same files
    #[arg(long, value_name = "NAME")]
    peer: Option<Peer>,
    /// The Python that has the peer
    #[arg(long, value_name = "PATH", default_value = "python3")]
    python: String,
    /// Flags for each render of ours: --workers, --size, --sampler…
    #[arg(last = true, value_name = "RENDER FLAGS")]
    flags: Vec<String>,
}

impl BenchFlags {
    pub fn ready(self) -> anyhow::Result<Bench> {
        let Self { scenes, reference: references, spp_min, spp_max, seeds, out, peer, python, flags } = self;
        if scenes.len() != references.len() {
            let (scenes, references) = (scenes.len(), references.len());
            return Err(Usage(format!("{scenes} scenes need as many --reference images, not {references}")).into());
        }
        Ok(Bench { scenes, references, spp_min, spp_max, seeds, out, peer: peer.is_some(), python, flags })
    }
}

pub const SCALE_EXAMPLES: &str = "\
Examples:
  tilecast scale scene.xml --workers 1,2,4,8 --spp 256          writes scale.csv, .json, .md and .svg
  tilecast scale scene.xml --workers 1,2 --simulate 10000       and goes on with the real ledger on simulated time
  tilecast scale scene.xml --connect 10.0.0.1:7878 --workers 1,4,16   of those that there are";

#[derive(Args)]
pub struct ScaleFlags {
    #[command(flatten)]
    picture: PictureFlags,
    /// Numbers of workers, one after another: processes to start here (1,2 unless given), or some of those of --connect (all unless given)
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', value_parser = clap::value_parser!(u32).range(1..))]
    workers: Option<Vec<u32>>,
    /// Threads of each
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=i64::from(tilecast_proto::limits::THREADS_MAX)))]
    threads: u32,
    /// Renders with each number, in turn
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    repeats: u32,
    /// Simulates more workers than there are, up to N
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=10_000))]
    simulate: Option<u32>,
    /// Megabytes a second that the coordinator's line carries in the simulation
    #[arg(long, value_name = "MB/s", default_value_t = 125.0)]
    line: f64,
    /// Measures the workers of a coordinator instead of processes here
    #[arg(long, value_name = "ADDR", conflicts_with = "threads")]
    connect: Option<String>,
    /// Folder of certificates for --connect
    #[arg(long, value_name = "DIR", requires = "connect")]
    certs: Option<PathBuf>,
    #[command(flatten)]
    isa: IsaFlags,
    /// Beginning of the names of what is written
    #[arg(long, value_name = "PREFIX", default_value = "scale")]
    out: PathBuf,
    #[command(flatten)]
    style: StyleFlags,
}

impl ScaleFlags {
    pub fn ready(self) -> anyhow::Result<Scale> {
        let Self { workers, threads, repeats, simulate, line, out, .. } = self;
        if !(line > 0.0 && line.is_finite()) {
            return Err(Usage(format!("--line {line}: megabytes a second, above 0")).into());
        }
        let connector =
            self.connect.map(|address| ConnectFlags::to(address, self.certs).ready(&CLIENTS)).transpose()?;
        let workers = match (workers, &connector) {
            (Some(workers), Some(_)) => workers.into_iter().map(NonZeroU32::new).collect(),
            (None, Some(_)) => vec![None],
            (workers, None) => {
                let workers = workers.unwrap_or_else(|| vec![1, 2]);
                if let Some(many) = workers.iter().find(|&&workers| workers > CHILDREN_MAX) {
                    return Err(Usage(format!("--workers {many}: at most {CHILDREN_MAX} processes here")).into());
                }
                workers.into_iter().map(NonZeroU32::new).collect()
            }
        };
        let (picture, isa, style) = (self.picture.ready(), self.isa.ready()?, self.style.ready());
        Ok(Scale { picture, workers, threads, repeats, simulate, line, connector, isa, out, style })
    }
}
