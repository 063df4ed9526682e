//! `tilecast info`: what is in a scene, what was read but has no effect, and what it takes.

use crate::picture::{Overrides, Picture, Ready};
use crate::report::print;
use anyhow::Context;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Instant;
use tilecast_core::bvh::Stats;
use tilecast_core::bvh::simd::Isa;
use tilecast_core::scene::{Bsdf, Emitter, Geometry, Mesh, Scene, Texels, Texture};
use tilecast_core::settings::Settings;
use tilecast_core::world::World;

/// What to look at.
pub struct Info {
    /// The scene's file.
    pub scene: PathBuf,
    /// Values for its `$names`.
    pub defines: Vec<(String, String)>,
    /// As JSON.
    pub json: bool,
}

/// What there is to know of a scene.
#[derive(Serialize)]
struct Facts {
    scene: String,
    /// How many of each kind; surfaces that several shapes share count for each.
    shapes: BTreeMap<&'static str, usize>,
    triangles: usize,
    materials: BTreeMap<&'static str, usize>,
    textures: BTreeMap<&'static str, usize>,
    lights: BTreeMap<&'static str, usize>,
    images: Vec<ImageFacts>,
    /// Of meshes and images as loaded.
    memory_bytes: usize,
    /// Over the triangles.
    hierarchy: HierarchyFacts,
    /// What this machine would trace with.
    isa: &'static str,
    settings: Settings,
    notes: Vec<String>,
}

#[derive(Serialize)]
struct HierarchyFacts {
    nodes: usize,
    blocks: usize,
    bytes: usize,
    /// Cost of an average ray by the surface area heuristic, in visits of a node.
    sah_cost: f32,
    build_seconds: f64,
}

#[derive(Serialize)]
struct ImageFacts {
    width: u32,
    height: u32,
    bytes: usize,
}

/// Looks and tells.
///
/// # Errors
/// What is wrong with the scene's files.
pub async fn run(Info { scene, defines, json }: Info) -> anyhow::Result<()> {
    let picture = Picture { scene, defines, overrides: Overrides::default() };
    let facts = tokio::task::spawn_blocking(move || anyhow::Ok(facts(picture.load()?))).await;
    let facts = facts.context("loading panicked")??;
    if json {
        print(&facts);
    } else {
        println!("{}", text(&facts));
    }
    Ok(())
}

fn facts(Ready { scene, blobs, settings, notes }: Ready) -> Facts {
    let meshes = || scene.shapes.iter().filter_map(|shape| mesh_of(&scene, &shape.geometry));
    let images: Vec<ImageFacts> = scene
        .images
        .iter()
        .map(|image| ImageFacts { width: image.width, height: image.height, bytes: texel_bytes(&image.texels) })
        .collect();
    let mesh_bytes = scene.meshes.iter().map(|mesh| mesh_bytes(mesh)).sum::<usize>();
    let begun = Instant::now();
    let Stats { nodes, blocks, bytes, sah_cost } = World::compile(&scene).geometry.triangle_stats();
    let build_seconds = begun.elapsed().as_secs_f64();
    let area_lights = scene.shapes.iter().filter(|shape| shape.radiance.is_some()).map(|_| "area");
    Facts {
        scene: blobs.digest.to_string(),
        shapes: count(scene.shapes.iter().map(|shape| match shape.geometry {
            Geometry::Mesh(_) => "mesh",
            Geometry::Sphere { .. } => "sphere",
            Geometry::Disk { .. } => "disk",
            Geometry::Cylinder { .. } => "cylinder",
        })),
        triangles: meshes().map(|mesh| mesh.triangles.len()).sum(),
        materials: count(scene.bsdfs.iter().map(bsdf_name)),
        textures: count(scene.textures.iter().filter_map(texture_name)),
        lights: count(scene.emitters.iter().map(emitter_name).chain(area_lights)),
        memory_bytes: mesh_bytes + images.iter().map(|image| image.bytes).sum::<usize>(),
        images,
        hierarchy: HierarchyFacts { nodes, blocks, bytes, sah_cost, build_seconds },
        isa: Isa::detect().name(),
        settings,
        notes,
    }
}

fn mesh_of<'a>(scene: &'a Scene, geometry: &Geometry) -> Option<&'a Mesh> {
    match geometry {
        Geometry::Mesh(id) => scene.meshes.get(id.0 as usize).map(|mesh| &**mesh),
        Geometry::Sphere { .. } | Geometry::Disk { .. } | Geometry::Cylinder { .. } => None,
    }
}

fn mesh_bytes(mesh: &Mesh) -> usize {
    size_of_val(&*mesh.positions)
        + size_of_val(&*mesh.normals)
        + size_of_val(&*mesh.uvs)
        + size_of_val(&*mesh.triangles)
}

fn texel_bytes(texels: &Texels) -> usize {
    match texels {
        Texels::Grey8 { data, .. } | Texels::Rgb8 { data, .. } => data.len(),
        Texels::Grey32(data) | Texels::Rgb32(data) => size_of_val(&**data),
    }
}

fn bsdf_name(bsdf: &Bsdf) -> &'static str {
    match bsdf {
        Bsdf::Diffuse { .. } => "diffuse",
        Bsdf::Conductor { .. } => "conductor",
        Bsdf::Dielectric { .. } => "dielectric",
        Bsdf::Phong { .. } => "phong",
        Bsdf::TwoSided { .. } => "twosided",
        Bsdf::Mask { .. } => "mask",
        Bsdf::RoughConductor { .. } => "roughconductor",
        Bsdf::RoughDielectric { .. } => "roughdielectric",
        Bsdf::ThinDielectric { .. } => "thindielectric",
        Bsdf::Plastic { .. } => "plastic",
        Bsdf::RoughPlastic { .. } => "roughplastic",
        Bsdf::Principled { .. } => "principled",
        Bsdf::PrincipledThin { .. } => "principledthin",
        Bsdf::Null => "null",
        Bsdf::BlendBsdf { .. } => "blendbsdf",
        Bsdf::BumpMap { .. } => "bumpmap",
        Bsdf::NormalMap { .. } => "normalmap",
    }
}

/// Constants are values of materials rather than textures.
fn texture_name(texture: &Texture) -> Option<&'static str> {
    match texture {
        Texture::Constant(_) => None,
        Texture::Checkerboard { .. } => Some("checkerboard"),
        Texture::Bitmap { .. } => Some("bitmap"),
    }
}

fn emitter_name(emitter: &Emitter) -> &'static str {
    match emitter {
        Emitter::Constant { .. } => "constant",
        Emitter::Envmap { .. } => "envmap",
        Emitter::Point { .. } => "point",
        Emitter::Spot { .. } => "spot",
        Emitter::Projector { .. } => "projector",
        Emitter::Directional { .. } => "directional",
    }
}

fn count(names: impl Iterator<Item = &'static str>) -> BTreeMap<&'static str, usize> {
    let mut counts = BTreeMap::new();
    names.for_each(|name| *counts.entry(name).or_default() += 1);
    counts
}

fn text(facts: &Facts) -> String {
    let list = |counts: &BTreeMap<&str, usize>| match counts.is_empty() {
        true => "none".to_owned(),
        false => counts.iter().map(|(name, n)| format!("{n} {name}")).collect::<Vec<_>>().join(", "),
    };
    let Settings { film, spp, seed, integrator, strategy, sampler, .. } = &facts.settings;
    let depth = integrator.max_depth.map_or_else(|| "no limit".to_owned(), |depth| depth.to_string());
    let HierarchyFacts { nodes, blocks, bytes, sah_cost, build_seconds } = &facts.hierarchy;
    let crop = film.crop;
    let mut lines = vec![
        format!("scene      {}", facts.scene),
        format!("shapes     {} ({} triangles)", list(&facts.shapes), facts.triangles),
        format!("materials  {}", list(&facts.materials)),
        format!("textures   {}", list(&facts.textures)),
        format!("lights     {}", list(&facts.lights)),
        format!("memory     {:.1} MB of meshes and images", facts.memory_bytes as f64 / 1e6),
        format!(
            "hierarchy  {} nodes, {} blocks of triangles, {:.1} MB, average ray costs {:.1} visits, built in {:.2} s",
            nodes,
            blocks,
            *bytes as f64 / 1e6,
            sah_cost,
            build_seconds
        ),
        format!("traced by  {}", facts.isa),
        format!("film       {}x{}, crop {},{},{},{}", film.width, film.height, crop.x0, crop.y0, crop.x1, crop.y1),
        format!("filter     {:?}", film.filter),
        format!("samples    {spp} a pixel, {sampler:?}, seed {seed}"),
        format!("integrator {:?}, directions by {strategy:?}, longest path {depth}", integrator.kind),
    ];
    lines.extend(facts.images.iter().map(|i| format!("image      {}x{}, {} bytes", i.width, i.height, i.bytes)));
    lines.extend(facts.notes.iter().map(|note| format!("note       {note}")));
    lines.join("\n")
}
