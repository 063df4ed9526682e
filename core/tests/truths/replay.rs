//! A replayed sample is the rendered one, and the path that is told makes up all of it.

use crate::build::{camera, room, scene, settings, shape};
use glam::Vec3;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use tilecast_core::bvh::simd::Isa;
use tilecast_core::film::{Film, TileSums};
use tilecast_core::load::{LoadOptions, load};
use tilecast_core::scene::{Emitter, Geometry, MeshId};
use tilecast_core::settings::{IntegratorKind, SamplerKind, Settings, Strategy, Window};
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
        let tracer = Tracer::with_reuse(Arc::new(World::compile(&lit)), settings.clone(), Isa::detect(), true).unwrap();
        let mut sums = TileSums::new(settings.film.crop, 0..settings.spp);
        for (i, pixel) in sums.pixels.iter_mut().enumerate() {
            for index in 0..settings.spp {
                let (radiance, events) = tracer.replay(i as u32 % 4, i as u32 / 4, index);
                pixel.add(index, radiance, settings.scale_exponent).unwrap();
                let told: Vec3 = events
                    .iter()
                    .map(|event| match event {
                        Event::Emission { gained, .. } | Event::Light { gained, .. } | Event::Others { gained } => {
                            *gained
                        }
                        _ => Vec3::ZERO,
                    })
                    .sum();
                assert!((told - radiance).abs().max_element() <= 1e-5 * radiance.max_element(), "{told} {radiance}");
                let own = events.iter().rev().find(|event| !matches!(event, Event::Others { .. }));
                assert!(matches!(own, Some(Event::End(_))), "{events:?}");
            }
        }
        let mut film = Film::new(&settings);
        film.merge(&sums);
        let rendered = tracer.trace(settings.film.crop, 0..settings.spp, &AtomicBool::new(false)).unwrap().unwrap();
        assert!(rendered == sums, "emits: {emits}");
    }
}

/// A sample's bits do not depend on the paths that are under way beside it: one by one they make the image that waves make, on
/// every instruction set, in scenes of all kinds of surfaces and lights, with every integrator and sampler. Fails if a branch's
/// second ray moves the surface that the branches share, or if the wave takes a curved lamp for a flat one.
#[test]
fn waves_and_single_paths_are_the_same() {
    for name in ["cornell-box", "furnace", "plates", "veach-strategies"] {
        let file = format!("{}/../scenes/{name}/scene.xml", env!("CARGO_MANIFEST_DIR"));
        let loaded = load(file.as_ref(), &LoadOptions::default()).unwrap();
        let world = Arc::new(World::compile(&loaded.scene));
        let size = |settings: &mut Settings| {
            (settings.film.width, settings.film.height) = (9, 7);
            settings.film.crop = Window { x0: 0, x1: 9, y0: 0, y1: 7 };
            settings.spp = 4;
        };
        for kind in [IntegratorKind::Path, IntegratorKind::Direct, IntegratorKind::Whitted] {
            for sampler in [SamplerKind::Sobol, SamplerKind::SobolJoint] {
                let mut settings = loaded.settings.clone();
                size(&mut settings);
                settings.integrator.kind = kind;
                settings.sampler = sampler;
                let stop = AtomicBool::new(false);
                let (crop, samples) = (settings.film.crop, 0..settings.spp);
                let tracer = |isa| Tracer::with_reuse(world.clone(), settings.clone(), isa, true).unwrap();
                let mut single = TileSums::new(crop, samples.clone());
                for (i, pixel) in single.pixels.iter_mut().enumerate() {
                    for index in samples.clone() {
                        let (radiance, _) = tracer(Isa::Portable).replay(i as u32 % 9, i as u32 / 9, index);
                        pixel.add(index, radiance, settings.scale_exponent).unwrap();
                    }
                }
                for isa in Isa::available() {
                    let waves = tracer(isa).trace(crop, samples.clone(), &stop).unwrap().unwrap();
                    assert!(waves == single, "{name}, {kind:?}, {sampler:?} on {}", isa.name());
                }
            }
        }
    }
}
