//! A replayed sample is the rendered one, and the path that is told makes up all of it.

use crate::build::{camera, render, room, scene, settings, shape};
use glam::Vec3;
use std::sync::Arc;
use tilecast_core::bvh::simd::Isa;
use tilecast_core::film::{Film, TileSums};
use tilecast_core::scene::{Emitter, Geometry, MeshId};
use tilecast_core::settings::Strategy;
use tilecast_core::trace::Tracer;
use tilecast_core::witness::Event;
use tilecast_core::world::World;

/// The film made of replays has the digest of the rendered one, and what each path is told to have gained adds up to its
/// radiance. Fails if a gain is told without its throughput, or if watching draws other numbers.
#[test]
fn replays_make_up_the_image() {
    let mut lit = scene(camera(Vec3::new(0.2, 0.1, -0.3), Vec3::X, Vec3::Y, Vec3::Z), 0.7, Vec::new());
    lit.meshes.push(Arc::new(room()));
    lit.shapes = vec![shape(Geometry::Mesh(MeshId(0)), false)];
    lit.emitters.push(Emitter::Point { position: Vec3::new(0.5, 0.6, 0.2), intensity: Vec3::new(1.0, 0.5, 0.2) });
    for emits in [false, true] {
        lit.shapes[0].radiance = emits.then_some(lit.bsdfs.len() as u32).map(tilecast_core::scene::TextureId);
        let settings = settings(4, 8, Strategy::Mis);
        let tracer = Tracer::new(Arc::new(World::compile(&lit)), settings.clone(), Isa::detect()).unwrap();
        let mut sums = TileSums::new(settings.film.crop, 0..settings.spp);
        for (i, pixel) in sums.pixels.iter_mut().enumerate() {
            for index in 0..settings.spp {
                let (radiance, events) = tracer.replay(i as u32 % 4, i as u32 / 4, index);
                pixel.add(index, radiance, settings.scale_exponent).unwrap();
                let told: Vec3 = events
                    .iter()
                    .map(|event| match event {
                        Event::Emission { gained, .. } | Event::Light { gained, .. } => *gained,
                        _ => Vec3::ZERO,
                    })
                    .sum();
                assert!((told - radiance).abs().max_element() <= 1e-5 * radiance.max_element(), "{told} {radiance}");
                assert!(matches!(events.last(), Some(Event::End(_))), "{events:?}");
            }
        }
        let mut film = Film::new(&settings);
        film.merge(&sums);
        assert_eq!(film.digest(), render(&lit, &settings).digest());
    }
}
