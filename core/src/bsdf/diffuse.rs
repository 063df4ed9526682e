//! Lambert's reflector: f = albedo / π above the surface, black below.

use super::{Evaluation, Sample, both_above};
use crate::warp::{cosine_hemisphere, cosine_hemisphere_pdf};
use glam::{Vec2, Vec3};
use std::f32::consts::FRAC_1_PI;

/// Its parameters.
#[derive(Clone, Copy, Debug)]
pub struct Diffuse {
    /// Albedo.
    pub reflectance: Vec3,
}

impl Diffuse {
    /// f · cos θ and the density of the cosine.
    #[inline(always)]
    pub fn eval(&self, wo: Vec3, wi: Vec3) -> Evaluation {
        let above = both_above(wo, wi);
        let value = self.reflectance * (FRAC_1_PI * wi.z);
        Evaluation {
            value: if above { value } else { Vec3::ZERO },
            pdf: if above { cosine_hemisphere_pdf(wi.z) } else { 0.0 },
        }
    }

    /// By the cosine: f · cos θ / pdf is the albedo.
    #[inline(always)]
    pub fn sample(&self, wo: Vec3, u: Vec2) -> Option<Sample> {
        let (sample, is_some) = self.sample_flagged(wo, u);
        is_some.then_some(sample)
    }

    /// As [`Diffuse::sample`], without branches: a sample, and whether it is one.
    #[inline(always)]
    pub fn sample_flagged(&self, wo: Vec3, u: Vec2) -> (Sample, bool) {
        let wi = cosine_hemisphere(u);
        (Sample { wi, weight: self.reflectance, pdf: cosine_hemisphere_pdf(wi.z), eta: 1.0 }, both_above(wo, wi))
    }
}
