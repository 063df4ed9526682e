//! Paths that are reused leave every pixel its expected value, between materials of all kinds and far from each other.

use crate::build::{camera, loaded, long, room, scene, scene_path, settings, shape};
use crate::robust::{Dice, material};
use glam::{Affine3, Vec3};
use rayon::prelude::*;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use tilecast_core::bvh::simd::Isa;
use tilecast_core::film::Film;
use tilecast_core::scene::{Bsdf, BsdfId, Emitter, Geometry, MeshId, Scene, Sensor, Shape, Texture, TextureId};
use tilecast_core::settings::{IntegratorKind, SamplerKind, Settings, Strategy};
use tilecast_core::trace::Tracer;
use tilecast_core::world::World;

/// One block is the whole picture, so that the first surfaces that reuse each other's paths are far apart.
const SIDE: u32 = 4;
const VALUES: usize = (3 * SIDE * SIDE) as usize;
/// Renders that tell mean and spread.
const RENDERS: u64 = 16;

/// Mean of a few renders, and the variance of that mean, by pixel and channel.
fn averaged(world: &Arc<World>, job: &Settings, reuse: bool) -> Vec<[f64; 2]> {
    let never = AtomicBool::new(false);
    let renders: Vec<Vec<f64>> = (0..RENDERS)
        .into_par_iter()
        .map(|seed| {
            let job = Settings { seed: 2 * seed + u64::from(reuse), ..job.clone() };
            let tracer = Tracer::with_reuse(world.clone(), job.clone(), Isa::detect(), reuse).unwrap();
            assert_eq!(tracer.reuses(), reuse);
            let mut film = Film::new(&job);
            film.merge(&tracer.trace(job.film.crop, 0..job.spp, &never).unwrap().unwrap());
            let pixels = (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (x, y)));
            pixels.flat_map(|(x, y)| film.estimate(x, y).mean.map(f64::from)).collect()
        })
        .collect();
    let n = RENDERS as f64;
    let of_value = |i: usize| {
        let mean = renders.iter().map(|values| values[i]).sum::<f64>() / n;
        let spread = renders.iter().map(|values| (values[i] - mean).powi(2)).sum::<f64>();
        [mean, spread / (n * (n - 1.0))]
    };
    (0..VALUES).map(of_value).collect()
}

/// The mean of z² over pixels and channels of renders with and without reuse, one if they differ by chance alone (and a little
/// more since variances are estimated). What chance does not touch must be the same.
fn difference(what: &str, world: &Arc<World>, job: &Settings) -> f64 {
    let (with, without) = (averaged(world, job, true), averaged(world, job, false));
    let mut squares = 0.0;
    for (i, ([a, va], [b, vb])) in with.into_iter().zip(without).enumerate() {
        // Rounding, where nothing else differs.
        let z = (a - b) / (va + vb + (1e-6 * (a + b)).powi(2) + 1e-30).sqrt();
        assert!(z.abs() < 9.0, "{what}, value {i}: {a} with, {b} without, z {z}");
        squares += z * z;
    }
    squares / VALUES as f64
}

/// A room whose walls are of one material, with a ball of another, a lamp, and a mirror ball.
fn any_room(dice: &mut Dice) -> Scene {
    let mut sensor = camera(Vec3::new(0.2, 0.1, -0.3), Vec3::X, Vec3::Y, Vec3::Z);
    if let Sensor::Perspective { fov_degrees, .. } = &mut sensor {
        *fov_degrees = 110.0;
    }
    let mut any = scene(sensor, 0.5, Vec::new());
    any.textures.extend([Texture::Constant(Vec3::splat(0.3)), Texture::Constant(Vec3::new(0.2, 0.5, 0.8))]);
    any.meshes.push(Arc::new(room()));
    let ball = |at: Vec3, radius: f32| Geometry::Sphere {
        to_world: Affine3::from_translation(at) * Affine3::from_scale(Vec3::splat(radius)),
        flip_normals: false,
    };
    let (mut walls, other) = (material(dice), material(dice));
    if dice.of(5) == 0 {
        // Often, since it does both: mirror and scatter.
        let (diffuse_reflectance, specular_reflectance) = (TextureId(1), TextureId(1));
        walls = Bsdf::Plastic { eta: 3.0, nonlinear: false, diffuse_reflectance, specular_reflectance };
    }
    let first = any.bsdfs.len() as u32;
    any.bsdfs.extend([walls, other]);
    // Both sides of the walls, so that the room is what its material is.
    any.bsdfs.push(Bsdf::TwoSided { front: BsdfId(0), back: BsdfId(0) });
    let is_one_sided = !matches!(
        any.bsdfs[first as usize],
        Bsdf::Dielectric { .. }
            | Bsdf::RoughDielectric { .. }
            | Bsdf::ThinDielectric { .. }
            | Bsdf::Principled { .. }
            | Bsdf::Null
    );
    if is_one_sided {
        any.bsdfs[first as usize + 2] = Bsdf::TwoSided { front: BsdfId(first), back: BsdfId(first) };
    }
    any.shapes.push(Shape { bsdf: BsdfId(first + 2), ..shape(Geometry::Mesh(MeshId(0)), false) });
    any.shapes.push(Shape { bsdf: BsdfId(first + 1), ..shape(ball(Vec3::new(0.5, 0.1, 0.4), 0.3), false) });
    any.shapes.push(Shape { bsdf: BsdfId(first), ..shape(ball(Vec3::new(-0.4, -0.3, 0.4), 0.25), false) });
    let lamp = shape(ball(Vec3::new(0.1, 0.7, 0.2), 0.2), false);
    any.shapes.push(Shape { radiance: Some(TextureId(any.textures.len() as u32 - 1)), ..lamp });
    any.emitters.push(Emitter::Point { position: Vec3::new(-0.5, 0.5, -0.2), intensity: Vec3::splat(0.2) });
    any
}

/// Seen to fail when what cannot be seen counts, when |cos θ| at the second surface is left out, when a direction chosen there
/// counts with its own path's density alone, when light there is weighed by a wrong one, and when what a mirror chose is reused.
#[test]
fn all_materials_keep_their_means() {
    let rooms = if long() { 2000 } else { 60 };
    let mut sum = 0.0;
    for seed in 0..rooms {
        let any = any_room(&mut Dice(seed));
        any.validate().unwrap();
        let mut job = settings(SIDE, 64, [Strategy::Mis, Strategy::Bsdf, Strategy::Light][seed as usize % 3]);
        job.integrator.max_depth = Some(6);
        let of: Vec<String> = any.bsdfs[1..].iter().map(|bsdf| format!("{bsdf:?}")).collect();
        let what = format!("seed {seed}, {:?} in a room of\n{}", job.strategy, of.join("\n"));
        let squares = difference(&what, &Arc::new(World::compile(&any)), &job);
        assert!(squares < 5.0, "{what}: z of {}", squares.sqrt());
        sum += squares;
    }
    let mean = sum / rooms as f64;
    assert!(mean < 1.35, "z² of {mean} on the average");
}

/// The same for the repository's scenes, and whatever random numbers are chosen by.
#[test]
fn scenes_keep_their_means() {
    for name in ["cornell-box", "veach-strategies", "plates", "furnace"] {
        let (scene, job) = loaded(&scene_path(&format!("{name}/scene.xml")), [SIDE, SIDE], 64);
        let world = Arc::new(World::compile(&scene));
        for sampler in [SamplerKind::Sobol, SamplerKind::SobolJoint, SamplerKind::SobolZ, SamplerKind::Independent] {
            let mut job = Settings { sampler, ..job.clone() };
            job.integrator.kind = IntegratorKind::Path;
            let squares = difference(&format!("{name}, {sampler:?}"), &world, &job);
            assert!(squares < 3.0, "{name}, {sampler:?}: z of {}", squares.sqrt());
        }
    }
}
