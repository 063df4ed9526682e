//! Exact film: radiance summed in fixed point, so that sums need no order and lose nothing.
//!
//! A radiance r is stored as the integer r · 2^scale in an `i128`: 32 bits for the count of samples, [`HEADROOM_BITS`] above
//! the brightest radiance in the scene, 71 below it. Every f32 down to 2^-47 of the brightest is exact, smaller ones are
//! rounded once, each by itself. Integer addition is associative and commutative: tiles merge in any order, on any machine,
//! to the same bits. The mean is rounded once, at the end.
//!
//! Sample `i` of a pixel belongs to replicate `i % REPLICATES`. Replicates are independent of each other, so the spread of
//! their means measures the error of the whole mean.

pub mod file;
pub mod ranges;
pub mod records;
pub mod sums;

use crate::scene::Digest;
use crate::settings::{Half, Settings, Window};
use glam::Vec3;
use std::ops::Range;

/// Independent sets of samples a pixel. Four sums of three channels take 192 bytes a pixel.
pub const REPLICATES: usize = 4;
/// Bits for the number of samples: a pixel may have 2^32 − 1.
const COUNT_BITS: i32 = 32;
/// Bits between the brightest emitted radiance and the largest value a sample may have. A sample's weight f·|cos θ|/pdf can
/// exceed 1, most of all under `uniform` on glossy surfaces.
pub const HEADROOM_BITS: i32 = 24;
/// A sample's magnitude stays below 2^SAMPLE_BITS, so that 2^32 of them stay below 2^127.
const SAMPLE_BITS: i32 = 127 - COUNT_BITS;

/// The fixed-point exponent for a scene whose brightest emitted radiance is `brightest` (≥ 0).
pub fn scale_exponent(brightest: f32) -> i32 {
    if brightest > 0.0 && brightest.is_finite() {
        SAMPLE_BITS - HEADROOM_BITS - (exponent_of(brightest) + 1)
    } else {
        SAMPLE_BITS - HEADROOM_BITS
    }
}

/// The power of two of the leading bit of a positive `x`.
fn exponent_of(x: f32) -> i32 {
    let bits = x.to_bits() & 0x7fff_ffff;
    match (bits >> 23) as i32 {
        0 => -118 - bits.leading_zeros() as i32, // subnormal: 2^-149 · mantissa
        e => e - 127,
    }
}

/// Why a radiance cannot be added to the film.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RadianceError {
    /// NaN or infinite.
    #[error("its radiance ({}, {}, {}) is not finite", .0.x, .0.y, .0.z)]
    NotFinite(Vec3),
    /// Beyond what the fixed point can hold.
    #[error("its radiance ({}, {}, {}) is 2^24 times beyond the brightest light of the scene", .0.x, .0.y, .0.z)]
    OutOfRange(Vec3),
}

/// What one pixel has received: a sum a replicate and channel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PixelSums(pub [[i128; 3]; REPLICATES]);

impl PixelSums {
    /// Adds the radiance of sample `index`.
    ///
    /// # Errors
    /// NaN, infinite or out-of-range radiance; nothing is added then.
    #[inline(always)]
    pub fn add(&mut self, index: u32, radiance: Vec3, scale_exponent: i32) -> Result<(), RadianceError> {
        if !radiance.is_finite() {
            return Err(RadianceError::NotFinite(radiance));
        }
        let fixed = |x: f32| to_fixed(x, scale_exponent);
        let (Some(r), Some(g), Some(b)) = (fixed(radiance.x), fixed(radiance.y), fixed(radiance.z)) else {
            return Err(RadianceError::OutOfRange(radiance));
        };
        let sums = &mut self.0[index as usize % REPLICATES];
        sums[0] += r;
        sums[1] += g;
        sums[2] += b;
        Ok(())
    }

    /// Adds another's sums, exactly. They are bounded by what [`PixelSums::add`] accepts; what comes from elsewhere is checked by
    /// [`TileSums::check`] first.
    pub fn merge(&mut self, other: &PixelSums) {
        for (mine, theirs) in self.0.iter_mut().flatten().zip(other.0.iter().flatten()) {
            *mine += theirs;
        }
    }

    /// Forgets the replicates that are not of a half.
    pub fn keep(&mut self, half: Half) {
        let kept = half.replicates();
        (0..REPLICATES).filter(|r| !kept.contains(r)).for_each(|r| self.0[r] = [0; 3]);
    }

    /// Undoes [`PixelSums::merge`], exactly.
    pub fn remove(&mut self, other: &PixelSums) {
        for (mine, theirs) in self.0.iter_mut().flatten().zip(other.0.iter().flatten()) {
            *mine -= theirs;
        }
    }
}

/// x · 2^scale as an integer, to nearest, ties to even; `None` beyond [`SAMPLE_BITS`].
#[inline(always)]
fn to_fixed(x: f32, scale_exponent: i32) -> Option<i128> {
    let bits = x.to_bits();
    let biased = ((bits >> 23) & 0xff) as i32;
    let fraction = i128::from(bits & 0x007f_ffff);
    let (mantissa, exponent) = if biased == 0 { (fraction, -149) } else { (fraction | 0x0080_0000, biased - 150) };
    let shift = exponent + scale_exponent;
    let magnitude = if shift >= 0 {
        if shift > SAMPLE_BITS - 24 {
            return if mantissa == 0 { Some(0) } else { None };
        }
        mantissa << shift
    } else if shift > -26 {
        let half = 1i128 << (-shift - 1);
        let floor = mantissa >> -shift;
        let rest = mantissa & ((half << 1) - 1);
        floor + i128::from(rest > half || (rest == half && floor & 1 == 1))
    } else {
        0
    };
    Some(if bits >> 31 == 0 { magnitude } else { -magnitude })
}

/// The result of a unit of work: the sums of a tile over a range of sample indices.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TileSums {
    /// The pixels.
    pub tile: Window,
    /// The sample indices that every pixel of it has received.
    pub samples: Range<u32>,
    /// Row by row.
    pub pixels: Vec<PixelSums>,
}

impl TileSums {
    /// No sample yet.
    pub fn new(tile: Window, samples: Range<u32>) -> Self {
        let len = usize::try_from(tile.area()).unwrap_or(usize::MAX);
        Self { tile, samples, pixels: vec![PixelSums::default(); len] }
    }

    /// Whether the sums are such as their number of samples can make: what is merged is bounded.
    pub fn check(&self) -> bool {
        bounded(self.tile, self.samples.len() as u64, &self.pixels)
    }
}

/// Whether these can be the sums of `count` samples of every pixel of `tile`.
fn bounded(tile: Window, count: u64, pixels: &[PixelSums]) -> bool {
    let bound = u128::from(count) << SAMPLE_BITS;
    pixels.len() as u64 == tile.area() && pixels.iter().all(|p| p.0.iter().flatten().all(|s| s.unsigned_abs() <= bound))
}

/// The image in the making: the sums of every pixel of a crop window, and how many samples each replicate has.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Film {
    /// The pixels, in the coordinates of the whole picture.
    pub window: Window,
    /// See [`Settings::scale_exponent`].
    pub scale_exponent: i32,
    /// The replicates that what is merged belongs to, see [`Settings::half`].
    pub half: Half,
    /// The image is the mean of the means of both halves, whatever samples each has; else the mean of all samples.
    pub halves: bool,
    sums: Vec<PixelSums>,
    counts: Vec<[u32; REPLICATES]>,
}

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
    /// An empty film for a job.
    pub fn new(settings: &Settings) -> Self {
        let window = settings.film.crop;
        let len = usize::try_from(window.area()).unwrap_or(usize::MAX);
        Self {
            window,
            scale_exponent: settings.scale_exponent,
            half: settings.half,
            halves: false,
            sums: vec![PixelSums::default(); len],
            counts: vec![[0; REPLICATES]; len],
        }
    }

    /// Adds a unit's result. Merging is exact: order and grouping do not matter. The tile must lie within the window; each
    /// (tile, sample range) must be merged once, which is the ledger's care.
    pub fn merge(&mut self, part: &TileSums) {
        self.add(part.tile, std::slice::from_ref(&part.samples), &part.pixels);
    }

    /// Adds the sums of several disjoint sample ranges of a tile.
    pub fn add(&mut self, tile: Window, samples: &[Range<u32>], pixels: &[PixelSums]) {
        let counts = counts(samples, self.half);
        self.change(tile, pixels, |sums, count, pixel| {
            sums.merge(pixel);
            count.iter_mut().zip(counts).for_each(|(c, n)| *c += n);
        });
    }

    /// Takes out what [`Film::add`] added: what is left is, to the bit, what would be there without it.
    pub fn remove(&mut self, tile: Window, samples: &[Range<u32>], pixels: &[PixelSums]) {
        let counts = counts(samples, self.half);
        self.change(tile, pixels, |sums, count, pixel| {
            sums.remove(pixel);
            count.iter_mut().zip(counts).for_each(|(c, n)| *c -= n);
        });
    }

    /// Adds all of another film of the same window and scale, whose samples are others.
    pub fn join(&mut self, other: &Film) {
        assert!(self.window == other.window && self.scale_exponent == other.scale_exponent, "films of other pictures");
        self.sums.iter_mut().zip(&other.sums).for_each(|(mine, theirs)| mine.merge(theirs));
        for (mine, theirs) in self.counts.iter_mut().flatten().zip(other.counts.iter().flatten()) {
            *mine += theirs;
        }
    }

    fn change(
        &mut self,
        tile: Window,
        pixels: &[PixelSums],
        act: impl Fn(&mut PixelSums, &mut [u32; REPLICATES], &PixelSums),
    ) {
        assert!(self.window.contains(&tile), "tile {tile:?} outside {:?}", self.window);
        let width = tile.width() as usize;
        for (row, pixels) in pixels.chunks_exact(width).enumerate() {
            let start = self.index(tile.x0, tile.y0 + row as u32);
            let sums = &mut self.sums[start..start + width];
            let counts = &mut self.counts[start..start + width];
            for ((sum, count), pixel) in sums.iter_mut().zip(counts).zip(pixels) {
                act(sum, count, pixel);
            }
        }
    }

    /// A copy of the sums of a tile, row by row.
    pub fn tile(&self, tile: Window) -> Vec<PixelSums> {
        let width = tile.width() as usize;
        (tile.y0..tile.y1)
            .flat_map(|y| {
                let start = self.index(tile.x0, y);
                &self.sums[start..start + width]
            })
            .copied()
            .collect()
    }

    /// Mean, variance of the mean, and count of the pixel (x, y) of the whole picture.
    pub fn estimate(&self, x: u32, y: u32) -> Estimate {
        let whole = self.half_estimate(x, y, Half::Both);
        let [a, b] = [Half::First, Half::Second].map(|half| self.half_estimate(x, y, half));
        if !self.halves || a.count == 0 || b.count == 0 {
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
        let filled: Vec<(f64, f64)> = (sums.iter().zip(counts))
            .filter(|&(_, &n)| n > 0)
            .map(|(&s, &n)| (f64::from(n), s as f64 / f64::from(n)))
            .collect();
        if filled.len() < 2 {
            return f32::INFINITY;
        }
        let n: f64 = filled.iter().map(|(n, _)| n).sum();
        let m = filled.iter().map(|(n, m)| n * m).sum::<f64>() / n;
        let spread: f64 = filled.iter().map(|(n, mean)| n * (mean - m) * (mean - m)).sum();
        let fixed = spread / (n * (filled.len() - 1) as f64);
        scale_down(scale_down(fixed, self.scale_exponent), self.scale_exponent) as f32
    }

    /// BLAKE3 over window, scale, counts and sums: equal digests are equal images, to the last bit of every sum.
    pub fn digest(&self) -> Digest {
        let mut hasher = blake3::Hasher::new();
        for word in [self.window.x0, self.window.y0, self.window.x1, self.window.y1] {
            hasher.update(&word.to_le_bytes());
        }
        hasher.update(&self.scale_exponent.to_le_bytes());
        if self.halves {
            hasher.update(b"halves");
        }
        let mut row = Vec::new();
        for (sums, counts) in self.sums.iter().zip(&self.counts) {
            row.clear();
            counts.iter().for_each(|c| row.extend(c.to_le_bytes()));
            sums.0.iter().flatten().for_each(|s| row.extend(s.to_le_bytes()));
            hasher.update(&row);
        }
        Digest(*hasher.finalize().as_bytes())
    }

    /// The sums of all pixels, row by row through the window.
    pub fn sums(&self) -> &[PixelSums] {
        &self.sums
    }

    /// How many samples each replicate of each pixel has, in the same order.
    pub fn counts(&self) -> &[[u32; REPLICATES]] {
        &self.counts
    }

    /// A film from [`Film::sums`] and [`Film::counts`] that came from elsewhere; `None` if they do not fill the window or
    /// hold sums that so many samples cannot make.
    pub fn from_parts(
        window: Window,
        scale_exponent: i32,
        sums: Vec<PixelSums>,
        counts: Vec<[u32; REPLICATES]>,
    ) -> Option<Self> {
        let bounded = |(sums, counts): (&PixelSums, &[u32; REPLICATES])| {
            let bounds = counts.map(|n| u128::from(n) << SAMPLE_BITS);
            sums.0.iter().zip(bounds).all(|(channels, bound)| channels.iter().all(|s| s.unsigned_abs() <= bound))
        };
        let fills = sums.len() as u64 == window.area() && counts.len() as u64 == window.area();
        let valid = fills && sums.iter().zip(&counts).all(bounded);
        valid.then_some(Self { window, scale_exponent, half: Half::Both, halves: false, sums, counts })
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

    fn index(&self, x: u32, y: u32) -> usize {
        (y - self.window.y0) as usize * self.window.width() as usize + (x - self.window.x0) as usize
    }
}

/// How many indices of disjoint ranges fall to each replicate.
fn counts(samples: &[Range<u32>], half: Half) -> [u32; REPLICATES] {
    samples
        .iter()
        .map(|range| replicate_counts(range, half.replicates()))
        .fold([0; REPLICATES], |a, b| std::array::from_fn(|r| a[r] + b[r]))
}

/// How many indices of a range fall to each replicate.
fn replicate_counts(samples: &Range<u32>, replicates: Range<usize>) -> [u32; REPLICATES] {
    let below = |end: u32, place: usize| (end as usize + replicates.len() - 1 - place) / replicates.len();
    let mut counts = [0; REPLICATES];
    for (place, count) in counts[replicates.clone()].iter_mut().enumerate() {
        *count = (below(samples.end, place) - below(samples.start, place)) as u32;
    }
    counts
}

/// sum / (count · 2^scale), rounded once to f32 (nearest, ties to even), as long as the result is a normal number.
fn mean(sum: i128, count: u64, scale_exponent: i32) -> f32 {
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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn film(width: u32, height: u32, brightest: f32) -> Film {
        let window = Window { x0: 0, y0: 0, x1: width, y1: height };
        let len = window.area() as usize;
        Film {
            window,
            scale_exponent: scale_exponent(brightest),
            half: Half::Both,
            halves: false,
            sums: vec![PixelSums::default(); len],
            counts: vec![[0; REPLICATES]; len],
        }
    }

    /// Fails for an f32 or f64 sum, and for a scale that leaves too few bits below the brightest radiance.
    #[test]
    fn a_billion_equal_samples_have_exactly_that_mean() {
        for brightest in [1e-12f32, 1.0, 1e12] {
            for relative in [1e-12f32, 0.3333, 1.0] {
                let value = brightest * relative;
                let scale = scale_exponent(brightest);
                let fixed = to_fixed(value, scale).unwrap();
                let sum = fixed * 1_000_000_007;
                assert_eq!(mean(sum, 1_000_000_007, scale), value);
            }
        }
    }

    #[test]
    fn the_mean_is_rounded_to_nearest() {
        // (2^24 + 1) + (2^24 + 2) over two: halfway cases go to even, anything above goes up.
        let one = |x: f32| to_fixed(x, 0).unwrap();
        assert_eq!(mean(one(16_777_216.0) + 16_777_217, 2, 0), 16_777_216.0);
        assert_eq!(mean(3 * one(16_777_216.0) + 4, 3, 0), 16_777_218.0);
        assert_eq!(mean(-7, 2, 0), -3.5);
    }

    #[test]
    fn what_is_no_radiance_is_refused() {
        let mut pixel = PixelSums::default();
        let scale = scale_exponent(1.0);
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert!(matches!(pixel.add(0, Vec3::new(0.0, bad, 0.0), scale), Err(RadianceError::NotFinite(_))));
        }
        assert!(matches!(pixel.add(0, Vec3::splat(1e9), scale), Err(RadianceError::OutOfRange(_))));
        assert_eq!(pixel, PixelSums::default());
        assert!(pixel.add(0, Vec3::splat(1e7), scale).is_ok());
    }

    #[test]
    fn the_variance_of_four_known_replicates() {
        let mut film = film(1, 1, 4.0);
        let mut part = TileSums::new(film.window, 0..4);
        for (i, x) in [1.0, 2.0, 3.0, 4.0].into_iter().enumerate() {
            part.pixels[0].add(i as u32, Vec3::splat(x), film.scale_exponent).unwrap();
        }
        film.merge(&part);
        let estimate = film.estimate(0, 0);
        assert_eq!(estimate.mean, [2.5; 3]);
        // Sample variance 5/3 over 4 replicates.
        assert!((estimate.variance[0] - 5.0 / 12.0).abs() < 1e-7);
    }

    /// Both halves' samples are those of the whole, and the mean of halves of different sizes weighs them equally.
    #[test]
    fn halves_make_the_whole() {
        let value = |i: u32| Vec3::new(i as f32, 1.0 / (1 + i) as f32, 2.0);
        let traced = |half: Half, own: Range<u32>| {
            let mut film = Film { half, ..film(1, 1, 8.0) };
            let mut part = TileSums::new(film.window, own.clone());
            own.for_each(|own| {
                let index = half.index(own);
                part.pixels[0].add(index, value(index), film.scale_exponent).unwrap();
            });
            film.merge(&part);
            film
        };
        let mut joined = traced(Half::First, 0..8);
        joined.join(&traced(Half::Second, 0..8));
        assert_eq!(Film { half: Half::Both, ..joined.clone() }, traced(Half::Both, 0..16));
        joined.join(&traced(Half::First, 8..20));
        joined.halves = true;
        let mean = |half: Half, n: u32| (0..n).map(|own| half.index(own) as f32).sum::<f32>() / n as f32;
        assert_eq!(joined.estimate(0, 0).mean[0], 0.5 * (mean(Half::First, 20) + mean(Half::Second, 8)));
        assert_eq!(joined.estimate(0, 0).count, 28);
    }

    proptest! {
        /// Any f32 within 2^47 of the brightest comes back exactly from one sample.
        #[test]
        fn conversion_is_exact(mantissa in 0x0080_0000u32..0x0100_0000, exponent in -46i32..24, negative: bool) {
            let value = libm::ldexpf(mantissa as f32, exponent - 23) * if negative { -1.0 } else { 1.0 };
            let scale = scale_exponent(1.0);
            let fixed = to_fixed(value, scale).unwrap();
            prop_assert_eq!(mean(fixed, 1, scale), value);
        }

        /// Merging in another order and grouping gives the same film, and the digest sees every change.
        #[test]
        fn merging_needs_no_order(values in prop::collection::vec(-1e3f32..1e6, 24), cut in 1u32..23) {
            let whole = film(2, 1, 1e3);
            let part = |range: Range<u32>| {
                let mut part = TileSums::new(whole.window, range.clone());
                for i in range {
                    for pixel in &mut part.pixels {
                        pixel.add(i, Vec3::splat(values[i as usize]), whole.scale_exponent).unwrap();
                    }
                }
                part
            };
            let (mut once, mut forwards, mut backwards) = (whole.clone(), whole.clone(), whole.clone());
            once.merge(&part(0..24));
            forwards.merge(&part(0..cut));
            prop_assert_ne!(forwards.digest(), once.digest());
            forwards.merge(&part(cut..24));
            backwards.merge(&part(cut..24));
            backwards.merge(&part(0..cut));
            prop_assert_eq!(&once, &forwards);
            prop_assert_eq!(&once, &backwards);
            prop_assert_eq!(once.digest(), backwards.digest());
        }
    }
}
