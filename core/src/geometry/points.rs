//! The surface at a hit: tables looked up, the point computed.

use super::place::{face_normal, place, place_of_sliver};
use super::{Geometry, Hit, NONE};
use crate::bvh::simd::prefetch_line;
use crate::bvh::{Ray, TriangleHit};
use crate::frame::Frame;
use crate::surface::Surface;
use glam::{Vec2, Vec3};

impl Geometry {
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
                    prefetch_line(&self.normals[table.normal_of(vertex)]);
                }
                if table.first_uv != NONE {
                    prefetch_line(&self.uvs[table.uv_of(vertex)]);
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
            let at = |i: usize| self.normals[table.normal_of(vertices[i])];
            at(0) * weights[0] + at(1) * weights[1] + at(2) * weights[2]
        };
        let uv = if table.first_uv == NONE {
            b
        } else {
            let at = |i: usize| self.uvs[table.uv_of(vertices[i])];
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
