//! Interfaces between transparent materials: smooth, rough, and a pane as one sheet.

use super::{
    ALPHA, ALPHA_U, ALPHA_V, Build, DISTRIBUTION, EXT_IOR, Loader, Meaning, Parameter, Plugin, Properties,
    SAMPLE_VISIBLE, SPECULAR_REFLECTANCE, Takes, distribution, parameter, relative_ior,
};
use crate::load::error::Result;
use crate::scene::{Bsdf, BsdfId};

const INT_IOR: Parameter = parameter("int_ior", Takes::Ior("bk7"), "Index of refraction inside.");
const SPECULAR_TRANSMITTANCE: Parameter =
    parameter("specular_transmittance", Takes::Texture(Some(1.0), Meaning::Reflectance), "Factor on the transmission.");

pub(super) const PLUGINS: &[Plugin] = &[
    Plugin {
        name: "dielectric",
        doc: "A smooth surface between two transparent materials.",
        parameters: &[INT_IOR, EXT_IOR, SPECULAR_REFLECTANCE, SPECULAR_TRANSMITTANCE],
        build: Build::Bsdf(dielectric),
    },
    Plugin {
        name: "roughdielectric",
        doc: "A rough surface between two transparent materials.",
        parameters: &[
            INT_IOR,
            EXT_IOR,
            DISTRIBUTION,
            ALPHA,
            ALPHA_U,
            ALPHA_V,
            SAMPLE_VISIBLE,
            SPECULAR_REFLECTANCE,
            SPECULAR_TRANSMITTANCE,
        ],
        build: Build::Bsdf(roughdielectric),
    },
    Plugin {
        name: "thindielectric",
        doc: "A pane of glass as one sheet: light passes straight.",
        parameters: &[INT_IOR, EXT_IOR, SPECULAR_REFLECTANCE, SPECULAR_TRANSMITTANCE],
        build: Build::Bsdf(thindielectric),
    },
];

fn dielectric(loader: &mut Loader, properties: &Properties) -> Result<BsdfId> {
    let eta = relative_ior(properties)?;
    let specular_reflectance = loader.texture(properties, "specular_reflectance")?;
    let specular_transmittance = loader.texture(properties, "specular_transmittance")?;
    Ok(loader.assembly.bsdf(Bsdf::Dielectric { eta, specular_reflectance, specular_transmittance }))
}

fn thindielectric(loader: &mut Loader, properties: &Properties) -> Result<BsdfId> {
    let eta = relative_ior(properties)?;
    let specular_reflectance = loader.texture(properties, "specular_reflectance")?;
    let specular_transmittance = loader.texture(properties, "specular_transmittance")?;
    Ok(loader.assembly.bsdf(Bsdf::ThinDielectric { eta, specular_reflectance, specular_transmittance }))
}

fn roughdielectric(loader: &mut Loader, properties: &Properties) -> Result<BsdfId> {
    let eta = relative_ior(properties)?;
    let (alpha_u, alpha_v) = loader.roughness(properties)?;
    let bsdf = Bsdf::RoughDielectric {
        distribution: distribution(properties)?,
        alpha_u,
        alpha_v,
        eta,
        specular_reflectance: loader.texture(properties, "specular_reflectance")?,
        specular_transmittance: loader.texture(properties, "specular_transmittance")?,
    };
    Ok(loader.assembly.bsdf(bsdf))
}
