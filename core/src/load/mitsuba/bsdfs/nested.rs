//! BSDFs that change or join others, and the one that does nothing.

use super::{Build, Loader, Meaning, Parameter, Plugin, Properties, Takes, inner, parameter};
use crate::load::error::Result;
use crate::load::mitsuba::document::Tag;
use crate::load::mitsuba::plugins::child;
use crate::scene::{Bend, Bsdf, BsdfId};

const FLIP_INVALID_NORMALS: Parameter = parameter(
    "flip_invalid_normals",
    Takes::Boolean(true),
    "Turn normals that point away from the viewer until they do not.",
);
const USE_SHADOWING_FUNCTION: Parameter =
    parameter("use_shadowing_function", Takes::Boolean(true), "Dim light near the horizon of the bent surface.");
const BENT: Parameter = child(Tag::Bsdf, "What scatters on it.");

pub(super) const PLUGINS: &[Plugin] = &[
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
    Plugin { name: "null", doc: "Nothing: light goes straight through.", parameters: &[], build: Build::Bsdf(null) },
    Plugin {
        name: "blendbsdf",
        doc: "Joins two BSDFs.",
        parameters: &[
            parameter("weight", Takes::Texture(None, Meaning::Scalar), "0 is the first, 1 is the second."),
            child(Tag::Bsdf, "The two."),
        ],
        build: Build::Bsdf(blendbsdf),
    },
    Plugin {
        name: "bumpmap",
        doc: "Shades as if a texture of heights raised the surface.",
        parameters: &[
            child(Tag::Texture, "The heights, in scene units."),
            parameter("scale", Takes::Float(Some(1.0)), "Factor on the heights."),
            FLIP_INVALID_NORMALS,
            USE_SHADOWING_FUNCTION,
            BENT,
        ],
        build: Build::Bsdf(bumpmap),
    },
    Plugin {
        name: "normalmap",
        doc: "Shades with the normals of a texture.",
        parameters: &[
            parameter(
                "normalmap",
                Takes::Texture(None, Meaning::Reflectance),
                "Normals as colours: 0.5 is 0; a bitmap of them should be raw.",
            ),
            FLIP_INVALID_NORMALS,
            USE_SHADOWING_FUNCTION,
            BENT,
        ],
        build: Build::Bsdf(normalmap),
    },
];

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
    let nested = inner(loader, properties)?;
    Ok(loader.assembly.bsdf(Bsdf::Mask { opacity, nested }))
}

fn null(loader: &mut Loader, _: &Properties) -> Result<BsdfId> {
    Ok(loader.assembly.bsdf(Bsdf::Null))
}

fn blendbsdf(loader: &mut Loader, properties: &Properties) -> Result<BsdfId> {
    let nested: Vec<_> = properties.children(Tag::Bsdf).collect();
    let [(first, _), (second, _)] = nested.as_slice() else {
        let span = nested.get(2).map_or(&properties.object.span, |(_, span)| span);
        return Err(properties.error(span, format!("'blendbsdf' holds two BSDFs, not {}", nested.len())));
    };
    let weight = loader.texture(properties, "weight")?;
    let nested = [loader.bsdf(*first)?, loader.bsdf(*second)?];
    Ok(loader.assembly.bsdf(Bsdf::BlendBsdf { weight, nested }))
}

fn bumpmap(loader: &mut Loader, properties: &Properties) -> Result<BsdfId> {
    let Some(heights) = properties.child(Tag::Texture)? else {
        return Err(properties.error(&properties.object.span, "'bumpmap' needs a texture in it: the heights"));
    };
    let texture = loader.texture_object(heights, Meaning::Scalar)?;
    let largest = f64::from(f32::MAX);
    let scale = properties.float_in("scale", -largest..=largest, "a 32-bit number")? as f32;
    let nested = bent(loader, properties)?;
    Ok(loader.assembly.bsdf(Bsdf::BumpMap { texture, scale, bend: bend(properties), nested }))
}

fn normalmap(loader: &mut Loader, properties: &Properties) -> Result<BsdfId> {
    let normalmap = loader.texture(properties, "normalmap")?;
    let nested = bent(loader, properties)?;
    Ok(loader.assembly.bsdf(Bsdf::NormalMap { normalmap, bend: bend(properties), nested }))
}

fn bend(properties: &Properties) -> Bend {
    Bend {
        flip_invalid_normals: properties.boolean("flip_invalid_normals"),
        use_shadowing_function: properties.boolean("use_shadowing_function"),
    }
}

/// What a map is put on: one frame is all that a surface has, so in it there is no other map.
fn bent(loader: &mut Loader, properties: &Properties) -> Result<BsdfId> {
    let nested = inner(loader, properties)?;
    match loader.bends(nested) {
        false => Ok(nested),
        true => {
            let span = properties.children(Tag::Bsdf).next().map_or(&properties.object.span, |(_, span)| span);
            let message = "a bump or normal map cannot stand in another; join the two into one texture";
            Err(properties.error(span, message))
        }
    }
}
