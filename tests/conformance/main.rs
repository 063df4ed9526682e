//! Conformance: tilecast reads Mitsuba 3's scene files and makes the images that Mitsuba makes.
//!
//! Every scene in `scenes/` is about one plugin or a few of its parameters; `references/` has Mitsuba's image of it with the
//! variance of that image ([`make_references.py`](make_references.py)). Here each is rendered with independent seeds and
//! the two are tested for having the same mean, by pixel, by block and as a whole ([`compare`]).
//!
//! `CONFORMANCE=bsdf-rough cargo test --release --test conformance -- --nocapture` takes the scenes whose names contain that.

mod compare;
mod page;
mod reference;

use compare::{Comparison, Renders};
use glam::DVec3;
use rayon::prelude::*;
use reference::Reference;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use tilecast_core::bvh::simd::Isa;
use tilecast_core::film::Film;
use tilecast_core::load::{LoadOptions, load};
use tilecast_core::settings::Settings;
use tilecast_core::trace::Tracer;
use tilecast_core::world::World;

/// Renders of a scene. From so many, their spread is known to 13 %, and Student's t with 31 degrees of freedom leaves
/// |t| < 3.3 once in 400 only.
const SEEDS: u64 = 32;
/// Samples a pixel in each: 512 in all, a sixteenth of a reference's. All scenes take a minute on two cores; it is what
/// tells that a scene file means here what it means elsewhere.
const SPP: u32 = 16;
/// And as many, with other seeds, where the image's mean is not known by then as well as it must be, or where the images seem to
/// disagree: of so many blocks in so many scenes, one or two lie beyond the bar by chance, and what is wrong is wrong again.
const SPP_AGAIN: u32 = 64;

#[test]
fn every_scene_gives_the_image_that_mitsuba_makes() {
    let wanted = std::env::var("CONFORMANCE").unwrap_or_default();
    let names: Vec<String> = stems("scenes", "xml").into_iter().filter(|name| name.contains(&wanted)).collect();
    assert!(!names.is_empty(), "no scene's name contains '{wanted}'");
    let results: Vec<(bool, String)> = names
        .par_iter()
        .map(|name| match judge(name, &[]) {
            Ok(comparison) => (comparison.agrees(), format!("{name:32} {comparison}")),
            Err(error) => (false, format!("{name:32} {error}")),
        })
        .collect();
    let lines = |wanted: bool| results.iter().filter(move |(agrees, _)| *agrees == wanted).map(|(_, line)| line);
    lines(true).for_each(|line| println!("{line}"));
    let failed: Vec<&str> = lines(false).map(String::as_str).collect();
    assert!(failed.is_empty(), "{} of {} scenes disagree:\n{}", failed.len(), results.len(), failed.join("\n"));
}

#[test]
fn every_reference_belongs_to_a_scene() {
    assert_eq!(stems("references", "exr"), stems("scenes", "xml"));
}

#[test]
fn the_page_says_what_the_loader_supports() {
    let mut uses = page::Uses::default();
    for name in stems("scenes", "xml") {
        let text = std::fs::read_to_string(folder().join(format!("scenes/{name}.xml"))).expect("the scene can be read");
        uses.add(&name, &text).expect("the scene is XML");
    }
    assert_eq!(uses.untested(), [""; 0], "plugins without a conformance scene");
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/mitsuba.md");
    let page = page::page(&uses);
    if std::env::var_os("UPDATE_DOCS").is_some() {
        std::fs::create_dir_all(path.parent().expect("a file is in a folder")).expect("the folder can be made");
        std::fs::write(&path, &page).expect("the page can be written");
    }
    let written = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        written == page,
        "docs/mitsuba.md is out of date: UPDATE_DOCS=1 cargo test --release --test conformance page"
    );
}

/// The comparison can fail: an index of refraction that is wrong by 0.03 is seen.
#[test]
fn a_slightly_wrong_material_disagrees() {
    let wrong = ("int_ior".to_owned(), "1.36".to_owned());
    let comparison = judge("bsdf-dielectric-tinted", &[wrong]).expect("the scene renders");
    assert!(!comparison.agrees(), "{comparison}");
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/conformance")
}

/// Names of the files of an ending in a folder, without it, sorted.
fn stems(inside: &str, ending: &str) -> Vec<String> {
    let entries = std::fs::read_dir(folder().join(inside)).expect("the folder is there");
    let paths = entries.map(|entry| entry.expect("the folder can be read").path());
    let mut stems: Vec<String> = paths
        .filter(|path| path.extension().is_some_and(|e| e == ending))
        .filter_map(|path| path.file_stem().map(|stem| stem.to_string_lossy().into_owned()))
        .collect();
    stems.sort();
    stems
}

/// Renders a scene and compares it with its reference.
fn judge(name: &str, defines: &[(String, String)]) -> Result<Comparison, Box<dyn Error + Send + Sync>> {
    let reference = Reference::read(&folder().join(format!("references/{name}.exr")))?;
    let options = LoadOptions { defines: defines.to_vec(), ..LoadOptions::default() };
    let loaded = load(&folder().join(format!("scenes/{name}.xml")), &options)?;
    let world = Arc::new(World::compile(&loaded.scene));
    let crop = loaded.settings.film.crop;
    let (width, height) = (crop.width() as usize, crop.height() as usize);
    if (width, height) != (reference.width, reference.height) {
        return Err(format!("{width}×{height} pixels, not {}×{}", reference.width, reference.height).into());
    }
    let compare = |spp: u32, seeds: std::ops::Range<u64>| -> Result<Comparison, Box<dyn Error + Send + Sync>> {
        let images = seeds
            .into_par_iter()
            .map(|seed| render(&world, Settings { spp, seed, ..loaded.settings.clone() }))
            .collect::<Result<Vec<_>, _>>()?;
        let renders = Renders { width, height, images };
        Ok(Comparison::new(&renders, &reference, loaded.settings.film.filter))
    };
    let first = compare(SPP, 0..SEEDS)?;
    if first.agrees() && first.knows_the_mean() { Ok(first) } else { compare(SPP_AGAIN, SEEDS..2 * SEEDS) }
}

/// The means of all pixels, row by row.
fn render(world: &Arc<World>, settings: Settings) -> Result<Vec<DVec3>, Box<dyn Error + Send + Sync>> {
    let (window, samples) = (settings.film.crop, 0..settings.spp);
    let mut film = Film::new(&settings);
    let tracer = Tracer::new(world.clone(), settings, Isa::detect())?;
    if let Some(part) = tracer.trace(window, samples, &AtomicBool::new(false))? {
        film.merge(&part);
    }
    let pixels = (window.y0..window.y1).flat_map(|y| (window.x0..window.x1).map(move |x| (x, y)));
    Ok(pixels.map(|(x, y)| DVec3::from_array(film.estimate(x, y).mean.map(f64::from))).collect())
}
