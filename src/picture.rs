//! A scene file and what the command line changes of it, made into what is rendered.

use crate::flags::Usage;
use crate::kept::{Kept, difference};
use crate::merge::film_of;
use crate::report::Report;
use anyhow::bail;
use std::collections::HashMap;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tilecast_core::film::file::Head;
use tilecast_core::film::ranges::Ranges;
use tilecast_core::load::{LoadOptions, Loaded, Note, load};
use tilecast_core::scene::{Scene, SceneBlobs};
use tilecast_core::settings::{IntegratorKind, Offsets, SamplerKind, Settings, Strategy, Window, Without};

/// What is to be rendered.
#[derive(Clone, Debug)]
pub struct Picture {
    /// The scene's file.
    pub scene: PathBuf,
    /// Values for its `$names`.
    pub defines: Vec<(String, String)>,
    /// Whether what tilecast does not have is replaced; else it is an error.
    pub substitute: bool,
    /// What is to be otherwise than the file says.
    pub overrides: Overrides,
    /// The image that is gone on with.
    pub resume: Option<PathBuf>,
    /// These samples alone.
    pub samples: Option<Range<u32>>,
    /// The command that renders this picture here; with `--pixel` and `--sample` it replays a sample.
    pub replay: String,
}

/// Settings that win over the scene file's, where there is a value.
#[derive(Clone, Debug, Default)]
pub struct Overrides {
    /// Samples a pixel.
    pub spp: Option<u32>,
    /// Seed.
    pub seed: Option<u64>,
    /// Width and height of the whole picture; the crop is reset to all of it.
    pub size: Option<[u32; 2]>,
    /// The part to render.
    pub crop: Option<Window>,
    /// Light transport.
    pub integrator: Option<IntegratorKind>,
    /// Directions.
    pub strategy: Option<Strategy>,
    /// Random numbers.
    pub sampler: Option<SamplerKind>,
    /// What saves work and shall not.
    pub without: Option<Without>,
    /// Where rays leave surfaces.
    pub offsets: Option<Offsets>,
    /// Longest path, or none.
    pub max_depth: Option<Option<u32>>,
}

/// A picture that can be rendered.
pub struct Ready {
    /// The scene's digest, manifest and parts.
    pub blobs: SceneBlobs,
    /// How it is rendered, checked.
    pub settings: Settings,
    /// Which samples.
    pub samples: Range<u32>,
    /// Those that there are already.
    pub base: Option<Arc<Kept>>,
    /// What the scene's author should know.
    pub notes: Vec<Note>,
    /// What was replaced or left out, if that was allowed.
    pub substitutions: Vec<Note>,
    /// See [`Picture::replay`].
    pub replay: String,
}

impl Ready {
    /// Tells of replacements and of what has no effect.
    pub fn tell(&self, report: &mut Report) {
        gathered(&self.substitutions).iter().for_each(|text| report.substituted(text));
        gathered(&self.notes).iter().for_each(|note| report.note(note));
    }
}

/// What is said of thousands of objects, once, with the first of its places; `tilecast info` lists all.
fn gathered(notes: &[Note]) -> Vec<String> {
    let mut times = HashMap::new();
    notes.iter().for_each(|note| *times.entry(note.text.as_str()).or_insert(0) += 1);
    let mut gathered = Vec::new();
    for note in notes {
        match times.remove(note.text.as_str()) {
            Some(1) => gathered.push(note.to_string()),
            Some(count) => gathered.push(format!("{note} (and the same {} times more)", count - 1)),
            None => {}
        }
    }
    gathered
}

impl Picture {
    /// Loads the scene, applies the overrides and hashes the whole. Blocks. The scene comes apart, so that it can be let go of.
    ///
    /// # Errors
    /// What is wrong with the scene's files, or overrides that do not fit it.
    pub fn load(&self) -> anyhow::Result<(Scene, Ready)> {
        let options = LoadOptions { defines: self.defines.clone(), substitute: self.substitute };
        let Loaded { scene, mut settings, notes, substitutions } = load(&self.scene, &options)?;
        let base = self.resume.as_ref().map(|path| Kept::read(&film_of(path))).transpose()?;
        if let Some(base) = &base {
            settings = base.head.settings.clone();
        }
        self.overrides.apply(&mut settings)?;
        let samples = match (&self.samples, self.overrides.spp) {
            (Some(samples), None) => {
                settings.spp = samples.end;
                samples.clone()
            }
            (Some(samples), Some(spp)) if samples.end > spp => {
                let Range { start, end } = samples;
                return Err(Usage(format!("--samples {start}..{end} goes beyond --spp {spp}")).into());
            }
            (Some(samples), Some(_)) => samples.clone(),
            (None, _) => 0..settings.spp,
        };
        settings.validate()?;
        let blobs = scene.blobs();
        let samples = match (&base, &self.resume) {
            (Some(base), Some(path)) => missing(base, path, &blobs, &settings)?,
            _ => samples,
        };
        let base = base.map(Arc::new);
        Ok((scene, Ready { blobs, settings, samples, base, notes, substitutions, replay: self.replay.clone() }))
    }
}

/// The samples that an image lacks to be one of `settings`.
fn missing(base: &Kept, path: &Path, blobs: &SceneBlobs, settings: &Settings) -> anyhow::Result<Range<u32>> {
    let shown = path.display();
    let wanted = Head {
        engine: tilecast_core::VERSION.to_owned(),
        scene: blobs.digest,
        settings: settings.clone(),
        target: None,
    };
    if let Some(difference) = difference(&base.head, &wanted) {
        bail!("{shown} cannot be gone on with (there, and here): {difference}");
    }
    let spp = settings.spp;
    match base.samples().map(Ranges::as_slice) {
        Some([Range { start: 0, end }]) if *end < spp => Ok(*end..spp),
        Some([Range { start: 0, end }]) => {
            Err(Usage(format!("{shown} has {end} samples a pixel already; ask for more than that with --spp")).into())
        }
        _ => bail!(
            "{shown} has samples {}, not the first ones of every pixel; render what is missing with --samples and join it with \
             tilecast merge",
            base.shown()
        ),
    }
}

impl Overrides {
    fn apply(&self, settings: &mut Settings) -> Result<(), Usage> {
        let Settings { film, spp, seed, integrator, strategy, sampler, without, offsets, .. } = settings;
        if let Some([width, height]) = self.size {
            (film.width, film.height) = (width, height);
            film.crop = Window { x0: 0, y0: 0, x1: width, y1: height };
        }
        if let Some(crop) = self.crop {
            let (width, height) = (film.width, film.height);
            if crop.x1 > width || crop.y1 > height {
                let Window { x0, y0, x1, y1 } = crop;
                return Err(Usage(format!(
                    "--crop {x0},{y0},{x1},{y1} is not within the picture's {width}x{height} pixels"
                )));
            }
            film.crop = crop;
        }
        set(spp, self.spp);
        set(seed, self.seed);
        set(&mut integrator.kind, self.integrator);
        set(&mut integrator.max_depth, self.max_depth);
        set(strategy, self.strategy);
        set(sampler, self.sampler);
        set(without, self.without);
        set(offsets, self.offsets);
        Ok(())
    }
}

fn set<T>(value: &mut T, wanted: Option<T>) {
    if let Some(wanted) = wanted {
        *value = wanted;
    }
}
