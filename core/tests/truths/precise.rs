//! Answers that formulas know to all digits, met to one part in ten thousand: within four of the reported error bars, which are
//! themselves below 10^-4 of the answer.
//!
//! `analytic.rs` has more strategies and looser bounds: what only finds light by chance would need 10^9 samples here.

use crate::build::{camera, long, mean_and_error, render, scene, settings, shape};
use glam::{Affine3, Mat3, Vec3};
use std::f64::consts::PI;
use std::sync::Arc;
use tilecast_core::scene::{Emitter, Geometry, Mesh, MeshId, Scene, Sensor, Shape};
use tilecast_core::settings::{IntegratorKind, Settings, Strategy};

/// What of the answer its error bar may be.
const PRECISION: f64 = 1e-4;
const ALBEDO: f32 = 0.5;

/// Looks straight down on the square of this half side around `at`, through no perspective.
fn above(at: Vec3, half_side: f32) -> Sensor {
    let matrix3 = Mat3::from_cols(Vec3::X * half_side, Vec3::NEG_Y * half_side, Vec3::NEG_Z);
    Sensor::Orthographic { to_world: Affine3 { matrix3, translation: at }, near_clip: 1e-3, far_clip: 1e3 }
}

fn floor() -> Shape {
    shape(Geometry::Disk { to_world: Affine3::from_scale(Vec3::splat(50.0)), flip_normals: false }, false)
}

/// Direct light, as many samples as the precision takes.
fn direct(strategy: Strategy, spp: u32) -> Settings {
    let mut job = settings(8, spp, strategy);
    job.integrator.kind = IntegratorKind::Direct;
    job
}

/// The mean over the picture is the truth: f32 itself loses up to a millionth.
fn check(what: &str, scene: &Scene, job: &Settings, truth: f64) {
    let (mean, error) = mean_and_error(&render(scene, job));
    assert!((mean - truth).abs() < 4.0 * error + 2e-6 * truth, "{what}: {mean} ± {error} for {truth}");
    assert!(error < PRECISION * truth, "{what}: ± {error} is too much to tell {truth}");
}

/// Of each of 64 pixels.
fn samples() -> u32 {
    if long() { 1 << 14 } else { 1 << 12 }
}

const SAMPLED: [Strategy; 2] = [Strategy::Light, Strategy::Mis];

/// View factor of a small upward piece of a plane to a parallel disk of radius `r` whose centre is `h` above and `a` beside it
/// (Howell's catalogue, B-13).
fn disk_factor(r: f64, h: f64, a: f64) -> f64 {
    let sum = h * h + a * a + r * r;
    0.5 * (1.0 - (sum - 2.0 * r * r) / (sum * sum - 4.0 * r * r * a * a).sqrt())
}

/// Albedo times the view factor of the lamp, whose radiance is one: below it and beside it.
#[test]
fn a_disk_light_over_a_plane() {
    let radius = 0.7f32;
    let to_world = Affine3::from_translation(Vec3::Z * 1.5) * Affine3::from_scale(Vec3::splat(radius));
    let lamp = shape(Geometry::Disk { to_world, flip_normals: true }, true);
    for aside in [0.0f32, 0.5, 2.0] {
        // Over the side of the picture the factor varies by its square.
        let sensor = above(Vec3::new(aside, 0.0, 0.5), 1e-4);
        let lit = scene(sensor, ALBEDO, vec![floor(), lamp.clone()]);
        let truth = f64::from(ALBEDO) * disk_factor(radius.into(), 1.5, aside.into());
        for strategy in SAMPLED {
            check(&format!("disk, {aside} aside, {strategy:?}"), &lit, &direct(strategy, samples()), truth);
        }
    }
}

/// A sphere that is wholly above the horizon: (r/d)² cos θ, exactly.
#[test]
fn a_sphere_lights_irradiance() {
    let (radius, height) = (0.5f32, 1.25f32);
    let to_world = Affine3::from_translation(Vec3::Z * height) * Affine3::from_scale(Vec3::splat(radius));
    let lamp = shape(Geometry::Sphere { to_world, flip_normals: false }, true);
    for aside in [0.0f32, 0.6, 2.4] {
        let lit = scene(above(Vec3::new(aside, 0.0, 0.5), 1e-4), ALBEDO, vec![floor(), lamp.clone()]);
        let distance = f64::from(aside).hypot(height.into());
        let truth = f64::from(ALBEDO) * (f64::from(radius) / distance).powi(2) * f64::from(height) / distance;
        for strategy in SAMPLED {
            check(&format!("sphere, {aside} aside, {strategy:?}"), &lit, &direct(strategy, samples()), truth);
        }
    }
}

/// View factor between two equal, opposite rectangles with sides x and y times their distance (Howell's catalogue, C-11).
fn plates_factor(x: f64, y: f64) -> f64 {
    let (x1, y1) = ((1.0 + x * x).sqrt(), (1.0 + y * y).sqrt());
    let log = (x1 * y1 / (1.0 + x * x + y * y).sqrt()).ln();
    let arcs = x * y1 * (x / y1).atan() + y * x1 * (y / x1).atan() - x * x.atan() - y * y.atan();
    2.0 / (PI * x * y) * (log + arcs)
}

/// Two parallel squares, one a lamp; the picture shows exactly all of the other, from between them. Its mean is the albedo times the
/// view factor. The lamp is made of triangles: they are sampled by the solid angle that they fill.
#[test]
fn parallel_plates_have_their_view_factor() {
    for side in [1.0f32, 3.0] {
        let corners = |z: f32| {
            let at = |x: f32, y: f32| Vec3::new(x * 0.5 * side, y * 0.5 * side, z);
            [at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)]
        };
        let mut lit = scene(above(Vec3::Z * 0.5, 0.5 * side), ALBEDO, Vec::new());
        for (id, (z, triangles)) in
            [(0.0, [[0, 1, 2], [0, 2, 3]]), (1.0, [[0, 2, 1], [0, 3, 2]])].into_iter().enumerate()
        {
            let (positions, triangles) = (corners(z).to_vec(), triangles.to_vec());
            lit.meshes.push(Arc::new(Mesh { positions, triangles, ..Mesh::default() }));
            lit.shapes.push(shape(Geometry::Mesh(MeshId(id as u32)), id == 1));
        }
        let truth = f64::from(ALBEDO) * plates_factor(side.into(), side.into());
        for strategy in SAMPLED {
            check(&format!("plates, side {side}, {strategy:?}"), &lit, &direct(strategy, 2 * samples()), truth);
        }
    }
}

/// I cos θ / d² = I h / d³ times albedo/π: nothing is random.
#[test]
fn a_point_lights_falloff() {
    for (aside, height) in [(0.0f32, 1.0f32), (0.3, 0.01), (3.0, 4.0), (20.0, 0.5), (0.0, 500.0)] {
        let mut lit = scene(above(Vec3::new(aside, 0.0, 0.005), 1e-6), ALBEDO, vec![floor()]);
        lit.emitters.push(Emitter::Point { position: Vec3::Z * height, intensity: Vec3::splat(7.0) });
        let distance = f64::from(aside).hypot(height.into());
        let truth = f64::from(ALBEDO) / PI * 7.0 * f64::from(height) / distance.powi(3);
        check(&format!("point, {aside} aside, {height} up"), &lit, &direct(Strategy::Mis, 16), truth);
    }
}

/// Σ aᵏ inside a sphere that emits one everywhere, cut off after so many bounces and not at all: each bounce counts. Seen
/// to fail for a cosine's density that is a thousandth too large.
#[test]
fn a_furnace_counts_every_bounce() {
    let sphere = Geometry::Sphere { to_world: Affine3::IDENTITY, flip_normals: true };
    let sensor = camera(Vec3::new(0.2, 0.1, -0.3), Vec3::X, Vec3::Y, Vec3::Z);
    for albedo in [0.5f32, 0.9] {
        let lit = scene(sensor.clone(), albedo, vec![shape(sphere.clone(), true)]);
        let a = f64::from(albedo);
        for depth in [1u32, 2, 3, 10] {
            // Without roulette nothing is random under the cosine: each path brings the whole sum.
            let mut job = settings(4, 16, Strategy::Bsdf);
            (job.integrator.max_depth, job.integrator.rr_depth) = (Some(depth), 1000);
            job.without.early_roulette = true;
            check(&format!("albedo {albedo}, depth {depth}"), &lit, &job, (1.0 - a.powi(depth as i32)) / (1.0 - a));
        }
        // Roulette begins where f32 shows nothing of what is left. What it does is tested in `analytic.rs`.
        let mut job = settings(16, if long() { 1 << 10 } else { 4 }, Strategy::Bsdf);
        job.integrator.rr_depth = if albedo < 0.6 { 40 } else { 300 };
        job.without.early_roulette = true;
        check(&format!("albedo {albedo}, without end"), &lit, &job, 1.0 / (1.0 - a));
    }
}
