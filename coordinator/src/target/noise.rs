//! How noisy the tiles of a film are, how that falls with the number of samples, and so how many they need.
//!
//! Model: the variance of a tile's means falls as n^-γ. Independent samples have γ = 1; well distributed ones more, up to 3 where
//! all is smooth. γ is one for the picture, found from its noise at two counts.

use super::SPP_MAX;
use tilecast_core::film::Film;
use tilecast_core::film::file::Target;
use tilecast_core::settings::{Half, Window};

/// γ lies in between; what seems outside is chance. The first where nothing better is known.
const RATES: [f64; 2] = [1.0, 2.2];
/// Fewer pixels are too few to tell how much noise there is.
const FEW: f64 = 64.0;
/// A tile gets this part of the mean count at least, and this many times the mean at most: a pilot may see no noise where
/// some is, or too much of it.
const SHARES: [f64; 2] = [0.125, 8.0];
/// What is added to each tile's variance, as a part of the mean over all tiles, for what a pilot may have missed.
const UNSEEN: f64 = 0.1;
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
    /// Sum of the squares of the pixels' variances.
    squares: f64,
    /// Tiles in a row of the picture; they are in order, row by row.
    columns: usize,
}

/// How samples are shared out among tiles for a target, and how the noise falls.
#[derive(Clone, Debug)]
pub struct Model {
    target: Target,
    rate: f64,
    /// By tile, relative to their mean.
    shares: Vec<f64>,
    area: Vec<f64>,
}

impl Noise {
    /// Of a film, as far as one half or both of it tell.
    pub fn of(film: &Film, half: Half, tiles: &[Window]) -> Self {
        let columns = tiles.iter().take_while(|tile| tile.y0 == tiles[0].y0).count();
        let mut noise = Self { variance: Vec::new(), power: Vec::new(), area: Vec::new(), squares: 0.0, columns };
        for tile in tiles {
            let (mut variance, mut power) = (0.0, 0.0);
            for (x, y) in (tile.y0..tile.y1).flat_map(|y| (tile.x0..tile.x1).map(move |x| (x, y))) {
                let estimate = film.half_estimate(x, y, half);
                noise.squares += estimate.variance.into_iter().map(f64::from).sum::<f64>().powi(2);
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

    /// Whether few pixels carry the noise, as many as would if it were equal on each (Kish's effective size): too few to say how
    /// much there is.
    pub fn is_on_few(&self) -> bool {
        let total: f64 = self.variance.iter().sum();
        total * total < FEW * self.squares
    }

    /// One number that falls as the noise does.
    pub fn total(&self, target: Target) -> f64 {
        match target {
            Target::Image(_) => self.variance.iter().sum(),
            Target::Pixels(_) => self.relative().iter().zip(&self.area).map(|(e, area)| e * area).sum(),
        }
    }

    /// What it would be with one sample a pixel, where it is this with `counts`.
    pub fn at_one(&self, counts: &[u32], rate: f64) -> Self {
        let scaled = |(v, &n): (&f64, &u32)| v * f64::from(n).powf(rate);
        Self { variance: self.variance.iter().zip(counts).map(scaled).collect(), ..self.clone() }
    }

    /// The mean of two looks at the same picture.
    pub fn with(&self, other: &Noise) -> Self {
        let mean = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| 0.5 * (a + b)).collect();
        let (variance, power) = (mean(&self.variance, &other.variance), mean(&self.power, &other.power));
        Self { variance, power, ..self.clone() }
    }

    /// γ between an earlier look at the same picture, at even counts, and this one at `factor` times as many samples.
    pub fn rate(&self, before: &Noise, factor: f64, target: Target) -> f64 {
        let (before, after) = (before.total(target), self.total(target));
        if self.is_on_few() || before <= 0.0 || after <= 0.0 {
            return RATES[0];
        }
        ((before / after).ln() / factor.ln()).clamp(RATES[0], RATES[1])
    }

    /// γ between a pilot and this, whose tiles have different counts, all in all more: by bisection.
    pub fn rate_since(&self, pilot: &Noise, pilot_count: u32, counts: &[u32], target: Target) -> f64 {
        let of = |rate: f64| {
            let scaled = |(v, &n): (&f64, &u32)| v * (f64::from(pilot_count) / f64::from(n)).powf(rate);
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

    /// The variance of a pixel, tile by tile: that of the tile, or of the 3×3 tiles around where that is more. What makes rare
    /// bright samples, a lamp smaller than a pixel or its reflection, seldom ends at the edge of a tile that happened to see one.
    fn around(&self) -> Vec<f64> {
        let (columns, rows) = (self.columns, self.variance.len().div_ceil(self.columns.max(1)));
        let near = |i: usize, end: usize| i.saturating_sub(1)..(i + 2).min(end);
        let density = |i: usize| {
            let (mut variance, mut area) = (0.0, 0.0);
            for row in near(i / columns, rows) {
                for at in near(i % columns, columns).map(|column| row * columns + column) {
                    variance += self.variance[at];
                    area += self.area[at];
                }
            }
            f64::max(variance / area, self.variance[i] / self.area[i])
        };
        (0..self.variance.len()).map(density).collect()
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
    /// For noise as it is with one sample a pixel.
    pub fn new(at_one: &Noise, target: Target, rate: f64) -> Self {
        let mean = at_one.variance.iter().sum::<f64>() / at_one.area.iter().sum::<f64>();
        let shares: Vec<f64> = match target {
            // Least samples for a sum of variances: Lagrange gives n^(1+γ) ∝ variance.
            Target::Image(_) => at_one.around().iter().map(|v| (v + UNSEEN * mean).powf(1.0 / (1.0 + rate))).collect(),
            // All equally well.
            Target::Pixels(_) => at_one.relative().iter().map(|e| e.max(1e-12).powf(1.0 / rate)).collect(),
        };
        Self { target, rate, shares: bounded(&shares, &at_one.area), area: at_one.area.clone() }
    }

    /// The samples a pixel that each tile needs for `aim` times the target's error, where this is the noise with one; a tile has
    /// `least` already.
    pub fn counts(&self, at_one: &Noise, least: &[u32], aim: f64) -> Vec<f64> {
        let scale = match self.target {
            Target::Image(error) => {
                let goal = (aim * f64::from(error)).powi(2) * at_one.power.iter().sum::<f64>();
                self.scale_for_sum(&at_one.variance, least, goal)
            }
            Target::Pixels(error) => {
                let goal = (aim * f64::from(error)).powi(2);
                let needs: Vec<f64> = at_one.relative().iter().map(|e| (e / goal).powf(1.0 / self.rate)).collect();
                self.scale_for_most(&needs, least)
            }
        };
        self.shares.iter().zip(least).map(|(share, &least)| (share * scale).max(f64::from(least))).collect()
    }

    /// The factor for the shares at which the sum of the tiles' variances is the goal: by bisection of its logarithm.
    fn scale_for_sum(&self, at_one: &[f64], least: &[u32], goal: f64) -> f64 {
        if goal <= 0.0 {
            return 1.0;
        }
        let sum = |scale: f64| -> f64 {
            let tiles = at_one.iter().zip(&self.shares).zip(least);
            tiles.map(|((v, share), &least)| v * (share * scale).max(f64::from(least)).powf(-self.rate)).sum()
        };
        let (mut low, mut high) = (0.0, SPP_MAX.ln());
        for _ in 0..60 {
            let middle: f64 = 0.5 * (low + high);
            if sum(middle.exp()) > goal { low = middle } else { high = middle }
        }
        high.exp()
    }

    /// The factor for the shares at which [`PIXELS_REACHING`] of the picture have what they need.
    fn scale_for_most(&self, needs: &[f64], least: &[u32]) -> f64 {
        let tiles = needs.iter().zip(&self.shares).zip(least).zip(&self.area);
        let mut scales: Vec<(f64, f64)> = tiles
            .map(|(((need, share), &least), &area)| (if *need > f64::from(least) { need / share } else { 0.0 }, area))
            .collect();
        scales.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut left = PIXELS_REACHING * self.area.iter().sum::<f64>();
        let reaching = scales.iter().find(|(_, area)| {
            left -= area;
            left <= 0.0
        });
        reaching.map_or(1.0, |&(scale, _)| scale)
    }

    /// γ.
    pub fn rate(&self) -> f64 {
        self.rate
    }

    /// Samples a pixel, on average over tiles with these counts.
    pub fn mean(&self, counts: &[f64]) -> f64 {
        let total: f64 = counts.iter().zip(&self.area).map(|(n, area)| n * area).sum();
        total / self.area.iter().sum::<f64>()
    }
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
