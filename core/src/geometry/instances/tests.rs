//! What instances promise: they are what a copy would be, alike on every path and in any order; rays that leave them do not
//! come back; ten thousand of them cost their places alone.

use crate::bvh::Ray;
use crate::bvh::simd::{Isa, Kernel, Lanes};
use crate::geometry::{Geometry, Hit};
use crate::sampler::{Sampler, Slot};
use crate::scene::{BsdfId, Geometry as Form, Group, GroupId, Instance, Mesh, MeshId, Scene, Shape};
use crate::settings::SamplerKind;
use crate::warp::{cosine_hemisphere, uniform_sphere};
use glam::{Affine3, Mat3, Quat, Vec2, Vec3};
use std::sync::Arc;

/// A ball of `2 * n * n` triangles, without normals.
fn ball(n: u32) -> Mesh {
    let at = |i: u32, j: u32| {
        let (theta, phi) = (i as f32 / n as f32 * 3.2 - 0.03, j as f32 / n as f32 * std::f32::consts::TAU);
        let ((sin, cos), (y, x)) = (libm::sincosf(theta), libm::sincosf(phi));
        Vec3::new(sin * x, sin * y, cos)
    };
    let vertex = |i: u32, j: u32| i * n + j % n;
    let quads = (0..n).flat_map(|i| (0..n).map(move |j| (i, j)));
    Mesh {
        positions: (0..=n).flat_map(|i| (0..n).map(move |j| at(i, j))).collect(),
        triangles: quads
            .flat_map(|(i, j)| {
                let [a, b, c, d] = [vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1)];
                [[a, b, c], [a, c, d]]
            })
            .collect(),
        ..Mesh::default()
    }
}

fn shape(geometry: Form) -> Shape {
    Shape { name: String::new(), geometry, bsdf: BsdfId(0), radiance: None }
}

/// A ball of triangles and a disk over it, placed.
fn scene(mesh: Mesh, places: &[Affine3]) -> Scene {
    let to_world = Affine3::from_translation(Vec3::new(0.0, 0.0, 1.5));
    let shapes = vec![shape(Form::Mesh(MeshId(0))), shape(Form::Disk { to_world, flip_normals: false })];
    Scene {
        groups: vec![Group { shapes }],
        instances: places.iter().map(|&to_world| Instance { group: GroupId(0), to_world }).collect(),
        meshes: vec![Arc::new(mesh)],
        ..Scene::empty()
    }
}

fn place(i: u32, scale: f32) -> Affine3 {
    let at = |k: u32| Sampler::new(SamplerKind::Independent, 7, i, k, 0, 1).film();
    let (a, b, c) = (at(0), at(1), at(2));
    let rotation = Mat3::from_quat(Quat::from_xyzw(a.x - 0.5, a.y - 0.5, b.x - 0.5, b.y + 0.1).normalize());
    let mirror = if i.is_multiple_of(3) { -1.0 } else { 1.0 };
    let matrix3 = rotation * Mat3::from_diagonal(Vec3::new(mirror * (0.3 + c.x), 0.5, 0.3 + c.y) * scale);
    Affine3 { matrix3, translation: (Vec3::new(a.x, c.y, b.x) * 20.0 - 10.0) * scale }
}

/// Nearest hits, and whether there is any.
struct Answers<'a>(&'a Geometry, &'a [Ray]);

impl Kernel for Answers<'_> {
    type Output = Vec<(Option<Hit>, bool)>;

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> Self::Output {
        self.1.iter().map(|ray| (self.0.closest(lanes, ray), self.0.occluded(lanes, ray))).collect()
    }
}

fn geometry(scene: &Scene) -> Geometry {
    Geometry::new(scene, &vec![None; scene.shapes.len()])
}

fn nearest(geometry: &Geometry, ray: &Ray) -> Option<Hit> {
    Isa::detect().dispatch(Answers(geometry, std::slice::from_ref(ray)))[0].0
}

fn rays(n: u32, reach: f32) -> Vec<Ray> {
    let number = |i: u32, k: u32| Sampler::new(SamplerKind::Independent, 3, i, k, 0, 1).film();
    let ray = |i: u32| {
        let (a, b) = (number(i, 0), number(i, 1));
        let origin = (Vec3::new(a.x, a.y, b.x) * 24.0 - 12.0) * reach;
        Ray { origin, direction: uniform_sphere(Vec2::new(b.y, number(i, 2).x)), t_max: f32::INFINITY }
    };
    (0..n).map(ray).collect()
}

/// An instance is its group's mesh with every vertex mapped; disks are mapped by their formula. Fails if normals go by the
/// matrix itself, and not by its inverse transpose.
#[test]
fn instances_are_where_copies_would_be() {
    let places: Vec<Affine3> = (0..40).map(|i| place(i, 1.0)).collect();
    let instanced = scene(ball(8), &places);
    let mut copied = Scene { groups: Vec::new(), instances: Vec::new(), meshes: Vec::new(), ..instanced.clone() };
    for to_world in &places {
        let mut mesh = ball(8);
        mesh.positions.iter_mut().for_each(|p| *p = to_world.transform_point3(*p));
        copied.shapes.push(shape(Form::Mesh(MeshId(copied.meshes.len() as u32))));
        copied.meshes.push(Arc::new(mesh));
        let to_world = *to_world * Affine3::from_translation(Vec3::new(0.0, 0.0, 1.5));
        copied.shapes.push(shape(Form::Disk { to_world, flip_normals: false }));
    }
    let (instanced, copied) = (geometry(&instanced), geometry(&copied));
    let (mut hits, mut other) = (0, 0);
    for ray in rays(20_000, 1.0) {
        let pair = nearest(&instanced, &ray).zip(nearest(&copied, &ray));
        let Some((a, b)) = pair else {
            other += u32::from(nearest(&instanced, &ray).is_some() != nearest(&copied, &ray).is_some());
            continue;
        };
        if (a.t() - b.t()).abs() > 1e-4 * (1.0 + b.t()) {
            other += 1; // at a silhouette
            continue;
        }
        let (a, b) = (instanced.surface(&ray, a), copied.surface(&ray, b));
        assert!((a.position - b.position).length() < 1e-4, "{a:?} {b:?}");
        // A mirrored copy's faces are turned over, an instance's are not.
        assert!(a.normal.dot(b.normal).abs() > 0.9999, "{a:?} {b:?}");
        hits += 1;
    }
    assert!(hits > 1000 && other <= 1, "{hits} alike, {other} not");
}

/// The same bits on every path; the order in which instances are listed does not matter, and of two in the same place the
/// first is seen.
#[test]
fn hits_do_not_depend_on_path_or_order() {
    let places: Vec<Affine3> = (0..60).map(|i| place(i / 2, 1.0)).collect();
    let rays = rays(20_000, 1.0);
    let forwards = geometry(&scene(ball(6), &places));
    let bits = |answers: Vec<(Option<Hit>, bool)>| -> Vec<(u32, u32, bool)> {
        let of = |hit: Option<Hit>| match hit {
            Some(Hit::InstancedTriangle(i, hit)) => (i, hit.t.to_bits()),
            Some(Hit::InstancedAnalytic(i, t, _)) => (i, t.to_bits()),
            _ => (u32::MAX, 0),
        };
        answers.into_iter().map(|(hit, any)| (of(hit).0, of(hit).1, any)).collect()
    };
    let expected = bits(Isa::Portable.dispatch(Answers(&forwards, &rays)));
    assert!(expected.iter().filter(|(i, ..)| *i != u32::MAX).count() > 500);
    for (i, t, any) in &expected {
        assert_eq!(*i != u32::MAX, *any, "at {}", f32::from_bits(*t));
        assert!(*i == u32::MAX || i % 2 == 0, "instance {i} at {}", f32::from_bits(*t));
    }
    for isa in Isa::available() {
        assert_eq!(bits(isa.dispatch(Answers(&forwards, &rays))), expected, "{}", isa.name());
    }
    let backwards: Vec<Affine3> = places.iter().rev().copied().collect();
    let backwards = bits(Isa::detect().dispatch(Answers(&geometry(&scene(ball(6), &backwards)), &rays)));
    for (a, b) in expected.iter().zip(backwards) {
        assert_eq!((a.1, a.2), (b.1, b.2));
    }
}

/// A ball is convex, so what leaves it outwards never meets it again: whatever the scale and however far from the origin.
/// Fails if the error bound leaves out what a ray loses on its way back into the group.
#[test]
fn rays_that_leave_do_not_come_back() {
    for (scale, away) in [(1e-3, 1.0), (1.0, 1.0), (1e3, 1.0), (1.0, 1e3)] {
        let mut to_world = place(1, scale);
        to_world.translation *= away;
        let mut scene = scene(ball(12), &[to_world]);
        scene.groups[0].shapes.truncate(1);
        let geometry = geometry(&scene);
        let (mut left, centre) = (0, to_world.translation);
        for (i, ray) in rays(4000, scale).into_iter().enumerate() {
            let origin = ray.origin * 0.1 + centre + Vec3::splat(5.0 * scale);
            let inwards = (centre - origin + ray.direction * 0.3 * scale).normalize();
            let ray = Ray { origin, direction: inwards, t_max: f32::INFINITY };
            let Some(hit) = nearest(&geometry, &ray) else { continue };
            let surface = geometry.surface(&ray, hit);
            let outwards = if surface.normal.dot(ray.direction) < 0.0 { surface.normal } else { -surface.normal };
            let mut sampler = Sampler::new(SamplerKind::Independent, 5, i as u32, 0, 0, 1);
            sampler.at_surface(0);
            let frame = crate::frame::Frame::around(outwards);
            let w = frame.to_world(cosine_hemisphere(sampler.two(Slot::Direction)));
            let again = nearest(&geometry, &surface.ray(w, f32::INFINITY));
            assert!(again.is_none(), "scale {scale}, {away} away: {surface:?} towards {w} is met again: {again:?}");
            left += 1;
        }
        assert!(left > 1000, "{left} rays tell little");
    }
}

/// 10,000 instances of 10,368 triangles: a hundred million triangles that take the memory of one mesh and of the places.
#[test]
fn memory_grows_with_instances_alone() {
    let of = |n: u32| {
        let places: Vec<Affine3> = (0..n).map(|i| place(i, 0.01)).collect();
        geometry(&scene(ball(72), &places)).memory()
    };
    let (one, many) = (of(1), of(10_000));
    assert_eq!((one.surfaces, one.hierarchies), (many.surfaces, many.hierarchies));
    assert!(many.instances < 10_000 * 300, "{} bytes", many.instances);
    assert!(one.hierarchies > 10_368 * 40, "{} bytes", one.hierarchies);
}
