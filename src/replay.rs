//! `tilecast render … --pixel X,Y --sample I`: traces one sample again and prints its path, vertex by vertex. The sample is the
//! very one that the image holds, whoever traced it there: error messages name the command.

use crate::flags::Usage;
use crate::info::bsdf_name;
use crate::picture::{Picture, Ready};
use anyhow::Context;
use glam::{DVec3, Vec3};
use std::fmt::Write;
use std::sync::Arc;
use tilecast_core::bvh::simd::Isa;
use tilecast_core::scene::Scene;
use tilecast_core::surface::Surface;
use tilecast_core::trace::Tracer;
use tilecast_core::witness::{Cause, Event};
use tilecast_core::world::World;

/// Which sample of which picture.
pub struct Replay {
    /// The picture.
    pub picture: Picture,
    /// Column and row in the whole picture.
    pub pixel: [u32; 2],
    /// Sample index.
    pub sample: u32,
}

/// Traces it and tells.
///
/// # Errors
/// What is wrong with the scene's files, or a pixel that is not in the picture.
pub async fn run(Replay { picture, pixel, sample }: Replay) -> anyhow::Result<()> {
    let told = tokio::task::spawn_blocking(move || {
        let (scene, ready) = picture.load()?;
        told(&scene, ready, pixel, sample)
    })
    .await;
    print!("{}", told.context("loading panicked")??);
    Ok(())
}

fn told(scene: &Scene, Ready { settings, .. }: Ready, [x, y]: [u32; 2], sample: u32) -> anyhow::Result<String> {
    let (width, height) = (settings.film.width, settings.film.height);
    if x >= width || y >= height {
        return Err(Usage(format!("--pixel {x},{y} is not within the picture's {width}x{height} pixels")).into());
    }
    let head = format!("sample {sample} of pixel ({x}, {y}), seed {}\n", settings.seed);
    let tracer = Tracer::new(Arc::new(World::compile(scene)), settings, Isa::Portable)?;
    let (radiance, events) = tracer.replay(x, y, sample);
    let mut text = head;
    for event in &events {
        tell(&mut text, scene, event)?;
    }
    writeln!(text, "radiance {}", vector(radiance))?;
    Ok(text)
}

/// One event as a line or two. Vertices stand at the margin, what happens there below them.
fn tell(text: &mut String, scene: &Scene, event: &Event) -> std::fmt::Result {
    match event {
        Event::Camera { origin, direction, weight } => {
            let at = position(scene, *origin);
            writeln!(text, "camera ray from {at}, direction {}, filter weight {weight}", vector(*direction))
        }
        Event::Hit { depth, surface, throughput } => hit(text, scene, *depth, surface, *throughput),
        Event::Emission { radiance, mis, pdf, gained } => {
            let (radiance, gained) = (vector(*radiance), vector(*gained));
            writeln!(text, "  emission {radiance}, found with pdf {pdf}, weight {mis}: gains {gained}")
        }
        Event::Branch { number, of } => writeln!(text, "branch {number} of {of}"),
        Event::Light { wi, pdf, bsdf_pdf, mis, visible, gained } => {
            let (wi, gained) = (vector(*wi), vector(*gained));
            let way = if *visible { "" } else { "nothing comes that way: " };
            writeln!(
                text,
                "  light at wi {wi}, pdf {pdf}, by the material {bsdf_pdf}, weight {mis}: {way}gains {gained}"
            )
        }
        Event::Continuation { wi, pdf, weight } => {
            writeln!(text, "  goes on to wi {}, pdf {pdf}, weight {}", vector(*wi), vector(*weight))
        }
        Event::Roulette { survival, survived } => {
            let end = if *survived { "goes on" } else { "ends" };
            writeln!(text, "  roulette: survival {survival}, {end}")
        }
        Event::Shared { weight } => {
            writeln!(text, "  goes on for all pixels of its block, with weight {} for its own", vector(*weight))
        }
        Event::Others { gained } => {
            writeln!(text, "paths of the other pixels of its block find {} for it", vector(*gained))
        }
        Event::End(cause) => writeln!(text, "{}", ending(*cause)),
    }
}

fn hit(text: &mut String, scene: &Scene, depth: u32, surface: &Surface, throughput: Vec3) -> std::fmt::Result {
    let Some(shape) = scene.levels().flatten().nth(surface.shape as usize) else {
        return writeln!(text, "vertex {depth}: a shape that the scene does not have");
    };
    let material = bsdf_name(&scene.bsdfs[shape.bsdf.0 as usize]);
    let light = surface.light.map_or_else(String::new, |light| format!(", light {light}"));
    writeln!(
        text,
        "vertex {depth}: {} ({material}), primitive {}{light}, throughput {}",
        shape.name,
        surface.primitive,
        vector(throughput)
    )?;
    let (at, error) = (position(scene, surface.position), vector(surface.error));
    writeln!(text, "  at {at} within {error}, uv ({}, {})", surface.uv.x, surface.uv.y)?;
    writeln!(text, "  normal {}, shading normal {}", vector(surface.normal), vector(surface.frame.n))
}

fn ending(cause: Cause) -> &'static str {
    match cause {
        Cause::Escaped => "leaves the scene",
        Cause::Dark => "ends: the last segment leads to nothing that shines",
        Cause::Depth => "ends at the longest path asked for",
        Cause::Absorbed => "is absorbed",
        Cause::Roulette => "ends by roulette",
    }
}

/// A point in the coordinates of the scene's file.
fn position(scene: &Scene, p: Vec3) -> String {
    let p = DVec3::from_array(scene.origin) + p.as_dvec3();
    format!("({}, {}, {})", p.x, p.y, p.z)
}

/// Every digit: f32 values that are printed so can be read back.
fn vector(v: Vec3) -> String {
    format!("({}, {}, {})", v.x, v.y, v.z)
}
