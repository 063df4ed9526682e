//! Closed meshes of kinds that go wrong, and the places where they stand.

use crate::build::{camera, scene, shape};
use glam::Vec3;
use std::collections::BTreeMap;
use std::sync::Arc;
use tilecast_core::scene::{Geometry as Shape, Mesh, MeshId};
use tilecast_core::world::World;

/// A hash of (seed, index) in −1…1.
pub fn noise(seed: u64, index: u64) -> f32 {
    let mut x = seed.wrapping_mul(0xa076_1d64_78bd_642f) ^ index.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    for _ in 0..3 {
        x = (x ^ x >> 31).wrapping_mul(0xd6e8_feb8_6659_fd93);
    }
    (x >> 40) as f32 / (1 << 23) as f32 - 1.0
}

pub fn noise3(seed: u64, index: u64) -> Vec3 {
    Vec3::from_array([0, 1, 2].map(|k| noise(seed, 3 * index + k)))
}

/// A closed mesh around a circle of radius `core` (0: the origin), of about unit size.
pub struct Closed {
    pub name: &'static str,
    pub mesh: Mesh,
    pub core: f32,
}

/// `n` by `m` squares over the torus, or the sphere if `m` ends in poles; shared vertices, so that it is closed whatever the
/// rounding.
fn wrapped(n: u32, m: u32, poles: bool, point: impl Fn(f32, f32) -> Vec3) -> Mesh {
    let rows = if poles { m + 1 } else { m };
    let tau = std::f32::consts::TAU;
    let mut mesh = Mesh::default();
    for j in 0..rows {
        for i in 0..n {
            let (u, v) = (i as f32 / n as f32 * tau, j as f32 / m as f32 * if poles { 0.5 * tau } else { tau });
            // All vertices of a pole are one.
            let first = if poles && (j == 0 || j == m) { 0.0 } else { u };
            mesh.positions.push(point(first, v));
        }
    }
    let vertex = |i: u32, j: u32| {
        let at_pole = poles && (j == 0 || j == m);
        (j % rows) * n + if at_pole { 0 } else { i % n }
    };
    for j in 0..m {
        for i in 0..n {
            let [a, b, c, d] = [vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1)];
            mesh.triangles.extend([[a, b, c], [a, c, d]].into_iter().filter(|[a, b, c]| a != b && b != c && a != c));
        }
    }
    mesh
}

fn around(u: f32, v: f32) -> Vec3 {
    let ((sin_u, cos_u), (sin_v, cos_v)) = (libm::sincosf(u), libm::sincosf(v));
    Vec3::new(sin_v * cos_u, sin_v * sin_u, cos_v)
}

pub fn closed() -> Vec<Closed> {
    let torus = |u: f32, v: f32| {
        let ((sin_u, cos_u), (sin_v, cos_v)) = (libm::sincosf(u), libm::sincosf(v));
        Vec3::new((1.0 + 0.4 * cos_v) * cos_u, (1.0 + 0.4 * cos_v) * sin_u, 0.4 * sin_v)
    };
    vec![
        Closed { name: "sphere", mesh: wrapped(64, 40, true, around), core: 0.0 },
        Closed { name: "torus", mesh: wrapped(50, 30, false, torus), core: 1.0 },
        Closed { name: "slivers", mesh: slivers(wrapped(40, 24, true, around), |_| 1e-2), core: 0.0 },
        Closed { name: "scan", mesh: scan(), core: 0.0 },
    ]
}

/// Scale and place of each test.
pub const PLACES: [(f32, Vec3); 4] =
    [(1.0, Vec3::ZERO), (100.0, Vec3::new(148_376.0, 1234.0, -223_423.0)), (1e6, Vec3::ZERO), (1e-6, Vec3::ZERO)];

pub fn placed(closed: &Closed, (scale, to): (f32, Vec3)) -> (World, Mesh) {
    let mut mesh = closed.mesh.clone();
    mesh.positions.iter_mut().for_each(|p| *p = *p * scale + to);
    let mut scene = scene(camera(Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z), 0.5, Vec::new());
    scene.meshes.push(Arc::new(mesh.clone()));
    scene.shapes.push(shape(Shape::Mesh(MeshId(0)), false));
    scene.validate().unwrap();
    (World::compile(&scene), mesh)
}

/// Six times the volume; negative if the normals point inwards.
pub fn volume(mesh: &Mesh) -> f32 {
    let parts = mesh.triangles.iter().map(|t| t.map(|v| mesh.positions[v as usize]));
    parts.map(|[a, b, c]| a.dot(b.cross(c))).sum()
}

/// Each triangle split in three by a point near the middle of its first edge: a sliver, so many times as high as it is long. `height` of 0
/// leaves a triangle whole.
fn slivers(mut mesh: Mesh, height: impl Fn(u64) -> f32) -> Mesh {
    let mut split = Vec::with_capacity(3 * mesh.triangles.len());
    for (i, &[a, b, c]) in mesh.triangles.iter().enumerate() {
        let height = height(i as u64);
        if height == 0.0 {
            split.push([a, b, c]);
            continue;
        }
        let [p, q, r] = [a, b, c].map(|v| mesh.positions[v as usize]);
        let middle = p + (q - p) * (0.5 + 0.4 * noise(40, i as u64));
        let new = mesh.positions.len() as u32;
        mesh.positions.push(middle + (r - middle) * height);
        split.extend([[a, b, new], [b, c, new], [c, a, new]]);
    }
    Mesh { triangles: split, ..mesh }
}

/// As a scanner leaves them: a bumpy sphere with noise, and in one of three triangles a sliver, 1 : 10 to 1 : 10^7.
fn scan() -> Mesh {
    let mut mesh = wrapped(160, 100, true, around);
    let bumps =
        |p: Vec3, scale: f32| libm::sinf(scale * p.x + 1.0) * libm::sinf(scale * p.y) * libm::sinf(scale * p.z + 2.0);
    for (i, p) in mesh.positions.iter_mut().enumerate() {
        // Noise goes with the size of triangles, which shrink towards the poles: at a vertex whose faces are more than 90° apart, a step
        // along the normal of one of them leaves the body through another, whatever the rounding.
        let rough = 0.003 * p.truncate().length() * noise(41, i as u64);
        *p *= 1.0 + 0.2 * bumps(*p, 3.0) + 0.04 * bumps(*p, 17.0) + rough;
    }
    slivers(mesh, |i| if i % 3 == 0 { libm::powf(10.0, -4.0 + 3.0 * noise(42, i)) } else { 0.0 })
}

/// Every edge has a triangle on both sides, once each way.
#[test]
fn they_are_closed() {
    for closed in closed() {
        let mut edges = BTreeMap::new();
        for [a, b, c] in closed.mesh.triangles {
            [[a, b], [b, c], [c, a]].into_iter().for_each(|edge| *edges.entry(edge).or_insert(0) += 1);
        }
        assert!(edges.iter().all(|(&[a, b], &n)| n == 1 && edges.get(&[b, a]) == Some(&1)), "{}", closed.name);
    }
}
