//! What the properties of vertices and faces mean: positions, normals, texture coordinates, attributes, named as Mitsuba
//! names them.

use super::payload::Rows;
use crate::scene::{Attribute, AttributeValues};
use glam::Vec3;
use ply_rs_bw::ply::{ElementDef, PropertyType};

/// Properties by their meaning, as indices into an element's.
pub struct Columns {
    pub position: Option<[usize; 3]>,
    pub normal: Option<[usize; 3]>,
    pub uv: Option<[usize; 2]>,
    /// All attributes there are.
    pub attributes: Vec<Channels>,
}

/// An attribute and where its channels are.
#[derive(Clone)]
pub struct Channels {
    /// As a scene calls it, `vertex_color`.
    pub name: String,
    /// One or three.
    properties: Vec<usize>,
}

/// What the channels of an attribute may be called, behind `name_`; colours get `_color` behind their name.
const POSTFIXES: [[&str; 4]; 4] =
    [["x", "y", "z", "w"], ["0", "1", "2", "3"], ["1", "2", "3", "4"], ["r", "g", "b", "a"]];

impl Columns {
    /// Of an element whose attributes' names begin with `prefix`.
    pub fn of(element: &ElementDef, prefix: &str) -> Self {
        let names: Vec<&str> = element
            .properties
            .iter()
            .map(|(name, property)| match property.data_type {
                PropertyType::Scalar(_) => name.as_str(),
                PropertyType::List(..) => "",
            })
            .collect();
        let find = |names_of_one: &[&str]| names.iter().position(|name| names_of_one.contains(name));
        let all = |wanted: [&[&str]; 3]| Some([find(wanted[0])?, find(wanted[1])?, find(wanted[2])?]);
        let (position, normal) = (all([&["x"], &["y"], &["z"]]), all([&["nx"], &["ny"], &["nz"]]));
        let u = find(&["u", "s", "texture_u", "texture_s"]);
        let uv = u.and_then(|u| Some([u, find(&["v", "t", "texture_v", "texture_t"])?]));
        let colour = all([&["r"], &["g"], &["b"]]).or_else(|| all([&["red"], &["green"], &["blue"]]));
        let mut attributes: Vec<Channels> = colour
            .map(|rgb| Channels { name: format!("{prefix}color"), properties: rgb.to_vec() })
            .into_iter()
            .collect();
        let taken: Vec<usize> =
            [position, normal, colour].into_iter().flatten().flatten().chain(uv.into_iter().flatten()).collect();
        let free = (0..names.len()).filter(|i| !taken.contains(i));
        attributes.extend(others(&names, free, prefix));
        Self { position, normal, uv, attributes }
    }

    /// The attributes that are named in `wanted`.
    pub fn wanted(&self, wanted: &[String]) -> Vec<Channels> {
        self.attributes.iter().filter(|channels| wanted.contains(&channels.name)).cloned().collect()
    }

    /// The properties that are read with these attributes.
    pub fn numbers(&self, channels: &[Channels]) -> Vec<usize> {
        let known = [self.position, self.normal].into_iter().flatten().flatten().chain(self.uv.into_iter().flatten());
        known.chain(channels.iter().flat_map(|channels| channels.properties.iter().copied())).collect()
    }
}

/// Attributes of properties `name_x`, `name_y`, `name_z` in a row, or of the first of them alone. A fourth channel is opacity,
/// which is no part of a colour.
fn others(names: &[&str], free: impl Iterator<Item = usize>, prefix: &str) -> Vec<Channels> {
    let mut runs: Vec<(&str, usize, Vec<usize>)> = Vec::new();
    for i in free {
        let Some((stem, postfix)) = names[i].rsplit_once('_') else { continue };
        if let Some((last, kind, run)) = runs.last_mut()
            && *last == stem
            && run.last() == Some(&(i - 1))
            && POSTFIXES[*kind].get(run.len()) == Some(&postfix)
        {
            run.push(i);
        } else if let Some(kind) = POSTFIXES.iter().position(|of_kind| of_kind[0] == postfix) {
            runs.push((stem, kind, vec![i]));
        }
    }
    let named = |(stem, kind, mut properties): (&str, usize, Vec<usize>)| {
        let colour = if POSTFIXES[kind][0] == "r" { "_color" } else { "" };
        properties.truncate(3);
        (properties.len() != 2).then(|| Channels { name: format!("{prefix}{stem}{colour}"), properties })
    };
    runs.into_iter().filter_map(named).collect()
}

impl Channels {
    /// The attribute with the values of all rows.
    pub fn attribute(&self, rows: &Rows) -> Attribute {
        let values = match *self.properties {
            [r, g, b] => AttributeValues::Colours(
                rows.collect(|row| Vec3::new(row.get(r) as f32, row.get(g) as f32, row.get(b) as f32)),
            ),
            _ => AttributeValues::Scalars(rows.collect(|row| row.get(self.properties[0]) as f32)),
        };
        Attribute { name: self.name.clone(), values }
    }
}
