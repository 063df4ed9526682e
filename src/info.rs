//! `tilecast info`: what is in a scene, what was read but has no effect, and what it takes.

use crate::picture::{Overrides, Picture, Ready};
use crate::report::print;
use anyhow::Context;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;
use tilecast_core::bvh::Stats;
use tilecast_core::bvh::simd::Isa;
use tilecast_core::geometry::Memory;
use tilecast_core::scene::{Bsdf, Emitter, Geometry, Mesh, Scene, Shape, Texture};
use tilecast_core::settings::Settings;
use tilecast_core::trace::Tracer;
use tilecast_core::world::World;

/// What to look at.
pub struct Info {
    /// The scene's file.
    pub scene: PathBuf,
    /// Values for its `$names`.
    pub defines: Vec<(String, String)>,
    /// Whether what tilecast does not have is replaced; else it is an error.
    pub substitute: bool,
    /// As JSON.
    pub json: bool,
}

/// What there is to know of a scene.
#[derive(Serialize)]
struct Facts {
    scene: String,
    /// How many of each kind, those in groups included; surfaces that several shapes share count for each.
    shapes: BTreeMap<&'static str, usize>,
    /// As kept; what instances place counts once.
    triangles: usize,
    instances: usize,
    /// What the instances place, counted for each.
    instanced_triangles: usize,
    materials: BTreeMap<&'static str, usize>,
    textures: BTreeMap<&'static str, usize>,
    lights: BTreeMap<&'static str, usize>,
    images: Vec<ImageFacts>,
    memory: MemoryFacts,
    /// Over the triangles.
    hierarchy: HierarchyFacts,
    /// Whether paths would be reused by the pixels around theirs: a pilot finds whether that pays.
    path_reuse: bool,
    /// What this machine would trace with.
    isa: &'static str,
    settings: Settings,
    /// What was read and has no effect, or was left out.
    notes: Vec<String>,
    /// What was replaced because that was asked for.
    substitutions: Vec<String>,
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

/// What a worker holds while it renders, in bytes.
#[derive(Serialize)]
struct MemoryFacts {
    /// Positions, normals, texture coordinates, indices.
    surfaces: usize,
    /// Over triangles, shapes and instances, with the hierarchies' own copies of triangles.
    hierarchies: usize,
    /// The places of instances.
    instances: usize,
    /// Images and attributes of meshes.
    textures: usize,
    /// Surfaces and hierarchies, for each triangle.
    a_triangle: Option<f64>,
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
pub async fn run(Info { scene, defines, substitute, json }: Info) -> anyhow::Result<()> {
    let picture = Picture {
        scene,
        defines,
        substitute,
        overrides: Overrides::default(),
        resume: None,
        samples: None,
        replay: String::new(),
    };
    let facts =
        tokio::task::spawn_blocking(move || picture.load().and_then(|(scene, ready)| facts(&scene, ready))).await;
    let facts = facts.context("loading panicked")??;
    if json {
        print(&facts);
    } else {
        println!("{}", text(&facts));
    }
    Ok(())
}

fn facts(scene: &Scene, Ready { blobs, settings, notes, substitutions, .. }: Ready) -> anyhow::Result<Facts> {
    let triangles_of = |shapes: &[Shape]| -> usize {
        shapes.iter().filter_map(|shape| mesh_of(scene, &shape.geometry)).map(|mesh| mesh.triangles.len()).sum()
    };
    let triangles = scene.levels().map(triangles_of).sum();
    let of_groups: Vec<usize> = scene.groups.iter().map(|group| triangles_of(&group.shapes)).collect();
    let images: Vec<ImageFacts> = scene
        .images
        .iter()
        .map(|image| ImageFacts { width: image.width, height: image.height, bytes: image.bytes() })
        .collect();
    let begun = Instant::now();
    let world = World::compile(scene);
    let build_seconds = begun.elapsed().as_secs_f64();
    let Stats { nodes, blocks, bytes, sah_cost } = world.geometry.triangle_stats();
    let memory = memory(&world, triangles);
    let path_reuse = Tracer::new(Arc::new(world), settings.clone(), Isa::detect())?.reuses();
    let area_lights = scene.shapes.iter().filter(|shape| shape.radiance.is_some()).map(|_| "area");
    Ok(Facts {
        scene: blobs.digest.to_string(),
        shapes: count(scene.levels().flatten().map(|shape| match shape.geometry {
            Geometry::Mesh(_) => "mesh",
            Geometry::Sphere { .. } => "sphere",
            Geometry::Disk { .. } => "disk",
            Geometry::Cylinder { .. } => "cylinder",
        })),
        triangles,
        instances: scene.instances.len(),
        instanced_triangles: scene.instances.iter().map(|instance| of_groups[instance.group.0 as usize]).sum(),
        materials: count(scene.bsdfs.iter().map(bsdf_name)),
        textures: count(scene.textures.iter().filter_map(texture_name)),
        lights: count(scene.emitters.iter().map(emitter_name).chain(area_lights)),
        memory,
        images,
        hierarchy: HierarchyFacts { nodes, blocks, bytes, sah_cost, build_seconds },
        path_reuse,
        isa: Isa::detect().name(),
        settings,
        notes: notes.iter().map(ToString::to_string).collect(),
        substitutions: substitutions.iter().map(ToString::to_string).collect(),
    })
}

fn memory(world: &World, triangles: usize) -> MemoryFacts {
    let Memory { surfaces, hierarchies, instances } = world.geometry.memory();
    let a_triangle = (triangles > 0).then(|| (surfaces + hierarchies) as f64 / triangles as f64);
    MemoryFacts { surfaces, hierarchies, instances, textures: world.textures.bytes(), a_triangle }
}

fn mesh_of<'a>(scene: &'a Scene, geometry: &Geometry) -> Option<&'a Mesh> {
    match geometry {
        Geometry::Mesh(id) => scene.meshes.get(id.0 as usize).map(|mesh| &**mesh),
        Geometry::Sphere { .. } | Geometry::Disk { .. } | Geometry::Cylinder { .. } => None,
    }
}

/// The plugin's name.
pub fn bsdf_name(bsdf: &Bsdf) -> &'static str {
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
        Texture::MeshAttribute { .. } => Some("mesh_attribute"),
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
        memory_line(&facts.memory),
        format!(
            "hierarchy  {} nodes, {} blocks of triangles, {:.1} MB, average ray costs {:.1} visits, built in {:.2} s",
            nodes,
            blocks,
            *bytes as f64 / 1e6,
            sah_cost,
            build_seconds
        ),
        format!("traced by  {}", facts.isa),
        format!(
            "paths      {}",
            if facts.path_reuse { "reused by the pixels around theirs" } else { "each its own pixel's" }
        ),
        format!("film       {}x{}, crop {},{},{},{}", film.width, film.height, crop.x0, crop.y0, crop.x1, crop.y1),
        format!("filter     {:?}", film.filter),
        format!("samples    {spp} a pixel, {sampler:?}, seed {seed}"),
        format!("integrator {:?}, directions by {strategy:?}, longest path {depth}", integrator.kind),
    ];
    if facts.instances > 0 {
        let line = format!("instances  {} of {} triangles in all", facts.instances, facts.instanced_triangles);
        lines.insert(2, line);
    }
    lines.extend(facts.images.iter().map(|i| format!("image      {}x{}, {} bytes", i.width, i.height, i.bytes)));
    lines.extend(facts.substitutions.iter().map(|text| format!("replaced   {text}")));
    lines.extend(facts.notes.iter().map(|note| format!("note       {note}")));
    lines.join("\n")
}

fn memory_line(memory: &MemoryFacts) -> String {
    let MemoryFacts { surfaces, hierarchies, instances, textures, a_triangle } = memory;
    let megabytes = |bytes: &usize| *bytes as f64 / 1e6;
    let a_triangle = a_triangle.map_or(String::new(), |bytes| format!("; {bytes:.0} bytes a triangle"));
    format!(
        "memory     surfaces {:.1} MB, hierarchies {:.1} MB, instances {:.1} MB, textures {:.1} MB{a_triangle}",
        megabytes(surfaces),
        megabytes(hierarchies),
        megabytes(instances),
        megabytes(textures)
    )
}
