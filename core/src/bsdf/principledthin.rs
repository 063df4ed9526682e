//! Burley's principled model for thin sheets (2015, §4) as Mitsuba's `principledthin`: reflection and refraction by facets,
//! the latter a mirror image of the former, and diffuse reflection with sheen and diffuse transmission. Both sides are alike.

use super::disney::{alphas, diffuse_response, f0_of, schlick_fresnel, sheen_response, tint};
use super::microfacet::{Microfacet, half_reflected, reflected};
use super::{Evaluation, Sample, fresnel};
use crate::scene::Distribution;
use crate::warp::{cosine_hemisphere, cosine_hemisphere_pdf};
use glam::{Vec2, Vec3};
use std::f32::consts::FRAC_1_PI;

/// Its parameters, all but `eta` in 0..1.
#[derive(Clone, Copy, Debug)]
pub struct PrincipledThin {
    /// Colour.
    pub base_color: Vec3,
    /// Of the diffuse part and, squared, of the facets.
    pub roughness: f32,
    /// From round to long highlights along the first tangent.
    pub anisotropic: f32,
    /// From diffuse to clear.
    pub spec_trans: f32,
    /// Index of refraction inside over outside.
    pub eta: f32,
    /// How much of the base's colour the reflection has.
    pub spec_tint: f32,
    /// Strength of the sheen.
    pub sheen: f32,
    /// How much of the base's colour the sheen has.
    pub sheen_tint: f32,
    /// From diffuse to a subsurface look.
    pub flatness: f32,
    /// Share of the diffuse light that goes through (half of Mitsuba's parameter).
    pub diff_trans: f32,
}

impl PrincipledThin {
    /// All parts that scatter from `wi` to `wo`.
    #[inline]
    pub fn eval(&self, wo: Vec3, wi: Vec3) -> Evaluation {
        if wo.z == 0.0 || wi.z == 0.0 {
            return Evaluation::default();
        }
        let (wo, wi) = if wo.z > 0.0 { (wo, wi) } else { (-wo, -wi) };
        // Facets know the upper side only.
        let up = Vec3::new(wi.x, wi.y, wi.z.abs());
        let Some(m) = half_reflected(wo, up) else { return Evaluation::default() };
        let cos = wo.dot(m);
        if wi.z > 0.0 { self.reflection(wo, wi, m, cos) } else { self.transmission(wo, wi, up, m, cos) }
    }

    /// By a part chosen by its strength.
    #[inline]
    pub fn sample(&self, wo: Vec3, lobe: f32, u: Vec2) -> Option<Sample> {
        if wo.z == 0.0 {
            return None;
        }
        let side = 1.0f32.copysign(wo.z);
        let above = wo * side;
        let clear = 0.5 * self.spec_trans;
        let wi = if lobe < clear {
            reflected(above, self.reflecting().sample_reflection(above, u))
        } else if lobe < self.spec_trans {
            let m = self.transmitting().sample_reflection(above, u);
            let up = reflected(above, m);
            let wi = Vec3::new(up.x, up.y, -up.z);
            if wi.dot(m) >= 0.0 {
                return None;
            }
            wi
        } else if lobe < self.spec_trans + self.opaque() * (1.0 - self.diff_trans) {
            cosine_hemisphere(u)
        } else {
            -cosine_hemisphere(u)
        };
        // A facet's reflection that ended on the other side is lost; it must not pass for another part's.
        if lobe < self.spec_trans && (lobe < clear) != (wi.z > 0.0) {
            return None;
        }
        let wi = wi * side;
        let Evaluation { value, pdf } = self.eval(wo, wi);
        (pdf > 0.0).then(|| Sample { wi, weight: value / pdf, pdf, eta: 1.0 })
    }

    #[inline]
    fn reflection(&self, wo: Vec3, wi: Vec3, m: Vec3, cos: f32) -> Evaluation {
        let mut value = Vec3::ZERO;
        let diffuse = self.opaque() * (1.0 - self.diff_trans);
        let mut pdf = diffuse * cosine_hemisphere_pdf(wi.z);
        if diffuse > 0.0 {
            let response = diffuse_response(self.roughness, self.flatness, wo.z, wi.z, cos);
            value += self.base_color * (diffuse * FRAC_1_PI * response * wi.z);
            if self.sheen > 0.0 {
                value += self.sheen * diffuse * wi.z * sheen_response(self.base_color, self.sheen_tint, cos);
            }
        }
        if self.spec_trans > 0.0 {
            let part = self.reflecting().reflection(wo, wi, m);
            let dielectric = fresnel::dielectric(cos, self.eta).reflectance;
            let f0 = tint(self.base_color) * f0_of(self.eta);
            let tinted = schlick_fresnel(f0, cos, self.eta);
            let factor = Vec3::splat(dielectric * (1.0 - self.spec_tint)) + tinted * self.spec_tint;
            value += self.spec_trans * factor * part.value;
            pdf += 0.5 * self.spec_trans * part.pdf;
        }
        Evaluation { value, pdf }
    }

    /// `up` is the mirror image of `wi` above the sheet.
    #[inline]
    fn transmission(&self, wo: Vec3, wi: Vec3, up: Vec3, m: Vec3, cos: f32) -> Evaluation {
        let diffuse = self.opaque() * self.diff_trans;
        let mut value = self.base_color * (diffuse * FRAC_1_PI * up.z);
        let mut pdf = diffuse * cosine_hemisphere_pdf(up.z);
        if self.spec_trans > 0.0 && wi.dot(m) < 0.0 {
            let part = self.transmitting().reflection(wo, up, m);
            let passed = 1.0 - fresnel::dielectric(cos, self.eta).reflectance;
            value += self.base_color * (self.spec_trans * passed * part.value);
            pdf += 0.5 * self.spec_trans * part.pdf;
        }
        Evaluation { value, pdf }
    }

    #[inline]
    fn opaque(&self) -> f32 {
        1.0 - self.spec_trans
    }

    #[inline]
    fn reflecting(&self) -> Microfacet {
        Microfacet::new(Distribution::Ggx, alphas(self.roughness, self.anisotropic))
    }

    /// Two interfaces in a row widen the lobe by the index (Burley 2015, figure 15).
    #[inline]
    fn transmitting(&self) -> Microfacet {
        let roughness = (0.65 * self.eta - 0.35) * self.roughness;
        Microfacet::new(Distribution::Ggx, alphas(roughness, self.anisotropic))
    }
}
