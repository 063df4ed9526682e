//! Rough surfaces as facets that are mirrors or windows: how facet normals are distributed, how many are seen, and how to
//! choose one that is. What a facet is made of is the models' concern.
//!
//! Names are those of Walter et al. 2007, "Microfacet Models for Refraction through Rough Surfaces": D is the density of
//! normals m, G1(w) the share of facets seen from w. Masking and shadowing are taken as independent, G = G1(wo) G1(wi), as
//! Mitsuba has them.

use super::{beckmann, mirrored};
use crate::scene::Distribution;
use crate::warp::around_z;
use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_1_PI, FRAC_2_SQRT_PI};

/// A smoother surface is drawn as this rough: below, f32 directions could not tell the facets apart. Mitsuba's bound.
const ALPHA_MIN: f32 = 1e-4;
/// Densities below this are taken as zero, as in Mitsuba.
const DENSITY_MIN: f32 = 1e-20;

/// A distribution of facet normals.
#[derive(Clone, Copy, Debug)]
pub struct Microfacet {
    distribution: Distribution,
    /// Roughness along the two tangents.
    alpha: Vec2,
}

/// What facets with one normal do between two directions, all but Fresnel's factor.
#[derive(Clone, Copy, Debug, Default)]
pub struct Scattering {
    /// f · |cos θi|.
    pub value: f32,
    /// Density of wi in solid angle, given that this kind of scattering was chosen.
    pub pdf: f32,
    /// `value` / `pdf`. D is not in it, so it keeps its digits where D is nearly a delta.
    pub weight: f32,
}

impl Microfacet {
    /// The distribution with these roughnesses.
    #[inline(always)]
    pub fn new(distribution: Distribution, alpha: Vec2) -> Self {
        Self { distribution, alpha: alpha.max(Vec2::splat(ALPHA_MIN)) }
    }

    /// The roughness of GGX facets that are as rough along both tangents.
    #[inline(always)]
    pub fn round_ggx(&self) -> Option<f32> {
        (self.distribution == Distribution::Ggx && self.alpha.x == self.alpha.y).then_some(self.alpha.x)
    }

    /// D(m): area of facets with this normal, a unit of surface and solid angle.
    #[inline(always)]
    pub fn density(&self, m: Vec3) -> f32 {
        if m.z <= 0.0 {
            return 0.0;
        }
        let slope = Vec2::new(m.x / self.alpha.x, m.y / self.alpha.y);
        let cos2 = m.z * m.z;
        let per_area = FRAC_1_PI / (self.alpha.x * self.alpha.y);
        let density = match self.distribution {
            Distribution::Ggx => {
                let stretched = slope.length_squared() + cos2;
                per_area / (stretched * stretched)
            }
            Distribution::Beckmann => {
                let exponent = slope.length_squared() / cos2;
                // exp(−80) is far below the bound whatever stands before it; beyond, 0 / 0 would come up.
                if exponent > 80.0 { 0.0 } else { per_area * libm::expf(-exponent) / (cos2 * cos2) }
            }
        };
        if density * m.z > DENSITY_MIN { density } else { 0.0 }
    }

    /// G1(w) / |cos θ|, which is finite at grazing angles where both go to zero.
    #[inline(always)]
    pub fn masking_over_cos(&self, w: Vec3) -> f32 {
        let cos = w.z.abs();
        let spread = self.spread(w);
        match self.distribution {
            Distribution::Ggx => 2.0 / (cos + (cos * cos + spread * spread).sqrt()),
            // Walter et al. 2007, eq. 27: within 0.35% of the true one, and what Mitsuba evaluates.
            Distribution::Beckmann if cos >= 1.6 * spread => 1.0 / cos,
            Distribution::Beckmann => {
                let a = cos / spread;
                (3.535 + 2.181 * a) / (spread * (1.0 + 2.276 * a + 2.577 * a * a))
            }
        }
    }

    /// G1(w).
    #[inline(always)]
    pub fn masking(&self, w: Vec3) -> f32 {
        self.masking_over_cos(w) * w.z.abs()
    }

    /// The share of seen facets over |cos θ| as the *sampling* has it: the density of visible normals is
    /// D(m) · this · (w·m), and must integrate to one. It differs from [`Self::masking_over_cos`] by the latter's fit.
    #[inline(always)]
    fn visible_over_cos(&self, w: Vec3) -> f32 {
        match self.distribution {
            Distribution::Ggx => self.masking_over_cos(w),
            Distribution::Beckmann => {
                let (cos, spread) = (w.z.abs(), self.spread(w));
                // Beyond a = 4, exp(−a²) is lost beside one.
                if cos >= 4.0 * spread {
                    return 1.0 / cos;
                }
                let a = cos / spread;
                2.0 / (cos * libm::erfcf(-a) + 0.5 * FRAC_2_SQRT_PI * spread * libm::expf(-a * a))
            }
        }
    }

    /// Length of the tangential part of `w`, stretched by the roughnesses: α sin θ where both are equal.
    #[inline(always)]
    fn spread(&self, w: Vec3) -> f32 {
        Vec2::new(self.alpha.x * w.x, self.alpha.y * w.y).length()
    }

    /// A facet normal as seen from `w` (w.z ≥ 0), by projected area. For GGX: Dupuy & Benyoub 2023, "Sampling Visible GGX
    /// Normals with Spherical Caps".
    #[inline(always)]
    pub fn sample_visible(&self, w: Vec3, u: Vec2) -> Vec3 {
        let stretched = self.stretched(w).normalize();
        match self.distribution {
            Distribution::Ggx => self.capped(stretched, stretched.z, u),
            Distribution::Beckmann => self.unstretched(beckmann::visible_normal(stretched, u)),
        }
    }

    /// A facet normal to reflect `wo` (wo.z > 0) with. For GGX the cap is cut to what may lead above the surface: Tokuyoshi
    /// & Eto 2024, "Bounded VNDF Sampling for the Smith-GGX BRDF".
    #[inline(always)]
    pub fn sample_reflection(&self, wo: Vec3, u: Vec2) -> Vec3 {
        match self.distribution {
            Distribution::Ggx => {
                let stretched = self.stretched(wo).normalize();
                self.capped(stretched, self.bound(wo) * stretched.z, u)
            }
            Distribution::Beckmann => self.sample_visible(wo, u),
        }
    }

    /// Reflection of `wo` into `wi`, both above, off facets with the normal `m`; sampled by [`Self::sample_reflection`].
    #[inline(always)]
    pub fn reflection(&self, wo: Vec3, wi: Vec3, m: Vec3) -> Scattering {
        let pdf_over_density = match self.distribution {
            Distribution::Ggx => 0.5 / (self.bound(wo) * wo.z + self.stretched(wo).length()),
            Distribution::Beckmann => 0.25 * self.visible_over_cos(wo),
        };
        self.scattering(wo, wi, m, 0.25, pdf_over_density)
    }

    /// Reflection as before, on either side; sampled by [`Self::sample_visible`].
    #[inline(always)]
    pub fn visible_reflection(&self, wo: Vec3, wi: Vec3, m: Vec3) -> Scattering {
        self.scattering(wo, wi, m, 0.25, 0.25 * self.visible_over_cos(wo))
    }

    /// Refraction of `wo` into `wi` on the other side; `eta` is the index on wi's side over that on wo's. Radiance is scaled
    /// by 1/η² as it crosses. Zero where a direction sees the other face of the facet.
    #[inline(always)]
    pub fn refraction(&self, wo: Vec3, wi: Vec3, m: Vec3, eta: f32) -> Scattering {
        let (cos_o, cos_i) = (wo.dot(m), wi.dot(m));
        if cos_o * wo.z <= 0.0 || cos_i * wi.z <= 0.0 {
            return Scattering::default();
        }
        // |dm/dwi|, Walter et al. 2007, eq. 17, without its η².
        let root = cos_o + eta * cos_i;
        let jacobian = (cos_o * cos_i).abs() / (root * root);
        self.scattering(wo, wi, m, jacobian, eta * eta * jacobian * self.visible_over_cos(wo))
    }

    #[inline(always)]
    fn scattering(&self, wo: Vec3, wi: Vec3, m: Vec3, jacobian: f32, pdf_over_density: f32) -> Scattering {
        let density = self.density(m);
        let value = jacobian * self.masking_over_cos(wo) * self.masking(wi);
        Scattering { value: value * density, pdf: pdf_over_density * density, weight: value / pdf_over_density }
    }

    /// A normal between `stretched` and a direction uniform in the cap z ≥ −`depth` of the sphere.
    #[inline(always)]
    fn capped(&self, stretched: Vec3, depth: f32, u: Vec2) -> Vec3 {
        let z = (1.0 - u.y) * (1.0 + depth) - depth;
        self.unstretched(stretched + around_z(z, u.x))
    }

    /// The factor k on the cap's depth (Tokuyoshi & Eto 2024, eq. 5).
    #[inline(always)]
    fn bound(&self, wo: Vec3) -> f32 {
        let alpha = self.alpha.min_element().min(1.0);
        let alpha2 = alpha * alpha;
        let s = 1.0 + Vec2::new(wo.x, wo.y).length();
        let s2 = s * s;
        (1.0 - alpha2) * s2 / (s2 + alpha2 * wo.z * wo.z)
    }

    #[inline(always)]
    fn stretched(&self, w: Vec3) -> Vec3 {
        Vec3::new(self.alpha.x * w.x, self.alpha.y * w.y, w.z)
    }

    #[inline(always)]
    fn unstretched(&self, m: Vec3) -> Vec3 {
        Vec3::new(self.alpha.x * m.x, self.alpha.y * m.y, m.z.max(0.0)).try_normalize().unwrap_or(Vec3::Z)
    }
}

/// The mirror image of `w` in the facet normal `m`.
#[inline(always)]
pub fn reflected(w: Vec3, m: Vec3) -> Vec3 {
    if m == Vec3::Z { mirrored(w) } else { m * (2.0 * w.dot(m)) - w }
}

/// The normal, on the upper side, of facets that reflect `wo` into `wi` on the same side. None for two so near to the horizon
/// and opposite that it is lost in rounding.
#[inline(always)]
pub fn half_reflected(wo: Vec3, wi: Vec3) -> Option<Vec3> {
    (wo + wi).try_normalize().map(upwards)
}

/// The normal, on the upper side, of facets that refract `wo` into `wi`; `eta` is as in [`Microfacet::refraction`]. None
/// where no facet does: the two go straight through.
#[inline(always)]
pub fn half_refracted(wo: Vec3, wi: Vec3, eta: f32) -> Option<Vec3> {
    (wo + wi * eta).try_normalize().map(upwards)
}

#[inline(always)]
fn upwards(m: Vec3) -> Vec3 {
    if m.z < 0.0 { -m } else { m }
}
