//! A diffuse base under a smooth clear coat: a mirror reflection, and light that enters, scatters, and leaves again, perhaps
//! after being reflected inside.

use super::{Evaluation, Sample, both_above, fresnel, mirrored};
use crate::warp::{cosine_hemisphere, cosine_hemisphere_pdf};
use glam::{Vec2, Vec3};
use std::f32::consts::FRAC_1_PI;

/// How much more often than by its brightness the mirror is chosen: its light is found by this choice alone, where light on the base is
/// sampled as well. Measured: 2 and 3 are alike, 5 is worse.
const FAVOUR: f32 = 2.0;

/// Its parameters.
#[derive(Clone, Copy, Debug)]
pub struct Plastic {
    /// Index of refraction of the coat over that outside.
    eta: f32,
    /// Albedo of the base as it would look from within, over η².
    base: Vec3,
    /// Factor on the mirror reflection.
    specular_reflectance: Vec3,
    /// How much the mirror is preferred to the base.
    preference: f32,
}

impl Plastic {
    /// From Mitsuba's parameters. `nonlinear` lets the base's colour deepen by the reflections inside.
    #[inline(always)]
    pub fn new(eta: f32, nonlinear: bool, diffuse_reflectance: Vec3, specular_reflectance: Vec3) -> Self {
        let inside = fresnel::diffuse_reflectance(1.0 / eta);
        Self {
            eta,
            base: base_from_within(diffuse_reflectance, inside, eta, nonlinear),
            specular_reflectance,
            preference: preference(FAVOUR * specular_reflectance, diffuse_reflectance),
        }
    }

    /// The base's part, and the density of choosing it.
    #[inline(always)]
    pub fn eval(&self, wo: Vec3, wi: Vec3) -> Evaluation {
        if !both_above(wo, wi) {
            return Evaluation::default();
        }
        let passed = (1.0 - self.reflectance(wo)) * (1.0 - self.reflectance(wi));
        let pdf = (1.0 - self.mirror_share(wo)) * cosine_hemisphere_pdf(wi.z);
        Evaluation { value: self.base * (passed * FRAC_1_PI * wi.z), pdf }
    }

    /// The mirror direction, or the base by the cosine.
    #[inline(always)]
    pub fn sample(&self, wo: Vec3, lobe: f32, u: Vec2) -> Option<Sample> {
        if wo.z <= 0.0 {
            return None;
        }
        let (reflectance, share) = (self.reflectance(wo), self.mirror_share(wo));
        if lobe < share {
            let weight = self.specular_reflectance * (reflectance / share);
            return Some(Sample { wi: mirrored(wo), weight, pdf: f32::INFINITY, eta: 1.0 });
        }
        let wi = cosine_hemisphere(u);
        let passed = (1.0 - reflectance) * (1.0 - self.reflectance(wi)) / (1.0 - share);
        let pdf = (1.0 - share) * cosine_hemisphere_pdf(wi.z);
        (pdf > 0.0).then_some(Sample { wi, weight: self.base * passed, pdf, eta: 1.0 })
    }

    /// Probability of the mirror direction.
    #[inline(always)]
    pub fn mirror_share(&self, wo: Vec3) -> f32 {
        share_of_mirror(self.reflectance(wo), self.preference)
    }

    #[inline(always)]
    fn reflectance(&self, w: Vec3) -> f32 {
        fresnel::dielectric(w.z, self.eta).reflectance
    }
}

/// The base's albedo summed over reflections `inside` the coat, over η²: a / (1 − a r), or with the colour kept a / (1 − r).
#[inline(always)]
pub fn base_from_within(albedo: Vec3, inside: f32, eta: f32, nonlinear: bool) -> Vec3 {
    let lost = if nonlinear { albedo * inside } else { Vec3::splat(inside) };
    albedo / ((Vec3::ONE - lost) * (eta * eta))
}

/// Which of the coat and the base is brighter by its colour: 1 is the coat alone.
#[inline(always)]
pub fn preference(specular: Vec3, diffuse: Vec3) -> f32 {
    let (s, d) = (specular.max_element(), diffuse.max_element());
    if s + d > 0.0 { s / (s + d) } else { 0.5 }
}

/// Probability to choose the coat where it reflects `reflectance`.
#[inline(always)]
pub fn share_of_mirror(reflectance: f32, preference: f32) -> f32 {
    let (coat, base) = (reflectance * preference, (1.0 - reflectance) * (1.0 - preference));
    if coat + base > 0.0 { coat / (coat + base) } else { 0.5 }
}
