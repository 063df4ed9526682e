//! Exact film: radiance summed in fixed point, so that sums need no order and lose nothing.
//!
//! A radiance r is stored as the integer r · 2^scale in an `i128`: 32 bits for the count of samples, [`HEADROOM_BITS`] above
//! the brightest radiance in the scene, 71 below it. Every f32 down to 2^-47 of the brightest is exact, smaller ones are
//! rounded once, each by itself. Integer addition is associative and commutative: tiles merge in any order, on any machine,
//! to the same bits. The mean is rounded once, at the end.
//!
//! Sample `i` of a pixel belongs to replicate `i % REPLICATES`. Replicates are independent of each other, so the spread of
//! their means measures the error of the whole mean.

mod error;
mod estimate;
pub mod file;
pub mod ranges;
pub mod records;
pub mod sums;
#[cfg(test)]
mod tests;

pub use error::RelativeError;
pub use estimate::Estimate;

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
