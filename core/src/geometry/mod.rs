//! All surfaces of a scene, laid out for tracing: what a ray hits, and the surface point there.

mod instances;
mod lists;
mod place;
mod points;
mod search;
mod tangents;

use crate::bvh::{Aabb, Stats, TriangleBvh, TriangleHit, triangle_bounds};
use crate::scene::{Scene, Shape};
use crate::shape::{Analytic, AnalyticBvh};
use glam::{Vec2, Vec3};
use instances::Instances;
use lists::Lists;
pub use lists::Meshes;
use place::face_normal;
pub use place::{Place, place, place_of_sliver};
pub use points::TrianglePoint;

/// Stands for "none" in the tables below.
const NONE: u32 = u32::MAX;

/// Hierarchies of more bytes are searched by many rays in turns. Below, single rays are as fast or faster: measured on scenes of up
/// to 260,000 triangles.
const TURNS_FROM: usize = 1 << 26;
/// With so many triangles it pays to ask for what tables say of them ahead of time; with fewer all of it is near anyway.
const SCATTERED_FROM: u32 = 1 << 12;

/// Triangles of all meshes in one list, analytic shapes in another. A *primitive* is a triangle or an analytic shape;
/// analytic ones are numbered after the triangles. Groups that are placed many times are such geometries of their own.
pub struct Geometry {
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    uvs: Vec<Vec2>,
    triangles: Vec<[u32; 3]>,
    /// The shape of each triangle.
    triangle_shapes: Vec<u32>,
    analytic: Vec<Analytic>,
    /// The shape of each analytic surface.
    analytic_shapes: Vec<u32>,
    shapes: Vec<ShapeTable>,
    /// The number of its first shape in the whole scene.
    first_shape: u32,
    bvh: TriangleBvh,
    /// Rays take turns in the hierarchy of triangles: it is too large for the nearest cache.
    in_turns: bool,
    /// Tables of triangles are larger than the nearest cache.
    is_scattered: bool,
    analytic_bvh: AnalyticBvh,
    instances: Option<Box<Instances>>,
}

/// What a geometry takes in memory, in bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Memory {
    /// Positions, normals, texture coordinates, indices, analytic shapes.
    pub surfaces: usize,
    /// The hierarchies over them, with their own copies of triangles.
    pub hierarchies: usize,
    /// The places of instances and the hierarchy over them; what they place counts above, once.
    pub instances: usize,
}

impl Memory {
    /// Both together.
    pub fn plus(self, other: Self) -> Self {
        Self {
            surfaces: self.surfaces + other.surfaces,
            hierarchies: self.hierarchies + other.hierarchies,
            instances: self.instances + other.instances,
        }
    }
}

/// Where a shape's data lies in the common lists.
#[derive(Clone, Copy, Debug)]
struct ShapeTable {
    first_primitive: u32,
    primitives: u32,
    first_vertex: u32,
    /// Index of its first normal, or [`NONE`].
    first_normal: u32,
    /// Index of its first texture coordinate, or [`NONE`].
    first_uv: u32,
    /// The light of its first primitive, or [`NONE`]; its other primitives' follow.
    first_light: u32,
}

/// What a ray has hit.
#[derive(Clone, Copy, Debug)]
pub enum Hit {
    /// A triangle.
    Triangle(TriangleHit),
    /// An analytic shape.
    Analytic {
        /// Ray parameter.
        t: f32,
        /// Index in the list of analytic shapes.
        index: u32,
    },
    /// A triangle of an instance's group.
    InstancedTriangle(u32, TriangleHit),
    /// An analytic shape of an instance's group, its t and index.
    InstancedAnalytic(u32, f32, u32),
}

impl Hit {
    /// Ray parameter.
    #[inline(always)]
    pub fn t(&self) -> f32 {
        match self {
            Hit::Triangle(hit) | Hit::InstancedTriangle(_, hit) => hit.t,
            Hit::Analytic { t, .. } | Hit::InstancedAnalytic(_, t, _) => *t,
        }
    }

    /// A hit on a group as one on an instance of it, at this t.
    #[inline]
    fn in_instance(self, t: f32, instance: u32) -> Self {
        match self {
            Hit::Triangle(hit) | Hit::InstancedTriangle(_, hit) => {
                Hit::InstancedTriangle(instance, TriangleHit { t, ..hit })
            }
            Hit::Analytic { index, .. } | Hit::InstancedAnalytic(_, _, index) => {
                Hit::InstancedAnalytic(instance, t, index)
            }
        }
    }
}

impl Geometry {
    /// Lays out the shapes of a scene and builds their hierarchies. `first_lights` has, for each shape that emits, the light
    /// of its first primitive.
    pub fn new(scene: &Scene, first_lights: &[Option<u32>]) -> Self {
        Self::lay_out(scene, Meshes::new(scene, scene.meshes.clone()), first_lights)
    }

    /// As [`Geometry::new`], with the scene's meshes apart: each is let go of when it is laid out.
    pub fn lay_out(scene: &Scene, mut meshes: Meshes, first_lights: &[Option<u32>]) -> Self {
        let instances = (!scene.instances.is_empty()).then(|| Box::new(Instances::new(scene, &mut meshes)));
        Self { instances, ..Self::level(&mut meshes, &scene.shapes, first_lights, 0) }
    }

    /// Some of the scene's shapes, the first of which has this number.
    fn level(meshes: &mut Meshes, shapes: &[Shape], first_lights: &[Option<u32>], first_shape: u32) -> Self {
        let mut lists = Lists::with_room_for(meshes, shapes);
        for (shape, light) in shapes.iter().zip(first_lights) {
            lists.push(meshes, &shape.geometry, light.unwrap_or(NONE));
        }
        let triangle_count = lists.triangles.len() as u32;
        for table in lists.shapes.iter_mut().filter(|t| t.first_vertex == NONE) {
            table.first_primitive += triangle_count;
        }
        let vertices = |i: u32| lists.triangles[i as usize].map(|v| lists.positions[v as usize]);
        let bvh = TriangleBvh::build(triangle_count, vertices);
        let analytic_bvh = AnalyticBvh::build(&lists.analytic);
        let Lists { positions, normals, uvs, triangles, triangle_shapes, analytic, analytic_shapes, shapes } = lists;
        Self {
            positions,
            normals,
            uvs,
            triangles,
            triangle_shapes,
            analytic,
            analytic_shapes,
            shapes,
            first_shape,
            in_turns: bvh.stats().bytes > TURNS_FROM,
            is_scattered: triangle_count > SCATTERED_FROM,
            bvh,
            analytic_bvh,
            instances: None,
        }
    }

    /// What it takes in memory.
    pub fn memory(&self) -> Memory {
        let vectors = size_of_val(&*self.positions) + size_of_val(&*self.normals) + size_of_val(&*self.uvs);
        let indices = size_of_val(&*self.triangles) + size_of_val(&*self.triangle_shapes);
        let analytic = size_of_val(&*self.analytic) + size_of_val(&*self.analytic_shapes);
        let own = Memory {
            surfaces: vectors + indices + analytic + size_of_val(&*self.shapes),
            hierarchies: self.bvh.stats().bytes + self.analytic_bvh.bytes(),
            instances: 0,
        };
        self.instances.as_ref().map_or(own, |instances| own.plus(instances.memory()))
    }

    /// How many instances of groups there are.
    pub fn instances(&self) -> usize {
        self.instances.as_ref().map_or(0, |instances| instances.len())
    }

    /// The hierarchy over the triangles, in numbers.
    pub fn triangle_stats(&self) -> Stats {
        self.bvh.stats()
    }

    /// The analytic shape of this index.
    pub fn analytic(&self, index: u32) -> &Analytic {
        &self.analytic[index as usize]
    }

    /// The primitives of a shape: triangles, or one number behind all triangles.
    pub fn primitives(&self, shape: usize) -> std::ops::Range<u32> {
        let table = &self.shapes[shape];
        table.first_primitive..table.first_primitive + table.primitives
    }

    /// The analytic index of a primitive, none for a triangle.
    pub fn analytic_index(&self, primitive: u32) -> Option<u32> {
        primitive.checked_sub(self.triangles.len() as u32)
    }

    /// A box around a primitive.
    pub fn bounds(&self, primitive: u32) -> Aabb {
        match self.analytic_index(primitive) {
            Some(index) => {
                let (min, max) = self.analytic[index as usize].bounds();
                Aabb { min, max }
            }
            None => Aabb::around(self.vertices(primitive)),
        }
    }

    /// A box around a primitive, padded as in the hierarchy: a ray that meets the primitive meets the box.
    pub fn padded_bounds(&self, primitive: u32) -> Aabb {
        match self.analytic_index(primitive) {
            Some(_) => self.bounds(primitive),
            None => triangle_bounds(self.vertices(primitive)),
        }
    }

    /// The light that a hit is part of, if any.
    #[inline(always)]
    pub fn light_of(&self, hit: &Hit) -> Option<u32> {
        match hit {
            Hit::Triangle(hit) => {
                self.shapes[self.triangle_shapes[hit.triangle as usize] as usize].light_of(hit.triangle)
            }
            Hit::Analytic { index, .. } => {
                let table = &self.shapes[self.analytic_shapes[*index as usize] as usize];
                table.light_of(table.first_primitive)
            }
            Hit::InstancedTriangle(..) | Hit::InstancedAnalytic(..) => None,
        }
    }

    /// A cone around all shading normals of a primitive: its unit axis and the cosine of its half angle, −1 for all directions.
    pub fn normal_cone(&self, primitive: u32) -> (Vec3, f32) {
        let Some(index) = self.analytic_index(primitive) else {
            let corners = [Vec2::ZERO, Vec2::X, Vec2::Y].map(|b| self.triangle_surface(primitive, b).frame.n);
            let Some(axis) = (corners[0] + corners[1] + corners[2]).try_normalize() else { return (Vec3::Z, -1.0) };
            let cosine = corners.into_iter().fold(1.0, |least: f32, n| least.min(axis.dot(n)));
            // Flat ones keep their sharp edge; the others have room for rounding.
            return if cosine > 1.0 - 1e-6 { (axis, 1.0) } else { (axis, (cosine - 1e-4).max(-1.0)) };
        };
        self.analytic[index as usize].one_normal().map_or((Vec3::Z, -1.0), |normal| (normal, 1.0))
    }

    /// Area of a primitive.
    pub fn area(&self, primitive: u32) -> f32 {
        match self.analytic_index(primitive) {
            Some(index) => self.analytic[index as usize].area(),
            None => self.triangle_area(primitive),
        }
    }

    /// The vertices of a triangle.
    #[inline(always)]
    pub fn vertices(&self, triangle: u32) -> [Vec3; 3] {
        let [a, b, c] = self.triangles[triangle as usize];
        [self.positions[a as usize], self.positions[b as usize], self.positions[c as usize]]
    }

    /// Area of a triangle.
    #[inline(always)]
    pub fn triangle_area(&self, triangle: u32) -> f32 {
        let [p0, p1, p2] = self.vertices(triangle);
        0.5 * (p1 - p0).cross(p2 - p0).length()
    }

    /// Centre and radius of a ball around everything; radius 0 for an empty scene.
    pub fn bounding_ball(&self) -> (Vec3, f32) {
        let all = self.bounds_of_all();
        let size = all.max - all.min;
        if size.x < 0.0 { (Vec3::ZERO, 0.0) } else { (all.centre(), 0.5 * size.length()) }
    }

    /// The box around everything.
    fn bounds_of_all(&self) -> Aabb {
        let of_instances = self.instances.as_ref().map_or(Aabb::EMPTY, |instances| instances.bounds());
        let all = self.positions.iter().fold(of_instances, |all, &p| all.with(p));
        let analytic = self.analytic.iter().map(|shape| Aabb { min: shape.bounds().0, max: shape.bounds().1 });
        analytic.fold(all, Aabb::union)
    }
}

impl ShapeTable {
    /// Index of a vertex's normal, where the shape has normals.
    #[inline(always)]
    fn normal_of(&self, vertex: u32) -> usize {
        (vertex - self.first_vertex + self.first_normal) as usize
    }

    /// Index of a vertex's texture coordinates, where the shape has them.
    #[inline(always)]
    fn uv_of(&self, vertex: u32) -> usize {
        (vertex - self.first_vertex + self.first_uv) as usize
    }

    #[inline(always)]
    fn light_of(&self, primitive: u32) -> Option<u32> {
        (self.first_light != NONE).then(|| self.first_light + (primitive - self.first_primitive))
    }
}
