//! How surfaces scatter light: the parameters only, models are in [`crate::bsdf`].

use super::TextureId;
use serde::{Deserialize, Serialize};

/// Index into [`super::Scene::bsdfs`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct BsdfId(pub u32);

/// A scattering model with its parameters, named as Mitsuba names them. Nested ones come before those that nest them, so
/// there is no circle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Bsdf {
    /// Lambert's: reflects on the side of the normal, black behind.
    Diffuse {
        /// Albedo.
        reflectance: TextureId,
    },
    /// A smooth metal.
    Conductor {
        /// Real part of the index of refraction over the outside's.
        eta: TextureId,
        /// Imaginary part, the absorption.
        k: TextureId,
        /// Factor on the reflection.
        specular_reflectance: TextureId,
    },
    /// A smooth interface between two transparent media.
    Dielectric {
        /// Index of refraction inside over outside (where the normal points to).
        eta: f32,
        /// Factor on the reflection.
        specular_reflectance: TextureId,
        /// Factor on the transmission.
        specular_transmittance: TextureId,
    },
    /// Lambert plus a cosine lobe around the mirror direction (Lafortune & Willems 1994): what an OBJ's MTL describes.
    Phong {
        /// Albedo of the Lambert part (Kd).
        diffuse_reflectance: TextureId,
        /// Albedo of the lobe (Ks).
        specular_reflectance: TextureId,
        /// Exponent of the lobe (Ns).
        exponent: f32,
    },
    /// One BSDF for each side; a side's own normal points to the viewer.
    TwoSided {
        /// Seen from where the normal points to.
        front: BsdfId,
        /// Seen from behind.
        back: BsdfId,
    },
    /// Scatters with probability `opacity`, else lets light straight through.
    Mask {
        /// 0 is invisible, 1 is solid.
        opacity: TextureId,
        /// What scatters.
        nested: BsdfId,
    },
}
