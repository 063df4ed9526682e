//! Emitters: lights with and without surfaces.

use super::Loader;
use super::document::{ObjectId, Tag};
use super::plugins::{Build, Meaning, Plugin, Takes, parameter, unmodelled};
use super::properties::Properties;
use crate::load::error::Result;
use crate::load::placed::PlacedEmitter;
use crate::scene::TextureId;
use glam::DVec3;

const SAMPLING_WEIGHT: super::Parameter =
    unmodelled("sampling_weight", Takes::Float(Some(1.0)), "tilecast chooses lights by their power");

pub(crate) const PLUGINS: &[Plugin] = &[
    Plugin {
        name: "area",
        doc: "Makes the shape it stands in shine, to the side its normal points to.",
        parameters: &[
            parameter("radiance", Takes::Texture(Some(1.0), Meaning::Emission), "Radiance."),
            SAMPLING_WEIGHT,
        ],
        build: Build::AreaLight(area),
    },
    Plugin {
        name: "constant",
        doc: "The same radiance from everywhere beyond the scene.",
        parameters: &[parameter("radiance", Takes::Colour(1.0, Meaning::Emission), "Radiance."), SAMPLING_WEIGHT],
        build: Build::Emitter(constant),
    },
    Plugin {
        name: "point",
        doc: "A point that shines alike in all directions.",
        parameters: &[
            parameter("position", Takes::Vector(None), "Where it is; or give to_world."),
            parameter("to_world", Takes::Transform, "Takes (0, 0, 0) to where it is."),
            parameter("intensity", Takes::Colour(1.0, Meaning::Emission), "Radiant intensity."),
            SAMPLING_WEIGHT,
        ],
        build: Build::Emitter(point),
    },
    Plugin {
        name: "directional",
        doc: "Parallel light.",
        parameters: &[
            parameter("direction", Takes::Vector(None), "Where the light travels to; or give to_world."),
            parameter("to_world", Takes::Transform, "Takes (0, 0, 1) to where the light travels to."),
            parameter("irradiance", Takes::Colour(1.0, Meaning::Emission), "Power through a unit area across it."),
            SAMPLING_WEIGHT,
        ],
        build: Build::Emitter(directional),
    },
];

impl Loader<'_> {
    /// The emitters that stand directly in the scene.
    pub fn emitters(&mut self, found: &[ObjectId]) -> Result<()> {
        let document = self.document;
        let mut sky = None;
        for &id in found {
            let object = document.object(id);
            if self.lit.contains_key(&id) {
                continue;
            }
            let mut notes = Vec::new();
            let properties = Properties::new(document, id, &mut notes)?;
            let Build::Emitter(build) = properties.plugin.build else { continue };
            self.made.insert(id);
            self.assembly.notes.append(&mut notes);
            let emitter = build(self, &properties)?;
            if matches!(emitter, PlacedEmitter::Constant { .. }) && sky.replace(id).is_some() {
                return Err(
                    document.error(&object.span, "a scene can have only one light from beyond it; keep one of them")
                );
            }
            self.assembly.emitters.push(emitter);
        }
        Ok(())
    }

    /// The radiance of the area light that stands in a shape.
    pub fn area_light(&mut self, light: ObjectId, shape: &Properties) -> Result<TextureId> {
        let document = self.document;
        let properties = Properties::new(document, light, &mut self.assembly.notes)?;
        let Build::AreaLight(build) = properties.plugin.build else {
            let message =
                format!("an emitter of type '{}' cannot stand in a shape; only 'area' can", properties.plugin.name);
            return Err(document.error(&properties.object.span, message));
        };
        if self.lit.insert(light, shape.id).is_some() {
            let message = format!("{} stands in two shapes; give each its own", properties.object.describe());
            let span = shape.children(Tag::Emitter).next().map_or(&shape.object.span, |(_, span)| span);
            return Err(document.error(span, message));
        }
        self.made.insert(light);
        build(self, &properties)
    }
}

fn area(loader: &mut Loader, properties: &Properties) -> Result<TextureId> {
    loader.texture(properties, "radiance")
}

fn constant(loader: &mut Loader, properties: &Properties) -> Result<PlacedEmitter> {
    Ok(PlacedEmitter::Constant { radiance: loader.colour(properties, "radiance")?.as_vec3() })
}

fn point(loader: &mut Loader, properties: &Properties) -> Result<PlacedEmitter> {
    let position = match one_of(properties, "position")? {
        true => properties.vector("position")?,
        false => properties.transform("to_world")?.translation,
    };
    Ok(PlacedEmitter::Point { position, intensity: loader.colour(properties, "intensity")?.as_vec3() })
}

fn directional(loader: &mut Loader, properties: &Properties) -> Result<PlacedEmitter> {
    let direction = match one_of(properties, "direction")? {
        true => properties.vector("direction")?,
        false => properties.transform("to_world")?.matrix3 * DVec3::Z,
    };
    if !direction.is_finite() || direction.try_normalize().is_none() {
        return Err(properties.wrong("direction", "'direction' must not be zero"));
    }
    Ok(PlacedEmitter::Directional { direction, irradiance: loader.colour(properties, "irradiance")?.as_vec3() })
}

/// Whether the parameter is given; it excludes `to_world`.
fn one_of(properties: &Properties, name: &str) -> Result<bool> {
    match (properties.get(name), properties.get("to_world")) {
        (Some(_), Some(_)) => {
            Err(properties.wrong(name, format!("either '{name}' or 'to_world' can be given, not both")))
        }
        (given, _) => Ok(given.is_some()),
    }
}
