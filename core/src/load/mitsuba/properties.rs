//! The properties of one object, checked against its plugin's row of the table, with the table's defaults.

use super::document::{Document, Object, ObjectId, Property, Span, Tag, Value};
use super::plugins::{self, Parameter, Plugin, Takes};
use crate::load::Note;
use crate::load::error::{LoadError, Result, did_you_mean};
use glam::{DAffine3, DMat4, DVec3};

/// An object whose properties all fit its plugin.
pub(crate) struct Properties<'a> {
    pub document: &'a Document,
    pub id: ObjectId,
    pub object: &'a Object,
    pub plugin: &'static Plugin,
}

impl<'a> Properties<'a> {
    /// Finds the plugin and checks every property. What is read without effect is noted, unless it is the default.
    ///
    /// # Errors
    /// The first plugin, parameter or type that does not exist.
    pub fn new(document: &'a Document, id: ObjectId, notes: &mut Vec<Note>) -> Result<Self> {
        let object = document.object(id);
        let plugin = plugins::find(object.tag, &object.plugin).map_err(|m| document.error(&object.plugin_span, m))?;
        let properties = Self { document, id, object, plugin };
        for property in &object.properties {
            let parameter = properties.check(property)?;
            if !parameter.modelled && !parameter.takes.is_default(&property.value) {
                let name = property.name.as_deref().unwrap_or_default();
                let text = format!("'{name}' of {} has no effect here: {}", object.describe(), parameter.doc);
                notes.push(Note { place: Some(document.place(&property.span)), text });
            }
        }
        Ok(properties)
    }

    /// The parameter that a property sets.
    ///
    /// # Errors
    /// A name that the plugin does not have, or a value of another type.
    pub fn check(&self, property: &Property) -> Result<&'static Parameter> {
        let parameters = self.plugin.parameters;
        let child = match property.value {
            Value::Object(child) => Some(self.document.object(child).tag),
            _ => None,
        };
        let by_name = property.name.as_deref().and_then(|name| parameters.iter().find(|p| p.name == name));
        if let Some(parameter) = by_name.filter(|p| !p.name.is_empty()) {
            return match accepts(parameter.takes, &property.value, child) {
                true => Ok(parameter),
                false => {
                    let message = format!(
                        "'{}' of {} takes {}, not a {}",
                        parameter.name,
                        self.object.describe(),
                        parameter.takes.describe(),
                        child.map_or(property.value.kind(), Tag::name),
                    );
                    Err(self.error(&property.span, message))
                }
            };
        }
        let as_child = parameters.iter().find(|p| matches!((p.takes, child), (Takes::Child(a), Some(b)) if a == b));
        as_child.ok_or_else(|| self.stray(property, child))
    }

    /// An error about a property that the plugin does not have.
    fn stray(&self, property: &Property, child: Option<Tag>) -> LoadError {
        let names = || self.plugin.parameters.iter().map(|p| p.name).filter(|name| !name.is_empty());
        let described = format!("{} '{}'", self.plugin.tag().name(), self.plugin.name);
        let message = match (&property.name, child) {
            (None, Some(child)) => match self.plugin.parameters.iter().find(|p| accepts_tag(p.takes, child)) {
                Some(parameter) => format!(
                    "this {} needs a name that says which parameter of {described} it is, such as name=\"{}\"",
                    child.name(),
                    parameter.name
                ),
                None => format!("a {} cannot stand in {described}", child.name()),
            },
            (name, _) => {
                let name = name.as_deref().unwrap_or_default();
                let list: Vec<&str> = names().collect();
                let list = if list.is_empty() { "it has none".into() } else { format!("it has {}", list.join(", ")) };
                format!("{described} has no parameter '{name}'{}; {list}", did_you_mean(name, names()))
            }
        };
        self.error(&property.span, message)
    }

    /// An error at a place of this document.
    pub fn error(&self, span: &Span, message: impl Into<String>) -> LoadError {
        self.document.error(span, message)
    }

    /// An error about a parameter, at its value if it has one.
    pub fn wrong(&self, name: &str, message: impl Into<String>) -> LoadError {
        self.error(self.get(name).map_or(&self.object.span, |p| &p.span), message)
    }

    /// The property of that name, if it is given.
    pub fn get(&self, name: &str) -> Option<&'a Property> {
        self.object.properties.iter().find(|p| p.name.as_deref() == Some(name))
    }

    /// The objects of a tag that stand in this one, in the order of writing.
    pub fn children(&self, tag: Tag) -> impl Iterator<Item = (ObjectId, &'a Span)> {
        let named = |p: &Property| {
            let name = p.name.as_deref().unwrap_or_default();
            self.plugin.parameters.iter().any(|parameter| !name.is_empty() && parameter.name == name)
        };
        self.object.properties.iter().filter(move |p| !named(p)).filter_map(move |p| match p.value {
            Value::Object(child) if self.document.object(child).tag == tag => Some((child, &p.span)),
            _ => None,
        })
    }

    /// At most one object of a tag.
    ///
    /// # Errors
    /// A second one.
    pub fn child(&self, tag: Tag) -> Result<Option<ObjectId>> {
        let mut children = self.children(tag);
        let first = children.next();
        match children.next() {
            Some((_, span)) => {
                let message = format!("{} can have only one {}; keep one of them", self.object.describe(), tag.name());
                Err(self.error(span, message))
            }
            None => Ok(first.map(|(id, _)| id)),
        }
    }

    /// What the table says of a parameter.
    pub fn takes(&self, name: &str) -> Takes {
        match self.plugin.parameters.iter().find(|parameter| parameter.name == name) {
            Some(parameter) => parameter.takes,
            // A fault of this crate: the test of all plugins reads every parameter.
            None => panic!("the table has no parameter '{name}' of '{}'", self.plugin.name),
        }
    }

    /// An error about a parameter that must be given.
    pub fn missing(&self, name: &str) -> LoadError {
        let takes = self.takes(name).describe();
        let message = format!("{} needs the parameter '{name}' ({takes})", self.object.describe());
        self.error(&self.object.span, message)
    }

    /// A number.
    pub fn float(&self, name: &str) -> Result<f64> {
        match (self.get(name).map(|p| &p.value), self.takes(name)) {
            (Some(Value::Float(x)), _) => Ok(*x),
            (Some(Value::Integer(i)), _) => Ok(*i as f64),
            (None, Takes::Float(Some(default))) => Ok(default),
            _ => Err(self.missing(name)),
        }
    }

    /// A number within limits.
    pub fn float_in(&self, name: &str, range: impl std::ops::RangeBounds<f64>, says: &str) -> Result<f64> {
        let x = self.float(name)?;
        match range.contains(&x) {
            true => Ok(x),
            false => Err(self.wrong(name, format!("'{name}' is {x}; it must be {says}"))),
        }
    }

    /// A whole number.
    pub fn integer(&self, name: &str) -> Result<i64> {
        match (self.get(name).map(|p| &p.value), self.takes(name)) {
            (Some(Value::Integer(i)), _) => Ok(*i),
            (None, Takes::Integer(Some(default))) => Ok(default),
            _ => Err(self.missing(name)),
        }
    }

    /// A whole number that fits a `u32`, at least `least`.
    pub fn count(&self, name: &str, least: u32) -> Result<u32> {
        let i = self.integer(name)?;
        match u32::try_from(i) {
            Ok(count) if count >= least => Ok(count),
            _ => Err(self.wrong(name, format!("'{name}' is {i}; it must be {least} to {}", u32::MAX))),
        }
    }

    /// True or false.
    pub fn boolean(&self, name: &str) -> bool {
        match (self.get(name).map(|p| &p.value), self.takes(name)) {
            (Some(Value::Boolean(b)), _) => *b,
            (None, Takes::Boolean(default)) => default,
            _ => false,
        }
    }

    /// A text that is given.
    pub fn text(&self, name: &str) -> Option<&'a str> {
        match self.get(name).map(|p| &p.value) {
            Some(Value::Text(text)) => Some(text),
            _ => None,
        }
    }

    /// A text that must be given.
    pub fn required_text(&self, name: &str) -> Result<&'a str> {
        self.text(name).ok_or_else(|| self.missing(name))
    }

    /// The index of a word in its parameter's list.
    ///
    /// # Errors
    /// Another word.
    pub fn choice(&self, name: &str) -> Result<usize> {
        let Takes::Choice(words) = self.takes(name) else { return Ok(0) };
        let Some(text) = self.text(name) else { return Ok(0) };
        words.iter().position(|word| *word == text).ok_or_else(|| {
            let hint = did_you_mean(text, words.iter().copied());
            self.wrong(name, format!("'{name}' cannot be '{text}'{hint}; it is one of {}", words.join(", ")))
        })
    }

    /// The name of a file.
    pub fn file(&self, name: &str) -> Result<(&'a str, &'a Span)> {
        match self.get(name) {
            Some(Property { value: Value::Text(text), span, .. }) => Ok((text, span)),
            _ => Err(self.missing(name)),
        }
    }

    /// A point or direction.
    pub fn vector(&self, name: &str) -> Result<DVec3> {
        match (self.get(name).map(|p| &p.value), self.takes(name)) {
            (Some(Value::Vector(v)), _) => Ok(*v),
            (None, Takes::Vector(Some(default))) => Ok(default.into()),
            _ => Err(self.missing(name)),
        }
    }

    /// A transformation that can be inverted.
    pub fn transform(&self, name: &str) -> Result<DAffine3> {
        let Some(Property { value: Value::Transform(matrix), .. }) = self.get(name) else {
            return Ok(DAffine3::IDENTITY);
        };
        let determinant = matrix.determinant();
        match DMat4::is_finite(matrix) && determinant.is_finite() && determinant != 0.0 {
            true => Ok(DAffine3::from_mat4(*matrix)),
            false => {
                Err(self.wrong(name, "this transformation is singular: it makes everything flat, so use no scale of 0"))
            }
        }
    }
}

/// Whether a parameter takes a value.
fn accepts(takes: Takes, value: &Value, child: Option<Tag>) -> bool {
    match (takes, value) {
        (_, Value::Object(_)) => child.is_some_and(|tag| accepts_tag(takes, tag)),
        (Takes::Float(_), Value::Float(_) | Value::Integer(_)) => true,
        (Takes::Integer(_), Value::Integer(_)) => true,
        (Takes::Boolean(_), Value::Boolean(_)) => true,
        (Takes::Text(_) | Takes::Choice(_) | Takes::File, Value::Text(_)) => true,
        (Takes::Vector(_), Value::Vector(_)) => true,
        (Takes::Transform, Value::Transform(_)) => true,
        (Takes::Ior(_), Value::Float(_) | Value::Integer(_) | Value::Text(_)) => true,
        (
            Takes::Colour(..) | Takes::Texture(..),
            Value::Rgb(_)
            | Value::FlatSpectrum(_)
            | Value::Spectrum(_)
            | Value::SpectrumFile(_)
            | Value::Float(_)
            | Value::Integer(_),
        ) => true,
        _ => false,
    }
}

fn accepts_tag(takes: Takes, tag: Tag) -> bool {
    matches!(takes, Takes::Colour(..) | Takes::Texture(..)) && tag == Tag::Texture
}

impl Takes {
    /// What it takes, for messages and documentation.
    pub fn describe(self) -> String {
        match self {
            Takes::Float(_) => "a float".into(),
            Takes::Integer(_) => "an integer".into(),
            Takes::Boolean(_) => "a boolean".into(),
            Takes::Text(_) => "a string".into(),
            Takes::Choice(words) => format!("one of the strings {}", words.join(", ")),
            Takes::File => "a string, the name of a file".into(),
            Takes::Vector(_) => "a point or vector".into(),
            Takes::Transform => "a transform".into(),
            Takes::Colour(..) => "an rgb, spectrum or float".into(),
            Takes::Texture(..) => "an rgb, spectrum, float or texture".into(),
            Takes::Ior(_) => "a float, or a string with the name of a material".into(),
            Takes::Child(tag) => format!("a {}", tag.name()),
        }
    }

    /// Whether a value is the default, so that it says nothing.
    fn is_default(self, value: &Value) -> bool {
        match (self, value) {
            (Takes::Float(Some(default)), Value::Float(x)) => *x == default,
            (Takes::Float(Some(default)), Value::Integer(i)) => *i as f64 == default,
            (Takes::Integer(Some(default)), Value::Integer(i)) => *i == default,
            (Takes::Boolean(default), Value::Boolean(b)) => *b == default,
            (Takes::Text(Some(default)), Value::Text(text)) => text == default,
            (Takes::Choice(words), Value::Text(text)) => words.first() == Some(&text.as_str()),
            _ => false,
        }
    }

    /// Its default as one would write it, if it has one.
    pub fn default(self) -> Option<String> {
        match self {
            Takes::Float(default) => default.map(|x| x.to_string()),
            Takes::Integer(default) => default.map(|i| i.to_string()),
            Takes::Boolean(default) => Some(default.to_string()),
            Takes::Text(default) => default.map(String::from),
            Takes::Choice(words) => words.first().map(|word| (*word).into()),
            Takes::Vector(default) => default.map(|[x, y, z]| format!("{x}, {y}, {z}")),
            Takes::Transform => Some("none".into()),
            Takes::Colour(default, _) => Some(default.to_string()),
            Takes::Texture(default, _) => default.map(|x| x.to_string()),
            Takes::Ior(default) => Some(default.into()),
            Takes::File | Takes::Child(_) => None,
        }
    }
}
