//! Spectra as objects, `<spectrum type="…">`: the same everywhere, but for daylight on a texture.
//!
//! Values are measured in Mitsuba's `*_rgb` variants; those that Mitsuba cannot render there (`blackbody`, `regular`,
//! `irregular`) become what the same list of wavelengths and values would.

use super::document::Tag;
use super::plugins::{Build, Meaning, Plugin, Takes, child, parameter};
use super::properties::Properties;
use super::textures::of_pairs;
use super::{Loader, spectrum, values};
use crate::load::error::Result;
use crate::scene::{Texture, TextureId};
use glam::DVec3;

const WAVELENGTH_MIN: super::Parameter =
    parameter("wavelength_min", Takes::Float(Some(360.0)), "First wavelength in nm.");
const WAVELENGTH_MAX: super::Parameter =
    parameter("wavelength_max", Takes::Float(Some(830.0)), "Last wavelength in nm.");

pub(crate) const PLUGINS: &[Plugin] = &[
    Plugin {
        name: "uniform",
        doc: "The same value at every wavelength.",
        parameters: &[parameter("value", Takes::Float(None), "The value."), WAVELENGTH_MIN, WAVELENGTH_MAX],
        build: Build::Texture(uniform),
    },
    Plugin {
        name: "d65",
        doc: "Daylight, which is white, times a colour or texture.",
        parameters: &[
            parameter("scale", Takes::Float(Some(1.0)), "Factor."),
            parameter("color", Takes::Texture(Some(1.0), Meaning::Unbounded), "Colour."),
            child(Tag::Texture, "The same as color, under any name."),
        ],
        build: Build::Texture(d65),
    },
    Plugin {
        name: "blackbody",
        doc: "A glowing black body, in W/m²/sr/nm.",
        parameters: &[parameter("temperature", Takes::Float(None), "In kelvins."), WAVELENGTH_MIN, WAVELENGTH_MAX],
        build: Build::Texture(blackbody),
    },
    Plugin {
        name: "regular",
        doc: "Values at wavelengths of equal distances.",
        parameters: &[
            parameter("wavelength_min", Takes::Float(None), "First wavelength in nm."),
            parameter("wavelength_max", Takes::Float(None), "Last wavelength in nm."),
            parameter("values", Takes::Text(None), "A list of numbers."),
        ],
        build: Build::Texture(regular),
    },
    Plugin {
        name: "irregular",
        doc: "Values at wavelengths.",
        parameters: &[
            parameter("wavelengths", Takes::Text(None), "A list of increasing numbers, in nm."),
            parameter("values", Takes::Text(None), "As many numbers."),
        ],
        build: Build::Texture(irregular),
    },
    Plugin {
        name: "srgb",
        doc: "A colour.",
        parameters: &[parameter("color", Takes::Texture(None, Meaning::Unbounded), "Linear sRGB.")],
        build: Build::Texture(srgb),
    },
    Plugin {
        name: "rawconstant",
        doc: "A value that is no colour.",
        parameters: &[parameter("value", Takes::Texture(None, Meaning::Unbounded), "The value.")],
        build: Build::Texture(rawconstant),
    },
];

fn uniform(loader: &mut Loader, properties: &Properties, _: Meaning) -> Result<TextureId> {
    let value = properties.float_in("value", 0.0..=f64::from(f32::MAX), "at least 0")?;
    Ok(loader.assembly.constant(DVec3::splat(value)))
}

fn d65(loader: &mut Loader, properties: &Properties, meaning: Meaning) -> Result<TextureId> {
    let scale = properties.float_in("scale", 0.0..=f64::from(f32::MAX), "at least 0")?;
    let nested = match properties.child(Tag::Texture)? {
        Some(id) => loader.texture_object(id, meaning)?,
        None => loader.texture_as(properties, "color", meaning)?,
    };
    if scale == 1.0 { Ok(nested) } else { Ok(loader.scaled(nested, scale)) }
}

fn blackbody(loader: &mut Loader, properties: &Properties, _: Meaning) -> Result<TextureId> {
    let kelvins = properties.float_in("temperature", f64::MIN_POSITIVE..=1e6, "above 0 and at most 1e6")?;
    let (min, max) = (properties.float("wavelength_min")?, properties.float("wavelength_max")?);
    let pairs: Vec<_> = (360..=830u16).map(f64::from).filter(|nm| (min..=max).contains(nm)).collect();
    if pairs.len() < 2 {
        return Err(properties.wrong("wavelength_min", "no visible wavelength lies between wavelength_min and _max"));
    }
    let pairs: Vec<_> = pairs.into_iter().map(|nm| (nm, planck(nm, kelvins))).collect();
    Ok(loader.assembly.constant(spectrum::emission(&pairs)))
}

/// Radiance of a black body in W·m⁻²·sr⁻¹·nm⁻¹ (Planck's law, with the constants of the SI of 2019).
fn planck(nm: f64, kelvins: f64) -> f64 {
    const PLANCK: f64 = 6.62607015e-34;
    const LIGHT: f64 = 299_792_458.0;
    const BOLTZMANN: f64 = 1.380649e-23;
    let metres = nm * 1e-9;
    let exponent = PLANCK * LIGHT / (metres * BOLTZMANN * kelvins);
    2.0 * PLANCK * LIGHT * LIGHT / libm::pow(metres, 5.0) / libm::expm1(exponent) * 1e-9
}

fn regular(loader: &mut Loader, properties: &Properties, meaning: Meaning) -> Result<TextureId> {
    let (min, max) = (properties.float("wavelength_min")?, properties.float("wavelength_max")?);
    let values = list(properties, "values")?;
    let step = (max - min) / (values.len().max(2) - 1) as f64;
    let wavelengths = (0..values.len()).map(|i| min + step * i as f64).collect();
    of_lists(loader, properties, wavelengths, values, meaning)
}

fn irregular(loader: &mut Loader, properties: &Properties, meaning: Meaning) -> Result<TextureId> {
    let (wavelengths, values) = (list(properties, "wavelengths")?, list(properties, "values")?);
    of_lists(loader, properties, wavelengths, values, meaning)
}

fn list(properties: &Properties, name: &str) -> Result<Vec<f64>> {
    values::numbers(properties.required_text(name)?).map_err(|message| properties.wrong(name, message))
}

fn of_lists(
    loader: &mut Loader,
    properties: &Properties,
    wavelengths: Vec<f64>,
    values: Vec<f64>,
    meaning: Meaning,
) -> Result<TextureId> {
    if wavelengths.len() != values.len() {
        let message = format!("there are {} values for {} wavelengths", values.len(), wavelengths.len());
        return Err(properties.wrong("values", message));
    }
    let pairs = values::check_spectrum(wavelengths.into_iter().zip(values).collect())
        .map_err(|message| properties.wrong("values", message))?;
    let rgb = of_pairs(&pairs, meaning);
    if !rgb.as_vec3().is_finite() {
        return Err(properties.wrong("values", "the values are too large for 32-bit numbers"));
    }
    Ok(loader.assembly.constant(rgb))
}

fn srgb(loader: &mut Loader, properties: &Properties, meaning: Meaning) -> Result<TextureId> {
    loader.texture_as(properties, "color", meaning)
}

fn rawconstant(loader: &mut Loader, properties: &Properties, meaning: Meaning) -> Result<TextureId> {
    loader.texture_as(properties, "value", meaning)
}

impl Loader<'_> {
    /// A texture times a factor. Recursion ends: textures refer only to those before them, as deep as objects may nest.
    fn scaled(&mut self, id: TextureId, factor: f64) -> TextureId {
        match self.assembly.texture_of(id).cloned() {
            Some(Texture::Constant(rgb)) => self.assembly.constant(rgb.as_dvec3() * factor),
            Some(Texture::Checkerboard { color0, color1, to_uv }) => {
                let (color0, color1) = (self.scaled(color0, factor), self.scaled(color1, factor));
                self.assembly.texture(Texture::Checkerboard { color0, color1, to_uv })
            }
            Some(Texture::Bitmap { image, to_uv, filter, wrap, scale }) => {
                let scale = (f64::from(scale) * factor) as f32;
                self.assembly.texture(Texture::Bitmap { image, to_uv, filter, wrap, scale })
            }
            Some(Texture::MeshAttribute { name, scale }) => {
                let scale = (f64::from(scale) * factor) as f32;
                self.assembly.texture(Texture::MeshAttribute { name, scale })
            }
            None => id,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::planck;

    /// Numbers from Mitsuba 3.9.1's `blackbody` in its spectral variant.
    #[test]
    fn black_bodies_glow_as_planck_says() {
        for (nm, expected) in [(400.0, 8743.57), (555.0, 12740.3), (700.0, 11812.0)] {
            assert!((planck(nm, 5000.0) / expected - 1.0).abs() < 1e-5, "{nm} nm: {}", planck(nm, 5000.0));
        }
    }
}
