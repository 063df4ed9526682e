//! Lambert plus a cosine lobe around the mirror direction: f = kd/π + ks (n + 2)/(2π) cosⁿ α (Lafortune & Willems 1994,
//! "Using the Modified Phong Reflectance Model for Physically Based Rendering"). It keeps energy if kd + ks ≤ 1.

use super::{Evaluation, Sample, both_above, mirrored};
use crate::frame::Frame;
use crate::warp::{around_z, cosine_hemisphere, cosine_hemisphere_pdf};
use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_1_PI, PI};

/// Its parameters.
#[derive(Clone, Copy, Debug)]
pub struct Phong {
    /// Albedo of the Lambert part.
    pub kd: Vec3,
    /// Albedo of the lobe.
    pub ks: Vec3,
    /// Exponent n of the lobe.
    pub exponent: f32,
}

impl Phong {
    /// f · cos θ, and the density of choosing between cosine and lobe by their albedos.
    #[inline]
    pub fn eval(&self, wo: Vec3, wi: Vec3) -> Evaluation {
        if !both_above(wo, wi) {
            return Evaluation::default();
        }
        let cos_alpha = mirrored(wo).dot(wi).max(0.0);
        let lobe = libm::powf(cos_alpha, self.exponent);
        let value = (self.kd * FRAC_1_PI + self.ks * ((self.exponent + 2.0) / (2.0 * PI) * lobe)) * wi.z;
        let lobe_pdf = (self.exponent + 1.0) / (2.0 * PI) * lobe;
        let share = self.diffuse_share();
        Evaluation { value, pdf: share * cosine_hemisphere_pdf(wi.z) + (1.0 - share) * lobe_pdf }
    }

    /// The cosine or the lobe; a direction below the surface is absorbed.
    #[inline]
    pub fn sample(&self, wo: Vec3, lobe: f32, u: Vec2) -> Option<Sample> {
        let wi = if lobe < self.diffuse_share() {
            cosine_hemisphere(u)
        } else {
            let cos_alpha = libm::powf(1.0 - u.x, 1.0 / (self.exponent + 1.0));
            Frame::around(mirrored(wo)).to_world(around_z(cos_alpha, u.y))
        };
        let Evaluation { value, pdf } = self.eval(wo, wi);
        (pdf > 0.0).then(|| Sample { wi, weight: value / pdf, pdf, eta: 1.0 })
    }

    #[inline]
    fn diffuse_share(&self) -> f32 {
        let (kd, ks) = (self.kd.max_element(), self.ks.max_element());
        if kd + ks > 0.0 { kd / (kd + ks) } else { 1.0 }
    }
}
