//! Burley's principled model (2012, 2015) as Mitsuba's `principled`: diffuse with sheen, a microfacet reflection between
//! dielectric and metal, a refraction, and a clear coat. It is an artist's model: it may return more than it receives.

use super::disney::{Clearcoat, diffuse_response, f0_of, schlick_fresnel, sheen_response, tint};
use super::microfacet::{Microfacet, Scattering, half_reflected, half_refracted, reflected};
use super::{Evaluation, Sample, fresnel};
use crate::warp::{cosine_hemisphere, cosine_hemisphere_pdf};
use glam::{Vec2, Vec3};
use std::f32::consts::FRAC_1_PI;

/// Its parameters, all but `eta` in 0..1.
#[derive(Clone, Copy, Debug)]
pub struct Principled {
    /// Colour of the diffuse part and of the metal.
    pub base_color: Vec3,
    /// Of the diffuse part; that of the specular ones is in `facets`.
    pub roughness: f32,
    /// From dielectric to metal.
    pub metallic: f32,
    /// From opaque to transparent.
    pub spec_trans: f32,
    /// Index of refraction inside over outside; not one if `spec_trans` is not zero: [`Principled::eta_for_facets`].
    pub eta: f32,
    /// How much of the base's colour the dielectric reflection has.
    pub spec_tint: f32,
    /// Strength of the sheen.
    pub sheen: f32,
    /// How much of the base's colour the sheen has.
    pub sheen_tint: f32,
    /// From diffuse to a subsurface look.
    pub flatness: f32,
    /// Strength of the coat.
    pub clearcoat: f32,
    /// From a satin to a glossy coat.
    pub clearcoat_gloss: f32,
    /// Facets of reflection and refraction.
    pub facets: Microfacet,
}

/// How likely each part is chosen; of what is left, the facets decide between reflection and refraction by themselves.
struct Choice {
    diffuse: f32,
    clearcoat: f32,
    facets: f32,
}

impl Principled {
    /// Mitsuba moves an index of one to 1.001 where there is refraction, and so do we with all that is as near to it: facets
    /// that do not bend light have no density.
    #[inline]
    pub fn eta_for_facets(eta: f32, spec_trans: f32) -> f32 {
        if spec_trans > 0.0 && (eta - 1.0).abs() < 5e-4 { 1.001 } else { eta }
    }

    /// All parts that scatter from `wi` to `wo`.
    #[inline]
    pub fn eval(&self, wo: Vec3, wi: Vec3) -> Evaluation {
        let (front, glass) = (wo.z > 0.0, self.glass());
        if wo.z == 0.0 || wi.z == 0.0 || !(front || glass > 0.0) {
            return Evaluation::default();
        }
        if front != (wi.z > 0.0) {
            return self.refraction(wo, wi);
        }
        let Some(m) = half_reflected(wo, wi) else { return Evaluation::default() };
        let cos = wo.dot(m);
        let interface = fresnel::dielectric(cos, self.eta);
        if !front {
            let part = self.facets.visible_reflection(wo, wi, m);
            let value = Vec3::splat(glass * interface.reflectance * part.value);
            return Evaluation { value, pdf: interface.reflectance * part.pdf };
        }
        let choice = self.choice(true);
        let (part, reflects) = self.front_reflection(wo, wi, m, interface.reflectance);
        let mut value = self.reflectance(interface.reflectance, cos) * part.value + self.diffuse(wo, wi, cos);
        let mut pdf = choice.facets * reflects * part.pdf + choice.diffuse * cosine_hemisphere_pdf(wi.z);
        if self.clearcoat > 0.0 {
            let coat = Clearcoat::new(self.clearcoat_gloss);
            let shine = schlick_fresnel(Vec3::splat(0.04), cos, self.eta).x;
            value += 0.25 * self.clearcoat * shine * coat.density(m) * Clearcoat::masking(wo, wi) * wi.z;
            pdf += choice.clearcoat * coat.pdf(m) / (4.0 * cos);
        }
        Evaluation { value, pdf }
    }

    /// By a part chosen by its strength.
    #[inline]
    pub fn sample(&self, wo: Vec3, lobe: f32, u: Vec2) -> Option<Sample> {
        let front = wo.z > 0.0;
        if wo.z == 0.0 || !(front || self.glass() > 0.0) {
            return None;
        }
        let choice = self.choice(front);
        let rest = lobe - choice.diffuse - choice.clearcoat;
        let mut eta = 1.0;
        let wi = if lobe < choice.diffuse {
            cosine_hemisphere(u)
        } else if rest < 0.0 {
            reflected(wo, Clearcoat::new(self.clearcoat_gloss).sample(u))
        } else if self.glass() > 0.0 {
            let m = self.facets.sample_visible(if front { wo } else { -wo }, u);
            let cos = wo.dot(m);
            let interface = fresnel::dielectric(cos, self.eta);
            if rest < choice.facets * self.reflects(front, interface.reflectance) {
                reflected(wo, m)
            } else {
                eta = interface.eta;
                (m * (cos / eta + interface.cos_transmitted) - wo / eta).normalize()
            }
        } else {
            reflected(wo, self.facets.sample_reflection(wo, u))
        };
        // A reflection that went through the surface, or the reverse, is lost.
        if (wi.z * wo.z > 0.0) != (eta == 1.0) {
            return None;
        }
        let Evaluation { value, pdf } = self.eval(wo, wi);
        (pdf > 0.0).then(|| Sample { wi, weight: value / pdf, pdf, eta })
    }

    /// Light may go through.
    #[inline]
    pub fn transmits(&self) -> bool {
        self.glass() > 0.0
    }

    #[inline]
    fn glass(&self) -> f32 {
        (1.0 - self.metallic) * self.spec_trans
    }

    #[inline]
    fn choice(&self, front: bool) -> Choice {
        if !front {
            return Choice { diffuse: 0.0, clearcoat: 0.0, facets: 1.0 };
        }
        let (diffuse, clearcoat) = ((1.0 - self.metallic) * (1.0 - self.spec_trans), 0.25 * self.clearcoat);
        let total = 1.0 + diffuse + clearcoat;
        Choice { diffuse: diffuse / total, clearcoat: clearcoat / total, facets: 1.0 / total }
    }

    /// Probability that facets with this reflectance reflect rather than refract.
    #[inline]
    fn reflects(&self, front: bool, reflectance: f32) -> f32 {
        if front { 1.0 - self.glass() * (1.0 - reflectance) } else { reflectance }
    }

    /// Without refraction all facets reflect, and are sampled for that alone.
    #[inline]
    fn front_reflection(&self, wo: Vec3, wi: Vec3, m: Vec3, reflectance: f32) -> (Scattering, f32) {
        if self.glass() > 0.0 {
            (self.facets.visible_reflection(wo, wi, m), self.reflects(true, reflectance))
        } else {
            (self.facets.reflection(wo, wi, m), 1.0)
        }
    }

    #[inline]
    fn refraction(&self, wo: Vec3, wi: Vec3) -> Evaluation {
        let (front, glass) = (wo.z > 0.0, self.glass());
        let eta = if front { self.eta } else { 1.0 / self.eta };
        let Some(m) = half_refracted(wo, wi, eta).filter(|_| glass > 0.0) else { return Evaluation::default() };
        let part = self.facets.refraction(wo, wi, m, eta);
        let reflectance = fresnel::dielectric(wo.dot(m), self.eta).reflectance;
        let root = Vec3::from_array(self.base_color.to_array().map(|c| c.max(0.0).sqrt()));
        Evaluation {
            value: root * (glass * (1.0 - reflectance) * part.value),
            pdf: self.choice(front).facets * (1.0 - self.reflects(front, reflectance)) * part.pdf,
        }
    }

    /// Fresnel's factor from the front: of a dielectric, a tinted dielectric and a metal, by their weights.
    #[inline]
    fn reflectance(&self, dielectric: f32, cos: f32) -> Vec3 {
        let insulator = 1.0 - self.metallic;
        let mut value = Vec3::splat(insulator * (1.0 - self.spec_tint) * dielectric);
        if self.metallic > 0.0 {
            value += self.metallic * schlick_fresnel(self.base_color, cos, self.eta);
        }
        if self.spec_tint > 0.0 {
            let f0 = tint(self.base_color) * f0_of(self.eta);
            value += insulator * self.spec_tint * schlick_fresnel(f0, cos, self.eta);
        }
        value
    }

    /// Diffuse part and sheen, from the front.
    #[inline]
    fn diffuse(&self, wo: Vec3, wi: Vec3, cos_d: f32) -> Vec3 {
        let insulator = 1.0 - self.metallic;
        let opaque = insulator * (1.0 - self.spec_trans);
        if opaque <= 0.0 {
            return Vec3::ZERO;
        }
        let response = diffuse_response(self.roughness, self.flatness, wo.z, wi.z, cos_d);
        let mut value = self.base_color * (opaque * FRAC_1_PI * response);
        if self.sheen > 0.0 {
            value += self.sheen * insulator * sheen_response(self.base_color, self.sheen_tint, cos_d);
        }
        value * wi.z
    }
}
