//! Films, pixel filters and samplers: the size of a picture and its samples.

use super::Loader;
use super::document::{ObjectId, Tag};
use super::plugins::{Build, Parameter, Plugin, Takes, child, parameter, unmodelled};
use super::properties::Properties;
use crate::load::error::Result;
use crate::settings::{FILM_SIDE_MAX, FILTER_RADIUS_MAX, Film, Filter, Window};

pub(crate) const PLUGINS: &[Plugin] = &[
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
    Plugin {
        name: "mitchell",
        doc: "Mitchell and Netravali's cubics, radius 2; partly negative.",
        parameters: &[
            parameter("B", Takes::Float(Some(1.0 / 3.0)), "Blur."),
            parameter("C", Takes::Float(Some(1.0 / 3.0)), "Ringing."),
        ],
        build: Build::Rfilter(mitchell),
    },
    Plugin {
        name: "catmullrom",
        doc: "The cubic that interpolates, radius 2; partly negative.",
        parameters: &[],
        build: Build::Rfilter(catmullrom),
    },
    Plugin {
        name: "lanczos",
        doc: "A windowed sinc; partly negative.",
        parameters: &[parameter("lobes", Takes::Integer(Some(3)), "Lobes on each side, and the radius.")],
        build: Build::Rfilter(lanczos),
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
    /// A sensor's film; without one, Mitsuba's.
    pub fn film_of(&mut self, film: Option<ObjectId>) -> Result<Film> {
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

    /// A sampler's samples a pixel.
    pub fn samples(&mut self, sampler: ObjectId) -> Result<u32> {
        let document = self.document;
        let properties = Properties::new(document, sampler, &mut self.assembly.notes)?;
        match properties.plugin.build {
            Build::Sampler(build) => build(self, &properties),
            _ => Err(super::misplaced(&properties)),
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

fn mitchell(properties: &Properties) -> Result<Filter> {
    let part = |name: &str| properties.float_in(name, 0.0..=1.0, "between 0 and 1").map(|x| x as f32);
    Ok(Filter::Mitchell { b: part("B")?, c: part("C")? })
}

fn catmullrom(_: &Properties) -> Result<Filter> {
    Ok(Filter::CatmullRom)
}

fn lanczos(properties: &Properties) -> Result<Filter> {
    let lobes = properties.count("lobes", 1)? as f32;
    checked(properties, "lobes", Filter::Lanczos { lobes })
}

fn checked(properties: &Properties, name: &str, filter: Filter) -> Result<Filter> {
    let radius = filter.radius();
    match radius > 0.0 && radius <= FILTER_RADIUS_MAX {
        true => Ok(filter),
        false => {
            let message = format!(
                "'{name}' makes the filter reach {radius} pixels; it must be above 0 and at most {}",
                FILTER_RADIUS_MAX
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
