//! The film that is kept beside an image (`OUT.film`): the exact sums and which samples made them, so that the image can be gone
//! on with, joined with others, and proved. docs/film.md describes the file, docs/references.md what it is for.

use crate::output::replace;
use anyhow::{Context, bail};
use serde_json::Value;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::fs::File;
use std::io::BufWriter;
use std::ops::Range;
use std::path::{Path, PathBuf};
use tilecast_core::film::Film;
use tilecast_core::film::file::{FilmWriter, Head, PART_PIXELS_MAX, Part, assemble, overlap, read};
use tilecast_core::film::ranges::Ranges;
use tilecast_core::scene::Digest;
use tilecast_core::settings::{Half, Settings, Window};

/// See the module.
#[derive(Clone, Debug)]
pub struct Kept {
    /// What the samples are of.
    pub head: Head,
    /// Their sums.
    pub film: Film,
    /// Which samples the pixels have: tiles that do not overlap, of both halves or of each.
    pub tiles: Tiles,
}

/// Tiles, the half whose indices the ranges are, and those.
pub type Tiles = Vec<(Window, Half, Ranges)>;

/// The film beside an image.
pub fn beside(image: &Path) -> PathBuf {
    image.with_extension("film")
}

impl Kept {
    /// A film whose pixels all have the same samples.
    pub fn even(settings: Settings, scene: Digest, film: Film, samples: &Ranges) -> Self {
        let head = Head { engine: tilecast_core::VERSION.to_owned(), scene, settings, target: None };
        let tiles = bands(film.window).map(|band| (band, Half::Both, samples.clone())).collect();
        Self { head, film, tiles }
    }

    /// A film of which nobody knows yet which samples it will have.
    pub fn in_the_making(settings: Settings, scene: Digest, film: Film) -> Self {
        Self { tiles: Vec::new(), ..Self::even(settings, scene, film, &Ranges::default()) }
    }

    /// Reads a film. Blocks.
    ///
    /// # Errors
    /// No such file, or one that is damaged, with where.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        let shown = || format!("cannot read the film {}", path.display());
        let (head, parts) = read(File::open(path).with_context(shown)?).with_context(shown)?;
        let mut film = assemble(&head.settings, &parts).with_context(shown)?;
        film.halves = head.target.is_some();
        let mut tiles = Tiles::new();
        let mut places: HashMap<(Window, Half), usize> = HashMap::new();
        for Part { tile, half, samples, .. } in parts {
            // Of other contributors there may be more of the same tile.
            match places.entry((tile, half)) {
                Entry::Occupied(place) => {
                    let (_, _, known) = &mut tiles[*place.get()];
                    samples.as_slice().iter().for_each(|range| known.insert(range.clone()));
                }
                Entry::Vacant(place) => {
                    place.insert(tiles.len());
                    tiles.push((tile, half, samples));
                }
            }
        }
        Ok(Self { head, film, tiles })
    }

    /// Writes a film beside itself, and renames when all is there. Blocks.
    ///
    /// # Errors
    /// A full disk, or whatever else befalls files; what was there before is there still.
    pub fn write(&self, path: &Path) -> anyhow::Result<()> {
        replace(path, |file| {
            let mut writer = FilmWriter::new(BufWriter::with_capacity(1 << 20, file), &self.head)?;
            for (tile, half, samples) in &self.tiles {
                let mut pixels = self.film.tile(*tile);
                pixels.iter_mut().for_each(|pixel| pixel.keep(*half));
                writer.part(&Part { tile: *tile, half: *half, samples: samples.clone(), pixels, contributor: 0 })?;
            }
            writer.finish()?.into_inner().map_err(std::io::IntoInnerError::into_error)?;
            Ok(())
        })
    }

    /// The samples of all pixels, if all have the same.
    pub fn samples(&self) -> Option<&Ranges> {
        let (_, _, first) = self.tiles.first()?;
        let even = self.tiles.iter().all(|(_, half, samples)| *half == Half::Both && samples == first);
        let area: u64 = self.tiles.iter().map(|(tile, ..)| tile.area()).sum();
        (even && area == self.film.window.area()).then_some(first)
    }

    /// Samples a pixel, on average.
    pub fn spp(&self) -> f64 {
        let of = |(tile, _, samples): &(Window, Half, Ranges)| tile.area() as f64 * samples.count() as f64;
        self.tiles.iter().map(of).sum::<f64>() / self.film.window.area() as f64
    }

    /// Adds another film to this one. `names` are what they are called, this one first.
    ///
    /// # Errors
    /// One of something else, or with samples that are here already; nothing is added.
    pub fn join(&mut self, other: Kept, names: [&str; 2]) -> anyhow::Result<()> {
        let [mine, theirs] = names;
        if let Some(difference) = difference(&self.head, &other.head) {
            bail!("{theirs} does not belong to {mine}: {difference}");
        }
        let (Some(all), Some(more)) = (self.samples(), other.samples()) else {
            bail!("{theirs} and {mine} have other samples in some tiles than in others; such films stand alone");
        };
        let (mut both, more) = (all.clone(), more.clone());
        let all = self.tiles.iter().chain(&other.tiles).map(|(tile, _, samples)| (*tile, samples));
        if let Some((tile, samples)) = overlap(all) {
            bail!(
                "{theirs} and {mine} both have samples {}..{} of the pixels from ({}, {}) to ({}, {}): a sample counts once",
                samples.start,
                samples.end,
                tile.x0,
                tile.y0,
                tile.x1 - 1,
                tile.y1 - 1
            );
        }
        let window = self.film.window;
        more.as_slice().iter().for_each(|range| both.insert(range.clone()));
        self.tiles = bands(window).map(|band| (band, Half::Both, both.clone())).collect();
        self.film.join(&other.film);
        self.head.settings.spp = self.head.settings.spp.max(other.head.settings.spp);
        Ok(())
    }

    /// Which samples, for people and for the image's attributes.
    pub fn shown(&self) -> String {
        match self.samples() {
            Some(samples) => shown(samples),
            None if self.tiles.is_empty() => "in the making".into(),
            None => "other ones in every tile".into(),
        }
    }
}

/// Ranges as text: `0..64,128..256`.
pub fn shown(samples: &Ranges) -> String {
    let shown: Vec<String> = samples.as_slice().iter().map(|Range { start, end }| format!("{start}..{end}")).collect();
    shown.join(",")
}

/// Ranges from such text; `None` from other text.
pub fn parse(text: &str) -> Option<Ranges> {
    let range = |part: &str| {
        let (start, end) = part.split_once("..")?;
        Some(start.parse().ok()?..end.parse().ok()?)
    };
    Ranges::from_sorted(text.split(',').map(range).collect::<Option<_>>()?)
}

/// Why samples under one head do not belong to those under another.
pub fn difference(mine: &Head, theirs: &Head) -> Option<String> {
    if mine.scene != theirs.scene {
        return Some(format!("they are of different scenes, with digests {} and {}", mine.scene, theirs.scene));
    }
    if mine.engine != theirs.engine {
        return Some(format!("they were traced by engines {} and {}, whose bits differ", mine.engine, theirs.engine));
    }
    if mine.settings.same_samples(&theirs.settings) {
        return None;
    }
    Some(settings_difference(&mine.settings, &theirs.settings))
}

/// What of two settings differs, of those that samples depend on.
fn settings_difference(mine: &Settings, theirs: &Settings) -> String {
    let value = |settings: &Settings| serde_json::to_value(settings).unwrap_or_default();
    let mut found = Vec::new();
    differing("", &value(mine), &value(theirs), &mut found);
    if found.len() == 1 && mine.spp != theirs.spp {
        return format!(
            "the numbers of --sampler sobol-z depend on the samples a pixel is to have, {} and {}; name the whole count when \
             its parts are rendered (--samples A..B --spp N), or take --sampler sobol",
            mine.spp, theirs.spp
        );
    }
    format!("their settings differ: {}", found.join(", "))
}

/// Leaves of two JSON values that differ, with their paths.
fn differing(path: &str, a: &Value, b: &Value, found: &mut Vec<String>) {
    match (a, b) {
        (Value::Object(a), Value::Object(b)) => {
            for key in a.keys().chain(b.keys().filter(|key| !a.contains_key(*key))) {
                let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
                differing(&path, a.get(key).unwrap_or(&Value::Null), b.get(key).unwrap_or(&Value::Null), found);
            }
        }
        _ if a != b => found.push(format!("{path} {a} and {b}")),
        _ => {}
    }
}

/// A window as tiles that fit a film's parts.
fn bands(window: Window) -> impl Iterator<Item = Window> {
    let rows = u32::try_from(PART_PIXELS_MAX / u64::from(window.width())).unwrap_or(1).max(1);
    (window.y0..window.y1).step_by(rows as usize).map(move |y0| Window {
        y0,
        y1: y0.saturating_add(rows).min(window.y1),
        ..window
    })
}
