//! Paths that are reused leave every pixel its expected value, between materials of all kinds and far from each other.

use crate::build::{camera, loaded, long, room, scene, scene_path, settings, shape};
use crate::means::{self, Case, SIDE, difference};
use crate::robust::{Dice, material};
use glam::{Affine3, Vec3};
use std::sync::Arc;
use tilecast_core::scene::{Bsdf, BsdfId, Emitter, Geometry, MeshId, Scene, Sensor, Shape, Texture, TextureId};
use tilecast_core::settings::{IntegratorKind, SamplerKind, Settings, Strategy};
use tilecast_core::world::World;

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
    means::all_look_alike((0..rooms).map(|seed| {
        let scene = any_room(&mut Dice(seed));
        let mut job = settings(SIDE, 64, [Strategy::Mis, Strategy::Bsdf, Strategy::Light][seed as usize % 3]);
        job.integrator.max_depth = Some(6);
        let of: Vec<String> = scene.bsdfs[1..].iter().map(|bsdf| format!("{bsdf:?}")).collect();
        let what = format!("seed {seed}, {:?} in a room of\n{}", job.strategy, of.join("\n"));
        Case { what, scene, ways: [(job.clone(), true), (job, false)] }
    }));
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
            let squares = difference(&format!("{name}, {sampler:?}"), &world, &[(job.clone(), true), (job, false)]);
            assert!(squares < 3.0, "{name}, {sampler:?}: z of {}", squares.sqrt());
        }
    }
}
