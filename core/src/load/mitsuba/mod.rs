//! Mitsuba 3 scene files, read as Mitsuba 3.9 reads them.
//!
//! [`xml`] turns the file into a tree ([`document`]); the tree's objects are checked against the table of [`mod@plugins`]; one
//! file a family makes of them what the scene needs. Only what the scene uses is made, and only its files are read.

mod bsdfs;
mod cie;
mod document;
mod element;
mod emitters;
mod films;
mod integrator;
mod materials;
mod plugins;
mod properties;
mod sensors;
mod shapes;
mod spectra;
pub(crate) mod spectrum;
mod stand_in;
mod substitute;
mod textures;
mod transform;
mod upgrade;
mod values;
mod xml;

pub use document::Tag;
pub use plugins::{Meaning, Parameter, Plugin, Takes, plugins};

use super::assembly::Assembly;
use super::error::{LoadError, Place, Result};
use super::folder::{self, Folder};
use super::{LoadOptions, Loaded};
use crate::scene::{BsdfId, TextureId};
use document::{Document, ObjectId, ROOT, Span, Value};
use properties::Properties;
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

/// Loads a scene file.
///
/// # Errors
/// Whatever is wrong with it or the files it names.
pub(crate) fn load(path: &Path, options: &LoadOptions) -> Result<Loaded> {
    let folder = Folder::of(path)?;
    let bytes = folder::read_scene_file(path)?;
    let Some(name) = path.file_name() else {
        return Err(LoadError::at(Place::file(path.display().to_string()), "this is no file"));
    };
    let mut document = xml::read(&folder, Path::new(name), bytes, &options.defines)?;
    let substitutions = if options.substitute { stand_in::apply(&mut document) } else { Vec::new() };
    let loader = Loader {
        document: &document,
        assembly: Assembly::new(folder),
        textures: HashMap::new(),
        bsdfs: HashMap::new(),
        lit: HashMap::new(),
        made: HashSet::new(),
        groups: HashMap::new(),
        in_group: false,
    };
    loader.scene().map(|loaded| Loaded { substitutions, ..loaded })
}

/// A document on its way into an assembly.
pub(crate) struct Loader<'a> {
    pub document: &'a Document,
    pub assembly: Assembly,
    /// Textures and BSDFs made so far; a texture used as numbers is another than the same used as colours.
    pub textures: HashMap<(ObjectId, bool), TextureId>,
    pub bsdfs: HashMap<ObjectId, BsdfId>,
    /// Area lights and the shapes they make shine.
    pub lit: HashMap<ObjectId, ObjectId>,
    /// Objects in use.
    pub made: HashSet<ObjectId>,
    /// Groups of shapes made so far.
    pub groups: HashMap<ObjectId, usize>,
    /// Whether the shapes being made stand in a group.
    pub in_group: bool,
}

/// Tags of which a scene may have unused objects.
const SPARE_TAGS: [Tag; 5] = [Tag::Shape, Tag::Bsdf, Tag::Texture, Tag::Emitter, Tag::Medium];

impl Loader<'_> {
    fn scene(mut self) -> Result<Loaded> {
        let document = self.document;
        let (mut integrators, mut sensors) = (Vec::new(), Vec::new());
        let mut lights = Vec::new();
        for property in &document.object(ROOT).properties {
            let Value::Object(id) = property.value else {
                let message =
                    format!("a {} cannot stand directly in <scene>; it belongs into an object", property.value.kind());
                return Err(document.error(&property.span, message));
            };
            match document.object(id).tag {
                Tag::Shape if document.object(id).plugin == "shapegroup" => {}
                Tag::Shape => self.shape(id)?,
                Tag::Emitter => lights.push(id),
                Tag::Integrator => integrators.push((id, &property.span)),
                Tag::Sensor => sensors.push(id),
                _ => {}
            }
        }
        self.emitters(&lights)?;
        let integrator = self.integrator(&integrators)?;
        let view = self.sensor(&sensors)?;
        self.note_unused();
        let settings = integrator.settings(view.film, view.spp);
        let sensor = view.sensor;
        self.assembly.finish(|bounds| sensor.unwrap_or_else(|| sensors::default_sensor(bounds)), settings)
    }

    /// The path within the scene's folder of a file that a property names, where Mitsuba would look for it.
    pub fn locate(&self, name: &str, span: &Span) -> Result<PathBuf> {
        let fail = |message: String| self.document.error(span, message);
        if name.is_empty() {
            return Err(fail("a file needs a name".into()));
        }
        let mut candidates = Vec::new();
        for folder in &self.document.search {
            candidates.push(self.assembly.folder.locate(folder, name).map_err(fail)?);
        }
        let found = candidates.iter().position(|path| candidates.len() > 1 && self.assembly.folder.has(path));
        Ok(candidates.swap_remove(found.unwrap_or(candidates.len() - 1)))
    }

    /// Says what stands in the file and is not used.
    fn note_unused(&mut self) {
        let root = self.document.object(ROOT);
        let children = root.properties.iter().filter_map(|property| match property.value {
            Value::Object(id) if !self.made.contains(&id) => Some(id),
            _ => None,
        });
        let spare: Vec<ObjectId> = children.filter(|id| SPARE_TAGS.contains(&self.document.object(*id).tag)).collect();
        for id in spare {
            let object = self.document.object(id);
            let place = self.document.place(&object.span);
            self.assembly.note(Some(place), format!("{} is not used, and not loaded", object.describe()));
        }
    }
}

/// A mistake in the table of plugins: a row whose tag is another than where it was found.
fn misplaced(properties: &Properties) -> LoadError {
    let message = format!("{} cannot stand here", properties.object.describe());
    properties.error(&properties.object.span, message)
}
