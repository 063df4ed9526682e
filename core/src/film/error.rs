//! What a film says of the picture: how wrong it is, and how sure that is.

use super::estimate::Estimate;
use super::{Film, REPLICATES};

/// The estimated relative error of a picture: √(Σ variance of the mean / Σ mean²) over pixels and channels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelativeError {
    /// The estimate.
    pub value: f32,
    /// The lower end of its 95 % confidence interval.
    pub low: f32,
    /// The upper end.
    pub high: f32,
}

/// 95 % of the normal distribution lie within so many standard deviations.
const NORMAL_95: f64 = 1.96;

/// Pixels within squares of this side may err together: they may have been made from the same paths.
const TOGETHER: u32 = 4;

/// What pixels have added up to.
#[derive(Clone, Copy, Default)]
struct Sums {
    pixels: f64,
    variance: f64,
    /// Σ mean².
    power: f64,
    /// Σ variance² over pixels, and over squares of pixels.
    squares: f64,
    squares_together: f64,
    /// Pairs of pixels within a square, and the sum of their squared correlations.
    pairs: f64,
    correlation: f64,
}

/// A square of pixels as far as it has been seen: its variance, and the replicates' deviations at its first pixel.
#[derive(Clone, Copy, Default)]
struct Square {
    variance: f64,
    first: Option<[f64; REPLICATES]>,
}

impl Film {
    /// The estimated relative error of the picture over at most `pixels_max` pixels spread evenly; `None` while too few
    /// replicates have samples, or for a black picture.
    pub fn relative_error(&self, pixels_max: u64) -> Option<RelativeError> {
        let area = self.window.area();
        let step = area.div_ceil(pixels_max.max(1)).max(1);
        let sums = self.sums_of_every(usize::try_from(step).ok()?);
        let Sums { pixels: n, variance, squares, .. } = sums;
        if !variance.is_finite() || sums.power <= 0.0 {
            return None;
        }
        let value = (variance / sums.power).sqrt();
        // A variance v estimated with ν degrees of freedom itself has the variance 2v²/ν, of which v̂² · 2/(ν + 2) is the unbiased
        // estimate; those of two pixels whose errors have the correlation ρ have the covariance 2ρ² v w/ν. Chance alone makes ρ² of
        // 1/ν. Pixels that were left out add how much the others differ.
        let freedom = if self.halves { REPLICATES - 2 } else { REPLICATES - 1 } as f64;
        let seen_together = if sums.pairs > 0.0 { sums.correlation / sums.pairs } else { 0.0 };
        let together = ((seen_together - 1.0 / freedom) / (1.0 - 1.0 / freedom)).clamp(0.0, 1.0);
        let of_estimates = (squares + together * (sums.squares_together - squares)) * 2.0 / (freedom + 2.0);
        let of_pixels = (squares - variance * variance / n).max(0.0) * n / (n - 1.0).max(1.0);
        let seen = n / area as f64;
        let deviation = (seen * of_estimates + (1.0 - seen) * of_pixels).sqrt();
        // The root halves relative deviations; an interval in the logarithm stays above zero.
        let width = if variance > 0.0 { libm::exp(0.5 * NORMAL_95 * deviation / variance) } else { 1.0 };
        Some(RelativeError { value: value as f32, low: (value / width) as f32, high: (value * width) as f32 })
    }

    /// Over every pixel of so many, row by row.
    fn sums_of_every(&self, step: usize) -> Sums {
        let mut sums = Sums::default();
        let width = self.window.width();
        let (first, last) = (self.window.x0 / TOGETHER, (self.window.x1 - 1) / TOGETHER);
        let (mut band, mut squares) = (0, vec![Square::default(); (last - first + 1) as usize]);
        for i in (0..self.window.area()).step_by(step) {
            let (x, y) =
                (self.window.x0 + (i % u64::from(width)) as u32, self.window.y0 + (i / u64::from(width)) as u32);
            if y / TOGETHER != band {
                (sums, band) = (sums.with(&squares), y / TOGETHER);
                squares.fill(Square::default());
            }
            let Estimate { mean, variance, .. } = self.estimate(x, y);
            let variance = variance.iter().map(|&v| f64::from(v)).sum::<f64>();
            sums.pixels += 1.0;
            sums.variance += variance;
            sums.squares += variance * variance;
            sums.power += mean.iter().map(|&m| f64::from(m) * f64::from(m)).sum::<f64>();
            let square = &mut squares[(x / TOGETHER - first) as usize];
            square.variance += variance;
            let deviations = self.deviations(x, y);
            match square.first {
                None => square.first = Some(deviations),
                Some(first) => {
                    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
                    let (both, each) = (dot(&first, &deviations), dot(&first, &first) * dot(&deviations, &deviations));
                    if each > 0.0 {
                        sums.pairs += 1.0;
                        sums.correlation += both * both / each;
                    }
                }
            }
        }
        sums.with(&squares)
    }
}

impl Sums {
    /// With squares that are complete.
    fn with(mut self, squares: &[Square]) -> Self {
        self.squares_together += squares.iter().map(|square| square.variance * square.variance).sum::<f64>();
        self
    }
}
