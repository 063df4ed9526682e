//! Surfaces: triangle meshes and the analytic shapes that are traced as such.

use super::{BsdfId, TextureId};
use glam::{Affine3, Vec2, Vec3};
use serde::{Deserialize, Serialize};

/// Index into [`super::Scene::meshes`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct MeshId(pub u32);

/// A surface with its material and, if it is a light, its radiance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Shape {
    /// The id or file name it had, for messages.
    pub name: String,
    /// The surface itself.
    pub geometry: Geometry,
    /// How it scatters.
    pub bsdf: BsdfId,
    /// Radiance emitted to the side its normal points to (W·m⁻²·sr⁻¹), if it is an area light.
    pub radiance: Option<TextureId>,
}

/// The surface of a [`Shape`], in the scene's coordinates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Geometry {
    /// Triangles.
    Mesh(MeshId),
    /// The unit sphere under a similarity (rotation, uniform scale, translation). `to_world` takes (0,0,1) to its pole:
    /// u runs around it, v from pole to pole, as Mitsuba's `sphere` has it.
    Sphere {
        /// Object to scene coordinates.
        to_world: Affine3,
        /// Normals point inwards.
        flip_normals: bool,
    },
    /// The unit disk in the plane z = 0, normal +z, under an affine map. u is the radius, v the angle over 2π.
    Disk {
        /// Object to scene coordinates.
        to_world: Affine3,
        /// The normal is −z.
        flip_normals: bool,
    },
    /// The side of the unit cylinder (x² + y² = 1, 0 ≤ z ≤ 1) under an affine map, normals outwards. u runs around, v is z.
    Cylinder {
        /// Object to scene coordinates.
        to_world: Affine3,
        /// Normals point inwards.
        flip_normals: bool,
    },
}

/// Triangles with shared vertices. `normals` and `uvs`, where present, have one entry a vertex.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Positions in scene coordinates.
    pub positions: Vec<Vec3>,
    /// Unit shading normals, or empty: the face's own normal is used.
    pub normals: Vec<Vec3>,
    /// Texture coordinates, or empty: the triangle's barycentric coordinates are used.
    pub uvs: Vec<Vec2>,
    /// Vertex indices of each triangle, counter-clockwise seen from the side the face normal points to.
    pub triangles: Vec<[u32; 3]>,
}
