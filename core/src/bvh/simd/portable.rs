//! The path for any processor: arrays, which compilers turn into whatever vectors there are.

use super::{Floats, Kernel, Lanes};
use std::array;

/// The token of plain arrays; always at hand.
#[derive(Clone, Copy, Debug)]
pub struct Portable;

/// `N` floats, aligned like the vector they stand for.
#[derive(Clone, Copy, Debug)]
#[repr(align(16))]
pub struct Array<const N: usize>([f32; N]);

#[inline(always)]
fn zip<const N: usize>(a: Array<N>, b: Array<N>, f: impl Fn(f32, f32) -> f32) -> Array<N> {
    Array(array::from_fn(|i| f(a.0[i], b.0[i])))
}

#[inline(always)]
fn bits<const N: usize>(a: Array<N>, b: Array<N>, f: impl Fn(f32, f32) -> bool) -> u32 {
    (0..N).fold(0, |mask, i| mask | u32::from(f(a.0[i], b.0[i])) << i)
}

impl<const N: usize> Floats<N> for Array<N> {
    type Token = Portable;

    #[inline(always)]
    fn splat(_: Portable, x: f32) -> Self {
        Array([x; N])
    }
    #[inline(always)]
    fn load(_: Portable, row: &[f32; N]) -> Self {
        Array(*row)
    }
    #[inline(always)]
    fn store(self) -> [f32; N] {
        self.0
    }
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        zip(self, other, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        zip(self, other, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        zip(self, other, |a, b| a * b)
    }
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        zip(self, other, |a, b| a / b)
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        zip(self, other, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        zip(self, other, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn le(self, other: Self) -> u32 {
        bits(self, other, |a, b| a <= b)
    }
    #[inline(always)]
    fn lt(self, other: Self) -> u32 {
        bits(self, other, |a, b| a < b)
    }
}

impl Lanes for Portable {
    type X8 = Array<8>;
    type X4 = Array<4>;

    #[inline(always)]
    fn far_to_near(self, near: Self::X8, far: Self::X8, children: &[u32; 8]) -> ([u64; 8], usize) {
        let mut entries = [0; 8];
        let mut count = 0;
        for (slot, child) in children.iter().enumerate() {
            if near.0[slot] <= far.0[slot] {
                let entry = u64::from(near.0[slot].to_bits() & !7) << 32 | u64::from(*child);
                let mut at = count;
                while at > 0 && entries[at - 1] < entry {
                    entries[at] = entries[at - 1];
                    at -= 1;
                }
                entries[at] = entry;
                count += 1;
            }
        }
        (entries, count)
    }

    #[inline(never)]
    fn run<K: Kernel>(self, kernel: K) -> K::Output {
        kernel.run(self)
    }
}
