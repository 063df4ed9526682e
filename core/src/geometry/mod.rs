//! All surfaces of a scene, laid out for tracing: what a ray hits, and the surface point there.

mod instances;
mod lists;
mod place;
mod tangents;

use crate::bvh::simd::{Lanes, prefetch_line};
use crate::bvh::{Aabb, Ray, Stats, TriangleBvh, TriangleHit, triangle_bounds};
use crate::frame::Frame;
use crate::scene::{Scene, Shape};
use crate::shape::{Analytic, AnalyticBvh};
use crate::surface::Surface;
use glam::{Vec2, Vec3};
use instances::Instances;
use lists::Lists;
pub use lists::Meshes;
use place::face_normal;
pub use place::{Place, place, place_of_sliver};

/// Stands for "none" in the tables below.
const NONE: u32 = u32::MAX;

/// Hierarchies of more bytes are searched by many rays in turns. Below, single rays are as fast or faster: measured on scenes of up
/// to 260,000 triangles.
const TURNS_FROM: usize = 1 << 26;
/// With so many triangles it pays to ask for what tables say of them ahead of time; with fewer all of it is near anyway.
const SCATTERED_FROM: u32 = 1 << 12;
/// Rays handed over to the hierarchy at a time.
const TURNS: usize = 256;

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

    /// The nearest hit; of equally near ones the first primitive.
    #[inline(always)]
    pub fn closest<L: Lanes>(&self, lanes: L, ray: &Ray) -> Option<Hit> {
        self.closest_with(lanes, ray, self.bvh.closest(lanes, ray))
    }

    /// The nearest hit, that of the triangles given.
    #[inline(always)]
    fn closest_with<L: Lanes>(&self, lanes: L, ray: &Ray, triangle: Option<TriangleHit>) -> Option<Hit> {
        let hit = self.closest_of_own(lanes, ray, triangle);
        let Some(instances) = &self.instances else { return hit };
        let t_max = hit.map_or(ray.t_max, |hit| hit.t());
        let instanced = instances.closest(lanes, &Ray { t_max, ..*ray });
        instanced.filter(|other| hit.is_none_or(|hit| other.t() < hit.t())).or(hit)
    }

    /// [`Geometry::closest`] of many rays. `hits` is as long as `rays`.
    #[inline(always)]
    pub fn closest_many<L: Lanes>(&self, lanes: L, rays: &[Ray], hits: &mut [Option<Hit>]) {
        if !self.in_turns {
            for (ray, hit) in rays.iter().zip(hits) {
                *hit = self.closest(lanes, ray);
            }
            return;
        }
        let mut triangles = [None; TURNS];
        for (rays, hits) in rays.chunks(TURNS).zip(hits.chunks_mut(TURNS)) {
            let triangles = &mut triangles[..rays.len()];
            self.bvh.closest_many(lanes, rays, triangles);
            for ((ray, hit), triangle) in rays.iter().zip(hits).zip(triangles) {
                *hit = self.closest_with(lanes, ray, *triangle);
            }
        }
    }

    /// [`Geometry::occluded`] of many rays. `occluded` is as long as `rays`.
    #[inline(always)]
    pub fn occluded_many<L: Lanes>(&self, lanes: L, rays: &[Ray], occluded: &mut [bool]) {
        if !self.in_turns {
            for (ray, occluded) in rays.iter().zip(occluded) {
                *occluded = self.occluded(lanes, ray);
            }
            return;
        }
        self.bvh.occluded_many(lanes, rays, occluded);
        for (ray, occluded) in rays.iter().zip(occluded) {
            *occluded = *occluded || self.occluded_by_others(lanes, ray);
        }
    }

    /// The nearest hit that is in no instance, that of the triangles given.
    #[inline(always)]
    fn closest_of_own<L: Lanes>(&self, lanes: L, ray: &Ray, triangle: Option<TriangleHit>) -> Option<Hit> {
        if self.analytic.is_empty() {
            return triangle.map(Hit::Triangle);
        }
        let t_max = triangle.map_or(ray.t_max, |hit| hit.t);
        let analytic = self.analytic_bvh.closest(lanes, &self.analytic, &Ray { t_max, ..*ray });
        match (triangle, analytic) {
            (Some(hit), Some((t, _))) if hit.t <= t => Some(Hit::Triangle(hit)),
            (_, Some((t, index))) => Some(Hit::Analytic { t, index }),
            (triangle, None) => triangle.map(Hit::Triangle),
        }
    }

    /// Whether anything lies on the ray.
    #[inline(always)]
    pub fn occluded<L: Lanes>(&self, lanes: L, ray: &Ray) -> bool {
        self.bvh.occluded(lanes, ray) || self.occluded_by_others(lanes, ray)
    }

    /// Whether anything but the geometry's own triangles lies on the ray.
    #[inline(always)]
    fn occluded_by_others<L: Lanes>(&self, lanes: L, ray: &Ray) -> bool {
        (!self.analytic.is_empty() && self.analytic_bvh.occluded(lanes, &self.analytic, ray))
            || self.instances.as_ref().is_some_and(|instances| instances.occluded(lanes, ray))
    }

    /// Whether anything that is in no instance lies on the ray.
    #[inline(always)]
    fn occluded_by_own<L: Lanes>(&self, lanes: L, ray: &Ray) -> bool {
        self.bvh.occluded(lanes, ray)
            || (!self.analytic.is_empty() && self.analytic_bvh.occluded(lanes, &self.analytic, ray))
    }

    /// The surface where a ray hit it.
    #[inline(always)]
    pub fn surface(&self, ray: &Ray, hit: Hit) -> Surface {
        match hit {
            Hit::Triangle(TriangleHit { u, v, triangle, .. }) => self.triangle_surface(triangle, Vec2::new(u, v)),
            Hit::Analytic { t, index } => self.analytic_surface(index, ray.origin + ray.direction * t),
            Hit::InstancedTriangle(i, hit) => self.instanced(i, ray, Hit::Triangle(hit)),
            Hit::InstancedAnalytic(i, t, index) => self.instanced(i, ray, Hit::Analytic { t, index }),
        }
    }

    fn instanced(&self, instance: u32, ray: &Ray, hit: Hit) -> Surface {
        match &self.instances {
            Some(instances) => instances.surface(ray, instance, hit),
            None => unreachable!("a hit on an instance comes from a geometry with instances"),
        }
    }

    /// The point of a triangle with barycentric coordinates `b` of its vertices 1 and 2.
    #[inline(always)]
    pub fn triangle_surface(&self, triangle: u32, b: Vec2) -> Surface {
        let point = self.triangle_point(triangle, b);
        let mut place = place(point.corners, point.shading, b);
        if !place.is_sure {
            place = place_of_sliver(point.corners, point.shading, b);
        }
        Surface {
            position: place.position,
            error: place.error,
            normal: place.normal,
            frame: place.frame,
            uv: point.uv,
            barycentric: b,
            shape: point.shape,
            instance: None,
            primitive: triangle,
            light: point.light,
        }
    }

    /// Asks for what [`Geometry::triangle_point`] will read at these hits, ahead of time.
    #[inline(always)]
    pub fn prefetch(&self, hits: &[Option<Hit>]) {
        if !self.is_scattered {
            return;
        }
        let triangles =
            || hits.iter().filter_map(|hit| if let Some(Hit::Triangle(hit)) = hit { Some(hit) } else { None });
        for hit in triangles() {
            prefetch_line(&self.triangles[hit.triangle as usize]);
            prefetch_line(&self.triangle_shapes[hit.triangle as usize]);
        }
        for hit in triangles() {
            let table = &self.shapes[self.triangle_shapes[hit.triangle as usize] as usize];
            for vertex in self.triangles[hit.triangle as usize] {
                prefetch_line(&self.positions[vertex as usize]);
                if table.first_normal != NONE {
                    prefetch_line(&self.normals[(vertex - table.first_vertex + table.first_normal) as usize]);
                }
                if table.first_uv != NONE {
                    prefetch_line(&self.uvs[(vertex - table.first_vertex + table.first_uv) as usize]);
                }
            }
        }
    }

    /// What tables say of the point of a triangle.
    #[inline(always)]
    pub fn triangle_point(&self, triangle: u32, b: Vec2) -> TrianglePoint {
        let shape = self.triangle_shapes[triangle as usize];
        let table = &self.shapes[shape as usize];
        let vertices = self.triangles[triangle as usize];
        let weights = [1.0 - b.x - b.y, b.x, b.y];
        let shading = if table.first_normal == NONE {
            Vec3::ZERO
        } else {
            let at = |i: usize| self.normals[(vertices[i] - table.first_vertex + table.first_normal) as usize];
            at(0) * weights[0] + at(1) * weights[1] + at(2) * weights[2]
        };
        let uv = if table.first_uv == NONE {
            b
        } else {
            let at = |i: usize| self.uvs[(vertices[i] - table.first_vertex + table.first_uv) as usize];
            at(0) * weights[0] + at(1) * weights[1] + at(2) * weights[2]
        };
        let corner = |i: usize| self.positions[vertices[i] as usize];
        let corners = [corner(0), corner(1), corner(2)];
        TrianglePoint { corners, shading, uv, shape: self.first_shape + shape, light: table.light_of(triangle) }
    }

    /// Whether a triangle's shading normal is its own everywhere, found without [`place_of_sliver`].
    pub fn is_plain(&self, triangle: u32) -> bool {
        let table = &self.shapes[self.triangle_shapes[triangle as usize] as usize];
        table.first_normal == NONE && face_normal(self.vertices(triangle)).1
    }

    /// The point of an analytic shape nearest to `position`.
    #[inline(always)]
    pub fn analytic_surface(&self, index: u32, position: Vec3) -> Surface {
        self.analytic_point(index, self.analytic[index as usize].point(position))
    }

    /// A point of an analytic shape as a surface.
    #[inline(always)]
    pub fn analytic_point(&self, index: u32, point: crate::shape::Point) -> Surface {
        let shape = self.analytic_shapes[index as usize];
        let table = &self.shapes[shape as usize];
        Surface {
            position: point.position,
            error: point.error,
            normal: point.normal,
            frame: Frame::around(point.normal),
            uv: point.uv,
            barycentric: Vec2::ZERO,
            shape: self.first_shape + shape,
            instance: None,
            primitive: table.first_primitive,
            light: table.light_of(table.first_primitive),
        }
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
            None => self.vertices(primitive).into_iter().fold(Aabb::EMPTY, Aabb::with),
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
        let Aabb { min, max } = self.bounds_of_all();
        if min.x > max.x { (Vec3::ZERO, 0.0) } else { (0.5 * (min + max), 0.5 * (max - min).length()) }
    }

    /// The box around everything.
    fn bounds_of_all(&self) -> Aabb {
        let of_instances = self.instances.as_ref().map_or(Aabb::EMPTY, |instances| instances.bounds());
        let all = self.positions.iter().fold(of_instances, |all, &p| all.with(p));
        let analytic = self.analytic.iter().map(|shape| Aabb { min: shape.bounds().0, max: shape.bounds().1 });
        analytic.fold(all, Aabb::union)
    }
}

/// What tables say of a point of a triangle.
#[derive(Clone, Copy, Debug)]
pub struct TrianglePoint {
    /// The vertices.
    pub corners: [Vec3; 3],
    /// The interpolated normal, of any length; zero where there is none.
    pub shading: Vec3,
    /// Texture coordinates.
    pub uv: Vec2,
    /// The shape.
    pub shape: u32,
    /// The light, if it emits.
    pub light: Option<u32>,
}

impl ShapeTable {
    #[inline(always)]
    fn light_of(&self, primitive: u32) -> Option<u32> {
        (self.first_light != NONE).then(|| self.first_light + (primitive - self.first_primitive))
    }
}
