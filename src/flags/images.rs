//! Flags about images that are there, and about scenes that are not rendered.

use super::{IsaFlags, StyleFlags, cores, values};
use crate::info::Info;
use crate::merge::Merge;
use crate::output::Output;
use crate::verify::Verify;
use clap::Args;
use std::path::PathBuf;
use tilecast_proto::limits::THREADS_MAX;

pub const MERGE_EXAMPLES: &str = "\
Example: half of the samples on each of two machines
  tilecast render scene.xml --samples 0..2048 -o a.exr
  tilecast render scene.xml --samples 2048..4096 -o b.exr
  tilecast merge a.film b.film -o image.exr              the bits of --spp 4096";

#[derive(Args)]
pub struct MergeFlags {
    /// Films, or images with their films beside them
    #[arg(required = true, value_name = "FILM")]
    films: Vec<PathBuf>,
    /// The image
    #[arg(short, long, value_name = "OUT.exr")]
    output: PathBuf,
    /// Also writes OUT.png: sRGB, no exposure
    #[arg(long)]
    preview: bool,
    /// Does not keep OUT.film, the exact sums (some 110 bytes a pixel)
    #[arg(long)]
    no_film: bool,
    #[command(flatten)]
    style: StyleFlags,
}

impl MergeFlags {
    pub fn ready(self) -> anyhow::Result<Merge> {
        let Self { films, output, preview, no_film, style } = self;
        Ok(Merge { films, output: Output::check(output, preview, !no_film)?, style: style.ready() })
    }
}

#[derive(Args)]
pub struct VerifyFlags {
    /// The image; the film beside it is looked at, too, if it is there
    image: PathBuf,
    /// The scene it claims to be of
    scene: PathBuf,
    /// Sets a value that the scene names $NAME, above its own default
    #[arg(short = 'D', value_name = "NAME=VALUE", value_parser = values::define)]
    defines: Vec<(String, String)>,
    /// Replaces or leaves out what tilecast does not have, as when the image was rendered
    #[arg(long)]
    substitute: bool,
    /// The share of the image that is rendered again
    #[arg(long, value_name = "SHARE", default_value_t = 0.01, value_parser = values::share)]
    share: f64,
    /// Chooses which; without it nobody can know before
    #[arg(long, value_name = "S")]
    seed: Option<u64>,
    /// Threads that trace [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(THREADS_MAX)))]
    threads: Option<u32>,
    #[command(flatten)]
    isa: IsaFlags,
    /// One JSON object
    #[arg(long)]
    json: bool,
}

impl VerifyFlags {
    pub fn ready(self) -> anyhow::Result<Verify> {
        let Self { image, scene, defines, substitute, share, seed, threads, isa, json } = self;
        let threads = threads.unwrap_or_else(cores);
        Ok(Verify { image, scene, defines, substitute, share, seed, threads, isa: isa.ready()?, json })
    }
}

#[derive(Args)]
pub struct InfoFlags {
    /// Mitsuba 3 XML, or a bare Wavefront OBJ
    scene: PathBuf,
    /// Sets a value that the scene names $NAME, above its own default
    #[arg(short = 'D', value_name = "NAME=VALUE", value_parser = values::define)]
    defines: Vec<(String, String)>,
    /// Replaces or leaves out what tilecast does not have, and lists it, instead of failing
    #[arg(long)]
    substitute: bool,
    /// One JSON object
    #[arg(long)]
    json: bool,
}

impl InfoFlags {
    pub fn ready(self) -> Info {
        let Self { scene, defines, substitute, json } = self;
        Info { scene, defines, substitute, json }
    }
}
