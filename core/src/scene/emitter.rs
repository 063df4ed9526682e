//! Lights that are not surfaces.

use super::ImageId;
use glam::{Mat3, Vec3};
use serde::{Deserialize, Serialize};

/// A light without a surface. Values are linear sRGB.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Emitter {
    /// The same radiance from every direction beyond the scene (W·m⁻²·sr⁻¹).
    Constant {
        /// Radiance.
        radiance: Vec3,
    },
    /// Radiance from an image around the scene, rows running from +y to −y, as Mitsuba's `envmap` has it.
    Envmap {
        /// The image, at least 2×3 pixels.
        image: ImageId,
        /// Factor on every value.
        scale: f32,
        /// The image's space to the scene's, a rotation (or a reflection).
        to_world: Mat3,
    },
    /// A point that shines alike in all directions.
    Point {
        /// In scene coordinates.
        position: Vec3,
        /// Radiant intensity (W·sr⁻¹), for distances in scene units.
        intensity: Vec3,
    },
    /// Parallel light.
    Directional {
        /// The unit direction the light travels in.
        direction: Vec3,
        /// Power through a unit area across it (W·m⁻²).
        irradiance: Vec3,
    },
}
