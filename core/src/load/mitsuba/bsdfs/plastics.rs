//! Diffuse bases under a coat, smooth or rough.

use super::{
    Build, DISTRIBUTION, EXT_IOR, Loader, Meaning, Parameter, Plugin, Properties, SAMPLE_VISIBLE, SPECULAR_REFLECTANCE,
    Takes, both_alphas, distribution, parameter, relative_ior,
};
use crate::load::error::Result;
use crate::scene::{Bsdf, BsdfId};

const INT_IOR: Parameter = parameter("int_ior", Takes::Ior("polypropylene"), "Index of refraction of the coat.");
const NONLINEAR: Parameter =
    parameter("nonlinear", Takes::Boolean(false), "The colour deepens by reflections inside the coat.");
const DIFFUSE_REFLECTANCE: Parameter =
    parameter("diffuse_reflectance", Takes::Texture(Some(0.5), Meaning::Reflectance), "Albedo of the base.");

pub(super) const PLUGINS: &[Plugin] = &[
    Plugin {
        name: "plastic",
        doc: "A diffuse base under a smooth coat.",
        parameters: &[DIFFUSE_REFLECTANCE, NONLINEAR, INT_IOR, EXT_IOR, SPECULAR_REFLECTANCE],
        build: Build::Bsdf(plastic),
    },
    Plugin {
        name: "roughplastic",
        doc: "A diffuse base under a rough coat.",
        parameters: &[
            DIFFUSE_REFLECTANCE,
            NONLINEAR,
            INT_IOR,
            EXT_IOR,
            DISTRIBUTION,
            parameter("alpha", Takes::Float(Some(0.1)), "Roughness of the coat, the same everywhere."),
            parameter("alpha_u", Takes::Float(None), "The same as alpha; alpha_v must be equal."),
            parameter("alpha_v", Takes::Float(None), "The same as alpha; alpha_u must be equal."),
            SAMPLE_VISIBLE,
            SPECULAR_REFLECTANCE,
        ],
        build: Build::Bsdf(roughplastic),
    },
];

fn plastic(loader: &mut Loader, properties: &Properties) -> Result<BsdfId> {
    let bsdf = Bsdf::Plastic {
        eta: relative_ior(properties)?,
        nonlinear: properties.boolean("nonlinear"),
        diffuse_reflectance: loader.texture(properties, "diffuse_reflectance")?,
        specular_reflectance: loader.texture(properties, "specular_reflectance")?,
    };
    Ok(loader.assembly.bsdf(bsdf))
}

fn roughplastic(loader: &mut Loader, properties: &Properties) -> Result<BsdfId> {
    let roughness = |name: &str| properties.float_in(name, 0.0..=f64::from(f32::MAX), "at least 0");
    let alpha = match both_alphas(properties)? {
        true if roughness("alpha_u")? != roughness("alpha_v")? => {
            return Err(properties.wrong("alpha_v", "'alpha_u' and 'alpha_v' of a rough plastic must be equal"));
        }
        true => roughness("alpha_u")?,
        false => roughness("alpha")?,
    };
    let bsdf = Bsdf::RoughPlastic {
        distribution: distribution(properties)?,
        alpha: alpha as f32,
        eta: relative_ior(properties)?,
        nonlinear: properties.boolean("nonlinear"),
        diffuse_reflectance: loader.texture(properties, "diffuse_reflectance")?,
        specular_reflectance: loader.texture(properties, "specular_reflectance")?,
    };
    Ok(loader.assembly.bsdf(bsdf))
}
