//! An XML tag with its attributes, and the checks of which may be there.

use super::document::{Span, Value};
use crate::load::error::did_you_mean;

/// What is wrong, and which attribute (or the tag itself) is to blame.
pub(crate) type Wrong<'a> = (Option<&'a Attribute>, String);

/// An opening tag with its values filled in.
#[derive(Debug)]
pub(crate) struct Element {
    pub tag: String,
    pub span: Span,
    pub attributes: Vec<Attribute>,
}

#[derive(Debug)]
pub(crate) struct Attribute {
    pub name: String,
    pub value: String,
    pub span: Span,
}

impl Element {
    pub fn get(&self, name: &str) -> Option<&Attribute> {
        self.attributes.iter().find(|attribute| attribute.name == name)
    }

    /// Whether all of `required` and nothing but these and `optional` is there.
    pub fn check(&self, required: &[&str], optional: &[&str]) -> std::result::Result<(), Wrong<'_>> {
        let known = || required.iter().chain(optional).copied();
        if let Some(stray) = self.attributes.iter().find(|a| !known().any(|name| name == a.name)) {
            let hint = did_you_mean(&stray.name, known());
            let list: Vec<&str> = known().collect();
            let message = format!("<{}> has no attribute '{}'{hint}; it has {}", self.tag, stray.name, list.join(", "));
            return Err((Some(stray), message));
        }
        match required.iter().find(|name| self.get(name).is_none()) {
            Some(name) => Err((None, format!("<{}> needs the attribute '{name}'", self.tag))),
            None => Ok(()),
        }
    }
}

/// A property with a name and a value.
pub(crate) fn scalar(
    element: &Element,
    read: impl Fn(&str) -> std::result::Result<Value, String>,
) -> std::result::Result<Value, Wrong<'_>> {
    element.check(&["name", "value"], &[])?;
    let value = element.get("value");
    read(value.map_or("", |a| &a.value)).map_err(|message| (value, message))
}
