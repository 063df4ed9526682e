//! Flags about what is rendered, until when, and where the image goes.

use super::{IsaFlags, StyleFlags, Task, cores, replaying, values};
use crate::output::Output;
use crate::picture::{Overrides, Picture};
use crate::render::{Backend, Render};
use crate::replay::Replay;
use crate::seek::Goal;
use anyhow::Context;
use clap::Args;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tilecast_core::film::file::Target;
use tilecast_core::settings::Window;
use tilecast_proto::limits::{THREADS_MAX, TILE_SIDE_MAX};
use values::{IntegratorName, OffsetsName, SamplerName, SavingName, StrategyName};

pub const RENDER_EXAMPLES: &str = "\
Examples:
  tilecast render scene.xml                              writes scene.exr
  tilecast render scene.xml --spp 4096 -o reference.exr  a quieter one
  tilecast render scene.xml --resume reference.exr --spp 65536   goes on with it: the bits of a fresh one
  tilecast render scene.xml -D albedo=0.8 --preview      sets a <default>; also writes scene.png
  tilecast render scene.xml --strategy cosine --spp 16   where directions come from
  tilecast render model.obj --size 640x480               a bare model, under an even sky
  tilecast render scene.xml --crop 100,100,164,164       a part: the same bits as in the whole
  tilecast render scene.xml --view                       a page that shows it converge
  tilecast render scene.xml --workers 4                  four worker processes: the same bits
  tilecast render scene.xml --pixel 12,34 --sample 5     the path of one sample, vertex by vertex";

/// Worker processes on one machine; more have no cores to run on.
pub const CHILDREN_MAX: u32 = 1024;

/// The scene, and how it is rendered.
#[derive(Args)]
pub struct PictureFlags {
    /// Mitsuba 3 XML, or a bare Wavefront OBJ
    pub scene: PathBuf,
    /// Sets a value that the scene names $NAME, above its own default
    #[arg(short = 'D', value_name = "NAME=VALUE", value_parser = values::define)]
    defines: Vec<(String, String)>,
    /// Replaces or leaves out what tilecast does not have, and lists it, instead of failing
    #[arg(long)]
    substitute: bool,
    /// Samples a pixel [default: the scene's]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    spp: Option<u32>,
    /// Chooses among equally good sets of random numbers [default: the scene's]
    #[arg(long, value_name = "S")]
    seed: Option<u64>,
    /// Pixels of the whole picture; undoes the scene's crop [default: the scene's]
    #[arg(long, value_name = "WxH", value_parser = values::size)]
    size: Option<[u32; 2]>,
    /// The part to render, in pixels of the whole picture; X1 and Y1 are behind its end
    #[arg(long, value_name = "X0,Y0,X1,Y1", value_parser = values::crop)]
    crop: Option<Window>,
    /// Which light transport is counted [default: the scene's]
    #[arg(long, value_name = "NAME")]
    integrator: Option<IntegratorName>,
    /// Where random directions come from [default: mis]
    #[arg(long, value_name = "NAME")]
    strategy: Option<StrategyName>,
    /// Where random numbers come from [default: the scene's]
    #[arg(long, value_name = "NAME")]
    sampler: Option<SamplerName>,
    /// Switches off what saves work without changing the expected image, to measure what it gains; may be repeated
    #[arg(long, value_name = "NAME")]
    without: Vec<SavingName>,
    /// Where rays leave surfaces: `mitsuba` is for comparisons with its images [default: exact]
    #[arg(long, value_name = "NAME")]
    offsets: Option<OffsetsName>,
    /// Goes on with an image, by the film beside it, up to --spp; the result has the bits of a fresh render. Settings are the
    /// image's [writes to it, unless -o says otherwise]
    #[arg(long, value_name = "IMAGE.exr", requires = "spp", conflicts_with = "samples")]
    pub resume: Option<PathBuf>,
    /// Renders samples A to B-1 of each pixel alone, for `tilecast merge`; --spp says of how many in all [default: B]
    #[arg(long, value_name = "A..B", value_parser = values::samples)]
    samples: Option<Range<u32>>,
    /// Longest path: 1 emitters alone, 2 direct light, -1 no limit [default: the scene's]
    #[arg(long, value_name = "N", value_parser = values::max_depth, allow_negative_numbers = true)]
    max_depth: Option<values::MaxDepth>,
}

impl PictureFlags {
    pub fn ready(self) -> Picture {
        let overrides = Overrides {
            spp: self.spp,
            seed: self.seed,
            size: self.size,
            crop: self.crop,
            integrator: self.integrator.map(Into::into),
            strategy: self.strategy.map(Into::into),
            sampler: self.sampler.map(Into::into),
            without: (!self.without.is_empty()).then(|| values::without(&self.without)),
            offsets: self.offsets.map(Into::into),
            max_depth: self.max_depth.map(|depth| depth.0),
        };
        let replay = replaying::command(std::env::args_os().map(|arg| arg.to_string_lossy().into_owned()));
        let Self { scene, defines, substitute, resume, samples, .. } = self;
        Picture { scene, defines, substitute, overrides, resume, samples, replay }
    }
}

/// Where the image goes.
#[derive(Args)]
pub struct OutputFlags {
    /// The image [default: the scene's name with .exr, in this folder]
    #[arg(short, long, value_name = "OUT.exr")]
    output: Option<PathBuf>,
    /// Also writes OUT.png: sRGB, no exposure
    #[arg(long)]
    preview: bool,
    /// Refreshes OUT.exr, OUT.png and OUT.error.png, a picture of the errors, after every round
    #[arg(long)]
    previews: bool,
    /// Does not keep OUT.film, the exact sums (some 110 bytes a pixel, however many samples), without which --resume and
    /// `tilecast merge` cannot go on with the image, nor OUT.json, which says who rendered what
    #[arg(long)]
    no_film: bool,
    /// Side of a tile in pixels; the image is the same for all
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(TILE_SIDE_MAX)))]
    pub tile: Option<u32>,
    #[command(flatten)]
    pub style: StyleFlags,
}

impl OutputFlags {
    /// The checked way to the image: that it can be written is known before anything is rendered.
    pub fn ready(self, scene: &Path, resume: Option<&Path>) -> anyhow::Result<Output> {
        let path = match (self.output, resume) {
            (Some(path), _) => path,
            (None, Some(image)) => image.to_owned(),
            (None, None) => {
                let stem = scene.file_stem().context("the scene's path has no file name; name the image with -o")?;
                let mut name = stem.to_owned();
                name.push(".exr");
                PathBuf::from(name)
            }
        };
        let output = Output::check(path, self.preview, !self.no_film)?;
        if self.previews { output.refreshed() } else { Ok(output) }
    }
}

/// When an image is done, if not at a number of samples.
#[derive(Args)]
pub struct GoalFlags {
    /// Renders until the relative error of the image is E (0.02: 2 %), with more samples where it is noisier; unbiased, and
    /// the same bits for any number of workers
    #[arg(long, value_name = "E", value_parser = values::error, conflicts_with_all = ["spp", "samples", "resume"])]
    target_error: Option<f32>,
    /// Likewise, until 95 % of the picture are known to E, relative to the pixels around
    #[arg(long, value_name = "E", value_parser = values::error, conflicts_with_all = ["target_error", "spp", "samples", "resume"])]
    target_pixel_error: Option<f32>,
    /// Renders for so long, such as 90s, 30m or 4h
    #[arg(long, value_name = "TIME", value_parser = values::time, conflicts_with_all = ["target_error", "target_pixel_error", "spp", "samples", "resume", "tile"])]
    time: Option<Duration>,
}

impl GoalFlags {
    pub fn ready(&self) -> Goal {
        match (self.target_error, self.target_pixel_error, self.time) {
            (Some(error), _, _) => Goal::Error(Target::Image(error)),
            (_, Some(error), _) => Goal::Error(Target::Pixels(error)),
            (_, _, Some(time)) => Goal::Time(time),
            (None, None, None) => Goal::Samples,
        }
    }
}

#[derive(Args)]
pub struct RenderFlags {
    #[command(flatten)]
    picture: PictureFlags,
    #[command(flatten)]
    goal: GoalFlags,
    #[command(flatten)]
    output: OutputFlags,
    /// Threads that trace; with --workers, of each of them [default: all cores, divided among the workers]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(THREADS_MAX)))]
    threads: Option<u32>,
    /// Traces in N worker processes instead of this one
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(CHILDREN_MAX)))]
    workers: Option<u32>,
    /// Keeps what is done in this folder: when the render ends before the image is there (kill -9, power), the same command
    /// goes on with it [costs writes of some 110 bytes a pixel and unit of work]
    #[arg(long, value_name = "DIR")]
    state: Option<PathBuf>,
    /// Serves a page that shows the image as it converges, on this machine alone [default: a free port of 127.0.0.1]
    #[arg(long, value_name = "ADDR", num_args = 0..=1, require_equals = true, default_missing_value = "127.0.0.1:0")]
    view: Option<String>,
    /// Sends the image as it converges to the viewer tev there [default port: 14158]
    #[arg(long, value_name = "HOST:PORT", value_parser = values::tev)]
    tev: Option<String>,
    #[command(flatten)]
    isa: IsaFlags,
    /// Traces one sample of this pixel again and prints its path; writes no image
    #[arg(long, value_name = "X,Y", value_parser = values::pixel, requires = "sample", conflicts_with_all = ["output", "preview", "json"])]
    pixel: Option<[u32; 2]>,
    /// Which sample of --pixel
    #[arg(long, value_name = "I", requires = "pixel")]
    sample: Option<u32>,
}

impl RenderFlags {
    pub fn ready(self) -> anyhow::Result<Task> {
        if let (Some(pixel), Some(sample)) = (self.pixel, self.sample) {
            return Ok(Task::Replay(Replay { picture: self.picture.ready(), pixel, sample }));
        }
        let backend = match self.workers {
            None => Backend::Here { threads: self.threads.unwrap_or_else(cores) },
            Some(workers) => {
                let threads = self.threads.unwrap_or_else(|| (cores() / workers).max(1));
                Backend::Processes { workers, threads }
            }
        };
        let (tile, style) = (self.output.tile, self.output.style.ready());
        let output = self.output.ready(&self.picture.scene, self.picture.resume.as_deref())?;
        let (picture, goal, isa) = (self.picture.ready(), self.goal.ready(), self.isa.ready()?);
        let (state, view, tev) = (self.state, self.view, self.tev);
        Ok(Task::Render(Render { picture, goal, output, tile, backend, state, view, tev, isa, style }))
    }
}
