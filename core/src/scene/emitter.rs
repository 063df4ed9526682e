//! Lights that are not surfaces.

use glam::Vec3;
use serde::{Deserialize, Serialize};

/// A light without a surface. Values are linear sRGB.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Emitter {
    /// The same radiance from every direction beyond the scene (W·m⁻²·sr⁻¹).
    Constant {
        /// Radiance.
        radiance: Vec3,
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
