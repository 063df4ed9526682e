//! Images from files: OpenEXR by channel name, and what the `image` library reads.

use crate::exr::CHANNELS;
use anyhow::{Context, bail};
use exr::prelude::{AttributeValue, FlatSamples, read_all_flat_layers_from_file};
use std::path::Path;
use tilecast_core::film::Estimate;
use tilecast_core::settings::Settings;
use tilecast_measure::image::{Image, Variance};

/// Channels that a colour image has.
const COLOURS: [&str; 3] = ["R", "G", "B"];
/// Channels that say how sure of itself it is.
const VARIANCES: [&str; 3] = ["Variance.R", "Variance.G", "Variance.B"];
/// The attribute by which an image says how its variances were estimated.
pub const REPLICATES_ATTRIBUTE: &str = "tilecast:replicates";

/// Reads an image. Blocks.
///
/// # Errors
/// No such file, another format, or channels that are missing.
pub fn image(path: &Path) -> anyhow::Result<Image> {
    let is_exr = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr"));
    let read = if is_exr { exr(path) } else { other(path) };
    read.with_context(|| format!("cannot read {}", path.display()))
}

fn exr(path: &Path) -> anyhow::Result<Image> {
    let file = read_all_flat_layers_from_file(path)?;
    let Some(layer) = file.layer_data.iter().find(|layer| layer.channel_data.list.iter().any(|c| c.name.eq("R")))
    else {
        let names: Vec<String> =
            file.layer_data.iter().flat_map(|l| &l.channel_data.list).map(|c| c.name.to_string()).collect();
        bail!("it has no channels R, G, B, but {}", names.join(", "));
    };
    let (width, height) = (layer.size.0, layer.size.1);
    let planes = |names: [&str; 3]| -> Option<Vec<[f32; 3]>> {
        let plane = |name: &str| layer.channel_data.list.iter().find(|c| c.name.eq(name)).map(|c| &c.sample_data);
        let planes = [plane(names[0])?, plane(names[1])?, plane(names[2])?];
        Some((0..width * height).map(|i| planes.map(|plane| value(plane, i))).collect())
    };
    let rgb = planes(COLOURS).with_context(|| format!("one of its channels {} is missing", COLOURS.join(", ")))?;
    let replicates = layer.attributes.other.iter().find(|(name, _)| **name == *REPLICATES_ATTRIBUTE);
    let freedom = replicates.and_then(|(_, value)| match value {
        AttributeValue::Text(text) => text.to_string().parse::<u32>().ok()?.checked_sub(1),
        _ => None,
    });
    let variance = planes(VARIANCES).map(|rgb| Variance { rgb, freedom });
    Ok(Image { name: path.display().to_string(), width, height, rgb, variance })
}

/// What an image of ours says of itself, and its bits.
pub struct Proof {
    /// Digest of its scene, as text.
    pub scene: String,
    /// Settings.
    pub settings: Settings,
    /// The tracer's version.
    pub engine: String,
    /// Digest of its film, likewise.
    pub digest: String,
    /// Its sample ranges, as text.
    pub samples: String,
    /// See [`crate::exr`]'s channels, in that order; row by row.
    planes: [Vec<f32>; 7],
}

impl Proof {
    /// Changes the last bit of a value; again, and it is as before.
    #[cfg(test)]
    pub fn flip(&mut self, x: u32, y: u32, plane: usize) {
        let crop = self.settings.film.crop;
        let value = &mut self.planes[plane][(y - crop.y0) as usize * crop.width() as usize + (x - crop.x0) as usize];
        // A count of 4 and one more in the last place are different numbers of samples only if the last place is 1.
        *value = if plane == 6 { 9.0 - *value } else { f32::from_bits(value.to_bits() ^ 1) };
    }

    /// A pixel of it, in the coordinates of the whole picture.
    pub fn pixel(&self, x: u32, y: u32) -> Estimate {
        let crop = self.settings.film.crop;
        let at = (y - crop.y0) as usize * crop.width() as usize + (x - crop.x0) as usize;
        let [r, g, b, vr, vg, vb, count] = &self.planes;
        Estimate { mean: [r[at], g[at], b[at]], variance: [vr[at], vg[at], vb[at]], count: f64::from(count[at]) as u64 }
    }
}

/// Reads an image of ours with what it says of itself. Blocks.
///
/// # Errors
/// One that is none, or lacks something.
pub fn proof(path: &Path) -> anyhow::Result<Proof> {
    read_proof(path).with_context(|| format!("{} is no image that tilecast can verify", path.display()))
}

fn read_proof(path: &Path) -> anyhow::Result<Proof> {
    let file = read_all_flat_layers_from_file(path)?;
    let layer = file.layer_data.first().context("it has no layer")?;
    let text = |name: &str| {
        let found = layer.attributes.other.iter().find(|(key, _)| **key == *name);
        match found {
            Some((_, AttributeValue::Text(text))) => Ok(text.to_string()),
            _ => bail!("it lacks the attribute {name}"),
        }
    };
    let settings: Settings = serde_json::from_str(&text("tilecast:settings")?).context("its settings make no sense")?;
    settings.validate()?;
    let crop = settings.film.crop;
    if (layer.size.0, layer.size.1) != (crop.width() as usize, crop.height() as usize) {
        bail!("its size is not that of its settings");
    }
    let planes = CHANNELS.map(|(name, _)| {
        let channel = layer.channel_data.list.iter().find(|channel| channel.name.eq(name));
        match channel.map(|channel| &channel.sample_data) {
            Some(FlatSamples::F32(values)) => Ok(values.clone()),
            _ => Err(anyhow::anyhow!("it lacks the channel {name}, or that is not of 32 bits")),
        }
    });
    let [r, g, b, vr, vg, vb, count] = planes;
    Ok(Proof {
        scene: text("tilecast:scene")?,
        digest: text("tilecast:digest")?,
        engine: text("tilecast:engine")?,
        samples: text("tilecast:samples")?,
        planes: [r?, g?, b?, vr?, vg?, vb?, count?],
        settings,
    })
}

fn value(samples: &FlatSamples, i: usize) -> f32 {
    match samples {
        FlatSamples::F16(values) => values[i].to_f32(),
        FlatSamples::F32(values) => values[i],
        FlatSamples::U32(values) => values[i] as f32,
    }
}

/// PNG and its like are encoded for displays; HDR files are linear.
fn other(path: &Path) -> anyhow::Result<Image> {
    let decoded = image::ImageReader::open(path)?.with_guessed_format()?.decode()?;
    let linear = matches!(decoded, image::DynamicImage::ImageRgb32F(_) | image::DynamicImage::ImageRgba32F(_));
    let rgb = decoded.to_rgb32f();
    let (width, height) = (rgb.width() as usize, rgb.height() as usize);
    let value = |v: f32| if linear { v } else { tilecast_measure::srgb_to_linear(v) };
    let rgb = rgb.pixels().map(|p| p.0.map(value)).collect();
    Ok(Image { name: path.display().to_string(), width, height, rgb, variance: None })
}
