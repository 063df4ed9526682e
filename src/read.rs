//! Images from files: OpenEXR by channel name, and what the `image` library reads.

use anyhow::{Context, bail};
use exr::prelude::{AttributeValue, FlatSamples, read_all_flat_layers_from_file};
use std::path::Path;
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
