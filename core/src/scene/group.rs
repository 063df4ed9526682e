//! Surfaces that are placed many times and kept once.

use super::Shape;
use glam::Affine3;
use serde::{Deserialize, Serialize};

/// Index into [`super::Scene::groups`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct GroupId(pub u32);

/// Shapes in coordinates of their own; they are seen only where an [`Instance`] places them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Group {
    /// None of them emits: a light has one place.
    pub shapes: Vec<Shape>,
}

/// A group in its place.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Instance {
    /// What is placed.
    pub group: GroupId,
    /// The group's coordinates to the scene's. It may mirror: normals stay on their side of the surface.
    pub to_world: Affine3,
}
