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
    /// Further values over it, for [`super::Texture::MeshAttribute`]; only those that some texture shows.
    pub attributes: Vec<Attribute>,
}

/// Values at the vertices or on the triangles of a mesh.
#[derive(Clone, Debug, PartialEq)]
pub struct Attribute {
    /// Begins with `vertex_` or `face_`, which says whether there is a value for each vertex or for each triangle.
    pub name: String,
    /// The values.
    pub values: AttributeValues,
}

/// The values of an [`Attribute`].
#[derive(Clone, Debug, PartialEq)]
pub enum AttributeValues {
    /// One number each.
    Scalars(Vec<f32>),
    /// A linear sRGB colour each.
    Colours(Vec<Vec3>),
}

impl AttributeValues {
    /// How many there are.
    pub fn len(&self) -> usize {
        match self {
            Self::Scalars(values) => values.len(),
            Self::Colours(values) => values.len(),
        }
    }

    /// There are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The value of this index as a colour.
    #[inline]
    pub fn at(&self, i: usize) -> Vec3 {
        match self {
            Self::Scalars(values) => Vec3::splat(values[i]),
            Self::Colours(values) => values[i],
        }
    }
}

impl Attribute {
    /// What the names of values at vertices begin with.
    pub const AT_VERTICES: &'static str = "vertex_";
    /// What the names of values on triangles begin with.
    pub const ON_FACES: &'static str = "face_";

    /// Whether there is a value for each triangle rather than for each vertex.
    pub fn is_on_faces(&self) -> bool {
        self.name.starts_with(Self::ON_FACES)
    }
}

impl Mesh {
    /// What it takes in memory.
    pub fn bytes(&self) -> usize {
        let of_attribute = |attribute: &Attribute| match &attribute.values {
            AttributeValues::Scalars(values) => size_of_val(&**values),
            AttributeValues::Colours(values) => size_of_val(&**values),
        };
        size_of_val(&*self.positions)
            + size_of_val(&*self.normals)
            + size_of_val(&*self.uvs)
            + size_of_val(&*self.triangles)
            + self.attributes.iter().map(of_attribute).sum::<usize>()
    }
}
