//! A rough interface between transparent media: facets that reflect or refract (Walter et al. 2007).

use super::microfacet::{Microfacet, half_reflected, half_refracted, reflected};
use super::{Evaluation, Sample, fresnel};
use glam::{Vec2, Vec3};

/// Within this of one, an index bends light by less than the rounding of directions allows to tell the facets by: light
/// goes straight through then.
const INDEX_RESOLUTION: f32 = 2e-5;

/// Its parameters.
#[derive(Clone, Copy, Debug)]
pub struct RoughDielectric {
    /// The facets.
    pub facets: Microfacet,
    /// Index of refraction inside over outside.
    pub eta: f32,
    /// Factor on the reflection.
    pub specular_reflectance: Vec3,
    /// Factor on the transmission.
    pub specular_transmittance: Vec3,
}

impl RoughDielectric {
    /// Reflection or refraction by visible facets, each as likely as Fresnel's equations make it.
    #[inline]
    pub fn eval(&self, wo: Vec3, wi: Vec3) -> Evaluation {
        if wo.z == 0.0 || wi.z == 0.0 {
            return Evaluation::default();
        }
        if (wo.z > 0.0) == (wi.z > 0.0) {
            let Some(m) = half_reflected(wo, wi) else { return Evaluation::default() };
            let share = fresnel::dielectric(wo.dot(m), self.eta).reflectance;
            let part = self.facets.visible_reflection(wo, wi, m);
            return Evaluation { value: self.specular_reflectance * (share * part.value), pdf: share * part.pdf };
        }
        let eta = if wo.z > 0.0 { self.eta } else { 1.0 / self.eta };
        match half_refracted(wo, wi, eta) {
            Some(m) if !self.is_straight() => {
                let share = 1.0 - fresnel::dielectric(wo.dot(m), self.eta).reflectance;
                let part = self.facets.refraction(wo, wi, m, eta);
                Evaluation { value: self.specular_transmittance * (share * part.value), pdf: share * part.pdf }
            }
            _ => Evaluation::default(),
        }
    }

    /// By a visible facet, the mirror direction with probability of its reflectance, else the refracted one.
    #[inline]
    pub fn sample(&self, wo: Vec3, lobe: f32, u: Vec2) -> Option<Sample> {
        if wo.z == 0.0 {
            return None;
        }
        let m = self.facets.sample_visible(if wo.z > 0.0 { wo } else { -wo }, u);
        let cos = wo.dot(m);
        if cos * wo.z <= 0.0 {
            return None;
        }
        let interface = fresnel::dielectric(cos, self.eta);
        if lobe < interface.reflectance {
            let wi = reflected(wo, m);
            let part = self.facets.visible_reflection(wo, wi, m);
            let pdf = interface.reflectance * part.pdf;
            let weight = self.specular_reflectance * part.weight;
            return (wi.z * wo.z > 0.0 && pdf > 0.0).then_some(Sample { wi, weight, pdf, eta: 1.0 });
        }
        let eta = interface.eta;
        if self.is_straight() {
            let weight = self.specular_transmittance * self.facets.masking(wo);
            return Some(Sample { wi: -wo, weight, pdf: f32::INFINITY, eta });
        }
        let wi = (m * (cos / eta + interface.cos_transmitted) - wo / eta).normalize();
        let part = self.facets.refraction(wo, wi, m, eta);
        let pdf = (1.0 - interface.reflectance) * part.pdf;
        let weight = self.specular_transmittance * part.weight;
        (wi.z * wo.z < 0.0 && pdf > 0.0).then_some(Sample { wi, weight, pdf, eta })
    }

    /// Light goes straight through but for a vanishing reflection.
    #[inline]
    pub fn is_straight(&self) -> bool {
        (self.eta - 1.0).abs() < INDEX_RESOLUTION
    }
}
