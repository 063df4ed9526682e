//! Sobol' points by their indices: coordinates, scrambling, and the order of pixels along a Z curve.
//!
//! Coordinates come with reversed bits (the first binary digit of the fraction is bit 0), as [`owen_hash`] wants them.

/// Owen scrambling of a number whose bits are reversed: each bit is flipped by a hash of the bits below it. Laine & Karras
/// 2011 with Vegdahl's constants (2021).
#[inline(always)]
pub(crate) fn owen_hash(mut x: u32, seed: u32) -> u32 {
    x ^= x.wrapping_mul(0x3d20_adea);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6c56);
    x ^ x.wrapping_mul(0x53a2_2864)
}

/// The second Sobol' coordinate of an index, with reversed bits. The generator matrix is Pascal's triangle mod 2, the
/// fivefold Kronecker power of `[[1,1],[0,1]]`, so five masked shifts apply it: bit i of the result is the parity of C(k, i)
/// over the set bits k of the index.
#[inline(always)]
pub(crate) fn pascal(index: u32) -> u32 {
    let mut x = index;
    x ^= (x & 0xaaaa_aaaa) >> 1;
    x ^= (x & 0xcccc_cccc) >> 2;
    x ^= (x & 0xf0f0_f0f0) >> 4;
    x ^= (x & 0xff00_ff00) >> 8;
    x ^ (x >> 16)
}

/// Coordinates that [`sobol`] has.
const DIMENSIONS: usize = 7;

/// Primitive polynomials and initial direction numbers of the third coordinate and on (Joe & Kuo 2008, new-joe-kuo-6): degree,
/// inner coefficients, numbers.
const JOE_KUO: [(usize, u32, [u32; 5]); DIMENSIONS - 2] = [
    (2, 1, [1, 3, 0, 0, 0]),
    (3, 1, [1, 3, 1, 0, 0]),
    (3, 2, [1, 1, 1, 0, 0]),
    (4, 1, [1, 1, 3, 3, 0]),
    (4, 4, [1, 3, 5, 13, 0]),
];

/// For each coordinate from the third on and each byte of an index, what that byte adds.
static TABLES: [[[u32; 256]; 4]; DIMENSIONS - 2] = tables();

/// Column k of each generator matrix, with reversed bits: what bit k of the index adds.
const fn columns(dimension: usize) -> [u32; 32] {
    let (degree, coefficients, initial) = JOE_KUO[dimension];
    let mut v = [0u32; 32];
    let mut k = 0;
    while k < 32 {
        v[k] = if k < degree {
            initial[k] << (31 - k)
        } else {
            let mut value = v[k - degree] ^ (v[k - degree] >> degree);
            let mut i = 1;
            while i < degree {
                if (coefficients >> (degree - 1 - i)) & 1 == 1 {
                    value ^= v[k - i];
                }
                i += 1;
            }
            value
        };
        k += 1;
    }
    let mut k = 0;
    while k < 32 {
        v[k] = v[k].reverse_bits();
        k += 1;
    }
    v
}

const fn tables() -> [[[u32; 256]; 4]; DIMENSIONS - 2] {
    let mut tables = [[[0u32; 256]; 4]; DIMENSIONS - 2];
    let mut d = 0;
    while d < DIMENSIONS - 2 {
        let columns = columns(d);
        let mut byte = 0;
        while byte < 4 {
            let mut value = 1;
            while value < 256usize {
                // The lowest set bit, and what the others add.
                let low = value.trailing_zeros() as usize;
                tables[d][byte][value] = tables[d][byte][value & (value - 1)] ^ columns[8 * byte + low];
                value += 1;
            }
            byte += 1;
        }
        d += 1;
    }
    tables
}

/// Coordinate `dimension` (below seven) of the Sobol' point `index`, with reversed bits.
#[inline(always)]
pub(crate) fn sobol(index: u32, dimension: u32) -> u32 {
    match dimension {
        0 => index,
        1 => pascal(index),
        _ => {
            let [a, b, c, d] = index.to_le_bytes().map(usize::from);
            let table = &TABLES[dimension as usize - 2];
            table[0][a] ^ table[1][b] ^ table[2][c] ^ table[3][d]
        }
    }
}

/// The position of (x, y) along a Z curve: their bits interleaved.
#[inline(always)]
pub(crate) fn morton(x: u32, y: u32) -> u64 {
    let spread = |v: u32| {
        let mut v = u64::from(v);
        v = (v ^ (v << 16)) & 0x0000_ffff_0000_ffff;
        v = (v ^ (v << 8)) & 0x00ff_00ff_00ff_00ff;
        v = (v ^ (v << 4)) & 0x0f0f_0f0f_0f0f_0f0f;
        v = (v ^ (v << 2)) & 0x3333_3333_3333_3333;
        (v ^ (v << 1)) & 0x5555_5555_5555_5555
    };
    spread(x) | spread(y) << 1
}

/// Base-4 digits of the Z curve that are permuted. Pixels farther apart than 2^8 share their points in another order.
const CURVE_DIGITS: u32 = 8;

/// The index of a sample in the one sequence that runs along the Z curve (Ahmed & Wonka 2020, "Screen-space blue-noise diffusion
/// of Monte Carlo sampling error via hierarchical ordering of pixels"): each base-4 digit of the pixel's position is permuted by
/// a hash of the digits above it, the bits of the pixel's own samples likewise. Only the lowest 32 bits of it count, and of the
/// curve at most [`CURVE_DIGITS`].
#[inline(always)]
pub(crate) fn z_index((curve, bits): (u64, u32), index: u32, seed: u32) -> u32 {
    let mut position = 0u32;
    for digit in (0..CURVE_DIGITS).rev() {
        let above = curve >> (2 * digit + 2);
        let hash = crate::sampler::mix64(above ^ u64::from(seed) << 32 ^ u64::from(digit) << 24);
        let place = (curve >> (2 * digit)) as u32 & 3;
        position = position << 2 | permuted(place, hash);
    }
    let own = crate::sampler::mix64(curve ^ u64::from(seed) << 32) as u32;
    let shuffled = owen_hash(index.reverse_bits(), own).reverse_bits();
    // Within a pixel the indices stay an aligned block; beyond what was asked for they fall into other pixels' blocks, scrambled.
    let mask = 1u32.checked_shl(bits).map_or(u32::MAX, |end| end - 1);
    position.checked_shl(bits).unwrap_or(0) ^ (shuffled & mask) ^ (index & !mask)
}

/// One of the 24 permutations of four, chosen by a hash.
#[inline(always)]
fn permuted(place: u32, hash: u64) -> u32 {
    // Fisher & Yates, in two bits an entry.
    let mut order = 0b11_10_01_00u32;
    let mut choice = (hash >> 32) % 24;
    for i in (1..4).rev() {
        let j = (choice % (i + 1)) as u32;
        choice /= i + 1;
        let (a, b) = ((order >> (2 * i)) & 3, (order >> (2 * j)) & 3);
        order ^= (a ^ b) << (2 * i) ^ (a ^ b) << (2 * j);
    }
    order >> (2 * place) & 3
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first points of the reference implementation (new-joe-kuo-6), coordinates three to seven of point 5 and 7.
    #[test]
    fn every_coordinate_is_stratified() {
        for dimension in 0..DIMENSIONS as u32 {
            for k in [1, 4, 8] {
                let mut seen = vec![false; 1 << k];
                for index in 0..1u32 << k {
                    let cell = sobol(index, dimension).reverse_bits() >> (32 - k);
                    assert!(!std::mem::replace(&mut seen[cell as usize], true), "dimension {dimension}, 2^{k} points");
                }
            }
        }
    }

    /// Point 3 (binary 11) of coordinates 3 to 7: both direction numbers, read off Joe & Kuo's table: v1 ^ v2.
    #[test]
    fn points_are_those_of_joe_and_kuo() {
        let halves = [0b11, 0b11, 0b01, 0b01, 0b11];
        for (dimension, m2) in (2u32..).zip(halves) {
            let expected = (1u32 << 31) ^ (m2 << 30);
            assert_eq!(sobol(3, dimension).reverse_bits(), expected, "dimension {dimension}");
        }
    }

    #[test]
    fn a_permutation_is_one() {
        for hash in 0..24u64 {
            let mut places = [0, 1, 2, 3].map(|place| permuted(place, hash << 32));
            places.sort_unstable();
            assert_eq!(places, [0, 1, 2, 3]);
        }
        assert_eq!((morton(3, 0), morton(0, 2), morton(65535, 65535)), (5, 8, 0xffff_ffff));
    }
}
