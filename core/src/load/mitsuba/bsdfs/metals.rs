//! Metals, smooth and rough.

use super::{
    ALPHA, ALPHA_U, ALPHA_V, Build, DISTRIBUTION, Loader, Meaning, Parameter, Plugin, Properties, SAMPLE_VISIBLE,
    SPECULAR_REFLECTANCE, Takes, distribution, parameter,
};
use crate::load::error::{Result, did_you_mean};
use crate::load::mitsuba::materials::CONDUCTORS;
use crate::scene::{Bsdf, BsdfId, TextureId};

const MATERIAL: Parameter =
    parameter("material", Takes::Text(Some("none")), "A metal by name, such as Au; none is a perfect mirror.");
const ETA: Parameter =
    parameter("eta", Takes::Texture(Some(0.0), Meaning::Unbounded), "Index of refraction, real part.");
const K: Parameter = parameter("k", Takes::Texture(Some(1.0), Meaning::Unbounded), "Imaginary part, the absorption.");

pub(super) const PLUGINS: &[Plugin] = &[
    Plugin {
        name: "conductor",
        doc: "A smooth metal.",
        parameters: &[MATERIAL, ETA, K, SPECULAR_REFLECTANCE],
        build: Build::Bsdf(conductor),
    },
    Plugin {
        name: "roughconductor",
        doc: "A rough metal.",
        parameters: &[MATERIAL, ETA, K, DISTRIBUTION, ALPHA, ALPHA_U, ALPHA_V, SAMPLE_VISIBLE, SPECULAR_REFLECTANCE],
        build: Build::Bsdf(roughconductor),
    },
];

fn conductor(loader: &mut Loader, properties: &Properties) -> Result<BsdfId> {
    let (eta, k) = indices(loader, properties)?;
    let specular_reflectance = loader.texture(properties, "specular_reflectance")?;
    Ok(loader.assembly.bsdf(Bsdf::Conductor { eta, k, specular_reflectance }))
}

fn roughconductor(loader: &mut Loader, properties: &Properties) -> Result<BsdfId> {
    let (eta, k) = indices(loader, properties)?;
    let (alpha_u, alpha_v) = loader.roughness(properties)?;
    let specular_reflectance = loader.texture(properties, "specular_reflectance")?;
    let distribution = distribution(properties)?;
    Ok(loader.assembly.bsdf(Bsdf::RoughConductor { distribution, alpha_u, alpha_v, eta, k, specular_reflectance }))
}

/// The complex index of refraction, by name or by numbers.
fn indices(loader: &mut Loader, properties: &Properties) -> Result<(TextureId, TextureId)> {
    let material = properties.text("material").unwrap_or("none");
    if material == "none" {
        return Ok((loader.texture(properties, "eta")?, loader.texture(properties, "k")?));
    }
    if properties.get("eta").or(properties.get("k")).is_some() {
        return Err(properties.wrong("material", "either 'material' or 'eta' and 'k' can be given, not both"));
    }
    let Some((_, eta, k)) = CONDUCTORS.iter().find(|(name, ..)| *name == material) else {
        let hint = did_you_mean(material, CONDUCTORS.iter().map(|(name, ..)| *name));
        let message = format!("no conductor is called '{material}'{hint}; there are Ag, Al, Au, Cr, Cu and others");
        return Err(properties.wrong("material", message));
    };
    Ok((loader.assembly.constant((*eta).into()), loader.assembly.constant((*k).into())))
}
