//! Every sampler of lights follows the density that it claims, with which strategies are weighed against each other.

use super::Lights;
use crate::bvh::Ray;
use crate::bvh::simd::{Isa, Kernel, Lanes};
use crate::chi_square::{self, DRAWS, number};
use crate::frame::Frame;
use crate::geometry::Geometry;
use crate::scene::{
    BsdfId, Emitter, Geometry as Form, Image, ImageId, Mesh, MeshId, Scene, Shape, Texels, Texture, TextureId,
};
use crate::surface::Surface;
use crate::texture::Textures;
use glam::{Affine3, Mat3, Quat, Vec2, Vec3};
use rayon::prelude::*;
use std::sync::Arc;

/// Cells along the axis and around it: of equal solid angle.
const SIDE: usize = 32;
/// Directions along a cell's side that its expectation is the mean of. Lights fill a fifth of the sphere here or more, so that
/// their edges, where this is coarse, are in few of the cells.
const FINE: usize = 32;

/// Cells with a density of more than this many times their mean, and those around them, are not compared: at the silhouette of what
/// is sampled by area the density in solid angle is infinite, and no grid has its mean.
const STEEP: f64 = 4.0;

/// What is seen from `from`, on a surface of this normal.
struct Case {
    name: &'static str,
    scene: Scene,
    from: Vec3,
    normal: Vec3,
}

fn turned(scale: Vec3, translation: Vec3) -> Affine3 {
    let rotation = Mat3::from_quat(Quat::from_xyzw(0.1, 0.3, -0.2, 0.9).normalize());
    Affine3 { matrix3: rotation * Mat3::from_diagonal(scale), translation }
}

fn scene(forms: Vec<Form>, meshes: Vec<Mesh>) -> Scene {
    let shape = |geometry| Shape { name: String::new(), geometry, bsdf: BsdfId(0), radiance: Some(TextureId(0)) };
    Scene {
        shapes: forms.into_iter().map(shape).collect(),
        textures: vec![Texture::Constant(Vec3::ONE)],
        meshes: meshes.into_iter().map(Arc::new).collect(),
        ..Scene::empty()
    }
}

/// Triangles that face the origin, around +z and well spread.
fn triangles(count: u32) -> Mesh {
    let corner = |i: u32, k: u64| {
        let at = |n: u64| number(u64::from(i) * 3 + k, n) - 0.5;
        let middle = Vec3::new(at(3) * 0.1, at(4) * 0.1, 0.0);
        let (sin, cos) = libm::sincosf(std::f32::consts::TAU * (k as f32 / 3.0 + at(0) * 0.2));
        let place = Vec3::new((i % 3) as f32 - 1.0, (i / 3 % 3) as f32 - 1.0, 0.8 + 0.3 * (i % 2) as f32);
        if count == 1 {
            Vec3::new(sin * 1.5, cos * 1.5, 0.6) + middle
        } else {
            place + Vec3::new(sin, cos, 0.0) * 0.5 + middle
        }
    };
    Mesh {
        positions: (0..count).flat_map(|i| [0, 1, 2].map(|k| corner(i, k))).collect(),
        triangles: (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
        ..Mesh::default()
    }
}

fn cases() -> Vec<Case> {
    let sphere = |radius: f32, centre, flip_normals| Form::Sphere {
        to_world: turned(Vec3::splat(radius), centre),
        flip_normals,
    };
    let disk = Form::Disk { to_world: turned(Vec3::new(1.4, 0.9, 1.0), Vec3::new(0.1, 0.1, 0.5)), flip_normals: true };
    let cylinder =
        Form::Cylinder { to_world: turned(Vec3::new(0.7, 0.5, 1.5), Vec3::new(1.0, 0.3, 0.0)), flip_normals: false };
    let tube =
        Form::Cylinder { to_world: turned(Vec3::new(1.0, 1.2, 2.0), Vec3::new(0.2, -0.3, -0.7)), flip_normals: true };
    let mesh = || Form::Mesh(MeshId(0));
    let ball = sphere(1.0, Vec3::new(0.3, 0.2, 1.25), false);
    let all = vec![
        mesh(),
        sphere(0.6, Vec3::new(-1.3, 0.2, 0.4), false),
        sphere(0.5, Vec3::new(1.2, 0.3, 0.2), false),
        disk.clone(),
    ];
    let up = |name, scene| Case { name, scene, from: Vec3::ZERO, normal: Vec3::Z };
    let mut sky = scene(vec![ball.clone()], Vec::new());
    sky.shapes[0].radiance = None; // it gives the sky a scene to shine on
    let texels = (0..7 * 5).flat_map(|i| [[0.0, 0.2, 3.0, 0.1, 1.0, 0.0, 0.7][i * 5 % 7]; 3]).collect();
    sky.images = vec![Arc::new(Image { width: 7, height: 5, texels: Texels::Rgb32(texels) })];
    let to_world = turned(Vec3::ONE, Vec3::ZERO).matrix3;
    sky.emitters = vec![Emitter::Envmap { image: ImageId(0), scale: 1.0, to_world }];
    let mut even = scene(vec![ball.clone()], Vec::new());
    even.emitters = vec![Emitter::Constant { radiance: Vec3::ONE }];
    vec![
        up("triangle", scene(vec![mesh()], vec![triangles(1)])),
        up("three triangles", scene(vec![mesh()], vec![triangles(3)])),
        up("tree of triangles", scene(vec![mesh()], vec![triangles(9)])),
        up("sphere", scene(vec![ball.clone()], Vec::new())),
        up("inside of a sphere", scene(vec![sphere(1.0, Vec3::new(0.3, 0.2, 0.5), true)], Vec::new())),
        up("disk", scene(vec![disk], Vec::new())),
        up("cylinder", scene(vec![cylinder], Vec::new())),
        up("inside of a cylinder", scene(vec![tube], Vec::new())),
        up("tree of all kinds", scene(all, vec![triangles(2)])),
        up("envmap", sky),
        up("sphere under a sky", even),
        Case { normal: Vec3::new(0.8, 0.0, -0.6), ..up("tree from aside", scene(vec![mesh()], vec![triangles(9)])) },
    ]
}

/// Where a direction lies.
fn cell(w: Vec3) -> usize {
    let part = |x: f32| ((x * SIDE as f32) as usize).min(SIDE - 1);
    let turn = (libm::atan2f(w.y, w.x) / std::f32::consts::TAU + 1.0).fract();
    part(0.5 * (1.0 - w.z)) * SIDE + part(turn)
}

/// The cell and those around it.
fn neighbours(cell: usize) -> impl Iterator<Item = usize> {
    let (row, column) = (cell / SIDE, cell % SIDE);
    let rows = row.saturating_sub(1)..=(row + 1).min(SIDE - 1);
    rows.flat_map(move |row| [SIDE - 1, 0, 1].map(|step| row * SIDE + (column + step) % SIDE))
}

/// Whether a grid of densities says too little of their mean.
fn is_steep(densities: &[f64]) -> bool {
    let lit = densities.iter().filter(|&&density| density > 0.0).count().max(1);
    let mean = densities.iter().sum::<f64>() / lit as f64;
    densities.iter().any(|&density| density > STEEP * mean)
}

/// A direction in a cell.
fn direction(cell: usize, u: Vec2) -> Vec3 {
    let (row, column) = ((cell / SIDE) as f32, (cell % SIDE) as f32);
    crate::warp::around_z(1.0 - 2.0 * (row + u.x) / SIDE as f32, (column + u.y) / SIDE as f32)
}

/// The density in solid angle of light in a direction: of all lights that lie there, one behind the other.
struct Density<'a> {
    case: &'a Case,
    geometry: &'a Geometry,
    textures: &'a Textures,
    lights: &'a Lights,
    directions: &'a [Vec3],
    mis: bool,
}

impl Kernel for Density<'_> {
    type Output = Vec<f64>;

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> Self::Output {
        let Self { case, geometry, textures, lights, directions, mis } = self;
        let density = |&w: &Vec3| {
            let mut density = lights.background(textures, w, mis).map_or(0.0, |(_, pdf)| f64::from(pdf));
            let mut ray = Ray { origin: case.from, direction: w, t_max: f32::INFINITY };
            while let Some(hit) = geometry.closest(lanes, &ray) {
                let point = geometry.surface(&ray, hit);
                if let Some(light) = point.light.filter(|_| point.frame.n.dot(w) < 0.0) {
                    density += f64::from(lights.pdf(geometry, case.from, case.normal, &point, light));
                }
                ray = point.ray(w, f32::INFINITY);
            }
            density
        };
        directions.iter().map(density).collect()
    }
}

/// 10^6 draws of each case over 1024 cells. Fails for a triangle sampled by area with the density of solid angle, a tree whose
/// probabilities leave out the normal, or a disk's density without its cosine.
#[test]
fn sampling_follows_the_density() {
    let cases = cases();
    // Only a background is sampled otherwise without the help of the BSDF.
    let alone = cases.iter().filter(|case| !case.scene.emitters.is_empty()).map(|case| (case, false));
    let all: Vec<(&Case, bool)> = cases.iter().map(|case| (case, true)).chain(alone).collect();
    all.par_iter().for_each(|&(case, mis)| check(case, mis, all.len()));
}

fn check(case: &Case, mis: bool, cases: usize) {
    let geometry = Geometry::new(&case.scene, &Lights::first_of_shapes(&case.scene));
    let textures = Textures::new(&case.scene);
    let lights = Lights::new(&case.scene, &geometry, &textures);
    let surface = Surface {
        position: case.from,
        error: Vec3::ZERO,
        normal: case.normal,
        frame: Frame::around(case.normal),
        uv: Vec2::ZERO,
        barycentric: Vec2::ZERO,
        shape: 0,
        instance: None,
        primitive: 0,
        light: None,
    };
    let density = |directions: &[Vec3]| {
        let (geometry, textures, lights) = (&geometry, &textures, &lights);
        Isa::detect().dispatch(Density { case, geometry, textures, lights, directions, mis })
    };
    let mut counts = vec![0.0; SIDE * SIDE];
    let mut others = 0.0;
    for i in 0..DRAWS {
        let u = Vec2::new(number(i, 1), number(i, 2));
        // As waves do it: plain lights without the detour.
        let chosen = lights.choose(surface.position, surface.frame.n, number(i, 0), u);
        let sample = chosen.and_then(|chosen| match lights.plain(&geometry, &textures, chosen.light) {
            Some(plain) => {
                let (sample, shines) = plain.sample(&surface, chosen.probability, chosen.u);
                shines.then_some(sample)
            }
            None => lights.sample(&geometry, &textures, &surface, chosen, mis),
        });
        match sample {
            Some(sample) => {
                counts[cell(sample.wi)] += 1.0;
                if i % 1000 == 0 {
                    let again = density(&[sample.wi])[0];
                    // At an edge the way there may just miss.
                    let close = (f64::from(sample.pdf) - again).abs() <= 0.01 * again;
                    assert!(close || again == 0.0 || lights.len() > 1, "{}: {} and {again}", case.name, sample.pdf);
                }
            }
            None => others += 1.0,
        }
    }
    let fine = (0..FINE * FINE).map(|i| (Vec2::new((i / FINE) as f32, (i % FINE) as f32) + 0.5) / FINE as f32);
    let fine: Vec<Vec2> = fine.collect();
    let cells: Vec<Vec<f64>> =
        (0..SIDE * SIDE).map(|cell| density(&fine.iter().map(|&u| direction(cell, u)).collect::<Vec<_>>())).collect();
    let steep: Vec<bool> = cells.iter().map(|densities| is_steep(densities)).collect();
    let mut unsure = others;
    let mut expected = vec![0.0; SIDE * SIDE];
    for (cell, expected) in expected.iter_mut().enumerate() {
        if neighbours(cell).any(|cell| steep[cell]) {
            unsure += std::mem::take(&mut counts[cell]);
        } else {
            let mean = cells[cell].iter().sum::<f64>() / fine.len() as f64;
            *expected = mean * 4.0 * std::f64::consts::PI / (SIDE * SIDE) as f64 * DRAWS as f64;
        }
    }
    let name = case.name;
    let draws = DRAWS as f64;
    assert!(unsure - others < 0.3 * draws, "{name}: {} draws are not compared", unsure - others);
    let mass = (expected.iter().sum::<f64>() + unsure) / draws;
    assert!((mass - 1.0).abs() < 3e-3, "{name}, mis {mis}: the density and what is not compared make {mass}");
    if let Err(told) = chi_square::compare(&counts, &expected, cases) {
        panic!("{name}, mis {mis}: {told}");
    }
}
