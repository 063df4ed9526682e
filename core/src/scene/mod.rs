//! What there is to render, as plain data: the value between every file format and the tracer.
//!
//! A `Scene` says nothing of how it is rendered (size, samples, integrator: [`crate::settings::Settings`]) nor of how it is
//! traced (hierarchies, light tables: [`crate::world::World`]). References are indices. Geometry is in world space,
//! transformed in f64 and moved so that [`Scene::origin`] is the zero of its f32 coordinates.

mod blobs;
mod bsdf;
mod emitter;
mod extent;
mod group;
mod sensor;
mod shape;
mod texture;
mod validate;

pub use blobs::{BlobError, Digest, SceneBlobs};
pub use bsdf::{Bend, Bsdf, BsdfId, Distribution};
pub use emitter::Emitter;
pub use group::{Group, GroupId, Instance};
pub use sensor::{FovAxis, Lens, Sensor};
pub use shape::{Attribute, AttributeValues, Geometry, Mesh, MeshId, Shape};
pub use texture::{FilterType, Image, ImageId, Texels, Texture, TextureId, WrapMode};
pub use validate::SceneError;

use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// A whole scene. Every index in it is in range and every number finite once [`Scene::validate`] has passed; loaders and
/// the wire call it, nothing behind them checks again.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scene {
    /// Where the pictures are taken from.
    pub sensor: Sensor,
    /// Everything that a ray can hit, but for instances.
    pub shapes: Vec<Shape>,
    /// Shapes that are kept once and seen where instances place them.
    pub groups: Vec<Group>,
    /// Groups in their places.
    pub instances: Vec<Instance>,
    /// How surfaces scatter; shapes and other BSDFs refer to them.
    pub bsdfs: Vec<Bsdf>,
    /// Colours over surfaces; BSDFs and emitters refer to them.
    pub textures: Vec<Texture>,
    /// Lights that are not surfaces. (A shape that emits carries its radiance itself.)
    pub emitters: Vec<Emitter>,
    /// Triangle meshes, the bulk of most scenes. They travel as blobs of their own.
    #[serde(skip)]
    pub meshes: Vec<Arc<Mesh>>,
    /// Decoded images, likewise.
    #[serde(skip)]
    pub images: Vec<Arc<Image>>,
    /// The point of the file's world space, in its units, that lies at the zero of this scene's coordinates.
    pub origin: [f64; 3],
}

impl Scene {
    /// The shapes that stand in the scene itself, then those of each group: so they are numbered.
    pub fn levels(&self) -> impl Iterator<Item = &[Shape]> {
        std::iter::once(&*self.shapes).chain(self.groups.iter().map(|group| &*group.shapes))
    }
}

#[cfg(test)]
impl Scene {
    /// A camera and nothing before it, for tests to fill.
    pub(crate) fn empty() -> Self {
        let sensor = Sensor::Perspective {
            to_world: glam::Affine3::IDENTITY,
            fov_degrees: 40.0,
            fov_axis: FovAxis::X,
            principal_point_offset: [0.0; 2],
            near_clip: 0.01,
            far_clip: 1e4,
            lens: None,
        };
        Self {
            sensor,
            shapes: Vec::new(),
            groups: Vec::new(),
            instances: Vec::new(),
            bsdfs: Vec::new(),
            textures: Vec::new(),
            emitters: Vec::new(),
            meshes: Vec::new(),
            images: Vec::new(),
            origin: [0.0; 3],
        }
    }
}
