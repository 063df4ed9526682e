//! `tilecast compare A B`: how far an image is from a reference, and whether chance explains it.

use crate::output::{replace, writable};
use crate::{read, report};
use anyhow::{Context, bail};
use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use serde::Serialize;
use std::path::{Path, PathBuf};
use tilecast_measure::image::{Image, comparable};
use tilecast_measure::metrics::{FlipMeans, Metrics, flip_means, metrics};
use tilecast_measure::ztest::{Bias, Source, ZTest, bias, ztest};

/// What to compare.
pub struct Compare {
    /// An image.
    pub image: PathBuf,
    /// What it should be.
    pub reference: PathBuf,
    /// Where to draw the signed difference.
    pub difference: Option<PathBuf>,
    /// As JSON.
    pub json: bool,
}

/// The share of values that the difference picture shows without clipping.
const SHOWN: f64 = 0.99;

/// What is found.
#[derive(Serialize)]
struct Findings {
    image: String,
    reference: String,
    width: usize,
    height: usize,
    mse: f64,
    relmse: f64,
    mae: f64,
    /// `None` for equal images.
    psnr_db: Option<f64>,
    flip_ldr: f64,
    flip_hdr: f64,
    bias: [BiasFindings; 3],
    bias_interval_from: &'static str,
    ztest: Option<ZFindings>,
    /// Images without variances, which cannot be tested.
    without_variances: Vec<String>,
}

#[derive(Serialize)]
struct BiasFindings {
    channel: char,
    difference: f64,
    interval_95: f64,
    relative: Option<f64>,
    p: f64,
}

#[derive(Serialize)]
struct ZFindings {
    tested: usize,
    certain_and_different: usize,
    within_95: f64,
    smallest_p: f64,
    allowed_p: f64,
    rms: f64,
    differs: bool,
}

/// Compares and tells.
///
/// # Errors
/// Files that cannot be read, or images that cannot be compared.
pub async fn run(Compare { image, reference, difference, json }: Compare) -> anyhow::Result<()> {
    let difference = difference.map(writable).transpose()?;
    let found = tokio::task::spawn_blocking(move || {
        let (image, reference) = (read::image(&image)?, read::image(&reference)?);
        comparable(&image, &reference)?;
        if let Some(path) = difference {
            draw_difference(&image, &reference, &path)?;
        }
        anyhow::Ok(findings(&image, &reference))
    });
    let found = found.await.context("comparing panicked")??;
    if json {
        report::print(&found);
    } else {
        print!("{}", text(&found));
    }
    Ok(())
}

fn findings(image: &Image, reference: &Image) -> Findings {
    let Metrics { mse, relmse, mae, psnr } = metrics(image, reference);
    let FlipMeans { ldr, hdr } = flip_means(image, reference);
    let (biases, source) = bias(image, reference);
    let channel = |(channel, Bias { difference, interval, relative, p }): (char, Bias)| BiasFindings {
        channel,
        difference,
        interval_95: interval,
        relative: relative.is_finite().then_some(relative),
        p,
    };
    let unsure = [image, reference].into_iter().filter(|image| image.variance.is_none());
    Findings {
        image: image.name.clone(),
        reference: reference.name.clone(),
        width: reference.width,
        height: reference.height,
        mse,
        relmse,
        mae,
        psnr_db: psnr.is_finite().then_some(psnr),
        flip_ldr: ldr,
        flip_hdr: hdr,
        bias: [0, 1, 2].map(|c| channel((['R', 'G', 'B'][c], biases[c]))),
        bias_interval_from: match source {
            Source::Variances => "variances",
            Source::Spread => "spread",
        },
        ztest: ztest(image, reference).map(z_findings),
        without_variances: unsure.map(|image| image.name.clone()).collect(),
    }
}

fn z_findings(test: ZTest) -> ZFindings {
    let differs = test.differs();
    let ZTest { tested, certain_and_different, within, smallest_p, allowed_p, rms } = test;
    ZFindings { tested, certain_and_different, within_95: within, smallest_p, allowed_p, rms, differs }
}

fn text(found: &Findings) -> String {
    let Findings { image, reference, width, height, mse, relmse, mae, flip_ldr, flip_hdr, .. } = found;
    let psnr = found.psnr_db.map_or_else(|| "infinite".to_owned(), |db| format!("{db:.2} dB"));
    let mut lines = vec![
        format!("{image} against {reference}, {width}x{height} pixels"),
        format!("MSE     {mse:.6e}"),
        format!("relMSE  {relmse:.6e}"),
        format!("MAE     {mae:.6e}"),
        format!("PSNR    {psnr}"),
        format!("FLIP    {flip_ldr:.6} as displayed (LDR), {flip_hdr:.6} over all exposures (HDR)"),
    ];
    for BiasFindings { channel, difference, interval_95, relative, p } in &found.bias {
        let relative = relative.map_or_else(String::new, |r| format!(", {:+.4} % of the mean", 100.0 * r));
        lines.push(format!("bias {channel}  {difference:+.4e} ± {interval_95:.1e}{relative}, p = {p:.3}"));
    }
    lines.push(match found.bias_interval_from {
        "variances" => "        95 % intervals, from the images' variances".to_owned(),
        _ => "        95 % intervals, from the spread of the differences over the pixels".to_owned(),
    });
    lines.push(match &found.ztest {
        None => format!("z-test  not possible: no Variance channels in {}", found.without_variances.join(" and ")),
        Some(z) => format!(
            "z-test  {:.2} % of {} values within their 95 % intervals, smallest p {:.2e} (allowed {:.2e}), rms z {:.3}: {}",
            100.0 * z.within_95,
            z.tested,
            z.smallest_p,
            z.allowed_p,
            z.rms,
            if z.differs { "the images differ by more than chance" } else { "chance explains the differences" }
        ),
    });
    lines.push(String::new());
    lines.join("\n")
}

/// Red where the image is brighter than the reference, blue where it is darker, white where they are equal; the mean over the
/// channels. Full colour is the difference that 99 % of the pixels stay below.
fn draw_difference(image: &Image, reference: &Image, path: &Path) -> anyhow::Result<()> {
    let pairs = image.rgb.iter().zip(&reference.rgb);
    let differences: Vec<f32> = pairs.map(|(a, b)| (0..3).map(|c| a[c] - b[c]).sum::<f32>() / 3.0).collect();
    let mut sizes: Vec<f32> = differences.iter().map(|d| d.abs()).collect();
    sizes.sort_unstable_by(f32::total_cmp);
    let full = sizes[((sizes.len() - 1) as f64 * SHOWN) as usize];
    let full = if full > 0.0 { full } else { sizes.last().copied().unwrap_or(0.0).max(f32::MIN_POSITIVE) };
    let bytes: Vec<u8> = differences.iter().flat_map(|d| colour(d / full)).collect();
    let [width, height] = [reference.width, reference.height].map(u32::try_from);
    let (Ok(width), Ok(height)) = (width, height) else { bail!("the images are too large for a PNG") };
    let draw = |file: &mut _| Ok(PngEncoder::new(file).write_image(&bytes, width, height, ExtendedColorType::Rgb8)?);
    replace(path, draw).with_context(|| format!("cannot write {}", path.display()))?;
    eprintln!("wrote {}: full colour is a difference of {full:.3e}, red where the image is brighter", path.display());
    Ok(())
}

/// −1 blue, 0 white, 1 red.
fn colour(difference: f32) -> [u8; 3] {
    let fade = |by: f32| ((1.0 - by.clamp(0.0, 1.0)) * 255.0).round() as u8;
    let others = fade(difference.abs());
    if difference > 0.0 { [255, others, others] } else { [others, others, 255] }
}

#[cfg(test)]
mod tests {
    use super::colour;

    #[test]
    fn brighter_is_red_and_darker_blue() {
        assert_eq!([-2.0, -1.0, 0.0, 1.0].map(colour), [[0, 0, 255], [0, 0, 255], [255; 3], [255, 0, 0]]);
    }
}
