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
/// Points a side of the grid that integrates over facets, for light from outside and from within, where total reflection makes
/// an edge: Mitsuba's.
const GRID_OUTSIDE: usize = 32;
const GRID_INSIDE: usize = 128;

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
    #[inline]
    pub fn new(coat: &'a RoughCoat, nonlinear: bool, diffuse_reflectance: Vec3, specular_reflectance: Vec3) -> Self {
        let base = base_from_within(diffuse_reflectance, coat.internal_reflectance, coat.eta, nonlinear);
        let preference = preference(specular_reflectance, diffuse_reflectance);
        Self { coat, base, specular_reflectance, preference }
    }

    /// The coat's reflection and the base's, and the density of choosing between facets and cosine.
    #[inline]
    pub fn eval(&self, wo: Vec3, wi: Vec3) -> Evaluation {
        if !both_above(wo, wi) {
            return Evaluation::default();
        }
        let Some(m) = half_reflected(wo, wi) else { return Evaluation::default() };
        let Scattering { value, pdf, .. } = self.coat.facets.reflection(wo, wi, m);
        let reflectance = fresnel::dielectric(wo.dot(m), self.coat.eta).reflectance;
        let (enters, leaves) = (self.coat.transmittance(wo.z), self.coat.transmittance(wi.z));
        let share = share_of_mirror(1.0 - enters, self.preference);
        Evaluation {
            value: self.specular_reflectance * (reflectance * value) + self.base * (enters * leaves * FRAC_1_PI * wi.z),
            pdf: share * pdf + (1.0 - share) * cosine_hemisphere_pdf(wi.z),
        }
    }

    /// Off a visible facet, or from the base by the cosine.
    #[inline]
    pub fn sample(&self, wo: Vec3, lobe: f32, u: Vec2) -> Option<Sample> {
        if wo.z <= 0.0 {
            return None;
        }
        let share = share_of_mirror(1.0 - self.coat.transmittance(wo.z), self.preference);
        let wi =
            if lobe < share { reflected(wo, self.coat.facets.sample_reflection(wo, u)) } else { cosine_hemisphere(u) };
        let Evaluation { value, pdf } = self.eval(wo, wi);
        (pdf > 0.0).then(|| Sample { wi, weight: value / pdf, pdf, eta: 1.0 })
    }
}

impl RoughCoat {
    /// Tabulates a coat, on the current rayon pool; some ten milliseconds of work.
    pub fn new(distribution: Distribution, alpha: f32, eta: f32) -> Self {
        let facets = Microfacet::new(distribution, Vec2::splat(alpha));
        let (outside, within) = (grid(GRID_OUTSIDE), grid(GRID_INSIDE));
        let shares: Vec<(f64, f64)> = (0..TABLE)
            .into_par_iter()
            .map(|i| {
                let cos = (i as f32 / (TABLE - 1) as f32).max(1e-6);
                let (_, entering) = reflected_and_refracted(&facets, cos, eta, &outside);
                let (reflected, _) = reflected_and_refracted(&facets, cos, 1.0 / eta, &within);
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
    #[inline]
    fn transmittance(&self, cos: f32) -> f32 {
        let x = cos * (TABLE - 1) as f32;
        let i = (x as usize).min(TABLE - 2);
        let t = x - i as f32;
        self.transmittance[i] * (1.0 - t) + self.transmittance[i + 1] * t
    }
}

/// A grid of points on the unit square with their weights, which sum to 1: `n` nodes of Gauss and Legendre a side.
fn grid(n: usize) -> Vec<(Vec2, f64)> {
    let nodes = gauss_legendre(n);
    let point = |a: &(f64, f64), b: &(f64, f64)| (Vec2::new(a.0 as f32, b.0 as f32), a.1 * b.1);
    nodes.iter().flat_map(|a| nodes.iter().map(move |b| point(a, b))).collect()
}

/// Nodes in (0, 1) and weights of the rule that is exact for polynomials of degree 2n − 1: the roots of Legendre's polynomial
/// by Newton's method from Tricomi's first guess (Abramowitz & Stegun 1964, 25.4.30).
fn gauss_legendre(n: usize) -> Vec<(f64, f64)> {
    /// Newton doubles the right digits, of which the guess has three.
    const STEPS: usize = 6;
    let count = n as f64;
    let polynomial = |x: f64| {
        let (mut before, mut p) = (1.0, x);
        for k in 2..=n {
            let k = k as f64;
            (before, p) = (p, ((2.0 * k - 1.0) * x * p - (k - 1.0) * before) / k);
        }
        (p, count * (x * p - before) / (x * x - 1.0))
    };
    let node = |i: usize| {
        let mut x = libm::cos(std::f64::consts::PI * (i as f64 + 0.75) / (count + 0.5));
        for _ in 0..STEPS {
            let (p, slope) = polynomial(x);
            x -= p / slope;
        }
        let slope = polynomial(x).1;
        (0.5 * (x + 1.0), 1.0 / ((1.0 - x * x) * slope * slope))
    };
    (0..n).map(node).collect()
}

/// Of the light that meets the facets at this cosine, the shares that leave by one reflection and by one refraction:
/// E[F G1(wi)] and E[(1 − F) G1(wi)] over the visible normals, by the points of `grid`.
fn reflected_and_refracted(facets: &Microfacet, cos: f32, eta: f32, grid: &[(Vec2, f64)]) -> (f64, f64) {
    let wo = Vec3::new((1.0 - cos * cos).max(0.0).sqrt(), 0.0, cos);
    let (mut reflected_sum, mut refracted_sum) = (0.0, 0.0);
    for &(u, weight) in grid {
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
    (reflected_sum, refracted_sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails if a step of the recurrence is wrong: x^k integrates to 1/(k + 1) up to degree 2n − 1.
    #[test]
    fn the_rule_is_exact_for_polynomials() {
        for k in 0..64 {
            let sum: f64 = gauss_legendre(32).iter().map(|(x, w)| w * x.powi(k)).sum();
            assert!((sum * f64::from(k + 1) - 1.0).abs() < 1e-12, "x^{k}: {sum}");
        }
    }

    /// What Mitsuba 3.9.1 tabulates for GGX 0.1 and 0.2 at an index of 1.5: entries 1, 5, 20 and 63 of the transmittance, and
    /// the reflectance inside. The same points of the square stand for other facets there: Mitsuba's entries are up to
    /// 4·10^-4 above the integral (0.959199 for the last of GGX 0.1), these up to 10^-4.
    #[test]
    fn tables_are_mitsubas() {
        let rows: [(f32, [f64; 4], f64); 2] = [
            (0.1, [0.569_286, 0.592_172, 0.817_901, 0.959_560], 0.551_894),
            (0.2, [0.663_511, 0.697_282, 0.829_141, 0.957_231], 0.486_299),
        ];
        for (alpha, entries, inside) in rows {
            let coat = RoughCoat::new(Distribution::Ggx, alpha, 1.5);
            for (i, expected) in [1, 5, 20, 63].into_iter().zip(entries) {
                let entry = f64::from(coat.transmittance[i]);
                assert!((entry / expected - 1.0).abs() < 4e-4, "alpha {alpha}, entry {i}: {entry} for {expected}");
            }
            let found = f64::from(coat.internal_reflectance);
            assert!((found / inside - 1.0).abs() < 5e-4, "alpha {alpha}: {found} for {inside}");
        }
    }
}
