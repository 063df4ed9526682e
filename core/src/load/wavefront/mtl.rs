//! MTL files: the materials of OBJ files, as plain values. What they become is decided in [`super`].

use crate::load::error::{LoadError, Place, Result, did_you_mean};
use glam::{DVec2, DVec3};
use std::path::PathBuf;

/// A material, with the defaults of the format where it says nothing.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Material {
    pub name: String,
    /// Kd: albedo.
    pub diffuse: Option<DVec3>,
    /// Ks: albedo of the highlight.
    pub specular: DVec3,
    /// Ns: its exponent.
    pub exponent: f64,
    /// Ke: radiance.
    pub emission: DVec3,
    /// Tf: factor on what goes through.
    pub transmission: Option<DVec3>,
    /// Ni: index of refraction.
    pub ior: Option<f64>,
    /// d, or 1 − Tr.
    pub opacity: f64,
    /// The number of an illumination model.
    pub illumination: Option<u32>,
    pub diffuse_map: Option<Map>,
    pub opacity_map: Option<Map>,
}

/// An image over a surface.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Map {
    pub name: String,
    pub place: Place,
    /// The folder of the MTL file, within the scene's.
    pub from: PathBuf,
    pub scale: DVec2,
    pub offset: DVec2,
    pub clamp: bool,
}

/// Statements that are known and have no effect here.
const UNMODELLED: &[&str] = &[
    "Ka",
    "Km",
    "Pr",
    "Pm",
    "Ps",
    "Pc",
    "Pcr",
    "aniso",
    "anisor",
    "sharpness",
    "bump",
    "map_Bump",
    "map_bump",
    "norm",
    "disp",
    "decal",
    "refl",
    "map_Ka",
    "map_Ks",
    "map_Ns",
    "map_Ke",
    "map_Pr",
    "map_Pm",
    "map_Ps",
    "map_aat",
    "map_refl",
    "map_disp",
    "map_Tr",
    "map_Kn",
];
/// Statements that have an effect.
const MODELLED: &[&str] = &["newmtl", "Kd", "Ks", "Ns", "Ke", "Tf", "Ni", "d", "Tr", "illum", "map_Kd", "map_d"];

impl Material {
    pub fn new(name: &str) -> Self {
        Self {
            name: name.into(),
            diffuse: None,
            specular: DVec3::ZERO,
            exponent: 0.0,
            emission: DVec3::ZERO,
            transmission: None,
            ior: None,
            opacity: 1.0,
            illumination: None,
            diffuse_map: None,
            opacity_map: None,
        }
    }
}

/// What an MTL file has.
#[derive(Debug, Default)]
pub(crate) struct Library {
    pub materials: Vec<Material>,
    /// Statements without effect here, each once, with its first place.
    pub unmodelled: Vec<(String, Place)>,
}

/// Reads a file; `name` is for messages, `from` its folder within the scene's.
///
/// # Errors
/// The first line that cannot be read.
pub(crate) fn parse(name: &str, from: &std::path::Path, text: &str) -> Result<Library> {
    let Library { mut materials, mut unmodelled } = Library::default();
    for (i, line) in text.lines().enumerate() {
        let place = || Place::on_line(name, i + 1, line);
        let statement = line.split('#').next().unwrap_or_default().trim();
        let (keyword, rest) = statement.split_once(char::is_whitespace).unwrap_or((statement, ""));
        let rest = rest.trim();
        if keyword.is_empty() {
            continue;
        }
        if keyword == "newmtl" {
            materials.push(Material::new(rest));
            continue;
        }
        if !MODELLED.contains(&keyword) {
            if !unmodelled.iter().any(|(known, _)| known == keyword) {
                unmodelled.push((keyword.into(), place()));
            }
            if UNMODELLED.contains(&keyword) || !materials.is_empty() {
                continue;
            }
        }
        let Some(material) = materials.last_mut() else {
            let hint = did_you_mean(keyword, ["newmtl"]);
            let message = format!("'{keyword}' comes before any 'newmtl'{hint}; is it an MTL file?");
            return Err(LoadError::at(place(), message));
        };
        material.set(keyword, rest, place, from).map_err(|message| LoadError::at(place(), message))?;
    }
    Ok(Library { materials, unmodelled })
}

impl Material {
    fn set(
        &mut self,
        keyword: &str,
        rest: &str,
        place: impl Fn() -> Place,
        from: &std::path::Path,
    ) -> std::result::Result<(), String> {
        match keyword {
            "Kd" => self.diffuse = Some(colour(rest)?),
            "Ks" => self.specular = colour(rest)?,
            "Ke" => self.emission = colour(rest)?,
            "Tf" => self.transmission = Some(colour(rest)?),
            "Ns" => self.exponent = number(rest)?.max(0.0),
            "Ni" => self.ior = Some(number(rest)?),
            "d" => self.opacity = number(rest.trim_start_matches("-halo").trim())?.clamp(0.0, 1.0),
            "Tr" => self.opacity = 1.0 - number(rest)?.clamp(0.0, 1.0),
            "illum" => self.illumination = Some(number(rest)?.clamp(0.0, 100.0) as u32),
            "map_Kd" => self.diffuse_map = map(rest, place(), from)?,
            "map_d" => self.opacity_map = map(rest, place(), from)?,
            _ => {}
        }
        Ok(())
    }
}

fn number(text: &str) -> std::result::Result<f64, String> {
    let word = text.split_whitespace().next().unwrap_or_default();
    let finite = word.parse().ok().filter(|x: &f64| x.is_finite());
    finite.ok_or_else(|| format!("'{word}' is not a finite number"))
}

/// One number for all channels, or three.
fn colour(text: &str) -> std::result::Result<DVec3, String> {
    let words: Vec<&str> = text.split_whitespace().collect();
    let rgb = match words.as_slice() {
        [one] => DVec3::splat(number(one)?),
        [r, g, b, ..] if *r != "spectral" && *r != "xyz" => DVec3::new(number(r)?, number(g)?, number(b)?),
        _ => {
            return Err(format!(
                "'{text}' is no colour; write three numbers (spectral files and xyz are not supported)"
            ));
        }
    };
    match rgb.min_element() >= 0.0 && rgb.as_vec3().is_finite() {
        true => Ok(rgb),
        false => Err(format!("the colour '{text}' has a number below 0 or beyond 3e38")),
    }
}

/// Options, then a file name that may contain blanks.
fn map(text: &str, place: Place, from: &std::path::Path) -> std::result::Result<Option<Map>, String> {
    let mut map =
        Map { name: String::new(), place, from: from.into(), scale: DVec2::ONE, offset: DVec2::ZERO, clamp: false };
    let mut rest = text;
    while rest.starts_with('-') {
        let (option, tail) = split_word(rest);
        rest = tail;
        // Some options take one to three numbers.
        let most = match option {
            "-o" | "-s" | "-t" => 3,
            "-mm" => 2,
            _ => 1,
        };
        let mut values = Vec::new();
        while values.len() < most {
            let (word, tail) = split_word(rest);
            if most == 3 && !values.is_empty() && word.parse::<f64>().is_err() {
                break;
            }
            values.push(word);
            rest = tail;
        }
        let numbers: Vec<f64> = values.iter().map_while(|value| number(value).ok()).collect();
        match (option, numbers.as_slice()) {
            ("-s", [u, rest @ ..]) => map.scale = DVec2::new(*u, rest.first().copied().unwrap_or(1.0)),
            ("-o", [u, rest @ ..]) => map.offset = DVec2::new(*u, rest.first().copied().unwrap_or(0.0)),
            ("-s" | "-o", []) => return Err(format!("'{option}' needs a number")),
            ("-clamp", _) => map.clamp = values.first().is_some_and(|value| *value == "on"),
            _ => {}
        }
    }
    map.name = rest.replace('\\', "/");
    match map.name.is_empty() {
        true => Err("an image file is missing here".into()),
        false => Ok(Some(map)),
    }
}

/// The first word and what follows it.
fn split_word(text: &str) -> (&str, &str) {
    let (word, rest) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
    (word, rest.trim_start())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn materials(text: &str) -> Vec<Material> {
        parse("a.mtl", Path::new(""), text).unwrap().materials
    }

    #[test]
    fn statements_set_the_latest_material() {
        let list = materials(
            "# made by hand\nnewmtl red one\nKd .8 0 0\nKs 0.5\nNs 60\nillum 2\n\nnewmtl glass\nNi 1.5\nTr .25\nTf 1 .9 .8\n",
        );
        assert_eq!((list[0].name.as_str(), list[0].diffuse), ("red one", Some(DVec3::new(0.8, 0.0, 0.0))));
        assert_eq!((list[0].specular, list[0].exponent), (DVec3::splat(0.5), 60.0));
        assert_eq!((list[1].ior, list[1].opacity, list[1].illumination), (Some(1.5), 0.75, None));
        assert_eq!(list[1].transmission, Some(DVec3::new(1.0, 0.9, 0.8)));
    }

    #[test]
    fn maps_have_options_and_names_with_blanks() {
        let list = materials("newmtl a\nmap_Kd -s 2 3 1 -o 0.5 -clamp on -bm 1 wood planks.jpg\n");
        let map = list[0].diffuse_map.clone().unwrap();
        assert_eq!((map.name.as_str(), map.scale, map.clamp), ("wood planks.jpg", DVec2::new(2.0, 3.0), true));
        assert_eq!(map.offset, DVec2::new(0.5, 0.0));
        assert_eq!(materials("newmtl a\nmap_Kd maps\\a.png\n")[0].diffuse_map.as_ref().unwrap().name, "maps/a.png");
    }

    #[test]
    fn what_has_no_effect_is_listed_once() {
        let Library { unmodelled, .. } =
            parse("a.mtl", Path::new(""), "newmtl a\nKa 1 1 1\nPr 0.5\nKa 0 0 0\n").unwrap();
        assert_eq!(unmodelled.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>(), ["Ka", "Pr"]);
    }

    #[test]
    fn each_fault_is_told_with_its_line() {
        for (text, expected) in [
            ("Kd 1 1 1\n", "a.mtl:1:1: 'Kd' comes before any 'newmtl'"),
            ("hello\n", "is it an MTL file?"),
            ("newmtl a\nKd 1 x 1\n", "a.mtl:2:1: 'x' is not a finite number"),
            ("newmtl a\nKd spectral a.rfl\n", "spectral files"),
            ("newmtl a\nKd -1 0 0\n", "below 0"),
            ("newmtl a\nNi nan\n", "'nan' is not"),
            ("newmtl a\nmap_Kd -s 2\n", "an image file is missing"),
        ] {
            let message = parse("a.mtl", Path::new(""), text).unwrap_err().to_string();
            assert!(message.contains(expected), "{text:?}: {message}");
        }
    }
}
