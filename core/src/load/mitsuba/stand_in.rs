//! What is rendered in the place of what tilecast does not have, for those who ask for it: a change of the document before
//! anything is made of it, and a list of every change.
//!
//! A BSDF becomes the default one, a texture its parameter's default or a middle grey, integrators, films and samplers the
//! common ones; shapes, lights, media and single parameters are left out. A sensor has no stand-in: a picture from elsewhere
//! is another picture.

use super::document::{Document, ObjectId, ROOT, Tag, Value};
use super::plugins::{self, Plugin, Takes};
use super::properties::Properties;
use crate::load::Note;
use std::collections::HashSet;

/// A texture's place is filled with this where its parameter has no default.
const MIDDLE: f64 = 0.5;

/// Puts stand-ins into a document; returns what was replaced, in the order of the file.
pub(crate) fn apply(document: &mut Document) -> Vec<Note> {
    let mut changes = Vec::new();
    for id in in_use(document) {
        let object = document.object(id);
        if object.tag != Tag::Scene {
            changes.extend(stand_in(document, id));
        }
    }
    // Objects are replaced before parameters are checked: what they may have depends on what they are by then.
    let mut replaced = Vec::new();
    let mut left_out = HashSet::new();
    for Replacement { id, by, note } in changes {
        match by {
            Some(plugin) => {
                let object = &mut document.objects[id.0];
                object.plugin = plugin.into();
                if object.tag == Tag::Bsdf {
                    object.properties.clear();
                }
            }
            None => {
                left_out.insert(id);
            }
        }
        replaced.push(note);
    }
    for id in in_use(document) {
        replaced.extend(trim(document, id, &left_out));
    }
    replaced
}

/// An object that becomes of another type, or is left out.
struct Replacement {
    id: ObjectId,
    by: Option<&'static str>,
    note: Note,
}

/// What an object is replaced by, if it must be.
fn stand_in(document: &Document, id: ObjectId) -> Option<Replacement> {
    let object = document.object(id);
    if plugins::find(object.tag, &object.plugin).is_ok() {
        return None;
    }
    let (by, told) = match object.tag {
        Tag::Bsdf => (Some("diffuse"), "replaced by a grey 'diffuse'"),
        Tag::Integrator => (Some("path"), "replaced by 'path'"),
        Tag::Film => (Some("hdrfilm"), "replaced by 'hdrfilm'"),
        Tag::Sampler => (Some("independent"), "replaced by 'independent'"),
        Tag::Rfilter => (Some("gaussian"), "replaced by 'gaussian'"),
        Tag::Texture => (None, "replaced by its parameter's default or grey"),
        Tag::Shape | Tag::Emitter | Tag::Medium | Tag::Phase | Tag::Volume | Tag::Field => (None, "left out"),
        Tag::Sensor | Tag::Scene => return None,
    };
    let text = format!("tilecast has no {} '{}': {told}", object.tag.name(), object.plugin);
    Some(Replacement { id, by, note: Note { place: Some(document.place(&object.plugin_span)), text } })
}

/// Takes out of an object what is left out and what its plugin does not have.
fn trim(document: &mut Document, id: ObjectId, left_out: &HashSet<ObjectId>) -> Vec<Note> {
    let object = document.object(id);
    let plugin = plugins::find(object.tag, &object.plugin).ok();
    if plugin.is_none() && id != ROOT {
        return Vec::new(); // a sensor that tilecast does not have: loading tells
    }
    let mut notes = Vec::new();
    let mut fates = Vec::with_capacity(object.properties.len());
    for property in &object.properties {
        let is_left_out = matches!(property.value, Value::Object(child) if left_out.contains(&child));
        let fits = plugin.is_none_or(|plugin| Properties { document, id, object, plugin }.check(property).is_ok());
        fates.push(match (is_left_out, plugin) {
            (true, Some(plugin)) if needs_value(plugin, property.name.as_deref()) => Fate::Middle,
            (true, _) => Fate::Gone,
            (false, _) if fits => Fate::Kept,
            (false, _) => {
                let what = property.name.as_deref().unwrap_or_else(|| property.value.kind());
                let text = format!("{} of type '{}' has no '{what}' here: left out", object.tag.name(), object.plugin);
                notes.push(Note { place: Some(document.place(&property.span)), text });
                Fate::Gone
            }
        });
    }
    let mut fates = fates.into_iter();
    document.objects[id.0].properties.retain_mut(|property| match fates.next() {
        Some(Fate::Gone) => false,
        Some(Fate::Middle) => {
            property.value = Value::Float(MIDDLE);
            true
        }
        Some(Fate::Kept) | None => true,
    });
    notes
}

/// What becomes of a property.
enum Fate {
    Kept,
    Gone,
    Middle,
}

/// Whether a parameter that takes textures has no default.
fn needs_value(plugin: &Plugin, name: Option<&str>) -> bool {
    let mut named = plugin.parameters.iter().filter(|parameter| Some(parameter.name) == name);
    named.any(|parameter| matches!(parameter.takes, Takes::Texture(None, _)))
}

/// Every object that the scene uses, from the scene itself down. What stands in it to be referred to is used only so.
fn in_use(document: &Document) -> Vec<ObjectId> {
    let spare = |id: ObjectId| {
        let object = document.object(id);
        super::SPARE_TAGS.contains(&object.tag) && !matches!(object.tag, Tag::Emitter | Tag::Shape)
            || object.plugin == "shapegroup"
    };
    let (mut found, mut seen, mut open) = (Vec::new(), HashSet::from([ROOT]), vec![ROOT]);
    while let Some(id) = open.pop() {
        found.push(id);
        let children = document.object(id).properties.iter().rev().filter_map(|property| match property.value {
            Value::Object(child) if id != ROOT || !spare(child) => Some(child),
            _ => None,
        });
        open.extend(children.filter(|child| seen.insert(*child)));
    }
    found
}
