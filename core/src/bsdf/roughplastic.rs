//! A diffuse base under a rough clear coat. How much light passes the coat is an integral over its facets; it is tabulated
//! once a material, as Mitsuba does.

use super::microfacet::{Microfacet, Scattering, half_reflected, reflected};
use super::plastic::{base_from_within, preference, share_of_mirror};
use super::{Evaluation, Sample, both_above, fresnel};
use crate::scene::Distribution;
use crate::warp::{cosine_hemisphere, cosine_hemisphere_pdf};
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use std::f32::consts::FRAC_1_PI;

/// Entries of a coat's table: cosines 0, 1/63, … 1.
const TABLE: usize = 64;
/// Points a side of the grid that integrates over facets: the tables are exact to some 10^-4.
const GRID: u32 = 64;

/// What a rough coat lets through.
#[derive(Clone, Debug)]
pub struct RoughCoat {
    facets: Microfacet,
    /// Index of refraction of the coat over that outside.
    eta: f32,
    /// Share of the light from outside that enters, by the cosine of its direction.
    transmittance: [f32; TABLE],
    /// Share of the diffuse light from within that is reflected back.
    internal_reflectance: f32,
}

/// Its parameters.
#[derive(Clone, Copy, Debug)]
pub struct RoughPlastic<'a> {
    coat: &'a RoughCoat,
    /// Albedo of the base as it would look from within, over η².
    base: Vec3,
    /// Factor on the coat's reflection.
    specular_reflectance: Vec3,
    /// How much the coat is preferred to the base.
    preference: f32,
}

impl<'a> RoughPlastic<'a> {
    /// From Mitsuba's parameters. `nonlinear` lets the base's colour deepen by the reflections inside.
    #[inline(always)]
    pub fn new(coat: &'a RoughCoat, nonlinear: bool, diffuse_reflectance: Vec3, specular_reflectance: Vec3) -> Self {
        let base = base_from_within(diffuse_reflectance, coat.internal_reflectance, coat.eta, nonlinear);
        let preference = preference(specular_reflectance, diffuse_reflectance);
        Self { coat, base, specular_reflectance, preference }
    }

    /// What matters of it to all directions from one that it is seen from.
    #[inline(always)]
    pub fn seen_from(&self, wo: Vec3) -> SeenPlastic {
        let enters = self.transmittance(wo.z);
        SeenPlastic {
            facets: self.coat.facets,
            eta: self.coat.eta,
            base: self.base,
            specular_reflectance: self.specular_reflectance,
            enters,
            share: share_of_mirror(1.0 - enters, self.preference),
        }
    }

    /// Share of the light at this cosine that passes the coat.
    #[inline(always)]
    pub fn transmittance(&self, cos: f32) -> f32 {
        self.coat.transmittance(cos)
    }

    /// The coat's reflection and the base's, and the density of choosing between facets and cosine.
    #[inline(always)]
    pub fn eval(&self, wo: Vec3, wi: Vec3) -> Evaluation {
        if !both_above(wo, wi) {
            return Evaluation::default();
        }
        self.seen_from(wo).eval(wo, wi, self.transmittance(wi.z))
    }

    /// Off a visible facet, or from the base by the cosine.
    #[inline(always)]
    pub fn sample(&self, wo: Vec3, lobe: f32, u: Vec2) -> Option<Sample> {
        if wo.z <= 0.0 {
            return None;
        }
        let seen = self.seen_from(wo);
        let wi = seen.direction(wo, lobe, u);
        let (sample, is_some) = seen.sample(wo, wi, self.transmittance(wi.z));
        is_some.then_some(sample)
    }
}

/// A rough plastic seen from one direction, without its table: for loops over many surfaces.
#[derive(Clone, Copy, Debug)]
pub struct SeenPlastic {
    /// The coat's facets.
    pub facets: Microfacet,
    /// Index of refraction of the coat over that outside.
    pub eta: f32,
    /// Albedo of the base as it would look from within, over η².
    pub base: Vec3,
    /// Factor on the coat's reflection.
    pub specular_reflectance: Vec3,
    /// Share of the light from there that enters.
    pub enters: f32,
    /// Probability to choose the coat.
    pub share: f32,
}

impl SeenPlastic {
    /// As [`RoughPlastic::eval`]; of the light from `wi` the share `leaves` would pass the coat.
    #[inline(always)]
    pub fn eval(&self, wo: Vec3, wi: Vec3, leaves: f32) -> Evaluation {
        let half = half_reflected(wo, wi);
        let m = half.unwrap_or(Vec3::Z);
        let is_some = both_above(wo, wi) & half.is_some();
        let Scattering { value, pdf, .. } = self.facets.reflection(wo, wi, m);
        let reflectance = fresnel::dielectric(wo.dot(m), self.eta).reflectance;
        let value =
            self.specular_reflectance * (reflectance * value) + self.base * (self.enters * leaves * FRAC_1_PI * wi.z);
        let pdf = self.share * pdf + (1.0 - self.share) * cosine_hemisphere_pdf(wi.z);
        Evaluation { value: if is_some { value } else { Vec3::ZERO }, pdf: if is_some { pdf } else { 0.0 } }
    }

    /// A direction, to be followed by [`SeenPlastic::sample`].
    #[inline(always)]
    pub fn direction(&self, wo: Vec3, lobe: f32, u: Vec2) -> Vec3 {
        let (off_facet, from_base) = (reflected(wo, self.facets.sample_reflection(wo, u)), cosine_hemisphere(u));
        if lobe < self.share { off_facet } else { from_base }
    }

    /// What that direction is worth, and whether it is one.
    #[inline(always)]
    pub fn sample(&self, wo: Vec3, wi: Vec3, leaves: f32) -> (Sample, bool) {
        let Evaluation { value, pdf } = self.eval(wo, wi, leaves);
        (Sample { wi, weight: value / pdf, pdf, eta: 1.0 }, (wo.z > 0.0) & (pdf > 0.0))
    }
}

impl RoughCoat {
    /// Tabulates a coat, on the current rayon pool; some ten milliseconds of work.
    pub fn new(distribution: Distribution, alpha: f32, eta: f32) -> Self {
        let facets = Microfacet::new(distribution, Vec2::splat(alpha));
        let shares: Vec<(f64, f64)> = (0..TABLE)
            .into_par_iter()
            .map(|i| {
                let cos = (i as f32 / (TABLE - 1) as f32).max(1e-6);
                let (_, entering) = reflected_and_refracted(distribution, &facets, cos, eta);
                let (reflected, _) = reflected_and_refracted(distribution, &facets, cos, 1.0 / eta);
                (entering, reflected * f64::from(cos))
            })
            .collect();
        // 2 ∫ R cos d cos as the plain mean over the table's cosines: cruder than the table deserves, but so does Mitsuba,
        // whose pictures would else be brighter by about one percent.
        let inside: f64 = shares.iter().map(|(_, reflected)| reflected).sum();
        Self {
            facets,
            eta,
            transmittance: std::array::from_fn(|i| shares[i].0 as f32),
            internal_reflectance: (2.0 * inside / TABLE as f64) as f32,
        }
    }

    /// The table, linear between its entries.
    #[inline(always)]
    fn transmittance(&self, cos: f32) -> f32 {
        let x = cos * (TABLE - 1) as f32;
        let i = (x as usize).min(TABLE - 2);
        let t = x - i as f32;
        self.transmittance[i] * (1.0 - t) + self.transmittance[i + 1] * t
    }
}

/// Of the light that meets the facets at this cosine, the shares that leave by one reflection and by one refraction:
/// E[F G1(wi)] and E[(1 − F) G1(wi)] over the visible normals.
fn reflected_and_refracted(distribution: Distribution, facets: &Microfacet, cos: f32, eta: f32) -> (f64, f64) {
    let wo = Vec3::new((1.0 - cos * cos).max(0.0).sqrt(), 0.0, cos);
    let (mut reflected_sum, mut refracted_sum, mut weights) = (0.0, 0.0, 0.0);
    // One coordinate mirrors the normal in the plane of wo, so half of it is enough.
    for i in 0..GRID * GRID / 2 {
        let s = (Vec2::new((i / GRID) as f32, (i % GRID) as f32) + 0.5) / GRID as f32;
        // Steps that shrink towards the ends, where Beckmann's map is steep.
        let u = s * s * (Vec2::splat(3.0) - 2.0 * s);
        let weight = f64::from(s.x * (1.0 - s.x) * s.y * (1.0 - s.y));
        let u = match distribution {
            Distribution::Ggx => u,
            Distribution::Beckmann => Vec2::new(u.y, u.x),
        };
        weights += weight;
        let m = facets.sample_visible(wo, u);
        let cos = wo.dot(m);
        let interface = fresnel::dielectric(cos, eta);
        let up = reflected(wo, m);
        if up.z > 0.0 {
            reflected_sum += weight * f64::from(interface.reflectance * facets.masking(up));
        }
        let down = m * (cos / interface.eta + interface.cos_transmitted) - wo / interface.eta;
        if down.z < 0.0 && interface.reflectance < 1.0 {
            refracted_sum += weight * f64::from((1.0 - interface.reflectance) * facets.masking(down));
        }
    }
    (reflected_sum / weights, refracted_sum / weights)
}
