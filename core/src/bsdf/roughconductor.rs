//! A rough metal: facets that are mirrors, reflecting what Fresnel's equations say.

use super::microfacet::{Microfacet, Scattering, half_reflected, reflected};
use super::{Evaluation, Sample, both_above, fresnel};
use glam::{Vec2, Vec3};

/// Its parameters.
#[derive(Clone, Copy, Debug)]
pub struct RoughConductor {
    /// The facets.
    pub facets: Microfacet,
    /// Real part of the index of refraction.
    pub eta: Vec3,
    /// Imaginary part.
    pub k: Vec3,
    /// Factor on the reflection.
    pub specular_reflectance: Vec3,
}

impl RoughConductor {
    /// F D G / (4 cos θo) and the density of reflecting off a visible facet.
    #[inline(always)]
    pub fn eval(&self, wo: Vec3, wi: Vec3) -> Evaluation {
        if !both_above(wo, wi) {
            return Evaluation::default();
        }
        let Some(m) = half_reflected(wo, wi) else { return Evaluation::default() };
        let Scattering { value, pdf, .. } = self.facets.reflection(wo, wi, m);
        Evaluation { value: self.colour(wo, m) * value, pdf }
    }

    /// Off a visible facet; what goes below the surface is absorbed.
    #[inline(always)]
    pub fn sample(&self, wo: Vec3, u: Vec2) -> Option<Sample> {
        if wo.z <= 0.0 {
            return None;
        }
        let m = self.facets.sample_reflection(wo, u);
        let wi = reflected(wo, m);
        if wi.z <= 0.0 {
            return None;
        }
        let Scattering { pdf, weight, .. } = self.facets.reflection(wo, wi, m);
        (pdf > 0.0).then(|| Sample { wi, weight: self.colour(wo, m) * weight, pdf, eta: 1.0 })
    }

    #[inline(always)]
    fn colour(&self, wo: Vec3, m: Vec3) -> Vec3 {
        self.specular_reflectance * fresnel::conductor(wo.dot(m).clamp(0.0, 1.0), self.eta, self.k)
    }
}
