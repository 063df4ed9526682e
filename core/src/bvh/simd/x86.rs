//! The paths of x86-64: eight lanes in a `__m256`, four in a `__m128`.
//!
//! AVX-512 works on the registers of AVX2, of which it has twice as many, and compares into mask registers; registers of 512
//! bits would be half empty here.

#![allow(unsafe_code)]

use super::{Floats, Kernel, Lanes};
use std::arch::x86_64::*;

/// The proof that this processor has AVX2, BMI1, BMI2, LZCNT and POPCNT, and where `AVX512` AVX-512 F, VL, BW and DQ.
#[derive(Clone, Copy, Debug)]
pub struct X86<const AVX512: bool>(());

/// The proof of AVX2.
pub type Avx2 = X86<false>;
/// The proof of AVX-512.
pub type Avx512 = X86<true>;

impl<const AVX512: bool> X86<AVX512> {
    /// The token, where the processor has all of it.
    pub fn detect() -> Option<Self> {
        let avx2 = is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("bmi1")
            && is_x86_feature_detected!("bmi2")
            && is_x86_feature_detected!("lzcnt")
            && is_x86_feature_detected!("popcnt");
        let avx512 = is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512vl")
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("avx512dq");
        (avx2 && (avx512 || !AVX512)).then_some(X86(()))
    }
}

/// Eight floats. A value of it exists only where an [`X86`] did.
#[derive(Clone, Copy, Debug)]
pub struct F32x8<const AVX512: bool>(__m256);

/// Four floats. A value of it exists only where an [`X86`] did.
#[derive(Clone, Copy, Debug)]
pub struct F32x4<const AVX512: bool>(__m128);

impl<const AVX512: bool> Floats<8> for F32x8<AVX512> {
    type Token = X86<AVX512>;

    #[inline(always)]
    fn splat(_: X86<AVX512>, x: f32) -> Self {
        // SAFETY: the token proves AVX2.
        F32x8(unsafe { _mm256_set1_ps(x) })
    }
    #[inline(always)]
    fn load(_: X86<AVX512>, row: &[f32; 8]) -> Self {
        // SAFETY: the token proves AVX2; the reference is valid for 32 bytes and the load needs no alignment.
        F32x8(unsafe { _mm256_loadu_ps(row.as_ptr()) })
    }
    #[inline(always)]
    fn store(self) -> [f32; 8] {
        let mut row = [0.0; 8];
        // SAFETY: `self` proves AVX2; `row` is valid for 32 bytes and the store needs no alignment.
        unsafe { _mm256_storeu_ps(row.as_mut_ptr(), self.0) };
        row
    }
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        // SAFETY: `self` proves AVX2.
        F32x8(unsafe { _mm256_add_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        // SAFETY: `self` proves AVX2.
        F32x8(unsafe { _mm256_sub_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        // SAFETY: `self` proves AVX2.
        F32x8(unsafe { _mm256_mul_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        // SAFETY: `self` proves AVX2.
        F32x8(unsafe { _mm256_div_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        // SAFETY: `self` proves AVX2.
        F32x8(unsafe { _mm256_min_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        // SAFETY: `self` proves AVX2.
        F32x8(unsafe { _mm256_max_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn le(self, other: Self) -> u32 {
        if AVX512 {
            // SAFETY: `self` proves AVX-512 F and VL.
            return u32::from(unsafe { _mm256_cmp_ps_mask::<_CMP_LE_OQ>(self.0, other.0) });
        }
        // SAFETY: `self` proves AVX2.
        unsafe { _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(self.0, other.0)) as u32 }
    }
    #[inline(always)]
    fn lt(self, other: Self) -> u32 {
        if AVX512 {
            // SAFETY: `self` proves AVX-512 F and VL.
            return u32::from(unsafe { _mm256_cmp_ps_mask::<_CMP_LT_OQ>(self.0, other.0) });
        }
        // SAFETY: `self` proves AVX2.
        unsafe { _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0)) as u32 }
    }
}

impl<const AVX512: bool> Floats<4> for F32x4<AVX512> {
    type Token = X86<AVX512>;

    #[inline(always)]
    fn splat(_: X86<AVX512>, x: f32) -> Self {
        // SAFETY: the token proves AVX2, which includes SSE.
        F32x4(unsafe { _mm_set1_ps(x) })
    }
    #[inline(always)]
    fn load(_: X86<AVX512>, row: &[f32; 4]) -> Self {
        // SAFETY: the token proves SSE; the reference is valid for 16 bytes and the load needs no alignment.
        F32x4(unsafe { _mm_loadu_ps(row.as_ptr()) })
    }
    #[inline(always)]
    fn store(self) -> [f32; 4] {
        let mut row = [0.0; 4];
        // SAFETY: `self` proves SSE; `row` is valid for 16 bytes and the store needs no alignment.
        unsafe { _mm_storeu_ps(row.as_mut_ptr(), self.0) };
        row
    }
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        // SAFETY: `self` proves AVX2, which includes SSE.
        F32x4(unsafe { _mm_add_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        // SAFETY: `self` proves AVX2, which includes SSE.
        F32x4(unsafe { _mm_sub_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        // SAFETY: `self` proves AVX2, which includes SSE.
        F32x4(unsafe { _mm_mul_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        // SAFETY: `self` proves AVX2, which includes SSE.
        F32x4(unsafe { _mm_div_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        // SAFETY: `self` proves AVX2, which includes SSE.
        F32x4(unsafe { _mm_min_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        // SAFETY: `self` proves AVX2, which includes SSE.
        F32x4(unsafe { _mm_max_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn le(self, other: Self) -> u32 {
        if AVX512 {
            // SAFETY: `self` proves AVX-512 F and VL.
            return u32::from(unsafe { _mm_cmp_ps_mask::<_CMP_LE_OQ>(self.0, other.0) });
        }
        // SAFETY: `self` proves AVX2.
        unsafe { _mm_movemask_ps(_mm_cmp_ps::<_CMP_LE_OQ>(self.0, other.0)) as u32 }
    }
    #[inline(always)]
    fn lt(self, other: Self) -> u32 {
        if AVX512 {
            // SAFETY: `self` proves AVX-512 F and VL.
            return u32::from(unsafe { _mm_cmp_ps_mask::<_CMP_LT_OQ>(self.0, other.0) });
        }
        // SAFETY: `self` proves AVX2.
        unsafe { _mm_movemask_ps(_mm_cmp_ps::<_CMP_LT_OQ>(self.0, other.0)) as u32 }
    }
}

/// The hits among eight children, far to near: see [`Lanes::far_to_near`].
#[inline(always)]
fn far_to_near<const AVX512: bool>(near: F32x8<AVX512>, far: F32x8<AVX512>, children: &[u32; 8]) -> ([u64; 8], usize) {
    let mut entries = [0; 8];
    // SAFETY: `near` proves AVX2; `children` is valid for a load of 32 bytes and `entries` for two stores.
    unsafe {
        let hit = _mm256_cmp_ps::<_CMP_LE_OQ>(near.0, far.0);
        let count = _mm256_movemask_ps(hit).count_ones() as usize;
        let slots = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
        let bits = _mm256_andnot_si256(_mm256_set1_epi32(7), _mm256_castps_si256(near.0));
        let missed = _mm256_castsi256_ps(_mm256_set1_epi32(i32::MIN));
        let keys = _mm256_castsi256_ps(_mm256_or_si256(bits, slots));
        let keys = _mm256_castps_si256(_mm256_blendv_ps(missed, keys, hit));
        let keys = descending(keys);
        // A permutation looks at the lowest three bits alone, which are the slot.
        let children = _mm256_loadu_si256(children.as_ptr().cast());
        let children = _mm256_permutevar8x32_epi32(children, keys);
        let low = _mm256_unpacklo_epi32(children, keys);
        let high = _mm256_unpackhi_epi32(children, keys);
        let out: *mut __m256i = entries.as_mut_ptr().cast();
        _mm256_storeu_si256(out, _mm256_permute2x128_si256::<0x20>(low, high));
        _mm256_storeu_si256(out.add(1), _mm256_permute2x128_si256::<0x31>(low, high));
        (entries, count)
    }
}

/// Sorts eight integers by a bitonic network: six rounds of compare and exchange.
///
/// # Safety
/// The processor has AVX2.
#[inline(always)]
unsafe fn descending(x: __m256i) -> __m256i {
    // SAFETY: the caller answers for AVX2.
    unsafe {
        let pairs = |x| {
            let y = _mm256_shuffle_epi32::<0b10_11_00_01>(x);
            _mm256_blend_epi32::<0b1010_1010>(_mm256_max_epi32(x, y), _mm256_min_epi32(x, y))
        };
        let x = pairs(x);
        let y = _mm256_shuffle_epi32::<0b00_01_10_11>(x);
        let x = _mm256_blend_epi32::<0b1100_1100>(_mm256_max_epi32(x, y), _mm256_min_epi32(x, y));
        let x = pairs(x);
        let y = _mm256_permutevar8x32_epi32(x, _mm256_setr_epi32(7, 6, 5, 4, 3, 2, 1, 0));
        let x = _mm256_blend_epi32::<0b1111_0000>(_mm256_max_epi32(x, y), _mm256_min_epi32(x, y));
        let y = _mm256_shuffle_epi32::<0b01_00_11_10>(x);
        let x = _mm256_blend_epi32::<0b1100_1100>(_mm256_max_epi32(x, y), _mm256_min_epi32(x, y));
        pairs(x)
    }
}

impl Lanes for Avx2 {
    type X8 = F32x8<false>;
    type X4 = F32x4<false>;

    #[inline(always)]
    fn far_to_near(self, near: Self::X8, far: Self::X8, children: &[u32; 8]) -> ([u64; 8], usize) {
        far_to_near(near, far, children)
    }

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) -> K::Output {
        #[inline(never)]
        #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
        fn enter<K: Kernel>(lanes: Avx2, kernel: K) -> K::Output {
            kernel.run(lanes)
        }
        // SAFETY: the token proves every feature that is enabled.
        unsafe { enter(self, kernel) }
    }
}

impl Lanes for Avx512 {
    type X8 = F32x8<true>;
    type X4 = F32x4<true>;

    #[inline(always)]
    fn far_to_near(self, near: Self::X8, far: Self::X8, children: &[u32; 8]) -> ([u64; 8], usize) {
        far_to_near(near, far, children)
    }

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) -> K::Output {
        #[inline(never)]
        #[target_feature(enable = "avx512f,avx512vl,avx512bw,avx512dq,avx2,bmi1,bmi2,lzcnt,popcnt")]
        fn enter<K: Kernel>(lanes: Avx512, kernel: K) -> K::Output {
            kernel.run(lanes)
        }
        // SAFETY: the token proves every feature that is enabled.
        unsafe { enter(self, kernel) }
    }
}
