//! Sensors with their films, filters and samplers.

use super::Loader;
use super::document::{ObjectId, Tag};
use super::plugins::{Build, Parameter, Plugin, Takes, child, parameter, unmodelled};
use super::properties::Properties;
use crate::load::error::Result;
use crate::load::placed::PlacedSensor;
use crate::scene::FovAxis;
use crate::settings::{FILM_SIDE_MAX, Film, Filter, Window};
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

pub(crate) const PLUGINS: &[Plugin] = &[
    Plugin {
        name: "perspective",
        doc: "A pinhole camera; it looks along +z of its own space, y up.",
        parameters: &[
            parameter("to_world", Takes::Transform, "Where it stands, without a scale."),
            parameter("fov", Takes::Float(None), "Field of view in degrees; or give focal_length."),
            parameter("fov_axis", Takes::Choice(&["x", "y", "diagonal", "smaller", "larger"]), "What fov measures."),
            parameter("focal_length", Takes::Text(Some("50mm")), "For a 35 mm film."),
            parameter("near_clip", Takes::Float(Some(0.01)), "Nearer surfaces are not seen."),
            parameter("far_clip", Takes::Float(Some(10000.0)), "Farther surfaces are not seen."),
            parameter("principal_point_offset_x", Takes::Float(Some(0.0)), "Shift, as a fraction of the width."),
            parameter("principal_point_offset_y", Takes::Float(Some(0.0)), "Shift, as a fraction of the height."),
            unmodelled("focus_distance", Takes::Float(None), "a pinhole has everything in focus"),
            unmodelled("shutter_open", Takes::Float(Some(0.0)), "nothing moves"),
            unmodelled("shutter_close", Takes::Float(Some(0.0)), "nothing moves"),
            child(Tag::Film, "Size and filter; by default an hdrfilm."),
            child(Tag::Sampler, "Samples a pixel; by default 4."),
        ],
        build: Build::Sensor(perspective),
    },
    Plugin {
        name: "hdrfilm",
        doc: "The size of the picture, and what of it is rendered.",
        parameters: &[
            parameter("width", Takes::Integer(Some(768)), "Pixels across."),
            parameter("height", Takes::Integer(Some(576)), "Pixels down."),
            parameter("crop_offset_x", Takes::Integer(Some(0)), "First column that is rendered."),
            parameter("crop_offset_y", Takes::Integer(Some(0)), "First row that is rendered."),
            parameter("crop_width", Takes::Integer(None), "Columns that are rendered; by default all."),
            parameter("crop_height", Takes::Integer(None), "Rows that are rendered; by default all."),
            child(Tag::Rfilter, "The pixel filter; by default gaussian."),
            unmodelled("file_format", Takes::Text(Some("openexr")), "tilecast writes OpenEXR"),
            unmodelled("pixel_format", Takes::Text(Some("rgb")), "tilecast writes R, G, B and their variance"),
            unmodelled("component_format", Takes::Text(Some("float16")), "tilecast writes 32-bit floats"),
            unmodelled("sample_border", Takes::Boolean(false), "every sample belongs to one pixel"),
            unmodelled("compensate", Takes::Boolean(false), "sums are exact"),
            unmodelled("banner", Takes::Boolean(false), "there is no banner"),
        ],
        build: Build::Film(hdrfilm),
    },
    Plugin {
        name: "box",
        doc: "Every sample of a pixel counts alike.",
        parameters: &[],
        build: Build::Rfilter(box_filter),
    },
    Plugin {
        name: "tent",
        doc: "Falls linearly to zero.",
        parameters: &[parameter("radius", Takes::Float(Some(1.0)), "Where it reaches zero, in pixels.")],
        build: Build::Rfilter(tent),
    },
    Plugin {
        name: "gaussian",
        doc: "A Gaussian cut at four standard deviations.",
        parameters: &[parameter("stddev", Takes::Float(Some(0.5)), "Standard deviation in pixels.")],
        build: Build::Rfilter(gaussian),
    },
    sampler("independent"),
    sampler("stratified"),
    sampler("multijitter"),
    sampler("orthogonal"),
    sampler("ldsampler"),
];

const SAMPLER_PARAMETERS: &[Parameter] = &[
    parameter("sample_count", Takes::Integer(Some(4)), "Samples a pixel."),
    unmodelled("seed", Takes::Integer(Some(0)), "give the seed when rendering"),
    unmodelled("jitter", Takes::Boolean(true), "tilecast has its own random numbers"),
    unmodelled("strength", Takes::Integer(Some(2)), "tilecast has its own random numbers"),
];

/// All of Mitsuba's samplers are one here: tilecast has its own numbers.
const fn sampler(name: &'static str) -> Plugin {
    Plugin {
        name,
        doc: "Samples a pixel; the numbers are tilecast's own whatever the kind.",
        parameters: SAMPLER_PARAMETERS,
        build: Build::Sampler(sample_count),
    }
}

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

    fn film_of(&mut self, film: Option<ObjectId>) -> Result<Film> {
        let Some(film) = film else {
            let crop = Window { x0: 0, y0: 0, x1: 768, y1: 576 };
            return Ok(Film { width: 768, height: 576, crop, filter: Filter::Gaussian { stddev: 0.5 } });
        };
        let properties = Properties::new(self.document, film, &mut self.assembly.notes)?;
        match properties.plugin.build {
            Build::Film(build) => build(self, &properties),
            _ => Err(super::misplaced(&properties)),
        }
    }

    fn samples(&mut self, sampler: ObjectId) -> Result<u32> {
        let document = self.document;
        let properties = Properties::new(document, sampler, &mut self.assembly.notes)?;
        match properties.plugin.build {
            Build::Sampler(build) => build(self, &properties),
            _ => Err(super::misplaced(&properties)),
        }
    }
}

/// What Mitsuba places before a scene without a sensor: at −z, so far that 45° take in the largest extent.
pub(crate) fn default_sensor(bounds: Option<(DVec3, DVec3)>) -> PlacedSensor {
    let (min, max) = bounds.unwrap_or((DVec3::splat(-1.0), DVec3::ONE));
    let (center, extent) = ((min + max) * 0.5, (max - min).max_element().max(f64::MIN_POSITIVE));
    let distance = extent / (2.0 * libm::tan(22.5f64.to_radians()));
    PlacedSensor {
        to_world: DAffine3::from_translation(DVec3::new(center.x, center.y, min.z - distance)),
        fov_degrees: 45.0,
        fov_axis: FovAxis::X,
        principal_point_offset: [0.0; 2],
        near_clip: distance / 100.0,
        far_clip: 5.0 * extent + distance,
    }
}

fn perspective(_: &mut Loader, properties: &Properties) -> Result<PlacedSensor> {
    let to_world = properties.transform("to_world")?;
    let axes = [to_world.matrix3.x_axis, to_world.matrix3.y_axis, to_world.matrix3.z_axis];
    if axes.iter().any(|axis| (axis.length() - 1.0).abs() > SCALE_TOLERANCE) {
        return Err(properties.wrong("to_world", "a camera cannot be scaled; take the <scale> out of its to_world"));
    }
    let (fov_degrees, fov_axis) = field_of_view(properties)?;
    let near_clip = properties.float_in("near_clip", f64::MIN_POSITIVE.., "above 0")?;
    let far_clip = properties.float("far_clip")?;
    if far_clip <= near_clip {
        let message = format!("'far_clip' is {far_clip}; it must be beyond near_clip, which is {near_clip}");
        return Err(properties.wrong("far_clip", message));
    }
    Ok(PlacedSensor {
        to_world,
        fov_degrees,
        fov_axis,
        principal_point_offset: [
            properties.float("principal_point_offset_x")?,
            properties.float("principal_point_offset_y")?,
        ],
        near_clip,
        far_clip,
    })
}

fn field_of_view(properties: &Properties) -> Result<(f64, FovAxis)> {
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

fn hdrfilm(loader: &mut Loader, properties: &Properties) -> Result<Film> {
    let side = |name: &str| {
        let pixels = properties.integer(name)?;
        u32::try_from(pixels).ok().filter(|side| (1..=FILM_SIDE_MAX).contains(side)).ok_or_else(|| {
            properties.wrong(name, format!("'{name}' is {pixels} pixels; it must be 1 to {FILM_SIDE_MAX}"))
        })
    };
    let (width, height) = (side("width")?, side("height")?);
    let range = |offset: &str, extent: &str, whole: u32| {
        let start = properties.count(offset, 0)?;
        let len = if properties.get(extent).is_some() { properties.count(extent, 1)? } else { whole };
        let end = start.checked_add(len).filter(|end| *end <= whole);
        let blamed = if properties.get(extent).is_some() { extent } else { offset };
        let message = || {
            format!(
                "the crop window begins at {start} and has {len} pixels, but the film has only {whole} here; make it \
                     smaller"
            )
        };
        end.map(|end| (start, end)).ok_or_else(|| properties.wrong(blamed, message()))
    };
    let (x0, x1) = range("crop_offset_x", "crop_width", width)?;
    let (y0, y1) = range("crop_offset_y", "crop_height", height)?;
    let filter = match properties.child(Tag::Rfilter)? {
        Some(id) => {
            let properties = Properties::new(loader.document, id, &mut loader.assembly.notes)?;
            match properties.plugin.build {
                Build::Rfilter(build) => build(&properties)?,
                _ => return Err(super::misplaced(&properties)),
            }
        }
        None => Filter::Gaussian { stddev: 0.5 },
    };
    Ok(Film { width, height, crop: Window { x0, y0, x1, y1 }, filter })
}

fn box_filter(_: &Properties) -> Result<Filter> {
    Ok(Filter::Box)
}

fn tent(properties: &Properties) -> Result<Filter> {
    let radius = properties.float("radius")? as f32;
    checked(properties, "radius", Filter::Tent { radius })
}

fn gaussian(properties: &Properties) -> Result<Filter> {
    let stddev = properties.float("stddev")? as f32;
    checked(properties, "stddev", Filter::Gaussian { stddev })
}

fn checked(properties: &Properties, name: &str, filter: Filter) -> Result<Filter> {
    let radius = filter.radius();
    match radius > 0.0 && radius <= crate::settings::FILTER_RADIUS_MAX {
        true => Ok(filter),
        false => {
            let message = format!(
                "'{name}' makes the filter reach {radius} pixels; it must be above 0 and at most {}",
                crate::settings::FILTER_RADIUS_MAX
            );
            Err(properties.wrong(name, message))
        }
    }
}

fn sample_count(loader: &mut Loader, properties: &Properties) -> Result<u32> {
    if properties.plugin.name != "independent" {
        let text = format!(
            "the sampler '{}' gives the number of samples; the numbers are tilecast's own",
            properties.plugin.name
        );
        loader.assembly.note(Some(loader.document.place(&properties.object.span)), text);
    }
    match properties.integer("sample_count")? {
        0 => Err(properties.wrong("sample_count", "0 samples a pixel make no picture; ask for at least 1")),
        _ => properties.count("sample_count", 1),
    }
}
