//! Emitters: lights with and without surfaces.

use super::Loader;
use super::document::{ObjectId, Tag};
use super::plugins::{Build, Meaning, Plugin, Takes, parameter, unmodelled};
use super::properties::Properties;
use super::sensors::{FOCAL_LENGTH, FOV, FOV_AXIS, field_of_view};
use super::shapes::is_similarity;
use crate::load::error::Result;
use crate::load::image;
use crate::load::placed::PlacedEmitter;
use crate::scene::TextureId;
use glam::{DAffine3, DMat3, DVec3};

const SAMPLING_WEIGHT: super::Parameter =
    unmodelled("sampling_weight", Takes::Float(Some(1.0)), "tilecast chooses lights by their power");

const TO_WORLD: super::Parameter =
    parameter("to_world", Takes::Transform, "Where it stands and points to; a scale alike along all axes is ignored.");

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
        name: "envmap",
        doc: "Radiance from an image around the scene.",
        parameters: &[
            parameter("filename", Takes::File, "The image: longitude across, +y at the top."),
            parameter("scale", Takes::Float(Some(1.0)), "Factor on the image."),
            parameter("to_world", Takes::Transform, "Turns it."),
            unmodelled("mis_compensation", Takes::Boolean(false), "directions are sampled by brightness alone"),
            SAMPLING_WEIGHT,
        ],
        build: Build::Emitter(envmap),
    },
    Plugin {
        name: "spot",
        doc: "A point that shines into a cone around +z of its own space.",
        parameters: &[
            TO_WORLD,
            parameter("intensity", Takes::Colour(1.0, Meaning::Emission), "Radiant intensity on the axis."),
            parameter("cutoff_angle", Takes::Float(Some(20.0)), "Degrees from the axis at which it ends."),
            parameter(
                "beam_width",
                Takes::Float(None),
                "Degrees up to which it is constant; by default 3/4 of it all.",
            ),
            parameter("texture", Takes::Texture(None, Meaning::Unbounded), "A factor over the square around the cone."),
            SAMPLING_WEIGHT,
        ],
        build: Build::Emitter(spot),
    },
    Plugin {
        name: "projector",
        doc: "A point that throws an image along +z of its own space.",
        parameters: &[
            TO_WORLD,
            parameter("irradiance", Takes::Texture(Some(1.0), Meaning::Unbounded), "The image."),
            parameter("scale", Takes::Float(Some(1.0)), "Factor on the image."),
            FOV,
            FOV_AXIS,
            FOCAL_LENGTH,
            SAMPLING_WEIGHT,
        ],
        build: Build::Emitter(projector),
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
            let around = matches!(emitter, PlacedEmitter::Constant { .. } | PlacedEmitter::Envmap { .. });
            if around && sky.replace(id).is_some() {
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

fn envmap(loader: &mut Loader, properties: &Properties) -> Result<PlacedEmitter> {
    let (name, span) = properties.file("filename")?;
    let path = loader.locate(name, span)?;
    let usage = image::Use { raw: false, scalar: false };
    let image = loader.assembly.image(path, usage, loader.document.place(span));
    Ok(PlacedEmitter::Envmap { image, scale: scale(properties)?, to_world: rigid(properties)?.matrix3 })
}

fn spot(loader: &mut Loader, properties: &Properties) -> Result<PlacedEmitter> {
    let cutoff = properties.float_in("cutoff_angle", f64::from(f32::MIN_POSITIVE)..90.0, "above 0 and below 90")?;
    let beam_width = match properties.get("beam_width") {
        Some(_) => properties.float_in("beam_width", 0.0..=cutoff, &format!("0 to cutoff_angle, {cutoff}"))?,
        None => 0.75 * cutoff,
    };
    let texture = properties.get("texture").map(|_| loader.texture(properties, "texture")).transpose()?;
    Ok(PlacedEmitter::Spot {
        to_world: rigid(properties)?,
        intensity: loader.colour(properties, "intensity")?.as_vec3(),
        cutoff_degrees: cutoff as f32,
        beam_width_degrees: beam_width as f32,
        texture,
    })
}

fn projector(loader: &mut Loader, properties: &Properties) -> Result<PlacedEmitter> {
    let (fov_degrees, fov_axis) = field_of_view(properties)?;
    let irradiance = loader.texture(properties, "irradiance")?;
    Ok(PlacedEmitter::Projector {
        to_world: rigid(properties)?,
        irradiance,
        scale: scale(properties)?,
        fov_degrees: fov_degrees as f32,
        fov_axis,
    })
}

fn scale(properties: &Properties) -> Result<f32> {
    properties.float_in("scale", 0.0..=f64::from(f32::MAX), "at least 0").map(|scale| scale as f32)
}

/// `to_world` without its scale.
fn rigid(properties: &Properties) -> Result<DAffine3> {
    let to_world = properties.transform("to_world")?;
    if !is_similarity(&to_world) {
        return Err(properties.wrong("to_world", "this light cannot be sheared, nor scaled along one axis alone"));
    }
    let m = to_world.matrix3;
    let matrix3 = DMat3::from_cols(m.x_axis.normalize(), m.y_axis.normalize(), m.z_axis.normalize());
    Ok(DAffine3 { matrix3, translation: to_world.translation })
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
