//! `tilecast verify`: renders parts of an image again, chosen at random, and says whether the bits agree, and how likely a
//! change elsewhere would have been missed.
//!
//! A unit is a square of [`SIDE`] pixels with all its samples: an image holds means, so fewer samples could not be compared with
//! it. docs/references.md has the argument and its limits.

use crate::kept::{Kept, Tiles, beside, parse};
use crate::picture::{Overrides, Picture};
use crate::read::{self, Proof};
use crate::report::print;
use anyhow::{Context, bail};
use serde::Serialize;
use std::hash::{BuildHasher, RandomState};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use tilecast_core::bvh::simd::Isa;
use tilecast_core::film::{Estimate, Film};
use tilecast_core::settings::{Half, Settings, Window};
use tilecast_core::trace::Tracer;
use tilecast_core::world::World;

/// Pixels along a side of a unit: small, so that many different ones are looked at for the same work.
const SIDE: u32 = 8;
/// Shares of changed units for which the chance to miss them is told.
const SHARES: [f64; 4] = [0.001, 0.01, 0.05, 0.2];
/// Units that disagree which are listed.
const LISTED_MAX: usize = 10;

/// What to look at.
pub struct Verify {
    /// The image.
    pub image: PathBuf,
    /// The scene it claims to be of, and how that is loaded.
    pub scene: PathBuf,
    /// Values for its `$names`.
    pub defines: Vec<(String, String)>,
    /// Whether what tilecast does not have is replaced.
    pub substitute: bool,
    /// The share of units that is rendered again.
    pub share: f64,
    /// Which ones; at random if `None`.
    pub seed: Option<u64>,
    /// Threads that trace.
    pub threads: u32,
    /// Instruction set.
    pub isa: Isa,
    /// One JSON object instead of text.
    pub json: bool,
}

#[derive(Serialize)]
struct Verified<'a> {
    event: &'static str,
    agrees: bool,
    units: usize,
    units_total: usize,
    /// The film beside the image was there, and all pixels are those of its sums.
    film: bool,
    seed: u64,
    /// Tiles (x0, y0, x1, y1) whose bits differ.
    differing: &'a [[u32; 4]],
    /// Share of units changed, and the chance that this look would have missed all of them.
    missed: Vec<[f64; 2]>,
}

/// Looks, and says what it saw. Blocks.
///
/// # Errors
/// An image that is not what it claims to be, or that cannot be looked at.
pub fn run(verify: &Verify) -> anyhow::Result<()> {
    let proof = read::proof(&verify.image)?;
    let shown = verify.image.display();
    if proof.engine != tilecast_core::VERSION {
        bail!("{shown} was made by engine {}; this one is {}, whose bits differ", proof.engine, tilecast_core::VERSION);
    }
    let kept = Some(beside(&verify.image)).filter(|path| path.exists()).map(|path| Kept::read(&path)).transpose()?;
    if let Some(kept) = &kept {
        agrees_with_film(&proof, kept).with_context(|| format!("{shown} is not the image of the film beside it"))?;
    }
    let halves = kept.as_ref().is_some_and(|kept| kept.film.halves);
    let tiles = match (&kept, parse(&proof.samples)) {
        (Some(kept), _) => kept.tiles.clone(),
        (None, Some(samples)) => vec![(proof.settings.film.crop, Half::Both, samples)],
        (None, None) => bail!("{shown} has other samples in every tile; its film, that says which, must lie beside it"),
    };
    let world = world(verify, &proof)?;
    let looker = Looker::new(&world, &proof, tiles, halves, verify.isa)?;
    let units: Vec<Window> = units(proof.settings.film.crop).collect();
    let seed = verify.seed.unwrap_or_else(|| RandomState::new().hash_one(0));
    let count = ((units.len() as f64 * verify.share).ceil() as usize).clamp(1, units.len());
    let chosen: Vec<Window> = pick(units.len(), count, seed).into_iter().map(|i| units[i]).collect();
    let differing = differing(&looker, &proof, &chosen, verify.threads)?;
    tell(verify, units.len(), &chosen, &differing, kept.is_some(), seed);
    if !differing.is_empty() {
        bail!("{shown} is not what its scene and settings give: {} of {count} units differ", differing.len());
    }
    Ok(())
}

/// The scene, if it is the one that the image names.
fn world(verify: &Verify, proof: &Proof) -> anyhow::Result<Arc<World>> {
    let Verify { scene, defines, substitute, .. } = verify;
    let picture = Picture {
        scene: scene.clone(),
        defines: defines.clone(),
        substitute: *substitute,
        overrides: Overrides::default(),
        resume: None,
        samples: None,
        replay: String::new(),
    };
    let (scene, ready) = picture.load()?;
    if ready.blobs.digest.to_string() != proof.scene {
        bail!("the image is of a scene with digest {}; this one has {}", proof.scene, ready.blobs.digest);
    }
    Ok(Arc::new(World::consume(scene)))
}

/// Whether every pixel and the digest of the image are those of the film.
fn agrees_with_film(proof: &Proof, kept: &Kept) -> anyhow::Result<()> {
    if kept.film.digest().to_string() != proof.digest {
        bail!("the film's digest is {}, and the image says {}", kept.film.digest(), proof.digest);
    }
    if kept.head.scene.to_string() != proof.scene
        || kept.head.settings != proof.settings
        || kept.head.engine != proof.engine
    {
        bail!("scene, settings or engine are not the same");
    }
    let window = kept.film.window;
    for (x, y) in pixels(window) {
        if !same(&kept.film.estimate(x, y), &proof.pixel(x, y)) {
            bail!("pixel ({x}, {y}) differs");
        }
    }
    Ok(())
}

/// Traces units again; those that differ from the image.
fn differing(looker: &Looker, proof: &Proof, chosen: &[Window], threads: u32) -> anyhow::Result<Vec<Window>> {
    let (next, found) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let failed = Mutex::new(None);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                while let Some(&unit) = chosen.get(next.fetch_add(1, Ordering::Relaxed)) {
                    match looker.trace(unit) {
                        Ok(film) if agrees(&film, proof) => {}
                        Ok(_) => found.lock().unwrap_or_else(PoisonError::into_inner).push(unit),
                        Err(error) => _ = failed.lock().unwrap_or_else(PoisonError::into_inner).replace(error),
                    }
                }
            });
        }
    });
    if let Some(error) = failed.into_inner().unwrap_or_else(PoisonError::into_inner) {
        return Err(error);
    }
    let mut found = found.into_inner().unwrap_or_else(PoisonError::into_inner);
    found.sort_by_key(|unit| (unit.y0, unit.x0));
    Ok(found)
}

/// Traces what an image claims to have.
struct Looker {
    /// For each half.
    tracers: Vec<(Half, Tracer)>,
    settings: Settings,
    tiles: Tiles,
    halves: bool,
}

impl Looker {
    fn new(world: &Arc<World>, proof: &Proof, tiles: Tiles, halves: bool, isa: Isa) -> anyhow::Result<Self> {
        let mut tracers = Vec::new();
        for half in [Half::Both, Half::First, Half::Second] {
            let settings = Settings { half, ..proof.settings.clone() };
            tracers.push((half, Tracer::new(Arc::clone(world), settings, isa)?));
        }
        Ok(Self { tracers, settings: proof.settings.clone(), tiles, halves })
    }

    /// All samples of a unit again, as a film of its own.
    fn trace(&self, unit: Window) -> anyhow::Result<Film> {
        let mut own = self.settings.clone();
        own.film.crop = unit;
        let mut film = Film::new(&own);
        film.halves = self.halves;
        for (half, tracer) in &self.tracers {
            film.half = *half;
            for (tile, _, samples) in self.tiles.iter().filter(|(_, of, _)| of == half) {
                let Some(part) = tile.intersection(&unit) else { continue };
                for range in samples.as_slice() {
                    let sums = tracer.trace(part, range.clone(), &AtomicBool::new(false))?;
                    film.merge(&sums.context("nobody stops this")?);
                }
            }
        }
        Ok(film)
    }
}

/// Whether the image has the film's bits.
fn agrees(film: &Film, proof: &Proof) -> bool {
    pixels(film.window).all(|(x, y)| same(&film.estimate(x, y), &proof.pixel(x, y)))
}

/// Bit for bit, as far as an image can hold a count.
fn same(a: &Estimate, b: &Estimate) -> bool {
    let bits = |values: [f32; 3]| values.map(f32::to_bits);
    bits(a.mean) == bits(b.mean) && bits(a.variance) == bits(b.variance) && a.count as f32 == b.count as f32
}

fn pixels(window: Window) -> impl Iterator<Item = (u32, u32)> {
    (window.y0..window.y1).flat_map(move |y| (window.x0..window.x1).map(move |x| (x, y)))
}

/// A window cut into units.
fn units(window: Window) -> impl Iterator<Item = Window> {
    let steps = |from: u32, to: u32| (from..to).step_by(SIDE as usize);
    steps(window.y0, window.y1).flat_map(move |y0| {
        steps(window.x0, window.x1).map(move |x0| Window {
            x0,
            y0,
            x1: window.x1.min(x0 + SIDE),
            y1: window.y1.min(y0 + SIDE),
        })
    })
}

/// `count` different numbers below `len`, every choice as likely as any other (Floyd).
fn pick(len: usize, count: usize, seed: u64) -> Vec<usize> {
    let mut state = seed;
    let mut chosen = std::collections::BTreeSet::new();
    for last in len - count..len {
        let at = below(&mut state, last as u64 + 1) as usize;
        chosen.insert(if chosen.contains(&at) { last } else { at });
    }
    chosen.into_iter().collect()
}

/// A random number below `bound`; SplitMix64, whose bias for such bounds is below 2^-32.
fn below(state: &mut u64, bound: u64) -> u64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut x = *state;
    x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((u128::from(x ^ (x >> 31)) * u128::from(bound)) >> 64) as u64
}

/// The chance that `looked` of `units` units, all choices being equally likely, have none of the `changed` ones:
/// C(units − changed, looked) / C(units, looked).
pub fn missed(units: usize, changed: usize, looked: usize) -> f64 {
    (0..looked).map(|i| units.saturating_sub(changed + i) as f64 / (units - i) as f64).product()
}

fn tell(verify: &Verify, total: usize, chosen: &[Window], differing: &[Window], film: bool, seed: u64) {
    let changed = |share: f64| ((total as f64 * share).ceil() as usize).max(1);
    let missed = SHARES.map(|share| [share, missed(total, changed(share), chosen.len())]);
    if verify.json {
        let tiles: Vec<[u32; 4]> = differing.iter().map(|t| [t.x0, t.y0, t.x1, t.y1]).collect();
        print(&Verified {
            event: "verified",
            agrees: differing.is_empty(),
            units: chosen.len(),
            units_total: total,
            film,
            seed,
            differing: &tiles,
            missed: missed.to_vec(),
        });
        return;
    }
    if film {
        println!(
            "every pixel of the image is that of the film beside it, whose digest is the one that the image bears"
        );
    }
    println!(
        "rendered {} of {total} units again ({SIDE}x{SIDE} pixels, all samples), chosen by --seed {seed}",
        chosen.len()
    );
    for tile in differing.iter().take(LISTED_MAX) {
        println!("  pixels ({}, {}) to ({}, {}) differ", tile.x0, tile.y0, tile.x1 - 1, tile.y1 - 1);
    }
    if differing.is_empty() {
        println!("their bits agree. Of a change elsewhere, this look would have seen nothing:");
        for [share, chance] in missed {
            println!("  {:>5} % of the units changed: with a chance of {:.4} %", 100.0 * share, 100.0 * chance);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashMap;
    use tilecast_core::film::ranges::Ranges;
    use tilecast_core::load::{LoadOptions, load};

    const SPP: u32 = 4;

    /// A small image as it is read from its file, its units as they are traced again, and all of them.
    fn small() -> (Proof, HashMap<usize, Film>, Vec<Window>) {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell-box/scene.xml");
        let loaded = load(&path, &LoadOptions::default()).unwrap();
        let mut settings = Settings { spp: SPP, ..loaded.settings };
        (settings.film.width, settings.film.height) = (100, 90);
        settings.film.crop = Window { x0: 1, y0: 0, x1: 100, y1: 90 };
        let digest = loaded.scene.blobs().digest;
        let world = Arc::new(World::consume(loaded.scene));
        let tracer = Tracer::new(Arc::clone(&world), settings.clone(), Isa::detect()).unwrap();
        let mut film = Film::new(&settings);
        film.merge(&tracer.trace(settings.film.crop, 0..SPP, &AtomicBool::new(false)).unwrap().unwrap());
        let mut samples = Ranges::default();
        samples.insert(0..SPP);
        let kept = Kept::even(settings, digest, film, &samples);
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.exr");
        crate::output::replace(&file, |file| crate::exr::write(file, &kept)).unwrap();
        let proof = read::proof(&file).unwrap();
        agrees_with_film(&proof, &kept).unwrap();
        let looker = Looker::new(&world, &proof, kept.tiles.clone(), false, Isa::detect()).unwrap();
        let units: Vec<Window> = units(kept.film.window).collect();
        assert_eq!(differing(&looker, &proof, &units, 2).unwrap(), [], "an honest image is accepted");
        let films = units.iter().enumerate().map(|(i, &unit)| (i, looker.trace(unit).unwrap())).collect();
        (proof, films, units)
    }

    /// 1,000 trials: in 1 % of the units one bit of one value is another, and a look at a fifth of them finds that as often as
    /// it is said to. Fails if a channel is not compared, or units are not equally likely.
    #[test]
    fn a_change_is_found_as_often_as_is_said() {
        const TRIALS: u64 = 1000;
        let (mut proof, films, units) = small();
        let (changed, looked) = (units.len().div_ceil(100), units.len() / 5);
        let mut found = 0;
        for trial in 0..TRIALS {
            let mut state = trial;
            let bad = pick(units.len(), changed, trial ^ 0x1234_5678);
            let places: Vec<(u32, u32, usize)> = bad
                .iter()
                .map(|&unit| {
                    let Window { x0, y0, x1, y1 } = units[unit];
                    let x = x0 + below(&mut state, u64::from(x1 - x0)) as u32;
                    let y = y0 + below(&mut state, u64::from(y1 - y0)) as u32;
                    (x, y, below(&mut state, 7) as usize)
                })
                .collect();
            places.iter().for_each(|&(x, y, plane)| proof.flip(x, y, plane));
            let look = pick(units.len(), looked, trial);
            let seen = look.iter().any(|unit| !agrees(&films[unit], &proof));
            assert_eq!(seen, look.iter().any(|unit| bad.contains(unit)), "trial {trial}");
            found += u64::from(seen);
            places.iter().for_each(|&(x, y, plane)| proof.flip(x, y, plane));
        }
        let expected = 1.0 - missed(units.len(), changed, looked);
        let deviation = (expected * (1.0 - expected) * TRIALS as f64).sqrt();
        let off = (found as f64 - expected * TRIALS as f64) / deviation;
        assert!(off.abs() < 4.0, "found in {found} of {TRIALS}, which should be {expected}: {off} standard deviations");
    }

    #[test]
    fn chances_are_those_of_drawing_without_putting_back() {
        assert!((missed(10, 1, 3) - 0.7).abs() < 1e-12);
        assert!((missed(10, 2, 5) - 2.0 / 9.0).abs() < 1e-12);
        assert_eq!(missed(10, 6, 5), 0.0);
        assert_eq!(missed(4, 1, 4), 0.0);
    }

    #[test]
    fn what_is_picked_differs_and_all_are_as_likely() {
        let mut hits = [0u32; 10];
        for seed in 0..20_000 {
            let picked = pick(10, 3, seed);
            assert!(picked.len() == 3 && picked.windows(2).all(|pair| pair[0] < pair[1]));
            picked.into_iter().for_each(|i| hits[i] += 1);
        }
        // 6,000 each, with a standard deviation of 65.
        assert!(hits.iter().all(|n| n.abs_diff(6000) < 300), "{hits:?}");
    }
}
