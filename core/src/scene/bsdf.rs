//! How surfaces scatter light: the parameters only, models are in [`crate::bsdf`].

use super::TextureId;
use serde::{Deserialize, Serialize};

/// Index into [`super::Scene::bsdfs`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct BsdfId(pub u32);

/// How the normals of a rough surface's facets are distributed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Distribution {
    /// Slopes are a Gaussian; the roughness is their root mean square times √2.
    Beckmann,
    /// Trowbridge & Reitz's, with longer tails.
    Ggx,
}

/// How a map of heights or normals bends the shading frame of what it nests (in it, no other map).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bend {
    /// A normal that points away from the viewer is turned around the original one until it does not.
    pub flip_invalid_normals: bool,
    /// Light is dimmed near the horizon of the bent surface (Conty Estevez, Lecocq & Stein 2019, "A Microfacet-Based
    /// Shadowing Function to Solve the Bump Terminator Problem").
    pub use_shadowing_function: bool,
}

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
    /// A rough metal.
    RoughConductor {
        /// Of the facets.
        distribution: Distribution,
        /// Roughness along the first tangent.
        alpha_u: TextureId,
        /// Roughness along the second; the same texture as `alpha_u` where there is but one.
        alpha_v: TextureId,
        /// Real part of the index of refraction over the outside's.
        eta: TextureId,
        /// Imaginary part, the absorption.
        k: TextureId,
        /// Factor on the reflection.
        specular_reflectance: TextureId,
    },
    /// A rough interface between two transparent media.
    RoughDielectric {
        /// Of the facets.
        distribution: Distribution,
        /// Roughness along the first tangent.
        alpha_u: TextureId,
        /// Roughness along the second; the same texture as `alpha_u` where there is but one.
        alpha_v: TextureId,
        /// Index of refraction inside over outside (where the normal points to).
        eta: f32,
        /// Factor on the reflection.
        specular_reflectance: TextureId,
        /// Factor on the transmission.
        specular_transmittance: TextureId,
    },
    /// A pane of glass as one sheet.
    ThinDielectric {
        /// Index of refraction inside over outside.
        eta: f32,
        /// Factor on the reflection.
        specular_reflectance: TextureId,
        /// Factor on the transmission.
        specular_transmittance: TextureId,
    },
    /// A diffuse base under a smooth coat.
    Plastic {
        /// Index of refraction of the coat over the outside's.
        eta: f32,
        /// The base's colour deepens by reflections inside the coat.
        nonlinear: bool,
        /// Albedo of the base.
        diffuse_reflectance: TextureId,
        /// Factor on the coat's reflection.
        specular_reflectance: TextureId,
    },
    /// A diffuse base under a rough coat.
    RoughPlastic {
        /// Of the coat's facets.
        distribution: Distribution,
        /// Roughness of the coat.
        alpha: f32,
        /// Index of refraction of the coat over the outside's.
        eta: f32,
        /// The base's colour deepens by reflections inside the coat.
        nonlinear: bool,
        /// Albedo of the base.
        diffuse_reflectance: TextureId,
        /// Factor on the coat's reflection.
        specular_reflectance: TextureId,
    },
    /// Burley's model (2012, 2015). All but the colour are scalars in 0..1.
    Principled {
        /// Colour of the diffuse part and of the metal.
        base_color: TextureId,
        /// Of the diffuse part and, squared, of the facets.
        roughness: TextureId,
        /// From round to long highlights along the first tangent.
        anisotropic: TextureId,
        /// From dielectric to metal.
        metallic: TextureId,
        /// From opaque to transparent.
        spec_trans: TextureId,
        /// Index of refraction inside over outside.
        eta: f32,
        /// How much of the base's colour the dielectric reflection has.
        spec_tint: TextureId,
        /// Strength of the sheen.
        sheen: TextureId,
        /// How much of the base's colour the sheen has.
        sheen_tint: TextureId,
        /// From diffuse to a subsurface look.
        flatness: TextureId,
        /// Strength of the coat.
        clearcoat: TextureId,
        /// From a satin to a glossy coat.
        clearcoat_gloss: TextureId,
    },
    /// Burley's model for thin sheets (2015). All but the colour, `eta` and `diff_trans` are scalars in 0..1.
    PrincipledThin {
        /// Colour.
        base_color: TextureId,
        /// Of the diffuse part and, squared, of the facets.
        roughness: TextureId,
        /// From round to long highlights along the first tangent.
        anisotropic: TextureId,
        /// From diffuse to clear.
        spec_trans: TextureId,
        /// Index of refraction inside over outside.
        eta: TextureId,
        /// How much of the base's colour the reflection has.
        spec_tint: TextureId,
        /// Strength of the sheen.
        sheen: TextureId,
        /// How much of the base's colour the sheen has.
        sheen_tint: TextureId,
        /// From diffuse to a subsurface look.
        flatness: TextureId,
        /// Diffuse light that goes through, from 0 (none) to 2 (all).
        diff_trans: TextureId,
    },
    /// Nothing: light goes straight through.
    Null,
    /// Scatters as the second with probability `weight`, else as the first.
    BlendBsdf {
        /// 0 is the first, 1 is the second.
        weight: TextureId,
        /// What is blended.
        nested: [BsdfId; 2],
    },
    /// Bends the shading frame as if the surface were raised by a height field.
    BumpMap {
        /// Heights in scene units, over texture coordinates.
        texture: TextureId,
        /// Factor on the heights.
        scale: f32,
        /// How it bends.
        bend: Bend,
        /// What scatters on it.
        nested: BsdfId,
    },
    /// Bends the shading frame to a texture's normals.
    NormalMap {
        /// Normals in the space of the tangents and the normal; (−1..1)³ is stored as 0..1.
        normalmap: TextureId,
        /// How it bends.
        bend: Bend,
        /// What scatters on it.
        nested: BsdfId,
    },
}

impl Bsdf {
    /// The BSDFs that stand in it.
    pub fn nested(&self) -> Vec<BsdfId> {
        match *self {
            Bsdf::TwoSided { front, back } => vec![front, back],
            Bsdf::BlendBsdf { nested, .. } => nested.to_vec(),
            Bsdf::Mask { nested, .. } | Bsdf::BumpMap { nested, .. } | Bsdf::NormalMap { nested, .. } => vec![nested],
            _ => Vec::new(),
        }
    }

    /// The textures that it reads itself.
    pub fn textures(&self) -> Vec<TextureId> {
        match *self {
            Bsdf::Null | Bsdf::TwoSided { .. } => Vec::new(),
            Bsdf::Diffuse { reflectance: map }
            | Bsdf::Mask { opacity: map, .. }
            | Bsdf::BlendBsdf { weight: map, .. }
            | Bsdf::BumpMap { texture: map, .. }
            | Bsdf::NormalMap { normalmap: map, .. } => vec![map],
            Bsdf::Conductor { eta, k, specular_reflectance } => vec![eta, k, specular_reflectance],
            Bsdf::RoughConductor { alpha_u, alpha_v, eta, k, specular_reflectance, .. } => {
                vec![alpha_u, alpha_v, eta, k, specular_reflectance]
            }
            Bsdf::Dielectric { specular_reflectance, specular_transmittance, .. }
            | Bsdf::ThinDielectric { specular_reflectance, specular_transmittance, .. } => {
                vec![specular_reflectance, specular_transmittance]
            }
            Bsdf::RoughDielectric { alpha_u, alpha_v, specular_reflectance, specular_transmittance, .. } => {
                vec![alpha_u, alpha_v, specular_reflectance, specular_transmittance]
            }
            Bsdf::Phong { diffuse_reflectance, specular_reflectance, .. }
            | Bsdf::Plastic { diffuse_reflectance, specular_reflectance, .. }
            | Bsdf::RoughPlastic { diffuse_reflectance, specular_reflectance, .. } => {
                vec![diffuse_reflectance, specular_reflectance]
            }
            Bsdf::Principled {
                base_color,
                roughness,
                anisotropic,
                metallic,
                spec_trans,
                spec_tint,
                sheen,
                sheen_tint,
                flatness,
                clearcoat,
                clearcoat_gloss,
                ..
            } => {
                let base = [base_color, roughness, anisotropic, metallic, spec_trans, spec_tint];
                [&base[..], &[sheen, sheen_tint, flatness, clearcoat, clearcoat_gloss]].concat()
            }
            Bsdf::PrincipledThin {
                base_color,
                roughness,
                anisotropic,
                spec_trans,
                eta,
                spec_tint,
                sheen,
                sheen_tint,
                flatness,
                diff_trans,
            } => {
                let base = [base_color, roughness, anisotropic, spec_trans, eta, spec_tint];
                [&base[..], &[sheen, sheen_tint, flatness, diff_trans]].concat()
            }
        }
    }
}
