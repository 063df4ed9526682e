//! FLIP: how different two images look when one is flipped over the other.
//!
//! LDR: Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström & Fairchild 2020, "FLIP: A Difference Evaluator for Alternating
//! Images". HDR: Andersson, Nilsson, Shirley & Akenine-Möller 2021, "Visualizing Errors in Rendered High Dynamic Range Images":
//! the worst LDR-FLIP over a range of exposures, tone-mapped by ACES. Numbers are those of the papers; the tests compare with
//! the authors' program. Maps are 0 (equal) to 1, row by row.

use crate::flip_colour::{from_ycxcz, hyab, luminance, to_hunt_lab, to_ycxcz};
use rayon::prelude::*;
use std::f32::consts::PI;

/// Pixels a degree: 0.7 m before a 0.7 m wide display of 3840 pixels.
const PIXELS_PER_DEGREE: f32 = 0.7 * (3840.0 / 0.7) * (PI / 180.0);
/// Exponents and knee of the colour difference.
const COLOUR_EXPONENT: f32 = 0.7;
const KNEE_IN: f32 = 0.4;
const KNEE_OUT: f32 = 0.95;
/// Width of the features (edges and points) that the eye sees, in degrees, and the exponent of their difference.
const FEATURE_WIDTH: f32 = 0.082;
const FEATURE_EXPONENT: f32 = 0.5;
/// Contrast sensitivity of each channel of YCxCz: (weight, width) of two Gaussians.
const SENSITIVITY: [[(f32, f32); 2]; 3] =
    [[(1.0, 0.0047), (0.0, 1e-5)], [(1.0, 0.0053), (0.0, 1e-5)], [(34.1, 0.04), (13.5, 0.025)]];
/// The luminance that tone mapping should make of the brightest pixel at the first exposure, of the median at the last.
const EXPOSED: f32 = 0.85;

type Pixels = Vec<[f32; 3]>;

/// Differences as displayed: linear sRGB, clamped to 0…1.
pub fn ldr(size: [usize; 2], reference: &[[f32; 3]], test: &[[f32; 3]]) -> Vec<f32> {
    let seen = |image: &[[f32; 3]]| image.iter().map(|v| to_ycxcz(v.map(|v| v.clamp(0.0, 1.0)))).collect::<Pixels>();
    let (reference, test) = (seen(reference), seen(test));
    let colour = colour_differences(&sensed(size, &reference), &sensed(size, &test));
    let feature = feature_differences(size, &reference, &test);
    colour.iter().zip(feature).map(|(&colour, feature)| libm::powf(colour, 1.0 - feature)).collect()
}

/// The largest difference over all exposures at which the reference shows something. Negative light is taken for none.
pub fn hdr(size: [usize; 2], reference: &[[f32; 3]], test: &[[f32; 3]]) -> Vec<f32> {
    let (start, stop) = exposures(reference);
    let count = ((stop - start).ceil() as i32).max(2);
    let step = (stop - start) / (count - 1) as f32;
    (0..count)
        .map(|i| {
            let gain = libm::exp2f(start + i as f32 * step);
            let shown =
                |image: &[[f32; 3]]| image.iter().map(|v| v.map(|v| aces(v.max(0.0) * gain))).collect::<Pixels>();
            ldr(size, &shown(reference), &shown(test))
        })
        .reduce(|mut worst, map| {
            worst.iter_mut().zip(map).for_each(|(w, v)| *w = w.max(v));
            worst
        })
        .unwrap_or_default()
}

/// The coefficients of the ACES curve (Narkowicz 2015, with 0.6 as the exposure): (x²a + xb) / (x²c + xd + e).
const ACES: [f32; 5] = [0.6 * 0.6 * 2.51, 0.6 * 0.03, 0.6 * 0.6 * 2.43, 0.6 * 0.59, 0.14];

fn aces(x: f32) -> f32 {
    let [a, b, c, d, e] = ACES;
    ((x * x * a + x * b) / (x * x * c + x * d + e)).clamp(0.0, 1.0)
}

/// The range of exposures in stops: from where the brightest luminance is shown as [`EXPOSED`] to where the median is.
fn exposures(reference: &[[f32; 3]]) -> (f32, f32) {
    let [a, b, c, d, e] = ACES;
    let (qa, qb, qc) = (a - EXPOSED * c, b - EXPOSED * d, -EXPOSED * e);
    let half = qb / (2.0 * qa);
    let shown = -half + (half * half - qc / qa).sqrt();
    let mut luminances: Vec<f32> = reference.iter().map(|v| luminance(v.map(|v| v.max(0.0)))).collect();
    luminances.sort_unstable_by(f32::total_cmp);
    let n = luminances.len();
    let brightest = luminances.last().copied().unwrap_or(0.0).max(f32::MIN_POSITIVE);
    let median = 0.5 * (luminances[(n - 1) / 2] + luminances[n / 2]);
    // The authors' smallest median, so that black images end.
    (libm::log2f(shown / brightest), libm::log2f(shown / median.max(1e-6_f32.max(brightest * 1e-6))))
}

/// What is left of an image after the eye's contrast sensitivity, in Hunt-adjusted L*a*b*.
fn sensed([width, height]: [usize; 2], image: &Pixels) -> Pixels {
    let widest = SENSITIVITY.iter().flatten().map(|&(_, b)| b).fold(0.0, f32::max);
    let radius = (3.0 * (widest / (2.0 * PI * PI)).sqrt() * PIXELS_PER_DEGREE).ceil() as i32;
    let mut filtered = vec![[0.0f32; 3]; image.len()];
    for (c, gaussians) in SENSITIVITY.iter().enumerate() {
        let plane: Vec<f32> = image.iter().map(|v| v[c]).collect();
        let kernels: Vec<(f32, Vec<f32>)> = gaussians
            .iter()
            .filter(|(a, _)| *a > 0.0)
            .map(|&(a, b)| {
                let g = |i: i32| libm::expf(-PI * PI / b * (i as f32 / PIXELS_PER_DEGREE).powi(2));
                (a * (PI / b).sqrt(), (-radius..=radius).map(g).collect())
            })
            .collect();
        let total: f32 = kernels.iter().map(|(a, k)| a * k.iter().sum::<f32>().powi(2)).sum();
        for (a, kernel) in &kernels {
            let blurred = separable([width, height], &plane, kernel, kernel);
            filtered.iter_mut().zip(blurred).for_each(|(v, b)| v[c] += a / total * b);
        }
    }
    filtered.into_iter().map(|v| to_hunt_lab(from_ycxcz(v).map(|v| v.clamp(0.0, 1.0)))).collect()
}

/// HyAB distances of L*a*b* colours, mapped to 0…1 so that small ones take most of the range.
fn colour_differences(reference: &Pixels, test: &Pixels) -> Vec<f32> {
    let power = |d: f32| libm::powf(d, COLOUR_EXPONENT);
    let largest = power(hyab(to_hunt_lab([0.0, 1.0, 0.0]), to_hunt_lab([0.0, 0.0, 1.0])));
    let knee = KNEE_IN * largest;
    let spread = |d: f32| match d {
        d if d < knee => KNEE_OUT / knee * d,
        d => KNEE_OUT + (d - knee) / (largest - knee) * (1.0 - KNEE_OUT),
    };
    reference.iter().zip(test).map(|(&r, &t)| spread(power(hyab(r, t)))).collect()
}

/// How different edges and points are, 0…1.
fn feature_differences(size: [usize; 2], reference: &Pixels, test: &Pixels) -> Vec<f32> {
    let features = |image: &Pixels| {
        let y: Vec<f32> = image.iter().map(|v| (v[0] + 16.0) / 116.0).collect();
        let [gaussian, edge, point] = feature_kernels();
        let norm = |kernel: &[f32]| -> Vec<f32> {
            let (dx, dy) = (separable(size, &y, kernel, &gaussian), separable(size, &y, &gaussian, kernel));
            dx.iter().zip(dy).map(|(&x, y)| (x * x + y * y).sqrt()).collect()
        };
        (norm(&edge), norm(&point))
    };
    let ((edges_r, points_r), (edges_t, points_t)) = (features(reference), features(test));
    (0..edges_r.len())
        .map(|i| {
            let difference = (edges_r[i] - edges_t[i]).abs().max((points_r[i] - points_t[i]).abs());
            libm::powf(std::f32::consts::FRAC_1_SQRT_2 * difference, FEATURE_EXPONENT)
        })
        .collect()
}

/// A Gaussian, its first and its second derivative; positive weights sum to 1, negative ones to −1.
fn feature_kernels() -> [Vec<f32>; 3] {
    let deviation = 0.5 * FEATURE_WIDTH * PIXELS_PER_DEGREE;
    let radius = (3.0 * deviation).ceil() as i32;
    let kernel = |weight: &dyn Fn(f32) -> f32| {
        let values: Vec<f32> = (-radius..=radius)
            .map(|i| i as f32)
            .map(|x| weight(x) * libm::expf(-x * x / (2.0 * deviation * deviation)))
            .collect();
        let positive: f32 = values.iter().filter(|&&v| v > 0.0).sum();
        let negative: f32 = -values.iter().filter(|&&v| v < 0.0).sum::<f32>();
        values.into_iter().map(|v| if v > 0.0 { v / positive } else { v / negative.max(f32::MIN_POSITIVE) }).collect()
    };
    [kernel(&|_| 1.0), kernel(&|x| -x), kernel(&|x| x * x / (deviation * deviation) - 1.0)]
}

/// A separable filter; beyond the border the image goes on as at its border.
fn separable([width, height]: [usize; 2], plane: &[f32], across: &[f32], down: &[f32]) -> Vec<f32> {
    let tap = |i: usize, k: usize, kernel: &[f32], len: usize| (i + k).saturating_sub(kernel.len() / 2).min(len - 1);
    let mut rows = vec![0.0f32; plane.len()];
    rows.par_chunks_mut(width).zip(plane.par_chunks(width)).for_each(|(out, row)| {
        for (x, out) in out.iter_mut().enumerate() {
            *out = across.iter().enumerate().map(|(k, w)| w * row[tap(x, k, across, width)]).sum();
        }
    });
    let mut columns = vec![0.0f32; plane.len()];
    columns.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
        for (k, w) in down.iter().enumerate() {
            let row = &rows[tap(y, k, down, height) * width..][..width];
            out.iter_mut().zip(row).for_each(|(out, v)| *out += w * v);
        }
    });
    columns
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 48;
    const HEIGHT: usize = 40;

    fn picture(change: usize) -> Pixels {
        let value = |x: usize, y: usize, c: usize| {
            let changed = if x > 20 { (x * y) % 5 * change } else { 0 };
            ((x * x / 16 + y * 3 + c * 29 + changed) % 64) as f32 / 63.0
        };
        (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| [0, 1, 2].map(|c| value(x, y, c)))).collect()
    }

    fn check(map: &[f32], mean: f32, at: [(usize, usize, f32); 4]) {
        let ours = map.iter().sum::<f32>() / map.len() as f32;
        assert!((ours - mean).abs() < 1e-4, "mean {ours} for {mean}");
        for (x, y, value) in at {
            assert!((map[y * WIDTH + x] - value).abs() < 5e-4, "({x}, {y}): {} for {value}", map[y * WIDTH + x]);
        }
    }

    /// Values of flip-evaluator 1.7, the authors' program. Fails if a filter is transposed or a constant is off.
    #[test]
    fn the_authors_program_says_the_same() {
        let (reference, test) = (picture(0), picture(3));
        check(
            &ldr([WIDTH, HEIGHT], &reference, &test),
            0.245_506_8,
            [(5, 5, 0.0), (21, 0, 0.303_233_7), (30, 17, 0.275_777_1), (47, 39, 0.834_821_1)],
        );
        let bright = |image: Pixels| image.into_iter().map(|v| v.map(|v| v * v * 20.0 + 0.001)).collect::<Pixels>();
        let (reference, test) = (bright(reference), bright(test));
        let (start, stop) = exposures(&reference);
        assert!((start + 2.901_170_3).abs() < 1e-4 && (stop + 1.411_867_5).abs() < 1e-4, "{start} {stop}");
        check(
            &hdr([WIDTH, HEIGHT], &reference, &test),
            0.306_495_6,
            [(5, 5, 0.0), (21, 0, 0.332_89), (30, 17, 0.405_687), (47, 39, 0.904_812_4)],
        );
    }

    #[test]
    fn equal_images_and_black_ones_do_not_differ() {
        let reference = picture(0);
        assert!(ldr([WIDTH, HEIGHT], &reference, &reference).iter().all(|&v| v == 0.0));
        let black = vec![[0.0; 3]; WIDTH * HEIGHT];
        assert!(hdr([WIDTH, HEIGHT], &black, &black).iter().all(|&v| v == 0.0));
    }
}
