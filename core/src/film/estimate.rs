//! What a film says: means, their variances, and how wrong the picture is.

use super::{Film, REPLICATES};
use crate::settings::Half;

/// What is known of a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The mean radiance (linear sRGB, W·m⁻²·sr⁻¹).
    pub mean: [f32; 3],
    /// The estimated variance of that mean; infinite where fewer than two replicates have samples.
    pub variance: [f32; 3],
    /// Samples.
    pub count: u64,
}

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

impl Film {
    /// Mean, variance of the mean, and count of the pixel (x, y) of the whole picture.
    pub fn estimate(&self, x: u32, y: u32) -> Estimate {
        let whole = self.half_estimate(x, y, Half::Both);
        if !self.halves {
            return whole;
        }
        let [a, b] = [Half::First, Half::Second].map(|half| self.half_estimate(x, y, half));
        if a.count == 0 || b.count == 0 {
            return whole;
        }
        let i = self.index(x, y);
        let mean = |half: Half, c: usize| {
            let (sum, count) = half
                .replicates()
                .fold((0, 0), |(sum, count), r| (sum + self.sums[i].0[r][c], count + u64::from(self.counts[i][r])));
            scale_down(sum as f64 / count as f64, self.scale_exponent)
        };
        // Rounded to f64 on the way, to f32 once.
        let mean = std::array::from_fn(|c| (0.5 * (mean(Half::First, c) + mean(Half::Second, c))) as f32);
        let variance = std::array::from_fn(|c| 0.25 * (a.variance[c] + b.variance[c]));
        Estimate { mean, variance, count: whole.count }
    }

    /// The same from the replicates of a half alone.
    pub fn half_estimate(&self, x: u32, y: u32, half: Half) -> Estimate {
        let (i, replicates) = (self.index(x, y), half.replicates());
        let (mut sums, mut counts) = ([[0; 3]; REPLICATES], [0; REPLICATES]);
        sums[replicates.clone()].copy_from_slice(&self.sums[i].0[replicates.clone()]);
        counts[replicates.clone()].copy_from_slice(&self.counts[i][replicates]);
        let (sums, counts) = (&sums, &counts);
        let count: u64 = counts.iter().map(|&c| u64::from(c)).sum();
        let channel = |c: usize| {
            let total: i128 = sums.iter().map(|s| s[c]).sum();
            let variance = self.variance(std::array::from_fn(|r| sums[r][c]), counts);
            (mean(total, count, self.scale_exponent), variance)
        };
        let channels: [(f32, f32); 3] = std::array::from_fn(channel);
        Estimate { mean: channels.map(|(m, _)| m), variance: channels.map(|(_, v)| v), count }
    }

    /// Variance of the mean from the replicates' means m_r with n_r samples each: Σ n_r (m_r − m)² / (n (K − 1)) over the K
    /// replicates that have samples, infinite for K < 2.
    fn variance(&self, sums: [i128; REPLICATES], counts: &[u32; REPLICATES]) -> f32 {
        let filled = || {
            let filled = sums.iter().zip(counts).filter(|&(_, &n)| n > 0);
            filled.map(|(&s, &n)| (f64::from(n), s as f64 / f64::from(n)))
        };
        let replicates = filled().count();
        if replicates < 2 {
            return f32::INFINITY;
        }
        let n: f64 = filled().map(|(n, _)| n).sum();
        let m = filled().map(|(n, m)| n * m).sum::<f64>() / n;
        let spread: f64 = filled().map(|(n, mean)| n * (mean - m) * (mean - m)).sum();
        let fixed = spread / (n * (replicates - 1) as f64);
        scale_down(scale_down(fixed, self.scale_exponent), self.scale_exponent) as f32
    }

    /// The estimated relative error of the picture over at most `pixels_max` pixels spread evenly; `None` while too few
    /// replicates have samples, or for a black picture.
    pub fn relative_error(&self, pixels_max: u64) -> Option<RelativeError> {
        let area = self.window.area();
        let step = area.div_ceil(pixels_max.max(1)).max(1);
        let (mut n, mut error, mut squares, mut power) = (0.0, 0.0, 0.0, 0.0);
        for i in (0..area).step_by(usize::try_from(step).ok()?) {
            let width = u64::from(self.window.width());
            let estimate = self.estimate(self.window.x0 + (i % width) as u32, self.window.y0 + (i / width) as u32);
            let variance = estimate.variance.iter().map(|&v| f64::from(v)).sum::<f64>();
            n += 1.0;
            error += variance;
            squares += variance * variance;
            power += estimate.mean.iter().map(|&m| f64::from(m) * f64::from(m)).sum::<f64>();
        }
        if !error.is_finite() || power <= 0.0 {
            return None;
        }
        let value = (error / power).sqrt();
        // A variance v estimated with ν degrees of freedom itself has the variance 2v²/ν, of which v̂² · 2/(ν + 2) is the unbiased
        // estimate; pixels that were left out add how much the others differ.
        let freedom = if self.halves { REPLICATES - 2 } else { REPLICATES - 1 };
        let of_estimates = squares * 2.0 / (freedom as f64 + 2.0);
        let of_pixels = (squares - error * error / n).max(0.0) * n / (n - 1.0).max(1.0);
        let seen = n / area as f64;
        let deviation = (seen * of_estimates + (1.0 - seen) * of_pixels).sqrt();
        // The root halves relative deviations; an interval in the logarithm stays above zero.
        let width = if error > 0.0 { libm::exp(0.5 * NORMAL_95 * deviation / error) } else { 1.0 };
        Some(RelativeError { value: value as f32, low: (value / width) as f32, high: (value * width) as f32 })
    }
}

/// sum / (count · 2^scale), rounded once to f32 (nearest, ties to even), as long as the result is a normal number.
pub(super) fn mean(sum: i128, count: u64, scale_exponent: i32) -> f32 {
    if sum == 0 || count == 0 {
        return 0.0;
    }
    let magnitude = sum.unsigned_abs();
    let shift = magnitude.leading_zeros();
    let normalised = magnitude << shift;
    // At least 127 − 34 significant bits; the lowest is made sticky, so that rounding to 24 bits sees what division lost.
    let count = u128::from(count);
    let quotient = (normalised / count) | u128::from(!normalised.is_multiple_of(count));
    let rounded = f64::from(quotient as f32);
    let value = scale_down(rounded, scale_exponent + shift as i32) as f32;
    if sum < 0 { -value } else { value }
}

/// x · 2^-exponent, exact within f64's normal range.
fn scale_down(x: f64, exponent: i32) -> f64 {
    libm::ldexp(x, -exponent)
}
