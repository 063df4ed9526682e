//! Colours, spectra and textures.

use super::Loader;
use super::document::{ObjectId, Property, Value};
use super::plugins::{Build, Meaning, Plugin, Takes, parameter, unmodelled};
use super::properties::Properties;
use super::{spectrum, values};
use crate::load::assembly::ShownAttribute;
use crate::load::error::Result;
use crate::load::folder::TEXT_BYTES_MAX;
use crate::load::image;
use crate::scene::{Attribute, FilterType, Texture, TextureId, WrapMode};
use glam::{Affine2, DVec3, Mat2, Vec2};

pub(crate) const PLUGINS: &[Plugin] = &[
    Plugin {
        name: "bitmap",
        doc: "An image: PNG, JPEG, TGA, HDR or EXR.",
        parameters: &[
            parameter("filename", Takes::File, "The image."),
            parameter("filter_type", Takes::Choice(&["bilinear", "nearest"]), "Between texels."),
            parameter("wrap_mode", Takes::Choice(&["repeat", "mirror", "clamp"]), "Beyond the unit square."),
            parameter("raw", Takes::Boolean(false), "Take values as they are, not decoded from sRGB."),
            parameter("to_uv", Takes::Transform, "Applied to the surface's texture coordinates first."),
            unmodelled("format", Takes::Choice(&["auto", "variant", "float16", "uint8"]), "images keep all their bits"),
            unmodelled("accel", Takes::Boolean(true), "there is no hardware to accelerate"),
        ],
        build: Build::Texture(bitmap),
    },
    Plugin {
        name: "checkerboard",
        doc: "Squares of half a unit.",
        parameters: &[
            parameter("color0", Takes::Texture(Some(0.4), Meaning::Reflectance), "Of the square at the origin."),
            parameter("color1", Takes::Texture(Some(0.2), Meaning::Reflectance), "Of its neighbours."),
            parameter("to_uv", Takes::Transform, "Applied to the surface's texture coordinates first."),
        ],
        build: Build::Texture(checkerboard),
    },
    Plugin {
        name: "mesh_attribute",
        doc: "Values that a mesh has at its vertices or on its faces; only PLY files have them.",
        parameters: &[
            parameter("name", Takes::Text(None), "The attribute's name; it begins with `vertex_` or `face_`."),
            parameter("scale", Takes::Float(Some(1.0)), "Factor on every value."),
        ],
        build: Build::Texture(mesh_attribute),
    },
];

impl Loader<'_> {
    /// The texture that a parameter is set to, or its default.
    pub fn texture(&mut self, properties: &Properties, name: &str) -> Result<TextureId> {
        let Takes::Texture(_, meaning) = properties.takes(name) else {
            return self.colour(properties, name).map(|rgb| self.assembly.constant(rgb));
        };
        self.texture_as(properties, name, meaning)
    }

    /// Likewise, whatever it means there: a checkerboard's colours mean what the checkerboard means.
    pub fn texture_as(&mut self, properties: &Properties, name: &str, meaning: Meaning) -> Result<TextureId> {
        match properties.get(name).map(|p| &p.value) {
            Some(Value::Object(id)) => self.texture_object(*id, meaning),
            _ => self.colour_as(properties, name, meaning).map(|rgb| self.assembly.constant(rgb)),
        }
    }

    /// The texture that an object describes, made once for each kind of use.
    pub fn texture_object(&mut self, id: ObjectId, meaning: Meaning) -> Result<TextureId> {
        let key = (id, meaning == Meaning::Scalar);
        if let Some(known) = self.textures.get(&key) {
            return Ok(*known);
        }
        let document = self.document;
        let properties = Properties::new(document, id, &mut self.assembly.notes)?;
        let texture = match properties.plugin.build {
            Build::Texture(build) => build(self, &properties, meaning)?,
            _ => return Err(super::misplaced(&properties)),
        };
        self.made.insert(id);
        self.textures.insert(key, texture);
        Ok(texture)
    }

    /// The colour that a parameter is set to, or its default.
    pub fn colour(&mut self, properties: &Properties, name: &str) -> Result<DVec3> {
        let meaning = match properties.takes(name) {
            Takes::Colour(_, meaning) | Takes::Texture(_, meaning) => meaning,
            _ => Meaning::Unbounded,
        };
        self.colour_as(properties, name, meaning)
    }

    fn colour_as(&mut self, properties: &Properties, name: &str, meaning: Meaning) -> Result<DVec3> {
        let Some(property) = properties.get(name) else {
            return match properties.takes(name) {
                Takes::Colour(default, _) | Takes::Texture(Some(default), _) => Ok(DVec3::splat(default)),
                _ => Err(properties.missing(name)),
            };
        };
        let rgb = match &property.value {
            Value::Object(id) => {
                let texture = self.texture_object(*id, meaning)?;
                match self.assembly.texture_of(texture) {
                    Some(Texture::Constant(rgb)) => return Ok(rgb.as_dvec3()),
                    _ => {
                        let message = format!("'{name}' must be the same everywhere: a colour or a spectrum");
                        return Err(properties.error(&property.span, message));
                    }
                }
            }
            Value::SpectrumFile(file) => {
                let pairs = self.spectrum_file(file, properties, property)?;
                // Mitsuba takes spectra of files without daylight where they are no reflectances.
                match meaning {
                    Meaning::Reflectance => of_pairs(&pairs, meaning),
                    _ => spectrum::emission(&pairs),
                }
            }
            value => of_value(value, meaning),
        };
        let rgb = if meaning == Meaning::Scalar { DVec3::splat(spectrum::luminance(rgb)) } else { rgb };
        let is_rgb = matches!(property.value, Value::Rgb(_));
        if meaning == Meaning::Reflectance && is_rgb && (rgb.min_element() < 0.0 || rgb.max_element() > 1.0) {
            let message = format!("'{name}' is a share of light: each of its numbers must lie between 0 and 1");
            return Err(properties.error(&property.span, message));
        }
        if rgb.min_element() < 0.0 {
            let message = format!("'{name}' must not be negative");
            return Err(properties.error(&property.span, message));
        }
        match rgb.as_vec3().is_finite() {
            true => Ok(rgb),
            false => Err(properties.error(&property.span, format!("'{name}' is too large for 32-bit numbers"))),
        }
    }

    fn spectrum_file(&self, file: &str, properties: &Properties, property: &Property) -> Result<Vec<(f64, f64)>> {
        let path = self.locate(file, &property.span)?;
        let fail = |message: String| properties.error(&property.span, message);
        let bytes = self.assembly.folder.read(&path, TEXT_BYTES_MAX).map_err(fail)?;
        values::spectrum_file(&String::from_utf8_lossy(&bytes)).map_err(|m| {
            fail(format!("the spectrum file '{}' cannot be used: {m}", self.assembly.folder.name_of(&path)))
        })
    }
}

/// Linear sRGB of a colour or spectrum; black of anything else, which the table's check lets not come here.
fn of_value(value: &Value, meaning: Meaning) -> DVec3 {
    match value {
        Value::Rgb(rgb) => *rgb,
        Value::Float(x) => DVec3::splat(*x),
        Value::Integer(i) => DVec3::splat(*i as f64),
        Value::FlatSpectrum(x) if meaning == Meaning::Emission => spectrum::flat_emission(*x),
        Value::FlatSpectrum(x) => DVec3::splat(*x),
        Value::Spectrum(pairs) => of_pairs(pairs, meaning),
        _ => DVec3::ZERO,
    }
}

/// Linear sRGB of wavelengths in nm, increasing, and values.
pub(crate) fn of_pairs(pairs: &[(f64, f64)], meaning: Meaning) -> DVec3 {
    match meaning {
        Meaning::Emission => spectrum::emission(pairs),
        Meaning::Reflectance => spectrum::under_daylight(pairs).min(DVec3::ONE),
        Meaning::Unbounded | Meaning::Scalar => spectrum::under_daylight(pairs),
    }
}

fn bitmap(loader: &mut Loader, properties: &Properties, meaning: Meaning) -> Result<TextureId> {
    let (name, span) = properties.file("filename")?;
    let path = loader.locate(name, span)?;
    let usage = image::Use { raw: properties.boolean("raw"), scalar: meaning == Meaning::Scalar };
    let image = loader.assembly.image(path, usage, loader.document.place(span));
    let texture = Texture::Bitmap {
        image,
        to_uv: to_uv(properties)?,
        filter: [FilterType::Bilinear, FilterType::Nearest][properties.choice("filter_type")?],
        wrap: [WrapMode::Repeat, WrapMode::Mirror, WrapMode::Clamp][properties.choice("wrap_mode")?],
        scale: 1.0,
    };
    Ok(loader.assembly.texture(texture))
}

fn checkerboard(loader: &mut Loader, properties: &Properties, meaning: Meaning) -> Result<TextureId> {
    let mut color0 = loader.texture_as(properties, "color0", meaning)?;
    let mut color1 = loader.texture_as(properties, "color1", meaning)?;
    if meaning == Meaning::Scalar {
        // Mitsuba 3.9 has the two the other way round where it wants one number.
        std::mem::swap(&mut color0, &mut color1);
    }
    let to_uv = to_uv(properties)?;
    Ok(loader.assembly.texture(Texture::Checkerboard { color0, color1, to_uv }))
}

fn mesh_attribute(loader: &mut Loader, properties: &Properties, meaning: Meaning) -> Result<TextureId> {
    let name = properties.required_text("name")?;
    if ![Attribute::AT_VERTICES, Attribute::ON_FACES].iter().any(|prefix| name.starts_with(prefix)) {
        let message = format!("'{name}' is no name of an attribute: it must begin with vertex_ or face_");
        return Err(properties.wrong("name", message));
    }
    let place = loader.document.place(properties.get("name").map_or(&properties.object.span, |p| &p.span));
    loader.assembly.shown_attributes.push(ShownAttribute {
        name: name.to_owned(),
        is_number: meaning == Meaning::Scalar,
        place,
    });
    let scale = properties.float("scale")? as f32;
    Ok(loader.assembly.texture(Texture::MeshAttribute { name: name.to_owned(), scale }))
}

/// The upper left of the 3D transformation that a scene file has.
fn to_uv(properties: &Properties) -> Result<Affine2> {
    let m = properties.transform("to_uv")?;
    let column = |v: DVec3| Vec2::new(v.x as f32, v.y as f32);
    let matrix = Mat2::from_cols(column(m.matrix3.x_axis), column(m.matrix3.y_axis));
    Ok(Affine2::from_mat2_translation(matrix, column(m.translation)))
}
