//! A Mitsuba scene file as a tree of objects with named properties, before any of them means anything.
//!
//! The tree knows where each piece stood in which file; it does not know which plugins or parameters exist.

use crate::load::error::{LoadError, Place, Result, SourceText};
use glam::{DMat4, DVec3};
use std::collections::HashMap;
use std::ops::Range;
use std::path::PathBuf;

/// Objects within objects, counted along references too. Mitsuba's own scenes need five.
pub(crate) const NESTING_MAX: usize = 64;

/// Index into [`Document::objects`]; 0 is the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct ObjectId(pub usize);

/// The scene object.
pub(crate) const ROOT: ObjectId = ObjectId(0);

/// A scene file with everything it includes.
#[derive(Debug, Default)]
pub(crate) struct Document {
    pub files: Vec<SourceText>,
    pub objects: Vec<Object>,
    pub ids: HashMap<String, ObjectId>,
    /// Folders within the scene's folder in which meshes and images are looked for, in this order.
    pub search: Vec<PathBuf>,
}

/// Bytes of one of [`Document::files`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Span {
    pub file: usize,
    pub range: Range<usize>,
}

/// What an object is, by its tag.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Tag {
    /// The whole.
    Scene,
    /// How a surface scatters.
    Bsdf,
    /// A light.
    Emitter,
    /// A spatially varying value (no plugin of it is supported).
    Field,
    /// What collects samples.
    Film,
    /// What is estimated.
    Integrator,
    /// What fills space (no plugin of it is supported).
    Medium,
    /// How a medium scatters (no plugin of it is supported).
    Phase,
    /// A pixel filter.
    Rfilter,
    /// A source of random numbers.
    Sampler,
    /// A camera.
    Sensor,
    /// A surface.
    Shape,
    /// A value over surfaces.
    Texture,
    /// A value over space (no plugin of it is supported).
    Volume,
}

/// Every tag that makes an object.
pub(crate) const TAGS: [(Tag, &str); 14] = [
    (Tag::Scene, "scene"),
    (Tag::Bsdf, "bsdf"),
    (Tag::Emitter, "emitter"),
    (Tag::Field, "field"),
    (Tag::Film, "film"),
    (Tag::Integrator, "integrator"),
    (Tag::Medium, "medium"),
    (Tag::Phase, "phase"),
    (Tag::Rfilter, "rfilter"),
    (Tag::Sampler, "sampler"),
    (Tag::Sensor, "sensor"),
    (Tag::Shape, "shape"),
    (Tag::Texture, "texture"),
    (Tag::Volume, "volume"),
];

impl Tag {
    /// The tag as it is written.
    pub fn name(self) -> &'static str {
        TAGS.iter().find(|(tag, _)| *tag == self).map_or("", |(_, name)| name)
    }

    pub(crate) fn of(name: &str) -> Option<Self> {
        TAGS.iter().find(|(_, known)| *known == name).map(|(tag, _)| *tag)
    }
}

/// `<bsdf type="diffuse" id="white">…</bsdf>`
#[derive(Debug)]
pub(crate) struct Object {
    pub tag: Tag,
    /// Its `type`, and where that stands.
    pub plugin: String,
    pub plugin_span: Span,
    pub id: Option<String>,
    /// Its opening tag.
    pub span: Span,
    /// In the order of writing.
    pub properties: Vec<Property>,
}

impl Object {
    /// `bsdf 'white'` or `bsdf of type 'diffuse'`, for messages.
    pub fn describe(&self) -> String {
        match &self.id {
            Some(id) => format!("{} '{id}'", self.tag.name()),
            None => format!("{} of type '{}'", self.tag.name(), self.plugin),
        }
    }
}

#[derive(Debug)]
pub(crate) struct Property {
    /// Objects and references may have none.
    pub name: Option<String>,
    pub value: Value,
    /// Its value, or its tag if the value spans several.
    pub span: Span,
}

#[derive(Debug)]
pub(crate) enum Value {
    Integer(i64),
    Float(f64),
    Boolean(bool),
    Text(String),
    Rgb(DVec3),
    /// The same at every wavelength.
    FlatSpectrum(f64),
    /// Wavelengths in nm, increasing, and values.
    Spectrum(Vec<(f64, f64)>),
    /// A file of wavelengths and values.
    SpectrumFile(String),
    /// A point or a vector.
    Vector(DVec3),
    Transform(DMat4),
    Object(ObjectId),
    /// An id, until [`Document::resolve`] puts the object in its place.
    Reference(String),
}

impl Value {
    /// What it is called in messages.
    pub fn kind(&self) -> &'static str {
        match self {
            Value::Integer(_) => "integer",
            Value::Float(_) => "float",
            Value::Boolean(_) => "boolean",
            Value::Text(_) => "string",
            Value::Rgb(_) => "rgb",
            Value::FlatSpectrum(_) | Value::Spectrum(_) | Value::SpectrumFile(_) => "spectrum",
            Value::Vector(_) => "vector",
            Value::Transform(_) => "transform",
            Value::Object(_) | Value::Reference(_) => "object",
        }
    }
}

impl Document {
    pub fn object(&self, id: ObjectId) -> &Object {
        &self.objects[id.0]
    }

    pub fn place(&self, span: &Span) -> Place {
        self.files[span.file].place(span.range.clone())
    }

    pub fn error(&self, span: &Span, message: impl Into<String>) -> LoadError {
        LoadError::at(self.place(span), message)
    }

    /// Puts objects in the place of references, and checks that nothing contains itself or nests too deep.
    ///
    /// # Errors
    /// The first reference to nothing, circle, or nesting beyond [`NESTING_MAX`].
    pub fn resolve(&mut self) -> Result<()> {
        let mut found = Vec::new();
        for (o, object) in self.objects.iter().enumerate() {
            for (p, property) in object.properties.iter().enumerate() {
                if let Value::Reference(id) = &property.value {
                    let target = self.ids.get(id).ok_or_else(|| self.dangling(id, &property.span))?;
                    found.push((o, p, *target));
                }
            }
        }
        for (o, p, target) in found {
            self.objects[o].properties[p].value = Value::Object(target);
        }
        let mut heights = vec![Height::Unknown; self.objects.len()];
        (0..self.objects.len()).try_for_each(|i| self.measure(ObjectId(i), &mut heights, 0).map(|_| ()))
    }

    fn dangling(&self, id: &str, span: &Span) -> LoadError {
        let hint = crate::load::error::did_you_mean(id, self.ids.keys().map(String::as_str));
        let hint = if hint.is_empty() { "; give one object this id, or correct the reference".into() } else { hint };
        self.error(span, format!("no object has the id '{id}'{hint}"))
    }

    /// Levels of objects from `id` down. Recursion is bounded by [`NESTING_MAX`].
    fn measure(&self, id: ObjectId, heights: &mut [Height], depth: usize) -> Result<usize> {
        let object = self.object(id);
        match heights[id.0] {
            Height::Known(height) if depth + height <= NESTING_MAX => return Ok(height),
            Height::Open => {
                let message = format!("{} contains itself, by way of a reference; break the circle", object.describe());
                return Err(self.error(&object.span, message));
            }
            _ if depth >= NESTING_MAX => {
                let message = format!("objects are nested more than {NESTING_MAX} deep; no scene needs that");
                return Err(self.error(&object.span, message));
            }
            _ => heights[id.0] = Height::Open,
        }
        let mut height = 1;
        for property in &object.properties {
            if let Value::Object(child) = property.value {
                height = height.max(1 + self.measure(child, heights, depth + 1)?);
            }
        }
        heights[id.0] = Height::Known(height);
        Ok(height)
    }
}

#[derive(Clone, Copy)]
enum Height {
    Unknown,
    /// Being measured: to meet it again is a circle.
    Open,
    Known(usize),
}
