//! Lights that are not surfaces.

use super::{ImageId, TextureId};
use glam::{Affine3, Mat3, Vec3};
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
    /// A point that shines into a cone around its +z axis, as Mitsuba's `spot`.
    Spot {
        /// The light's space to the scene's, without scale.
        to_world: Affine3,
        /// Radiant intensity on the axis (W·sr⁻¹).
        intensity: Vec3,
        /// Angle to the axis at which it ends, below 90.
        cutoff_degrees: f32,
        /// Angle to the axis up to which it is constant; from there it falls linearly with the angle.
        beam_width_degrees: f32,
        /// A factor over the square around the cone, at z > 0.
        texture: Option<TextureId>,
    },
    /// A point that throws an image along its +z axis, as Mitsuba's `projector`.
    Projector {
        /// The light's space to the scene's, without scale.
        to_world: Affine3,
        /// The image; the plane z = 1 gets π times its value (W·m⁻²). Its u runs along −x, its v along −y.
        irradiance: TextureId,
        /// Factor on it.
        scale: f32,
        /// Half the image's width and height on the plane z = 1.
        half_extent: [f32; 2],
    },
    /// Parallel light.
    Directional {
        /// The unit direction the light travels in.
        direction: Vec3,
        /// Power through a unit area across it (W·m⁻²).
        irradiance: Vec3,
    },
}
