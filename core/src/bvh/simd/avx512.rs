//! The AVX-512 path: the registers of AVX2, twice as many, with compares into mask registers.

#![allow(unsafe_code)]

use super::{Floats, Kernel, Lanes};
use std::arch::x86_64::*;

/// The proof that this processor has AVX-512 (F, VL, BW, DQ), AVX2, BMI1, BMI2, LZCNT and POPCNT.
#[derive(Clone, Copy, Debug)]
pub struct Avx512(());

impl Avx512 {
    /// The token, where the processor has all of it.
    pub fn detect() -> Option<Self> {
        let has = is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512vl")
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("bmi1")
            && is_x86_feature_detected!("bmi2")
            && is_x86_feature_detected!("lzcnt")
            && is_x86_feature_detected!("popcnt");
        has.then_some(Avx512(()))
    }
}

/// Eight floats. A value of it exists only where an [`Avx512`] did.
#[derive(Clone, Copy, Debug)]
pub struct F32x8(__m256);

/// Four floats. A value of it exists only where an [`Avx512`] did.
#[derive(Clone, Copy, Debug)]
pub struct F32x4(__m128);

impl Floats<8> for F32x8 {
    type Token = Avx512;

    #[inline(always)]
    fn splat(_: Avx512, x: f32) -> Self {
        // SAFETY: the token proves AVX-512.
        F32x8(unsafe { _mm256_set1_ps(x) })
    }
    #[inline(always)]
    fn load(_: Avx512, row: &[f32; 8]) -> Self {
        // SAFETY: the token proves AVX-512; the reference is valid for 32 bytes and the load needs no alignment.
        F32x8(unsafe { _mm256_loadu_ps(row.as_ptr()) })
    }
    #[inline(always)]
    fn store(self) -> [f32; 8] {
        let mut row = [0.0; 8];
        // SAFETY: `self` proves AVX-512; `row` is valid for 32 bytes and the store needs no alignment.
        unsafe { _mm256_storeu_ps(row.as_mut_ptr(), self.0) };
        row
    }
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        // SAFETY: `self` proves AVX-512.
        F32x8(unsafe { _mm256_add_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        // SAFETY: `self` proves AVX-512.
        F32x8(unsafe { _mm256_sub_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        // SAFETY: `self` proves AVX-512.
        F32x8(unsafe { _mm256_mul_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        // SAFETY: `self` proves AVX-512.
        F32x8(unsafe { _mm256_div_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        // SAFETY: `self` proves AVX-512.
        F32x8(unsafe { _mm256_min_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        // SAFETY: `self` proves AVX-512.
        F32x8(unsafe { _mm256_max_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn le(self, other: Self) -> u32 {
        // SAFETY: `self` proves AVX-512.
        unsafe { u32::from(_mm256_cmp_ps_mask::<_CMP_LE_OQ>(self.0, other.0)) }
    }
    #[inline(always)]
    fn lt(self, other: Self) -> u32 {
        // SAFETY: `self` proves AVX-512.
        unsafe { u32::from(_mm256_cmp_ps_mask::<_CMP_LT_OQ>(self.0, other.0)) }
    }
}

impl Floats<4> for F32x4 {
    type Token = Avx512;

    #[inline(always)]
    fn splat(_: Avx512, x: f32) -> Self {
        // SAFETY: the token proves AVX-512, which includes SSE.
        F32x4(unsafe { _mm_set1_ps(x) })
    }
    #[inline(always)]
    fn load(_: Avx512, row: &[f32; 4]) -> Self {
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
        // SAFETY: `self` proves AVX-512, which includes SSE.
        F32x4(unsafe { _mm_add_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        // SAFETY: `self` proves AVX-512, which includes SSE.
        F32x4(unsafe { _mm_sub_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        // SAFETY: `self` proves AVX-512, which includes SSE.
        F32x4(unsafe { _mm_mul_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        // SAFETY: `self` proves AVX-512, which includes SSE.
        F32x4(unsafe { _mm_div_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        // SAFETY: `self` proves AVX-512, which includes SSE.
        F32x4(unsafe { _mm_min_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        // SAFETY: `self` proves AVX-512, which includes SSE.
        F32x4(unsafe { _mm_max_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn le(self, other: Self) -> u32 {
        // SAFETY: `self` proves AVX-512.
        unsafe { u32::from(_mm_cmp_ps_mask::<_CMP_LE_OQ>(self.0, other.0)) }
    }
    #[inline(always)]
    fn lt(self, other: Self) -> u32 {
        // SAFETY: `self` proves AVX-512.
        unsafe { u32::from(_mm_cmp_ps_mask::<_CMP_LT_OQ>(self.0, other.0)) }
    }
}

impl Lanes for Avx512 {
    type X8 = F32x8;
    type X4 = F32x4;

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) -> K::Output {
        #[target_feature(enable = "avx2,avx512f,avx512vl,avx512bw,avx512dq,bmi1,bmi2,lzcnt,popcnt")]
        fn enter<K: Kernel>(lanes: Avx512, kernel: K) -> K::Output {
            kernel.run(lanes)
        }
        // SAFETY: the token proves every feature that is enabled.
        unsafe { enter(self, kernel) }
    }
}
