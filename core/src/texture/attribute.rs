//! The values of meshes that textures show, laid out for look-up: only those that some texture shows are kept.

use crate::scene::{Attribute, AttributeValues, Geometry, Scene, Shape, Texture};
use crate::surface::Surface;
use glam::Vec3;

/// Stands for "none" in the tables below.
const NONE: u32 = u32::MAX;

/// The attributes of all meshes that the scene's textures show.
pub struct Attributes {
    /// For each texture that shows an attribute, the table of each shape, or [`NONE`]; empty for other textures.
    of_texture: Vec<Vec<u32>>,
    tables: Vec<Table>,
}

/// An attribute of one shape.
struct Table {
    /// The number of the shape's first triangle.
    first_triangle: u32,
    /// The vertices of its triangles; empty where the values lie on the triangles themselves.
    vertices: Vec<[u32; 3]>,
    values: AttributeValues,
}

impl Attributes {
    /// Of a scene that has passed validation.
    pub fn new(scene: &Scene) -> Self {
        let mut attributes = Self { of_texture: Vec::with_capacity(scene.textures.len()), tables: Vec::new() };
        for texture in &scene.textures {
            let of_shapes = match texture {
                Texture::MeshAttribute { name, .. } => attributes.add(scene, name),
                _ => Vec::new(),
            };
            attributes.of_texture.push(of_shapes);
        }
        attributes
    }

    /// Lays out the attribute of this name for all shapes that have it.
    fn add(&mut self, scene: &Scene, name: &str) -> Vec<u32> {
        let mut first_triangle = 0;
        let mut of_shapes = Vec::with_capacity(scene.shapes.len());
        // Each group numbers its triangles from 0.
        for (i, shape) in scene.levels().flat_map(|shapes| shapes.iter().enumerate()) {
            first_triangle = if i == 0 { 0 } else { first_triangle };
            let found = attribute(scene, shape, name);
            of_shapes.push(if found.is_some() { self.tables.len() as u32 } else { NONE });
            let triangles = match shape.geometry {
                Geometry::Mesh(id) => &*scene.meshes[id.0 as usize].triangles,
                _ => &[],
            };
            self.tables.extend(found.map(|attribute| Table {
                first_triangle,
                vertices: if attribute.is_on_faces() { Vec::new() } else { triangles.to_vec() },
                values: attribute.values.clone(),
            }));
            first_triangle += triangles.len() as u32;
        }
        of_shapes
    }

    /// The value at a point of a mesh; black where there is none.
    pub fn at(&self, texture: u32, surface: &Surface) -> Vec3 {
        let of_shapes = &self.of_texture[texture as usize];
        let Some(table) = of_shapes.get(surface.shape as usize).and_then(|&i| self.tables.get(i as usize)) else {
            return Vec3::ZERO;
        };
        let triangle = (surface.primitive - table.first_triangle) as usize;
        let Some(vertices) = table.vertices.get(triangle) else { return table.values.at(triangle) };
        let [a, b, c] = vertices.map(|i| table.values.at(i as usize));
        let weights = surface.barycentric;
        a * (1.0 - weights.x - weights.y) + b * weights.x + c * weights.y
    }

    /// The mean of all values that a texture shows.
    pub fn mean(&self, texture: u32) -> Vec3 {
        let tables = self.of_texture[texture as usize].iter().filter_map(|&i| self.tables.get(i as usize));
        let (mut sum, mut count) = (glam::DVec3::ZERO, 0);
        for values in tables.map(|table| &table.values) {
            sum += (0..values.len()).map(|i| values.at(i).as_dvec3()).sum::<glam::DVec3>();
            count += values.len();
        }
        (sum / count.max(1) as f64).as_vec3()
    }

    /// What they take in memory.
    pub fn bytes(&self) -> usize {
        let of_values = |values: &AttributeValues| match values {
            AttributeValues::Scalars(values) => size_of_val(&**values),
            AttributeValues::Colours(values) => size_of_val(&**values),
        };
        self.tables.iter().map(|table| size_of_val(&*table.vertices) + of_values(&table.values)).sum()
    }
}

/// The attribute of this name that a shape has.
fn attribute<'a>(scene: &'a Scene, shape: &Shape, name: &str) -> Option<&'a Attribute> {
    let Geometry::Mesh(id) = shape.geometry else { return None };
    scene.meshes[id.0 as usize].attributes.iter().find(|attribute| attribute.name == name)
}
