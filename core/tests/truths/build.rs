//! Small scenes made in code, and their renders.

use glam::{Affine3, Mat3, Vec3};
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};
use tilecast_core::bvh::simd::Isa;
use tilecast_core::film::{self, Film};
use tilecast_core::load::{LoadOptions, Loaded, load};
use tilecast_core::scene::{Bsdf, BsdfId, FovAxis, Geometry, Mesh, Scene, Sensor, Shape, Texture, TextureId};
use tilecast_core::settings::{
    Film as FilmSettings, Filter, Integrator, IntegratorKind, SamplerKind, Settings, Strategy, Window, Without,
};
use tilecast_core::trace::Tracer;
use tilecast_core::world::World;
use tilecast_measure::image::{Image, Variance};

pub const ALL_STRATEGIES: [Strategy; 5] =
    [Strategy::Uniform, Strategy::Cosine, Strategy::Bsdf, Strategy::Light, Strategy::Mis];

pub fn camera(from: Vec3, x: Vec3, y: Vec3, z: Vec3) -> Sensor {
    Sensor::Perspective {
        to_world: Affine3 { matrix3: Mat3::from_cols(x, y, z), translation: from },
        fov_degrees: 40.0,
        fov_axis: FovAxis::X,
        principal_point_offset: [0.0; 2],
        near_clip: 1e-3,
        far_clip: 1e4,
        lens: None,
    }
}

pub fn settings(side: u32, spp: u32, strategy: Strategy) -> Settings {
    Settings {
        film: FilmSettings {
            width: side,
            height: side,
            crop: Window { x0: 0, y0: 0, x1: side, y1: side },
            filter: Filter::Box,
        },
        spp,
        seed: 1,
        integrator: Integrator { kind: IntegratorKind::Path, max_depth: None, rr_depth: 5, hide_emitters: false },
        strategy,
        sampler: SamplerKind::Sobol,
        without: Without::default(),
        half: Default::default(),
        offsets: Default::default(),
        scale_exponent: film::scale_exponent(100.0),
    }
}

pub fn render(scene: &Scene, settings: &Settings) -> Film {
    scene.validate().unwrap();
    let tracer = Tracer::new(Arc::new(World::compile(scene)), settings.clone(), Isa::detect()).unwrap();
    let mut film = Film::new(settings);
    let never = AtomicBool::new(false);
    film.merge(&tracer.trace(settings.film.crop, 0..settings.spp, &never).unwrap().unwrap());
    film
}

/// Pixels within blocks of this side may err together, since they reuse each other's paths.
const BLOCK: u32 = 4;

/// Mean over the image's red channel, and the standard error of it, from the spread of the replicates' means over each block.
pub fn mean_and_error(film: &Film) -> (f64, f64) {
    let w = film.window;
    let scale = 2f64.powi(-film.scale_exponent);
    let (mut sum, mut variance) = (0.0, 0.0);
    let starts = |from: u32, to: u32| (from / BLOCK..to.div_ceil(BLOCK)).map(|n| n * BLOCK);
    for (x0, y0) in starts(w.y0, w.y1).flat_map(|y| starts(w.x0, w.x1).map(move |x| (x, y))) {
        let mut means = [0.0; film::REPLICATES];
        for (x, y) in (y0.max(w.y0)..(y0 + BLOCK).min(w.y1))
            .flat_map(|y| (x0.max(w.x0)..(x0 + BLOCK).min(w.x1)).map(move |x| (x, y)))
        {
            sum += f64::from(film.estimate(x, y).mean[0]);
            let i = ((y - w.y0) * w.width() + (x - w.x0)) as usize;
            for (r, mean) in means.iter_mut().enumerate() {
                *mean += film.sums()[i].0[r][0] as f64 * scale / f64::from(film.counts()[i][r]);
            }
        }
        let replicates = means.len() as f64;
        let middle = means.iter().sum::<f64>() / replicates;
        let spread = means.iter().map(|mean| (mean - middle).powi(2)).sum::<f64>();
        variance += spread / (replicates * (replicates - 1.0));
    }
    let n = w.area() as f64;
    (sum / n, variance.sqrt() / n)
}

pub fn scene(sensor: Sensor, albedo: f32, shapes: Vec<Shape>) -> Scene {
    Scene {
        sensor,
        shapes,
        bsdfs: vec![Bsdf::Diffuse { reflectance: TextureId(0) }],
        textures: vec![Texture::Constant(Vec3::splat(albedo)), Texture::Constant(Vec3::ONE)],
        groups: Vec::new(),
        instances: Vec::new(),
        emitters: Vec::new(),
        meshes: Vec::new(),
        images: Vec::new(),
        origin: [0.0; 3],
    }
}

pub fn shape(geometry: Geometry, emits: bool) -> Shape {
    Shape { name: "shape".into(), geometry, bsdf: BsdfId(0), radiance: emits.then_some(TextureId(1)) }
}

/// A box of two units, normals inwards.
pub fn room() -> Mesh {
    let positions =
        (0..8).map(|i| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32) * 2.0 - 1.0).collect();
    let quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];
    let triangles = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    Mesh { positions, triangles, ..Mesh::default() }
}

/// Whether the long forms are asked for: `just accuracy` does.
pub fn long() -> bool {
    std::env::var_os("TILECAST_LONG").is_some()
}

/// The path of a scene of this repository.
pub fn scene_path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes").join(name)
}

/// A scene file, and its settings for a small picture.
pub fn loaded(path: &Path, [width, height]: [u32; 2], spp: u32) -> (Scene, Settings) {
    let Loaded { scene, mut settings, .. } = load(path, &LoadOptions::default()).unwrap();
    let crop = Window { x0: 0, y0: 0, x1: width, y1: height };
    settings.film = FilmSettings { width, height, crop, filter: Filter::Box };
    (scene, Settings { spp, ..settings })
}

/// All of a picture on all cores, in chunks of samples.
pub fn render_wide(world: &Arc<World>, settings: &Settings) -> Film {
    let tracer = Tracer::new(world.clone(), settings.clone(), Isa::detect()).unwrap();
    let never = AtomicBool::new(false);
    let chunk = settings.spp.div_ceil(64).next_multiple_of(4);
    let parts: Vec<u32> = (0..settings.spp).step_by(chunk as usize).collect();
    let merged = Mutex::new(Film::new(settings));
    parts.into_par_iter().for_each(|first| {
        let range = first..(first + chunk).min(settings.spp);
        let part = tracer.trace(settings.film.crop, range, &never).unwrap().unwrap();
        merged.lock().unwrap().merge(&part);
    });
    merged.into_inner().unwrap()
}

/// A film as an image that says how sure it is.
pub fn image_of(name: &str, film: &Film) -> Image {
    let w = film.window;
    let estimates = || (w.y0..w.y1).flat_map(|y| (w.x0..w.x1).map(move |x| (x, y))).map(|(x, y)| film.estimate(x, y));
    Image {
        name: name.into(),
        width: w.width() as usize,
        height: w.height() as usize,
        rgb: estimates().map(|e| e.mean).collect(),
        variance: Some(Variance {
            rgb: estimates().map(|e| e.variance).collect(),
            freedom: Some(film::REPLICATES as u32 - 1),
        }),
    }
}
