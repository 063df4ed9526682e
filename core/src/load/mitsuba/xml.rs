//! XML into a [`Document`]: tags, `$names`, `<default>`, `<include>`, `<alias>`, `<path>`.
//!
//! Knows Mitsuba's grammar, none of its plugins. Reads no file but includes.

use super::document::{Document, NESTING_MAX, Object, ObjectId, Property, ROOT, Span, TAGS, Tag, Value};
use super::element::{Attribute, Element, Wrong, scalar};
use super::substitute::Definitions;
use super::{transform, upgrade, values};
use crate::load::error::{LoadError, Place, Result, SourceText, did_you_mean};
use crate::load::folder::{Folder, TEXT_BYTES_MAX};
use glam::DMat4;
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// Includes within includes, as in Mitsuba.
const INCLUDE_DEPTH_MAX: usize = 15;
/// Files included in all; a file may be included more than once.
const INCLUDES_MAX: usize = 1000;
/// XML nodes a file; the limit keeps a hostile file's tree in memory's bounds.
const NODES_MAX: u32 = 20_000_000;
/// Tags that give an object a property, or say something about the file.
const PROPERTY_TAGS: [&str; 15] = [
    "boolean",
    "integer",
    "float",
    "string",
    "point",
    "vector",
    "rgb",
    "spectrum",
    "transform",
    "ref",
    "include",
    "alias",
    "default",
    "path",
    "scene",
];

/// Reads the scene file at `path` (within the folder), whose bytes are given, and all it includes.
///
/// # Errors
/// Whatever is wrong with the XML, its tags, attributes, values and references.
pub(crate) fn read(folder: &Folder, path: &Path, bytes: Vec<u8>, defines: &[(String, String)]) -> Result<Document> {
    let mut reader = Reader {
        folder,
        definitions: Definitions::new(defines),
        document: Document::default(),
        open: Vec::new(),
        named: HashSet::new(),
    };
    reader.file(path, bytes, None)?;
    if let Some(message) = reader.definitions.unused() {
        return Err(LoadError::at(Place::file(folder.name_of(path)), message));
    }
    let mut document = reader.document;
    document.search.push(PathBuf::new());
    document.resolve()?;
    Ok(document)
}

struct Reader<'a> {
    folder: &'a Folder,
    definitions: Definitions,
    document: Document,
    /// Files being read: the scene and its includes down to the current one.
    open: Vec<PathBuf>,
    /// Names given to properties so far.
    named: HashSet<(ObjectId, String)>,
}

/// Where an included file goes.
struct Host {
    object: ObjectId,
    name: Option<String>,
    depth: usize,
}

impl Reader<'_> {
    fn file(&mut self, path: &Path, bytes: Vec<u8>, host: Option<Host>) -> Result<()> {
        let name = self.folder.name_of(path);
        let text = String::from_utf8(bytes).map_err(|e| {
            let line = e.as_bytes()[..e.utf8_error().valid_up_to()].iter().filter(|&&b| b == b'\n').count() + 1;
            let message =
                format!("this is no scene: line {line} is not UTF-8 text; if the file is text, save it as UTF-8");
            LoadError::at(Place::file(name.as_str()), message)
        })?;
        let options = roxmltree::ParsingOptions { nodes_limit: NODES_MAX, ..Default::default() };
        let xml = roxmltree::Document::parse_with_options(&text, options).map_err(|e| {
            let place = SourceText::new(name.as_str(), text.as_str()).at(e.pos().row as usize, e.pos().col as usize);
            LoadError::at(place, format!("this is not well-formed XML: {}", e.to_string().trim_end_matches('.')))
        })?;
        let file = self.document.files.len();
        self.document.files.push(SourceText::new(name, text.as_str()));
        self.open.push(path.to_path_buf());
        let root = self.element(xml.root_element(), file)?;
        let old = self.version(&root)?;
        match host {
            None => {
                if root.tag != "scene" {
                    return Err(
                        self.wrong(&root, (None, format!("a scene file starts with <scene>, not <{}>", root.tag)))
                    );
                }
                self.object(Tag::Scene, &root, xml.root_element(), file, old, 0)?;
            }
            Some(host) if root.tag == "scene" => {
                self.check(&root, &["version"], &["type", "id", "name"])?;
                self.children(xml.root_element(), host.object, file, old, host.depth)?;
            }
            Some(host) => self.child(root, xml.root_element(), &host, file, old)?,
        }
        self.open.pop();
        Ok(())
    }

    /// Whether the file's version is below 2, so that its names need an upgrade.
    fn version(&mut self, root: &Element) -> Result<bool> {
        let Some(version) = root.get("version") else {
            let message = format!("<{}> needs a version: for a new file write version=\"3.0.0\"", root.tag);
            return Err(self.wrong(root, (None, message)));
        };
        let parts: Vec<Option<u32>> = version.value.split('.').map(|part| part.parse().ok()).collect();
        match parts.as_slice() {
            [Some(major), Some(_), Some(_)] => Ok(*major < 2),
            _ => {
                let message = format!("'{}' is no version; write three numbers such as 3.0.0", version.value);
                Err(self.wrong(root, (Some(version), message)))
            }
        }
    }

    /// An element's attributes with `$names` filled in.
    fn element(&mut self, node: roxmltree::Node, file: usize) -> Result<Element> {
        let tag = node.tag_name().name().to_owned();
        let start = node.range().start;
        let span = Span { file, range: start..start + 1 + tag.len() };
        let mut attributes = Vec::new();
        for attribute in node.attributes() {
            let span = Span { file, range: attribute.range_value() };
            let value = match attribute.value().contains('$') {
                true => self.definitions.apply(attribute.value()).map_err(|m| self.document.error(&span, m))?,
                false => attribute.value().to_owned(),
            };
            attributes.push(Attribute { name: attribute.name().to_owned(), value, span });
        }
        Ok(Element { tag, span, attributes })
    }

    fn wrong(&self, element: &Element, (attribute, message): Wrong) -> LoadError {
        self.document.error(attribute.map_or(&element.span, |a| &a.span), message)
    }

    fn check(&self, element: &Element, required: &[&str], optional: &[&str]) -> Result<()> {
        element.check(required, optional).map_err(|wrong| self.wrong(element, wrong))
    }

    /// Makes an object with all its properties.
    fn object(
        &mut self,
        tag: Tag,
        element: &Element,
        node: roxmltree::Node,
        file: usize,
        old: bool,
        depth: usize,
    ) -> Result<ObjectId> {
        let is_root = node.parent_element().is_none();
        let (required, optional): (&[&str], &[&str]) = match is_root {
            true => (&["version"], &["type", "id", "name"]),
            false => (&["type"], &["id", "name"]),
        };
        self.check(element, required, optional)?;
        if depth >= NESTING_MAX {
            let message = format!("objects are nested more than {NESTING_MAX} deep; no scene needs that");
            return Err(self.wrong(element, (None, message)));
        }
        let id = ObjectId(self.document.objects.len());
        self.document.objects.push(Object {
            tag,
            plugin: element.get("type").map_or("scene", |a| &a.value).to_owned(),
            plugin_span: element.get("type").map_or(&element.span, |a| &a.span).clone(),
            id: element.get("id").map(|a| a.value.clone()).filter(|id| !id.is_empty()),
            span: element.span.clone(),
            properties: Vec::new(),
        });
        if let Some(attribute) = element.get("id").filter(|a| !a.value.is_empty()) {
            self.name_object(attribute, id)?;
        }
        self.children(node, id, file, old, depth + 1)?;
        if old {
            let object = &mut self.document.objects[id.0];
            upgrade::from_version_1(object).map_err(|(span, message)| self.document.error(&span, message))?;
        }
        Ok(id)
    }

    fn name_object(&mut self, attribute: &Attribute, object: ObjectId) -> Result<()> {
        match self.document.ids.insert(attribute.value.clone(), object) {
            None => Ok(()),
            Some(first) => {
                let first = self.document.place(&self.document.object(first).span);
                let message =
                    format!("the id '{}' is taken by the object at {first}; ids must differ", attribute.value);
                Err(self.document.error(&attribute.span, message))
            }
        }
    }

    fn children(&mut self, node: roxmltree::Node, host: ObjectId, file: usize, old: bool, depth: usize) -> Result<()> {
        for child in node.children().filter(roxmltree::Node::is_element) {
            let element = self.element(child, file)?;
            self.child(element, child, &Host { object: host, name: None, depth }, file, old)?;
        }
        Ok(())
    }

    /// Adds what an element stands for to the object it stands in.
    fn child(&mut self, element: Element, node: roxmltree::Node, host: &Host, file: usize, old: bool) -> Result<()> {
        let spectrum_plugin = element.tag == "spectrum" && element.get("type").is_some();
        let tag = if spectrum_plugin { Some(Tag::Texture) } else { Tag::of(&element.tag) };
        let name = element.get("name").map(|a| a.value.clone()).filter(|name| !name.is_empty());
        if let Some(tag) = tag {
            let object = self.object(tag, &element, node, file, old, host.depth)?;
            let name = host.name.clone().or(name);
            return self.add(host.object, Property { name, value: Value::Object(object), span: element.span });
        }
        if element.tag != "transform"
            && let Some(inner) = node.children().find(roxmltree::Node::is_element)
        {
            let inner = self.element(inner, file)?;
            let message = format!("<{}> cannot stand inside <{}>, which only has a value", inner.tag, element.tag);
            return Err(self.wrong(&inner, (None, message)));
        }
        match element.tag.as_str() {
            "include" => self.include(&element, host),
            "default" => self.default(&element),
            "alias" => self.alias(&element),
            "path" => self.path(&element, host),
            "ref" => {
                self.check(&element, &["id"], &["name"])?;
                let id = element.get("id").map(|a| a.value.clone()).unwrap_or_default();
                self.add(host.object, Property { name, value: Value::Reference(id), span: element.span })
            }
            _ => {
                let (value, span) = self.value(&element, node, file)?;
                self.add(host.object, Property { name, value, span })
            }
        }
    }

    fn add(&mut self, object: ObjectId, property: Property) -> Result<()> {
        if let Some(name) = &property.name
            && !self.named.insert((object, name.clone()))
        {
            let message = format!("'{name}' is given twice; keep one of them");
            return Err(self.document.error(&property.span, message));
        }
        self.document.objects[object.0].properties.push(property);
        Ok(())
    }

    /// The value of a property tag, and where it stands.
    fn value(&mut self, element: &Element, node: roxmltree::Node, file: usize) -> Result<(Value, Span)> {
        let value = match element.tag.as_str() {
            "transform" => {
                self.check(element, &["name"], &[])?;
                return Ok((self.transform(node, file)?, element.span.clone()));
            }
            "point" | "vector" => element
                .check(&["name"], &["x", "y", "z", "value"])
                .and_then(|()| match element.get("value") {
                    Some(_) => Ok(()),
                    None => element.check(&["name", "x", "y", "z"], &[]),
                })
                .and_then(|()| transform::vector(element, 0.0))
                .map(Value::Vector),
            "spectrum" if element.get("filename").is_some() => element
                .check(&["name", "filename"], &[])
                .map(|()| Value::SpectrumFile(element.get("filename").map_or("", |a| &a.value).to_owned())),
            "boolean" => scalar(element, |text| values::boolean(text).map(Value::Boolean)),
            "integer" => scalar(element, |text| values::integer(text).map(Value::Integer)),
            "float" => scalar(element, |text| values::number(text).map(Value::Float)),
            "string" => scalar(element, |text| Ok(Value::Text(text.to_owned()))),
            "rgb" => scalar(element, |text| values::triple(text).map(|rgb| Value::Rgb(rgb.into()))),
            "spectrum" => scalar(element, |text| match values::tokens(text).as_slice() {
                [one] if !one.contains(':') => values::number(one).map(Value::FlatSpectrum),
                _ => values::spectrum(text).map(Value::Spectrum),
            }),
            tag => {
                let known = PROPERTY_TAGS.iter().copied().chain(TAGS.iter().map(|(_, name)| *name));
                let transformation = ["translate", "rotate", "scale", "lookat", "matrix"].contains(&tag);
                let message = match transformation {
                    true => format!("<{tag}> can stand only inside a <transform>"),
                    false => format!("Mitsuba knows no <{tag}>{}", did_you_mean(tag, known)),
                };
                Err((None, message))
            }
        };
        let value = value.map_err(|wrong| self.wrong(element, wrong))?;
        let span = element.get("value").map_or(&element.span, |a| &a.span);
        Ok((value, span.clone()))
    }

    fn transform(&mut self, node: roxmltree::Node, file: usize) -> Result<Value> {
        let mut matrix = DMat4::IDENTITY;
        for child in node.children().filter(roxmltree::Node::is_element) {
            let element = self.element(child, file)?;
            matrix = transform::matrix_of(&element).map_err(|wrong| self.wrong(&element, wrong))? * matrix;
        }
        Ok(Value::Transform(matrix))
    }

    fn include(&mut self, element: &Element, host: &Host) -> Result<()> {
        self.check(element, &["filename"], &["name"])?;
        let Some(attribute) = element.get("filename") else { return Ok(()) };
        let fail = |message: String| self.document.error(&attribute.span, message);
        // Beside the file that includes, then beside each that includes that one.
        let folders = self.open.iter().rev().map(|file| file.parent().unwrap_or(Path::new("")));
        let mut candidates = Vec::new();
        for folder in folders.chain(self.document.search.iter().map(PathBuf::as_path)) {
            candidates.push(self.folder.locate(folder, &attribute.value).map_err(fail)?);
        }
        let path = candidates.iter().find(|path| self.folder.has(path)).unwrap_or(&candidates[0]).clone();
        if self.open.contains(&path) {
            return Err(fail(format!("'{}' includes itself; break the circle", attribute.value)));
        }
        if self.open.len() > INCLUDE_DEPTH_MAX || self.document.files.len() > INCLUDES_MAX {
            let message = format!("more than {INCLUDE_DEPTH_MAX} includes within each other, or {INCLUDES_MAX} in all");
            return Err(fail(message));
        }
        let bytes = self.folder.read(&path, TEXT_BYTES_MAX).map_err(fail)?;
        let name = element.get("name").map(|a| a.value.clone());
        self.file(&path, bytes, Some(Host { object: host.object, name, depth: host.depth }))
    }

    fn default(&mut self, element: &Element) -> Result<()> {
        self.check(element, &["name", "value"], &[])?;
        let [name, value] = ["name", "value"].map(|key| element.get(key).map_or("", |a| &a.value));
        if name.is_empty() {
            return Err(self.wrong(element, (None, "a <default> needs a name".into())));
        }
        self.definitions.set_default(name, value);
        Ok(())
    }

    fn alias(&mut self, element: &Element) -> Result<()> {
        self.check(element, &["id", "as"], &[])?;
        let (Some(id), Some(alias)) = (element.get("id"), element.get("as")) else { return Ok(()) };
        match self.document.ids.get(&id.value).copied() {
            Some(object) => self.name_object(alias, object),
            None => {
                let hint = did_you_mean(&id.value, self.document.ids.keys().map(String::as_str));
                let message = format!("no object before this one has the id '{}'{hint}", id.value);
                Err(self.wrong(element, (Some(id), message)))
            }
        }
    }

    /// A folder in which files are looked for before the scene's own.
    fn path(&mut self, element: &Element, host: &Host) -> Result<()> {
        self.check(element, &["value"], &[])?;
        let Some(attribute) = element.get("value") else { return Ok(()) };
        if host.object != ROOT {
            return Err(self.wrong(element, (None, "<path> can stand only directly in <scene>".into())));
        }
        let fail = |message: String| self.document.error(&attribute.span, message);
        let from = self.open.last().and_then(|file| file.parent()).unwrap_or(Path::new(""));
        let path = self.folder.locate(from, &attribute.value).map_err(fail)?;
        if !path.as_os_str().is_empty() && !self.folder.has(&path) {
            return Err(fail(format!("there is no folder '{}'", self.folder.name_of(&path))));
        }
        self.document.search.insert(0, path);
        Ok(())
    }
}
