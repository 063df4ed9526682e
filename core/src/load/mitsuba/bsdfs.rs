//! BSDFs: how surfaces scatter light.

use super::Loader;
use super::document::{ObjectId, Tag};
use super::materials::{CONDUCTORS, DIELECTRICS};
use super::plugins::{Build, Meaning, Plugin, Takes, child, parameter};
use super::properties::Properties;
use crate::load::error::{Result, did_you_mean};
use crate::scene::{Bsdf, BsdfId};
use glam::DVec3;
use std::collections::HashSet;

pub(crate) const PLUGINS: &[Plugin] = &[
    Plugin {
        name: "diffuse",
        doc: "Lambert's: reflects alike in all directions.",
        parameters: &[parameter("reflectance", Takes::Texture(Some(0.5), Meaning::Reflectance), "Albedo.")],
        build: Build::Bsdf(diffuse),
    },
    Plugin {
        name: "conductor",
        doc: "A smooth metal.",
        parameters: &[
            parameter("material", Takes::Text(Some("none")), "A metal by name, such as Au; none is a perfect mirror."),
            parameter("eta", Takes::Texture(Some(0.0), Meaning::Unbounded), "Index of refraction, real part."),
            parameter("k", Takes::Texture(Some(1.0), Meaning::Unbounded), "Imaginary part, the absorption."),
            parameter(
                "specular_reflectance",
                Takes::Texture(Some(1.0), Meaning::Reflectance),
                "Factor on the reflection.",
            ),
        ],
        build: Build::Bsdf(conductor),
    },
    Plugin {
        name: "dielectric",
        doc: "A smooth surface between two transparent materials.",
        parameters: &[
            parameter("int_ior", Takes::Ior("bk7"), "Index of refraction inside."),
            parameter("ext_ior", Takes::Ior("air"), "Index of refraction outside, where the normal points to."),
            parameter(
                "specular_reflectance",
                Takes::Texture(Some(1.0), Meaning::Reflectance),
                "Factor on the reflection.",
            ),
            parameter(
                "specular_transmittance",
                Takes::Texture(Some(1.0), Meaning::Reflectance),
                "Factor on the transmission.",
            ),
        ],
        build: Build::Bsdf(dielectric),
    },
    Plugin {
        name: "twosided",
        doc: "Gives an opaque BSDF a back side: the same, or a second one.",
        parameters: &[child(Tag::Bsdf, "The front's; a second one is the back's.")],
        build: Build::Bsdf(twosided),
    },
    Plugin {
        name: "mask",
        doc: "Lets some of the light straight through.",
        parameters: &[
            parameter("opacity", Takes::Texture(Some(0.5), Meaning::Scalar), "0 is invisible, 1 is solid."),
            child(Tag::Bsdf, "What scatters the rest."),
        ],
        build: Build::Bsdf(mask),
    },
];

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
}

fn diffuse(loader: &mut Loader, properties: &Properties) -> Result<BsdfId> {
    let reflectance = loader.texture(properties, "reflectance")?;
    Ok(loader.assembly.bsdf(Bsdf::Diffuse { reflectance }))
}

fn conductor(loader: &mut Loader, properties: &Properties) -> Result<BsdfId> {
    let material = properties.text("material").unwrap_or("none");
    let (eta, k) = if material == "none" {
        (loader.texture(properties, "eta")?, loader.texture(properties, "k")?)
    } else if properties.get("eta").or(properties.get("k")).is_some() {
        return Err(properties.wrong("material", "either 'material' or 'eta' and 'k' can be given, not both"));
    } else {
        let Some((_, eta, k)) = CONDUCTORS.iter().find(|(name, ..)| *name == material) else {
            let names = CONDUCTORS.iter().map(|(name, ..)| *name);
            let hint = did_you_mean(material, names);
            let message = format!("no conductor is called '{material}'{hint}; there are Ag, Al, Au, Cr, Cu and others");
            return Err(properties.wrong("material", message));
        };
        (loader.assembly.constant((*eta).into()), loader.assembly.constant((*k).into()))
    };
    let specular_reflectance = loader.texture(properties, "specular_reflectance")?;
    Ok(loader.assembly.bsdf(Bsdf::Conductor { eta, k, specular_reflectance }))
}

fn dielectric(loader: &mut Loader, properties: &Properties) -> Result<BsdfId> {
    let eta = (ior(properties, "int_ior")? / ior(properties, "ext_ior")?) as f32;
    let specular_reflectance = loader.texture(properties, "specular_reflectance")?;
    let specular_transmittance = loader.texture(properties, "specular_transmittance")?;
    Ok(loader.assembly.bsdf(Bsdf::Dielectric { eta, specular_reflectance, specular_transmittance }))
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

fn twosided(loader: &mut Loader, properties: &Properties) -> Result<BsdfId> {
    let nested: Vec<_> = properties.children(Tag::Bsdf).collect();
    let (front, back) = match nested.as_slice() {
        [(one, _)] => (*one, *one),
        [(front, _), (back, _)] => (*front, *back),
        list => {
            let span = list.get(2).map_or(&properties.object.span, |(_, span)| span);
            return Err(properties.error(span, format!("'twosided' holds one BSDF or two, not {}", list.len())));
        }
    };
    let (front, back) = (loader.bsdf(front)?, loader.bsdf(back)?);
    for (id, (_, span)) in [front, back].into_iter().zip(nested) {
        if loader.transmits(id) {
            let message = "'twosided' holds only BSDFs that no light goes through; take this one out of it";
            return Err(properties.error(span, message));
        }
    }
    Ok(loader.assembly.bsdf(Bsdf::TwoSided { front, back }))
}

fn mask(loader: &mut Loader, properties: &Properties) -> Result<BsdfId> {
    let opacity = loader.texture(properties, "opacity")?;
    let Some(nested) = properties.child(Tag::Bsdf)? else {
        return Err(
            properties.error(&properties.object.span, "'mask' needs a BSDF in it, for what it does not let through")
        );
    };
    let nested = loader.bsdf(nested)?;
    Ok(loader.assembly.bsdf(Bsdf::Mask { opacity, nested }))
}

impl Loader<'_> {
    /// Whether light goes through a BSDF, or through one that it nests.
    fn transmits(&self, id: BsdfId) -> bool {
        let (mut pending, mut seen) = (vec![id], HashSet::new());
        while let Some(id) = pending.pop() {
            if !seen.insert(id) {
                continue;
            }
            match self.assembly.bsdf_of(id) {
                Some(
                    Bsdf::Dielectric { .. }
                    | Bsdf::RoughDielectric { .. }
                    | Bsdf::ThinDielectric { .. }
                    | Bsdf::PrincipledThin { .. }
                    | Bsdf::Mask { .. }
                    | Bsdf::Null,
                ) => return true,
                Some(Bsdf::BlendBsdf { nested, .. }) => pending.extend(nested),
                Some(Bsdf::BumpMap { nested, .. } | Bsdf::NormalMap { nested, .. }) => pending.push(*nested),
                Some(_) | None => {}
            }
        }
        false
    }
}
