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
    #[inline]
    pub fn eval(&self, wo: Vec3, wi: Vec3) -> Evaluation {
        if both_above(wo, wi) {
            Evaluation { value: self.reflectance * (FRAC_1_PI * wi.z), pdf: cosine_hemisphere_pdf(wi.z) }
        } else {
            Evaluation::default()
        }
    }

    /// By the cosine: f · cos θ / pdf is the albedo.
    #[inline]
    pub fn sample(&self, wo: Vec3, u: Vec2) -> Option<Sample> {
        let wi = cosine_hemisphere(u);
        both_above(wo, wi).then(|| Sample { wi, weight: self.reflectance, pdf: cosine_hemisphere_pdf(wi.z), eta: 1.0 })
    }
}
