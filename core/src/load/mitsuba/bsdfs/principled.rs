//! Burley's models: solid and thin.

use super::{Build, Loader, Meaning, Parameter, Plugin, Properties, Takes, parameter, unmodelled};
use crate::load::error::Result;
use crate::scene::{Bsdf, BsdfId};

/// A factor of a model, by default absent.
const fn factor(name: &'static str, doc: &'static str) -> Parameter {
    parameter(name, Takes::Texture(Some(0.0), Meaning::Scalar), doc)
}

/// A weight of Mitsuba's choice among lobes.
const fn sampling_rate(name: &'static str) -> Parameter {
    unmodelled(name, Takes::Float(Some(1.0)), "tilecast chooses lobes by their strength")
}

const BASE_COLOR: Parameter = parameter("base_color", Takes::Texture(Some(0.5), Meaning::Reflectance), "Colour.");
const ROUGHNESS: Parameter =
    parameter("roughness", Takes::Texture(Some(0.5), Meaning::Scalar), "From smooth (0) to rough (1).");
const ANISOTROPIC: Parameter = factor("anisotropic", "From round to long highlights.");
const SPEC_TRANS: Parameter = factor("spec_trans", "From opaque to transparent.");
const SPEC_TINT: Parameter = factor("spec_tint", "How much of the base's colour the reflection has.");
const SHEEN: Parameter = factor("sheen", "Strength of the sheen.");
const SHEEN_TINT: Parameter = factor("sheen_tint", "How much of the base's colour the sheen has.");
const FLATNESS: Parameter = factor("flatness", "From diffuse to a subsurface look.");

pub(super) const PLUGINS: &[Plugin] = &[
    Plugin {
        name: "principled",
        doc: "Burley's model of metals, plastics and glass in one.",
        parameters: &[
            BASE_COLOR,
            ROUGHNESS,
            ANISOTROPIC,
            factor("metallic", "From dielectric to metal."),
            SPEC_TRANS,
            parameter("eta", Takes::Float(None), "Index of refraction inside over outside; or give specular."),
            parameter("specular", Takes::Float(Some(0.5)), "The same as a strength; 0.5 is an eta of 1.5."),
            SPEC_TINT,
            SHEEN,
            SHEEN_TINT,
            FLATNESS,
            factor("clearcoat", "Strength of the coat."),
            factor("clearcoat_gloss", "From a satin to a glossy coat."),
            sampling_rate("main_specular_sampling_rate"),
            sampling_rate("clearcoat_sampling_rate"),
            sampling_rate("diffuse_reflectance_sampling_rate"),
        ],
        build: Build::Bsdf(principled),
    },
    Plugin {
        name: "principledthin",
        doc: "Burley's model of thin sheets.",
        parameters: &[
            BASE_COLOR,
            ROUGHNESS,
            ANISOTROPIC,
            SPEC_TRANS,
            parameter("eta", Takes::Texture(Some(1.5), Meaning::Scalar), "Index of refraction inside over outside."),
            SPEC_TINT,
            SHEEN,
            SHEEN_TINT,
            FLATNESS,
            factor("diff_trans", "Diffuse light that goes through, from 0 (none) to 2 (all)."),
            sampling_rate("specular_reflectance_sampling_rate"),
            sampling_rate("specular_transmittance_sampling_rate"),
            sampling_rate("diffuse_reflectance_sampling_rate"),
            sampling_rate("diffuse_transmittance_sampling_rate"),
        ],
        build: Build::Bsdf(principledthin),
    },
];

fn principled(loader: &mut Loader, properties: &Properties) -> Result<BsdfId> {
    let eta = eta(properties)?;
    let mut texture = |name: &str| loader.texture(properties, name);
    let bsdf = Bsdf::Principled {
        base_color: texture("base_color")?,
        roughness: texture("roughness")?,
        anisotropic: texture("anisotropic")?,
        metallic: texture("metallic")?,
        spec_trans: texture("spec_trans")?,
        eta,
        spec_tint: texture("spec_tint")?,
        sheen: texture("sheen")?,
        sheen_tint: texture("sheen_tint")?,
        flatness: texture("flatness")?,
        clearcoat: texture("clearcoat")?,
        clearcoat_gloss: texture("clearcoat_gloss")?,
    };
    Ok(loader.assembly.bsdf(bsdf))
}

fn principledthin(loader: &mut Loader, properties: &Properties) -> Result<BsdfId> {
    let mut texture = |name: &str| loader.texture(properties, name);
    let bsdf = Bsdf::PrincipledThin {
        base_color: texture("base_color")?,
        roughness: texture("roughness")?,
        anisotropic: texture("anisotropic")?,
        spec_trans: texture("spec_trans")?,
        eta: texture("eta")?,
        spec_tint: texture("spec_tint")?,
        sheen: texture("sheen")?,
        sheen_tint: texture("sheen_tint")?,
        flatness: texture("flatness")?,
        diff_trans: texture("diff_trans")?,
    };
    Ok(loader.assembly.bsdf(bsdf))
}

/// The index of refraction, which `specular` gives as the reflection at normal incidence over 0.08 (Burley 2015, §5.3).
/// An interface that is none gets a very weak one, as in Mitsuba.
fn eta(properties: &Properties) -> Result<f32> {
    let eta = match (properties.get("eta"), properties.get("specular")) {
        (Some(_), Some(_)) => {
            return Err(properties.wrong("specular", "either 'eta' or 'specular' can be given, not both"));
        }
        (Some(_), None) => match properties.float_in("eta", f64::from(f32::MIN_POSITIVE).., "above 0")? {
            1.0 => 1.001,
            eta => eta,
        },
        (None, _) => {
            let specular = properties.float_in("specular", 0.0..12.5, "at least 0 and below 12.5")?;
            let specular = if specular == 0.0 { 1e-3 } else { specular };
            2.0 / (1.0 - (0.08 * specular).sqrt()) - 1.0
        }
    };
    Ok(eta as f32)
}
