//! Whether renders and a reference have the same mean: Welch's z, by pixel, by block of pixels, and for the whole image.
//!
//! Both sides know their own error: the renders by their spread, the reference by its variance. So nothing here depends on
//! how noisy a scene is; a noisy one just says less.

use crate::reference::Reference;
use glam::DVec3;
use std::fmt;
use tilecast_core::settings::Filter;

/// |z| of a pixel's channel that counts as agreement: of a perfect match 0.1 % to 0.3 % lie beyond.
const PIXEL_Z: f64 = 3.3;
/// |z| of a block's channel that counts as agreement. Blocks see small errors that cover an area.
const BLOCK_Z: f64 = 4.0;
/// Share of pixels, and of blocks, that must agree. The rest allows for pixels lit by rare events, which are not normal.
const SHARE: f64 = 0.99;
/// Side of a block in pixels.
const BLOCK: usize = 8;
/// Standard errors, and relative difference, by which the means of the whole images may differ.
const MEAN_Z: f64 = 4.0;
const MEAN_DIFFERENCE: f64 = 0.003;
/// The standard error up to which a mean is known: a third of the difference that matters. Where it is larger, the verdict
/// would be left to the noise, and more samples are taken.
const MEAN_ERROR_MAX: f64 = MEAN_DIFFERENCE / 3.0;
/// Where nothing is random, images still differ by rounding: Mitsuba adds 256 samples in f32, and computes exponentials
/// and trigonometric functions to a few units in the last place. An error of this share of the value is not counted.
const ROUNDING: f64 = 3e-5;
/// Mitsuba takes a Gaussian filter from a fitted polynomial that is wrong by up to this, and not zero in the tail: next to
/// something bright such a share of it is not counted.
const GAUSSIAN_FIT: f64 = 4.2e-4;
/// Wide filters spread a sample over several pixels, whose errors then are correlated and do not average out within a
/// block. By the ratio of the filter's integral, squared, to that of its square this is at most π (a Gaussian of ½ pixel).
const SHARED_SAMPLES: f64 = std::f64::consts::PI;

/// Independent renders of a scene, each row by row.
pub struct Renders {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// The images.
    pub images: Vec<Vec<DVec3>>,
}

/// A mean and its variance.
#[derive(Clone, Copy)]
struct Estimate {
    mean: DVec3,
    variance: DVec3,
}

/// How a scene's renders stand to its reference.
pub struct Comparison {
    /// Share of pixels' channels with |z| below [`PIXEL_Z`], and the greatest |z| with its pixel.
    pixels: (f64, f64, (usize, usize)),
    /// Share of blocks' channels with |z| below [`BLOCK_Z`], and the greatest |z|.
    blocks: (f64, f64),
    /// Relative difference of the images' means and its standard error, for the channel where it stands out most.
    mean: (f64, f64),
}

impl Comparison {
    /// Compares images of the same size, made with this filter.
    pub fn new(renders: &Renders, reference: &Reference, filter: Filter) -> Self {
        let Renders { width, height, .. } = *renders;
        let indices = |x0: usize, y0: usize, w: usize, h: usize| -> Vec<usize> {
            (y0..(y0 + h).min(height)).flat_map(|y| (x0..(x0 + w).min(width)).map(move |x| y * width + x)).collect()
        };
        let shared = if filter == Filter::Box { 1.0 } else { SHARED_SAMPLES };
        let reach = filter.radius().ceil() as usize;
        let floor = |i: usize| {
            let (x, y) = ((i % width).saturating_sub(reach), (i / width).saturating_sub(reach));
            let near = || indices(x, y, 2 * reach + 1, 2 * reach + 1).into_iter();
            match filter {
                Filter::Gaussian { .. } => {
                    GAUSSIAN_FIT * near().map(|i| reference.mean[i]).fold(DVec3::ZERO, DVec3::max)
                }
                _ => DVec3::ZERO,
            }
        };
        let both = |pixels: &[usize], shared: f64| {
            (of_renders(&renders.images, pixels), of_reference(reference, pixels, shared))
        };
        let z: Vec<DVec3> = (0..width * height)
            .map(|i| (both(&[i], 1.0), floor(i)))
            .map(|((a, b), floor)| z_score(a, b, floor))
            .collect();
        let corners = (0..height).step_by(BLOCK).flat_map(|y| (0..width).step_by(BLOCK).map(move |x| (x, y)));
        let block_z: Vec<DVec3> = corners
            .map(|(x, y)| both(&indices(x, y, BLOCK, BLOCK), shared))
            .map(|(a, b)| z_score(a, b, DVec3::ZERO))
            .collect();
        let worst = (0..z.len()).max_by(|&a, &b| z[a].max_element().total_cmp(&z[b].max_element())).unwrap_or(0);
        let (ours, theirs) = both(&indices(0, 0, width, height), shared);
        Self {
            pixels: (share_below(&z, PIXEL_Z), z[worst].max_element(), (worst % width, worst / width)),
            blocks: (share_below(&block_z, BLOCK_Z), block_z.iter().map(|z| z.max_element()).fold(0.0, f64::max)),
            mean: difference_of_means(ours, theirs),
        }
    }

    /// Whether the means are known well enough to compare them.
    pub fn knows_the_mean(&self) -> bool {
        self.mean.1 <= MEAN_ERROR_MAX
    }

    /// Whether all three tests are passed.
    pub fn agrees(&self) -> bool {
        let (difference, error) = self.mean;
        self.pixels.0 >= SHARE && self.blocks.0 >= SHARE && difference.abs() <= MEAN_DIFFERENCE + MEAN_Z * error
    }
}

impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ((pixels, pixel_z, (x, y)), (blocks, block_z), (difference, error)) = (self.pixels, self.blocks, self.mean);
        write!(f, "pixels {:.2} % (worst z {pixel_z:.1} at {x}, {y})", 100.0 * pixels)?;
        write!(f, ", blocks {:.1} % (worst z {block_z:.1})", 100.0 * blocks)?;
        write!(f, ", mean {:+.3} % ±{:.3} %", 100.0 * difference, 100.0 * error)
    }
}

/// The mean over some pixels, with the variance that the renders' spread gives it.
fn of_renders(images: &[Vec<DVec3>], pixels: &[usize]) -> Estimate {
    let means: Vec<DVec3> =
        images.iter().map(|image| pixels.iter().map(|&i| image[i]).sum::<DVec3>() / pixels.len() as f64).collect();
    let count = means.len() as f64;
    let mean = means.iter().sum::<DVec3>() / count;
    let squares: DVec3 = means.iter().map(|m| (*m - mean) * (*m - mean)).sum();
    Estimate { mean, variance: squares / (count - 1.0) / count }
}

fn of_reference(reference: &Reference, pixels: &[usize], shared: f64) -> Estimate {
    let count = pixels.len() as f64;
    Estimate {
        mean: pixels.iter().map(|&i| reference.mean[i]).sum::<DVec3>() / count,
        variance: pixels.iter().map(|&i| reference.variance[i]).sum::<DVec3>() * shared / (count * count),
    }
}

/// |z| of each channel, with an error besides the two sides' own; 0 where both sides are equal.
fn z_score(a: Estimate, b: Estimate, besides: DVec3) -> DVec3 {
    let floor = ROUNDING * a.mean.abs().max(b.mean.abs()) + besides;
    let error = (a.variance + b.variance + floor * floor).to_array().map(f64::sqrt);
    let difference = (a.mean - b.mean).abs();
    DVec3::from_array(std::array::from_fn(|c| if difference[c] == 0.0 { 0.0 } else { difference[c] / error[c] }))
}

fn share_below(z: &[DVec3], limit: f64) -> f64 {
    let below: usize = z.iter().map(|z| z.cmplt(DVec3::splat(limit)).bitmask().count_ones() as usize).sum();
    below as f64 / (3 * z.len()) as f64
}

/// Of the channel whose means differ most beyond what is allowed: relative difference and its standard error.
fn difference_of_means(ours: Estimate, theirs: Estimate) -> (f64, f64) {
    let channel = |c: usize| {
        let scale = theirs.mean[c].abs().max(f64::MIN_POSITIVE);
        ((ours.mean[c] - theirs.mean[c]) / scale, (ours.variance[c] + theirs.variance[c]).sqrt() / scale)
    };
    let excess = |(difference, error): (f64, f64)| difference.abs() - MEAN_Z * error;
    (0..3).map(channel).max_by(|a, b| excess(*a).total_cmp(&excess(*b))).unwrap_or((0.0, 0.0))
}
