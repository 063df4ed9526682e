//! Vectors of f32 whose every lane does the same IEEE operation on every path, and the choice of a path at run time.
//!
//! Only `+ - * /`, x86's `min` and `max`, and compares are offered, and no fused multiply-add, so that the portable arrays,
//! AVX2 and AVX-512 give the same bits. The files of this folder are the only ones with `unsafe`. They know nothing of
//! rays or boxes.
//!
//! A [`Lanes`] value is a token: whoever holds one has proved that the processor has the instructions. Code that uses it
//! is generic, `#[inline(always)]`, and entered through [`Lanes::run`], whose body is compiled with those instructions.

mod memory;
mod portable;
#[cfg(target_arch = "x86_64")]
mod x86;

#[cfg(target_arch = "x86_64")]
pub use x86::{Avx2, Avx512};

pub(crate) use memory::prefetch_line;
pub(super) use memory::{Stack, StackMemory, prefetch, prefetch_lines, with_room};
pub use portable::Portable;

/// `N` lanes of f32.
pub trait Floats<const N: usize>: Copy {
    /// The proof that a vector may be made here.
    type Token: Copy;

    /// `x` in every lane.
    fn splat(token: Self::Token, x: f32) -> Self;
    /// The lanes of an array.
    fn load(token: Self::Token, row: &[f32; N]) -> Self;
    /// The lanes as an array.
    fn store(self) -> [f32; N];
    /// Lane by lane `self + other`.
    fn add(self, other: Self) -> Self;
    /// Lane by lane `self - other`.
    fn sub(self, other: Self) -> Self;
    /// Lane by lane `self * other`.
    fn mul(self, other: Self) -> Self;
    /// Lane by lane `self / other`.
    fn div(self, other: Self) -> Self;
    /// Lane by lane `if self < other { self } else { other }`: the other one where either is NaN.
    fn min(self, other: Self) -> Self;
    /// Lane by lane `if self > other { self } else { other }`: the other one where either is NaN.
    fn max(self, other: Self) -> Self;
    /// Bit `i` is set where lane `i` of `self` is at most that of `other`; clear where either is NaN.
    fn le(self, other: Self) -> u32;
    /// Bit `i` is set where lane `i` of `self` is below that of `other`; clear where either is NaN.
    fn lt(self, other: Self) -> u32;
}

/// A path: a proof that the processor has its instructions, and the vectors it works with.
pub trait Lanes: Copy + Send + Sync + 'static {
    /// Eight lanes: the children of a node.
    type X8: Floats<8, Token = Self>;
    /// Four lanes: the triangles of a block.
    type X4: Floats<4, Token = Self>;

    /// The children whose entry `near` is at most `far`, the farthest first, and how many they are; what follows them is
    /// meaningless. Each is its entry's bits, the last three of them cleared and used otherwise, above the child. Entries
    /// are not negative. The order of equal or nearly equal entries depends on the path.
    fn far_to_near(self, near: Self::X8, far: Self::X8, children: &[u32; 8]) -> ([u64; 8], usize);

    /// Runs `kernel` compiled with the instructions of this path.
    fn run<K: Kernel>(self, kernel: K) -> K::Output;
}

/// An operation that is compiled once a path.
pub trait Kernel {
    /// What it returns.
    type Output;

    /// The operation. Mark it `#[inline(always)]`, and whatever it calls that should profit from the path.
    fn run<L: Lanes>(self, lanes: L) -> Self::Output;
}

/// The paths there are. All give the same bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Isa {
    /// Plain arrays, for any processor.
    Portable,
    /// AVX2 with BMI and LZCNT: x86-64 since 2013.
    Avx2,
    /// AVX-512 F, VL, BW and DQ on 256-bit registers.
    Avx512,
}

impl Isa {
    /// Every path, slowest first.
    pub const ALL: [Isa; 3] = [Isa::Portable, Isa::Avx2, Isa::Avx512];

    /// The fastest path of this processor.
    pub fn detect() -> Isa {
        Isa::ALL.into_iter().rfind(|isa| isa.is_available()).unwrap_or(Isa::Portable)
    }

    /// The paths of this processor, slowest first.
    pub fn available() -> Vec<Isa> {
        Isa::ALL.into_iter().filter(|isa| isa.is_available()).collect()
    }

    /// Whether this processor has the path.
    pub fn is_available(self) -> bool {
        match self {
            Isa::Portable => true,
            #[cfg(target_arch = "x86_64")]
            Isa::Avx2 => Avx2::detect().is_some(),
            #[cfg(target_arch = "x86_64")]
            Isa::Avx512 => Avx512::detect().is_some(),
            #[cfg(not(target_arch = "x86_64"))]
            _ => false,
        }
    }

    /// `portable`, `avx2` or `avx512`.
    pub fn name(self) -> &'static str {
        match self {
            Isa::Portable => "portable",
            Isa::Avx2 => "avx2",
            Isa::Avx512 => "avx512",
        }
    }

    /// The path of that name.
    pub fn from_name(name: &str) -> Option<Isa> {
        Isa::ALL.into_iter().find(|isa| isa.name() == name)
    }

    /// Runs `kernel` on this path, or on the portable one where the processor lacks it: the result is the same.
    #[inline]
    pub fn dispatch<K: Kernel>(self, kernel: K) -> K::Output {
        #[cfg(target_arch = "x86_64")]
        match self {
            Isa::Avx512 => {
                if let Some(lanes) = Avx512::detect() {
                    return lanes.run(kernel);
                }
            }
            Isa::Avx2 => {
                if let Some(lanes) = Avx2::detect() {
                    return lanes.run(kernel);
                }
            }
            Isa::Portable => {}
        }
        Portable.run(kernel)
    }
}
