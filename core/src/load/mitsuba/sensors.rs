//! Sensors: where a picture is taken from, and how its rays spread.

use super::Loader;
use super::document::{ObjectId, Tag};
use super::plugins::{Build, Parameter, Plugin, Takes, child, parameter, unmodelled};
use super::properties::Properties;
use crate::load::error::Result;
use crate::load::placed::{PlacedSensor, Projection};
use crate::scene::{FovAxis, Lens};
use crate::settings::Film;
use glam::{DAffine3, DVec3};

/// A sensor with what its film and sampler say.
pub(crate) struct View {
    pub film: Film,
    pub spp: u32,
    /// None if the scene has none: then it is placed by the scene's bounds.
    pub sensor: Option<PlacedSensor>,
}

/// The diagonal of a 35 mm film, 36 × 24 mm, which focal lengths refer to.
const FILM_DIAGONAL_MM: f64 = 43.266615305567875;
/// Deviation from unit length at which a camera's axis counts as scaled, as in Mitsuba.
const SCALE_TOLERANCE: f64 = 1e-3;
const FOV_AXES: [FovAxis; 5] = [FovAxis::X, FovAxis::Y, FovAxis::Diagonal, FovAxis::Smaller, FovAxis::Larger];

const TO_WORLD: Parameter = parameter("to_world", Takes::Transform, "Where it stands, without a scale.");
pub(super) const FOV: Parameter =
    parameter("fov", Takes::Float(None), "Field of view in degrees; or give focal_length.");
pub(super) const FOV_AXIS: Parameter =
    parameter("fov_axis", Takes::Choice(&["x", "y", "diagonal", "smaller", "larger"]), "What fov measures.");
pub(super) const FOCAL_LENGTH: Parameter = parameter("focal_length", Takes::Text(Some("50mm")), "For a 35 mm film.");
const NEAR_CLIP: Parameter = parameter("near_clip", Takes::Float(Some(0.01)), "Nearer surfaces are not seen.");
const FAR_CLIP: Parameter = parameter("far_clip", Takes::Float(Some(10000.0)), "Farther surfaces are not seen.");
const OFFSET_X: Parameter =
    parameter("principal_point_offset_x", Takes::Float(Some(0.0)), "Shift, as a fraction of the width.");
const OFFSET_Y: Parameter =
    parameter("principal_point_offset_y", Takes::Float(Some(0.0)), "Shift, as a fraction of the height.");
const SHUTTER_OPEN: Parameter = unmodelled("shutter_open", Takes::Float(Some(0.0)), "nothing moves");
const SHUTTER_CLOSE: Parameter = unmodelled("shutter_close", Takes::Float(Some(0.0)), "nothing moves");
const FILM: Parameter = child(Tag::Film, "Size and filter; by default an hdrfilm.");
const SAMPLER: Parameter = child(Tag::Sampler, "Samples a pixel; by default 4.");

pub(crate) const PLUGINS: &[Plugin] = &[
    Plugin {
        name: "perspective",
        doc: "A pinhole camera; it looks along +z of its own space, y up.",
        parameters: &[
            TO_WORLD,
            FOV,
            FOV_AXIS,
            FOCAL_LENGTH,
            NEAR_CLIP,
            FAR_CLIP,
            OFFSET_X,
            OFFSET_Y,
            unmodelled("focus_distance", Takes::Float(None), "a pinhole has everything in focus"),
            SHUTTER_OPEN,
            SHUTTER_CLOSE,
            FILM,
            SAMPLER,
        ],
        build: Build::Sensor(perspective),
    },
    Plugin {
        name: "thinlens",
        doc: "A camera with a lens: what is not in focus is blurred.",
        parameters: &[
            TO_WORLD,
            FOV,
            FOV_AXIS,
            FOCAL_LENGTH,
            parameter("aperture_radius", Takes::Float(None), "Of the lens, in scene units."),
            parameter("focus_distance", Takes::Float(None), "Of the plane in focus; by default far_clip."),
            NEAR_CLIP,
            FAR_CLIP,
            OFFSET_X,
            OFFSET_Y,
            SHUTTER_OPEN,
            SHUTTER_CLOSE,
            FILM,
            SAMPLER,
        ],
        build: Build::Sensor(thinlens),
    },
    Plugin {
        name: "orthographic",
        doc: "Parallel rays along +z: the film's width spans x from -1 to 1.",
        parameters: &[
            parameter("to_world", Takes::Transform, "Where it stands; its scale is that of the picture."),
            NEAR_CLIP,
            FAR_CLIP,
            unmodelled("focus_distance", Takes::Float(None), "parallel rays have everything in focus"),
            SHUTTER_OPEN,
            SHUTTER_CLOSE,
            FILM,
            SAMPLER,
        ],
        build: Build::Sensor(orthographic),
    },
];

impl Loader<'_> {
    /// The scene's first sensor with film and sampler.
    pub fn sensor(&mut self, found: &[ObjectId]) -> Result<View> {
        let document = self.document;
        let Some((&id, others)) = found.split_first() else {
            self.assembly.note(None, "the scene has no sensor; a camera that sees all of it is used");
            let film = self.film_of(None)?;
            return Ok(View { film, spp: 4, sensor: None });
        };
        if !others.is_empty() {
            let place = document.place(&document.object(others[0]).span);
            self.assembly.note(Some(place), "only the scene's first sensor is used");
        }
        self.made.insert(id);
        let properties = Properties::new(document, id, &mut self.assembly.notes)?;
        let sensor = match properties.plugin.build {
            Build::Sensor(build) => build(self, &properties)?,
            _ => return Err(super::misplaced(&properties)),
        };
        let film = self.film_of(properties.child(Tag::Film)?)?;
        let spp = match properties.child(Tag::Sampler)? {
            Some(sampler) => self.samples(sampler)?,
            None => 4,
        };
        Ok(View { film, spp, sensor: Some(sensor) })
    }
}

/// What Mitsuba places before a scene without a sensor: at −z, so far that 45° take in the largest extent.
pub(crate) fn default_sensor(bounds: Option<(DVec3, DVec3)>) -> PlacedSensor {
    let (min, max) = bounds.unwrap_or((DVec3::splat(-1.0), DVec3::ONE));
    let (center, extent) = ((min + max) * 0.5, (max - min).max_element().max(f64::MIN_POSITIVE));
    let distance = extent / (2.0 * libm::tan(22.5f64.to_radians()));
    PlacedSensor {
        to_world: DAffine3::from_translation(DVec3::new(center.x, center.y, min.z - distance)),
        projection: Projection::Perspective {
            fov_degrees: 45.0,
            fov_axis: FovAxis::X,
            principal_point_offset: [0.0; 2],
            lens: None,
        },
        near_clip: distance / 100.0,
        far_clip: 5.0 * extent + distance,
    }
}

fn perspective(_: &mut Loader, properties: &Properties) -> Result<PlacedSensor> {
    pinhole_or_lens(properties, None)
}

fn thinlens(_: &mut Loader, properties: &Properties) -> Result<PlacedSensor> {
    let positive = |name: &str| properties.float_in(name, f64::from(f32::MIN_POSITIVE).., "above 0");
    let aperture_radius = positive("aperture_radius")? as f32;
    let focus = if properties.get("focus_distance").is_some() { "focus_distance" } else { "far_clip" };
    let lens = Lens { aperture_radius, focus_distance: positive(focus)? as f32 };
    pinhole_or_lens(properties, Some(lens))
}

fn pinhole_or_lens(properties: &Properties, lens: Option<Lens>) -> Result<PlacedSensor> {
    let to_world = properties.transform("to_world")?;
    let axes = [to_world.matrix3.x_axis, to_world.matrix3.y_axis, to_world.matrix3.z_axis];
    if axes.iter().any(|axis| (axis.length() - 1.0).abs() > SCALE_TOLERANCE) {
        return Err(properties.wrong("to_world", "a camera cannot be scaled; take the <scale> out of its to_world"));
    }
    let (fov_degrees, fov_axis) = field_of_view(properties)?;
    let principal_point_offset =
        [properties.float("principal_point_offset_x")?, properties.float("principal_point_offset_y")?];
    let projection = Projection::Perspective { fov_degrees, fov_axis, principal_point_offset, lens };
    let (near_clip, far_clip) = clips(properties)?;
    Ok(PlacedSensor { to_world, projection, near_clip, far_clip })
}

fn orthographic(_: &mut Loader, properties: &Properties) -> Result<PlacedSensor> {
    let to_world = properties.transform("to_world")?;
    let (near_clip, far_clip) = clips(properties)?;
    Ok(PlacedSensor { to_world, projection: Projection::Orthographic, near_clip, far_clip })
}

fn clips(properties: &Properties) -> Result<(f64, f64)> {
    let near_clip = properties.float_in("near_clip", f64::MIN_POSITIVE.., "above 0")?;
    let far_clip = properties.float("far_clip")?;
    if far_clip <= near_clip {
        let message = format!("'far_clip' is {far_clip}; it must be beyond near_clip, which is {near_clip}");
        return Err(properties.wrong("far_clip", message));
    }
    Ok((near_clip, far_clip))
}

/// The field of view in degrees, and what it measures.
pub(super) fn field_of_view(properties: &Properties) -> Result<(f64, FovAxis)> {
    let within = |name: &str, fov: f64| match fov > 0.0 && fov < 180.0 {
        true => Ok(fov),
        false => Err(properties.wrong(name, format!("the field of view is {fov}°; it must lie between 0 and 180"))),
    };
    match (properties.get("fov"), properties.get("focal_length")) {
        (Some(_), Some(_)) => {
            Err(properties.wrong("focal_length", "either 'fov' or 'focal_length' can be given, not both"))
        }
        (Some(_), None) => Ok((within("fov", properties.float("fov")?)?, FOV_AXES[properties.choice("fov_axis")?])),
        (None, _) => {
            let text = properties.text("focal_length").unwrap_or("50mm");
            let millimetres = super::values::number(text.trim().trim_end_matches("mm"));
            let wrong =
                |_| properties.wrong("focal_length", format!("'{text}' is no focal length; write one such as 50mm"));
            let fov = 2.0 * libm::atan(FILM_DIAGONAL_MM / (2.0 * millimetres.map_err(wrong)?)).to_degrees();
            Ok((within("focal_length", fov)?, FovAxis::Diagonal))
        }
    }
}
