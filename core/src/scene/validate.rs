//! The one check of a whole scene: indices in range, numbers finite, nothing nested in a circle.

use super::{Bsdf, BsdfId, Emitter, Geometry, Image, Mesh, Scene, Sensor, Texels, Texture, TextureId};
use glam::{Affine3, Mat3, Vec3};

/// What is wrong with a scene that a file or the wire described.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SceneError {
    /// An index points behind the end of its list, or a nested object comes after the one that nests it.
    #[error("{what} refers to {list} {index}, but only {len} of them can be referred to there")]
    Index {
        /// The object that refers.
        what: String,
        /// The list referred to.
        list: &'static str,
        /// The index.
        index: u32,
        /// One more than the largest allowed.
        len: usize,
    },
    /// A number is not finite or outside its range.
    #[error("{what}: {problem}")]
    Value {
        /// The object.
        what: String,
        /// What is the matter, and what would be allowed.
        problem: String,
    },
}

impl Scene {
    /// Checks everything that the tracer relies on.
    ///
    /// # Errors
    /// The first index out of range or number that is not finite or not in its range.
    pub fn validate(&self) -> Result<(), SceneError> {
        self.validate_sensor()?;
        for (i, mesh) in self.meshes.iter().enumerate() {
            mesh.validate(&format!("mesh {i}"))?;
        }
        for (i, image) in self.images.iter().enumerate() {
            image.validate(&format!("image {i}"))?;
        }
        for (i, texture) in self.textures.iter().enumerate() {
            self.validate_texture(i, texture)?;
        }
        let mut bent = Vec::with_capacity(self.bsdfs.len());
        for (i, bsdf) in self.bsdfs.iter().enumerate() {
            self.validate_bsdf(i, bsdf)?;
            bent.push(bends(&format!("bsdf {i}"), bsdf, &bent)?);
        }
        for (i, emitter) in self.emitters.iter().enumerate() {
            self.validate_emitter(&format!("emitter {i}"), emitter)?;
        }
        let background = |e: &&Emitter| matches!(e, Emitter::Constant { .. } | Emitter::Envmap { .. });
        check(self.emitters.iter().filter(background).count() < 2, || {
            value("scene", "it has more than one background (constant, envmap), there must be at most one")
        })?;
        for shape in &self.shapes {
            let what = format!("shape '{}'", shape.name);
            index(&what, "bsdf", shape.bsdf.0, self.bsdfs.len())?;
            if let Some(radiance) = shape.radiance {
                index(&what, "texture", radiance.0, self.textures.len())?;
            }
            match &shape.geometry {
                Geometry::Mesh(id) => index(&what, "mesh", id.0, self.meshes.len())?,
                Geometry::Sphere { to_world, .. }
                | Geometry::Disk { to_world, .. }
                | Geometry::Cylinder { to_world, .. } => invertible(&what, to_world)?,
            }
        }
        check(self.origin.iter().all(|x| x.is_finite()), || value("scene", "its origin is not finite"))
    }

    fn validate_sensor(&self) -> Result<(), SceneError> {
        let (to_world, near_clip, far_clip) = match &self.sensor {
            Sensor::Perspective {
                to_world, fov_degrees, principal_point_offset, near_clip, far_clip, lens, ..
            } => {
                check(*fov_degrees > 0.0 && *fov_degrees < 180.0, || {
                    value(
                        "sensor",
                        format!("the field of view is {fov_degrees} degrees, it must lie between 0 and 180"),
                    )
                })?;
                check(principal_point_offset.iter().all(|x| x.is_finite()), || {
                    value("sensor", "the principal point's offset is not finite")
                })?;
                let positive = |x: f32| x > 0.0 && x.is_finite();
                check(lens.is_none_or(|l| positive(l.aperture_radius) && positive(l.focus_distance)), || {
                    value("sensor", "aperture_radius and focus_distance must be above zero and finite")
                })?;
                (to_world, near_clip, far_clip)
            }
            Sensor::Orthographic { to_world, near_clip, far_clip } => (to_world, near_clip, far_clip),
        };
        invertible("sensor", to_world)?;
        check(*near_clip > 0.0 && *near_clip < *far_clip, || {
            value("sensor", format!("near_clip {near_clip} and far_clip {far_clip} must satisfy 0 < near < far"))
        })
    }

    fn validate_emitter(&self, what: &str, emitter: &Emitter) -> Result<(), SceneError> {
        match emitter {
            Emitter::Constant { radiance } => finite(what, *radiance),
            Emitter::Envmap { image, scale, to_world } => {
                index(what, "image", image.0, self.images.len())?;
                let image = &self.images[image.0 as usize];
                check(image.width >= 2 && image.height >= 3, || {
                    value(what, format!("its image has {}×{} pixels, 2×3 are the least", image.width, image.height))
                })?;
                check(scale.is_finite() && *scale >= 0.0, || value(what, "its scale is negative or not finite"))?;
                // Directions are only turned: what a scale would mean is nowhere defined.
                let off = (*to_world * to_world.transpose() - Mat3::IDENTITY).to_cols_array();
                check(off.iter().all(|x| x.abs() < 1e-4), || value(what, "its to_world must be a rotation"))
            }
            Emitter::Point { position, intensity } => {
                finite(what, *position)?;
                finite(what, *intensity)
            }
            Emitter::Spot { to_world, intensity, cutoff_degrees, beam_width_degrees, texture } => {
                invertible(what, to_world)?;
                finite(what, *intensity)?;
                texture.iter().try_for_each(|id| index(what, "texture", id.0, self.textures.len()))?;
                let ordered = 0.0 <= *beam_width_degrees && beam_width_degrees <= cutoff_degrees;
                check(ordered && *cutoff_degrees > 0.0 && *cutoff_degrees < 90.0, || {
                    value(
                        what,
                        "its angles must satisfy 0 ≤ beam_width ≤ cutoff_angle and 0 < cutoff_angle < 90 degrees",
                    )
                })
            }
            Emitter::Projector { to_world, irradiance, scale, half_extent } => {
                invertible(what, to_world)?;
                index(what, "texture", irradiance.0, self.textures.len())?;
                check(scale.is_finite() && half_extent.iter().all(|&x| x > 0.0 && x.is_finite()), || {
                    value(what, "its scale must be finite and its extent above zero")
                })
            }
            Emitter::Directional { direction, irradiance } => {
                finite(what, *direction)?;
                finite(what, *irradiance)
            }
        }
    }

    fn validate_texture(&self, i: usize, texture: &Texture) -> Result<(), SceneError> {
        let what = format!("texture {i}");
        match texture {
            Texture::Constant(rgb) => finite(&what, *rgb),
            Texture::Checkerboard { color0, color1, to_uv } => {
                index(&what, "texture", color0.0, i)?;
                index(&what, "texture", color1.0, i)?;
                check(to_uv.is_finite(), || value(&what, "to_uv is not finite"))
            }
            Texture::Bitmap { image, to_uv, scale, .. } => {
                index(&what, "image", image.0, self.images.len())?;
                check(to_uv.is_finite() && scale.is_finite(), || value(&what, "to_uv or scale is not finite"))
            }
        }
    }

    fn validate_bsdf(&self, i: usize, bsdf: &Bsdf) -> Result<(), SceneError> {
        let what = format!("bsdf {i}");
        let texture = |id: &TextureId| index(&what, "texture", id.0, self.textures.len());
        let nested = |id: &BsdfId| index(&what, "bsdf", id.0, i);
        match bsdf {
            Bsdf::Diffuse { reflectance } => texture(reflectance),
            Bsdf::Conductor { eta, k, specular_reflectance } => {
                [eta, k, specular_reflectance].into_iter().try_for_each(texture)
            }
            Bsdf::Dielectric { eta, specular_reflectance, specular_transmittance }
            | Bsdf::ThinDielectric { eta, specular_reflectance, specular_transmittance } => {
                refractive_index(&what, *eta)?;
                [specular_reflectance, specular_transmittance].into_iter().try_for_each(texture)
            }
            Bsdf::Phong { diffuse_reflectance, specular_reflectance, exponent } => {
                check(exponent.is_finite() && *exponent >= 0.0, || {
                    value(&what, format!("the exponent is {exponent}, it must not be negative"))
                })?;
                [diffuse_reflectance, specular_reflectance].into_iter().try_for_each(texture)
            }
            Bsdf::RoughConductor { alpha_u, alpha_v, eta, k, specular_reflectance, .. } => {
                [alpha_u, alpha_v, eta, k, specular_reflectance].into_iter().try_for_each(texture)
            }
            Bsdf::RoughDielectric { alpha_u, alpha_v, eta, specular_reflectance, specular_transmittance, .. } => {
                refractive_index(&what, *eta)?;
                [alpha_u, alpha_v, specular_reflectance, specular_transmittance].into_iter().try_for_each(texture)
            }
            Bsdf::Plastic { eta, diffuse_reflectance, specular_reflectance, .. } => {
                refractive_index(&what, *eta)?;
                [diffuse_reflectance, specular_reflectance].into_iter().try_for_each(texture)
            }
            Bsdf::RoughPlastic { alpha, eta, diffuse_reflectance, specular_reflectance, .. } => {
                check(alpha.is_finite(), || value(&what, "the roughness is not finite"))?;
                refractive_index(&what, *eta)?;
                [diffuse_reflectance, specular_reflectance].into_iter().try_for_each(texture)
            }
            Bsdf::Principled { .. } | Bsdf::PrincipledThin { .. } => self.validate_principled(&what, bsdf),
            Bsdf::Null => Ok(()),
            Bsdf::TwoSided { front, back } => [front, back].into_iter().try_for_each(nested),
            Bsdf::BlendBsdf { weight, nested: both } => {
                texture(weight)?;
                both.iter().try_for_each(nested)
            }
            Bsdf::Mask { opacity: map, nested: inner } | Bsdf::NormalMap { normalmap: map, nested: inner, .. } => {
                texture(map)?;
                nested(inner)
            }
            Bsdf::BumpMap { texture: heights, scale, nested: inner, .. } => {
                check(scale.is_finite(), || value(&what, "its scale is not finite"))?;
                texture(heights)?;
                nested(inner)
            }
        }
    }

    fn validate_principled(&self, what: &str, bsdf: &Bsdf) -> Result<(), SceneError> {
        let texture = |id: &TextureId| index(what, "texture", id.0, self.textures.len());
        match bsdf {
            Bsdf::Principled {
                base_color,
                roughness,
                anisotropic,
                metallic,
                spec_trans,
                eta,
                spec_tint,
                sheen,
                sheen_tint,
                flatness,
                clearcoat,
                clearcoat_gloss,
            } => {
                refractive_index(what, *eta)?;
                [base_color, roughness, anisotropic, metallic, spec_trans, spec_tint]
                    .into_iter()
                    .try_for_each(texture)?;
                [sheen, sheen_tint, flatness, clearcoat, clearcoat_gloss].into_iter().try_for_each(texture)
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
                [base_color, roughness, anisotropic, spec_trans, eta].into_iter().try_for_each(texture)?;
                [spec_tint, sheen, sheen_tint, flatness, diff_trans].into_iter().try_for_each(texture)
            }
            _ => Ok(()),
        }
    }
}

/// Whether a bump or normal map is in it, given the same of those before it. Two in a row would need a frame each.
fn bends(what: &str, bsdf: &Bsdf, bent: &[bool]) -> Result<bool, SceneError> {
    let inner = |id: &BsdfId| bent[id.0 as usize];
    match bsdf {
        Bsdf::BumpMap { nested, .. } | Bsdf::NormalMap { nested, .. } => {
            check(!inner(nested), || value(what, "a bump or normal map cannot be nested in another"))?;
            Ok(true)
        }
        Bsdf::Mask { nested, .. } => Ok(inner(nested)),
        Bsdf::TwoSided { front, back } => Ok(inner(front) || inner(back)),
        Bsdf::BlendBsdf { nested, .. } => Ok(nested.iter().any(inner)),
        _ => Ok(false),
    }
}

fn refractive_index(what: &str, eta: f32) -> Result<(), SceneError> {
    check(eta.is_finite() && eta > 0.0, || {
        value(what, format!("the relative index of refraction is {eta}, it must be positive"))
    })
}

impl Mesh {
    fn validate(&self, what: &str) -> Result<(), SceneError> {
        let vertices = self.positions.len();
        for (list, len) in [("normals", self.normals.len()), ("uvs", self.uvs.len())] {
            check(len == 0 || len == vertices, || {
                value(what, format!("it has {len} {list} for {vertices} positions, there must be none or one each"))
            })?;
        }
        if let Some(&i) = self.triangles.iter().flatten().find(|&&i| i as usize >= vertices) {
            return Err(SceneError::Index { what: what.into(), list: "vertex", index: i, len: vertices });
        }
        let numbers = self.positions.iter().chain(&self.normals).all(|v| v.is_finite());
        check(numbers && self.uvs.iter().all(|v| v.is_finite()), || {
            value(what, "a position, normal or texture coordinate is not finite")
        })
    }
}

impl Image {
    fn validate(&self, what: &str) -> Result<(), SceneError> {
        let pixels = self.width as usize * self.height as usize;
        let (values, expected) = match &self.texels {
            Texels::Grey8 { data, .. } => (data.len(), pixels),
            Texels::Rgb8 { data, .. } => (data.len(), 3 * pixels),
            Texels::Grey32(data) => (data.len(), pixels),
            Texels::Rgb32(data) => (data.len(), 3 * pixels),
        };
        check(pixels > 0 && values == expected, || {
            value(what, format!("{}×{} pixels need {expected} values, it has {values}", self.width, self.height))
        })?;
        let finite = match &self.texels {
            Texels::Grey8 { .. } | Texels::Rgb8 { .. } => true,
            Texels::Grey32(data) | Texels::Rgb32(data) => data.iter().all(|x| x.is_finite()),
        };
        check(finite, || value(what, "a pixel is not finite"))
    }
}

fn index(what: &str, list: &'static str, index: u32, len: usize) -> Result<(), SceneError> {
    check((index as usize) < len, || SceneError::Index { what: what.into(), list, index, len })
}

fn finite(what: &str, v: Vec3) -> Result<(), SceneError> {
    check(v.is_finite(), || value(what, "a value is not finite"))
}

fn invertible(what: &str, to_world: &Affine3) -> Result<(), SceneError> {
    let determinant = to_world.matrix3.determinant();
    check(to_world.is_finite() && determinant.is_finite() && determinant != 0.0, || {
        value(what, "its to_world transform is singular or not finite")
    })
}

fn value(what: &str, problem: impl Into<String>) -> SceneError {
    SceneError::Value { what: what.into(), problem: problem.into() }
}

fn check(holds: bool, error: impl FnOnce() -> SceneError) -> Result<(), SceneError> {
    if holds { Ok(()) } else { Err(error()) }
}
