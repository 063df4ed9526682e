//! How noisy the tiles of a film are, how that falls with the number of samples, and so how many they need.
//!
//! Model: the variance of a tile's means falls as n^-γ. Independent samples have γ = 1; well distributed ones more, up to 3 where
//! all is smooth. γ is one for the picture, found from its noise at two counts.

use super::in_sets;
use tilecast_core::film::Film;
use tilecast_core::film::file::Target;
use tilecast_core::settings::{Half, Window};

/// γ lies in between; what seems outside is chance.
const RATES: [f64; 2] = [1.0, 2.2];
/// A tile gets this part of the mean count at least, and this many times the mean at most: a pilot may see no noise where
/// some is, or too much of it.
const SHARES: [f64; 2] = [0.125, 8.0];
/// What is added to each tile's variance, as a part of the mean over all tiles, for what a pilot may have missed.
const UNSEEN: f64 = 0.05;
/// Errors of pixels are relative to the mean square of their tile plus this part of the picture's: the dark must not decide
/// alone.
const DARK: f64 = 0.01;
/// The part of the picture that must reach [`Target::Pixels`].
pub const PIXELS_REACHING: f64 = 0.95;

/// Tile by tile, summed over pixels and channels.
#[derive(Clone, Debug)]
pub struct Noise {
    /// Of the mean that the film gives, or would give if its other half were as noisy.
    variance: Vec<f64>,
    /// Squares of the true means, estimated without bias; may be negative in the dark.
    power: Vec<f64>,
    area: Vec<f64>,
}

/// What is needed.
#[derive(Clone, Debug)]
pub struct Model {
    /// Samples a pixel, by tile.
    wanted: Vec<f64>,
    area: Vec<f64>,
}

impl Noise {
    /// Of a film, as far as one half or both of it tell.
    pub fn of(film: &Film, half: Half, tiles: &[Window]) -> Self {
        let mut noise = Self { variance: Vec::new(), power: Vec::new(), area: Vec::new() };
        for tile in tiles {
            let (mut variance, mut power) = (0.0, 0.0);
            for (x, y) in (tile.y0..tile.y1).flat_map(|y| (tile.x0..tile.x1).map(move |x| (x, y))) {
                let estimate = film.half_estimate(x, y, half);
                for (m, v) in estimate.mean.into_iter().zip(estimate.variance) {
                    variance += f64::from(v);
                    power += f64::from(m) * f64::from(m) - f64::from(v);
                }
            }
            // The mean of two equal halves has half the variance of one.
            let whole = if half == Half::Both { 1.0 } else { 0.5 };
            noise.variance.push(whole * variance);
            noise.power.push(power);
            noise.area.push(tile.area() as f64);
        }
        noise
    }

    /// One number that falls as the noise does.
    pub fn total(&self, target: Target) -> f64 {
        match target {
            Target::Image(_) => self.variance.iter().sum(),
            Target::Pixels(_) => self.relative().iter().zip(&self.area).map(|(e, area)| e * area).sum(),
        }
    }

    /// What the target takes, from the noise at `count` samples a pixel.
    pub fn model(&self, target: Target, count: f64, rate: f64, aim: f64) -> Model {
        let mean = self.variance.iter().sum::<f64>() / self.area.iter().sum::<f64>();
        let shares: Vec<f64> = match target {
            // Least samples for a sum of variances: Lagrange gives n^(1+γ) ∝ variance.
            Target::Image(_) => {
                let density = |(v, area): (&f64, &f64)| (v / area + UNSEEN * mean).max(0.0).powf(1.0 / (1.0 + rate));
                self.variance.iter().zip(&self.area).map(density).collect()
            }
            // All equally well.
            Target::Pixels(_) => self.relative().iter().map(|e| e.max(1e-12).powf(1.0 / rate)).collect(),
        };
        let shares = bounded(&shares, &self.area);
        let even = vec![count; shares.len()];
        let scale = self.scale(&even, &shares, target, rate, aim);
        Model { wanted: shares.iter().map(|share| share * scale).collect(), area: self.area.clone() }
    }

    /// By how much `counts`, at which this is the noise, have to grow. `pilot` is the noise at `pilot_count`, for the rate.
    pub fn growth(&self, pilot: &Noise, pilot_count: f64, counts: &[u32], target: Target, aim: f64) -> f64 {
        let counts: Vec<f64> = counts.iter().map(|&n| f64::from(n)).collect();
        let rate = self.rate_since(pilot, pilot_count, &counts, target);
        self.scale(&counts, &counts, target, rate, aim)
    }

    /// The factor by which `shares` have to be multiplied to be the counts that reach the target, where this is the noise at
    /// `counts`.
    fn scale(&self, counts: &[f64], shares: &[f64], target: Target, rate: f64, aim: f64) -> f64 {
        match target {
            Target::Image(error) => {
                let goal = (aim * f64::from(error)).powi(2) * self.power.iter().sum::<f64>();
                let at_one: f64 = (self.variance.iter().zip(counts).zip(shares))
                    .map(|((v, n), share)| v * (n / share).powf(rate))
                    .sum();
                if goal > 0.0 && at_one > 0.0 { (at_one / goal).powf(1.0 / rate) } else { 1.0 }
            }
            Target::Pixels(error) => {
                let goal = (aim * f64::from(error)).powi(2);
                let needs = self.relative().into_iter().zip(counts).zip(shares).zip(&self.area);
                let mut needs: Vec<(f64, f64)> =
                    needs.map(|(((e, n), share), area)| (n / share * (e / goal).powf(1.0 / rate), *area)).collect();
                needs.sort_by(|a, b| a.0.total_cmp(&b.0));
                let mut left = PIXELS_REACHING * self.area.iter().sum::<f64>();
                let at = needs.iter().position(|(_, area)| {
                    left -= area;
                    left <= 0.0
                });
                at.map_or(1.0, |at| needs[at].0)
            }
        }
    }

    /// γ between a pilot and this, whose tiles have different counts: by bisection.
    fn rate_since(&self, pilot: &Noise, pilot_count: f64, counts: &[f64], target: Target) -> f64 {
        let of = |rate: f64| {
            let scaled = |(v, n): (&f64, &f64)| v * (pilot_count / n).powf(rate);
            let variance = pilot.variance.iter().zip(counts).map(scaled).collect();
            Noise { variance, ..pilot.clone() }.total(target)
        };
        let (seen, [mut low, mut high]) = (self.total(target), RATES);
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if of(middle) > seen { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    }

    /// The squared relative errors of the tiles' pixels.
    fn relative(&self) -> Vec<f64> {
        let density = self.power.iter().sum::<f64>() / self.area.iter().sum::<f64>();
        let floor = (DARK * density).max(f64::MIN_POSITIVE);
        let one = |((v, p), area): ((&f64, &f64), &f64)| v / (p.max(0.0) + floor * area);
        self.variance.iter().zip(&self.power).zip(&self.area).map(one).collect()
    }
}

impl Model {
    /// Samples a pixel, on average.
    pub fn mean_count(&self) -> f64 {
        let total: f64 = self.wanted.iter().zip(&self.area).map(|(n, area)| n * area).sum();
        total / self.area.iter().sum::<f64>()
    }

    /// This part of what is needed, in whole sets.
    pub fn counts(&self, part: f64) -> Vec<u32> {
        self.wanted.iter().map(|&n| in_sets(part * n)).collect()
    }
}

/// γ from the noise at two counts, the second `factor` times the first.
pub fn rate(before: f64, after: f64, factor: f64) -> f64 {
    if before > 0.0 && after > 0.0 { ((before / after).ln() / factor.ln()).clamp(RATES[0], RATES[1]) } else { RATES[0] }
}

/// Shares relative to their mean, within bounds.
fn bounded(shares: &[f64], area: &[f64]) -> Vec<f64> {
    let total: f64 = shares.iter().zip(area).map(|(share, area)| share * area).sum();
    let mean = total / area.iter().sum::<f64>();
    if mean > 0.0 {
        shares.iter().map(|share| (share / mean).clamp(SHARES[0], SHARES[1])).collect()
    } else {
        vec![1.0; shares.len()]
    }
}
