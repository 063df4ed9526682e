//! Nothing breaks: scenes that nobody would make on purpose have finite images, and take finite time.

use crate::build::{camera, long, room, scene, settings, shape};
use glam::{Affine3, Mat3, Vec3};
use proptest::prelude::*;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use tilecast_core::bvh::simd::Isa;
use tilecast_core::film;
use tilecast_core::load::{LoadOptions, load};
use tilecast_core::scene::{
    Bsdf, BsdfId, Distribution, Emitter, Geometry, Mesh, MeshId, Scene, Sensor, Shape, Texture, TextureId,
};
use tilecast_core::settings::{Integrator, IntegratorKind, Settings, Strategy as Directions};
use tilecast_core::trace::Tracer;
use tilecast_core::world::World;

/// Numbers in 0…1 from a seed, one after the other.
pub struct Dice(pub u64);

impl Dice {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut x = self.0;
        for _ in 0..3 {
            x = (x ^ x >> 31).wrapping_mul(0xd6e8_feb8_6659_fd93);
        }
        (x >> 40) as f32 / (1 << 24) as f32
    }

    pub fn of(&mut self, count: usize) -> usize {
        ((self.next() * count as f32) as usize).min(count - 1)
    }

    fn point(&mut self) -> Vec3 {
        Vec3::new(self.next(), self.next(), self.next()) * 2.0 - 1.0
    }
}

/// A triangle of one of the kinds that go wrong.
fn triangle(dice: &mut Dice, before: &[Vec3]) -> [Vec3; 3] {
    let (p, q, r) = (dice.point(), dice.point(), dice.point());
    match dice.of(9) {
        0 => [p, p, p],
        1 => [p, q, p + (q - p) * 0.5],
        2 => [p, p + q, p + q + r * 1e-7],
        3 => [p, p + q * 1e-6, p + r * 1e-6],
        4 => [p, p + q * 1e-25, p + r * 1e-25],
        // The same again, or in the same plane.
        5 if before.len() >= 3 => [before[0], before[1], before[2]],
        6 if before.len() >= 3 => [before[0], before[1], before[0] + (before[2] - before[0]) * 2.0],
        7 => [Vec3::new(-1.0, -1.0, 0.0), Vec3::new(1.0, -1.0, 0.0), Vec3::new(1.0, 1.0, 0.0)],
        _ => [p, q, r],
    }
}

pub fn material(dice: &mut Dice) -> Bsdf {
    let eta = [1.0, 1.0 + 1e-6, 1.5, 1.0 / 1.5, 1.000_001 / 1.5][dice.of(5)];
    let distribution = [Distribution::Ggx, Distribution::Beckmann][dice.of(2)];
    let (white, smooth, half, zero) = (TextureId(1), TextureId(2), TextureId(0), TextureId(3));
    let alpha = [smooth, half][dice.of(2)];
    let (specular_reflectance, specular_transmittance) = (white, white);
    match dice.of(12) {
        0 => Bsdf::Diffuse { reflectance: white },
        1 => Bsdf::Conductor { eta: half, k: white, specular_reflectance },
        2 => Bsdf::RoughConductor {
            distribution,
            alpha_u: alpha,
            alpha_v: smooth,
            eta: half,
            k: white,
            specular_reflectance,
        },
        3 => Bsdf::Dielectric { eta, specular_reflectance, specular_transmittance },
        4 => {
            let (alpha_u, alpha_v) = (alpha, alpha);
            Bsdf::RoughDielectric { distribution, alpha_u, alpha_v, eta, specular_reflectance, specular_transmittance }
        }
        5 => Bsdf::ThinDielectric { eta, specular_reflectance, specular_transmittance },
        6 => Bsdf::Plastic { eta, nonlinear: true, diffuse_reflectance: white, specular_reflectance },
        7 => {
            let (alpha, diffuse_reflectance) = ([1e-4, 0.5][dice.of(2)], white);
            Bsdf::RoughPlastic { distribution, alpha, eta, nonlinear: true, diffuse_reflectance, specular_reflectance }
        }
        8 => Bsdf::Phong { diffuse_reflectance: half, specular_reflectance: half, exponent: [0.0, 1e6][dice.of(2)] },
        9 => {
            let mut any = || [zero, half, white][dice.of(3)];
            let (roughness, anisotropic, metallic, spec_trans, spec_tint) = (any(), any(), any(), any(), any());
            let (sheen, sheen_tint, flatness, clearcoat, clearcoat_gloss) = (any(), any(), any(), any(), any());
            let (base_color, eta) = (half, if eta == 1.0 { 1.5 } else { eta });
            Bsdf::Principled {
                base_color,
                roughness,
                anisotropic,
                metallic,
                spec_trans,
                eta,
                spec_tint,
                sheen,
                sheen_tint,
                flatness,
                clearcoat,
                clearcoat_gloss,
            }
        }
        10 => Bsdf::Null,
        _ => Bsdf::Diffuse { reflectance: half },
    }
}

/// A handful of shapes of such triangles and materials, some of them lights, and lights that touch them.
fn any_scene(dice: &mut Dice) -> Scene {
    let mut any = scene(any_camera(dice), 0.5, Vec::new());
    any.textures.extend([Texture::Constant(Vec3::splat(1e-4)), Texture::Constant(Vec3::ZERO)]);
    for id in 0..1 + dice.of(4) as u32 {
        let mut mesh = Mesh::default();
        for _ in 0..1 + dice.of(12) {
            let first = mesh.positions.len() as u32;
            let corners = triangle(dice, &mesh.positions);
            mesh.positions.extend(corners);
            mesh.triangles.push([first, first + 1, first + 2]);
        }
        if dice.of(3) == 0 {
            // Whatever the surface: opposed to it, in it, or beside it.
            mesh.normals = mesh.positions.iter().map(|_| dice.point().try_normalize().unwrap_or(Vec3::Z)).collect();
        }
        any.bsdfs.push(material(dice));
        let bsdf = BsdfId(any.bsdfs.len() as u32 - 1);
        let radiance = (dice.of(3) == 0).then_some(TextureId(1));
        if dice.of(4) == 0 {
            any.emitters.push(Emitter::Point { position: mesh.positions[0], intensity: Vec3::ONE });
        }
        any.meshes.push(Arc::new(mesh));
        any.shapes.push(Shape { bsdf, radiance, ..shape(Geometry::Mesh(MeshId(id)), false) });
    }
    if dice.of(2) == 0 {
        let to_world = Affine3::from_scale(Vec3::splat([1.0, 1e-6, 0.3][dice.of(3)]));
        let sphere = Geometry::Sphere { to_world, flip_normals: dice.of(2) == 0 };
        let bsdf = BsdfId(any.bsdfs.len() as u32 - 1);
        any.shapes.push(Shape { bsdf, radiance: (dice.of(2) == 0).then_some(TextureId(1)), ..shape(sphere, false) });
    }
    match dice.of(3) {
        0 => any.emitters.push(Emitter::Constant { radiance: Vec3::ONE }),
        1 => any.emitters.push(Emitter::Directional { direction: Vec3::NEG_Z, irradiance: Vec3::ONE }),
        _ => {}
    }
    any
}

/// Along an axis, with zeros of either sign, or anyhow.
fn any_camera(dice: &mut Dice) -> Sensor {
    let zero = [0.0, -0.0][dice.of(2)];
    let axes = Mat3::from_cols(Vec3::new(1.0, zero, zero), Vec3::new(zero, -1.0, zero), Vec3::new(zero, zero, -1.0));
    let from = Vec3::new(zero, zero, 3.0);
    match dice.of(3) {
        0 => camera(from, axes.x_axis, axes.y_axis, axes.z_axis),
        1 => Sensor::Orthographic {
            to_world: Affine3 { matrix3: axes, translation: from },
            near_clip: 1e-3,
            far_clip: 1e4,
        },
        _ => {
            let z = -dice.point().try_normalize().unwrap_or(Vec3::Z);
            let (x, y) = z.any_orthonormal_pair();
            camera(-2.0 * z, x, y, z)
        }
    }
}

/// Every sample is finite and within the film's range; `what` says whose are not.
fn traced(any: &Scene, settings: &Settings, what: &str) {
    any.validate().unwrap_or_else(|error| panic!("{what}: {error}"));
    let world = Arc::new(World::compile(any));
    let tracer = Tracer::with_reuse(world, settings.clone(), Isa::detect(), true).unwrap();
    let never = AtomicBool::new(false);
    if let Err(error) = tracer.trace(settings.film.crop, 0..settings.spp, &never) {
        let (radiance, events) = tracer.replay(error.x, error.y, error.index);
        let path: Vec<String> = events.iter().map(|event| format!("{event:?}")).collect();
        panic!("{what}: {error}\n{radiance}\n{}\n{:?}", path.join("\n"), any.bsdfs);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(if long() { 20_000 } else { 400 }))]

    /// Seen to fail when hidden emitters may be passed without end and triangles without area have no normal (0/0): it hung.
    #[test]
    fn any_scene_has_an_image(seed: u64, strategy in 0usize..5, kind in 0usize..3) {
        let mut dice = Dice(seed);
        let any = any_scene(&mut dice);
        let mut job = settings(5, 8, crate::build::ALL_STRATEGIES[strategy]);
        let kind = [IntegratorKind::Path, IntegratorKind::Direct, IntegratorKind::Whitted][kind];
        job.integrator = Integrator { kind, max_depth: Some(40), rr_depth: [1, 5, 100][dice.of(3)], hide_emitters: dice.of(2) == 0 };
        // Points on surfaces are lights at no distance: 1/d² has no bound, and the film's range is no truth about them.
        job.scale_exponent = film::scale_exponent(1e30);
        traced(&any, &job, &format!("seed {seed}, {:?}", job.strategy));
    }
}

/// A white box without roulette: each path is ten thousand segments long, and none of its light is lost.
#[test]
fn ten_thousand_bounces_in_a_white_box() {
    let mut white = scene(camera(Vec3::new(0.2, 0.1, -0.3), Vec3::X, Vec3::Y, Vec3::Z), 1.0, Vec::new());
    white.meshes.push(Arc::new(room()));
    white.shapes = vec![shape(Geometry::Mesh(MeshId(0)), true)];
    let mut job = settings(2, 8, Directions::Bsdf);
    job.integrator.max_depth = Some(10_000);
    job.integrator.rr_depth = 20_000;
    job.scale_exponent = film::scale_exponent(1e5);
    let (mean, error) = crate::build::mean_and_error(&crate::build::render(&white, &job));
    // The cosine's weight is 1 but for rounding, which adds up along the path.
    assert!((mean / 10_000.0 - 1.0).abs() < 1e-3 && error < 1.0, "{mean} ± {error}");
}

/// A hundred thousand lamps, each of an area of 10^-12, over a plane; and one such lamp alone, as bright as all.
#[test]
fn many_and_tiny_lights() {
    for count in [1u32, 100_000] {
        let plane = Geometry::Disk { to_world: Affine3::from_scale(Vec3::splat(50.0)), flip_normals: false };
        let mut lit = scene(camera(Vec3::Z * 0.9, Vec3::X, -Vec3::Y, -Vec3::Z), 0.5, vec![shape(plane, false)]);
        let radiance = 1e12 / count as f32;
        lit.textures.push(Texture::Constant(Vec3::splat(radiance)));
        let mut lamps = Mesh::default();
        for i in 0..count {
            let (x, y) = ((i % 317) as f32 / 317.0 - 0.5, (i / 317) as f32 / 317.0 - 0.5);
            let at = if count == 1 { Vec3::Z } else { Vec3::new(x, y, 1.0) };
            let side = libm::sqrtf(2e-12);
            lamps.positions.extend([at, at + Vec3::Y * side, at + Vec3::X * side]);
            lamps.triangles.push([3 * i, 3 * i + 1, 3 * i + 2]);
        }
        lit.meshes.push(Arc::new(lamps));
        lit.shapes.push(Shape { radiance: Some(TextureId(2)), ..shape(Geometry::Mesh(MeshId(0)), true) });
        for strategy in [Directions::Light, Directions::Mis] {
            let mut job = settings(8, 64, strategy);
            job.scale_exponent = film::scale_exponent(radiance);
            job.integrator.kind = IntegratorKind::Direct;
            let (mean, error) = crate::build::mean_and_error(&crate::build::render(&lit, &job));
            assert!(mean.is_finite() && mean > 0.0 && error < 0.1 * mean, "{count} {strategy:?}: {mean} ± {error}");
            if count == 1 {
                // Flux through the middle: albedo/π · L A cos²θ / d², somewhat less towards the border of the picture.
                let middle = 0.5 / std::f64::consts::PI;
                assert!((0.8 * middle..1.01 * middle).contains(&mean), "{strategy:?}: {mean} for {middle}");
            }
        }
    }
}

/// Glass seen at grazing angles from within and without: total internal reflection begins where the sine is 1/1.5.
#[test]
fn glass_at_grazing_angles() {
    for eta in [1.5, 1.0 / 1.5, 1.0, 1.0 + 1e-6] {
        let to_world = Affine3::from_scale(Vec3::splat(50.0));
        let plane = Geometry::Disk { to_world, flip_normals: false };
        for height in [1e-2f32, 1e-5, -1e-2, -1e-5] {
            // Nearly along the plane.
            let sensor = camera(Vec3::new(0.0, 0.0, height), Vec3::Y, Vec3::Z, Vec3::X);
            let mut lit = scene(sensor, 0.5, vec![shape(plane.clone(), false)]);
            let one = TextureId(1);
            lit.emitters.push(Emitter::Constant { radiance: Vec3::ONE });
            let rough = |alpha: f32| {
                let id = TextureId(2);
                (id, Texture::Constant(Vec3::splat(alpha)))
            };
            let (alpha, texture) = rough(1e-4);
            lit.textures.push(texture);
            let (specular_reflectance, specular_transmittance) = (one, one);
            let glass = [
                Bsdf::Dielectric { eta, specular_reflectance, specular_transmittance },
                Bsdf::RoughDielectric {
                    distribution: Distribution::Ggx,
                    alpha_u: alpha,
                    alpha_v: alpha,
                    eta,
                    specular_reflectance,
                    specular_transmittance,
                },
            ];
            for bsdf in glass {
                lit.bsdfs = vec![bsdf.clone()];
                for strategy in crate::build::ALL_STRATEGIES {
                    let mut job = settings(5, 16, strategy);
                    job.scale_exponent = film::scale_exponent(1e9);
                    job.integrator.max_depth = Some(8);
                    traced(&lit, &job, &format!("eta {eta} height {height} {strategy:?} {bsdf:?}"));
                }
            }
        }
    }
}

/// What a file may hold that is no surface: numbers that are none are an error which says where, triangles without area are left out
/// with a note, and what has area stays, be it a sliver of 1 : 10^7, twice there, or in the plane of another.
#[test]
fn files_with_bad_triangles_load_or_say_why_not() {
    let folder = tempfile::tempdir().unwrap();
    let xml = r#"<scene version="3.0.0"><sensor type="perspective"/><shape type="obj"><string name="filename" value="a.obj"/></shape></scene>"#;
    let scene = folder.path().join("scene.xml");
    std::fs::write(&scene, xml).unwrap();
    let load = |obj: &str| {
        std::fs::write(folder.path().join("a.obj"), obj).unwrap();
        load(&scene, &LoadOptions::default())
    };
    let plain = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nv 0.5 1e-7 0\nv 2 0 0\n";
    for bad in ["nan", "inf", "-inf", "1e39"] {
        let error = load(&format!("v 0 {bad} 0\n{plain}f 1 2 3\n")).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("a.obj:1:1") && error.contains("finite"), "{bad}: {error}");
    }
    // One twice, one in the same plane, a sliver; then one without area because its corners lie on a line, one with a corner twice.
    let loaded = load(&format!("{plain}f 1 2 3\nf 1 2 3\nf 2 4 3\nf 1 2 5\nf 1 2 6\nf 1 1 2\n")).unwrap();
    assert_eq!(loaded.scene.meshes[0].triangles.len(), 4);
    let notes: Vec<String> = loaded.notes.iter().map(|note| note.to_string()).collect();
    assert!(notes.iter().any(|note| note.contains("2 degenerate triangles")), "{notes:?}");
    traced(&loaded.scene, &settings(5, 8, Directions::Mis), "bad triangles");
}
