//! Random numbers as pure functions of (seed, pixel, sample index, dimension).
//!
//! A *slot* is one decision of a path (a direction, a light, a coin); it takes one or two numbers. Slots are numbered from
//! the camera on and are independent of each other (padding); within a slot, the samples of a pixel are well distributed. With
//! [`SamplerKind::SobolJoint`] the slots of one surface are distributed well together, too. docs/sampling.md compares the kinds.

use crate::film::REPLICATES;
use crate::settings::SamplerKind;
use crate::sobol::{morton, owen_hash, pascal, sobol, z_index};
use glam::Vec2;

/// Slots before the first surface: the positions on the film and on the lens.
const CAMERA_SLOTS: u32 = 2;
/// Slots of a surface hit, in the order of [`Slot`].
const SURFACE_SLOTS: u32 = 5;

/// The decisions at a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Slot {
    /// Which part of a composite material answers, and which of its lobes.
    Lobe = 0,
    /// The direction of the continuation.
    Direction = 1,
    /// Which light.
    Light = 2,
    /// Where on it.
    LightPoint = 3,
    /// Russian roulette.
    Roulette = 4,
}

/// Sobol' coordinates of the slots of a surface, first ones, for [`SamplerKind::SobolJoint`]: directions and points on lights
/// need the best pairs.
const JOINT: [u32; SURFACE_SLOTS as usize] = [4, 0, 5, 2, 6];

/// Bits of a sample's index in its replicate, for [`SamplerKind::SobolZ`]: what depends on the samples a pixel will have.
pub(crate) fn curve_bits(spp: u32) -> u32 {
    spp.div_ceil(REPLICATES as u32).next_power_of_two().ilog2()
}

/// The random numbers of one sample of one pixel.
#[derive(Clone, Copy, Debug)]
pub struct Sampler {
    kind: SamplerKind,
    /// Hash of seed, pixel and replicate; for [`SamplerKind::SobolZ`] of seed and replicate.
    stream: u64,
    /// Position in the replicate's sequence.
    index: u32,
    /// For [`SamplerKind::SobolZ`] alone: position of the pixel along the Z curve, and the bits of `index` behind it.
    curve: (u64, u32),
    /// Slot of the next decision's group.
    base: u32,
}

impl Sampler {
    /// The numbers of sample `index` of pixel (x, y). Indices deal samples out to the replicates in turn. `spp`, the samples
    /// that a pixel will have, matters to [`SamplerKind::SobolZ`] alone.
    #[inline(always)]
    pub fn new(kind: SamplerKind, seed: u64, x: u32, y: u32, index: u32, spp: u32) -> Self {
        let (replicate, index) = (u64::from(index % REPLICATES as u32), index / REPLICATES as u32);
        let (pixel, curve) = match kind {
            SamplerKind::SobolZ => (seed, (morton(x, y), curve_bits(spp))),
            _ => (seed ^ mix64(u64::from(x) << 32 | u64::from(y)), (0, 0)),
        };
        let stream = mix64(mix64(pixel).wrapping_add(replicate));
        Self { kind, stream, index, curve, base: 0 }
    }

    /// The position on the film, in [0,1)².
    #[inline(always)]
    pub fn film(&self) -> Vec2 {
        units(self.pair(0, 0, 0))
    }

    /// The position on the lens, in [0,1)².
    #[inline(always)]
    pub fn lens(&self) -> Vec2 {
        units(self.pair(1, 0, 2))
    }

    /// From here on, slots are those of the surface at `depth` (0: the first hit).
    #[inline(always)]
    pub fn at_surface(&mut self, depth: u32) {
        self.base = CAMERA_SLOTS + depth.wrapping_mul(SURFACE_SLOTS);
    }

    /// From here on, the numbers of sample `branch` of `count` that this one becomes: as well distributed among all of them.
    /// `count` is a power of two.
    #[inline(always)]
    pub fn branch(&self, branch: u32, count: u32) -> Self {
        let (pixel, bits) = self.curve;
        Self { index: self.index * count + branch, curve: (pixel, bits + count.ilog2()), ..*self }
    }

    /// One number in [0,1).
    #[inline(always)]
    pub fn one(&self, slot: Slot) -> f32 {
        let dimension = JOINT[slot as usize];
        let slot = self.base.wrapping_add(slot as u32);
        if self.kind == SamplerKind::Independent {
            return unit(self.hash(slot) as u32);
        }
        let (index, hash) = self.point(slot, self.base);
        match self.kind {
            SamplerKind::SobolJoint => unit(scramble_reversed(sobol(index, dimension), (hash >> 32) as u32)),
            _ => unit(scramble_reversed(index, (hash >> 32) as u32)),
        }
    }

    /// Two numbers in [0,1)².
    #[inline(always)]
    pub fn two(&self, slot: Slot) -> Vec2 {
        units(self.two_fractions(slot))
    }

    /// Two numbers as fractions of 2^32, which [`units`] makes floats of, less the last eight bits.
    #[inline(always)]
    pub fn two_fractions(&self, slot: Slot) -> [u32; 2] {
        self.pair(self.base.wrapping_add(slot as u32), self.base, JOINT[slot as usize])
    }

    /// Burley 2020, "Practical Hash-based Owen Scrambling", section 4: the index is shuffled, then each coordinate of the
    /// Sobol' point is scrambled by itself. The first coordinate is the index with its bits reversed.
    #[inline(always)]
    fn pair(&self, slot: u32, group: u32, dimension: u32) -> [u32; 2] {
        if self.kind == SamplerKind::Independent {
            let hash = self.hash(slot);
            return [hash as u32, (hash >> 32) as u32];
        }
        let (index, hash) = self.point(slot, group);
        let (x, y) = match self.kind {
            SamplerKind::SobolJoint => (sobol(index, dimension), sobol(index, dimension + 1)),
            _ => (index, pascal(index)),
        };
        let x = scramble_reversed(x, (hash >> 32) as u32);
        [x, scramble_reversed(y, mix32(hash as u32 ^ 0x9e37_79b9))]
    }

    /// The shuffled index of the Sobol' point and the hash that scrambles its coordinates.
    #[inline(always)]
    fn point(&self, slot: u32, group: u32) -> (u32, u64) {
        let hash = self.slot_seed(slot);
        let index = match self.kind {
            SamplerKind::SobolJoint => shuffle(self.index, self.slot_seed(group) as u32),
            SamplerKind::SobolZ => z_index(self.curve, self.index, hash as u32),
            SamplerKind::Sobol | SamplerKind::Independent => shuffle(self.index, hash as u32),
        };
        (index, hash)
    }

    #[inline(always)]
    fn slot_seed(&self, slot: u32) -> u64 {
        mix64(self.stream.wrapping_add(u64::from(slot).wrapping_mul(0x9e37_79b9_7f4a_7c15)))
    }

    #[inline(always)]
    fn hash(&self, slot: u32) -> u64 {
        mix64(self.slot_seed(slot) ^ u64::from(self.index))
    }
}

impl Sampler {
    /// What chooses numbers.
    #[inline(always)]
    pub fn kind(&self) -> SamplerKind {
        self.kind
    }
}

/// The numbers of many samples at once: as [`Sampler`]s, laid out for vectors.
pub struct Samplers<const N: usize> {
    stream: [u64; N],
    index: [u32; N],
    curve: [u64; N],
}

impl<const N: usize> Samplers<N> {
    /// Any at all.
    pub const NONE: Self = Self { stream: [0; N], index: [0; N], curve: [0; N] };

    /// Keeps a sampler, less what it has in common with the others.
    #[inline(always)]
    pub fn set(&mut self, i: usize, sampler: &Sampler) {
        (self.stream[i], self.index[i], self.curve[i]) = (sampler.stream, sampler.index, sampler.curve.0);
    }

    /// The sampler kept at `i`, at the surface of this depth. `like` has what they have in common.
    #[inline(always)]
    pub fn at(&self, i: usize, depth: u32, kind: SamplerKind, like: &Sampler) -> Sampler {
        let curve = (self.curve[i], like.curve.1);
        let mut sampler = Sampler { kind, stream: self.stream[i], index: self.index[i], curve, base: 0 };
        sampler.at_surface(depth);
        sampler
    }
}

/// The top 24 bits as a fraction: every value is exact and below 1.
#[inline(always)]
fn unit(bits: u32) -> f32 {
    (bits >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// Two fractions of 2^32 as floats, each less its last eight bits.
#[inline(always)]
pub fn units([x, y]: [u32; 2]) -> Vec2 {
    Vec2::new(unit(x), unit(y))
}

/// The inverse of [`units`], with the eight bits of `rest` that it drops.
#[inline(always)]
pub fn fraction(u: f32, rest: u32) -> u32 {
    ((u * 16_777_216.0) as u32).min(16_777_215) << 8 | rest & 0xff
}

/// The finaliser of SplitMix64 (Steele, Lea & Flood 2014): a bijection that mixes every bit.
#[inline(always)]
pub fn mix64(mut x: u64) -> u64 {
    x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// A 32-bit bijective mixer (Wellons' "lowbias32").
#[inline(always)]
fn mix32(mut x: u32) -> u32 {
    x = (x ^ (x >> 16)).wrapping_mul(0x7feb_352d);
    x = (x ^ (x >> 15)).wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

/// Owen-scrambles a number given with reversed bits, and puts the bits in order.
#[inline(always)]
fn scramble_reversed(reversed: u32, seed: u32) -> u32 {
    owen_hash(reversed, seed).reverse_bits()
}

/// Owen-scrambles the order of the indices: any aligned block of 2^k of them stays one.
#[inline(always)]
fn shuffle(index: u32, seed: u32) -> u32 {
    scramble_reversed(index.reverse_bits(), seed)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(kind: SamplerKind, count: u32, replicate: u32, slot: Slot) -> Vec<Vec2> {
        (0..count)
            .map(|i| {
                let mut sampler =
                    Sampler::new(kind, 7, 3, 5, i * REPLICATES as u32 + replicate, count * REPLICATES as u32);
                sampler.at_surface(2);
                sampler.two(slot)
            })
            .collect()
    }

    const NETS: [SamplerKind; 3] = [SamplerKind::Sobol, SamplerKind::SobolJoint, SamplerKind::SobolZ];

    /// Every elementary interval of 2^k boxes of equal area holds one of the first 2^k points, for every shape of the
    /// boxes: the definition of a (0,k,2)-net. Fails if a shift in `pascal` is wrong.
    #[test]
    fn the_points_of_a_replicate_are_a_net() {
        for (kind, k) in NETS.into_iter().flat_map(|kind| [(kind, 4u32), (kind, 8)]) {
            let points = points(kind, 1 << k, 1, Slot::Direction);
            for columns in 0..=k {
                let (nx, ny) = (1u32 << columns, 1u32 << (k - columns));
                let mut seen = vec![false; 1 << k];
                for p in &points {
                    let cell = (p.x * nx as f32) as u32 * ny + (p.y * ny as f32) as u32;
                    let twice = std::mem::replace(&mut seen[cell as usize], true);
                    assert!(!twice, "{kind:?}: two points in a {nx}×{ny} cell");
                }
            }
        }
    }

    /// Any number of samples, not only a power of two, falls evenly into the parts of every slot: of n points a half, a quarter
    /// or an eighth of the square holds its share, give or take two. Chance alone would miss by √n/2.
    #[test]
    fn any_count_is_stratified() {
        for kind in NETS {
            for n in [96u32, 100, 333, 1000] {
                let points = points(kind, n, 0, Slot::LightPoint);
                for parts in [2u32, 4, 8] {
                    let mut counts = vec![0i64; parts as usize];
                    points.iter().for_each(|p| counts[(p.x * parts as f32) as usize] += 1);
                    let even = f64::from(n) / f64::from(parts);
                    for count in counts {
                        assert!((count as f64 - even).abs() <= 3.0, "{kind:?}: {count} of {n} in one of {parts} parts");
                    }
                }
            }
        }
    }

    #[test]
    fn slots_and_replicates_and_pixels_differ() {
        for kind in NETS {
            let a = points(kind, 16, 0, Slot::Direction);
            assert_ne!(a, points(kind, 16, 1, Slot::Direction));
            assert_ne!(a, points(kind, 16, 0, Slot::LightPoint));
            let here = Sampler::new(kind, 7, 3, 5, 0, 64);
            let there = Sampler::new(kind, 7, 5, 3, 0, 64);
            assert_ne!(here.film(), there.film());
            assert_ne!(here.film(), here.lens());
        }
    }

    /// The integral of xy over the square is ¼; with N points the error of the net is far below the random one.
    #[test]
    fn a_net_beats_chance() {
        let n = 1024u32;
        let error = |kind| {
            let runs = (0..64u64).map(|seed| {
                let sum: f64 = (0..n)
                    .map(|i| Sampler::new(kind, seed, 0, 0, i, n).film())
                    .map(|p| f64::from(p.x) * f64::from(p.y))
                    .sum();
                (sum / f64::from(n) - 0.25).powi(2)
            });
            (runs.sum::<f64>() / 64.0).sqrt()
        };
        let (random, net) = (error(SamplerKind::Independent), error(SamplerKind::Sobol));
        // Var(xy) = 1/9 − 1/16, so the random error is √(0.0486/1024) = 0.0069.
        assert!((0.0055..0.0083).contains(&random), "random error {random}");
        assert!(net < random / 10.0, "net {net}, random {random}");
    }
}
