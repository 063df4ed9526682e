//! The lists of a geometry while they grow, and meshes on their way into them.

use super::{NONE, ShapeTable, face_normal};
use crate::scene::{Geometry as Form, Mesh, MeshId, Scene, Shape};
use crate::shape::Analytic;
use glam::{Vec2, Vec3};
use std::sync::Arc;

/// The meshes of a scene, each kept until the last shape of it is laid out.
pub struct Meshes {
    list: Vec<Arc<Mesh>>,
    /// How many shapes of each are still to come.
    uses: Vec<u32>,
}

impl Meshes {
    /// Of a scene, whose meshes these are.
    pub fn new(scene: &Scene, list: Vec<Arc<Mesh>>) -> Self {
        let mut uses = vec![0; list.len()];
        for shape in scene.levels().flatten() {
            if let Form::Mesh(id) = shape.geometry {
                uses[id.0 as usize] += 1;
            }
        }
        Self { list, uses }
    }

    fn of(&self, shape: &Shape) -> Option<&Mesh> {
        match shape.geometry {
            Form::Mesh(id) => Some(&self.list[id.0 as usize]),
            _ => None,
        }
    }

    /// A mesh for one of its shapes.
    fn take(&mut self, id: MeshId) -> Arc<Mesh> {
        let (mesh, uses) = (&mut self.list[id.0 as usize], &mut self.uses[id.0 as usize]);
        *uses -= 1;
        if *uses == 0 { std::mem::take(mesh) } else { mesh.clone() }
    }
}

/// How far a normal may be from that of its triangle and still say nothing else: what files round away.
const FLAT: f32 = 1e-4;

/// Whether the normals of a mesh are those of its triangles, which then need not be kept, looked up or interpolated.
fn is_flat(mesh: &Mesh) -> bool {
    mesh.triangles.iter().all(|triangle| {
        let (normal, is_sure) = face_normal(triangle.map(|i| mesh.positions[i as usize]));
        let is_its_own = |i: &u32| (mesh.normals[*i as usize].normalize_or_zero() - normal).length() < FLAT;
        is_sure && triangle.iter().all(is_its_own)
    })
}

/// The common lists while they grow.
#[derive(Default)]
pub struct Lists {
    pub positions: Vec<Vec3>,
    pub normals: Vec<Vec3>,
    pub uvs: Vec<Vec2>,
    pub triangles: Vec<[u32; 3]>,
    pub triangle_shapes: Vec<u32>,
    pub analytic: Vec<Analytic>,
    pub analytic_shapes: Vec<u32>,
    pub shapes: Vec<ShapeTable>,
}

impl Lists {
    /// Empty, with room for the vertices and triangles of some shapes.
    pub fn with_room_for(meshes: &Meshes, shapes: &[Shape]) -> Self {
        let mut lists = Self::default();
        let of =
            |len: fn(&Mesh) -> usize| -> usize { shapes.iter().filter_map(|shape| meshes.of(shape)).map(len).sum() };
        lists.positions.reserve_exact(of(|mesh| mesh.positions.len()));
        lists.normals.reserve_exact(of(|mesh| mesh.normals.len()));
        lists.uvs.reserve_exact(of(|mesh| mesh.uvs.len()));
        lists.triangles.reserve_exact(of(|mesh| mesh.triangles.len()));
        lists.triangle_shapes.reserve_exact(lists.triangles.capacity());
        lists
    }

    /// Adds a shape, whose first light is this one.
    pub fn push(&mut self, meshes: &mut Meshes, geometry: &Form, first_light: u32) {
        let shape = self.shapes.len() as u32;
        let mut table = ShapeTable {
            first_primitive: self.triangles.len() as u32,
            primitives: 1,
            first_vertex: NONE,
            first_normal: NONE,
            first_uv: NONE,
            first_light,
        };
        if let Form::Mesh(id) = geometry {
            let mesh = meshes.take(*id);
            let first = self.positions.len() as u32;
            table.first_vertex = first;
            table.primitives = mesh.triangles.len() as u32;
            if !mesh.normals.is_empty() && !is_flat(&mesh) {
                table.first_normal = self.normals.len() as u32;
                self.normals.extend(&mesh.normals);
            }
            if !mesh.uvs.is_empty() {
                table.first_uv = self.uvs.len() as u32;
                self.uvs.extend(&mesh.uvs);
            }
            self.positions.extend(&mesh.positions);
            self.triangles.extend(mesh.triangles.iter().map(|t| t.map(|i| i + first)));
            self.triangle_shapes.resize(self.triangles.len(), shape);
        } else if let Some(analytic) = Analytic::new(geometry) {
            table.first_primitive = self.analytic.len() as u32; // moved behind the triangles once they are counted
            self.analytic.push(analytic);
            self.analytic_shapes.push(shape);
        }
        self.shapes.push(table);
    }
}
