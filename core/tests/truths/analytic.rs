//! Analytic answers: scenes whose radiance is known from a formula, rendered and compared within their own error bars.

use crate::build::{ALL_STRATEGIES, camera, mean_and_error, render, room, scene, settings, shape};
use glam::{Affine3, Mat3, Vec3};
use std::sync::Arc;
use tilecast_core::scene::{
    Bsdf, Distribution, Emitter, Geometry, Image, ImageId, Mesh, MeshId, Shape, Texels, Texture, TextureId,
};
use tilecast_core::settings::{Film as FilmSettings, IntegratorKind, Settings, Strategy, Window};

/// A closed furnace with albedo a and emission 1: L = Σ aᵏ = 1/(1−a), for every strategy. Seen to fail for a cosine's density that is
/// a thousandth too large. Fails if Russian roulette is not
/// divided out, if a density lacks its 1/π, or if rays escape.
#[test]
fn a_furnace_sums_the_geometric_series() {
    let sensor = camera(Vec3::new(0.2, 0.1, -0.3), Vec3::X, Vec3::Y, Vec3::Z);
    for albedo in [0.2f32, 0.5, 0.9] {
        let truth = 1.0 / (1.0 - f64::from(albedo));
        let sphere = Geometry::Sphere { to_world: Affine3::IDENTITY, flip_normals: true };
        let mut boxed = scene(sensor.clone(), albedo, vec![shape(Geometry::Mesh(MeshId(0)), true)]);
        boxed.meshes.push(Arc::new(room()));
        for (name, scene) in [("sphere", scene(sensor.clone(), albedo, vec![shape(sphere, true)])), ("box", boxed)] {
            for strategy in ALL_STRATEGIES {
                // Uniform weights 2a cos θ have the second moment 4a²/3 a bounce: from a = √¾ on the variance is infinite.
                if strategy == Strategy::Uniform && albedo > 0.86 {
                    continue;
                }
                let (mean, error) = mean_and_error(&render(&scene, &settings(16, 256, strategy)));
                assert!(
                    (mean - truth).abs() < 4.0 * error + 1e-5 * truth,
                    "{name} a={albedo} {strategy:?}: {mean} ± {error} for {truth}"
                );
                assert!(error < 0.01 * truth, "{name} {strategy:?}: error {error} is too large to tell");
            }
        }
    }
}

/// A white diffuse plane under a constant sky of radiance 1 shows its albedo.
#[test]
fn a_plane_under_the_sky_shows_its_albedo() {
    let plane = Geometry::Disk { to_world: Affine3::from_scale(Vec3::splat(50.0)), flip_normals: false };
    let mut sky = scene(camera(Vec3::Z * 2.0, Vec3::X, -Vec3::Y, -Vec3::Z), 0.6, vec![shape(plane, false)]);
    sky.emitters.push(Emitter::Constant { radiance: Vec3::ONE });
    for strategy in ALL_STRATEGIES {
        let (mean, error) = mean_and_error(&render(&sky, &settings(16, 64, strategy)));
        assert!((mean - 0.6).abs() < 4.0 * error + 1e-5, "{strategy:?}: {mean} ± {error}");
    }
}

/// A plane under a sky with a few suns: light sampling, alone and with its density compensated, agrees with cosine
/// sampling, which knows nothing of the image.
#[test]
fn an_environment_lights_alike_under_every_strategy() {
    let plane = Geometry::Disk { to_world: Affine3::from_scale(Vec3::splat(50.0)), flip_normals: false };
    let mut sky = scene(camera(Vec3::Z * 2.0, Vec3::X, -Vec3::Y, -Vec3::Z), 0.6, vec![shape(plane, false)]);
    let texel = |i: u32| if i % 149 == 3 { 90.0 } else { 0.1 * (i % 5) as f32 };
    let texels = Texels::Rgb32((0..64 * 32).flat_map(|i| [texel(i); 3]).collect());
    sky.images.push(Arc::new(Image { width: 64, height: 32, texels }));
    let to_world = Mat3::from_axis_angle(Vec3::new(0.6, 0.0, 0.8), 1.0);
    sky.emitters.push(Emitter::Envmap { image: ImageId(0), scale: 0.5, to_world });
    let (truth, allowed) = mean_and_error(&render(&sky, &settings(16, 1024, Strategy::Cosine)));
    for strategy in [Strategy::Light, Strategy::Mis] {
        let (mean, error) = mean_and_error(&render(&sky, &settings(16, 64, strategy)));
        assert!(
            (mean - truth).abs() < 4.0 * (error + allowed),
            "{strategy:?}: {mean} ± {error} for {truth} ± {allowed}"
        );
        // Cosine sampling would have four times the error that it has with sixteen times the samples.
        assert!(error < 2.0 * allowed, "{strategy:?}: error {error} against {allowed}");
    }
}

/// A field of small lamps over a plane, some dark, one bright: chosen by the tree they light it as cosine sampling finds them,
/// which knows of no light.
#[test]
fn many_lights_light_as_brute_force_says() {
    let plane = Geometry::Disk { to_world: Affine3::from_scale(Vec3::splat(50.0)), flip_normals: false };
    let mut lit = scene(camera(Vec3::Z * 0.9, Vec3::X, -Vec3::Y, -Vec3::Z), 0.5, vec![shape(plane, false)]);
    lit.textures.extend([Texture::Constant(Vec3::ZERO), Texture::Constant(Vec3::splat(20.0))]);
    let mut lamps = [Mesh::default(), Mesh::default(), Mesh::default()];
    for i in 0..64u32 {
        let kind = if i == 27 { 2 } else { (i % 5 == 0) as usize };
        let at = Vec3::new((i % 8) as f32 - 3.5, (i / 8) as f32 - 3.5, 1.0 + (i % 3) as f32 * 0.3);
        let first = lamps[kind].positions.len() as u32;
        let tilt = Vec3::new(0.0, 0.0, 0.2 * (i % 4) as f32);
        lamps[kind].positions.extend([at, at + Vec3::Y * 0.5 + tilt, at + Vec3::X * 0.5]);
        lamps[kind].triangles.push([first, first + 1, first + 2]);
    }
    for (i, mesh) in lamps.into_iter().enumerate() {
        let radiance = Some(TextureId(i as u32 + 1));
        lit.meshes.push(Arc::new(mesh));
        lit.shapes.push(Shape { radiance, ..shape(Geometry::Mesh(MeshId(i as u32)), true) });
    }
    let mut direct = settings(16, 1 << 12, Strategy::Cosine);
    direct.integrator.kind = IntegratorKind::Direct;
    let (truth, allowed) = mean_and_error(&render(&lit, &direct));
    for strategy in [Strategy::Light, Strategy::Mis] {
        let (mean, error) = mean_and_error(&render(&lit, &Settings { spp: 256, strategy, ..direct.clone() }));
        assert!(
            (mean - truth).abs() < 4.0 * (error + allowed),
            "{strategy:?}: {mean} ± {error} for {truth} ± {allowed}"
        );
        assert!(error + allowed < 0.005 * truth, "{strategy:?}: ± {error} for {truth} ± {allowed}");
    }
}

/// Irradiance I cos θ / d² from a point light, E cos θ from parallel light, times albedo/π; depth 2 is direct light.
#[test]
fn delta_lights_have_their_formulas() {
    let plane = Geometry::Disk { to_world: Affine3::from_scale(Vec3::splat(50.0)), flip_normals: false };
    let mut lit = scene(camera(Vec3::Z * 2.0, Vec3::X, -Vec3::Y, -Vec3::Z), 0.5, vec![shape(plane, false)]);
    let position = Vec3::new(0.0, 0.0, 3.0);
    let direction = Vec3::new(0.6, 0.0, -0.8);
    let mut narrow = settings(1, 64, Strategy::Mis);
    narrow.film =
        FilmSettings { width: 101, height: 101, crop: Window { x0: 50, y0: 50, x1: 51, y1: 51 }, ..narrow.film };
    let albedo_over_pi = 0.5 / std::f64::consts::PI;
    lit.emitters = vec![Emitter::Point { position, intensity: Vec3::splat(9.0) }];
    let (mean, _) = mean_and_error(&render(&lit, &narrow));
    assert!((mean - albedo_over_pi).abs() < 1e-4, "point light: {mean}");
    lit.emitters = vec![Emitter::Directional { direction, irradiance: Vec3::splat(2.0) }];
    let (mean, _) = mean_and_error(&render(&lit, &narrow));
    assert!((mean - 1.6 * albedo_over_pi).abs() < 1e-4, "parallel light: {mean}");
}

/// The irradiance below a disk light of radius r at height h is π L r²/(r² + h²); a sphere light of radius r at distance d:
/// π L r²/d².
#[test]
fn area_lights_have_their_form_factors() {
    let plane = Geometry::Disk { to_world: Affine3::from_scale(Vec3::splat(50.0)), flip_normals: false };
    let disk = Geometry::Disk { to_world: Affine3::from_translation(Vec3::Z * 2.0), flip_normals: true };
    let sphere = Geometry::Sphere { to_world: Affine3::from_translation(Vec3::Z * 3.0), flip_normals: false };
    // From below the lights, looking straight down.
    let sensor = camera(Vec3::Z * 0.5, Vec3::X, -Vec3::Y, -Vec3::Z);
    for (light, form_factor) in [(disk, 1.0 / 5.0), (sphere, 1.0 / 9.0)] {
        let lit = scene(sensor.clone(), 0.5, vec![shape(plane.clone(), false), shape(light, true)]);
        for strategy in ALL_STRATEGIES {
            let mut one = settings(1, 1 << 16, strategy);
            one.integrator.kind = IntegratorKind::Direct;
            one.film = FilmSettings {
                width: 1001,
                height: 1001,
                crop: Window { x0: 500, y0: 500, x1: 501, y1: 501 },
                ..one.film
            };
            let film = render(&lit, &one);
            let estimate = film.estimate(500, 500);
            let (mean, error) = (f64::from(estimate.mean[0]), f64::from(estimate.variance[0]).sqrt());
            let truth = 0.5 * form_factor;
            // The lit surface's own albedo/π · π L F; three degrees of freedom make the bars wide.
            assert!((mean - truth).abs() < 9.0 * error + 1e-5, "{strategy:?}: {mean} ± {error} for {truth}");
        }
    }
}

/// Every strategy sees the same light on a material that is part mirror, and through one that is part window: uniform and
/// cosine directions must reach the other side of rough glass, and must not take plastic's mirror from it.
#[test]
fn strategies_agree_on_mirrors_under_plastic_and_on_rough_glass() {
    let sensor = camera(Vec3::new(0.0, 1.0, 3.0), Vec3::X, -Vec3::Y, -Vec3::Z);
    let (half, one) = (TextureId(0), TextureId(1));
    let plastic = Bsdf::Plastic { eta: 1.5, nonlinear: false, diffuse_reflectance: half, specular_reflectance: one };
    let glass = Bsdf::RoughDielectric {
        distribution: Distribution::Ggx,
        alpha_u: half,
        alpha_v: half,
        eta: 1.5,
        specular_reflectance: one,
        specular_transmittance: one,
    };
    for (name, bsdf) in [("plastic", plastic), ("rough glass", glass)] {
        let sphere = Geometry::Sphere { to_world: Affine3::IDENTITY, flip_normals: false };
        let mut lit = scene(sensor.clone(), 0.5, vec![shape(sphere, false)]);
        lit.bsdfs = vec![bsdf];
        lit.emitters.push(Emitter::Constant { radiance: Vec3::ONE });
        // Many uniform directions in a row would make rare, bright paths: the variance of their products grows without bound.
        let render = |strategy| {
            let mut settings = settings(16, 1024, strategy);
            settings.integrator.max_depth = Some(3);
            mean_and_error(&render(&lit, &settings))
        };
        let (truth, its_error) = render(Strategy::Mis);
        for strategy in ALL_STRATEGIES {
            let (mean, error) = render(strategy);
            let together = (error * error + its_error * its_error).sqrt();
            assert!((mean - truth).abs() < 4.0 * together, "{name} {strategy:?}: {mean} ± {error} for {truth}");
            assert!(error < 0.02 * truth, "{name} {strategy:?}: error {error} is too large to tell");
        }
    }
}

/// A small sphere light far away: L (r/d)² cos θ times the albedo. The light stands at the origin, where its own points are all
/// but exact, and rays from afar are not: fails if it casts a shadow on itself by rounding.
#[test]
fn a_small_far_light_does_not_shade_itself() {
    let radius = 0.1f32;
    let affine = |scale: f32, at: Vec3| Affine3::from_translation(at) * Affine3::from_scale(Vec3::splat(scale));
    let lamp = Geometry::Sphere { to_world: affine(radius, Vec3::ZERO), flip_normals: false };
    for to_lamp in [Vec3::new(0.7, 0.6, 2.0), Vec3::new(-1.3, 0.4, 5.0), Vec3::new(4.7, -3.9, 11.0)] {
        let plane = Geometry::Disk { to_world: affine(50.0, -to_lamp), flip_normals: false };
        let sensor = camera(Vec3::Z * 0.5 - to_lamp, Vec3::X, -Vec3::Y, -Vec3::Z);
        let lit = scene(sensor, 0.5, vec![shape(plane, false), shape(lamp.clone(), true)]);
        let mut one = settings(1, 1 << 10, Strategy::Light);
        one.film =
            FilmSettings { width: 1001, height: 1001, crop: Window { x0: 500, y0: 500, x1: 501, y1: 501 }, ..one.film };
        let mean = f64::from(render(&lit, &one).estimate(500, 500).mean[0]);
        let distance = to_lamp.length();
        let truth = 0.5 * f64::from((radius / distance).powi(2) * to_lamp.z / distance);
        // Over the light the cosine varies by r/d, which 1024 samples average; the pixel is a thousandth of the way wide.
        assert!((mean / truth - 1.0).abs() < 3e-3, "{to_lamp}: {mean} for {truth}");
    }
}
