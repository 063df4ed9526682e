//! `docs/mitsuba.md`: what of Mitsuba's format tilecast supports, from the loader's own table and the conformance scenes.

use std::collections::{BTreeMap, BTreeSet};
use tilecast_core::load::mitsuba::{Meaning, Parameter, Plugin, Tag, Takes, plugins};

/// Plugins that no scene needs to be about, with the reason.
const UNTESTED: &[(&str, &str)] = &[
    ("whitted", "Mitsuba has no such integrator."),
    ("blackbody", "Mitsuba's rgb variants refuse it."),
    ("regular", "Mitsuba's rgb variants refuse it; here it is a spectrum as by `<spectrum>`."),
    ("irregular", "Mitsuba's rgb variants refuse it; here it is a spectrum as by `<spectrum>`."),
    ("stratified", "It gives the number of samples, like `independent`."),
    ("multijitter", "It gives the number of samples, like `independent`."),
    ("orthogonal", "It gives the number of samples, like `independent`."),
    ("ldsampler", "It gives the number of samples, like `independent`."),
];

/// Where tilecast differs on purpose, and why.
const DIFFERENCES: &[(&str, &str)] = &[
    (
        "scene",
        "Without an integrator `path` is used, without a sensor a camera that sees everything; Mitsuba renders neither.",
    ),
    (
        "area",
        "On a mesh whose vertex normals lean away from its faces, Mitsuba's two ways of finding the light contradict each \
         other, as one of them takes areas by the vertex normals. tilecast takes them by the faces.",
    ),
    ("sphere", "A scale that differs by axis is an error; Mitsuba uses the first axis' scale for all of them."),
    ("obj", "Negative indices count back from the latest, as the format has it; Mitsuba refuses them."),
    ("ply", "Faces of more than three corners are cut into triangles; Mitsuba refuses them."),
    ("ply", "Opacity, the fourth number of a colour attribute, is left out; Mitsuba can show no such attribute."),
    (
        "hdrfilm",
        "A crop's pixels have the very bits that they have in the whole picture, so that pictures can be put together from \
         crops; Mitsuba cuts pixel filters off at the crop's edge. At the whole picture's edge both cut.",
    ),
    (
        "blendbsdf",
        "A mirror blended with something else keeps its light. Mitsuba 3.9.1 loses up to a fifth of it: under a sky of radiance \
         1, 70 % mirror and 30 % black give 0.62.",
    ),
    ("mesh_attribute", "A mesh that does not have the attribute is an error; Mitsuba shows it black."),
    ("gaussian", "Is exact; Mitsuba evaluates a fitted polynomial, wrong by up to 0.04 %."),
    (
        "path",
        "Rays leave a surface within its rounding error. Mitsuba starts them 9e-5 (1 + its largest coordinate) off the surface \
         and ends shadow rays 9e-4 of the way before the light, so that relief of that size casts no shadow: half a millimetre in a \
         room of metres. In Bitterli's staircase, where light grazes panelled walls, Mitsuba is 0.3 % brighter for that. With \
         `--offsets mitsuba` rays start where Mitsuba's do, and the picture is Mitsuba's.",
    ),
    ("hdrfilm", "The image is always EXR in 32 bits, with the variance of every pixel; format options have no effect."),
    ("independent", "Numbers are Owen-scrambled Sobol' points whatever the sampler is called."),
    (
        "direct",
        "Direct light is sampled four times a path, whatever the numbers of samples: only noise depends on them.",
    ),
    (
        "emitters",
        "Lights are chosen by how much they may contribute; `sampling_weight`, on which only noise depends, has no effect.",
    ),
];

/// The kinds of plugins, in the page's order.
const KINDS: [(Tag, &str); 9] = [
    (Tag::Shape, "Shapes"),
    (Tag::Bsdf, "BSDFs"),
    (Tag::Texture, "Textures and spectra"),
    (Tag::Emitter, "Emitters"),
    (Tag::Sensor, "Sensors"),
    (Tag::Film, "Films"),
    (Tag::Rfilter, "Pixel filters"),
    (Tag::Sampler, "Samplers"),
    (Tag::Integrator, "Integrators"),
];

/// Scenes named at a parameter, those about its plugin first.
const SCENES_NAMED: usize = 3;

const INTRODUCTION: &str = "\
# Mitsuba's scenes

tilecast reads the scene files of [Mitsuba 3](https://mitsuba.readthedocs.io) and makes the image that Mitsuba makes.
This page is written from the loader's own table: what is not on it is an error that names file and line. Behind each
parameter are [conformance scenes](../tests/conformance/README.md), whose image is tested against Mitsuba's.

Common to all: colours are linear sRGB, as in Mitsuba's `rgb` variants, and spectra are turned into it as there.
`<include>`, `<default>`, `<path>`, `<ref>` and `<alias>` work, and files of versions below 2 are upgraded
(scenes `format-references`, `format-transforms`, `format-version-0.6`).
";

/// Which scenes set which parameters: (tag, plugin) to parameter to scenes; the empty parameter is the plugin itself.
#[derive(Default)]
pub struct Uses(BTreeMap<(String, String), BTreeMap<String, BTreeSet<String>>>);

impl Uses {
    /// Notes what a scene's own file (not what it includes) uses.
    ///
    /// # Errors
    /// Text that is no XML.
    pub fn add(&mut self, scene: &str, text: &str) -> Result<(), roxmltree::Error> {
        let document = roxmltree::Document::parse(text)?;
        for object in document.descendants() {
            let Some(plugin) = object.attribute("type") else { continue };
            // A texture may be written as a spectrum.
            let tag = match object.tag_name().name() {
                "spectrum" => "texture",
                tag => tag,
            };
            let parameters = self.0.entry((tag.to_owned(), plugin.to_owned())).or_default();
            let names = object.children().filter_map(|child| child.attribute("name"));
            for name in names.chain([""]) {
                parameters.entry(name.to_owned()).or_default().insert(scene.to_owned());
            }
        }
        Ok(())
    }

    /// Plugins of the loader's table that no scene uses and that need one.
    pub fn untested(&self) -> Vec<&'static str> {
        let excused = |plugin: &&Plugin| UNTESTED.iter().any(|(name, _)| *name == plugin.name);
        plugins()
            .filter(|plugin| !excused(plugin) && self.of(plugin, "").is_empty())
            .map(|plugin| plugin.name)
            .collect()
    }

    /// The scenes that set a parameter of a plugin, those about the plugin first.
    fn of(&self, plugin: &Plugin, parameter: &str) -> Vec<&str> {
        let key = (plugin.tag().name().to_owned(), plugin.name.to_owned());
        let found = self.0.get(&key).and_then(|uses| uses.get(parameter));
        let mut scenes: Vec<&str> = found.into_iter().flatten().map(String::as_str).collect();
        scenes.sort_by_key(|scene| !scene.contains(plugin.name));
        scenes
    }
}

/// The page's text.
pub fn page(uses: &Uses) -> String {
    let mut text = INTRODUCTION.to_owned();
    for (tag, title) in KINDS {
        text += &format!("\n## {title}\n");
        plugins().filter(|plugin| plugin.tag() == tag).for_each(|plugin| text += &section(plugin, uses));
    }
    text += "\n## Differences\n\nWhere tilecast differs on purpose:\n\n";
    for (plugin, difference) in DIFFERENCES {
        text += &format!("- `{plugin}`: {difference}\n");
    }
    text
}

fn section(plugin: &Plugin, uses: &Uses) -> String {
    let mut text = format!("\n### `{}`\n\n{}", plugin.name, plugin.doc);
    match UNTESTED.iter().find(|(name, _)| *name == plugin.name) {
        Some((_, reason)) => text += &format!(" No scene: {reason}\n"),
        None => text += &format!(" Scenes: {}.\n", listed(&uses.of(plugin, ""))),
    }
    if !plugin.parameters.is_empty() {
        text += "\n| parameter | takes | default | | scenes |\n|---|---|---|---|---|\n";
    }
    for parameter in plugin.parameters {
        let (takes, default) = kind(parameter.takes);
        let (name, scenes) = match parameter.name {
            "" => ("(any name)".to_owned(), String::new()),
            name => (format!("`{name}`"), listed(&uses.of(plugin, name))),
        };
        let meaning = meaning(parameter);
        text += &format!("| {name} | {takes} | {default} | {meaning} | {scenes} |\n");
    }
    text
}

fn meaning(parameter: &Parameter) -> String {
    match parameter.modelled {
        true => parameter.doc.to_owned(),
        false => format!("No effect: {}.", parameter.doc),
    }
}

/// Some of the names, and how many there are besides.
fn listed(scenes: &[&str]) -> String {
    let mut named: Vec<String> = scenes.iter().take(SCENES_NAMED).map(|scene| format!("`{scene}`")).collect();
    if scenes.len() > SCENES_NAMED {
        named.push(format!("{} more", scenes.len() - SCENES_NAMED));
    }
    match named.is_empty() {
        true => "–".to_owned(),
        false => named.join(", "),
    }
}

/// What a parameter takes, and its default; empty if there is none.
fn kind(takes: Takes) -> (String, String) {
    fn shown<T: ToString>(default: Option<T>) -> String {
        default.map_or(String::new(), |value| value.to_string())
    }
    // Colours of light are in W·m⁻²·sr⁻¹ or its like; shares of light lie between 0 and 1.
    let colour = |kind: &str, meaning: Meaning| match meaning {
        Meaning::Reflectance => format!("{kind}, 0 to 1"),
        Meaning::Scalar => "number or texture".to_owned(),
        Meaning::Emission | Meaning::Unbounded => kind.to_owned(),
    };
    match takes {
        Takes::Float(default) => ("number".into(), shown(default.map(rounded))),
        Takes::Integer(default) => ("whole number".into(), shown(default)),
        Takes::Boolean(default) => ("boolean".into(), default.to_string()),
        Takes::Text(default) => ("text".into(), shown(default)),
        Takes::Choice(words) => (words.join(", "), words.first().copied().unwrap_or_default().into()),
        Takes::File => ("file".into(), String::new()),
        Takes::Vector(default) => ("vector".into(), shown(default.map(|v| v.map(|x| x.to_string()).join(", ")))),
        Takes::Transform => ("transform".into(), "none".into()),
        Takes::Colour(default, meaning) => (colour("colour", meaning), rounded(default)),
        Takes::Texture(default, meaning) => (colour("colour or texture", meaning), shown(default.map(rounded))),
        Takes::Ior(default) => ("number or material".into(), default.into()),
        Takes::Child(tag) => (tag.name().into(), String::new()),
    }
}

/// Four digits are enough for people.
fn rounded(value: f64) -> String {
    ((value * 1e4).round() / 1e4).to_string()
}
