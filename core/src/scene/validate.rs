//! The one check of a whole scene: indices in range, numbers finite, nothing nested in a circle.

use super::{Attribute, Bsdf, BsdfId, Emitter, Geometry, Image, Mesh, Scene, Sensor, Texels, Texture, TextureId};
use glam::{Affine3, Mat3, Vec3};
use std::collections::BTreeSet;

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
        for shape in self.levels().flatten() {
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
        self.validate_instances()?;
        self.validate_attributes()?;
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
            Texture::MeshAttribute { scale, .. } => {
                check(scale.is_finite(), || value(&what, "its scale is not finite"))
            }
        }
    }

    fn validate_bsdf(&self, i: usize, bsdf: &Bsdf) -> Result<(), SceneError> {
        let what = format!("bsdf {i}");
        bsdf.textures().iter().try_for_each(|id| index(&what, "texture", id.0, self.textures.len()))?;
        bsdf.nested().iter().try_for_each(|id| index(&what, "bsdf", id.0, i))?;
        match bsdf {
            Bsdf::Dielectric { eta, .. }
            | Bsdf::ThinDielectric { eta, .. }
            | Bsdf::RoughDielectric { eta, .. }
            | Bsdf::Plastic { eta, .. }
            | Bsdf::Principled { eta, .. } => refractive_index(&what, *eta),
            Bsdf::RoughPlastic { alpha, eta, .. } => {
                check(alpha.is_finite(), || value(&what, "the roughness is not finite"))?;
                refractive_index(&what, *eta)
            }
            Bsdf::Phong { exponent, .. } => check(exponent.is_finite() && *exponent >= 0.0, || {
                value(&what, format!("the exponent is {exponent}, it must not be negative"))
            }),
            Bsdf::BumpMap { scale, .. } => check(scale.is_finite(), || value(&what, "its scale is not finite")),
            _ => Ok(()),
        }
    }

    fn validate_instances(&self) -> Result<(), SceneError> {
        for shape in self.groups.iter().flat_map(|group| &group.shapes) {
            check(shape.radiance.is_none(), || {
                value(&format!("shape '{}'", shape.name), "it stands in a group and emits; a light has one place")
            })?;
        }
        for (i, instance) in self.instances.iter().enumerate() {
            let what = format!("instance {i}");
            index(&what, "group", instance.group.0, self.groups.len())?;
            invertible(&what, &instance.to_world)?;
        }
        Ok(())
    }

    /// Whether each mesh has the attributes that the textures on it show.
    fn validate_attributes(&self) -> Result<(), SceneError> {
        let mut of_textures: Vec<BTreeSet<&str>> = Vec::with_capacity(self.textures.len());
        for texture in &self.textures {
            let of = |id: &TextureId| of_textures[id.0 as usize].iter().copied();
            of_textures.push(match texture {
                Texture::Constant(_) | Texture::Bitmap { .. } => BTreeSet::new(),
                Texture::Checkerboard { color0, color1, .. } => of(color0).chain(of(color1)).collect(),
                Texture::MeshAttribute { name, .. } => BTreeSet::from([name.as_str()]),
            });
        }
        let of_texture = |id: TextureId| of_textures[id.0 as usize].iter().copied();
        let mut of_bsdfs: Vec<BTreeSet<&str>> = Vec::with_capacity(self.bsdfs.len());
        for bsdf in &self.bsdfs {
            let nested = bsdf.nested().into_iter().flat_map(|id| of_bsdfs[id.0 as usize].iter().copied());
            of_bsdfs.push(nested.chain(bsdf.textures().into_iter().flat_map(of_texture)).collect());
        }
        for shape in self.levels().flatten() {
            let of_bsdf = of_bsdfs[shape.bsdf.0 as usize].iter().copied();
            for name in of_bsdf.chain(shape.radiance.into_iter().flat_map(of_texture)) {
                let has = match shape.geometry {
                    Geometry::Mesh(id) => self.meshes[id.0 as usize].attributes.iter().any(|a| a.name == name),
                    _ => false,
                };
                check(has, || {
                    let problem = format!("a texture on it shows the attribute '{name}', which it does not have");
                    value(&format!("shape '{}'", shape.name), problem)
                })?;
            }
        }
        Ok(())
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
        })?;
        self.attributes.iter().try_for_each(|attribute| self.validate_attribute(what, attribute))
    }

    fn validate_attribute(&self, what: &str, attribute: &Attribute) -> Result<(), SceneError> {
        let Attribute { name, values } = attribute;
        let expected = match attribute.is_on_faces() {
            true => self.triangles.len(),
            false => self.positions.len(),
        };
        check(attribute.is_on_faces() || name.starts_with(Attribute::AT_VERTICES), || {
            value(what, format!("its attribute '{name}' begins neither with vertex_ nor with face_"))
        })?;
        check(values.len() == expected, || {
            value(what, format!("its attribute '{name}' has {} values, there must be {expected}", values.len()))
        })?;
        let finite = (0..values.len()).all(|i| values.at(i).is_finite());
        check(finite, || value(what, format!("a value of its attribute '{name}' is not finite")))
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
