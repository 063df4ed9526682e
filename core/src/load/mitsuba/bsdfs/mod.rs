//! BSDFs: how surfaces scatter light. Here is what all share; one file a kind holds its rows and makes it.

mod dielectrics;
mod metals;
mod nested;
mod plastics;
mod principled;

use super::Loader;
use super::document::{ObjectId, Tag};
use super::materials::DIELECTRICS;
use super::plugins::{Build, Meaning, Parameter, Plugin, Takes, parameter, unmodelled};
use super::properties::Properties;
use crate::load::error::{Result, did_you_mean};
use crate::scene::{Bsdf, BsdfId, Distribution, Texture, TextureId};
use glam::{DVec3, Vec3};
use std::collections::HashSet;

/// The rows of all kinds.
pub(crate) const PLUGINS: [&[Plugin]; 6] =
    [DIFFUSE, metals::PLUGINS, dielectrics::PLUGINS, plastics::PLUGINS, principled::PLUGINS, nested::PLUGINS];

const DIFFUSE: &[Plugin] = &[Plugin {
    name: "diffuse",
    doc: "Lambert's: reflects alike in all directions.",
    parameters: &[parameter("reflectance", Takes::Texture(Some(0.5), Meaning::Reflectance), "Albedo.")],
    build: Build::Bsdf(diffuse),
}];

const SPECULAR_REFLECTANCE: Parameter =
    parameter("specular_reflectance", Takes::Texture(Some(1.0), Meaning::Reflectance), "Factor on the reflection.");
const EXT_IOR: Parameter =
    parameter("ext_ior", Takes::Ior("air"), "Index of refraction outside, where the normal points to.");
const DISTRIBUTION: Parameter =
    parameter("distribution", Takes::Choice(&["beckmann", "ggx"]), "Of the facets that make it rough.");
const ALPHA: Parameter =
    parameter("alpha", Takes::Texture(Some(0.1), Meaning::Scalar), "Roughness; or give alpha_u and alpha_v.");
const ALPHA_U: Parameter =
    parameter("alpha_u", Takes::Texture(None, Meaning::Scalar), "Roughness along the first tangent.");
const ALPHA_V: Parameter = parameter("alpha_v", Takes::Texture(None, Meaning::Scalar), "Roughness along the second.");
const SAMPLE_VISIBLE: Parameter =
    unmodelled("sample_visible", Takes::Boolean(true), "only facets that can be seen are sampled");

impl Loader<'_> {
    /// The BSDF that an object describes, made once.
    pub fn bsdf(&mut self, id: ObjectId) -> Result<BsdfId> {
        if let Some(known) = self.bsdfs.get(&id) {
            return Ok(*known);
        }
        let document = self.document;
        let properties = Properties::new(document, id, &mut self.assembly.notes)?;
        let bsdf = match properties.plugin.build {
            Build::Bsdf(build) => build(self, &properties)?,
            _ => return Err(super::misplaced(&properties)),
        };
        self.made.insert(id);
        self.bsdfs.insert(id, bsdf);
        Ok(bsdf)
    }

    /// What a shape is made of that names nothing: grey, or black if it shines.
    pub fn default_bsdf(&mut self, shines: bool) -> BsdfId {
        let reflectance = self.assembly.constant(DVec3::splat(if shines { 0.0 } else { 0.5 }));
        self.assembly.bsdf(Bsdf::Diffuse { reflectance })
    }

    /// Roughness along both tangents; the same texture twice where they do not differ.
    fn roughness(&mut self, properties: &Properties) -> Result<(TextureId, TextureId)> {
        match both_alphas(properties)? {
            true => Ok((self.texture(properties, "alpha_u")?, self.texture(properties, "alpha_v")?)),
            false => self.texture(properties, "alpha").map(|alpha| (alpha, alpha)),
        }
    }

    /// Whether light goes through a BSDF, or through one that it nests.
    fn transmits(&self, id: BsdfId) -> bool {
        self.any_within(id, |bsdf| match bsdf {
            Bsdf::Dielectric { .. }
            | Bsdf::RoughDielectric { .. }
            | Bsdf::ThinDielectric { .. }
            | Bsdf::PrincipledThin { .. }
            | Bsdf::Mask { .. }
            | Bsdf::Null => true,
            Bsdf::Principled { spec_trans, .. } => {
                !matches!(self.assembly.texture_of(*spec_trans), Some(Texture::Constant(Vec3::ZERO)))
            }
            _ => false,
        })
    }

    /// Whether a BSDF, or one that it nests, bends the shading frame.
    fn bends(&self, id: BsdfId) -> bool {
        self.any_within(id, |bsdf| matches!(bsdf, Bsdf::BumpMap { .. } | Bsdf::NormalMap { .. }))
    }

    fn any_within(&self, id: BsdfId, test: impl Fn(&Bsdf) -> bool) -> bool {
        let (mut pending, mut seen) = (vec![id], HashSet::new());
        while let Some(id) = pending.pop() {
            let Some(bsdf) = self.assembly.bsdf_of(id).filter(|_| seen.insert(id)) else { continue };
            if test(bsdf) {
                return true;
            }
            match bsdf {
                Bsdf::TwoSided { front, back } => pending.extend([*front, *back]),
                Bsdf::BlendBsdf { nested, .. } => pending.extend(nested),
                Bsdf::Mask { nested, .. } | Bsdf::BumpMap { nested, .. } | Bsdf::NormalMap { nested, .. } => {
                    pending.push(*nested);
                }
                _ => {}
            }
        }
        false
    }
}

fn diffuse(loader: &mut Loader, properties: &Properties) -> Result<BsdfId> {
    let reflectance = loader.texture(properties, "reflectance")?;
    Ok(loader.assembly.bsdf(Bsdf::Diffuse { reflectance }))
}

/// Whether both `alpha_u` and `alpha_v` are given.
///
/// # Errors
/// One without the other, or `alpha` beside them.
fn both_alphas(properties: &Properties) -> Result<bool> {
    let given = |name: &str| properties.get(name).is_some();
    match (given("alpha"), given("alpha_u"), given("alpha_v")) {
        (_, false, false) => Ok(false),
        (false, true, true) => Ok(true),
        (true, ..) => {
            Err(properties.wrong("alpha", "either 'alpha' or 'alpha_u' and 'alpha_v' can be given, not both"))
        }
        (false, true, false) => Err(properties.wrong("alpha_u", "'alpha_u' needs 'alpha_v' beside it")),
        (false, false, true) => Err(properties.wrong("alpha_v", "'alpha_v' needs 'alpha_u' beside it")),
    }
}

fn distribution(properties: &Properties) -> Result<Distribution> {
    Ok([Distribution::Beckmann, Distribution::Ggx][properties.choice("distribution")?])
}

/// The index of refraction inside over that outside.
fn relative_ior(properties: &Properties) -> Result<f32> {
    Ok((ior(properties, "int_ior")? / ior(properties, "ext_ior")?) as f32)
}

/// An index of refraction, by number or by name.
fn ior(properties: &Properties, name: &str) -> Result<f64> {
    let by_name = |material: &str| {
        let wanted = material.to_ascii_lowercase();
        DIELECTRICS.iter().find(|(known, _)| *known == wanted).map(|(_, ior)| *ior).ok_or_else(|| {
            let names = || DIELECTRICS.iter().map(|(name, _)| *name);
            let list: Vec<&str> = names().collect();
            let hint = did_you_mean(material, names());
            properties.wrong(name, format!("no material is called '{material}'{hint}; there are {}", list.join(", ")))
        })
    };
    match (properties.get(name), properties.text(name), properties.takes(name)) {
        (Some(_), Some(material), _) => by_name(material),
        (Some(_), None, _) => properties.float_in(name, f64::MIN_POSITIVE.., "above 0"),
        (None, _, Takes::Ior(default)) => by_name(default),
        _ => Ok(1.0),
    }
}

/// The one BSDF that must stand in another.
fn inner(loader: &mut Loader, properties: &Properties) -> Result<BsdfId> {
    match properties.child(Tag::Bsdf)? {
        Some(nested) => loader.bsdf(nested),
        None => {
            let message = format!("'{}' needs a BSDF in it, for what it changes", properties.plugin.name);
            Err(properties.error(&properties.object.span, message))
        }
    }
}
