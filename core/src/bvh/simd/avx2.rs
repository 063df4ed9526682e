//! The AVX2 path: eight lanes in a `__m256`, four in a `__m128`.

#![allow(unsafe_code)]

use super::{Floats, Kernel, Lanes};
use std::arch::x86_64::*;

/// The proof that this processor has AVX2, BMI1, BMI2, LZCNT and POPCNT.
#[derive(Clone, Copy, Debug)]
pub struct Avx2(());

impl Avx2 {
    /// The token, where the processor has all of it.
    pub fn detect() -> Option<Self> {
        let has = is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("bmi1")
            && is_x86_feature_detected!("bmi2")
            && is_x86_feature_detected!("lzcnt")
            && is_x86_feature_detected!("popcnt");
        has.then_some(Avx2(()))
    }
}

/// Eight floats. A value of it exists only where an [`Avx2`] did.
#[derive(Clone, Copy, Debug)]
pub struct F32x8(__m256);

/// Four floats. A value of it exists only where an [`Avx2`] did.
#[derive(Clone, Copy, Debug)]
pub struct F32x4(__m128);

impl Floats<8> for F32x8 {
    type Token = Avx2;

    #[inline(always)]
    fn splat(_: Avx2, x: f32) -> Self {
        // SAFETY: the token proves AVX2.
        F32x8(unsafe { _mm256_set1_ps(x) })
    }
    #[inline(always)]
    fn load(_: Avx2, row: &[f32; 8]) -> Self {
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
        // SAFETY: `self` proves AVX2.
        unsafe { _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(self.0, other.0)) as u32 }
    }
    #[inline(always)]
    fn lt(self, other: Self) -> u32 {
        // SAFETY: `self` proves AVX2.
        unsafe { _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0)) as u32 }
    }
}

impl Floats<4> for F32x4 {
    type Token = Avx2;

    #[inline(always)]
    fn splat(_: Avx2, x: f32) -> Self {
        // SAFETY: the token proves AVX2, which includes SSE.
        F32x4(unsafe { _mm_set1_ps(x) })
    }
    #[inline(always)]
    fn load(_: Avx2, row: &[f32; 4]) -> Self {
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
        // SAFETY: `self` proves AVX.
        unsafe { _mm_movemask_ps(_mm_cmp_ps::<_CMP_LE_OQ>(self.0, other.0)) as u32 }
    }
    #[inline(always)]
    fn lt(self, other: Self) -> u32 {
        // SAFETY: `self` proves AVX.
        unsafe { _mm_movemask_ps(_mm_cmp_ps::<_CMP_LT_OQ>(self.0, other.0)) as u32 }
    }
}

impl Lanes for Avx2 {
    type X8 = F32x8;
    type X4 = F32x4;

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) -> K::Output {
        #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
        fn enter<K: Kernel>(lanes: Avx2, kernel: K) -> K::Output {
            kernel.run(lanes)
        }
        // SAFETY: the token proves every feature that is enabled.
        unsafe { enter(self, kernel) }
    }
}
