//! Where rays leave surfaces: a fin that casts a shadow, and none for rays that start above it.

use crate::build::{camera, mean_and_error, render, scene, settings, shape};
use glam::{Affine3, Vec3};
use std::sync::Arc;
use tilecast_core::scene::{Emitter, Geometry, Mesh, MeshId};
use tilecast_core::settings::{IntegratorKind, Offsets, Settings, Strategy};

/// A fin 0.05 high, a thousand units from the world's zero, in light that falls by one in ten: its shadow is half a unit long.
/// Mitsuba's rays start 8.94e-5 (1 + 1000) = 0.0895 above the ground there and pass it. Without the origin in the sum they would
/// start 0.0002 above it, and lie in its shadow.
#[test]
fn mitsubas_rays_start_above_low_relief() {
    let ground = Geometry::Disk { to_world: Affine3::from_scale(Vec3::splat(5.0)), flip_normals: false };
    let fin = Mesh {
        positions: vec![Vec3::new(0.0, -2.0, -0.1), Vec3::new(0.0, 2.0, -0.1), Vec3::new(0.0, 0.0, 0.05)],
        triangles: vec![[0, 1, 2]],
        ..Mesh::default()
    };
    let above = camera(Vec3::new(0.25, 0.0, 0.3), Vec3::X, -Vec3::Y, -Vec3::Z);
    let mut lit = scene(above, 0.5, vec![shape(ground, false), shape(Geometry::Mesh(MeshId(0)), false)]);
    lit.meshes = vec![Arc::new(fin)];
    lit.origin = [1000.0, 0.0, 0.0];
    let direction = Vec3::new(10.0, 0.0, -1.0).normalize();
    lit.emitters = vec![Emitter::Directional { direction, irradiance: Vec3::ONE }];
    let mut seen = settings(8, 16, Strategy::Mis);
    seen.integrator.kind = IntegratorKind::Direct;
    let mean = |offsets| mean_and_error(&render(&lit, &Settings { offsets, ..seen.clone() })).0;
    assert_eq!(mean(Offsets::Exact), 0.0);
    let bright = 0.5 / std::f64::consts::PI * f64::from(-direction.z);
    let passed = mean(Offsets::Mitsuba);
    assert!((passed - bright).abs() < 1e-5 * bright, "{passed} for {bright}");
}
