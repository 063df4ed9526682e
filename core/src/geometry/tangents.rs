//! How surface points move with their texture coordinates: for materials that have a grain or a normal map. Nothing else needs
//! it, so it is computed on demand and no hit pays for it.

use super::{Geometry, NONE};
use crate::frame::Frame;
use crate::surface::Surface;
use glam::{Vec2, Vec3};

impl Geometry {
    /// ∂p/∂u and ∂p/∂v at a point of this geometry, in scene coordinates and of any length, as Mitsuba defines them: on a
    /// triangle from its texture coordinates (its edges where it has none), on an analytic shape from its formula. They are
    /// linearly independent; where texture coordinates do not tell, they are some tangents of unit length.
    pub fn tangents(&self, surface: &Surface) -> (Vec3, Vec3) {
        if let (Some(instance), Some(instances)) = (surface.instance, &self.instances) {
            return instances.tangents(instance, surface);
        }
        match self.analytic_index(surface.primitive) {
            Some(index) => self.analytic[index as usize].tangents(surface.position),
            None => self.triangle_tangents(surface),
        }
    }

    fn triangle_tangents(&self, surface: &Surface) -> (Vec3, Vec3) {
        let table = &self.shapes[(surface.shape - self.first_shape) as usize];
        let vertices = self.triangles[surface.primitive as usize];
        let [p0, p1, p2] = vertices.map(|i| self.positions[i as usize]);
        let (e1, e2) = (p1 - p0, p2 - p0);
        if table.first_uv == NONE {
            return (e1, e2);
        }
        let [t0, t1, t2] = vertices.map(|i| self.uvs[table.uv_of(i)]);
        let (a, b): (Vec2, Vec2) = (t1 - t0, t2 - t0);
        let determinant = a.perp_dot(b);
        let (dpdu, dpdv) = ((e1 * b.y - e2 * a.y) / determinant, (e2 * a.x - e1 * b.x) / determinant);
        let independent = dpdu.cross(dpdv).length_squared();
        if determinant != 0.0 && independent > 0.0 && independent.is_finite() {
            (dpdu, dpdv)
        } else {
            let frame = Frame::around(surface.normal);
            (frame.s, frame.t)
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::geometry::Geometry;
    use crate::scene::{BsdfId, Geometry as Form, Mesh, MeshId, Scene, Shape};
    use glam::{Affine3, Mat3, Quat, Vec2, Vec3};
    use std::sync::Arc;

    fn scene(geometry: Form, mesh: Mesh) -> Scene {
        let shape = Shape { name: String::new(), geometry, bsdf: BsdfId(0), radiance: None };
        Scene { shapes: vec![shape], meshes: vec![Arc::new(mesh)], ..Scene::empty() }
    }

    fn placed() -> Affine3 {
        let matrix3 = Mat3::from_quat(Quat::from_xyzw(0.1, 0.3, -0.2, 0.9).normalize()) * 0.75;
        Affine3 { matrix3, translation: Vec3::new(0.3, -1.0, 4.0) }
    }

    /// p(uv + δ) − p(uv) = ∂p/∂u δu + ∂p/∂v δv for nearby points of the same surface.
    #[test]
    fn tangents_are_derivatives() {
        let mesh = Mesh {
            positions: vec![Vec3::new(0.3, 0.2, 0.1), Vec3::new(2.0, 0.4, -0.5), Vec3::new(0.1, 1.5, 0.7)],
            uvs: vec![Vec2::new(0.1, 0.2), Vec2::new(0.9, -0.3), Vec2::new(0.4, 1.7)],
            triangles: vec![[0, 1, 2]],
            ..Mesh::default()
        };
        let bare = Mesh { uvs: Vec::new(), ..mesh.clone() };
        let sphere = Form::Sphere { to_world: placed(), flip_normals: false };
        let disk = Form::Disk { to_world: placed(), flip_normals: false };
        for (form, mesh) in
            [(Form::Mesh(MeshId(0)), mesh), (Form::Mesh(MeshId(0)), bare.clone()), (sphere, bare.clone()), (disk, bare)]
        {
            let geometry = Geometry::new(&scene(form.clone(), mesh), &[None]);
            let at = |u: Vec2| match geometry.analytic_index(0) {
                None => geometry.triangle_surface(0, u),
                Some(i) => {
                    geometry.analytic_surface(i, placed().transform_point3(Vec3::new(0.2 + u.x, 0.5 + u.y, 0.1)))
                }
            };
            let (step, here) = (4e-3, at(Vec2::new(0.3, 0.4)));
            let (dpdu, dpdv) = geometry.tangents(&here);
            for towards in [Vec2::new(step, 0.0), Vec2::new(0.0, step)] {
                let there = at(Vec2::new(0.3, 0.4) + towards);
                let by = there.uv - here.uv;
                let moved = there.position - here.position;
                let predicted = dpdu * by.x + dpdv * by.y;
                assert!((moved - predicted).length() < 0.03 * moved.length(), "{form:?}: {moved} {predicted}");
            }
        }
    }
}
