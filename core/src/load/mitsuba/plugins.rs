//! The table of plugins: every name, parameter, type and default, once, for the loader and for whoever documents it.
//!
//! The rows stand beside the functions that use them, a file a family ([`super::shapes`], [`super::bsdfs`] …); here is what
//! a row is, and the names that Mitsuba knows and tilecast does not.

use super::document::Tag;
use super::properties::Properties;
use super::{Loader, bsdfs, emitters, films, integrator, sensors, shapes, spectra, textures};
use crate::load::error::{Result, did_you_mean};
use crate::load::placed::{PlacedEmitter, PlacedSensor};
use crate::scene::{BsdfId, TextureId};
use crate::settings::{Film, Filter};

/// A plugin: one row of the table.
pub struct Plugin {
    /// Its `type` in a scene file.
    pub name: &'static str,
    /// One line for people.
    pub doc: &'static str,
    /// What can stand in it.
    pub parameters: &'static [Parameter],
    pub(crate) build: Build,
}

impl Plugin {
    /// The tag it is written with.
    pub fn tag(&self) -> Tag {
        match self.build {
            Build::Shape(_) => Tag::Shape,
            Build::Bsdf(_) => Tag::Bsdf,
            Build::Texture(_) => Tag::Texture,
            Build::Emitter(_) | Build::AreaLight(_) => Tag::Emitter,
            Build::Sensor(_) => Tag::Sensor,
            Build::Film(_) => Tag::Film,
            Build::Rfilter(_) => Tag::Rfilter,
            Build::Sampler(_) => Tag::Sampler,
            Build::Integrator(_) => Tag::Integrator,
        }
    }
}

/// What a parameter is, and how it is named.
pub struct Parameter {
    /// Its name; empty for an object that needs none.
    pub name: &'static str,
    /// Type and default.
    pub takes: Takes,
    /// One line for people.
    pub doc: &'static str,
    /// Whether it has an effect; if not, its presence is noted.
    pub modelled: bool,
}

/// Types of parameters with their defaults.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Takes {
    /// A number; `None` if there is no fixed default.
    Float(Option<f64>),
    /// A whole number; `None` if there is no fixed default.
    Integer(Option<i64>),
    /// True or false.
    Boolean(bool),
    /// Any text; `None` if there is no default.
    Text(Option<&'static str>),
    /// One of some words, the first of which is the default.
    Choice(&'static [&'static str]),
    /// A file in the scene's folder; always needed.
    File,
    /// A point or direction; `None` if there is no default.
    Vector(Option<[f64; 3]>),
    /// A transformation, by default none.
    Transform,
    /// A colour or spectrum, the same everywhere.
    Colour(f64, Meaning),
    /// A colour, spectrum or texture; `None` if there is no fixed default.
    Texture(Option<f64>, Meaning),
    /// An index of refraction: a number or a material's name.
    Ior(&'static str),
    /// Any number of objects of a tag, under any name.
    Child(Tag),
}

/// What a colour measures; spectra turn into linear sRGB accordingly.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Meaning {
    /// A share of light, 0 to 1.
    Reflectance,
    /// Light.
    Emission,
    /// Any other value over wavelengths.
    Unbounded,
    /// One number, no colour.
    Scalar,
}

/// What makes a plugin's object; by this a row belongs to a tag.
pub(crate) enum Build {
    Shape(fn(&mut Loader, &Properties) -> Result<()>),
    Bsdf(fn(&mut Loader, &Properties) -> Result<BsdfId>),
    Texture(fn(&mut Loader, &Properties, Meaning) -> Result<TextureId>),
    Emitter(fn(&mut Loader, &Properties) -> Result<PlacedEmitter>),
    /// The radiance of the shape it stands in.
    AreaLight(fn(&mut Loader, &Properties) -> Result<TextureId>),
    Sensor(fn(&mut Loader, &Properties) -> Result<PlacedSensor>),
    Film(fn(&mut Loader, &Properties) -> Result<Film>),
    Rfilter(fn(&Properties) -> Result<Filter>),
    /// Samples a pixel.
    Sampler(fn(&mut Loader, &Properties) -> Result<u32>),
    Integrator(fn(&mut Loader, &Properties) -> Result<integrator::Estimator>),
}

/// A parameter with an effect.
pub(crate) const fn parameter(name: &'static str, takes: Takes, doc: &'static str) -> Parameter {
    Parameter { name, takes, doc, modelled: true }
}

/// A parameter that is read and has no effect.
pub(crate) const fn unmodelled(name: &'static str, takes: Takes, doc: &'static str) -> Parameter {
    Parameter { name, takes, doc, modelled: false }
}

/// An object that stands in another under any name.
pub(crate) const fn child(tag: Tag, doc: &'static str) -> Parameter {
    Parameter { name: "", takes: Takes::Child(tag), doc, modelled: true }
}

/// Every plugin, family by family.
pub fn plugins() -> impl Iterator<Item = &'static Plugin> {
    let others =
        [textures::PLUGINS, spectra::PLUGINS, emitters::PLUGINS, sensors::PLUGINS, films::PLUGINS, integrator::PLUGINS];
    [shapes::PLUGINS].into_iter().chain(bsdfs::PLUGINS).chain(others).flatten()
}

/// Plugins that Mitsuba has and tilecast does not have yet.
const MISSING: &[(Tag, &[&str])] = &[
    (Tag::Shape, &["bsplinecurve", "ellipsoids", "ellipsoidsmesh", "linearcurve", "merge", "sdfgrid"]),
    (Tag::Bsdf, &["circular", "hair", "measured", "measured_polarized", "polarizer", "pplastic", "retarder"]),
    (Tag::Texture, &["volume"]),
    (Tag::Emitter, &["directionalarea", "sunsky", "timed_sunsky"]),
    (Tag::Sensor, &["batch", "distant", "irradiancemeter", "radiancemeter"]),
    (Tag::Film, &["specfilm"]),
    (
        Tag::Integrator,
        &["aov", "depth", "moment", "prb", "prb_basic", "prbvolpath", "ptracer", "stokes", "volpath", "volpathmis"],
    ),
    (Tag::Medium, &["heterogeneous", "homogeneous"]),
    (Tag::Phase, &["blendphase", "hg", "isotropic", "rayleigh", "sggx", "tabphase"]),
    (Tag::Volume, &["constvolume", "gridvolume"]),
];

/// The plugin of a tag by its name.
///
/// # Errors
/// A message that tells a plugin not supported yet from one that does not exist.
pub(crate) fn find(tag: Tag, name: &str) -> std::result::Result<&'static Plugin, String> {
    let known = || plugins().filter(move |plugin| plugin.tag() == tag).map(|plugin| plugin.name);
    if let Some(plugin) = plugins().find(|plugin| plugin.tag() == tag && plugin.name == name) {
        return Ok(plugin);
    }
    let missing = || MISSING.iter().filter(move |(other, _)| *other == tag).flat_map(|(_, names)| *names).copied();
    let supported: Vec<&str> = known().collect();
    let supported = match supported.as_slice() {
        [] => format!("no {} is", tag.name()),
        list => format!("there are {}", list.join(", ")),
    };
    Err(if missing().any(|other| other == name) {
        let way_out = if tag == Tag::Sensor { "" } else { "; `--substitute` renders without it" };
        format!("Mitsuba's {} '{name}' is not supported yet; {supported}{way_out}", tag.name())
    } else {
        format!("no {} is called '{name}'{}; {supported}", tag.name(), did_you_mean(name, known().chain(missing())))
    })
}
