//! Random numbers as pure functions of (seed, pixel, sample index, dimension).
//!
//! A *slot* is one decision of a path (a direction, a light, a coin); it takes one or two numbers. Slots are numbered from
//! the camera on and are independent of each other (padding); within a slot, the samples of a pixel are well distributed.

use crate::film::REPLICATES;
use crate::settings::SamplerKind;
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

/// The random numbers of one sample of one pixel.
#[derive(Clone, Copy, Debug)]
pub struct Sampler {
    kind: SamplerKind,
    /// Hash of seed, pixel and replicate.
    stream: u64,
    /// Position in the replicate's sequence.
    index: u32,
    /// Slot of the next decision's group.
    base: u32,
}

impl Sampler {
    /// The numbers of sample `index` of pixel (x, y). Indices deal samples out to the replicates in turn.
    #[inline]
    pub fn new(kind: SamplerKind, seed: u64, x: u32, y: u32, index: u32) -> Self {
        let replicate = index % REPLICATES as u32;
        let pixel = mix64(seed ^ mix64(u64::from(x) << 32 | u64::from(y)));
        let stream = mix64(pixel.wrapping_add(u64::from(replicate)));
        Self { kind, stream, index: index / REPLICATES as u32, base: 0 }
    }

    /// The position on the film, in [0,1)².
    #[inline]
    pub fn film(&self) -> Vec2 {
        self.pair(0)
    }

    /// The position on the lens, in [0,1)².
    #[inline]
    pub fn lens(&self) -> Vec2 {
        self.pair(1)
    }

    /// From here on, slots are those of the surface at `depth` (0: the first hit).
    #[inline]
    pub fn at_surface(&mut self, depth: u32) {
        self.base = CAMERA_SLOTS + depth.wrapping_mul(SURFACE_SLOTS);
    }

    /// From here on, the numbers of sample `branch` of `count` that this one becomes: as well distributed among all of them.
    #[inline(always)]
    pub fn branch(&self, branch: u32, count: u32) -> Self {
        Self { index: self.index * count + branch, ..*self }
    }

    /// One number in [0,1).
    #[inline]
    pub fn one(&self, slot: Slot) -> f32 {
        let slot = self.base.wrapping_add(slot as u32);
        match self.kind {
            SamplerKind::Independent => unit(self.hash(slot) as u32),
            SamplerKind::Sobol => {
                let hash = self.slot_seed(slot);
                unit(scramble_reversed(shuffle(self.index, hash as u32), (hash >> 32) as u32))
            }
        }
    }

    /// Two numbers in [0,1)².
    #[inline]
    pub fn two(&self, slot: Slot) -> Vec2 {
        self.pair(self.base.wrapping_add(slot as u32))
    }

    /// Burley 2020, "Practical Hash-based Owen Scrambling", section 4: the index is shuffled, then each coordinate of the
    /// Sobol' point is scrambled by itself. The first coordinate is the index with its bits reversed.
    #[inline]
    fn pair(&self, slot: u32) -> Vec2 {
        match self.kind {
            SamplerKind::Independent => {
                let hash = self.hash(slot);
                Vec2::new(unit(hash as u32), unit((hash >> 32) as u32))
            }
            SamplerKind::Sobol => {
                let hash = self.slot_seed(slot);
                let index = shuffle(self.index, hash as u32);
                let x = scramble_reversed(index, (hash >> 32) as u32);
                let y = scramble_reversed(pascal(index), mix32(hash as u32 ^ 0x9e37_79b9));
                Vec2::new(unit(x), unit(y))
            }
        }
    }

    #[inline]
    fn slot_seed(&self, slot: u32) -> u64 {
        mix64(self.stream.wrapping_add(u64::from(slot).wrapping_mul(0x9e37_79b9_7f4a_7c15)))
    }

    #[inline]
    fn hash(&self, slot: u32) -> u64 {
        mix64(self.slot_seed(slot) ^ u64::from(self.index))
    }
}

/// The top 24 bits as a fraction: every value is exact and below 1.
#[inline]
fn unit(bits: u32) -> f32 {
    (bits >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// The finaliser of SplitMix64 (Steele, Lea & Flood 2014): a bijection that mixes every bit.
#[inline]
pub(crate) fn mix64(mut x: u64) -> u64 {
    x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// A 32-bit bijective mixer (Wellons' "lowbias32").
#[inline]
fn mix32(mut x: u32) -> u32 {
    x = (x ^ (x >> 16)).wrapping_mul(0x7feb_352d);
    x = (x ^ (x >> 15)).wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

/// Owen scrambling of a number whose bits are reversed: each bit is flipped by a hash of the bits below it. Laine & Karras
/// 2011 with Vegdahl's constants (2021).
#[inline]
fn owen_hash(mut x: u32, seed: u32) -> u32 {
    x ^= x.wrapping_mul(0x3d20_adea);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6c56);
    x ^ x.wrapping_mul(0x53a2_2864)
}

/// Owen-scrambles a number given with reversed bits, and puts the bits in order.
#[inline]
fn scramble_reversed(reversed: u32, seed: u32) -> u32 {
    owen_hash(reversed, seed).reverse_bits()
}

/// Owen-scrambles the order of the indices: any aligned block of 2^k of them stays one.
#[inline]
fn shuffle(index: u32, seed: u32) -> u32 {
    scramble_reversed(index.reverse_bits(), seed)
}

/// The second Sobol' coordinate of an index, with reversed bits. The generator matrix is Pascal's triangle mod 2, the
/// fivefold Kronecker power of `[[1,1],[0,1]]`, so five masked shifts apply it: bit i of the result is the parity of C(k, i)
/// over the set bits k of the index.
#[inline]
fn pascal(index: u32) -> u32 {
    let mut x = index;
    x ^= (x & 0xaaaa_aaaa) >> 1;
    x ^= (x & 0xcccc_cccc) >> 2;
    x ^= (x & 0xf0f0_f0f0) >> 4;
    x ^= (x & 0xff00_ff00) >> 8;
    x ^ (x >> 16)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(count: u32, replicate: u32, slot: Slot) -> Vec<Vec2> {
        (0..count)
            .map(|i| {
                let mut sampler = Sampler::new(SamplerKind::Sobol, 7, 3, 5, i * REPLICATES as u32 + replicate);
                sampler.at_surface(2);
                sampler.two(slot)
            })
            .collect()
    }

    /// Every elementary interval of 2^k boxes of equal area holds one of the first 2^k points, for every shape of the
    /// boxes: the definition of a (0,k,2)-net. Fails if a shift in `pascal` is wrong.
    #[test]
    fn the_points_of_a_replicate_are_a_net() {
        for k in [4u32, 8] {
            let points = points(1 << k, 1, Slot::Direction);
            for columns in 0..=k {
                let (nx, ny) = (1u32 << columns, 1u32 << (k - columns));
                let mut seen = vec![false; 1 << k];
                for p in &points {
                    let cell = (p.x * nx as f32) as u32 * ny + (p.y * ny as f32) as u32;
                    assert!(!std::mem::replace(&mut seen[cell as usize], true), "two points in a {nx}×{ny} cell");
                }
            }
        }
    }

    #[test]
    fn slots_and_replicates_and_pixels_differ() {
        let a = points(16, 0, Slot::Direction);
        assert_ne!(a, points(16, 1, Slot::Direction));
        assert_ne!(a, points(16, 0, Slot::LightPoint));
        let here = Sampler::new(SamplerKind::Sobol, 7, 3, 5, 0);
        let there = Sampler::new(SamplerKind::Sobol, 7, 5, 3, 0);
        assert_ne!(here.film(), there.film());
        assert_ne!(here.film(), here.lens());
    }

    /// The integral of xy over the square is ¼; with N points the error of the net is far below the random one.
    #[test]
    fn a_net_beats_chance() {
        let n = 1024u32;
        let error = |kind| {
            let runs = (0..64u64).map(|seed| {
                let sum: f64 = (0..n)
                    .map(|i| Sampler::new(kind, seed, 0, 0, i).film())
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
