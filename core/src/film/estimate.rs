//! What a film says of its pixels: means and their variances.

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

    /// How far each replicate's mean, over all channels, is from that of all (of its half, if those are apart); zero where there
    /// are too few to tell.
    pub(super) fn deviations(&self, x: u32, y: u32) -> [f64; REPLICATES] {
        let i = self.index(x, y);
        let mut means = [0.0; REPLICATES];
        for (r, mean) in means.iter_mut().enumerate() {
            *mean = self.sums[i].0[r].iter().map(|&s| s as f64).sum::<f64>() / f64::from(self.counts[i][r]);
        }
        let parts: &[Half] = if self.halves { &[Half::First, Half::Second] } else { &[Half::Both] };
        for half in parts {
            let means = &mut means[half.replicates()];
            let middle = means.iter().sum::<f64>() / means.len() as f64;
            means.iter_mut().for_each(|mean| *mean -= middle);
        }
        if means.iter().all(|mean| mean.is_finite()) { means } else { [0.0; REPLICATES] }
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
